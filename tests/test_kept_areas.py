"""Sunlit areas of large shapes that are kept: as exact as anew, and the same bytes whatever came before."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, Pose, Renderer, Shape, frames, generate, kept_nodes, level_tables
from glrender.area_engine import AreaEngine
from glrender.brdf import Hapke, Lambert
from glrender.costs import EngineCosts
from glrender.grouping import region
from glrender.ray_engine import RayEngine
from glrender.view import view_bodies

GREY = Lambert(normal_albedo=0.3)
ROUGH_LAW = Hapke(single_scattering_albedo=0.1, b=0.3, c=0.5, shoe_amplitude=1.0, shoe_width=0.05, roughness_deg=20.0)


class Drawn:
    """A rough body of 82,000 facets as a large one: its frames by areas, and how often they were cut."""

    def __init__(self, monkeypatch, law=GREY, bodies=(), **scene):
        monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10_000)
        # Nothing is looked for in spare time: it is counted.
        monkeypatch.setattr(kept_nodes, "_MOST_AHEAD", 0)
        self.camera = views.camera(128, 500.0)
        self.scene = views.scene([replace(views.rough_body(GREY), brdf=law), *bodies], [self.camera], **scene)
        self.rays = RayEngine(self.scene)
        self.kept, self.anew = (AreaEngine(self.scene, self.rays, keeps_areas=keeps) for keeps in (True, False))
        self.n_cut, cut = 0, AreaEngine._cut

        def counted(*given):
            self.n_cut += 1
            return cut(*given)

        monkeypatch.setattr(AreaEngine, "_cut", counted)

    def __call__(self, phase_deg, budget=0.02, areas=None, state=None, **given):
        state = state or views.state(phase_deg=phase_deg, range_m=1000.0, **given)
        seen = view_bodies(state, self.camera, self.scene.hulls)
        x0, y0, x1, y1 = region(seen[:1], self.camera)
        return (areas or self.kept).draw(("body",), self.camera, seen, (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                                         (x1 - x0, y1 - y0), budget)


def test_what_is_kept_serves_frames_nearby_and_none_depends_on_those_before(monkeypatch):
    drawn = Drawn(monkeypatch, sun_disc=False)
    first, _ = drawn(50.0)
    assert drawn.n_cut == 1
    near, _ = drawn(50.0005)
    assert drawn.n_cut == 1 and near.tobytes() != first.tobytes(), "the same areas, in another light"
    apart, _ = drawn(50.1)
    assert drawn.n_cut == 2 and apart.tobytes() != near.tobytes()
    assert drawn(50.0)[0].tobytes() == first.tobytes() and drawn.n_cut == 2
    drawn.kept.forget()
    assert drawn(50.0005)[0].tobytes() == near.tobytes() and drawn(50.0)[0].tobytes() == first.tobytes()
    assert drawn.n_cut == 3


def test_whichever_way_the_camera_looks_the_same_is_kept(monkeypatch):
    """Attitude, and where in the frame the body is: the flux of small angles off the boresight is the same to 1e-3."""
    drawn = Drawn(monkeypatch, sun_disc=False)
    straight = views.state(phase_deg=60.0, range_m=1000.0)
    place_m = straight.spacecraft.r_inertial_m
    images = []
    for aside_m in (0.0, 3.0, -5.0):
        turned = Pose(r_inertial_m=place_m, q_from_inertial=frames.look_at(place_m, np.array([0.0, aside_m, aside_m])))
        image, told = drawn(60.0, state=replace(straight, spacecraft=turned))
        anew, _ = drawn(60.0, state=replace(straight, spacecraft=turned), areas=drawn.anew)
        assert told <= 0.02 and views.relative_rms(image, anew) < 0.01
        images.append(image)
    assert drawn.n_cut == 1 + 3, "once, and once for each that was drawn anew"
    assert images[1].sum() == pytest.approx(images[0].sum(), rel=1e-3)
    assert images[2].sum() == pytest.approx(images[0].sum(), rel=1e-3)


def test_no_byte_depends_on_the_camera_that_came_first(monkeypatch):
    """A symmetric shape, in which rounding chooses what is divided: cameras of other principal points, and margins."""
    ball = generate.icosphere(radius_m=1.0, subdivisions=5)
    x, y, z = ball.vertices_m.T
    height_m = 100.0 * (1.0 + 0.25 * np.cos(6.0 * x) * np.cos(6.0 * y) * np.cos(5.0 * z))
    body = Body(name="body", shape=Shape.from_arrays(ball.vertices_m * height_m[:, None], ball.facets), brdf=GREY)
    monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10_000)
    state = views.state(phase_deg=70.0, range_m=1000.0, direction=(0.0, 0.0, 1.0))
    cameras = [views.camera(160, 400.0), views.camera(160, 400.0, principal_point_px=(81.3, 77.1)),
               views.camera(160, 400.0).with_margin(8)]
    with Renderer(views.scene([body], cameras[:1], sun_disc=False)) as renderer:
        monkeypatch.setattr(renderer, "_costs", EngineCosts(facet_ns=1e4, sample_ns=1e4, ray_ns=1e4, lone_ray_ns=1e4,
                                                            area_ns=1.0))
        images = set()
        for first in cameras:
            renderer.forget_shadow_maps()
            renderer.render(state, first, max_error=0.01)
            image = renderer.render(state, cameras[0], max_error=0.01)
            assert image.plan.windows[0].engine == "areas" and not image.plan.windows[0].levels[0].by_middles
            images.add((image.irradiance_W_m2.tobytes(), image.plan.predicted_error))
    assert len(images) == 1


def test_far_off_the_boresight_nothing_is_kept(monkeypatch):
    """Areas are larger there than where the node's camera has them."""
    drawn = Drawn(monkeypatch, sun_disc=False)
    drawn.camera = views.camera(256, 100.0)
    straight = views.state(phase_deg=60.0, range_m=1000.0)
    place_m = straight.spacecraft.r_inertial_m
    across = np.cross(place_m, [0.0, 0.0, 1.0])
    across *= 1000.0 / np.linalg.norm(across)
    for tangent, is_kept in ((0.2, True), (0.5, False)):
        turned = Pose(r_inertial_m=place_m, q_from_inertial=frames.look_at(place_m, tangent * across))
        n_cut = drawn.n_cut
        for _ in range(2):
            drawn(60.0, state=replace(straight, spacecraft=turned))
        assert drawn.n_cut - n_cut == (1 if is_kept else 2), tangent


@pytest.mark.parametrize(("law", "has_disc"), [(GREY, False), (ROUGH_LAW, False), (GREY, True)],
                         ids=["grey", "Hapke", "disc"])
@pytest.mark.parametrize("budget", [0.05, 0.01])
def test_errors_are_within_what_is_told(monkeypatch, law, has_disc, budget):
    """Between nodes, beside areas that are cut finely for each frame."""
    drawn = Drawn(monkeypatch, law, sun_disc=has_disc)
    for phase_deg in (20.0041, 50.0043, 89.9963, 115.0037, 135.0041):
        image, told = drawn(phase_deg, budget)
        truth, finely = drawn(phase_deg, 0.25 * budget, areas=drawn.anew)
        if math.isinf(told) or math.isinf(finely):
            assert has_disc and phase_deg > 80.0, "penumbras are left to rays"
            continue
        assert told <= budget and views.relative_rms(image, truth) < told, phase_deg
        assert image.sum() == pytest.approx(truth.sum(), rel=0.1 * budget), phase_deg


def test_the_node_s_own_error_is_told(monkeypatch):
    """The farthest from a node that may be, with areas cut finely: 0.1 % of the light moves."""
    drawn = Drawn(monkeypatch, sun_disc=False)
    worst = 0.0
    for phase_deg in np.linspace(100.0, 100.02, 9):
        image, told = drawn(phase_deg, 0.005)
        anew, _ = drawn(phase_deg, 0.005, areas=drawn.anew)
        assert told > 1.2e-3
        worst = max(worst, views.relative_rms(image, anew))
    assert 1e-4 < worst < 5e-3


def test_budgets_that_are_nearly_the_same_share_what_is_kept(monkeypatch):
    """As the planner's own move a little from frame to frame."""
    drawn = Drawn(monkeypatch, sun_disc=False)
    one, other = drawn(60.0, 0.0197), drawn(60.0, 0.0196)
    assert drawn.n_cut == 1 and one[0].tobytes() == other[0].tobytes()
    _, told = drawn(60.0, 0.01)
    assert drawn.n_cut == 2 and told <= 0.01


def test_the_suns_distance_and_a_flux_ratio_are_those_of_the_frame(monkeypatch):
    drawn = Drawn(monkeypatch, sun_disc=False)
    near = views.state(phase_deg=60.0, range_m=1000.0)
    image, _ = drawn(60.0, state=near)
    farther, _ = drawn(60.0, state=replace(near, r_sun_inertial_m=1.0001 * near.r_sun_inertial_m))
    assert drawn.n_cut == 1 and farther.sum() == pytest.approx(image.sum() / 1.0001**2, rel=1e-7)


def test_what_cannot_be_kept_is_drawn_as_ever(monkeypatch):
    """Surges, another body, a body that the frame cuts off, tight budgets, and close to it."""
    drawn = Drawn(monkeypatch, sun_disc=False)
    for given in ({"phase_deg": 5.0}, {"phase_deg": 150.0}, {"phase_deg": 60.0, "budget": 0.003},
                  {"phase_deg": 60.0, "target": (0.0, 60.0, 0.0)}):
        image, _ = drawn(**given)
        assert image.tobytes() == drawn(**given, areas=drawn.anew)[0].tobytes(), given
    drawn.camera = views.camera(128, 60.0)
    for radii, is_kept in ((2.9, False), (3.1, True)):
        state = views.state(phase_deg=60.0, range_m=radii * drawn.rays.solid("body").radius_m)
        n_cut = drawn.n_cut
        images = [drawn(60.0, state=state)[0].tobytes() for _ in range(2)]
        assert images[0] == images[1] and drawn.n_cut - n_cut == (1 if is_kept else 2), radii
    moon = Drawn(monkeypatch, bodies=[views.sphere(GREY, subdivisions=2, radius_m=5.0, name="moon")], sun_disc=False)
    state = views.state(phase_deg=60.0, range_m=1000.0, bodies=("body", "moon"))
    state = replace(state, bodies=state.bodies | {"moon": Pose(r_inertial_m=np.array([0.0, 0.0, 400.0]))})
    assert moon(60.0, state=state)[0].tobytes() == moon(60.0, state=state, areas=moon.anew)[0].tobytes()


def test_what_is_kept_has_an_end(monkeypatch):
    """In bytes, and in number where nothing is found: penumbras that are too wide."""
    drawn = Drawn(monkeypatch)
    near = views.state(phase_deg=110.0, range_m=1000.0, sun_distance_au=0.05)
    for k in range(70):
        _, told = drawn(0.0, 0.004, state=replace(near, r_sun_inertial_m=near.r_sun_inertial_m + 1e6 * k))
    assert math.isinf(told) and len(drawn.kept._kept_cuts) == 64 and drawn.kept._kept_cuts.n_bytes == 0
    assert not math.isinf(drawn(60.0, 0.05)[1])
    monkeypatch.setattr(kept_nodes, "_MOST_BYTES", drawn.kept._kept_cuts.n_bytes)
    drawn(62.0, 0.05)
    assert len(drawn.kept._kept_cuts) == 1
