"""Draw the figures of docs/photometry.md with the float64 laws: `python docs/img/photometry_figures.py`."""

from __future__ import annotations

import warnings
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from glrender.brdf import Akimov, Hapke, Lambert, LommelSeeliger, LunarLambert, Minnaert, OrenNayar, Rolo
from glrender.brdf.integrals import disc_albedo

HERE = Path(__file__).parent
EROS = {"single_scattering_albedo": 0.33, "b": 0.25, "c": 1.0}
LAWS = {
    "Lambert": Lambert(normal_albedo=0.2),
    "Oren-Nayar, 30°": OrenNayar(normal_albedo=0.2, roughness_deg=30.0),
    "Lommel-Seeliger": LommelSeeliger(single_scattering_albedo=0.8),
    "Lunar-Lambert, McEwen": LunarLambert(normal_albedo=0.2),
    "Minnaert, k = 0.6": Minnaert(normal_albedo=0.2, exponent=0.6),
    "Akimov": Akimov(normal_albedo=0.2),
    "ROLO": Rolo(surge=(0.12, 0.3), coefficients=(0.28, -3.4e-3, 1.5e-5, -2.2e-8)),
    "Hapke, smooth": Hapke(**EROS),
    "Hapke, Eros": Hapke(**EROS, shoe_amplitude=1.4, shoe_width=0.01, roughness_deg=28.0),
}
PHASES_DEG = (0, 30, 60, 90, 120)
PIXELS = 220


def sphere_radf(law, phase):
    """I/F of a sphere from afar, Sun to the right; NaN beside it."""
    x = (np.arange(PIXELS) + 0.5) / PIXELS * 2.1 - 1.05
    x, y = np.meshgrid(x, -x)
    z2 = 1.0 - x**2 - y**2
    normal = np.stack([x, y, np.sqrt(np.maximum(z2, 0.0))], axis=-1)
    to_sun = np.array([np.sin(phase), 0.0, np.cos(phase)])
    radf = np.pi * law.brdf(to_sun, np.array([0.0, 0.0, 1.0]), normal) * np.maximum(normal @ to_sun, 0.0)
    return np.where(z2 > 0.0, radf, np.nan)


def draw_spheres():
    figure, axes = plt.subplots(len(LAWS), len(PHASES_DEG), figsize=(9.0, 15.6), facecolor="black")
    for axis, phase_deg in zip(axes[0], PHASES_DEG, strict=True):
        axis.set_title(f"{phase_deg}°", color="white", fontsize=12, pad=18)
    for row, (name, law) in zip(axes, LAWS.items(), strict=True):
        for axis, phase_deg in zip(row, PHASES_DEG, strict=True):
            image = sphere_radf(law, np.radians(phase_deg))
            axis.imshow(np.nan_to_num(image), cmap="gray", vmin=0.0, vmax=np.nanpercentile(image, 99.5))
            axis.set_axis_off()
        row[0].text(0.02, 1.02, name, color="white", fontsize=11, transform=row[0].transAxes)
    figure.tight_layout(pad=0.6, h_pad=1.4)
    figure.savefig(HERE / "photometry_spheres.png", dpi=80, facecolor="black")


def draw_curves():
    phase_deg = np.concatenate([[0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 3.0], np.arange(5.0, 171.0, 2.5)])
    figure, (curve, profile) = plt.subplots(1, 2, figsize=(12.0, 5.0))
    styles = ["-", "--", "-.", ":"]
    for k, (name, law) in enumerate(LAWS.items()):
        value = np.array([disc_albedo(law, np.radians(g), 64) for g in phase_deg])
        style = {"color": f"C{k}", "linestyle": styles[k % 4]}
        curve.semilogy(phase_deg, value / value[0], label=name, **style)
        radf = sphere_radf(law, np.radians(60.0))[PIXELS // 2]
        x = (np.arange(PIXELS) + 0.5) / PIXELS * 2.1 - 1.05
        profile.plot(x, radf / np.nanmax(radf[np.abs(x) < 0.98]), label=name, **style)
    curve.set(xlabel="phase angle [deg]", ylabel="flux of a sphere over its value at 0°", ylim=(1e-4, 1.2),
              xlim=(0, 170))
    curve.legend(fontsize=8)
    profile.set(xlabel="place on the equator towards the Sun [radii]", ylabel="radiance over its greatest",
                title="phase 60°", xlim=(-1, 1), ylim=(0, 1.15))
    for axis in (curve, profile):
        axis.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(HERE / "photometry_curves.png", dpi=80)


if __name__ == "__main__":
    with warnings.catch_warnings():
        # McEwen's cubic is drawn beyond the phase where it is held.
        warnings.simplefilter("ignore", UserWarning)
        draw_spheres()
        draw_curves()
