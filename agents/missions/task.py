"""The tasks of a mission's steps: the base class of shipped tasks and yours (entry points).

A task's `tick` is called repeatedly and returns its current request, until it is done or has
failed. A task has no state: the result depends on its arguments, the estimates, and the progress.
So a mission can go on from its published state in another process.

    class Greet(Task):  # goes to a room and says good morning
        class Arguments(Task.Arguments, frozen=True):
            room: str

        places = ("room",)

        def tick(self, beliefs, progress):
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
    """The present estimates.

    Attributes:
        at: The robot's pose, m and rad in the world; None: unknown.
        deviation: Standard deviation of its position, m.
        room: The robot's room; empty: no named room, or unknown.
        battery: The remaining share of a full battery; None: unknown.
        charging: Whether the robot stands at a dock that charges.
        alarms: The rooms with an active alarm.
    """

    at: Waypoint | None = None
    deviation: float = 0.0
    room: str = ""
    battery: float | None = None
    charging: bool = False
    alarms: frozenset[str] = frozenset()


class Reach(Enum):
    """The progress of a task's request."""

    NONE = "not requested"
    UNDER_WAY = "under way"
    DONE = "done"
    FAILED = "failed"


class Progress(Struct, frozen=True):
    """The progress of a task.

    Attributes:
        elapsed: Time since its step began, s, without the time while the mission was suspended.
        state: Of its last request.
        note: Why that failed, what it waits for, or why it is unknown whether it is done.
        stage: The task's own number from its last result; 0 at first.
    """

    elapsed: float = 0.0
    state: Reach = Reach.NONE
    note: str = ""
    stage: int = 0


class Stand(Struct, frozen=True):
    """Keep the robot where it is."""


class Drive(Struct, frozen=True):
    """Have the robot driven to a place by its name, or to a pose: m, m, rad in the world."""

    to: str | tuple[float, float, float]


class Explore(Struct, frozen=True):
    """Have a rectangle of the world explored, m; None: all of it."""

    within: tuple[float, float, float, float] | None = None


class Charge(Struct, frozen=True):
    """Have the battery charged at a dock, up to a share of a full one."""

    until: float = 1.0


Request = Stand | Drive | Explore | Charge


class Going(Struct, frozen=True):
    """The current request; `stage` is passed to the next `tick`.

    A request that differs from the last one is a new one; so is one of another stage.
    """

    request: Request = Stand()
    stage: int = 0


class Done(Struct, frozen=True):
    """The task is done: its result for people, and an event to be published."""

    said: str = ""
    event: Message | None = None


class Failed(Struct, frozen=True):
    """The task cannot be done."""

    why: str


Verdict = Going | Done | Failed


def misfit(verdict: object) -> str:
    """Return what is wrong with a result of `tick`; "" if nothing is."""
    match verdict:
        case Done(said=str(), event=None | Message()) | Failed(why=str()):
            return ""
        case Done():
            return "said must be a text, and event a message"
        case Failed():
            return "why must be a text"
        case Going(request=request, stage=int(stage)) if 0 <= stage <= LARGEST_COUNT:
            return _misfit_request(request)
        case Going():
            return "stage must be a whole number, 0 or more"
    return "it must be a Going, Done or Failed"


def _misfit_request(request: object) -> str:
    """Return what is wrong with a request, by the messages that are sent for it."""
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
                return "request must be a Stand, Drive, Explore or Charge"
    except (TypeError, ValueError) as error:
        return str(error)
    return ""


class Task:
    """One kind of step, found by its entry point in `armadico.tasks`; the name there is its `do`.

    Attributes:
        places: The arguments that name places, which are checked against the world.
        breaks_off: Whether a surprise may interrupt it, to begin it anew afterwards; else it is
            finished first.
    """

    class Arguments(Struct, frozen=True, forbid_unknown_fields=True):
        """The keys of a step besides those of every step."""

    places: ClassVar[tuple[str, ...]] = ()
    breaks_off: ClassVar[bool] = True

    def __init__(self, arguments: Arguments) -> None:
        self.arguments = arguments

    def tick(self, beliefs: Beliefs, progress: Progress) -> Verdict:
        """Return the current request, or the end."""
        raise NotImplementedError("tick(self, beliefs, progress) must return the task's request")
