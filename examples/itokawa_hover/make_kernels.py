"""SPICE kernels of a hover at Itokawa, and the scenario beside them: make_kernels.py FOLDER

Hayabusa's own SPK is not small enough for this repository. These two bodies' motions start with the states of AMICA's
image ST_2458542208, 2005 October 13, as USGS' ALE has them of the mission's kernels; the arc after is made up.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import spiceypy
from scipy.spatial.transform import Rotation

ET_S = 182502855.87767982
"""Epoch of the image, TDB seconds past J2000 (USGS ALE, hayabusa_amica_st2458542208_isd.json)."""
SUN_KM = np.array([154700502.11551195, 5443988.583930893, -2054766.29920961])
SUN_KM_S = np.array([-6.6574479060899465, 28.813387859292327, 13.032393923917786])
"""The Sun from Itokawa, J2000; the same file."""
HAYABUSA_KM = np.array([8.86672985554185, 0.2413099824695155, 0.0807100049795115])
"""Hayabusa from Itokawa, J2000; the same file."""
GM_SUN_KM3_S2 = 132712440041.94
"""DE440."""
ITOKAWA, HAYABUSA, SUN = 2025143, -130, 10
TURN_S, ARC_DEG, N_RECORDS = 12.132 * 3600.0, 55.0, 49
PCK = """KPL/PCK
Poles and rotation of R. W. Gaskell, itokawa_gaskell_n3.tpc (NAIF, HAY-A-SPICE-6-V1.0).
\\begindata
BODY2025143_POLE_RA = ( 90.02564 0.0 0.0 )
BODY2025143_POLE_DEC = ( -67.02704 0.0 0.0 )
BODY2025143_PM = ( 129.73 712.14376110 0.0 )
BODY2025143_RADII = ( 0.274 0.156 0.138 )
FRAME_ITOKAWA_FIXED = 2025143
FRAME_2025143_NAME = 'ITOKAWA_FIXED'
FRAME_2025143_CLASS = 2
FRAME_2025143_CLASS_ID = 2025143
FRAME_2025143_CENTER = 2025143
NAIF_BODY_NAME = ( 'ITOKAWA', 'HAYABUSA' )
NAIF_BODY_CODE = ( 2025143, -130 )
\\begintext
"""


def hayabusa(epochs_s: np.ndarray) -> np.ndarray:
    """States (N, 6) [km, km/s] from Itokawa: from the image's place to a phase of 56 degrees in one turn."""
    axis = np.cross(HAYABUSA_KM, np.cross(HAYABUSA_KM, SUN_KM))
    axis = np.cross(HAYABUSA_KM, axis / np.linalg.norm(axis))
    axis /= np.linalg.norm(axis)
    # Rate 0 at both ends.
    share = (epochs_s - ET_S) / TURN_S
    angle = np.radians(ARC_DEG) * share**2 * (3.0 - 2.0 * share)
    rate = np.radians(ARC_DEG) * 6.0 * share * (1.0 - share) / TURN_S
    r = Rotation.from_rotvec(angle[:, None] * axis).apply(HAYABUSA_KM)
    return np.hstack([r, rate[:, None] * np.cross(axis, r)])


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "itokawa.tpc").write_text(PCK, encoding="ascii")
    (folder / "itokawa.bsp").unlink(missing_ok=True)
    epochs_s = np.linspace(ET_S, ET_S + TURN_S, N_RECORDS)
    handle = spiceypy.spkopn(str(folder / "itokawa.bsp"), "Itokawa hover", 0)
    state = np.concatenate([-SUN_KM, -SUN_KM_S])
    spiceypy.spkw05(handle, ITOKAWA, SUN, "J2000", epochs_s[0], epochs_s[-1], "ITOKAWA", GM_SUN_KM3_S2, 1, [state],
                    [ET_S])
    spiceypy.spkw13(handle, HAYABUSA, ITOKAWA, "J2000", epochs_s[0], epochs_s[-1], "HAYABUSA", 7, N_RECORDS,
                    hayabusa(epochs_s), epochs_s)
    spiceypy.spkcls(handle)
    shutil.copy(Path(__file__).parent / "hover.toml", folder)
    sys.stdout.write(f"{folder / 'hover.toml'}\n")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
