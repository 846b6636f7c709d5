"""The safe speed among known points, for all behaviours.

A behaviour's wanted speeds are reduced until the whole predicted motion, by the forward model of
`motion`, stays clear of the remembered points.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf
from typing import NamedTuple

from armadico.core.messages import Point
from armadico.core.parameters import Safety
from armadico.mobile.admissible import nearest
from armadico.mobile.geometry import turning_circle
from armadico.mobile.motion import Body, Speeds, touches_at
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import free_path

ON_THE_SPOT_M_S = 0.05  # up to this speed the robot turns in place, with the small margin all round
EARLIER_S = 0.05  # how much before the last moment `unhurried` brakes

# Without a map the robot drives as if it had at least this free path; otherwise it could not follow
# a wall, as the sonar agent expects a wall to continue this far beyond its last echo.
UNHEARD_M = 0.15

# A corner of the trajectory is not cut if an obstacle is nearer than this to the footprint's
# farthest corner.
CORNER_ROOM_M = 0.17


class Scene(NamedTuple):
    """The situation in which wanted speeds are checked."""

    body: Body
    measured: Speeds  # (v, w), m/s and rad/s
    points: Sequence[Point]  # known points in the body frame, m
    age: float = 0.0  # of the points, s
    waits: float = 0.0  # how long the command may be delayed, s

    def touches_at(self, wanted: Speeds, margin: float) -> float:
        """Return when the body comes within `margin` m of a point, s; inf: it rests before.

        Both an immediate and the most delayed command are checked.
        """
        found = self._touches_at(wanted, margin, self.age)
        if found == inf and self.waits > self.age:
            found = self._touches_at(wanted, margin, self.waits)
        return found

    def _touches_at(self, wanted: Speeds, margin: float, waited: float) -> float:
        return touches_at(self.body, self.measured, wanted, self.points, margin, waited=waited)


def limit(v: float, w: float, scene: Scene, safety: Safety) -> Speeds:
    """Return the admissible speeds nearest to the wanted ones, m/s and rad/s.

    Without admissible speeds (`nearest`) the robot brakes.
    """
    body = scene.body
    v, w = _clip(v, body.v_max), _clip(w, body.w_max)
    if v > 0.0 and safety.unmapped:
        v = min(v, _unmapped(scene))
    found = nearest((v, w), lambda wanted: _admissible(scene, wanted, safety), safety.slow)
    return found or _too_late(scene, w, safety)


def unhurried(v: float, w: float, scene: Scene, safety: Safety) -> float:
    """Return a speed up to v (m/s) at which no agent is `critical` in the next cycles.

    `limit` brakes at the last moment; by then other agents see a motion that would touch something
    if it continued. This brakes earlier, for points on the wanted arc and on the present one.
    """
    free = min(
        free_path(scene.points, v, turn, scene.body.outline, safety.margin_m)
        for turn in (w, scene.measured[1])
    )
    if free == inf:
        return v
    return min(v, scene.body.stops_within(free, scene.age + EARLIER_S))


def critical(scene: Scene, safety: Safety) -> bool:
    """Return whether the present motion, kept until the society reacts, touches a known point."""
    at_once = scene._replace(waits=0.0)  # a critical bid does not wait
    return at_once.touches_at(scene.measured, safety.margin_m) < inf


def corner_cut(obstacles: Obstacles, body: Body, least: float) -> float:
    """Return by how much a path may cut the trajectory's corners, m: little near an obstacle."""
    near, outline = obstacles.closest, body.outline
    if near is None:
        return inf
    corner = hypot(max(outline.front, outline.rear), outline.half_width)
    return max(least, hypot(near.x, near.y) - corner - CORNER_ROOM_M)


def _unmapped(scene: Scene) -> float:
    """Return the speed with which it stops within the nearest point's distance, in any direction.

    A sonar does not detect a smooth wall at a slant. So without a map each point may belong to a
    wall in any direction, also across the robot's path.
    """
    nearest = min((hypot(p.x, p.y) for p in scene.points), default=inf)
    free = max(nearest - turning_circle(*scene.body.outline), UNHEARD_M)
    return scene.body.stops_within(free) if free < inf else inf


def _admissible(scene: Scene, wanted: Speeds, safety: Safety) -> bool:
    return scene.touches_at(wanted, _margin(scene, wanted, safety)) == inf


def _margin(scene: Scene, wanted: Speeds, safety: Safety) -> float:
    """Return the margin: small for a robot that is slow or turns in place."""
    driven = abs(scene.measured[0])
    if abs(wanted[0]) <= safety.slow and driven <= safety.slow + ON_THE_SPOT_M_S:
        return min(safety.close_m, safety.margin_m)
    if wanted[0] == 0.0 and driven <= ON_THE_SPOT_M_S:
        return min(safety.close_m, safety.margin_m)
    return safety.margin_m


def _too_late(scene: Scene, w: float, safety: Safety) -> Speeds:
    """Return braking speeds, with the turn only if that touches nothing and braking would."""
    close = min(safety.close_m, safety.margin_m)
    if scene.touches_at((0.0, 0.0), close) < inf and scene.touches_at((0.0, w), close) == inf:
        return 0.0, w
    return 0.0, 0.0


def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
