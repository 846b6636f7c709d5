"""When a mission is due, what delays it, and whether it is reached. Sans-IO.

A mission is due after `START_S` and the time that its path takes at a slow pace. Where the progress
falls behind that pace, the time is counted for the present cause. A person's doing, a stop or
driving by hand, postpones the due time. So does a published cap below that pace, for at most the
time that was allowed at first: a robot that is capped for ever is late. Whatever else delays a
mission makes it late.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from math import degrees, hypot, inf
from typing import Final

from armadico.core.membership import agent_of
from armadico.core.messages import RobotState
from armadico.mobile.behaviour import LOST_M, UNSURE_M, heeded
from armadico.mobile.messages import Pose, Waypoint

PACE_M_S: Final = 0.25
"""The pace that is expected, m/s. It was chosen in the shipped scenarios, where missions without
faults are driven at 0.3 m/s and more on average."""

PACE_SHARE: Final = 0.4
"""The pace is at most this share of the robot's top speed."""

START_S: Final = 20.0
"""The time that is allowed beside the way, s: to plan, to turn at the start, and to park."""

SURE: Final = 1.25
"""A goal is reached for sure if the pose is within so many tolerances of it even when it is off by
its deviation. That is 0.15 m by default, as `reached` of a run."""

NAMED: Final = 3
"""At most so many causes are named."""

LEAST_SHARE: Final = 0.1
"""A cause with less than this share of the delay is not named."""

HEEDED_M_S: Final = 0.01
"""An order that is lower by less is still the highest under a cap."""


@dataclass
class Schedule:
    """The due time of one mission."""

    due_at: float = inf  # when it is due, s; inf: there is no mission
    _pace: float = PACE_M_S
    _at: float = 0.0
    _to_go: float = 0.0
    _spare_s: float = 0.0  # by so much caps may still postpone it, s
    _delays: Counter[str] = field(default_factory=Counter)  # s, by cause
    _postponed: Counter[str] = field(default_factory=Counter)  # s, by cause

    @classmethod
    def begin(cls, now: float, to_go: float, top: float) -> Schedule:
        """The schedule of a mission with `to_go` m left, for a robot with a top speed in m/s."""
        pace = min(PACE_M_S, PACE_SHARE * top)
        allowed = START_S + to_go / pace
        return cls(now + allowed, pace, now, to_go, allowed)

    def update(
        self,
        now: float,
        to_go: float,
        cause: str,
        *,
        persons: bool = False,
        cap: float = inf,
        wanted: float = inf,
    ) -> None:
        """Count the time since the last update.

        Args:
            now: s.
            to_go: m left. A path that has become longer is due as much later.
            cause: What delays the mission now, if it makes no progress.
            persons: Whether the cause is a person's doing, which postpones the due time.
            cap: The speed that a published cap leaves, m/s; inf: there is none.
            wanted: The speed that would be driven without the cap, m/s. What that lacks of the pace
                is the agent's own delay.
        """
        passed, nearer = max(now - self._at, 0.0), self._to_go - to_go
        self._at, self._to_go = now, to_go
        if persons:
            self.due_at += passed
            self._postponed[cause] += passed  # type: ignore[assignment]
        elif nearer < 0.0:
            self.due_at -= nearer / self._pace
        elif (lost := passed - nearer / self._pace) > 0.0:
            taken = max(min(wanted, self._pace) - cap, 0.0)  # m/s, by the cap
            spared = min(lost, self._spare_s, taken / self._pace * passed)
            self.due_at, self._spare_s = self.due_at + spared, self._spare_s - spared
            for counts, s in ((self._postponed, spared), (self._delays, lost - spared)):
                if s > 0.0:
                    counts[cause] += s  # type: ignore[assignment]

    def due_s(self, now: float) -> float | None:
        """Seconds until the mission is due; negative: it is late; None: there is none."""
        return None if self.due_at == inf else self.due_at - now

    def late(self, now: float) -> str:
        """By how much the mission is late, and by which causes; "" if it is not."""
        if now < self.due_at + 1.0:
            return ""
        besides = [f"not counted: {s:.0f} s {c}" for c, s in self._postponed.items() if s >= 1.0]
        why = "; ".join([self.causes or "the way took longer than expected", *besides])
        return f"{now - self.due_at:.0f} s late: {why}"

    @property
    def causes(self) -> str:
        """What has delayed the mission, with the times; "" if nothing has."""
        whole = sum(self._delays.values())
        return ", ".join(
            f"{cause} ({s:.0f} s)"
            for cause, s in self._delays.most_common(NAMED)
            if s >= LEAST_SHARE * whole
        )

    @property
    def main_cause(self) -> str:
        """The cause of most of the delay; "" if there is none."""
        return max(self._delays, key=self._delays.__getitem__, default="")


def cap_of(state: RobotState | None) -> float:
    """Return the speed that a published cap leaves of what was ordered, m/s; inf: there is none."""
    if state is None or not state.capped or abs(state.admitted.v) >= abs(state.ordered.v):
        return inf
    return abs(state.admitted.v)


def wanted_of(state: RobotState | None) -> float:
    """Return the speed that the driver wants, m/s; inf: as fast as it may, or unknown.

    A behaviour under a cap orders `heeded` at most, so such an order is no slowness of its own.
    """
    if state is None or abs(state.ordered.v) >= heeded(state.admitted.v) - HEEDED_M_S:
        return inf
    return abs(state.ordered.v)


def delay(state: RobotState | None, pose: Pose | None, waits: str | None) -> str:
    """Return what delays the robot now, by what the interface agent itself has received.

    State and pose are None if there is no fresh one. `waits` is why no path is free; None: there is
    one.
    """
    if state is None:
        return "no message from the robot"
    if pose is None:
        return "no pose is published"
    if pose.deviation > LOST_M:
        return "lost"
    if waits is not None:
        return waits or "waits: no path is free"
    if not state.driver:
        return "no agent drives"
    name, ordered = agent_of(state.driver), state.ordered
    if cap_of(state) < inf:
        return f"the robot agent slows {name} down: {state.capped}"
    if state.stalled:
        return f"{name} drives, and the robot is held by a contact, or its wheels are blocked"
    if pose.deviation > UNSURE_M:
        return f"{name} drives slowly, as the pose is uncertain"
    return f"{name} drives too slowly" if ordered.v or ordered.w else f"{name} stands"


def doubt(pose: Pose, goal: Waypoint, near_m: float, turned_rad: float) -> str:
    """Return why a pose does not tell that the robot is at its goal; "" if it does.

    The mission ends in any case: a pose does not get better while the robot stands.
    """
    off = hypot(goal.x - pose.x, goal.y - pose.y)
    if not pose.covariance:
        return f"arrived by a pose of unknown error: {off:.2f} m from the goal"
    if off + pose.deviation <= SURE * near_m and pose.heading_deviation <= turned_rad:
        return ""
    return (
        f"arrived as far as the pose is known: {off:.2f} m from the goal, +-{pose.deviation:.2f} m"
        f" and +-{degrees(pose.heading_deviation):.0f} degrees, for a tolerance of {near_m:.2f} m"
        f" and {degrees(turned_rad):.0f} degrees"
    )
