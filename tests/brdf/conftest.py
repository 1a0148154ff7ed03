"""Laws at angles, by Python and by the shader."""

from __future__ import annotations

import numpy as np
import photometry_truth as truth
import pytest
from glrender.engines.raster.gl.context import Context
from glrender.engines.raster.gl.evaluate import BrdfEvaluator


@pytest.fixture(scope="module")
def evaluate():
    """The shader, on arrays."""
    with Context("auto") as context:
        yield BrdfEvaluator(context)


@pytest.fixture(params=["twin", "shader"])
def brdf(request, evaluate):
    """The law at angles [deg]: float64 and, in float32, the GLSL."""
    def value(law, i, e, psi=0.0):
        s, v, n = truth.vectors(np.radians(i), np.radians(e), np.radians(psi))
        return law.brdf(s, v, n) if request.param == "twin" else evaluate(law, s, v, n).astype(np.float64)

    value.rtol = 1e-12 if request.param == "twin" else 1e-5
    return value
