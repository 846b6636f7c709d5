"""How a wall goes on beyond where it was heard last.

A sonar hears a smooth wall only where it is square to it: of one driven along that is beside, never
ahead, and of its end nothing at all. But points heard in a row are one wall, and a wall goes on a
little; one beside the robot, as far as the robot's front will come before it is heard there. A ping
that went through there is believed more.

Everything is in the body frame: x forward, y left, origin at the middle of the wheel axle; metres
and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from armadico.mobile.swept_path import Outline

NEAR_M = 0.5
"""Rows are looked for so near to the body: beyond, there is time to hear more."""

APART_M = (0.08, 0.35)
"""Points of a row are so far apart: nearer ones tell no direction, farther ones may be two things.
"""

ACROSS = math.sin(math.radians(30))
"""A row lies across the beams by which its points were heard, so nearly."""

ASIDE_M = 0.08
"""What is no farther off a row's line than this is of it."""

END_M = (0.05,)
"""So far any row goes on,"""

AHEAD_M = (0.05, 0.1, 0.15)
"""and so far one that the robot is driven along, or comes nearer to at a slant. Farther, rows close
doors: with 0.3 m drives through generated plans take a third longer and touch no less."""

AHEAD = math.cos(math.radians(50))
"""Ahead is what leads so nearly where the robot does; what it meets more squarely it hears."""

ANSWERS = math.sin(math.radians(20))
"""A ping that met it so squarely had to bring its echo."""


class Heard(NamedTuple):
    """A point, and the unit vector along which it was heard."""

    x: float
    y: float
    ahead: float
    left: float


Through = tuple[float, float, float, float, float]
"""A ping that went through: where the sonar sits, where it looks (a unit vector), how far."""


def onward(
    heard: Sequence[Heard], body: Outline, through: Sequence[Through], slope: float
) -> Iterator[tuple[float, float]]:
    """Where the rows among the points go on.

    Args:
        heard: The points near the body (`NEAR_M`) that are believed.
        body: Nothing goes on into it.
        through: What the sonars looked through lately.
        slope: Off a sonar's axis by so much a metre it still had to answer.
    """
    for p in heard:
        for ux, uy in _ends(p, heard):
            for way in AHEAD_M if ux > AHEAD else END_M:
                x, y = p.x + way * ux, p.y + way * uy
                if any(_answers(x, y, ux, uy, ping, slope) for ping in through):
                    break
                if not (-body.rear < x < body.front and abs(y) < body.half_width):
                    yield x, y


def _ends(p: Heard, near: Sequence[Heard]) -> Iterator[tuple[float, float]]:
    """The ways in which a row ends at a point, at most one to each side: unit vectors."""
    least, most = APART_M
    best: dict[bool, tuple[float, float, float]] = {}
    for q in near:
        dx, dy = p.x - q.x, p.y - q.y
        apart = math.hypot(dx, dy)
        if not least <= apart <= most:
            continue
        ux, uy = dx / apart, dy / apart
        if abs(ux * p.ahead + uy * p.left) > ACROSS or abs(ux * q.ahead + uy * q.left) > ACROSS:
            continue
        side = ux * p.left > uy * p.ahead
        if side not in best or apart > best[side][0]:
            best[side] = apart, ux, uy
    for _, ux, uy in best.values():
        if not any(_goes_on(p, r, ux, uy) for r in near):
            yield ux, uy


def _goes_on(p: Heard, r: Heard, ux: float, uy: float) -> bool:
    """Whether the row goes on with another point."""
    dx, dy = r.x - p.x, r.y - p.y
    along = ux * dx + uy * dy
    return 0.02 < along < APART_M[1] and abs(ux * dy - uy * dx) < ASIDE_M


def _answers(x: float, y: float, ux: float, uy: float, ping: Through, slope: float) -> bool:
    """Whether the wall there would have answered a ping that went through."""
    sonar_x, sonar_y, ahead, left, free = ping
    dx, dy = x - sonar_x, y - sonar_y
    along = ahead * dx + left * dy
    aside = abs(ahead * dy - left * dx)
    square = abs(ux * ahead + uy * left) < ANSWERS
    return square and 0.0 < along < free and aside <= slope * along
