"""The tasks of a list as resources between robots.

Each task is a resource (`sharing.py`). A task that is done stays done: a set that only grows, which
each robot publishes whole in each cycle. A task is also over if every robot that still publishes
has given it up, so that no task is tried for ever. Sans-IO: messages and the time (s) in, messages
out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Final

from armadico.agents.fleet.messages import FleetClaims, FleetDone
from armadico.agents.fleet.sharing import Choose, Sharing
from armadico.core.exchange import Bid
from armadico.core.resources import Resource

# The cycle of a fleet. The tasks of a robot that dies are released 2.3 cycles later.
PERIOD_S: Final = 1.0

# Of a bid (`utility_of`): a task changes hands if that saves a seventeenth of the time.
MARGIN: Final = 0.005

SPEAKS_S: Final = 3 * PERIOD_S  # the timeout of a robot that publishes nothing


@cache
def resource_of(task: int) -> Resource:
    """Return a task's resource. Its action: the times of arrival and of finishing all tasks, s."""
    return Resource(
        name=f"task-{task}",
        parameters=("there_s", "finish_s"),
        scale=(1.0, 1.0),
        neutral=(0.0, 0.0),
        margin=MARGIN,
        exchange="abrupt",
        period_s=PERIOD_S,
        stops=False,
    )


class TaskSharing(Sharing):
    """One robot's side of a list of tasks."""

    def __init__(
        self,
        robot: str,
        instance: str,
        list_id: int,
        tasks: int,
        rng: random.Random,
        now: float,
        choose: Choose = lambda _resource, _clock: None,
    ) -> None:
        """Begin to share so many tasks, at a time, s."""
        resources = [resource_of(task) for task in range(tasks)]
        super().__init__(instance, list_id, resources, rng, now, choose)
        self.robot, self.tasks = robot, tasks
        self.done: dict[int, dict[str, bool]] = {}  # by task and robot, whether that is unsure
        self.given_up: set[int] = set()  # by this robot
        self._others: dict[str, tuple[float, frozenset[int]]] = {}  # by robot: time, given-up tasks

    # State ---------------------------------------------------------------------------------------

    @property
    def open(self) -> list[int]:
        """Tasks that are not known to be done."""
        return [task for task in range(self.tasks) if task not in self.done]

    def over(self, now: float) -> bool:
        """Return whether all is done, except what all publishing robots have given up."""
        left = self.open
        if not self.given_up.issuperset(left) or self.mine:
            return False
        others = [given for at, given in self._others.values() if now - at < SPEAKS_S]
        return all(given.issuperset(left) for given in others)

    @property
    def mine(self) -> list[int]:
        """Open tasks that this robot holds, as far as it knows."""
        return [task for task in self.held if task not in self.done]

    def closed(self, number: int) -> bool:
        """Whether a task is done."""
        return number in self.done

    # Inputs --------------------------------------------------------------------------------------

    def on_claims(self, message: FleetClaims, now: float) -> bool:
        """Process another robot's claims and done tasks; return whether a turn begins."""
        if message.instance == self.instance or message.cycle.epoch != self.clock.epoch:
            return False
        self._others[message.robot] = now, frozenset(message.given_up)
        self.learn(message.done)
        return self.on_other_claims(message.instance, message.cycle, message.claims, now)

    def learn(self, done: Iterable[FleetDone]) -> None:
        """Add tasks that another robot knows to be done."""
        for each in done:
            if each.task < self.tasks:
                self.done.setdefault(each.task, {})[each.by] = each.unsure

    def finish(self, task: int, now: float, *, unsure: bool = False) -> None:
        """Mark a task as done by this robot, or as done only perhaps."""
        self.done.setdefault(task, {})[self.robot] = unsure
        self._bid(task, None, now)

    # Outputs -------------------------------------------------------------------------------------

    def turn(self, bids: Callable[[], Mapping[int, Bid]], now: float) -> None:
        """Take the turn of a cycle that has begun; `bids` by task, none for all others."""
        super().turn(
            lambda: {task: bid for task, bid in bids().items() if task not in self.done}, now
        )

    def drain(self) -> FleetClaims | None:
        """Return the message to be published now, if any."""
        claims = self.next_claims()
        if claims is None:
            return None
        done, given_up = done_of(self.done), tuple(sorted(self.given_up - {*self.mine, *self.done}))
        return FleetClaims(self.robot, self.instance, *claims, done, given_up)


def done_of(done: Mapping[int, Mapping[str, bool]]) -> tuple[FleetDone, ...]:
    """Return the done tasks as messages."""
    return tuple(
        FleetDone(task, by, unsure)
        for task in sorted(done)
        for by, unsure in sorted(done[task].items())
    )
