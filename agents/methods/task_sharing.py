"""Tasks as resources between robots: the bids and ballots of the wheels, with nobody's clock.

Each task of a list is a resource of its own. A resource needs an owner, who acknowledges what it
obeys and refuses beaten ballots; and between robots there is nobody who could be it, for any robot
may die. So **each robot has an owner of each task, for itself**: it judges what it hears, its own
robot's claims too, and acknowledges to its own contender only. Ballots are totally ordered, so all
who hear the same obey the same, and what one knows dies with nobody.

The cycles are nobody's either. Each robot counts on after a period, unless it has heard that
another one has: who counts first is followed by all, so a fleet's cycles come at the pace of its
fastest clock, and go on whoever dies. In its turn a robot bids for what it holds and for what it
would like to, and publishes all that it holds in one message: the talk of a cycle does not grow
with the tasks, nor with those that would like them.

What is done is done for ever: a set that only grows, published whole by everybody, each cycle. What
each of those who speak has given up is over, too: nobody tries it for ever.
Sans-IO: messages and the time (s) in, messages out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Final

from armadico.core.coordination import Contender, Owner
from armadico.core.cycles import CycleClock
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.messages import (
    TASKS,
    Claim,
    Command,
    Cycle,
    FleetClaims,
    FleetDone,
    Message,
)
from armadico.core.resources import Resource

PERIOD_S: Final = 1.0
"""From one cycle of a fleet to the next. A robot that dies gives its tasks back 2.3 of them later.
"""

MARGIN: Final = 0.005
"""Of a bid (`utility_of`): a task changes hands where that saves a seventeenth of the time."""

FAR: Final = 1000
"""Cycles: who is farther ahead than this is not followed. One bad number must not end a clock."""

LATEST: Final = 2**40
"""No cycle of a fleet has a greater number: there is always a next one."""

SPEAKS_S: Final = 3 * PERIOD_S
"""Who has said nothing for so long is not waited for."""

_PREFIX: Final = "task-"


@cache
def resource_of(task: int) -> Resource:
    """The resource that a task is. Its action is when its robot is there and done with all, s."""
    return Resource(
        name=f"{_PREFIX}{task}",
        parameters=("there_s", "finish_s"),
        scale=(1.0, 1.0),
        neutral=(0.0, 0.0),
        margin=MARGIN,
        exchange="abrupt",
        period_s=PERIOD_S,
        stops=False,
    )


def task_of(resource: str) -> int | None:
    """The number of the task that a resource is; None if it is none."""
    number = resource.removeprefix(_PREFIX)
    if not (resource.startswith(_PREFIX) and number.isascii() and number.isdecimal()):
        return None
    return int(number) if len(number) <= 3 and int(number) < TASKS else None


class FleetClock:
    """The cycles of one list: counted by everybody, and the one who is first is followed."""

    def __init__(self, epoch: int, now: float) -> None:
        """Begin at 0, after a period in which those may be heard who have begun before."""
        self.cycles = CycleClock(PERIOD_S)
        self.epoch = epoch
        self.due = now + PERIOD_S

    def count(self, now: float) -> bool:
        """Count on, if it is time and nobody has; whether it did."""
        if now < self.due:
            return False
        newest = self.cycles.newest
        self._be(Cycle(self.epoch, 0 if newest is None else newest.number + 1), now)
        return True

    def follow(self, cycle: Cycle, now: float) -> bool:
        """Take somebody's word that a cycle has begun; whether it had not for oneself."""
        newest = self.cycles.newest
        if cycle.epoch != self.epoch or cycle.number > LATEST:
            return False
        if newest is not None and not newest.number < cycle.number <= newest.number + FAR:
            return False
        self._be(cycle, now)
        return True

    def _be(self, cycle: Cycle, now: float) -> None:
        if not self.cycles.advance(cycle, now):
            # Farther on than the time that passed: two that were apart, and clocks differ. It is
            # taken for a clock that fell silent, so that one listens before one takes anything.
            self.cycles.received_at = float("-inf")
            self.cycles.advance(cycle, now)
        self.due = now + PERIOD_S


class TaskSharing:
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
        self.robot, self.instance, self.tasks = robot, instance, tasks
        self.clock = FleetClock(list_id, now)
        self.done: dict[int, set[str]] = {}  # by task, the robots that did it
        self.given_up: set[int] = set()  # by oneself
        self._others: dict[str, tuple[float, frozenset[int]]] = {}  # heard when; given up, by robot
        self._contenders: dict[int, Contender] = {}
        self._owners: dict[int, Owner] = {}
        exchange = EXCHANGES["abrupt"]
        for task in range(tasks):
            resource = resource_of(task)
            cycles = self.clock.cycles
            self._contenders[task] = Contender(resource, instance, cycles, exchange, rng)
            self._owners[task] = Owner(resource, cycles)
        self._claimed: dict[int, Claim] = {}  # by oneself, in this cycle
        self._said = True  # and published

    # What is known -------------------------------------------------------------------------------

    @property
    def open(self) -> list[int]:
        """Tasks that are not known to be done."""
        return [task for task in range(self.tasks) if task not in self.done]

    def over(self, now: float) -> bool:
        """Whether all is done, but for what each of those who speak has given up."""
        left = self.open
        if not self.given_up.issuperset(left) or self.mine:
            return False
        others = [given for at, given in self._others.values() if now - at < SPEAKS_S]
        return all(given.issuperset(left) for given in others)

    @property
    def mine(self) -> list[int]:
        """Tasks that one holds, as far as one knows."""
        return [task for task in self.open if self._contenders[task].holding]

    def rival(self, task: int) -> Claim | None:
        """The newest claim of another robot's that holds a task; None: nobody does."""
        contender = self._contenders[task]
        rival = contender.rival
        if contender.holding or rival is None or rival.gone or rival.claim.utility is None:
            return None
        age = self.clock.cycles.age(rival.claim.cycle)
        return rival.claim if age is not None and age <= self.clock.cycles.fresh_cycles else None

    # What comes in -------------------------------------------------------------------------------

    def hear(self, said: FleetClaims, now: float) -> bool:
        """Take what another robot holds, and what it knows to be done; whether a turn begins."""
        if said.instance == self.instance or said.cycle.epoch != self.clock.epoch:
            return False
        begins = self.clock.follow(said.cycle, now)
        self._others[said.robot] = now, frozenset(said.given_up)
        self.learn(said.done)
        there = set()
        for claim in said.claims:
            task = task_of(claim.resource)
            if task is None or task not in self._contenders:
                continue
            if claim.ballot.instance != said.instance:  # nobody claims in another's name
                continue
            there.add(task)
            self._take(task, claim, now)
        for task, contender in self._contenders.items():
            rival = contender.rival
            held = rival is not None and rival.claim.ballot.instance == said.instance
            if held and rival is not None and task not in there and not rival.gone:
                # All that it holds is in each message: what is not there it has let go of.
                ballot = rival.claim.ballot
                self._take(task, Claim(contender.resource.name, ballot, said.cycle, None), now)
        return begins

    def learn(self, done: Iterable[FleetDone]) -> None:
        """Take what somebody knows to be done."""
        for each in done:
            if each.task < self.tasks:
                self.done.setdefault(each.task, set()).add(each.by)

    def finish(self, task: int, now: float) -> None:
        """It is done, by oneself."""
        self.done.setdefault(task, set()).add(self.robot)
        self._bid(task, None, now)

    # What comes out ------------------------------------------------------------------------------

    def turn(self, bids: Callable[[], Mapping[int, Bid]], now: float) -> None:
        """The turn of a cycle that has begun: what one would do, by task; none for the others."""
        self._claimed.clear()
        for task, contender in self._contenders.items():
            ack = self._owners[task].ack(())
            if ack is not None:
                self._say(task, contender.acked(ack, now), now)
        wanted = bids()
        for task in self._contenders:
            self._bid(task, None if task in self.done else wanted.get(task), now)
        self._said = False

    def let_go(self, tasks: Iterable[int], now: float) -> None:
        """Give tasks back at once."""
        for task in tasks:
            self._bid(task, None, now)

    def wake(self, now: float) -> bool:
        """Take the time; whether a cycle has begun."""
        for task, contender in self._contenders.items():
            due = contender.wakeup
            if due is not None and now >= due:
                self._say(task, contender.tick(now), now)
        return self.clock.count(now)

    @property
    def wakeup(self) -> float:
        """When `wake` should be called, s."""
        due = [at for c in self._contenders.values() if (at := c.wakeup) is not None]
        return min([self.clock.due, *due])

    def take(self) -> FleetClaims | None:
        """What is to be published now, if anything is."""
        cycle = self.clock.cycles.newest
        if self._said or cycle is None:
            return None
        self._said = True
        claims = tuple(
            claim
            for task, claim in self._claimed.items()
            if claim.utility is None or self._contenders[task].holding
        )
        done, given_up = done_of(self.done), tuple(sorted(self.given_up - {*self.mine, *self.done}))
        return FleetClaims(self.robot, self.instance, cycle, claims, done, given_up)

    # Inside --------------------------------------------------------------------------------------

    def _take(self, task: int, claim: Claim, now: float) -> None:
        """Another's claim: its command for one's own owner, and then the claim."""
        owner = self._owners[task]
        action = None if claim.utility is None else claim.commanded
        command = Command(claim.resource, claim.cycle, claim.ballot, action)
        owner.judge(command, now, fault="" if action is None else owner.resource.fault(action))
        owner.hear(claim)
        if task not in self.done:
            self._say(task, self._contenders[task].hear(claim, now), now)

    def _bid(self, task: int, bid: Bid | None, now: float) -> None:
        cycle = self.clock.cycles.newest
        if cycle is not None:
            self._say(task, self._contenders[task].bid(cycle, bid, now), now)

    def _say(self, task: int, messages: Sequence[Message], now: float) -> None:
        """Have one's own owner judge it; the claims are published with all others."""
        owner = self._owners[task]
        for message in messages:
            if isinstance(message, Command):
                owner.judge(message, now)
            elif isinstance(message, Claim):
                owner.hear(message)
                self._claimed[task] = message
                self._said = False


def done_of(done: Mapping[int, Iterable[str]]) -> tuple[FleetDone, ...]:
    """What is done, as it is published."""
    return tuple(FleetDone(task, by) for task in sorted(done) for by in sorted(done[task]))
