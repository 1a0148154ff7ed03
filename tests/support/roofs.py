"""A slab under a square roof, with the Sun overhead and a camera aside, and its corners as rays show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import solids
import views
from glrender import Body, Pose, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.coverage.corner_visibility import look
from glrender.engines.coverage.facet_tables import FacetTables
from glrender.engines.coverage.image_cells import ImageCells
from glrender.engines.rays.engine import RayEngine
from glrender.view.view import view_bodies
from scipy.spatial.transform import Rotation

LAW = Lambert(normal_albedo=0.3)
HALF_M, ROOF_M, RANGE_M, EMISSION = 150.0, 20.0, 1e6, np.arctan(0.3)


def seen_of(bodies, state, camera, sun_radius_rad=0.0):
    """The first body's corners as rays show them, with the views and rays of the scene."""
    scene = views.scene(bodies, [camera], sun_disc=False)
    rays, seen = RayEngine(scene), view_bodies(state, camera, scene.hulls)
    cells = ImageCells(camera, camera.bounds_px, (camera.width_px, camera.height_px))
    tables = FacetTables(bodies[0], rays.solid(bodies[0].name))
    return look(tables, seen[0], seen, cells, rays, sun_radius_rad), seen, rays, cells


def below_a_roof(levels, height_m, turn_deg, px_m=1.0):
    """A slab of 300 m under a square roof of 40 m, turned about the vertical, with the Sun overhead.

    A camera aside sees the roof's shadow, and elsewhere loses as much of the slab behind the roof.
    """
    slab = generate.subdivide_with_relief(solids.slab(HALF_M), levels=levels, relief=0.0, seed=1)
    ground = Body(name="ground", shape=slab, brdf=LAW)
    roof = Body(name="roof", shape=solids.slab(ROOF_M, 0.01), brdf=LAW)
    state = views.state(direction=(np.sin(EMISSION), 0.0, np.cos(EMISSION)), range_m=RANGE_M,
                        bodies=("ground", "roof"))
    turn = Rotation.from_euler("z", turn_deg, degrees=True).as_quat(scalar_first=True)
    state = replace(state, r_sun_inertial_m=AU_M * np.array([0.0, 0.0, 1.0]), bodies={
        **state.bodies, "roof": Pose(r_inertial_m=[0.0, 0.0, height_m], q_from_inertial=turn)})
    return [ground, roof], state, views.camera(400, RANGE_M / px_m)
