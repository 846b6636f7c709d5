"""Other robots of the fleet, by their own word: what the local map expects where they are.

A robot says where it is a few times a second. It is expected there, moved on by its speeds for as
long as its word is old, wider by what both poses may be off, and longer by the way that it needs to
stop. Of two robots that drive towards each other each leaves room for the other one to stop, too.
Who has said nothing for a while is expected no more: what stands there the sonars hear.

Poses are in the world's frame, what comes out is in the body's: x forward, y left, origin at the
middle of the wheel axle; metres and radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, hypot, sqrt
from typing import Final

from armadico.agents.methods.near import Obstacle
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import COVARIANCE, FleetPose

OLD_S: Final = 2.0
"""So long a robot's word is believed."""

REACH_M: Final = 3.0
"""Beyond, nobody has to keep clear of it yet."""

STEP_M: Final = 0.12
"""From one place of an outline to the next, at the most: less than any robot fits through."""

WIDEST_M: Final = 0.3
"""However unsure the poses are, it is taken to be wider by no more than this: it is somewhere."""


REACTS_S: Final = 0.5
"""Until another robot brakes: its sensors and its society take so long,"""

BRAKES_M_S2: Final = 0.5
"""and then it brakes by so much, at the least: a Pioneer's ramp is 0.6."""


class KnownRobots:
    def __init__(self, name: str) -> None:
        """Nobody is known yet; `name` is this robot's own."""
        self._name = name
        self._heard: dict[str, tuple[FleetPose, float]] = {}

    def update(self, said: FleetPose, now: float) -> None:
        """Take a robot's word at a time, s."""
        if said.robot != self._name:
            self._heard[said.robot] = (said, now)

    def others(self, now: float) -> dict[str, tuple[FleetPose, Pose2]]:
        """What each robot last said that has said anything of late, and where it is by now, s."""
        self._heard = {r: each for r, each in self._heard.items() if now - each[1] <= OLD_S}
        return {r: (said, moved(said, now - at)) for r, (said, at) in self._heard.items()}

    def points(self, pose: Pose2 | None, covariance: Sequence[float], now: float) -> list[Obstacle]:
        """The outlines of those that are near.

        Args:
            pose: Of this robot; None: nobody knows, and then nobody is near.
            covariance: Of that pose, as in `Pose`.
            now: The time, s.
        """
        if pose is None:
            return []
        found = []
        for said, there in self.others(now).values():
            if hypot(there[0] - pose[0], there[1] - pose[1]) > REACH_M + said.front:
                continue
            wider = min(_off(covariance) + _off(said.covariance), WIDEST_M)
            for x, y in _outline(said, wider):
                ahead, left, _ = relative(pose, compose(there, (x, y, 0.0)))
                found.append(Obstacle(ahead, left, hypot(ahead, left)))
        return found


def moved(said: FleetPose, seconds: float) -> Pose2:
    """Where a robot is by now, if it has gone on as it did."""
    turned = said.w * seconds
    half = (0.0, 0.0, 0.5 * turned)
    there = compose((said.x, said.y, said.theta), half)
    return compose(compose(there, (said.v * seconds, 0.0, 0.0)), half)


def _off(covariance: Sequence[float]) -> float:
    """How far off a pose may be, m: its standard deviation."""
    if len(covariance) < COVARIANCE:
        return 0.0
    return sqrt(max(0.0, covariance[0] + covariance[3]))


def _outline(said: FleetPose, wider: float) -> Iterator[tuple[float, float]]:
    """Places all round a robot, in its own frame."""
    stops = abs(said.v) * REACTS_S + said.v * said.v / (2.0 * BRAKES_M_S2)
    front, rear, side = said.front + wider, said.rear + wider, said.half_width + wider
    if said.v > 0.0:
        front += stops
    else:
        rear += stops
    corners = [(front, side), (-rear, side), (-rear, -side), (front, -side)]
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        steps = ceil(hypot(bx - ax, by - ay) / STEP_M)
        for step in range(steps):
            share = step / steps
            yield ax + share * (bx - ax), ay + share * (by - ay)
