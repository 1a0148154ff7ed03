"""Views and traits of bodies for the planner's tests; without GL."""

from __future__ import annotations

import numpy as np
import views
from glrender.planner import body_plan
from glrender.planner.error_budget import Budget
from glrender.planner.error_model import BodyTraits
from glrender.planner.frame_plan import plan_frame
from glrender.planner.penumbra import Penumbra
from glrender.planner.request import WHOLE_IMAGE, Request
from glrender.planner.seen import Seen
from glrender.view.view import BodyView


def view(name="body", size_px=200.0, phase_deg=60.0, bounds_px=None, depth_m=(900.0, 1100.0), is_visible=True):
    """A body's view, as large as it is asked for; of infinite size it reaches beside the camera."""
    if bounds_px is None and np.isfinite(size_px):
        bounds_px = np.array([100.0, 80.0, 100.0 + size_px, 80.0 + 0.8 * size_px])
    return BodyView(name=name, camera_from_body=np.eye(3), r_camera_body_m=np.array([0.0, 0.0, -1000.0]),
                    sun_direction_body=np.array([0.0, 0.0, -1.0]), sun_distance_au=1.0, range_m=1000.0,
                    phase_rad=np.radians(phase_deg), depth_m=depth_m, bounds_px=bounds_px, is_visible=is_visible,
                    is_whole=bool(np.isfinite(size_px)))


CAMERA = views.camera(1024, 1000.0)


def traits(n_facets=50_000, crease_rad=0.15, facet_m=0.3, **known):
    """Traits of a body of 100 m with flat facets; `facet_m` is infinite for facets that are not uniform."""
    return BodyTraits(**{"radius_m": 100.0, "is_convex": False, "law": "lambert", "max_phase_rad": np.pi,
                         "n_facets": n_facets, "crease_rad": crease_rad, "facet_m": facet_m, **known})


def seen(member, known=None, casters=(), detail_layers=0, penumbra=None):
    """A body with traits of its own, or those of `traits()`."""
    return Seen(view=member, traits=known or traits(), casters=casters, detail_layers=detail_layers,
                penumbra=penumbra or Penumbra())


def body(member, known=None, tolerance=0.02, casters=(), **penumbra):
    return body_plan.plan_body(seen(member, known, casters, penumbra=Penumbra(**penumbra)), CAMERA,
                               Budget(tolerance=tolerance))


def ways(bodies, tolerance=0.02, use=WHOLE_IMAGE, **request):
    """The ways to draw each region of seen bodies, in order."""
    return plan_frame(bodies, Request(camera=CAMERA, max_error=tolerance, use=use, **request)).options
