"""The messages of missions, exploring and charging."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Final

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from armadico.core.messages import (
    LARGEST,
    Bits64,
    Counter,
    Cycle,
    Label,
    Latched,
    Message,
    Name,
    Real,
    Share,
    Text,
    TomlValue,
    Volts,
)
from armadico.core.services import event, latch, query, state
from armadico.mobile.errand import Errands, Order, Progress, StepDone
from armadico.mobile.messages import Joules, Leading, MissionReply, Waypoint


class ExploreRequest(Order, frozen=True):
    """Map what can be reached in a rectangle of the world, and come back to where it began."""

    x1: Real
    y1: Real
    x2: Real
    y2: Real
    home: Waypoint | None = None  # where it ends; null: where the robot is now

    @property
    def asks_for(self) -> str:
        """What its kind is called."""
        return "explorations"


class ExploreState(StrEnum):
    """How far an exploration has come."""

    NONE = "none"
    EXPLORING = "exploring"
    RETURNING = "returning"
    DONE = "done"
    FAILED = "failed"


class ExploreStatus(Errands, frozen=True):
    """The explore agent's report: `exploration` is the number that its request was answered."""

    exploration: Bits64
    state: ExploreState
    known: Annotated[float, Meta(ge=0, le=1e12)] = 0.0  # m^2 of the map that are free
    places: Counter = 0  # that it has set out for
    given_up: Counter = 0  # of those, not reached
    note: Text = ""

    @property
    def errands(self) -> tuple[Progress, ...]:
        """The exploration that it is about."""
        why = f": {self.note}" if self.note else ""
        return (
            Progress(
                self.exploration,
                state=self.state.value,
                over=self.state in (ExploreState.DONE, ExploreState.FAILED),
                failed=self.note if self.state is ExploreState.FAILED else "",
                summary=f"exploration {self.state.value}{why}; {self.known:.1f} m^2 known,"
                f" {self.places} places driven to, {self.given_up} of them not reached",
            ),
        )


class BatteryAlarm(Message, frozen=True):
    """The battery is nearly where it has to be charged; said anew for each tenth of a volt."""

    cycle: Cycle
    volts: Volts  # at rest
    share: Share


class EnergyRequest(Message, frozen=True):
    """Asks whether the energy will do: for what is planned, and from its end to a dock."""

    goal: Waypoint  # where it ends
    energy: Joules = 0.0  # that it takes to there


class EnergyReply(Message, frozen=True):
    """Whether it will (thesis 3.2.2, use case 2)."""

    enough: bool
    left: Joules = 0.0
    needed: Joules = 0.0  # to the goal and on to the nearest dock, with a reserve
    note: Text = ""


class ChargeRequest(Message, frozen=True):
    """Asks the battery charger to charge up to a share of a full battery; asked again meanwhile.

    Who does not ask again within 30 s does not want it any more.
    """

    until: Share = 1.0


class ChargeState(StrEnum):
    """What the battery charger does."""

    NONE = "none"
    TO_DOCK = "to-dock"
    DOCKING = "docking"
    CHARGING = "charging"
    LEAVING = "leaving"


class ChargeStatus(Leading, frozen=True):
    """The battery charger's report: of each cycle while the robot is driven into a dock or out."""

    cycle: Cycle
    state: ChargeState
    dock: Waypoint | None = None  # the pose of the robot in it; None: there is none
    name: Label = ""
    note: Text = ""

    @property
    def leads(self) -> bool:
        """Into the dock, and out of it: an agent that follows a trajectory would turn beside it."""
        return self.state in (ChargeState.DOCKING, ChargeState.LEAVING)


class Alarm(Message, frozen=True):
    """An alarm in a room of the world has begun, or is over; anybody may say so."""

    room: Name
    on: bool = True


class Photo(Message, frozen=True):
    """A photo that a mission had taken: without a camera, where and how sure that is."""

    mission: Bits64
    room: Label  # empty: in none that has a name
    x: Real
    y: Real
    theta: Real
    deviation: Annotated[float, Meta(ge=0, le=LARGEST)]  # of the position, m


class Told(Message, frozen=True):
    """What a step of a mission is told, by name: a value of TOML, as JSON."""

    name: Name
    json: Text

    @classmethod
    def of(cls, name: str, value: TomlValue) -> Told:
        """A value by its name."""
        return cls(name, msgspec.json.encode(value).decode())

    @property
    def value(self) -> TomlValue:
        """The value; what is no JSON of one is a text."""
        try:
            value: TomlValue = _VALUE.decode(self.json)
        except (msgspec.DecodeError, RecursionError):
            return self.json
        return value


_VALUE: Final = msgspec.json.Decoder(TomlValue)


class PlanStep(Message, frozen=True):
    """One step of a plan: a task, and what it is told."""

    do: Name
    told: Annotated[tuple[Told, ...], Meta(max_length=16)] = ()

    @classmethod
    def of(cls, do: str, **told: TomlValue) -> PlanStep:
        """A step by its task's name: `PlanStep.of("move", to="R1")`."""
        return cls(do, tuple(Told.of(name, value) for name, value in told.items()))

    def __str__(self) -> str:
        """As the thesis writes it: move(R1)."""
        told = ", ".join(f"{each.value}" for each in self.told)
        return f"{self.do}({told})" if told else self.do


Steps = Annotated[tuple[PlanStep, ...], Meta(max_length=64)]


class Frame(Message, frozen=True):
    """How far a mission is in one list of steps: those of a procedure, or of a detour's plan."""

    procedure: Label = ""  # empty: the mission's own steps,
    detour: Steps = ()  # or these, if there are any
    told: Annotated[tuple[Told, ...], Meta(max_length=16)] = ()  # what the procedure was told
    step: Counter = 0
    attempt: Counter = 0  # 0: the step itself, else which of its alternatives
    turn: Counter = 0  # of its repetitions
    elapsed: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # s that it has been at work on it
    begun: bool = False
    stage: Counter = 0  # the task's own


class StepEnd(StrEnum):
    """How a step of a mission ended."""

    DONE = "done"
    FAILED = "failed"
    PASSED = "passed over"  # its precondition was not believed


class StepResult(Message, frozen=True):
    """What came of one step."""

    step: Text
    end: StepEnd
    said: Text = ""
    at: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # s that the mission was at work by then

    def __str__(self) -> str:
        return str(self.done)

    @property
    def done(self) -> StepDone:
        """As of any errand."""
        return StepDone(self.step, self.end.value, self.said, self.at)


class Course(Message, frozen=True):
    """How far a mission has come: all that is needed to go on with it."""

    frames: Annotated[tuple[Frame, ...], Meta(max_length=32)] = (Frame(),)
    elapsed: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # s that it was at work
    tasks: Counter = 0  # begun so far; tells one from the next
    detour: Steps = ()  # comes before the next step
    drops: Counter = 0  # so many steps are left out then
    results: Annotated[tuple[StepResult, ...], Meta(max_length=100)] = ()  # the newest


class MissionEnd(StrEnum):
    """Where a mission of the board stands."""

    QUEUED = "queued"  # not begun
    ACTIVE = "active"
    SUSPENDED = "suspended"  # begun, and another one is more urgent
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


ENDS: Final = {
    MissionEnd.DONE: "",
    MissionEnd.FAILED: "it failed",
    MissionEnd.CANCELLED: "it was cancelled",
}
"""How a mission ends, and why it is not done."""


class BoardMission(Message, frozen=True):
    """One mission of the board."""

    mission: Bits64
    name: Name
    priority: Share
    state: MissionEnd
    by: Label = ""  # who ordered it
    text: Annotated[bytes, Meta(max_length=16_384)] = (
        b""  # its TOML, deflated; none once it is over
    )
    course: Course = Course()
    doing: Text = ""  # the step that is done now,
    room: Label = ""  # and where
    ahead: Annotated[tuple[Text, ...], Meta(max_length=64)] = ()  # steps to come, the first ones
    note: Text = ""
    way: Bits64 = 0  # on which its task has the robot driven; 0: on none

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self.state in ENDS

    def __str__(self) -> str:
        """In half a line: how many steps are done, and what it does now."""
        done = sum(result.end is StepEnd.DONE for result in self.course.results)
        words = [f"{done} done", self.doing or self.state.value]
        words += [f"{len(self.ahead)} to come"] if self.ahead else []
        return ", ".join([*words, *filter(None, [self.note])])

    @property
    def progress(self) -> Progress:
        """How far it has come, as of any errand."""
        why = ENDS.get(self.state, "")
        return Progress(
            self.mission,
            over=self.over,
            failed=": ".join(filter(None, [why, self.note])) if why else "",
            note=self.note,
            summary=str(self),
            name=self.name,
            state=self.state.value,
            priority=self.priority,
            by=self.by,
            active=self.state is MissionEnd.ACTIVE,
            doing=self.doing,
            room=self.room,
            ahead=self.ahead,
            steps=tuple(each.done for each in self.course.results),
        )


class Board(Latched, Errands, frozen=True):
    """All that mission planning knows: its missions, those that are over last.

    At most one of them is active.
    """

    counter: Counter
    by: Bits64  # drawn at random by each mission planning agent
    missions: Annotated[tuple[BoardMission, ...], Meta(max_length=32)] = ()
    alarms: Annotated[tuple[Name, ...], Meta(max_length=32)] = ()  # rooms where one is on,
    unchecked: Annotated[tuple[Name, ...], Meta(max_length=32)] = ()  # and nobody has been yet

    @property
    def order(self) -> tuple[int, int]:
        """Counted each time it is published."""
        return self.counter, self.by

    @property
    def errands(self) -> tuple[Progress, ...]:
        """Its missions."""
        return tuple(each.progress for each in self.missions)


class MissionOrder(Order, frozen=True):
    """Asks the interface agent to have a mission done; `text` is its TOML, deflated (zlib).

    `mission` is its number, drawn at random by whoever orders it: ordered again it is the same
    mission, and it can be cancelled though nobody has answered. 0: the interface agent draws one.
    """

    name: Name
    text: Annotated[bytes, Meta(max_length=16_384)]
    priority: Share | None = None  # none: its own
    by: Label = ""
    mission: Bits64 = 0

    def numbered(self, number: int) -> MissionOrder:
        """With its number: an order that was refused is withdrawn, and counts as over."""
        return replace(self, mission=number)

    def withdrawal(self) -> MissionCancel:
        """Cancels it."""
        return MissionCancel(self.mission, self.by)


class MissionProposal(Message, frozen=True):
    """The interface agent proposes a mission to mission planning (use case 1 of thesis 3.2)."""

    order: MissionOrder


class MissionCancel(Message, frozen=True):
    """Asks the interface agent to have a mission cancelled; 0: all of them."""

    mission: Bits64
    by: Label = ""


class MissionWithdrawal(Message, frozen=True):
    """The interface agent passes that on to mission planning."""

    cancel: MissionCancel


class NamedPlace(Message, frozen=True):
    """Where the robot stands in a room or at a goal of the world, m."""

    name: Name
    x: Real
    y: Real


PLACES: Final = 256
"""Of a world, that planner agents are told of."""


class SubplanRequest(Message, frozen=True):
    """The coordinator asks the planner agents: what is to be done `before` a mission goes on?

    Only those answer whose card has its `surprise` among its `plans`.
    """

    id: Bits64
    mission: Bits64
    why: Text
    at: Waypoint  # where the robot is,
    room: Label  # and in which room
    before: Steps
    ahead: Steps  # of the mission as it stands
    places: Annotated[tuple[NamedPlace, ...], Meta(max_length=PLACES)] = ()  # that it can move to
    surprise: Label = "alarm"
    """Also `battery` (the energy will not do for the way ahead), `blocked` (no way to where the
    first step `ahead` moves) and `failed` (that step has failed otherwise)."""


class Subplan(Message, frozen=True):
    """A planner agent's answer: the steps, and what they take until the mission's next objective.

    The last of the steps leads to where one of the mission's own does, which is left out then.
    """

    id: Bits64
    planner: Name  # the instance
    steps: Steps
    length: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # m
    energy: Annotated[float, Meta(ge=0, le=1e9)] = 0.0  # J
    refusal: Text = ""


query(ExploreRequest, "explore/request", MissionReply, "map a place")
state(ExploreStatus, "explore/status", 1, None, "how far the exploration has come")
event(BatteryAlarm, "battery/alarm", "it has to be charged soon")
query(EnergyRequest, "battery/enough", EnergyReply, "will it do?")
state(ChargeStatus, "battery/charging", 1, 3, "what the charger does; 10 Hz in the dock")
query(ChargeRequest, "battery/charge", MissionReply, "charge it")
event(Alarm, "alarm", "an alarm in a room; anyone may say so")
query(MissionOrder, "mission/order", MissionReply, "do a mission")
query(MissionCancel, "mission/cancel", MissionReply, "leave one be")
query(MissionProposal, "mission/proposal", MissionReply, "the interface agent passes an order on")
query(MissionWithdrawal, "mission/withdrawal", MissionReply, "and a cancellation")
latch(Board, "mission/board", "the missions, and how far they have come", rate_hz=1)
event(SubplanRequest, "mission/subplan", "asks the planner agents")
event(Subplan, "mission/subplan/answer", "what a planner agent would do")
event(Photo, "mission/photo", "a photo that a mission had taken")
