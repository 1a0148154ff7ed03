"""What is found of a body at nodes of a grid of Sun and camera about it, and kept for all frames near them.

Always from the node, whether kept or not: the same request gives the same bytes, whatever came before. So it may be
found before it is asked for, where Sun and camera move steadily.
"""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera, threads

from .frames import dcm, look_at
from .surface import Surface
from .view import BodyView, phase_angle, snapped

# Bytes that are kept, of each engine and kind: at one node some 40 to 60 MB of 3 million facets that cover 500 px. And
# how many at most, as nothing may be found. The next node is looked for where there is room for so many like this one.
_MOST_BYTES, _MOST, _ROOM = 1 << 28, 64, 3
# Steps of the Sun's distance in a factor 2.
_DISTANCES = 8
# After this without a frame the next node is looked for [s], at most so many frames ahead.
_PAUSE_S, _MOST_AHEAD = 0.03, 64
# Kinds of which the last frames are known; and of a step from frame to frame, what the next one may differ by.
_MOST_KINDS, _STEADY = 8, 0.25
# A frame waits for what is being looked for until that has taken so many times as long as frames themselves take: on a
# busy machine it may take for ever. And most frames in which nothing is looked for where it came too late.
_PATIENCE, _MOST_REST = 2.0, 16


class KeptAtNodes:
    """The last ones that were asked for, as far as there is room; of each it is told how large it is, `n_bytes`.

    Parameters
    ----------
    directions, ranges : int
        Steps of the grid: of directions of Sun and camera in 1 rad, of ranges in a factor e.
    """

    def __init__(self, directions: int, ranges: int):
        self._directions, self._ranges = directions, ranges
        self._kept: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
        self._lock = threading.Lock()
        # Of each kind, where Sun and camera were in the last frames.
        self._places: OrderedDict[tuple[Any, ...], list[np.ndarray]] = OrderedDict()
        self._spare = threads.SpareTime(_PAUSE_S)
        # What is being made in spare time, what tells its end, and when it began [s]; how long it takes otherwise [s].
        self._ahead: tuple[tuple[Any, ...], threading.Event, float] | None = None
        self._takes_s = 0.0
        # The last one that was found so; frames that could not wait since; and for how many more nothing is looked for.
        self._found_ahead: tuple[Any, ...] = ()
        self._n_missed, self._rest = 0, 0

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def n_bytes(self) -> int:
        """Of all that is kept."""
        with self._lock:
            return _bytes_of(self._kept)

    def forget(self) -> None:
        """Find all anew; no image changes."""
        self._spare.stop()
        self._places.clear()
        # What is being found may still be kept where nobody looks.
        self._kept = OrderedDict()

    def close(self) -> None:
        """Forget, and look for nothing any more."""
        self._spare.close()
        self.forget()

    def at(self, view: BodyView, radius_m: float, of: tuple[Any, ...], make: Callable[[BodyView], Any]
           ) -> tuple[BodyView, Any]:
        """The nearest node to a view of a body of this radius [m]; what was made there `of` something, or is made now.
        """
        node, kept, ahead = self._node(view, radius_m), self._kept, self._ahead
        key = _key(of, node)
        found = self._find(kept, key)
        if found is None and ahead is not None and ahead[0] == key:
            _, is_made, begun_s = ahead
            if is_made.wait(max(begun_s + _PATIENCE * self._takes_s - time.perf_counter(), 0.0)):
                found = self._find(kept, key)
        if key == self._found_ahead:
            self._n_missed = 0
        if found is None:
            # What may be asked for later has to wait.
            self._spare.stop()
            begin_s = time.perf_counter()
            found = self._keep(kept, key, make(node))
            self._takes_s = time.perf_counter() - begin_s
            if self._is_expected(of):
                self._n_missed += 1
                self._rest = min(1 << self._n_missed, _MOST_REST)
        # The next one must not push out this one.
        if _ROOM * found.n_bytes < _MOST_BYTES:
            self._follow(kept, view, radius_m, of, make)
        else:
            self._places.clear()
        return node, found

    def _is_expected(self, of: tuple[Any, ...]) -> bool:
        """Whether the next frame of a kind should be where those before lead to, and was looked for."""
        places = self._places.get(of, [])
        return self._rest == 0 and len(places) == 3 and _are_steady(*places)

    def _follow(self, kept: OrderedDict[tuple[Any, ...], Any], view: BodyView, radius_m: float, of: tuple[Any, ...],
                make: Callable[[BodyView], Any]) -> None:
        """Look ahead in spare time where Sun and camera move steadily."""
        places = self._places.setdefault(of, [])
        place = np.concatenate([view.sun_direction_body, view.r_camera_body_m / radius_m])
        if places and (place == places[-1]).all():
            return
        self._rest = max(self._rest - 1, 0)
        places[:] = [*places[-2:], place]
        self._places.move_to_end(of)
        if len(self._places) > _MOST_KINDS:
            self._places.popitem(last=False)
        if self._is_expected(of):
            self._spare.give(partial(self._look_ahead, kept, tuple(places), view, radius_m, of, make))

    def _look_ahead(self, kept: OrderedDict[tuple[Any, ...], Any], places: tuple[np.ndarray, ...], view: BodyView,
                    radius_m: float, of: tuple[Any, ...], make: Callable[[BodyView], Any]) -> None:
        """Find what is at the next node, if Sun and camera go on as in the last three frames."""
        first, step = _key(of, self._node(view, radius_m)), places[2] - places[1]
        turn = step - (places[1] - places[0])
        for n in range(1, _MOST_AHEAD + 1):
            place = places[2] + n * step + 0.5 * n * (n + 1) * turn
            to_sun, r_camera_m = place[:3] / np.linalg.norm(place[:3]), place[3:] * radius_m
            node = self._node(replace(view, sun_direction_body=to_sun, r_camera_body_m=r_camera_m,
                                      range_m=float(np.linalg.norm(r_camera_m))), radius_m)
            key = _key(of, node)
            if key != first:
                if self._find(kept, key) is None:
                    is_made = threading.Event()
                    self._ahead = key, is_made, time.perf_counter()
                    try:
                        self._keep(kept, key, make(node))
                        self._found_ahead = key
                    finally:
                        self._ahead = None
                        is_made.set()
                return

    def _node(self, view: BodyView, radius_m: float) -> BodyView:
        return at_node(view, radius_m, self._directions, self._ranges)

    def _find(self, kept: OrderedDict[tuple[Any, ...], Any], key: tuple[Any, ...]) -> Any:
        """What is kept; None if it is not."""
        with self._lock:
            if key in kept:
                kept.move_to_end(key)
            return kept.get(key)

    def _keep(self, kept: OrderedDict[tuple[Any, ...], Any], key: tuple[Any, ...], made: Any) -> Any:
        """Leave out those that were asked for longest ago if there is no room."""
        with self._lock:
            kept[key] = made
            while len(kept) > 1 and (len(kept) > _MOST or _bytes_of(kept) > _MOST_BYTES):
                kept.popitem(last=False)
        return made


def _key(of: tuple[Any, ...], node: BodyView) -> tuple[Any, ...]:
    return (*of, node.sun_distance_au, *node.sun_direction_body.tolist(), *node.r_camera_body_m.tolist())


def _bytes_of(kept: OrderedDict[tuple[Any, ...], Any]) -> int:
    return sum(each.n_bytes for each in kept.values())


def _are_steady(first: np.ndarray, second: np.ndarray, third: np.ndarray) -> bool:
    """Whether the last step is about as long as the one before, and in its direction."""
    step, turn = third - second, third - 2.0 * second + first
    return float(turn @ turn) < _STEADY**2 * float(step @ step)


def at_node(view: BodyView, radius_m: float, directions: int, ranges: int) -> BodyView:
    """The view from the nearest nodes of Sun and camera: so many directions in 1 rad, and ranges in a factor e.

    Straight at the body, whichever way the camera looks. Of distances of the Sun there are eight in a factor 2.
    """
    to_sun = snapped(view.sun_direction_body, directions)
    range_m = radius_m * math.exp(round(math.log(view.range_m / radius_m) * ranges) / ranges)
    to_camera = snapped(view.r_camera_body_m / view.range_m, directions)
    place_m = range_m * to_camera
    distance_au = 2.0 ** (round(math.log2(view.sun_distance_au) * _DISTANCES) / _DISTANCES)
    return replace(view, sun_distance_au=distance_au, sun_direction_body=to_sun, r_camera_body_m=place_m,
                   range_m=range_m,
                   phase_rad=phase_angle(to_sun, to_camera), camera_from_body=dcm(look_at(place_m, np.zeros(3))))


def camera_at_node(focal_length_px: float) -> PinholeCamera:
    """Which looks straight at the body: what is found does not depend on where in an image others have it."""
    return PinholeCamera(name="node", width_px=1, height_px=1, focal_length_px=focal_length_px,
                         principal_point_px=(0.0, 0.0))


def phase_gain(surface: Surface, view: BodyView, node: BodyView) -> float:
    """How much brighter a surface is at the phase angle of a view than at a node's."""
    return _symmetric_brdf(surface, view.phase_rad) / _symmetric_brdf(surface, node.phase_rad)


def _symmetric_brdf(surface: Surface, phase_rad: float) -> float:
    """BRDF [1/sr] where incidence and emission are half of the phase angle."""
    half = 0.5 * phase_rad
    to_sun, to_camera = (np.array([sign * math.sin(half), 0.0, math.cos(half)]) for sign in (1.0, -1.0))
    return float(surface.brdf(to_sun, to_camera[None], np.array([[0.0, 0.0, 1.0]]), np.ones(1))[0])
