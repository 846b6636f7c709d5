"""The messages of missions, exploring and charging."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

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
)
from armadico.core.services import event, latch, query, state
from armadico.mobile.errand import Errands, Order, Progress, StepDone
from armadico.mobile.messages import UNSURE, Joules, Leading, MissionReply, Terms, Waypoint


class ExploreRequest(Order, frozen=True):
    """Requests to explore a rectangle of the world, and to end at `home`."""

    x1: Real
    y1: Real
    x2: Real
    y2: Real
    home: Waypoint | None = None  # where it ends; null: where the robot is now

    @property
    def kind_name(self) -> str:
        """The name of this kind of errand."""
        return "explorations"


class ExploreState(StrEnum):
    """The state of an exploration."""

    NONE = "none"
    EXPLORING = "exploring"
    RETURNING = "returning"
    DONE = "done"
    FAILED = "failed"


class ExploreStatus(Errands, frozen=True):
    """The explore agent's report; `exploration` is the number of the reply to its request.

    One that is done with a note is back as far as the pose is known, which is not far enough.
    """

    exploration: Bits64
    state: ExploreState
    known: Annotated[float, Meta(ge=0, le=1e12)] = 0.0  # m^2 of the map that are free
    places: Counter = 0  # driven to
    given_up: Counter = 0  # of those, not reached
    note: Text = ""

    @property
    def errands(self) -> tuple[Progress, ...]:
        """The exploration, as the only errand."""
        why = f": {self.note}" if self.note else ""
        return (
            Progress(
                self.exploration,
                state=self.state.value,
                over=self.state in (ExploreState.DONE, ExploreState.FAILED),
                failed=self.note if self.state is ExploreState.FAILED else "",
                doubt=self.note if self.state is ExploreState.DONE else "",
                summary=f"exploration {self.state.value}{why}; {self.known:.1f} m^2 known,"
                f" {self.places} places driven to, {self.given_up} of them not reached",
            ),
        )


class EnergyRequest(Message, frozen=True):
    """Queries whether the energy suffices for a plan, and from its end to a dock."""

    goal: Waypoint  # where the plan ends
    energy: Joules = 0.0  # that the plan takes


class EnergyReply(Message, frozen=True):
    """Whether the energy suffices (thesis 3.2.2, use case 2)."""

    enough: bool
    left: Joules = 0.0
    needed: Joules = 0.0  # to the goal and on to the nearest dock, with a reserve
    note: Text = ""


class ChargeRequest(Message, frozen=True):
    """Requests charging up to a share of a full battery; must be repeated within 30 s."""

    until: Share = 1.0


class ChargeState(StrEnum):
    """The state of the battery charger."""

    NONE = "none"
    TO_DOCK = "to-dock"
    DOCKING = "docking"
    CHARGING = "charging"
    LEAVING = "leaving"


class ChargeStatus(Leading, frozen=True):
    """The battery charger's report; each cycle while the robot is driven into a dock or out."""

    cycle: Cycle
    state: ChargeState
    dock: Waypoint | None = None  # the robot's pose in the dock
    name: Label = ""
    note: Text = ""

    @property
    def leads(self) -> bool:
        """Whether the dock agent drives: agents that follow a trajectory would turn off course."""
        return self.state in (ChargeState.DOCKING, ChargeState.LEAVING)


class Alarm(Message, frozen=True):
    """An alarm in a room of the world begins or ends; any agent or program may publish it."""

    room: Name
    on: bool = True


class Photo(Message, frozen=True):
    """A photo that a mission took: without a camera, the pose and its deviation."""

    mission: Bits64
    room: Label  # empty: in no named room
    x: Real
    y: Real
    theta: Real
    deviation: Annotated[float, Meta(ge=0, le=LARGEST)]  # standard deviation of the position, m


class Told(Message, frozen=True):
    """One named argument of a mission's step: a value of TOML, encoded as JSON."""

    name: Name
    json: Text

    @classmethod
    def of(cls, name: str, value: TomlValue) -> Told:
        return cls(name, msgspec.json.encode(value).decode())

    @property
    def value(self) -> TomlValue:
        """The decoded value; text that is not JSON is returned as it is."""
        try:
            value: TomlValue = _VALUE.decode(self.json)
        except (msgspec.DecodeError, RecursionError):
            return self.json
        return value


_VALUE: Final = msgspec.json.Decoder(TomlValue)


class PlanStep(Message, frozen=True):
    """One step of a plan: a task and its arguments."""

    do: Name
    told: Annotated[tuple[Told, ...], Meta(max_length=16)] = ()

    @classmethod
    def of(cls, do: str, **told: TomlValue) -> PlanStep:
        """Return a step by its task's name: `PlanStep.of("move", to="R1")`."""
        return cls(do, tuple(Told.of(name, value) for name, value in told.items()))

    @property
    def place(self) -> TomlValue | None:
        """Where it moves to, or None."""
        arguments = {each.name: each.value for each in self.told}
        return arguments.get("to") if self.do == "move" else None

    def __str__(self) -> str:
        """In the notation of the thesis: move(R1)."""
        arguments = ", ".join(f"{each.value}" for each in self.told)
        return f"{self.do}({arguments})" if arguments else self.do


Steps = Annotated[tuple[PlanStep, ...], Meta(max_length=64)]


class Frame(Message, frozen=True):
    """The progress in one list of steps: those of a procedure, or of a detour's plan."""

    procedure: Label = ""  # empty: the mission's own steps
    detour: Steps = ()  # replaces the procedure's steps, unless empty
    told: Annotated[tuple[Told, ...], Meta(max_length=16)] = ()  # the procedure's arguments
    step: Counter = 0
    attempt: Counter = 0  # 0: the step itself, else the number of its alternative
    turn: Counter = 0  # the step's repetitions so far
    elapsed: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # time spent on the step, s
    begun: bool = False
    stage: Counter = 0  # the task's own
    doubt: Text = ""  # why it is unknown whether its request was done; empty: it was

    appended: ClassVar[int] = 1


class StepEnd(StrEnum):
    """The result of a mission's step."""

    DONE = "done"
    FAILED = "failed"
    PASSED = "passed over"  # its precondition did not hold


class StepResult(Message, frozen=True):
    """The result of one step."""

    step: Text
    end: StepEnd
    said: Text = ""
    at: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # the mission's time at work by then, s
    doubt: Text = ""  # why it is unknown whether a step that is done is; empty: it is

    appended: ClassVar[int] = 1

    def __str__(self) -> str:
        return str(self.done)

    @property
    def done(self) -> StepDone:
        """The result in the form that all errands share."""
        end = UNSURE if self.doubt else self.end.value
        return StepDone(self.step, end, self.doubt or self.said, self.at)


class Course(Message, frozen=True):
    """The progress of a mission: all that is needed to go on with it."""

    frames: Annotated[tuple[Frame, ...], Meta(max_length=32)] = (Frame(),)
    elapsed: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # time at work, s
    tasks: Counter = 0  # begun so far; distinguishes a task from the next
    detour: Steps = ()  # done before the next step
    drops: Counter = 0  # the number of steps that the detour replaces
    results: Annotated[tuple[StepResult, ...], Meta(max_length=100)] = ()  # the newest
    doubt: Text = ""  # of the first step of which it is unknown whether it is done

    appended: ClassVar[int] = 1


class MissionEnd(StrEnum):
    """The state of a mission on the board."""

    QUEUED = "queued"  # not begun
    ACTIVE = "active"
    SUSPENDED = "suspended"  # begun, while another one is more urgent
    DONE = "done"  # with a note: unsure, since a step may not be
    FAILED = "failed"
    CANCELLED = "cancelled"


# The states of a mission that is over, with the reason why it is not done.
ENDS: Final = {
    MissionEnd.DONE: "",
    MissionEnd.FAILED: "it failed",
    MissionEnd.CANCELLED: "it was cancelled",
}


class BoardMission(Message, frozen=True):
    """One mission on the board."""

    mission: Bits64
    name: Name
    priority: Share
    state: MissionEnd
    by: Label = ""  # the person or program that ordered it
    text: Annotated[bytes, Meta(max_length=16_384)] = (
        b""  # its TOML, deflated; empty once it is over
    )
    course: Course = Course()
    doing: Text = ""  # the current step
    room: Label = ""  # the current room
    ahead: Annotated[tuple[Text, ...], Meta(max_length=64)] = ()  # the next steps
    note: Text = ""
    way: Bits64 = 0  # the path that its task has the robot driven on; 0: none
    terms: Terms | None = None  # of its paths

    appended: ClassVar[int] = 1

    @property
    def over(self) -> bool:
        """Whether the mission has ended."""
        return self.state in ENDS

    @property
    def outcome(self) -> str:
        """The state for people and JSON: `unsure` if it is done only perhaps."""
        return UNSURE if self.doubt else self.state.value

    @property
    def doubt(self) -> str:
        """Why it is unknown whether it is done; "" if it is, or is not over."""
        return self.note if self.state is MissionEnd.DONE else ""

    def __str__(self) -> str:
        """The number of steps done, the current step, and the note."""
        done = sum(result.done.end == StepEnd.DONE for result in self.course.results)
        words = [f"{done} done", self.doing or self.outcome]
        words += [f"{len(self.ahead)} to come"] if self.ahead else []
        return ", ".join([*words, *filter(None, [self.note])])

    @property
    def progress(self) -> Progress:
        """The progress in the form that all errands share."""
        why = ENDS.get(self.state, "")
        return Progress(
            self.mission,
            over=self.over,
            failed=": ".join(filter(None, [why, self.note])) if why else "",
            doubt=self.doubt,
            note=self.note,
            summary=str(self),
            name=self.name,
            state=self.outcome,
            priority=self.priority,
            by=self.by,
            active=self.state is MissionEnd.ACTIVE,
            doing=self.doing,
            room=self.room,
            ahead=self.ahead,
            steps=tuple(each.done for each in self.course.results),
        )


class Board(Latched, Errands, frozen=True):
    """The state of mission planning: all missions, finished ones last.

    At most one of them is active.
    """

    counter: Counter
    by: Bits64  # drawn at random by each mission planning agent
    missions: Annotated[tuple[BoardMission, ...], Meta(max_length=32)] = ()
    alarms: Annotated[tuple[Name, ...], Meta(max_length=32)] = ()  # rooms with an active alarm
    unchecked: Annotated[tuple[Name, ...], Meta(max_length=32)] = ()  # of those, not yet visited

    @property
    def order(self) -> tuple[int, int]:
        """The order of boards: the counter first."""
        return self.counter, self.by

    @property
    def errands(self) -> tuple[Progress, ...]:
        """The progress of its missions."""
        return tuple(each.progress for each in self.missions)


class NamedPlace(Message, frozen=True):
    """A place in a room or at a goal of the world where the robot can stand, m."""

    name: Name
    x: Real
    y: Real


PLACES: Final = 256  # of a world that are sent to planner agents


class SubplanRequest(Message, frozen=True):
    """The coordinator requests plans: what should be done `before` a mission goes on?

    Planner agents reply whose card has the `surprise` among its `plans`.
    """

    id: Bits64
    mission: Bits64
    why: Text
    at: Waypoint  # where the robot is
    room: Label  # the robot's room
    before: Steps
    ahead: Steps  # the mission's remaining steps
    places: Annotated[tuple[NamedPlace, ...], Meta(max_length=PLACES)] = ()  # that it can move to
    surprise: Label = "alarm"  # or battery, blocked, failed (the first step `ahead`)


class Subplan(Message, frozen=True):
    """A planner agent's plan: the steps, and their cost until the mission's next objective.

    The last of its steps moves where one of the mission's own steps does, and replaces that.
    """

    id: Bits64
    planner: Name  # the instance
    steps: Steps
    length: Annotated[float, Meta(ge=0, le=LARGEST)] = 0.0  # m
    energy: Annotated[float, Meta(ge=0, le=1e9)] = 0.0  # J
    refusal: Text = ""


query(ExploreRequest, "explore/request", MissionReply, "explore and map a rectangle")
state(ExploreStatus, "explore/status", 1, None, "the progress of the exploration")
query(EnergyRequest, "battery/enough", EnergyReply, "does the energy suffice?")
state(ChargeStatus, "battery/charging", 1, 3, "the charger's state; 10 Hz in the dock")
query(ChargeRequest, "battery/charge", MissionReply, "charge the battery")
event(Alarm, "alarm", "an alarm in a room; any program may publish it", several=True, guests=True)
latch(Board, "mission/board", "the missions and their progress", rate_hz=1)
event(SubplanRequest, "mission/subplan", "a request to the planner agents")
event(Subplan, "mission/subplan/answer", "a planner agent's plan", several=True, sender="planner")
event(Photo, "mission/photo", "a photo that a mission took")
