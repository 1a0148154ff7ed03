"""Independent float64 truths for the reflectance laws, in angle form, written from ../shared/photometry.md.

Nothing here is shared with glrender.brdf: angles come from atan2 in extended precision, Hapke's law
has both branches of its roughness and the Legendre sums as printed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import eval_legendre


@dataclass(frozen=True)
class Angles:
    """incidence, emission, azimuth and phase [rad], (N,) each."""

    i: np.ndarray
    e: np.ndarray
    psi: np.ndarray
    g: np.ndarray


def _norm(v):
    return np.sqrt((v * v).sum(axis=-1))


def angles(to_sun, to_camera, normal) -> Angles:
    """Angles of (N, 3) vectors, atan2 of exact lengths in extended precision."""
    s, v, n = (np.asarray(x, np.longdouble) for x in (to_sun, to_camera, normal))
    s, v, n = (x / _norm(x)[..., None] for x in (s, v, n))
    a, b = np.cross(n, s), np.cross(n, v)
    i = np.arctan2(_norm(a), (n * s).sum(-1))
    e = np.arctan2(_norm(b), (n * v).sum(-1))
    psi = np.arctan2(_norm(np.cross(a, b)), (a * b).sum(-1))
    g = 2 * np.arctan2(_norm(s - v), _norm(s + v))
    return Angles(*(x.astype(np.float64) for x in (i, e, psi, g)))


def phase(i, e, psi):
    """Phase angle [rad] by the spherical law of cosines, in extended precision."""
    i, e, psi = (np.asarray(x, np.longdouble) for x in (i, e, psi))
    # haversines: no acos near 0.
    hav = np.sin((i - e) / 2) ** 2 + np.sin(i) * np.sin(e) * np.sin(psi / 2) ** 2
    return (2 * np.arctan2(np.sqrt(hav), np.sqrt(np.maximum(1 - hav, 0)))).astype(np.float64)


def vectors(i, e, psi, rng=None):
    """Unit vectors (N, 3) to the Sun, to the camera and the normal for angles [rad]; turned at random."""
    i, e, psi = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in (i, e, psi)))
    zero = np.zeros_like(i)
    s = np.stack([np.sin(i), zero, np.cos(i)], axis=-1)
    v = np.stack([np.sin(e) * np.cos(psi), np.sin(e) * np.sin(psi), np.cos(e)], axis=-1)
    n = np.broadcast_to([0.0, 0.0, 1.0], s.shape)
    if rng is None:
        return s, v, n
    q = rng.normal(size=(len(i), 4))
    w, x, y, z = (q / _norm(q)[:, None]).T
    turn = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                     2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                     2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    turn = turn.reshape(-1, 3, 3)
    return tuple(np.einsum("nij,nj->ni", turn, u) for u in (s, v, n))


def random_vectors(rng, count, max_deg=90.0):
    """Directions uniform over the cap of max_deg about the normal."""
    low = np.cos(np.radians(max_deg))
    i, e = np.arccos(rng.uniform(low, 1.0, (2, count)))
    return vectors(i, e, rng.uniform(0.0, np.pi, count), rng)


# ---- BRDFs [1/sr] of Angles. I/F = pi f cos i.


def lambert(a, albedo):
    return np.full_like(a.i, albedo / np.pi)


def lommel_seeliger(a, w, curve=None):
    p = 1.0 if curve is None else curve(np.degrees(a.g))
    return w / (4 * np.pi) * p / (np.cos(a.i) + np.cos(a.e))


def lunar_lambert(a, albedo, weight):
    """weight: function of the phase angle in degrees."""
    mu0, mu, big_l = np.cos(a.i), np.cos(a.e), weight(np.degrees(a.g))
    return albedo * (2 * big_l * mu0 / (mu0 + mu) + (1 - big_l) * mu0) / (np.pi * mu0)


def minnaert(a, albedo, k0, k1):
    k = k0 + k1 * np.degrees(a.g)
    return albedo / np.pi * np.cos(a.i) ** (k - 1) * np.cos(a.e) ** (k - 1)


def akimov(a, albedo):
    """tan gamma = (mu0/mu - cos g)/sin g; the printed form, so not for g = 0."""
    mu0, mu, g = np.cos(a.i), np.cos(a.e), a.g
    gamma = np.arctan((mu0 / mu - np.cos(g)) / np.sin(g))
    cos_beta = mu / np.cos(gamma)
    disk = (np.cos(g / 2) * np.cos(np.pi / (np.pi - g) * (gamma - g / 2))
            * cos_beta ** (g / (np.pi - g)) / np.cos(gamma))
    return albedo / np.pi * disk / mu0


def rolo(a, c0, c1, *terms):
    g = np.degrees(a.g)
    curve = c0 * np.exp(-c1 * g) + sum(term * g**k for k, term in enumerate(terms))
    return curve / (np.cos(a.i) + np.cos(a.e)) / np.pi


def oren_nayar(a, albedo, sigma_deg):
    s2 = np.radians(sigma_deg) ** 2
    big_a, big_b = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    alpha, beta = np.maximum(a.i, a.e), np.minimum(a.i, a.e)
    return albedo / np.pi * (big_a + big_b * np.maximum(0, np.cos(a.psi)) * np.sin(alpha) * np.tan(beta))


def henyey_greenstein(g, b, c):
    def lobe(x):
        return (1 - b * b) / (1 + 2 * x * np.cos(g) + b * b) ** 1.5

    return (1 + c) / 2 * lobe(-b) + (1 - c) / 2 * lobe(b)


def h_1981(x, w):
    return (1 + 2 * x) / (1 + 2 * x * np.sqrt(1 - w))


def h_2002(x, w):
    gamma = np.sqrt(1 - w)
    r0 = (1 - gamma) / (1 + gamma)
    return 1 / (1 - w * x * (r0 + (1 - 2 * r0 * x) / 2 * np.log((1 + x) / x)))


def h_exact(x, w, n_nodes=200):
    """Chandrasekhar's H by fixed point of 1/H = sqrt(1 - w) + w/2 int u H(u)/(x + u) du."""
    nodes, weights = np.polynomial.legendre.leggauss(n_nodes)
    u, du = 0.5 * (nodes + 1), 0.5 * weights
    h = np.ones(n_nodes)
    for _ in range(20000):
        new = 1 / (np.sqrt(1 - w) + w / 2 * (u * h * du / (u[:, None] + u)).sum(axis=1))
        done = np.abs(new - h).max() < 1e-13
        h = 0.5 * (h + new)
        if done:
            break
    x = np.atleast_1d(np.asarray(x, np.float64))
    return 1 / (np.sqrt(1 - w) + w / 2 * (u * h * du / (x[..., None] + u)).sum(axis=-1))


def _a(n):
    if n % 2 == 0:
        return 0.0
    return -0.5 if n == 1 else (2 - n) / (n + 1) * _a(n - 2)


def _b(n, b, c):
    return (2 * n + 1) * b**n * (1 if n % 2 == 0 else c)


def roughness(i, e, psi, theta_deg):
    """mu0e, mue and S of Hapke (1984), both branches as printed; 0 < theta, 0 <= i, e < pi/2."""
    big_t = np.tan(np.radians(theta_deg))
    chi = 1 / np.sqrt(1 + np.pi * big_t**2)
    mu0, mu = np.cos(i), np.cos(e)
    with np.errstate(divide="ignore", over="ignore"):
        cot = {"i": np.where(i > 0, 1 / np.tan(i), np.inf), "e": np.where(e > 0, 1 / np.tan(e), np.inf)}
        f = np.where(psi < np.pi, np.exp(-2 * np.tan(psi / 2)), 0.0)
        e1 = {k: np.exp(-2 / np.pi * c / big_t) for k, c in cot.items()}
        e2 = {k: np.exp(-1 / np.pi * (c / big_t) ** 2) for k, c in cot.items()}
    eta_i = chi * (mu0 + np.sin(i) * big_t * e2["i"] / (2 - e1["i"]))
    eta_e = chi * (mu + np.sin(e) * big_t * e2["e"] / (2 - e1["e"]))
    half = np.sin(psi / 2) ** 2

    d = 2 - e1["e"] - psi / np.pi * e1["i"]
    mu0e_1 = chi * (mu0 + np.sin(i) * big_t * (np.cos(psi) * e2["e"] + half * e2["i"]) / d)
    mue_1 = chi * (mu + np.sin(e) * big_t * (e2["e"] - half * e2["i"]) / d)
    s_1 = mue_1 / eta_e * mu0 / eta_i * chi / (1 - f + f * chi * mu0 / eta_i)

    d = 2 - e1["i"] - psi / np.pi * e1["e"]
    mu0e_2 = chi * (mu0 + np.sin(i) * big_t * (e2["i"] - half * e2["e"]) / d)
    mue_2 = chi * (mu + np.sin(e) * big_t * (np.cos(psi) * e2["i"] + half * e2["e"]) / d)
    s_2 = mue_2 / eta_e * mu0 / eta_i * chi / (1 - f + f * chi * mu / eta_e)
    first = i <= e
    return np.where(first, mu0e_1, mu0e_2), np.where(first, mue_1, mue_2), np.where(first, s_1, s_2)


def hapke(a, *, w, b, c, b_s0=0.0, h_s=0.0, b_c0=0.0, h_c=0.0, theta_deg=0.0, phi=0.0, h_function="2002",
          multiple_scattering="isotropic", h=None):
    """photometry.md section 1.5, r / mu0; h replaces the H function."""
    x = 1.209 * phi ** (2 / 3)
    k = 1.0 if phi == 0 else -np.log(1 - x) / x
    mu0e, mue, s = np.cos(a.i), np.cos(a.e), 1.0
    if theta_deg > 0:
        mu0e, mue, s = roughness(a.i, a.e, a.psi, theta_deg)
    h = h or {"1981": h_1981, "2002": h_2002}[h_function]
    h0, h1 = h(mu0e / k, w), h(mue / k, w)
    if multiple_scattering == "anisotropic":
        n_terms = 15 if b <= 0.3 else 151

        def averaged(x):
            return 1 + sum(_a(n) * _b(n, b, c) * eval_legendre(n, x) for n in range(1, n_terms + 1, 2))

        constant = 1 + sum(_a(n) ** 2 * _b(n, b, c) for n in range(1, n_terms + 1))
        m = averaged(mu0e / k) * (h1 - 1) + averaged(mue / k) * (h0 - 1) + constant * (h1 - 1) * (h0 - 1)
    else:
        m = h0 * h1 - 1
    tan_half = np.tan(a.g / 2)
    shoe = b_s0 / (1 + tan_half / h_s) if b_s0 and h_s else 0.0
    cboe = 0.0
    if b_c0 and h_c:
        z = np.maximum(tan_half / h_c, 1e-12)
        cboe = b_c0 * (1 - np.expm1(-z) / z) / (2 * (1 + z) ** 2)
    p = henyey_greenstein(a.g, b, c)
    r = k * w / (4 * np.pi) * mu0e / (mu0e + mue) * (p * (1 + shoe) + m) * (1 + cboe) * s
    return np.maximum(r / np.cos(a.i), 0.0)


# Names above -> arguments of glrender.brdf.Hapke.
HAPKE_NAMES = {
    "w": "single_scattering_albedo", "b": "b", "c": "c", "b_s0": "shoe_amplitude", "h_s": "shoe_width",
    "b_c0": "cboe_amplitude", "h_c": "cboe_width", "theta_deg": "roughness_deg", "phi": "filling_factor",
    "h_function": "h_function", "multiple_scattering": "multiple_scattering"}


def random_hapke(rng, max_b=0.7):
    """Parameters of `hapke`, each term on or off."""
    def sometimes(value):
        return value if rng.random() < 0.7 else 0.0

    return {"w": rng.uniform(0.01, 1.0), "b": sometimes(rng.uniform(0.0, max_b)),
            "c": float(rng.choice([1.0, -1.0, rng.uniform(-1.0, 1.0)])),
            "b_s0": sometimes(rng.uniform(0.0, 4.0)), "h_s": 10 ** rng.uniform(-3.0, 0.0),
            "b_c0": sometimes(rng.uniform(0.0, 1.0)), "h_c": 10 ** rng.uniform(-3.0, 0.0),
            "theta_deg": sometimes(rng.uniform(0.1, 60.0)), "phi": sometimes(rng.uniform(0.0, 0.74)),
            "h_function": str(rng.choice(["1981", "2002"])),
            "multiple_scattering": str(rng.choice(["isotropic", "anisotropic"]))}
