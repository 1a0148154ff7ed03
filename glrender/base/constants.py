"""Constants of nature and of the calendar, once. `python -m glrender.shaders` writes those that GLSL needs."""

from __future__ import annotations

import math

PI = math.pi
AU_M = 149_597_870_700.0
"""Astronomical unit [m]; IAU 2012 resolution B2."""
SPEED_OF_LIGHT_M_S = 299_792_458.0
"""Speed of light [m/s]; SI."""
PLANCK_J_S = 6.626_070_15e-34
"""Planck constant [J s]; SI."""
TOTAL_SOLAR_IRRADIANCE_W_M2 = 1360.8
"""Total solar irradiance at 1 au [W/m2]; Kopp and Lean (2011), TSIS-1."""
SUN_RADIUS_M = 695_700_000.0
"""Nominal solar radius [m]; IAU 2015 resolution B3."""
GM_SUN_M3_S2 = 1.327_124_400_412_794_2e20
"""Gravitational parameter of the Sun [m3/s2], TDB; Park et al. (2021), DE440."""
OBLIQUITY_J2000_RAD = math.radians(84_381.448 / 3600.0)
"""Obliquity of the ecliptic of J2000 to the equator of ICRF [rad]; IAU 1976, as SPICE's ECLIPJ2000 has it."""
FIRST_YEAR, LAST_YEAR = 1583, 9998
"""Calendar years of dates: Gregorian all through the first, and a year from the last that a date can be of."""

GLSL_CONSTANTS = {"PI": PI}
"""Constants that `constants.glsl` holds, by name."""
