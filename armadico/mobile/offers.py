"""What a behaviour can say of the wheels beside its bid: ratings of actions, and a vector.

Frame: the body's, x forward, y left, the origin at the middle of the wheel axle; m, rad, s.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import atan2, cos, hypot, inf, sin
from typing import Final, cast

from armadico.core.exchange import Bid
from armadico.core.messages import Point
from armadico.core.parameters import TURN_MARGIN_M
from armadico.mobile.motion import Body, Speeds
from armadico.mobile.swept_path import Outline, free_path, free_turn

NEAR_M_S: Final = 0.2
NEAR_RAD_S: Final = 0.3  # so far from a wish an action is neither good nor bad
TURN_ROOM: Final = 0.12  # rad: with less free turn on the spot, turning is bad
FULL_M_S: Final = 0.3  # from this speed on the whole reach must be free
SECTOR_RAD: Final = 0.35  # of the directions in which only the nearest point repels
LEAST: Final = -0.99  # -1 forbids an action
REPELS: Final = 100.0
"""Length of a vector away from what is within the margin, where a goal's is 1."""

SOON_S: Final = 1.0  # a bid's turn after this time gives the direction of its vector


def speeds_of(bid: Bid) -> Speeds:
    """Return a bid's (v, w), m/s and rad/s."""
    v, w = cast("Iterable[float]", bid.action)
    return v, w


def near(wish: Speeds, actions: Iterable[Speeds]) -> list[float]:
    """Rate actions (m/s, rad/s) by their distance from a wish: 1 for it, towards -1 far away.

    So the path followers of DAMN vote: "a Gaussian around the preferred arc" (Rosenblatt 1997).
    Here the tails are longer, so that of two bad actions the nearer one is still rated higher.
    """
    v, w = wish
    squares = (((a - v) / NEAR_M_S) ** 2 + ((b - w) / NEAR_RAD_S) ** 2 for a, b in actions)
    return [2.0 / (1.0 + square) - 1.0 for square in squares]


def onward(bearing: float, v_most: float, actions: Iterable[Speeds]) -> list[float]:
    """Rate actions by the progress towards a bearing (rad) and the heading that they lead to.

    Both after a second; faster than `v_most` m/s is worse. It forbids nothing.
    """
    rated = (
        0.5 * min(v / v_most, 1.0) * cos(bearing - 0.5 * SOON_S * w)
        + 0.5 * cos(bearing - SOON_S * w)
        - max(v / v_most - 1.0, 0.0)
        for v, w in actions
    )
    return [max(rating, LEAST) for rating in rated]


def open_ways(
    points: Sequence[Point], body: Body, actions: Iterable[Speeds], margin: float, reach: float
) -> list[float]:
    """Rate actions by the free way on their arcs: -1 where the robot could not stop, else up to 1.

    The faster, the more free way beyond the stopping distance it takes for 1: up to `reach`, m. To
    stand touches nothing. Actions are (v, w), m/s and rad/s; the margin is kept round the
    footprint, m.
    """
    outline = body.outline
    far = reach + hypot(max(outline.front, outline.rear), outline.half_width) + margin
    here = [p for p in points if hypot(p.x, p.y) <= far]
    behind = [Point(-p.x, p.y) for p in here]
    turns = {
        side: 1.0 if free_turn(here, side, outline, TURN_MARGIN_M) > TURN_ROOM else -1.0
        for side in (1.0, -1.0)
    }
    found = []
    for v, w in actions:
        if v == 0.0:
            found.append(1.0 if w == 0.0 else turns[1.0 if w > 0.0 else -1.0])
            continue
        if v > 0.0:
            free = free_path(here, v, w, outline, margin)
        else:
            free = free_path(behind, -v, -w, outline.turned_round, margin)
        left = free - body.stopping_distance(v)
        enough = reach * min(abs(v) / FULL_M_S, 1.0)
        found.append(-1.0 if left < 0.0 else 2.0 * min(left / enough, 1.0) - 1.0)
    return found


def along(bid: Bid | None, body: Body) -> Speeds:
    """Return a vector in the direction of a bid's motion; its length is the share of the speed."""
    if bid is None or bid.utility <= 0.0:
        return 0.0, 0.0
    v, w = speeds_of(bid)
    length = min(abs(v) / body.v_max, 1.0)
    return length * cos(SOON_S * w), length * sin(SOON_S * w)


def repelled(points: Iterable[Point], outline: Outline, sphere: float, margin: float) -> Speeds:
    """Return the sum of vectors away from the nearest point in each direction.

    Arkin (1989): none for a distance d > sphere, m; then (sphere - d) / (sphere - margin); from the
    margin on infinite, here `REPELS`, so that no goal draws the robot nearer.
    """
    nearest: dict[int, tuple[float, Point]] = {}
    for p in points:
        free = outline.clearance(p.x, p.y)
        sector = int(atan2(p.y, p.x) // SECTOR_RAD)
        if free < min(sphere, nearest.get(sector, (inf, p))[0]):
            nearest[sector] = free, p
    x = y = 0.0
    for free, p in nearest.values():
        length = REPELS if free <= margin else (sphere - free) / (sphere - margin)
        away = max(hypot(p.x, p.y), 1e-6)
        x -= length * p.x / away
        y -= length * p.y / away
    return x, y
