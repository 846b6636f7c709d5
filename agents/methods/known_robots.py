"""The other robots of the fleet, by their own reports, as expected obstacles of the local map.

A robot reports its pose a few times per second. Until the next report it is expected where its
speeds lead, wider by the uncertainty of both poses, and longer by its stopping distance. Of two
robots that approach each other, each leaves room for the other to stop. A robot that has not
reported for a while is no longer expected: sensors detect what stands there.

Poses are in the world frame, results in the body frame: x forward, y left, origin at the middle of
the wheel axle; metres and radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil, hypot, sqrt
from typing import Final

from armadico.agents.methods.near import Obstacle
from armadico.mobile.geometry import Pose2, compose, relative
from armadico.mobile.messages import COVARIANCE, FleetPose

STALE_S: Final = 2.0
"""Time for which a report is valid."""

REACH_M: Final = 3.0
"""Robots farther away are ignored."""

STEP_M: Final = 0.12
"""Greatest distance between points of an outline: no robot fits through."""

WIDEST_M: Final = 0.3
"""Greatest enlargement for uncertain poses: the robot may be anywhere near."""


REACTS_S: Final = 0.5
"""Time until another robot brakes: the delay of its sensors and its society."""

BRAKES_M_S2: Final = 0.5
"""Least deceleration of another robot: a Pioneer's ramp is 0.6."""


class KnownRobots:
    def __init__(self, name: str) -> None:
        """Prepare without other robots; `name` is this robot's own."""
        self._name = name
        self._reports: dict[str, tuple[FleetPose, float]] = {}

    def update(self, report: FleetPose, now: float) -> None:
        """Store a robot's report at a time, s."""
        if report.robot != self._name:
            self._reports[report.robot] = (report, now)

    def others(self, now: float) -> dict[str, tuple[FleetPose, Pose2]]:
        """The valid reports, each with the robot's present pose, at a time, s."""
        self._reports = {r: each for r, each in self._reports.items() if now - each[1] <= STALE_S}
        return {r: (report, moved(report, now - at)) for r, (report, at) in self._reports.items()}

    def points(self, pose: Pose2 | None, covariance: Sequence[float], now: float) -> list[Obstacle]:
        """The outlines of the robots that are near.

        None are near an unknown pose. Its covariance is as in `Pose`.
        """
        if pose is None:
            return []
        found = []
        for report, there in self.others(now).values():
            if hypot(there[0] - pose[0], there[1] - pose[1]) > REACH_M + report.front:
                continue
            wider = min(_deviation(covariance) + _deviation(report.covariance), WIDEST_M)
            for x, y in _outline(report, wider):
                ahead, left, _ = relative(pose, compose(there, (x, y, 0.0)))
                found.append(Obstacle(ahead, left, hypot(ahead, left)))
        return found


def moved(report: FleetPose, seconds: float) -> Pose2:
    """A robot's pose after some time at its reported speeds."""
    turned = report.w * seconds
    half = (0.0, 0.0, 0.5 * turned)
    there = compose((report.x, report.y, report.theta), half)
    return compose(compose(there, (report.v * seconds, 0.0, 0.0)), half)


def _deviation(covariance: Sequence[float]) -> float:
    """Standard deviation of a position, m."""
    if len(covariance) < COVARIANCE:
        return 0.0
    return sqrt(max(0.0, covariance[0] + covariance[3]))


def _outline(report: FleetPose, wider: float) -> Iterator[tuple[float, float]]:
    """Points of a robot's outline, in its own frame."""
    stops = abs(report.v) * REACTS_S + report.v * report.v / (2.0 * BRAKES_M_S2)
    front, rear, side = report.front + wider, report.rear + wider, report.half_width + wider
    if report.v > 0.0:
        front += stops
    else:
        rear += stops
    corners = [(front, side), (-rear, side), (-rear, -side), (front, -side)]
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        steps = ceil(hypot(bx - ax, by - ay) / STEP_M)
        for step in range(steps):
            share = step / steps
            yield ax + share * (bx - ax), ay + share * (by - ay)
