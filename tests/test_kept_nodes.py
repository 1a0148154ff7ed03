"""What is kept at nodes is there before it is asked for where Sun and camera move steadily: with the same bytes."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np
import pytest
import views
from glrender import Renderer, kept_nodes, level_tables
from glrender.brdf import Lambert
from glrender.costs import EngineCosts
from glrender.kept_nodes import KeptAtNodes
from glrender.view import BodyView, view_bodies

_DIRECTIONS, _RANGES = 1024, 64
_LATE_S = 10.0


@dataclass(frozen=True, eq=False)
class _Made:
    node: BodyView
    thread: str
    n_bytes: int = 1


class _Frames:
    """Views of a body whose Sun moves, and what they were given."""

    def __init__(self, monkeypatch):
        monkeypatch.setattr(kept_nodes, "_PAUSE_S", 0.005)
        self.kept, self.made = KeptAtNodes(_DIRECTIONS, _RANGES), []
        self.wait = lambda: None
        self._body, self._camera = views.sphere(Lambert(normal_albedo=0.3)), views.camera(64, 100.0)
        self._hulls = views.scene([self._body], [self._camera]).hulls

    def view(self, turn_rad, range_m=1000.0):
        return view_bodies(views.state(phase_deg=60.0 + np.degrees(turn_rad), range_m=range_m), self._camera,
                           self._hulls)[0]

    def __call__(self, turn_rad, **given):
        node, found = self.kept.at(self.view(turn_rad, **given), 100.0, ("kind",), self._make)
        assert (node.sun_direction_body == found.node.sun_direction_body).all()
        return found

    def _make(self, node):
        self.wait()
        made = _Made(node, threading.current_thread().name)
        self.made.append(made)
        return made

    def n_made(self, expected):
        """After a while."""
        end_s = time.perf_counter() + _LATE_S
        while len(self.made) < expected and time.perf_counter() < end_s:
            time.sleep(0.005)
        time.sleep(0.05)
        return len(self.made)


@pytest.fixture
def frames(monkeypatch):
    made = _Frames(monkeypatch)
    yield made
    made.kept.close()


STEP_RAD = 1.5 / _DIRECTIONS


def test_the_next_node_is_there_when_it_is_asked_for(frames):
    for n in range(3):
        frames(n * STEP_RAD)
    assert frames.n_made(4) == 4
    for n in range(3, 8):
        found = frames(n * STEP_RAD)
        assert found.thread.startswith("glrender-spare") and found is frames.made[n], n
        assert frames.n_made(n + 2) == n + 2


def test_slow_ones_look_as_far_as_the_next_node_and_no_farther(frames):
    seen = set()
    for n in range(12):
        seen.add(frames(0.05 * n * STEP_RAD))
        if n >= 2:
            assert frames.n_made(len(seen) + 1) == len(seen) + 1, n
    assert len(seen) > 2 and sum(each.thread == "MainThread" for each in frames.made) <= 2, "those of the first frames"


@pytest.mark.parametrize("turns", [(0.0, 1.0, -1.0, 2.0), (0.0, 1.0, 5.0, 6.0), (0.0, 1.0, 1.0, 1.0)],
                         ids=["to and fro", "a jump", "standing still"])
def test_nothing_is_looked_for_unless_they_move_steadily(frames, turns):
    for turn in turns:
        frames(turn * STEP_RAD)
    assert frames.n_made(len(set(turns))) == len(set(turns))


@pytest.mark.parametrize(("room", "n_expected"), [(4, 4), (2, 3)])
def test_the_next_node_does_not_push_out_the_one_in_use(frames, monkeypatch, room, n_expected):
    monkeypatch.setattr(kept_nodes, "_MOST_BYTES", room)
    for n in range(3):
        frames(n * STEP_RAD)
    assert frames.n_made(n_expected) == n_expected
    frames(2 * STEP_RAD)
    assert len(frames.made) == n_expected


def test_a_frame_waits_for_what_is_nearly_there(frames):
    is_begun = threading.Event()

    def wait() -> None:
        if threading.current_thread() is threading.main_thread():
            time.sleep(0.3)
        else:
            is_begun.set()
            time.sleep(0.1)

    frames.wait = wait
    for n in range(3):
        frames(n * STEP_RAD)
    assert is_begun.wait(_LATE_S)
    assert frames(3 * STEP_RAD).thread.startswith("glrender-spare") and len(frames.made) == 4


def test_a_frame_does_not_wait_for_ever(frames):
    """Spare time may be none."""
    is_begun, may_end = threading.Event(), threading.Event()

    def wait() -> None:
        if threading.current_thread() is not threading.main_thread():
            is_begun.set()
            may_end.wait(_LATE_S)

    frames.wait = wait
    for n in range(3):
        frames(n * STEP_RAD)
    assert is_begun.wait(_LATE_S)
    begin_s = time.perf_counter()
    assert frames(3 * STEP_RAD).thread == "MainThread"
    assert time.perf_counter() - begin_s < 1.0
    may_end.set()


def test_it_rests_where_frames_leave_no_spare_time(frames):
    for n in range(40):
        frames(n * STEP_RAD)
    frames.n_made(40)
    n_looked = sum(each.thread != "MainThread" for each in frames.made)
    assert n_looked <= 1 and frames.kept._rest > 4
    # And looks again where they do.
    for n in range(40, 40 + 2 * kept_nodes._MOST_REST):
        frames(n * STEP_RAD)
        time.sleep(0.05)
    assert frames.made[-1].thread.startswith("glrender-spare") and frames.kept._n_missed == 0


def test_what_was_forgotten_does_not_come_back(frames):
    is_begun, may_end = threading.Event(), threading.Event()

    def wait() -> None:
        if threading.current_thread() is not threading.main_thread():
            is_begun.set()
            may_end.wait(_LATE_S)

    frames.wait = wait
    for n in range(3):
        frames(n * STEP_RAD)
    assert is_begun.wait(_LATE_S)
    frames.kept.forget()
    may_end.set()
    frames.n_made(4)
    assert len(frames.kept) == 0 and frames.kept.n_bytes == 0


def test_frames_of_a_body_that_turns_are_the_same_bytes_as_anew(monkeypatch):
    """By areas and by middles: with what was looked for in between, and by a renderer for each frame."""
    monkeypatch.setattr(level_tables, "FEWEST_KEPT", 10_000)
    monkeypatch.setattr(kept_nodes, "_PAUSE_S", 0.005)
    names, keep = [], KeptAtNodes._keep

    def counted(self, kept, key, made):
        names.append(threading.current_thread().name)
        return keep(self, kept, key, made)

    monkeypatch.setattr(KeptAtNodes, "_keep", counted)
    camera = views.camera(128, 500.0)
    scene = views.scene([views.rough_body(Lambert(normal_albedo=0.3))], [camera], sun_disc=False)
    by_areas = EngineCosts(facet_ns=1e4, sample_ns=1e4, ray_ns=1e4, lone_ray_ns=1e4, area_ns=1.0)
    with Renderer(scene) as renderer, Renderer(scene) as other:
        for each in (renderer, other):
            monkeypatch.setattr(each, "_costs", by_areas)
        for budget, step_deg in ((0.02, 0.01), (0.1, 0.2)):
            for n in range(6):
                turned = views.state(phase_deg=60.0 + n * step_deg, range_m=1000.0)
                frame = renderer.render(turned, max_error=budget)
                time.sleep(0.3)
                other.forget_shadow_maps()
                anew = other.render(turned, max_error=budget)
                assert frame.irradiance_W_m2.tobytes() == anew.irradiance_W_m2.tobytes(), (budget, n)
                assert frame.plan.predicted_error == anew.plan.predicted_error
    assert sum(name.startswith("glrender-spare") for name in names) >= 4
