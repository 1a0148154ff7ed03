"""`python -m glrender.shaders`: write constants.glsl."""

from pathlib import Path

from .compose import constants_glsl

Path(__file__).with_name("constants.glsl").write_text(constants_glsl(), encoding="utf-8")
