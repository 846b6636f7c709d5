"""The messages of a fleet: a shared list of tasks, and narrow places that one robot takes."""

from __future__ import annotations

from typing import Annotated, Final

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

TASKS: Final = 256
"""Tasks of a list, at the most."""

TaskNumber = Annotated[int, Meta(ge=0, le=TASKS - 1)]

PASSAGES: Final = 256
"""Passages that one message names, at the most."""


class FleetPassages(Message, frozen=True):
    """The passages that a robot holds in a cycle of the fleet, and those that it drives through.

    The claims are those of the resources `passage-0`, `passage-1` and so on. The cycle's epoch
    tells maps apart. `through` are the passages that its way leads into and out of again. `waits`:
    the robot stands until it holds the next one.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    claims: Annotated[tuple[Claim, ...], Meta(max_length=PASSAGES)] = ()
    through: Annotated[tuple[Counter, ...], Meta(max_length=PASSAGES)] = ()
    waits: bool = False


class FleetTask(Message, frozen=True):
    """One task of a list: go there, and look for so long."""

    goal: Waypoint
    look_s: Annotated[float, Meta(ge=0, le=3600)] = 5.0
    name: Label = ""  # for people


class FleetTasks(Message, frozen=True):
    """A list that a fleet works on; tasks are numbered from 0.

    Who knows it gives it to who does not. `follows` is the list that it takes the place of; 0: none
    """

    id: Bits64
    follows: Bits64
    tasks: Annotated[tuple[FleetTask, ...], Meta(max_length=TASKS)]


class FleetDone(Message, frozen=True):
    """A task that is done, and by which robot."""

    task: TaskNumber
    by: Name


Done = Annotated[tuple[FleetDone, ...], Meta(max_length=4 * TASKS)]


class FleetClaims(Message, frozen=True):
    """What a robot's fleet agent holds in a cycle of the fleet, and all that it knows to be done.

    The claims are those of the resources `task-0`, `task-1` and so on. The cycle's epoch is the
    list's id, 0: it knows of no list. Nobody owns the cycles: who counts on first is followed.
    `given_up` are tasks that it has tried several times in vain: what all have given up is over.
    """

    robot: Name
    instance: Name
    cycle: Cycle
    claims: Annotated[tuple[Claim, ...], Meta(max_length=TASKS)] = ()
    done: Done = ()
    given_up: Annotated[tuple[TaskNumber, ...], Meta(max_length=TASKS)] = ()


class FleetRequest(Message, frozen=True):
    """Asks a fleet, by any one of its robots, to do a list of tasks.

    `replace`: also instead of one that it works on, of which nothing more is done then.
    """

    tasks: Annotated[tuple[FleetTask, ...], Meta(min_length=1, max_length=TASKS)]
    replace: bool = False


class FleetReply(Message, frozen=True):
    """Whether the list was taken on."""

    list: Bits64
    refusal: Text = ""


class FleetBoard(Latched, frozen=True):
    """What a robot's fleet agent knows, remembered by all agents of that robot."""

    counter: Counter
    list: Bits64
    follows: Bits64
    tasks: Annotated[tuple[FleetTask, ...], Meta(max_length=TASKS)]
    done: Done = ()
    mission: Bits64 = 0  # the last one that was asked for

    @property
    def order(self) -> tuple[int, int]:
        """Counted with each change; it has one author a robot."""
        return self.counter, self.list


class FleetStatus(Message, frozen=True):
    """A robot's fleet agent's report: the tasks that it holds, the next one first."""

    list: Bits64
    tasks: Counter
    done: Counter
    holds: Annotated[tuple[TaskNumber, ...], Meta(max_length=TASKS)]
    finish_s: Annotated[float, Meta(ge=0, le=1e9)] = 0.0  # until it is done with them, as it thinks
    note: Text = ""


event(FleetPassages, "fleet/{robot}/passages", "narrow places that a robot holds", rate_hz=2)
event(FleetTasks, "fleet/tasks", "the list that a fleet works on")
event(FleetClaims, "fleet/{robot}/claims", "tasks that a robot holds; done", rate_hz=1)
query(FleetRequest, "tasks/request", FleetReply, "do these tasks")
latch(FleetBoard, "tasks/board", "the list, and what of it is done")
state(FleetStatus, "tasks/status", 1, None, "how far it is, and what the robot holds")
