"""A small pass for all tests of this room: ten frames about a body whose relief is of its facets."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from arcs import N_FRAMES, STEP_DEG, scene, state
from glrender import generate
from glrender.sequences.sequence import FrameOptions, FrameSequence


@pytest.fixture(scope="session")
def flown(tmp_path_factory):
    """The folder of a sequence, its true shape, its scene and states, and a function that draws others."""
    rough = generate.gaussian_random_sphere(radius_m=280.0, sigma=0.1, seed=4, subdivisions=4)
    shape = generate.subdivide_with_relief(rough, levels=2, relief=0.08, seed=2)

    def drawn(states, form="npz", products=("range",)):
        folder = tmp_path_factory.mktemp("sequence")
        options = FrameOptions(camera="navcam", output="dn", format=form, products=list(products))
        list(FrameSequence(scene=scene(shape), states=states, folder=folder, options=options).draw(1))
        return folder

    states = [state(STEP_DEG * k) for k in range(N_FRAMES)]
    return SimpleNamespace(folder=drawn(states), shape=shape, states=states, drawn=drawn)
