"""Bodies of several materials: engines see their parts, callers see the bodies."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce
from itertools import groupby

import numpy as np
from glrender_camera import PinholeCamera

from ..base.errors import ConfigError
from ..planner.plan import BodyPlan, RenderPlan
from ..scene.body import PART, owner
from ..scene.scene import Scene
from ..view.state import State
from ..view.view import view_bodies
from .small_bodies import SmallBody

# A name may stand in quotes, its unprintable sign as an escape.
_PART = re.compile(rf"(?:{PART}|\\x1f)[0-9]+")


class Parts:
    """The parts of a scene's bodies: from callers' states to engines', and from engines' images to callers'.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    drawn : Scene
        With the parts as bodies; the scene itself where no body has materials.
    """

    def __init__(self, scene: Scene):
        self.drawn, self._scene = scene.of_parts, scene
        self._is_needed = self.drawn is not scene
        self._bodies, self._begins, facets = [], [], []
        for index, body in enumerate(scene.bodies if self._is_needed else ()):
            for part in body.parts:
                self._bodies.append(index)
                self._begins.append(sum(map(len, facets)))
                facets.append(body.facets_of(part))
        self._facets = np.concatenate([*facets, [-1]])

    @contextmanager
    def by_bodies(self) -> Iterator[None]:
        """A block whose errors name bodies in place of their parts."""
        try:
            yield
        except ConfigError as error:
            if self._is_needed:
                for name in ("path", "rule", "got", "hint"):
                    if isinstance(value := getattr(error, name), str):
                        setattr(error, name, _PART.sub("", value))
            raise

    def state(self, state: State, camera: PinholeCamera) -> State:
        """The state of the parts, each with its body's pose.

        Raises
        ------
        SceneError
            As of `view_bodies`, by the bodies.
        """
        if not self._is_needed:
            return state
        view_bodies(state, camera, self._scene.hulls)
        return replace(state, bodies={part.name: state.bodies[owner(part.name)] for part in self.drawn.bodies})

    def products(self, wanted: Sequence[str], draw: Callable[[Sequence[str]], Mapping[str, np.ndarray]]
                 ) -> dict[str, np.ndarray]:
        """Products that are drawn by their names, with the numbers of bodies, and of facets in these."""
        if not self._is_needed or not {"body_id", "facet_id"} & set(wanted):
            return dict(draw(wanted))
        made = dict(draw(tuple(dict.fromkeys((*wanted, "body_id", "facet_id")))))
        part, is_sky = made["body_id"], made["body_id"] < 0
        facet = np.where(is_sky, len(self._facets) - 1, np.take(self._begins, part) + made["facet_id"])
        made["facet_id"] = self._facets[facet].astype(np.int32)
        made["body_id"] = np.where(is_sky, -1, np.take(self._bodies, part)).astype(np.int32)
        return {name: made[name] for name in wanted}

    def plan(self, plan: RenderPlan) -> RenderPlan:
        """The plan by bodies."""
        if not self._is_needed:
            return plan
        bodies = [reduce(_both, (replace(each, name=name, casters=tuple(caster for caster in _once(each.casters)
                                                                        if caster != name)) for each in some))
                  for name, some in groupby(plan.bodies, lambda each: owner(each.name))]
        in_view = {f"{body.name}: out of view" for body in bodies if body.is_visible}
        return replace(
            plan, bodies=tuple(bodies), warnings=_once(plan.warnings),
            left_out=tuple(text for text in _once(plan.left_out) if text not in in_view),
            windows=tuple(replace(window, bodies=_once(window.bodies)) for window in plan.windows))

    def small_bodies(self, small: Iterable[SmallBody]) -> tuple[SmallBody, ...]:
        """Small bodies by the bodies' names."""
        return tuple(replace(each, names=_once(each.names)) for each in small)

    def memory_bytes(self, of_parts: Mapping[str, Mapping[str, int]]) -> dict[str, dict[str, int]]:
        """Memory [byte] of bodies, by kind."""
        made: dict[str, dict[str, int]] = {}
        for name, kinds in of_parts.items():
            of_body = made.setdefault(owner(name), dict.fromkeys(kinds, 0))
            for kind, size in kinds.items():
                of_body[kind] += size
        return made


def _once(texts: Iterable[str]) -> tuple[str, ...]:
    """Texts with bodies' names in place of parts', each once."""
    return tuple(dict.fromkeys(_PART.sub("", text) for text in texts))


def _both(one: BodyPlan, other: BodyPlan) -> BodyPlan:
    """The plan of two parts of a body."""
    most = {name: max(getattr(one, name), getattr(other, name)) for name in (
        "is_visible", "relative_to_camera", "normal_lookup", "size_px", "shadow_map_drawn_px", "detail_layers")}
    return replace(
        one, **most, n_facets=one.n_facets + other.n_facets,
        law=", ".join(dict.fromkeys((*one.law.split(", "), other.law))),
        shadow_map_px=max(one.shadow_map_px or 0, other.shadow_map_px or 0) or None,
        shadow_map_reused=one.shadow_map_reused and other.shadow_map_reused,
        modelled={cause: max(each.modelled.get(cause, 0.0) for each in (one, other))
                  for cause in {**one.modelled, **other.modelled}},
        penumbra=max(one.penumbra, other.penumbra, key=lambda each: (each.hard_error, each.width_px)),
        casters=tuple(dict.fromkeys((*one.casters, *other.casters))))
