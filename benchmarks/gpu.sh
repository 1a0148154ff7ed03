#!/bin/sh
# Measures a machine with an NVIDIA card and EGL, in under 8 minutes: the tests that touch OpenGL, frames a second by
# shape and image size. Writes out/gpu/, images too: gpu.py says how to compare them. GLRENDER_PYTHON names a Python
# that has glrender's packages (default: .venv/bin/python).
set -eu
cd "$(dirname "$0")/.."
python=${GLRENDER_PYTHON:-.venv/bin/python}
export PYTHONPATH="$PWD:$PWD/camera_model:$PWD/server:$PWD/clients/python${PYTHONPATH:+:$PYTHONPATH}"
"$python" -c 'import moderngl, numba, embreex' || {
    echo "gpu.sh needs glrender's packages: make setup, or GLRENDER_PYTHON=/path/to/python" >&2
    exit 1
}
timeout 200 "$python" -m pytest -q tests/engines/raster/test_context.py tests/shaders/test_shaders.py tests/brdf/test_brdf_twins.py \
    tests/engines/raster/test_renderer_geometry.py tests/engines/raster/test_renderer_photometry.py || echo "tests failed on this card (above)" >&2
timeout 260 "$python" benchmarks/gpu.py --out out/gpu/figures.json
