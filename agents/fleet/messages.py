"""The messages of a fleet: a shared list of tasks, and passages that one robot uses at a time."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.core.messages import (
    Bits64,
    Claim,
    Counter,
    Cycle,
    Label,
    Latched,
    Message,
    Name,
    Text,
)
from armadico.core.services import event, latch, query, state
from armadico.mobile.messages import Waypoint

TASKS: Final = 256  # of a list, at most

TaskNumber = Annotated[int, Meta(ge=0, le=TASKS - 1)]

PASSAGES: Final = 256  # of a message, at most


class FleetPassages(Message, frozen=True):
    """The passages that a robot holds in a cycle of the fleet, and those that it drives through.

    The claims are those of the resources `passage-0`, `passage-1` and so on. The cycle's epoch
    identifies the map. `through` are the passages that its path enters and leaves again. `waits`:
    the robot stands until it holds the next one.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    claims: Annotated[tuple[Claim, ...], Meta(max_length=PASSAGES)] = ()
    through: Annotated[tuple[Counter, ...], Meta(max_length=PASSAGES)] = ()
    waits: bool = False


class FleetTask(Message, frozen=True):
    """One task of a list: drive to the goal, and observe for `look_s`."""

    goal: Waypoint
    look_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0
    name: Label = ""  # for people


class FleetTasks(Message, frozen=True):
    """A list that a fleet works on; tasks are numbered from 0.

    A robot that knows the list sends it to others that do not. `follows` is the list that it
    replaces; 0: none.
    """

    id: Bits64
    follows: Bits64
    tasks: Annotated[tuple[FleetTask, ...], Meta(max_length=TASKS)]


class FleetDone(Message, frozen=True):
    """A task that is done, and the robot that did it."""

    task: TaskNumber
    by: Name
    unsure: bool = False  # the robot was at the goal only perhaps, by the deviation of its pose

    appended: ClassVar[int] = 1


Done = Annotated[tuple[FleetDone, ...], Meta(max_length=4 * TASKS)]


class FleetClaims(Message, frozen=True):
    """The tasks that a robot holds in a cycle of the fleet, and all that it knows to be done.

    The claims are those of the resources `task-0`, `task-1` and so on. The cycle's epoch is the
    list's id; 0: the robot knows of no list. No robot owns the cycles: all follow the one that
    counts first. `given_up` are tasks that the robot has tried several times in vain; a task that
    all have given up is over.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    claims: Annotated[tuple[Claim, ...], Meta(max_length=TASKS)] = ()
    done: Done = ()
    given_up: Annotated[tuple[TaskNumber, ...], Meta(max_length=TASKS)] = ()


class FleetRequest(Message, frozen=True):
    """Requests a fleet, by any one of its robots, to do a list of tasks.

    `replace`: also instead of a list that it works on, which then ends.
    """

    tasks: Annotated[tuple[FleetTask, ...], Meta(min_length=1, max_length=TASKS)]
    replace: bool = False


class FleetReply(Message, frozen=True):
    """Whether the list was accepted."""

    list: Bits64
    refusal: Text = ""


class FleetBoard(Latched, frozen=True):
    """The state of a robot's fleet agent, replicated to all agents of that robot."""

    counter: Counter
    list: Bits64
    follows: Bits64
    tasks: Annotated[tuple[FleetTask, ...], Meta(max_length=TASKS)]
    done: Done = ()
    mission: Bits64 = 0  # the last one that was requested

    @property
    def order(self) -> tuple[int, int]:
        """The order of boards: the counter first; a robot has one author."""
        return self.counter, self.list


class FleetStatus(Message, frozen=True):
    """The report of a robot's fleet agent: the tasks that it holds, the next one first."""

    list: Bits64
    tasks: Counter
    done: Counter
    holds: Annotated[tuple[TaskNumber, ...], Meta(max_length=TASKS)]
    finish_s: Annotated[float, Meta(ge=0, le=1e9)] = 0.0  # estimated time until all are done
    note: Text = ""


event(FleetPassages, "fleet/{robot}/passages", "passages that a robot holds", rate_hz=2)
event(FleetTasks, "fleet/tasks", "the list that a fleet works on", several=True)
event(FleetClaims, "fleet/{robot}/claims", "tasks that a robot holds; done", rate_hz=1)
query(FleetRequest, "tasks/request", FleetReply, "do these tasks")
latch(FleetBoard, "tasks/board", "the list, and its tasks that are done")
state(FleetStatus, "tasks/status", 1, None, "the progress, and the tasks that the robot holds")
