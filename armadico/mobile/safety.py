"""How fast is safe: every behaviour that moves the robot asks this of the points it knows.

Nobody drives blind, and nobody does what cannot be stopped: a behaviour's wish is brought down
until everything that it may lead to, by the forward model of `motion`, stays clear of the points
that are remembered.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf
from typing import NamedTuple

from armadico.core.messages import Point
from armadico.core.parameters import Safety
from armadico.mobile.geometry import turning_circle
from armadico.mobile.motion import Body, Speeds, touches_at
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import free_path

HALVINGS = 4
"""How finely the fastest admissible speed is looked for: to a sixteenth of what was wanted."""

TURNS = (1.0, 0.6, 0.3, 0.0)
"""Shares of the wanted turn that are tried: where a corner would swing into something it turns
less, and drives on as it does."""

ON_THE_SPOT_M_S = 0.05
"""Slower than this the robot turns on the spot, and the small margin will do all round."""

EARLIER_S = 0.05
"""So much before it must, whoever is in no hurry brakes."""

UNHEARD_M = 0.15
"""Without a map it drives as if it had at least this much way, or it would get along no wall: the
sonar agent expects a wall to go on so far beyond where it was heard."""

CORNER_ROOM_M = 0.17
"""Nearer to something than this, its farthest corner to obstacle, a corner of the trajectory is not
cut."""


class Scene(NamedTuple):
    """What a wish is held against."""

    body: Body
    measured: Speeds  # (v, w) by the wheels, m/s and rad/s
    points: Sequence[Point]  # what is known, in the body frame, m
    age: float = 0.0  # s that these are old
    waits: float = 0.0  # s that the command may have to wait, or it is given at once

    def touches_at(self, wanted: Speeds, margin: float) -> float:
        """When the body comes within `margin` m of something, s; inf: it rests before.

        Whether it is commanded at once or as late as it may be.
        """
        found = self._touches_at(wanted, margin, self.age)
        if found == inf and self.waits > self.age:
            found = self._touches_at(wanted, margin, self.waits)
        return found

    def _touches_at(self, wanted: Speeds, margin: float, waited: float) -> float:
        return touches_at(self.body, self.measured, wanted, self.points, margin, waited=waited)


class Limited(NamedTuple):
    v: float
    w: float
    free: float  # m that the arc of the wish itself is free; inf if nothing is on it


def limit(v: float, w: float, scene: Scene, safety: Safety) -> Limited:
    """The same motion as fast as is admissible, m/s and rad/s, and how far its way was free.

    First slowing keeps w: the robot turns tighter as it comes nearer, away from or along what is
    there. Where even that would swing a corner into something, it turns less. Where nothing is
    admissible it is too late, and it brakes.
    """
    body = scene.body
    v, w = _clip(v, body.v_max), _clip(w, body.w_max)
    free = inf
    if v > 0.0 and safety.unmapped:
        v = min(v, _unmapped(scene))
    if v > 0.0:
        free = free_path(scene.points, v, w, body.outline, safety.margin_m)
    if _admissible(scene, (v, w), safety):
        return Limited(v, w, free)
    for share in TURNS:
        turn = share * w
        if _admissible(scene, (0.0, turn), safety):
            return Limited(_fastest(scene, v, turn, safety), turn, free)
        if w == 0.0:
            break
    return Limited(*_too_late(scene, w, safety), free)


def unhurried(v: float, w: float, scene: Scene, safety: Safety) -> float:
    """The speed up to v (m/s) that nobody will call critical in the next cycles.

    `limit` lets a wish brake at the last moment; whoever looks then sees a motion that would touch
    something if it went on. So it brakes earlier, for what lies on the arc of the wish, and on that
    which the robot is on.
    """
    free = min(
        free_path(scene.points, v, turn, scene.body.outline, safety.margin_m)
        for turn in (w, scene.measured[1])
    )
    if free == inf:
        return v
    return min(v, scene.body.stops_within(free, scene.age + EARLIER_S))


def critical(scene: Scene, safety: Safety) -> bool:
    """Whether the present motion, held until the society reacts, ends in something known."""
    at_once = scene._replace(waits=0.0)  # about to collide, it does not wait
    return at_once.touches_at(scene.measured, safety.margin_m) < inf


def corner_cut(obstacles: Obstacles, body: Body, least: float) -> float:
    """How far off the trajectory's corners a way may lead, m: little where something is near."""
    near, outline = obstacles.closest, body.outline
    if near is None:
        return inf
    corner = hypot(max(outline.front, outline.rear), outline.half_width)
    return max(least, hypot(near.x, near.y) - corner - CORNER_ROOM_M)


def _unmapped(scene: Scene) -> float:
    """The speed from which it stops within the way to the nearest point, whichever way that is.

    A sonar does not hear a smooth wall at a slant. So without a map each point may be of a wall
    that goes on in any direction, also across the robot's way.
    """
    nearest = min((hypot(p.x, p.y) for p in scene.points), default=inf)
    free = max(nearest - turning_circle(*scene.body.outline), UNHEARD_M)
    return scene.body.stops_within(free) if free < inf else inf


def _admissible(scene: Scene, wanted: Speeds, safety: Safety) -> bool:
    return scene.touches_at(wanted, _margin(scene, wanted, safety)) == inf


def _margin(scene: Scene, wanted: Speeds, safety: Safety) -> float:
    """What is kept all round: little for a robot that is slow, or turns on the spot."""
    driven = abs(scene.measured[0])
    if abs(wanted[0]) <= safety.slow and driven <= safety.slow + ON_THE_SPOT_M_S:
        return min(safety.close_m, safety.margin_m)
    if wanted[0] == 0.0 and driven <= ON_THE_SPOT_M_S:
        return min(safety.close_m, safety.margin_m)
    return safety.margin_m


def _fastest(scene: Scene, v: float, w: float, safety: Safety) -> float:
    """The fastest admissible speed up to v with this turn, m/s; none at all is known to be."""
    slow, fast = 0.0, v
    if 0.0 < safety.slow < v and _admissible(scene, (safety.slow, w), safety):
        slow = safety.slow  # with its own margin: a search from zero may miss it
    for _ in range(HALVINGS):
        middle = 0.5 * (slow + fast)
        if _admissible(scene, (middle, w), safety):
            slow = middle
        else:
            fast = middle
    return slow


def _too_late(scene: Scene, w: float, safety: Safety) -> Speeds:
    """Brake; and turn too, only if with that nothing is touched at all."""
    close = min(safety.close_m, safety.margin_m)
    if scene.touches_at((0.0, 0.0), close) < inf and scene.touches_at((0.0, w), close) == inf:
        return 0.0, w
    return 0.0, 0.0


def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
