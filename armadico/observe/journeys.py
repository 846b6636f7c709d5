"""The drives to goals in what was received, each from its mission's beginning to its end (sans-IO).

`compared` says how one differed from what was told before it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import dist, hypot
from typing import Any, Final

from msgspec import Struct

from armadico.core.cycles import PERIOD
from armadico.core.messages import Message, Point, RobotState
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Trajectory
from armadico.observe.slowness import Slowness, Spot
from armadico.observe.view import View

WITHIN: Final = 0.1
"""A way that is longer than what was told, by more than this share of it, is named."""

LOST_S: Final = 2.0
"""Time lost at a place, beyond what was told of it, that is named."""


BEGUN_M: Final = 0.5
"""A drive begins no farther from where its path, or its rehearsal, does."""


class Journey(Struct, frozen=True):
    """A drive to a goal."""

    goal: Pose2  # x and y, m, and a heading, rad
    began: float  # when its mission began, s
    seconds: float  # how long it took
    reached: bool  # whether the goal was reached, as the interface agent reports
    way_m: float  # the way, by the estimated pose
    note: str  # why it failed, or what else is known of its end
    slow: tuple[Spot, ...]  # where the robot was slow or unsure
    start: tuple[float, float]  # its first pose, x and y, m
    world: str  # the name of the map on the agents' cards; "": not known


@dataclass
class _Going:
    mission: int
    goal: Pose2
    began: float
    path_start: Point
    start: tuple[float, float] | None = None
    at: tuple[float, float] | None = None
    way_m: float = 0.0
    slow: Slowness = field(default_factory=Slowness)

    def ended(self, t: float, note: str, world: str, *, reached: bool) -> Journey:
        seconds, way, slow = round(t - self.began, 1), round(self.way_m, 1), self.slow.spots
        assert self.start is not None, "else nobody knows where it began"
        return Journey(self.goal, self.began, seconds, reached, way, note, slow, self.start, world)


class Journeys:
    """The drives, from messages in order of time."""

    def __init__(self) -> None:
        self.done: list[Journey] = []
        self._going: _Going | None = None
        self._ways: dict[int, Trajectory] = {}  # by mission
        self._missed: int | None = None  # a mission that was under way before the first message

    def update(self, message: Message, view: View, t: float) -> None:
        """Process a message at a time, s; the view has received it already."""
        match message:
            case Trajectory() if message.waypoints:
                self._ways = {message.mission: message}
                self._begin(view.mission, view, t)
            case MissionStatus():
                self._on_status(message, view, t)
            case Pose() if self._going is not None:
                self._on_pose(self._going, message)
            case RobotState() if self._going is not None:
                self._on_state(self._going, message, view)

    def _begin(self, status: MissionStatus | None, view: View, t: float) -> None:
        going = self._going
        if status is None or status.state is not MissionState.DRIVING:
            return
        if status.mission in (self._missed, None if going is None else going.mission):
            return
        way = self._ways.get(status.mission)
        if way is None:
            return
        if going is not None:
            self._end(view, t, "another mission replaced it", reached=False)
        last = way.waypoints[-1]
        self._going = _Going(status.mission, (last.x, last.y, last.theta), t, way.start)

    def _on_status(self, status: MissionStatus, view: View, t: float) -> None:
        self._begin(status, view, t)
        going = self._going
        if going is None or status.mission != going.mission:
            return
        if status.state in (MissionState.REACHED, MissionState.FAILED):
            self._end(view, t, status.note, reached=status.state is MissionState.REACHED)

    def _end(self, view: View, t: float, note: str, *, reached: bool) -> None:
        going, self._going = self._going, None
        assert going is not None, "one that goes on ends"
        if going.start is not None:
            self.done.append(going.ended(t, note, view.world, reached=reached))

    def _on_pose(self, going: _Going, pose: Pose) -> None:
        here = pose.x, pose.y
        if going.at is None and dist(here, (going.path_start.x, going.path_start.y)) > BEGUN_M:
            # A recorder that joins receives the newest path and status of a mission under way.
            self._going, self._missed = None, going.mission
            return
        if going.at is not None:
            going.way_m += hypot(here[0] - going.at[0], here[1] - going.at[1])
        going.start = going.start or here
        going.at = here

    @staticmethod
    def _on_state(going: _Going, state: RobotState, view: View) -> None:
        pose = view.pose
        if going.at is None or going.start is None or pose is None:
            return
        cycle = PERIOD if view.description is None else view.description.cycle_s
        going.slow.update(
            going.at,
            (going.start, going.goal[:2]),
            state,
            view.mission,
            deviation=pose.deviation,
            cycle_s=cycle,
        )


def compared(driven: Journey, told: Mapping[str, Any]) -> str:
    """How a drive differed from its rehearsal, in a sentence; `told` are a rehearsal's fields."""
    times, (x, y, _) = told["time_s"], driven.goal
    spread = f" in {times[1]:.0f} s ({times[0]:.0f} to {times[-1]:.0f})" if times else ""
    said = f"{told['arrives']} of {told['samples']} arrive{spread}"
    head = f"To ({x:.1f}, {y:.1f}): rehearsed: {told['answer']}, {said}; driven: "
    if not driven.reached:
        why = f": {driven.note}" if driven.note else ""
        return f"{head}not reached after {driven.seconds:.0f} s{why}{_since(driven, told)}."
    went = f"reached in {driven.seconds:.0f} s over {driven.way_m:.1f} m"
    if not times:
        return f"{head}{went}."
    if driven.seconds > times[-1]:
        return f"{head}{went}, {driven.seconds - times[1]:.0f} s longer{_since(driven, told)}."
    if driven.seconds < times[0]:
        return f"{head}{went}, {times[1] - driven.seconds:.0f} s faster."
    return f"{head}{went}, as told."


def _since(driven: Journey, told: Mapping[str, Any]) -> str:
    """Where time was lost that the rehearsal did not lose, and how much longer the way was."""
    known = {(each["x"], each["y"]): each["seconds"] for each in told["slow"]}
    lost: Counter[tuple[float, float, str]] = Counter()
    for spot in driven.slow:
        more = spot.seconds - known.get((spot.x, spot.y), 0.0)
        if more >= LOST_S:
            lost[spot.x, spot.y, spot.why] = round(more)
    found = [
        f"it was slow for {s} s near ({x:.1f}, {y:.1f}): {why}"
        for (x, y, why), s in lost.most_common(2)
    ]
    if told["way_m"] and driven.way_m > (1.0 + WITHIN) * told["way_m"]:
        found.append(f"the way was {driven.way_m - told['way_m']:.1f} m longer")
    return f", since {'; '.join(found)}" if found else ""
