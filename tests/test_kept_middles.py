"""What is kept of large shapes from frame to frame: the same bytes whatever came before, and errors within bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, generate, kept_middles, kept_nodes, level_tables
from glrender.area_engine import AreaEngine
from glrender.brdf import Hapke, Lambert
from glrender.coverage import add_lit, add_seen, add_small, no_changes
from glrender.facet_relief import LevelShape
from glrender.facet_tables import FacetTables
from glrender.grouping import region
from glrender.lod import levels_of_detail
from glrender.middle_horizons import Middles
from glrender.ray_engine import RayEngine
from glrender.render_plan import LevelPlan
from glrender.view import view_bodies
from scipy.spatial.transform import Rotation
from test_spinning import spun_s

GREY = Lambert(normal_albedo=0.3)
SURGE = Hapke(single_scattering_albedo=0.1, b=0.3, c=0.5, shoe_amplitude=1.0, shoe_width=0.05, roughness_deg=20.0)


class Drawn:
    """A rough body of 82,000 facets as a large one: its frames by middles, and how often they were looked at anew."""

    def __init__(self, monkeypatch, law=GREY):
        monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10_000)
        # Nothing is looked for in spare time: it is counted.
        monkeypatch.setattr(kept_nodes, "_MOST_AHEAD", 0)
        self.n_anew, look = 0, kept_middles._radiance

        def counted(*given):
            self.n_anew += 1
            return look(*given)

        monkeypatch.setattr(kept_middles, "_radiance", counted)
        self.camera = views.camera(128, 500.0)
        self.scene = views.scene([replace(views.rough_body(GREY), brdf=law)], [self.camera], sun_disc=False)
        self.rays = RayEngine(self.scene)
        body, = self.scene.bodies
        self.areas = AreaEngine(self.scene, self.rays, {"body": ()})
        # Without levels of detail there are no tables of horizons.
        self.areas._facets["body"][0] = FacetTables(body, np.zeros(len(body.shape.facets), bool),
                                                    self.rays.solid("body"), with_middles=True)

    def __call__(self, phase_deg, **state):
        seen = view_bodies(views.state(phase_deg=phase_deg, range_m=1000.0, **state), self.camera, self.scene.hulls)
        x0, y0, x1, y1 = region(seen, self.camera)
        return self.areas.draw(("body",), self.camera, seen, (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                               (x1 - x0, y1 - y0), 0.01, {"body": LevelPlan(by_middles=True)})[0]


def test_what_is_kept_serves_frames_nearby_and_none_depends_on_those_before(monkeypatch):
    drawn = Drawn(monkeypatch)
    first = drawn(50.0)
    assert drawn.n_anew == 1
    near = drawn(50.002)
    assert drawn.n_anew == 1 and near.tobytes() != first.tobytes(), "the same facets, in another light"
    kept = drawn.areas._kept_middles._kept
    assert len(kept) == 1
    # Room for two or three.
    monkeypatch.setattr(kept_nodes, "_MOST_BYTES", 3 * next(iter(kept._kept.values())).n_bytes)
    for phase_deg in range(51, 56):
        drawn(float(phase_deg))
    assert drawn.n_anew == 6 and len(kept) in (2, 3)
    assert drawn(50.002).tobytes() == near.tobytes() and drawn(50.0).tobytes() == first.tobytes()
    assert drawn.n_anew == 7
    drawn.areas.forget()
    assert drawn(50.0).tobytes() == first.tobytes() and drawn.n_anew == 8


def test_no_thread_works_on_after_large_shapes():
    """A sphere of 1.3 million facets, without horizons: 0.1 s after a product of 180,000 rows by NumPy."""
    body = Body(name="body", shape=generate.icosphere(radius_m=100.0, subdivisions=8), brdf=GREY)
    camera = views.camera(64, 500.0)
    scene = views.scene([body], [camera], sun_disc=False)
    rays, kept = RayEngine(scene), kept_middles.KeptMiddles()
    tables = FacetTables(body, np.zeros(len(body.shape.facets), bool), rays.solid("body"))
    facets = np.concatenate([tables.normal, tables.corner_m(slice(None)).mean(axis=0)]).T
    tables.middles = Middles(facets=facets.astype(np.float32, order="C"),
                             heights=np.zeros((tables.n_facets, 16), np.uint8))
    view, = view_bodies(views.state(phase_deg=50.0, range_m=5000.0), camera, scene.hulls)

    def anew():
        kept.forget()
        return kept.radiance(tables, view, rays, has_relief=False, brightness=1.0)

    assert np.count_nonzero(anew()) > 400_000 and spun_s(anew) < 0.02


@pytest.mark.parametrize("law", [GREY, SURGE], ids=lambda law: law.glsl)
def test_frames_near_a_node_are_what_they_are_without_it(monkeypatch, law):
    """Phases between nodes: RMS below 0.02, the flux within 0.2 %. Where surfaces surge nothing is kept."""
    drawn = Drawn(monkeypatch, law)
    for phase_deg in (0.37, 3.03, 20.04, 50.04, 89.95, 115.06):
        kept = drawn(phase_deg)
        monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10**9)
        anew = drawn(phase_deg)
        monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10_000)
        assert (kept.tobytes() != anew.tobytes()) == (phase_deg > 15.0)
        assert kept.sum() == pytest.approx(anew.sum(), rel=2e-3), phase_deg
        assert views.relative_rms(kept, anew) < 0.02, phase_deg


def test_relief_on_the_terminator_stays_dim(monkeypatch):
    """It has light where a flat facet has none: what is kept of it must not grow as the Sun rises by a node's width."""
    monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10_000)
    body = views.rough_body(GREY)
    level = LevelShape.of(body.shape, levels_of_detail(body.shape)[0])
    camera = views.camera(64, 500.0)
    scene = views.scene([body], [camera], sun_disc=False)
    rays, kept = RayEngine(scene), kept_middles.KeptMiddles()
    tables = AreaEngine(scene, rays, {"body": [level]})._facets["body"][1]
    for phase_deg in np.linspace(30.0, 110.0, 120):
        view, = view_bodies(views.state(phase_deg=phase_deg, range_m=5000.0), camera, scene.hulls)
        found = kept.radiance(tables, view, rays, has_relief=True, brightness=1.0)
        anew = kept_middles._radiance(tables, view, rays, True, 1.0, kept_middles.BrdfTables())
        assert found.max() < 1.5 * anew.max(), phase_deg


def test_small_facets_are_shared_among_their_cells_as_their_lines_tell(rng):
    """Points, slivers, facets on edges of cells and beyond the image, and some that are large."""
    n, rows, columns = 4000, 20, 30
    middle = rng.uniform(-2.0, 1.0, (2, n)) + rng.uniform(0.0, 1.0, (2, n)) * np.array([[columns + 2.0], [rows + 2.0]])
    size = 10.0 ** rng.uniform(-4.0, 0.7, n)
    xy = middle[:, None] + size * rng.uniform(-1.0, 1.0, (2, 3, n))
    xy[:, :, : n // 4] = np.round(xy[:, :, : n // 4] * 2.0) / 2.0
    xy[:, 2, n // 4 : n // 3] = xy[:, 1, n // 4 : n // 3]
    xy[0, 0, -1] = xy[1, 1, -2] = xy[0, 2, -3] = np.nan
    # Counter-clockwise from outside: as `add_lit` takes them.
    a, b, c = xy.transpose(1, 0, 2)
    turned = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
    xy[:, 1:, turned] = xy[:, 2:0:-1, turned]
    corners = np.arange(3 * n).reshape(3, n)
    radiance = np.where(rng.random(n) < 0.2, 0.0, rng.uniform(0.1, 1.0, n))
    given = np.ascontiguousarray(xy.reshape(2, 3 * n)), corners
    turns = radiance, 0, n, n, np.zeros(2), np.ones(2)
    expected, found = no_changes((rows, columns)), no_changes((rows, columns))
    add_lit(expected, *given, np.full((3, n), -1, np.int32), *turns)
    add_small(found, *given, *turns)
    images = [np.cumsum(changes, axis=1)[:, :columns] for changes in (expected, found)]
    np.testing.assert_allclose(images[1], images[0], atol=1e-10 * np.abs(images[0]).max())
    assert images[0].imag.max() > 1.0
    # The same in space: float32 corners 1000 to 2000 m deep, which a camera sees there.
    deep = rng.uniform(1000.0, 2000.0, (3, n))
    turn, shift_m = Rotation.random(random_state=1).as_matrix(), np.array([10.0, -20.0, 30.0])
    seen_m = np.stack([(xy[0] - 5.0) * deep / 300.0, (xy[1] - 7.0) * deep / 300.0, deep]) - shift_m[:, None, None]
    corners_m = np.einsum("ji,jkn->kin", turn, seen_m).reshape(9, n).astype(np.float32)
    in_space = no_changes((rows, columns))
    for first in (0, 500):
        add_seen(in_space, corners_m, radiance, first, 500, 1000, turn, shift_m, 300.0, np.array([5.0, 7.0]),
                 np.zeros(2), np.ones(2))
    image = np.cumsum(in_space, axis=1)[:, :columns]
    np.testing.assert_allclose(image, images[0], atol=1e-3 * np.abs(images[0]).max())
