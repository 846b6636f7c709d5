"""The stages of driving the robot to a goal, in one table for all agents.

An agent either contends for the planner and the trajectory itself (an errand of the missions), or
requests the drive from the interface agent (`Ordered`). Both follow `TRANSITIONS`, and so does the
interface agent. An event without an entry for the stage changes nothing.
"""

from __future__ import annotations

from enum import StrEnum
from math import inf
from typing import Final

from armadico.mobile.messages import MissionReply, MissionState, MissionStatus

NEARER_M: Final = 0.1  # a robot that is nearer by this has made progress


class Stage(StrEnum):
    """The progress of an errand."""

    NONE = "none"
    PLANNING = "planning"  # a path was requested
    WITHDRAWN = "withdrawn"  # cancelled while the reply is pending
    WAITING = "waiting"  # there is a path, which is not driven now
    DRIVING = "driving"
    REACHED = "reached"
    FAILED = "failed"


class Event(StrEnum):
    """The events of an errand."""

    ASKED = "a path is requested"
    WITHDRAWN = "it ends, and a reply is pending"
    ENDED = "it ends"
    TAKEN = "there is a path"
    REFUSED = "there is no path"
    DRIVEN = "its path is driven"
    INTERRUPTED = "another path is driven"
    REACHED = "the robot has reached the goal"
    FAILED = "its path was abandoned"


UNDER_WAY: Final = frozenset({Stage.PLANNING, Stage.WAITING, Stage.DRIVING})

TRANSITIONS: Final[dict[tuple[Stage, Event], Stage]] = {
    (Stage.NONE, Event.ASKED): Stage.PLANNING,
    (Stage.NONE, Event.TAKEN): Stage.WAITING,  # a path from before
    (Stage.PLANNING, Event.TAKEN): Stage.WAITING,
    (Stage.PLANNING, Event.REFUSED): Stage.FAILED,
    (Stage.PLANNING, Event.WITHDRAWN): Stage.WITHDRAWN,
    (Stage.WITHDRAWN, Event.TAKEN): Stage.NONE,
    (Stage.WITHDRAWN, Event.REFUSED): Stage.NONE,
    (Stage.WAITING, Event.DRIVEN): Stage.DRIVING,
    (Stage.WAITING, Event.REACHED): Stage.REACHED,
    (Stage.WAITING, Event.FAILED): Stage.FAILED,
    (Stage.DRIVING, Event.INTERRUPTED): Stage.WAITING,
    (Stage.DRIVING, Event.REACHED): Stage.REACHED,
    (Stage.DRIVING, Event.FAILED): Stage.FAILED,
    **{(stage, Event.ENDED): Stage.NONE for stage in Stage if stage is not Stage.WITHDRAWN},
}

_REPORTED: Final = {
    MissionState.DRIVING: Event.DRIVEN,
    MissionState.REACHED: Event.REACHED,
    MissionState.FAILED: Event.FAILED,
}


def event_of(status: MissionStatus, mission: int) -> Event:
    """Return the event that a status of the interface agent is for the errand of a mission."""
    if status.mission != mission:
        return Event.INTERRUPTED
    return _REPORTED.get(status.state, Event.INTERRUPTED)


def following(stage: Stage, event: Event) -> Stage:
    return TRANSITIONS.get((stage, event), stage)


class Ordered:
    """A goal that an agent requests from the interface agent.

    Attributes:
        stage: The progress.
        mission: Its number; 0: none yet.
        leg: The leg of its path that the robot is on.
        to_go: The remaining length of its path, m.
        nearer_at: When the robot last came nearer to the goal, s.
        own: The numbers of all missions requested by this object.
    """

    def __init__(self) -> None:
        self.stage = Stage.NONE
        self.mission = self.leg = 0
        self.to_go = self._nearest = inf
        self.nearer_at = 0.0
        self.own: set[int] = set()

    @property
    def pending(self) -> bool:
        """Whether a reply is still to come."""
        return self.stage in (Stage.PLANNING, Stage.WITHDRAWN)

    def request(self, now: float) -> None:
        """Note that it is requested; only after `drop`, and while no reply is pending."""
        self._on(Event.ASKED)
        self.to_go = self._nearest = inf
        self.nearer_at = now

    def drop(self) -> None:
        """End it. A pending reply must still be passed to `answered`."""
        self._on(Event.WITHDRAWN if self.pending else Event.ENDED)
        self.mission = self.leg = 0

    def answered(self, reply: MissionReply | None, now: float) -> str:
        """Process the reply; return why it was refused, "" if it was not."""
        if reply is None or reply.refusal:
            self._on(Event.REFUSED)
            return "no interface agent answers" if reply is None else reply.refusal
        self.own.add(reply.mission)
        withdrawn = self.stage is Stage.WITHDRAWN
        self._on(Event.TAKEN)
        if not withdrawn:
            self.mission, self.nearer_at = reply.mission, now
            self.to_go = self._nearest = reply.length
        return ""

    def update(self, status: MissionStatus, now: float) -> Event | None:
        """Process a status; return its event, None if nothing has changed."""
        if not self.mission or (status.mission != self.mission and status.mission in self.own):
            return None
        event = event_of(status, self.mission)
        before = self.stage
        if status.mission == self.mission:
            self.leg, self.to_go = status.leg, status.to_go
            if status.to_go < self._nearest - NEARER_M:
                self._nearest, self.nearer_at = status.to_go, now
        self._on(event)
        changed = self.stage is not before or status.mission != self.mission
        return event if changed else None

    def _on(self, event: Event) -> None:
        self.stage = following(self.stage, event)
