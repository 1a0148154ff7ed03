"""The example of a plug-in, and a scene that its law can be asked in."""

from __future__ import annotations

from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "plugin_law"
SCENE = {"bodies": [{"name": "body", "generated": {"kind": "icosphere", "radius_m": 100.0},
                     "brdf": {"law": "lambert", "normal_albedo": 0.4}}],
         "cameras": [{"name": "navcam", "width_px": 64, "height_px": 64, "focal_length_px": 5000.0}]}
GOOD = (EXAMPLE / "glrender_dusty_lambert.py").read_text()
