"""The tasks of a list as resources between robots.

Each task is a resource of its own (`sharing.py`). A task that is done stays done: a set that only
grows, published whole by each robot in each cycle. A task that every robot that still publishes has
given up is over, too, so that no task is tried for ever.
Sans-IO: messages and the time (s) in, messages out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Final

from armadico.agents.fleet.messages import FleetClaims, FleetDone
from armadico.agents.fleet.sharing import Sharing
from armadico.core.exchange import Bid
from armadico.core.resources import Resource

PERIOD_S: Final = 1.0
"""From one cycle of a fleet to the next. A robot that dies gives its tasks back 2.3 of them later.
"""

MARGIN: Final = 0.005
"""Of a bid (`utility_of`): a task changes hands where that saves a seventeenth of the time."""

SPEAKS_S: Final = 3 * PERIOD_S
"""A robot that has published nothing for so long is not waited for."""


@cache
def resource_of(task: int) -> Resource:
    """The resource that a task is. Its action is when its robot is there and done with all, s."""
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
    ) -> None:
        """Begin to share so many tasks, at a time, s."""
        super().__init__(instance, list_id, [resource_of(task) for task in range(tasks)], rng, now)
        self.robot, self.tasks = robot, tasks
        self.done: dict[int, set[str]] = {}  # by task, the robots that did it
        self.given_up: set[int] = set()  # by this robot
        self._others: dict[str, tuple[float, frozenset[int]]] = {}  # heard when; given up, by robot

    # What is known -------------------------------------------------------------------------------

    @property
    def open(self) -> list[int]:
        """Tasks that are not known to be done."""
        return [task for task in range(self.tasks) if task not in self.done]

    def over(self, now: float) -> bool:
        """Whether all is done, but for what each robot that still publishes has given up."""
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

    # What comes in -------------------------------------------------------------------------------

    def on_claims(self, said: FleetClaims, now: float) -> bool:
        """Take what another robot holds and knows to be done; return whether a turn begins."""
        if said.instance == self.instance or said.cycle.epoch != self.clock.epoch:
            return False
        self._others[said.robot] = now, frozenset(said.given_up)
        self.learn(said.done)
        return self.hear_claims(said.instance, said.cycle, said.claims, now)

    def learn(self, done: Iterable[FleetDone]) -> None:
        """Take tasks that another robot knows to be done."""
        for each in done:
            if each.task < self.tasks:
                self.done.setdefault(each.task, set()).add(each.by)

    def finish(self, task: int, now: float) -> None:
        """Note that this robot has done a task."""
        self.done.setdefault(task, set()).add(self.robot)
        self._bid(task, None, now)

    # What comes out ------------------------------------------------------------------------------

    def turn(self, bids: Callable[[], Mapping[int, Bid]], now: float) -> None:
        """Take the turn of a cycle that has begun: bids by task; none for all others."""
        super().turn(
            lambda: {task: bid for task, bid in bids().items() if task not in self.done}, now
        )

    def drain(self) -> FleetClaims | None:
        """What is to be published now; None if nothing is."""
        said = self.take_claims()
        if said is None:
            return None
        done, given_up = done_of(self.done), tuple(sorted(self.given_up - {*self.mine, *self.done}))
        return FleetClaims(self.robot, self.instance, *said, done, given_up)


def done_of(done: Mapping[int, Iterable[str]]) -> tuple[FleetDone, ...]:
    """What is done, as it is published."""
    return tuple(FleetDone(task, by) for task in sorted(done) for by in sorted(done[task]))
