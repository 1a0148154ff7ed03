// Written by `python -m glrender.shaders` from glrender/base/constants.py; a test compares them.
const float PI = 3.141592653589793;
