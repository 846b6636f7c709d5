"""Where a robot was slow on a drive, or unsure of its pose, and why (sans-IO)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import Final

from msgspec import Struct

from armadico.core.membership import agent_of
from armadico.core.messages import RobotState
from armadico.mobile.behaviour import UNSURE_M
from armadico.mobile.messages import MissionStatus

SLOW_M_S, TURNS_RAD_S = 0.12, 0.25
"""A robot that is slower than both is slow; one that turns on the spot is not."""

ENDS_M: Final = 0.6
"""This near to its start and its goal a robot is slow anyway."""

SPOT_M: Final = 1.0
"""Side of the squares in which slow places are counted."""


class Spot(Struct, frozen=True):
    """A place (m) where the robot was slow, or unsure of its pose: for how long (s), and why."""

    x: float
    y: float
    seconds: float
    why: str


@dataclass
class _Slow:
    seconds: float
    why: Counter[str]


class Slowness:
    """Counts the time of one drive in which the robot was slow or unsure, by place and reason."""

    def __init__(self) -> None:
        self._squares: dict[tuple[int, int], _Slow] = {}

    def update(
        self,
        here: tuple[float, float],
        ends: Sequence[tuple[float, float]],
        state: RobotState,
        status: MissionStatus | None,
        *,
        deviation: float,
        cycle_s: float,
    ) -> None:
        """Add a cycle.

        The robot is `here`, the path's known ends are start and goal, m; the standard deviation of
        its position is m, and a cycle lasts `cycle_s`.
        """
        near = any(hypot(here[0] - x, here[1] - y) < ENDS_M for x, y in ends)
        slow = abs(state.v) < SLOW_M_S and abs(state.w) < TURNS_RAD_S and not near
        unsure = deviation > UNSURE_M
        if not slow and not unsure:
            return
        square = int(here[0] // SPOT_M), int(here[1] // SPOT_M)
        spot = self._squares.setdefault(square, _Slow(0.0, Counter()))
        spot.seconds += cycle_s
        if unsure:
            spot.why["it is unsure of its pose"] += 1
        if slow:
            spot.why[_why(state, status)] += 1

    @property
    def spots(self) -> tuple[Spot, ...]:
        """The places, the first one first, with the most frequent reason of each."""
        return tuple(
            Spot(
                (i + 0.5) * SPOT_M,
                (j + 0.5) * SPOT_M,
                round(each.seconds, 1),
                each.why.most_common(1)[0][0],
            )
            for (i, j), each in self._squares.items()
        )


def _why(state: RobotState, status: MissionStatus | None) -> str:
    if state.capped:
        return state.capped
    if not state.driver:
        return (status.note if status is not None else "") or "no agent drives"
    return f"{agent_of(state.driver)} drives"
