"""Files of the cookbook's scenarios: one slow pass of Itokawa as CSV, OEM with AEM, and SPICE's SPK and CK.

    python tests/support/make_cookbook.py server/glrender_cli/cookbook

The pass is made up; the Sun from Itokawa is that of AMICA's image ST_2458542208 (USGS ALE).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from glrender import frames

DURATION_S, N_ROWS, TURN_RAD = 3600.0, 13, np.radians(60.0)
NEAR_M, FAR_M, NORTH_M = 7000.0, 9000.0, 900.0
START_UTC, START_ET_S = "2005-10-13T01:00:00", 182437264.182358
"""By naif0012.tls: 32 leap seconds, 32.184 s and the periodic term."""
SUN_KM = np.array([154700502.11551195, 5443988.583930893, -2054766.29920961])
SUN_KM_S = np.array([-6.6574479060899465, 28.813387859292327, 13.032393923917786])
SUN_ET_S = 182502855.87767982
GM_SUN_KM3_S2 = 132712440041.94
"""DE440."""
HAYABUSA, ITOKAWA, SUN, BUS, TICKS_S = -130, 2025143, 10, -130000, 1000
META = "OBJECT_NAME = HAYABUSA\nOBJECT_ID = 2003-019A\nCENTER_NAME = ITOKAWA\n"
CLOCK = f"""KPL/SCLK
A clock of {TICKS_S} ticks a second from the start of this pass; made up.
\\begindata
SCLK_KERNEL_ID = ( @2026-11-28 )
SCLK_DATA_TYPE_130 = ( 1 )
SCLK01_TIME_SYSTEM_130 = ( 1 )
SCLK01_N_FIELDS_130 = ( 2 )
SCLK01_MODULI_130 = ( 1000000 {TICKS_S} )
SCLK01_OFFSETS_130 = ( 0 0 )
SCLK01_OUTPUT_DELIM_130 = ( 2 )
SCLK_PARTITION_START_130 = ( 0.0 )
SCLK_PARTITION_END_130 = ( 1.0E9 )
SCLK01_COEFFICIENTS_130 = ( 0.0 {START_ET_S} 1.0 )
\\begintext
"""


def path(t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [m] and velocities [m/s] (N, 3) of the pass, from Itokawa, J2000."""
    share, rate = t_s / DURATION_S, 1.0 / DURATION_S
    angle, radius = TURN_RAD * (share - 1.0), FAR_M + (NEAR_M - FAR_M) * share
    out = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    aside, up = np.stack([-out[:, 1], out[:, 0], 0.0 * angle], axis=1), np.array([0.0, 0.0, 1.0])
    return (radius[:, None] * out + NORTH_M * share[:, None] * up,
            (NEAR_M - FAR_M) * rate * out + (radius * TURN_RAD * rate)[:, None] * aside + NORTH_M * rate * up)


def attitudes(r_m: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) of a camera that looks at Itokawa, without a change of sign."""
    found = np.array([frames.look_at(place, np.zeros(3)) for place in r_m])
    return found * np.cumprod(np.concatenate([[1.0], np.sign(np.sum(found[1:] * found[:-1], axis=1))]))[:, None]


def main(folder: Path) -> None:
    """Write all files but those of others."""
    t_s = np.linspace(0.0, DURATION_S, N_ROWS)
    r_m, v_m_s = path(t_s)
    q = attitudes(r_m)
    table = ["t_s,r_x_m,r_y_m,r_z_m,q_w,q_x,q_y,q_z"]
    table += [",".join([f"{t:g}", *(f"{x:.3f}" for x in r), *(f"{x:.9f}" for x in turned)])
              for t, r, turned in zip(t_s, r_m, q, strict=True)]
    (folder / "states.csv").write_text("\n".join(table) + "\n")
    dates = [f"2005-10-13T{1 + int(t // 3600):02d}:{int(t % 3600 // 60):02d}:00.000" for t in t_s]
    span = f"TIME_SYSTEM = UTC\nSTART_TIME = {dates[0]}\nSTOP_TIME = {dates[-1]}\n"
    head = "_VERS = 2.0\nCREATION_DATE = 2026-11-28T00:00:00\nORIGINATOR = EXAMPLE\nMETA_START\n" + META
    rows = [f"{date} {' '.join(f'{x / 1e3:.9f}' for x in r)} {' '.join(f'{x / 1e3:.12f}' for x in v)}"
            for date, r, v in zip(dates, r_m, v_m_s, strict=True)]
    (folder / "hayabusa.oem").write_text("\n".join([f"CCSDS_OEM{head}REF_FRAME = ICRF\n{span}META_STOP", *rows, ""]))
    # CCSDS' quaternion turns frame A's axes onto B's: the conjugate of the one that turns components.
    rows = [f"{date} {' '.join(f'{x:.9f}' for x in (*-turned[1:], turned[0]))}" for date, turned in zip(
        dates, q, strict=True)]
    (folder / "hayabusa.aem").write_text("\n".join([
        f"CCSDS_AEM{head.replace('2.0', '1.0')}REF_FRAME_A = ICRF\nREF_FRAME_B = SC_BODY_1\nATTITUDE_DIR = A2B\n{span}"
        "ATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = LAST\nMETA_STOP\nDATA_START", *rows, "DATA_STOP", ""]))
    write_kernels(folder, t_s, np.hstack([r_m, v_m_s]) / 1e3, q)


def write_kernels(folder: Path, t_s: np.ndarray, states_km: np.ndarray, q: np.ndarray) -> None:
    """SPK of Itokawa and Hayabusa, CK of Hayabusa's bus, and its clock; `amica31.ti` has the frames."""
    import spiceypy

    (folder / "hayabusa.tsc").write_text(CLOCK)
    for name in ("hayabusa.bsp", "hayabusa.bc"):
        (folder / name).unlink(missing_ok=True)
    et_s = START_ET_S + t_s
    handle = spiceypy.spkopn(str(folder / "hayabusa.bsp"), "cookbook", 0)
    spiceypy.spkw05(handle, ITOKAWA, SUN, "J2000", et_s[0], et_s[-1], "ITOKAWA", GM_SUN_KM3_S2, 1,
                    [np.concatenate([-SUN_KM, -SUN_KM_S])], [SUN_ET_S])
    spiceypy.spkw13(handle, HAYABUSA, ITOKAWA, "J2000", et_s[0], et_s[-1], "HAYABUSA", 7, N_ROWS, states_km, et_s)
    spiceypy.spkcls(handle)
    for name in ("naif0012.tls", "amica31.ti", "hayabusa.tsc"):
        spiceypy.furnsh(str(folder / name))
    bus_from_amica = spiceypy.pxform("HAYABUSA_AMICA", "HAYABUSA_SC_BUS_PRIME", et_s[0])
    turned = np.array([spiceypy.m2q(bus_from_amica @ frames.dcm(each)) for each in q])
    ticks = TICKS_S * t_s
    handle = spiceypy.ckopn(str(folder / "hayabusa.bc"), "cookbook", 0)
    spiceypy.ckw03(handle, ticks[0], ticks[-1], BUS, "J2000", False, "HAYABUSA", N_ROWS, ticks, turned,
                   np.zeros((N_ROWS, 3)), 1, ticks[:1])
    spiceypy.ckcls(handle)
    spiceypy.kclear()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
