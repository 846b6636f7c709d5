"""What the steps of a mission ask for: the pattern of a task, yours among them (entry points).

A task is asked again and again what it wants now, until it says that it is done or has failed. It
keeps nothing: what it answers comes from its arguments, from what is believed, and from how far it
has come, so a mission goes on from its published state in another process.

    class Greet(Task):  # goes to a room and says good morning
        class Arguments(Task.Arguments, frozen=True):
            room: str

        places = ("room",)

        def look(self, beliefs, progress):
            if progress.state is not Reach.DONE:
                return Going(Drive(self.arguments.room))
            return Done("good morning")
"""

from __future__ import annotations

from enum import Enum
from typing import Any, ClassVar

from msgspec import Struct

from armadico.agents.missions.messages import ChargeRequest, ExploreRequest
from armadico.core.messages import LARGEST_COUNT, Message, encode
from armadico.mobile.messages import Waypoint


class Beliefs(Struct, frozen=True):
    """What is believed when a task is looked at.

    Attributes:
        at: Where the robot is, m and rad in the world; None: nobody knows.
        deviation: Standard deviation of that, m.
        room: The room that it is in; empty: none that has a name, or nobody knows.
        battery: The share of a full battery that is left; None: nobody says.
        charging: Whether it stands at a dock that charges.
        alarms: The rooms with an alarm that is on.
    """

    at: Waypoint | None = None
    deviation: float = 0.0
    room: str = ""
    battery: float | None = None
    charging: bool = False
    alarms: frozenset[str] = frozenset()


class Reach(Enum):
    """How far what a task asked for has come."""

    NONE = "not asked for"
    UNDER_WAY = "under way"
    DONE = "done"
    FAILED = "failed"


class Progress(Struct, frozen=True):
    """How far a task has come.

    Attributes:
        elapsed: Since its step began, s; while the mission was suspended is not counted.
        state: Of what it last asked for.
        note: Why that failed, or what keeps it.
        stage: The task's own number, as it last answered; 0 at first.
    """

    elapsed: float = 0.0
    state: Reach = Reach.NONE
    note: str = ""
    stage: int = 0


class Stand(Struct, frozen=True):
    """Let the robot stand where it is."""


class Drive(Struct, frozen=True):
    """Have the robot driven to a place by its name, or to a pose: m, m, rad in the world."""

    to: str | tuple[float, float, float]


class Explore(Struct, frozen=True):
    """Have a rectangle of the world mapped, m; None: all of it."""

    within: tuple[float, float, float, float] | None = None


class Charge(Struct, frozen=True):
    """Have the battery charged at a dock, up to a share of a full one."""

    until: float = 1.0


Request = Stand | Drive | Explore | Charge


class Going(Struct, frozen=True):
    """It wants this now; `stage` is what it wants to be told the next time.

    A request that differs from the last one is a new one; so is one of another stage.
    """

    request: Request = Stand()
    stage: int = 0


class Done(Struct, frozen=True):
    """It is done: what came of it for people, and an event to be published."""

    said: str = ""
    event: Message | None = None


class Failed(Struct, frozen=True):
    """It cannot be done."""

    why: str


Verdict = Going | Done | Failed


def misfit(verdict: Any) -> str:
    """What is wrong with an answer that no task may give; "" if nothing is."""
    match verdict:
        case Done(said=str(), event=None | Message()) | Failed(why=str()):
            return ""
        case Done():
            return "said is a text, and event a message"
        case Failed():
            return "why is a text"
        case Going(request=request, stage=int(stage)) if 0 <= stage <= LARGEST_COUNT:
            return _misfit_request(request)
        case Going():
            return "stage is a whole number, 0 or more"
    return "that is no Going, Done or Failed"


def _misfit_request(request: Any) -> str:
    """By the messages that are to be sent for it."""
    try:
        match request:
            case Stand() | Drive(to=str()) | Explore(within=None):
                return ""
            case Drive():
                pose: Any = request.to
                x, y, theta = pose
                encode(Waypoint(x, y, theta))
            case Explore():
                rectangle: Any = request.within
                x1, y1, x2, y2 = rectangle
                encode(ExploreRequest(x1, y1, x2, y2))
            case Charge(until=share):
                encode(ChargeRequest(share))
            case _:
                return "request is a Stand, Drive, Explore or Charge"
    except (TypeError, ValueError) as error:
        return str(error)
    return ""


class Task:
    """One kind of step, found by its entry point in `armadico.tasks`; the name there is its `do`.

    Attributes:
        places: Those of its arguments that name places: they are looked up in the world.
        breaks_off: Whether something unexpected may end it before its time, to begin it again
            afterwards; else it is finished first.
    """

    class Arguments(Struct, frozen=True, forbid_unknown_fields=True):
        """The keys of a step besides those that all steps have."""

    places: ClassVar[tuple[str, ...]] = ()
    breaks_off: ClassVar[bool] = True

    def __init__(self, arguments: Any) -> None:
        self.arguments: Any = arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        """What it wants now, or how it ended."""
        raise NotImplementedError("look(self, beliefs, progress) says what the task wants")
