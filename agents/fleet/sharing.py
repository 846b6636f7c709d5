"""Resources between robots: the bids and ballots of the wheels, without a common owner or clock.

A resource needs an owner, which acknowledges what it obeys and rejects beaten ballots. Between
robots there is no process that could be it, because any robot may fail. So **each robot has an
owner of each resource, for itself**: it judges what it receives, its own robot's claims included,
and acknowledges to its own contender only. Ballots are totally ordered, so all robots that receive
the same claims obey the same one, and no knowledge is lost with a robot.

The cycles have no common clock either. Each robot counts on after a period, unless it has received
a newer cycle from another robot. All follow the robot that counts first, so the cycles of a fleet
come at the pace of its fastest clock and go on whichever robot fails. In its turn a robot bids for
what it holds and for what it wants, and publishes all that it holds in one message: the number of
messages of a cycle does not grow with the resources or the contenders.

By another mechanism (`armadico.core.mechanisms`) a robot proposes to an arbiter, which awards, or
it claims by rules of its own.

Sans-IO: claims and the time (s) in, claims out.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from armadico.core.coordination import Contender, Owner
from armadico.core.cycles import CycleClock
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.mechanisms import Mechanism
from armadico.core.membership import agent_of
from armadico.core.messages import Award, Claim, Command, Cycle, Message, Proposal
from armadico.core.resources import Resource
from armadico.mobile.messages import FleetAwards, FleetProposals

# A robot that is more cycles ahead than this is followed only if its cycles come steadily: a single
# wrong number must not end a clock.
FAR: Final = 1000

STEADY: Final = 3  # cycles in a row, at most twice as fast as the period, are steady

LATEST: Final = 2**40  # the largest number of a cycle, so that there is always a next one


class FleetClock:
    """Cycles that every robot counts, and that follow the robot that counts first."""

    def __init__(self, epoch: int, period: float, now: float) -> None:
        """Begin at 0 after one period, s, so that an older count is received before."""
        self.cycles = CycleClock(period)
        self.epoch = epoch
        self.due = now + period
        self._far: tuple[int, float, int] | None = None  # a far cycle, its time, and count in a row

    def count(self, now: float) -> bool:
        """Count on if a period has passed without a newer cycle; return whether it did."""
        if now < self.due:
            return False
        newest = self.cycles.newest
        self._be(Cycle(self.epoch, 0 if newest is None else newest.number + 1), now)
        return True

    def follow(self, cycle: Cycle, now: float) -> bool:
        """Follow another robot's cycle; return whether it is newer than the own one."""
        newest = self.cycles.newest
        if cycle.epoch != self.epoch or cycle.number > LATEST:
            return False
        if newest is not None and cycle.number <= newest.number:
            return False
        far = newest is not None and cycle.number > newest.number + FAR
        if far and not self._goes_on(cycle.number, now):
            return False
        self._be(cycle, now)
        return True

    def _goes_on(self, number: int, now: float) -> bool:
        """Return whether far cycles come steadily, as those of a fleet that began long ago."""
        before, period, count = self._far, self.cycles.period, 1
        if before is not None:
            since = now - before[1]
            if number == before[0]:
                return False  # repeated
            if 0 < number - before[0] <= 2.0 * since / period + 1.0 and since <= STEADY * period:
                count = before[2] + 1
        self._far = number, now, count
        return count >= STEADY

    def _be(self, cycle: Cycle, now: float) -> None:
        if not self.cycles.advance(cycle, now):
            # More cycles than the time that has passed: clocks differ after a partition. It counts
            # as a clock that has timed out, so that the robot listens before it takes over.
            self.cycles.received_at = float("-inf")
            self.cycles.advance(cycle, now)
        self.due = now + self.cycles.period


Choose = Callable[[Resource, CycleClock], Mechanism | None]
"""Returns another mechanism than ballots for a resource; None: ballots."""


class Sharing:
    """One robot's side of several resources between robots, numbered from 0."""

    def __init__(
        self,
        instance: str,
        epoch: int,
        resources: Sequence[Resource],
        rng: random.Random,
        now: float,
        choose: Choose = lambda _resource, _clock: None,
    ) -> None:
        """Begin to contend for resources of one period, at a time, s.

        `epoch` identifies the set of resources: claims of another epoch are ignored.
        """
        period = resources[0].period_s
        assert period is not None, "a resource between robots has a period of its own"
        self.instance = instance
        self.clock = FleetClock(epoch, period, now)
        cycles, exchange = self.clock.cycles, EXCHANGES["abrupt"]
        self._contenders: list[Mechanism] = [
            choose(each, cycles) or Contender(each, instance, cycles, exchange, rng)
            for each in resources
        ]
        self._owners = [Owner(resource, cycles) for resource in resources]
        self._numbers = {resource.name: number for number, resource in enumerate(resources)}
        self._claimed: dict[int, Claim] = {}  # by this robot, in this cycle
        self._published = True  # whether those have been published
        self._proposed: dict[int, Proposal] = {}  # by this robot, in this cycle
        self._proposed_in: Cycle | None = None  # None: they have been published
        self._awards: dict[int, Award] = {}  # the newest of each resource

    @property
    def by_ballots(self) -> bool:
        """Whether other robots' claims decide, by ballots or by a variant of them."""
        return all(isinstance(each, Contender) for each in self._contenders)

    @property
    def held(self) -> list[int]:
        """The resources that this robot holds, as far as it knows."""
        return [number for number, each in enumerate(self._contenders) if each.share > 0.0]

    def confirmed(self, number: int, cycles: int) -> bool:
        """Return whether a resource was held for so many cycles: its claim is known by then."""
        contender = self._contenders[number]
        if not isinstance(contender, Contender):
            return contender.share > 0.0
        tenure = contender.tenure
        if not contender.holding or tenure is None:
            return False
        return (self.clock.cycles.age(tenure.began) or 0) >= cycles

    def rival(self, number: int) -> Claim | None:
        """The newest fresh claim of another robot that holds a resource; None if there is none."""
        contender = self._contenders[number]
        if not isinstance(contender, Contender):
            return None
        rival = contender.rival
        if contender.holding or rival is None or rival.gone or rival.claim.utility is None:
            return None
        age = self.clock.cycles.age(rival.claim.cycle)
        return rival.claim if age is not None and age <= self.clock.cycles.fresh_cycles else None

    def taken_by(self, number: int) -> str:
        """The instance of another robot that has a resource, by its claim or an award; "": none."""
        rival, award = self.rival(number), self._awards.get(number)
        if rival is not None:
            return rival.ballot.instance
        if award is None or not award.agents or not self.clock.cycles.fresh(award.cycle):
            return ""
        return "" if self.instance in award.agents else award.agents[0]

    def on_other_claims(
        self, instance: str, cycle: Cycle, claims: Iterable[Claim], now: float
    ) -> bool:
        """Process all claims of another robot in a cycle; return whether a turn begins."""
        if instance == self.instance or cycle.epoch != self.clock.epoch:
            return False
        begins = self.clock.follow(cycle, now)
        there = set()
        for claim in claims:
            number = self._numbers.get(claim.resource)
            if number is None or claim.ballot.instance != instance:
                continue  # unknown, or claimed in the name of another instance
            there.add(number)
            self._on_claim(number, claim, now)
        for number, contender in enumerate(self._contenders):
            if not isinstance(contender, Contender):
                continue
            rival = contender.rival
            if rival is None or rival.claim.ballot.instance != instance or rival.gone:
                continue
            if number not in there and cycle.number >= rival.claim.cycle.number:
                # Each message has all that the robot holds: what is missing has been released. A
                # message that was overtaken by a newer claim releases nothing.
                ballot = rival.claim.ballot
                self._on_claim(number, Claim(contender.resource.name, ballot, cycle, None), now)
        return begins

    def turn(self, bids: Callable[[], Mapping[int, Bid]], now: float) -> None:
        """Take the turn of a cycle that has begun; `bids` by number, none for all others."""
        self._claimed.clear()
        self._proposed.clear()
        for number, contender in enumerate(self._contenders):
            ack = self._owners[number].ack(())
            if ack is not None:
                self._judge_own(number, contender.acked(ack, now), now)
        wanted = bids()
        for number in range(len(self._contenders)):
            self._bid(number, wanted.get(number), now)
        self._published = False
        self._proposed_in = self.clock.cycles.newest

    def release(self, numbers: Iterable[int], now: float) -> None:
        """Release resources at once."""
        for number in numbers:
            self._bid(number, None, now)

    def wake(self, now: float) -> bool:
        """Update the time; return whether a cycle has begun."""
        for number, contender in enumerate(self._contenders):
            due = contender.wakeup
            if due is not None and now >= due:
                self._judge_own(number, contender.tick(now), now)
        return self.clock.count(now)

    @property
    def wakeup(self) -> float:
        """The next time at which `wake` must be called, s."""
        due = [at for c in self._contenders if (at := c.wakeup) is not None]
        return min([self.clock.due, *due])

    def next_claims(self) -> tuple[Cycle, tuple[Claim, ...]] | None:
        """Return the cycle and the claims to publish; None if nothing has changed since."""
        cycle = self.clock.cycles.newest
        if self._published or cycle is None:
            return None
        self._published = True
        claims = tuple(
            claim
            for number, claim in self._claimed.items()
            if claim.utility is None or self._contenders[number].share > 0.0
        )
        return cycle, claims

    def next_proposals(self, robot: str) -> FleetProposals | None:
        """Return the message to an arbiter to be published now, if any."""
        cycle, self._proposed_in = self._proposed_in, None
        if cycle is None or not any(Award in each.receives for each in self._contenders):
            return None
        proposals = tuple(each for n, each in self._proposed.items() if not self.closed(n))
        holds = [self._owners[n].resource.name for n in self.held if not self.closed(n)]
        return FleetProposals(robot, self.instance, cycle, proposals, tuple(holds))

    def on_awards(self, message: FleetAwards, now: float) -> str:
        """Process an arbiter's decisions; return why they are refused, "" if they are not."""
        if message.cycle.epoch != self.clock.epoch:
            return ""
        if self.by_ballots:
            decides, what = agent_of(message.instance), self._owners[0].resource.name
            return (
                f"{decides} awards {what.rpartition('-')[0]}s, and this robot shares them by"
                " ballots: start all with one --coordination"
            )
        for award in message.awards:
            number = self._numbers.get(award.resource)
            if number is None or not self.clock.cycles.fresh(award.cycle):
                continue
            contender = self._contenders[number]
            if Award in contender.receives and not self.closed(number):
                self._awards[number] = award
                self._judge_own(number, contender.on_message(award, now), now)
        return ""

    def closed(self, number: int) -> bool:  # noqa: ARG002 - for subclasses
        """Return whether a resource is no longer contended for."""
        return False

    def _on_claim(self, number: int, claim: Claim, now: float) -> None:
        """Judge another robot's claim as a command, and process it."""
        owner = self._owners[number]
        action = None if claim.utility is None else claim.commanded
        command = Command(claim.resource, claim.cycle, claim.ballot, action)
        owner.judge(command, now, fault="" if action is None else owner.resource.fault(action))
        owner.on_claim(claim)
        if not self.closed(number):
            self._judge_own(number, self._contenders[number].on_claim(claim, now), now)

    def _bid(self, number: int, bid: Bid | None, now: float) -> None:
        cycle = self.clock.cycles.newest
        if cycle is not None:
            self._judge_own(number, self._contenders[number].bid(cycle, bid, now), now)

    def _judge_own(self, number: int, messages: Sequence[Message], now: float) -> None:
        """Judge the own commands, and keep the claims for publication."""
        owner = self._owners[number]
        for message in messages:
            if isinstance(message, Command):
                owner.judge(message, now)
            elif isinstance(message, Claim):
                owner.on_claim(message)
                self._claimed[number] = message
                self._published = False
            elif isinstance(message, Proposal):
                self._proposed[number] = message
