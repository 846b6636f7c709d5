"""Which agent holds a resource: claims, ballots and winner determination, with nobody in charge.

Sans-IO: bids, claims, acks and the time go in, messages to publish come out. The holder of a
resource publishes its command and then its claim in each cycle. A contender compares bids **of the
same cycle**. If its own is better it casts a ballot of the next term and takes over immediately.
Beaten contenders publish nothing, so the traffic of a cycle does not grow with their number.

A **ballot** is a fencing token: (term, rank when cast, instance), totally ordered and fixed for a
tenure. The owner of the resource rejects messages with a smaller ballot than the largest that it
has obeyed or received. It publishes that ballot in its ack. It chooses no holder.

The rules are the two tables `TRANSITIONS` and `Owner.judge`; everything else is bookkeeping. Two
rules do not fit the first table and are guards beside it. *Listening* (`CycleClock`): an agent that
starts or has missed cycles does not take over for as many cycles, because it has missed the other
agents' messages. *Draw*: where several contenders may take over, each waits a random time.

Thesis: 3.3.2, 3.10 and figure 3.30, whose states 1 and 2 are IDLE here, 3 HOLDING, 4 CONTENDING.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Final, TypeVar

from msgspec.structs import replace

from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid, Exchange, Handover
from armadico.core.messages import (
    JUMP,
    LARGEST_COUNT,
    Ack,
    Action,
    Ballot,
    Claim,
    Command,
    Cycle,
    Message,
)
from armadico.core.resources import Resource

# Claim timeout in cycles. It is shorter than the owner's command timeout and longer than a claim
# that is a cycle late. With 1.5, an agent that bids every other cycle makes the wheels change
# hands ten times a second.
SILENCE: Final = 2.3

# Cycles that a tenure may continue without being obeyed. Other contenders wait for one more. With
# 3, two hops of 0.1 s lock up. With 6 for all, a holder deposed just before its own release does
# not stand back, and takes over again immediately.
UNOBEYED: Final = 6

# Seconds that a holder stands back after a tenure that was not obeyed: the first, the second and
# any further time in a row. They grow, because otherwise two partitioned networks compete forever.
STAND_BACK: Final[tuple[float, ...]] = (1.0, 2.0, 4.0)

# Where several contenders may take over, each waits up to this share of a cycle; better bids wait
# less.
DRAW: Final = 0.1

# Consecutive acks with an implausible largest ballot after which the owner's value is adopted. One
# ack may be corrupt; but the owner never obeys a ballot that is implausible to it.
APART: Final = 2

# A term more than this above the owner's largest is a *leap*. The owner accepts a single leap in
# LEAP_CYCLES: otherwise a contender whose claims rise by JUMP each reaches the last term within
# hours, and then no ballot can be cast. So it takes years. Honest terms rise by one per exchange;
# the first claim after a restart of the owner may leap.
STEP: Final = 1024
LEAP_CYCLES: Final = 1000

# Cycles whose bids and claims are kept for comparison. A holder that has bid 0 in all of them
# releases the resource.
KEPT_CYCLES: Final = 4

T = TypeVar("T")


class State(Enum):
    """A contender's state for one resource."""

    IDLE = "idle"
    CONTENDING = "contending"
    HOLDING = "holding"
    STANDING_BACK = "standing back"


class Event(Enum):
    BID = "has a bid"
    NO_BID = "has none"
    BETTER = "its bid beats the holder's of the same cycle"
    VACANT = "the holder released, or was killed"
    UNOBEYED = "the holder is not obeyed: silent for 2.3 cycles, or for 7 whatever it claims"
    OUTBID = "a larger ballot is claimed or acknowledged"
    NOT_OBEYED = "its own commands were not obeyed for 6 cycles"
    RESTED = "has stood back long enough"


class Step(Enum):
    """The action of a transition."""

    NOTHING = "nothing"
    CAST = "cast a ballot of the next term, command, claim"
    RELEASE = "release"
    YIELD = "fall silent, and wait for the claim timeout anew"


TRANSITIONS: Mapping[tuple[State, Event], tuple[State, Step]] = {
    (State.IDLE, Event.BID): (State.CONTENDING, Step.NOTHING),
    (State.CONTENDING, Event.NO_BID): (State.IDLE, Step.NOTHING),
    (State.CONTENDING, Event.BETTER): (State.HOLDING, Step.CAST),
    (State.CONTENDING, Event.VACANT): (State.HOLDING, Step.CAST),
    (State.CONTENDING, Event.UNOBEYED): (State.HOLDING, Step.CAST),
    (State.HOLDING, Event.NO_BID): (State.IDLE, Step.RELEASE),
    (State.HOLDING, Event.OUTBID): (State.CONTENDING, Step.YIELD),
    (State.HOLDING, Event.NOT_OBEYED): (State.STANDING_BACK, Step.RELEASE),
    (State.STANDING_BACK, Event.RESTED): (State.CONTENDING, Step.NOTHING),
}
"""All changes of state. An event without an entry for the state changes nothing."""


# Winner determination -----------------------------------------------------------------------------


def beats(bid: Bid, claim: Claim, margin: float) -> bool:
    """Return whether a bid wins (3.10.1): better by more than the margin, or equal and critical.

    The rank is (utility, critical), because goto and gothrough reach 1.0 as avoid does, and a bid
    against an imminent collision goes first.
    """
    assert claim.utility is not None, "a release is not a bid"
    if bid.utility > claim.utility + margin:
        return True
    return bid.critical and not claim.critical and bid.utility >= claim.utility


Bids = dict[Cycle, Bid]
Claims = dict[Cycle, Claim]
Compare = Callable[[Bids, Claims, float], bool]
"""Return whether a contender's bids beat the holder's claims, both by cycle in order, by a
margin."""


def same_cycle(bids: Bids, claims: Claims, margin: float) -> bool:
    """Compare a bid and a claim of one cycle, the newest that has both."""
    # Comparing a new bid with an old claim makes two rising utilities swap almost every cycle. An
    # older cycle's result may no longer be true.
    for cycle in reversed(bids):
        if cycle in claims:
            return beats(bids[cycle], claims[cycle], margin)
    return False


def by_newest(bids: Bids, claims: Claims, margin: float) -> bool:
    """Compare the newest bid with the newest claim, of whatever cycles: the thesis's rule.

    It is here to measure the benefit of `same_cycle`.
    """
    return bool(claims) and beats(
        bids[next(reversed(bids))], claims[next(reversed(claims))], margin
    )


COMPARISONS: Final[Mapping[str, Compare]] = {"same-cycle": same_cycle, "last-heard": by_newest}


def plausible(ballot: Ballot | None, largest: Ballot | None, most: int = JUMP) -> bool:
    """Return whether a term is near enough: one corrupt term must not exclude all others."""
    return ballot is None or ballot.term <= (0 if largest is None else largest.term) + most


def _recedes(ack: Ack, before: Ack | None) -> bool:
    """Return whether the largest ballot is smaller than before, which only a new epoch can do."""
    if before is None or before.largest is None or ack.cycle.epoch != before.cycle.epoch:
        return False
    return ack.largest is None or ack.largest < before.largest


# A contender --------------------------------------------------------------------------------------


@dataclass
class Tenure:
    """The state of this contender's own tenure."""

    ballot: Ballot
    began: Cycle
    handover: Handover
    commanded: Action  # the last one; at first, the action that the exchange started from
    # The cycle in which the previous holder, now gone, avoided a collision. Until this contender's
    # inputs are newer, it may brake but not accelerate.
    careful: Cycle | None = None


@dataclass
class Rival:
    """The present holder, as known from its claims and the owner's acks."""

    claim: Claim  # its newest
    since: Cycle  # when its tenure was first seen
    claims: dict[Cycle, Claim] = field(default_factory=dict)
    gone: bool = False  # it has released, or its process was killed


class Contender:
    """One agent's contention for one resource."""

    def __init__(
        self,
        resource: Resource,
        instance: str,
        clock: CycleClock,
        exchange: Exchange,
        rng: random.Random,
        margin: float | None = None,
        compare: Compare = same_cycle,
    ) -> None:
        """Begin idle. `margin` None: the resource's margin."""
        self.resource = resource
        self.instance = instance
        self.state = State.IDLE
        self.tenure: Tenure | None = None
        self.rival: Rival | None = None
        self.largest: Ballot | None = None  # claimed, cast or acknowledged
        self.ack: Ack | None = None  # the owner's newest
        self.clock = clock
        self._exchange = exchange
        self._rng = rng
        self._margin = resource.margin if margin is None else margin
        self._compare = compare
        self._bids: dict[Cycle, Bid] = {}
        self._inputs: Cycle | None = None  # the oldest input of the newest bid
        self._claimed_at = float("-inf")  # when the claim timeout last began
        self._checked_at = float("-inf")
        self._cast_at: float | None = None  # the drawn time of a take-over
        self._apart = 0  # consecutive acks with an implausible largest ballot
        self._failures = 0  # consecutive tenures that were not obeyed
        self._rest_until = 0.0

    # Inputs --------------------------------------------------------------------------------------

    def bid(
        self, cycle: Cycle, bid: Bid | None, now: float, inputs: Cycle | None = None
    ) -> list[Message]:
        """Process this cycle's bid, or None; `inputs` is the cycle of its oldest input."""
        if bid is None:
            self._bids.clear()
            return self._do(Event.NO_BID, now)
        if self.state is State.HOLDING and self._lapsed(cycle):
            self._do(Event.OUTBID, now)  # its silence was its own: it contends anew
        _remember(self._bids, cycle, bid)
        self._inputs = inputs
        self._do(Event.BID, now)
        if self.state is State.HOLDING:
            return self._hold(cycle, bid, now)
        if self.state is State.STANDING_BACK and now >= self._rest_until:
            self._do(Event.RESTED, now)
        return self._consider(now)

    def on_claim(self, claim: Claim, now: float) -> list[Message]:
        """Process another contender's claim or release."""
        if claim.ballot.instance == self.instance or not self.clock.fresh(claim.cycle):
            return []
        if not plausible(claim.ballot, self.largest):
            return []
        if self.largest is not None and claim.ballot < self.largest:
            return []  # beaten already; it receives the winner's claim
        self.largest = claim.ballot
        messages = self._do(Event.OUTBID, now)
        self._follow(claim, now)
        return messages + self._consider(now)

    def acked(self, ack: Ack, now: float) -> list[Message]:
        """Process the owner's ack: the largest ballot it knows and the last one it obeyed."""
        self._agree(ack.largest, now)
        largest, tenure, rival = ack.largest, self.tenure, self.rival
        before = self.ack
        known = plausible(largest, self.largest) and not _recedes(ack, before)
        if not known and before is not None:
            # Whom it obeys is doubted like its ballot, until another ack says the same.
            ack = replace(ack, obeyed=before.obeyed, obeyed_cycle=before.obeyed_cycle)
        self.ack = ack
        if largest is not None and known:
            if self.largest is None or largest > self.largest:
                self.largest = largest
                if rival is not None and largest > rival.claim.ballot:
                    # Its successor's claims were lost here. The claim timeout begins anew, so that
                    # the successor has time to be obeyed.
                    self.rival, self._claimed_at = None, now
            if self.state is State.HOLDING and tenure is not None:
                if largest > tenure.ballot:
                    return self._do(Event.OUTBID, now)
                if ack.obeyed == tenure.ballot:
                    self._failures = 0
            if rival is not None and rival.claim.ballot == largest and self._released(ack, rival):
                rival.gone = True  # its release was lost here
            self._follow_ack(ack)
        # An ack begins a cycle. If this cycle's bid is still to come, that bid decides: otherwise
        # a command by the last bid would be followed at once by another one.
        newest = next(reversed(self._bids), None)
        return [] if newest is not None and newest < ack.cycle else self._consider(now)

    def gone(self, instance: str, now: float) -> list[Message]:
        """Process the end of an instance's liveliness token."""
        rival = self.rival
        if rival is None or rival.claim.ballot.instance != instance:
            return []
        # Only a holder that was just claiming has been killed. If its claims stopped before, the
        # network is partitioned, and the owner may still receive its commands.
        if now < self._silent_at and not self.clock.listening:
            rival.gone = True
        return self._consider(now)

    def returned(self, now: float) -> None:
        """Discard what belongs to cycles that the clock no longer counts, except the ballot.

        A holder stops publishing as if it were outbid, because its tenure's first cycle never
        existed and the tenure has no age. It contends again after the claim timeout.
        """
        self._do(Event.OUTBID, now)
        self.tenure = self.rival = self.ack = self._inputs = None
        self._bids.clear()
        self._claimed_at = now

    def tick(self, now: float) -> list[Message]:
        """Check for a claim timeout at a wake-up, without waiting for the next cycle."""
        self._checked_at = now
        return self._consider(now)

    @property
    def wakeup(self) -> float | None:
        """When `tick` is due, s; None: not at all.

        A timeout is checked once. If the ack shows that the holder is still obeyed, the next ack or
        bid checks again.
        """
        if self.state is not State.CONTENDING:
            return None
        if self._cast_at is not None:
            return self._cast_at
        due = self._silent_at
        return due if self.rival is not None and due > self._checked_at else None

    receives: Final[tuple[type[Message], ...]] = ()

    def on_message(self, message: Message, now: float) -> list[Message]:  # noqa: ARG002
        return []

    @property
    def holding(self) -> bool:
        return self.state is State.HOLDING

    @property
    def speaker(self) -> str:
        """The instance whose commands carry its bids: its own."""
        return self.instance

    @property
    def share(self) -> float:
        """1 while it holds the resource, else 0."""
        return float(self.state is State.HOLDING)

    @property
    def owned(self) -> bool:
        """Whether the resource has an owner: its ack is fresh."""
        return self.ack is not None and self.clock.fresh(self.ack.cycle)

    @property
    def measured(self) -> Action:
        """The resource's measured action by its ack; neutral if that is missing or malformed."""
        ack, resource = self.ack, self.resource
        return resource.neutral if ack is None or resource.fault(ack.measured) else ack.measured

    # Decisions -----------------------------------------------------------------------------------

    def _consider(self, now: float) -> list[Message]:
        """Take over if there is a reason."""
        if self.state is not State.CONTENDING or not self._bids:
            return []
        event = self._reason(now)
        if event is None:
            self._cast_at = None
            return []
        if event is not Event.BETTER:
            if self._cast_at is None:
                rank = 1.0 - self._bids[next(reversed(self._bids))].utility
                share = 0.5 * rank + 0.5 * self._rng.random()
                self._cast_at = now + DRAW * self.clock.period * share
            if now < self._cast_at:
                return []
        return self._do(event, now)

    def _reason(self, now: float) -> Event | None:
        cycle = next(reversed(self._bids))
        if self._bids[cycle].utility <= 0.0 or not self.clock.fresh(cycle):
            return None  # a bid of 0 does not take over
        if self.clock.listening or not self.clock.alive(now) or not self.owned:
            return None
        if self.largest is not None and self.largest.term >= LARGEST_COUNT:
            return None  # there is no next term: the society must be restarted
        rival = self.rival
        if rival is not None and rival.gone:
            return Event.VACANT
        if now >= self._silent_at and not self._obeyed() and not self._claimed(cycle):
            return Event.UNOBEYED
        if rival is None:
            return None
        if self._cycles_without(rival.since, None) > UNOBEYED:
            return Event.UNOBEYED
        return Event.BETTER if self._compare(self._bids, rival.claims, self._margin) else None

    def _hold(self, cycle: Cycle, bid: Bid, now: float) -> list[Message]:
        """Publish as the holder, or release."""
        tenure = self.tenure
        assert tenure is not None, "a holder has a tenure"
        if self._cycles_without(tenure.began, tenure.ballot) >= UNOBEYED:
            return self._do(Event.NOT_OBEYED, now)
        # With a bid of 0 the holder offers the resource to any contender. An immediate release
        # would jerk a robot that another agent drives on.
        if len(self._bids) == KEPT_CYCLES and not any(b.utility > 0 for b in self._bids.values()):
            return self._do(Event.NO_BID, now)
        return self._command(cycle, bid)

    def _do(self, event: Event, now: float) -> list[Message]:
        """Make the event's transition; return the messages to publish."""
        found = TRANSITIONS.get((self.state, event))
        if found is None:
            return []
        self.state, step = found
        self._cast_at = None
        if step is Step.CAST:
            return self._cast(event, now)
        if step is Step.YIELD:
            # Otherwise the loser takes over again before it receives the winner's claim.
            self._claimed_at = now
        elif step is Step.RELEASE:
            if self.state is State.STANDING_BACK:
                self._rest_until = now + STAND_BACK[min(self._failures, len(STAND_BACK) - 1)]
                self._failures += 1
            return self._release()
        return []

    def _cast(self, event: Event, now: float) -> list[Message]:
        cycle = next(reversed(self._bids))
        bid = self._bids[cycle]
        term = 1 if self.largest is None else self.largest.term + 1
        ballot = self.largest = Ballot(term, bid.utility, bid.critical, self.instance)
        rival, loser = self.rival, None if self.rival is None else self.rival.claim
        start, weight = self.measured, bid.utility
        if rival is not None and loser is not None and loser.utility is not None:
            weight = loser.utility
            # An old command is not what the resource does now. Neither is one that the owner did
            # not obey, or the neutral action of a release while the robot still brakes.
            recent = self.clock.fresh(loser.cycle) and self._drives(rival)
            if recent and event is not Event.UNOBEYED and not self.resource.fault(loser.commanded):
                start = loser.commanded
        careful = None
        if loser is not None and loser.critical and event is not Event.BETTER:
            careful = loser.cycle
        handover = self._exchange.begin(self.resource, start, weight, bid, self.clock.period)
        self.tenure = Tenure(ballot, cycle, handover, start, careful)
        self.rival, self._claimed_at = None, now
        return self._command(cycle, bid)

    def _command(self, cycle: Cycle, bid: Bid) -> list[Message]:
        """Return the command and the claim of a cycle.

        The command comes first: when a contender answers the claim, the command is on its way.
        """
        tenure, name = self.tenure, self.resource.name
        assert tenure is not None, "only a holder commands"
        began = tenure.began
        t = cycle.number - began.number + 1 if began.epoch == cycle.epoch else 1_000_000
        action = tenure.handover.action(t, bid)
        if tenure.careful is not None:
            seen = self._inputs
            if seen is None or seen.epoch != tenure.careful.epoch or seen > tenure.careful:
                tenure.careful = None
            else:
                action = braked(action, tenure.commanded, self.resource.neutral)
        tenure.commanded = action
        return [
            Command(name, cycle, tenure.ballot, action),
            Claim(name, tenure.ballot, cycle, bid.utility, bid.critical, bid.packed, action),
        ]

    def _release(self) -> list[Message]:
        """Return a command and a claim that release.

        Whichever arrives first releases; the owner rejects the tenure's later messages.
        """
        tenure, cycle, name = self.tenure, self.clock.newest, self.resource.name
        self.tenure, self._claimed_at = None, float("-inf")  # there is no holder to wait for
        self._bids.clear()
        if cycle is None or tenure is None:
            return []
        nothing = self.resource.neutral
        return [
            Command(name, cycle, tenure.ballot, None),
            Claim(name, tenure.ballot, cycle, None, commanded=nothing),
        ]

    # Bookkeeping ---------------------------------------------------------------------------------

    @property
    def _silent_at(self) -> float:
        # The wake-up and the rule must use one value: a difference in the last bit would matter.
        return self._claimed_at + SILENCE * self.clock.period

    def _follow(self, claim: Claim, now: float) -> None:
        """Store a holder's claim or release."""
        rival = self.rival
        if rival is None or rival.claim.ballot != claim.ballot:
            rival = self.rival = Rival(claim, self.clock.newest or claim.cycle)
        elif rival.gone and rival.claim.utility is None:
            return  # a late claim of a tenure that is over
        rival.claim, rival.gone, self._claimed_at = claim, claim.utility is None, now
        if claim.utility is None:
            rival.claims.clear()
        else:
            _remember(rival.claims, claim.cycle, claim)

    def _follow_ack(self, ack: Ack) -> None:
        """Use the obeyed bid in an ack as the holder's claim, in case the claim is lost."""
        at, ballot = ack.obeyed_cycle, ack.obeyed
        if at is None or ballot is None or ballot != self.largest or not self.clock.fresh(at):
            return
        if ballot.instance == self.instance:
            return
        rival = self.rival
        claim = Claim(self.resource.name, ballot, at, ack.utility, ack.critical)
        if rival is None or rival.claim.ballot != ballot:
            rival = self.rival = Rival(claim, self.clock.newest or at)
        if not rival.gone and at not in rival.claims:
            _remember(rival.claims, at, claim)

    def _agree(self, largest: Ballot | None, now: float) -> None:
        """Adopt the owner's largest ballot, larger or smaller, if both are too far apart.

        That happens when some agents accepted a term that others rejected, and when the owner
        restarts, as it then knows no ballot.
        """
        apart = not (plausible(largest, self.largest) and plausible(self.largest, largest, STEP))
        self._apart = self._apart + 1 if apart else 0
        if self._apart >= APART:
            self._apart = 0
            self.largest, self.rival, self._claimed_at = largest, None, now

    @staticmethod
    def _released(ack: Ack, rival: Rival) -> bool:
        """Return whether the owner has the rival's release: it obeys no ballot since its claim."""
        at, claimed = ack.obeyed_cycle, rival.claim.cycle
        over = at is not None and at.epoch == claimed.epoch and at.number >= claimed.number
        return ack.obeyed is None and over

    def _drives(self, rival: Rival) -> bool:
        """Return whether the owner obeys a rival, whose tenure may be newer than its ack."""
        ack, since = self.ack, rival.since
        if ack is None:
            return False
        older = ack.cycle.epoch == since.epoch and ack.cycle.number <= since.number
        return older or ack.obeyed == rival.claim.ballot

    def _obeyed(self) -> bool:
        """Return whether the owner obeyed the largest known ballot within the last cycle."""
        ack = self.ack
        if ack is None or ack.obeyed is None or ack.obeyed_cycle is None or self.largest is None:
            return False
        age = self.clock.age(ack.obeyed_cycle)
        return ack.obeyed >= self.largest and age is not None and age <= 1

    def _claimed(self, cycle: Cycle) -> bool:
        """Return whether the holder has claimed in a cycle, or after it.

        Then no newer cycle has arrived here, and the holder's silence says nothing of it.
        """
        if self.rival is None:
            return False
        at = self.rival.claim.cycle
        return at.epoch == cycle.epoch and at.number >= cycle.number

    def _lapsed(self, cycle: Cycle) -> bool:
        """Whether this holder's last command was obeyed, and it has made no bid for long since.

        That is a holder without fresh inputs, for example. Cycles that it missed do not count.
        """
        last, ack, tenure = next(reversed(self._bids), None), self.ack, self.tenure
        if last is None or ack is None or tenure is None or ack.obeyed != tenure.ballot:
            return False
        resumed = 0 if self.clock.resumed is None else self.clock.resumed.number
        paused = cycle.epoch == last.epoch and cycle.number - max(last.number, resumed) >= UNOBEYED
        return paused and ack.obeyed_cycle == last

    def _cycles_without(self, since: Cycle, ballot: Ballot | None) -> int:
        """Return the cycles since a tenure began or a ballot (None: any) was last obeyed.

        The later one counts. Cycles that this agent missed do not.
        """
        newest, resumed = self.clock.newest, self.clock.resumed
        if newest is None or resumed is None:
            return 0
        last = max(resumed.number, since.number if since.epoch == newest.epoch else 0)
        ack = self.ack
        if ack is not None and ack.obeyed_cycle is not None and ack.obeyed is not None:
            ours = ballot is None or ack.obeyed == ballot
            if ours and ack.obeyed_cycle.epoch == newest.epoch:
                last = max(last, ack.obeyed_cycle.number)
        return newest.number - last


def braked(action: Action, last: Action, neutral: Action) -> Action:
    """Limit each number of an action to be no farther from neutral than the last command's."""
    if isinstance(action, bytes) or isinstance(last, bytes) or isinstance(neutral, bytes):
        return action
    if not len(action) == len(last) == len(neutral):
        return neutral
    return tuple(
        min(max(wanted, min(rest, before)), max(rest, before))
        for wanted, before, rest in zip(action, last, neutral, strict=True)
    )


# The owner ----------------------------------------------------------------------------------------


class Verdict(StrEnum):
    """An owner's decision on a command."""

    OBEYED = "obeyed"
    RELEASED = "released"
    LISTENING = "its owner has just started and listens for 3 cycles"
    STOPPED = "the robot is stopped"
    OLD_CYCLE = "its cycle is stale, or too far ahead"
    STALE_BALLOT = "its ballot is smaller than the largest obeyed or received"
    OVER = "its tenure has been released"
    IMPLAUSIBLE = "its term is too far above the largest known"
    OUT_OF_RANGE = "its action is not one of this resource, or beyond its limits"
    UNAVAILABLE = "the resource is not ready"
    NOT_ITS_KEY = "its sender is not the publisher that its key names"
    NOT_CRITICAL = "it is critical, which its agent's class does not declare"


class Owner:
    """The owner's side of a resource: it rejects commands and never chooses a holder."""

    def __init__(
        self,
        resource: Resource,
        clock: CycleClock,
        may_be_critical: Callable[[str], bool] | None = None,
    ) -> None:
        """Begin without a holder.

        The clock counts the resource's cycles. `may_be_critical` tells whether an instance's bids
        may be; None: all of them.
        """
        self.resource = resource
        self.largest: Ballot | None = None
        self.obeyed: Ballot | None = None
        self.obeyed_cycle: Cycle | None = None
        self.active = False  # it has obeyed a command and not rested since
        self.refusals: Counter[str] = Counter()  # since the last report, by verdict
        self.clock = clock
        self._may_be_critical = may_be_critical
        self._barred: Ballot | None = None  # the tenure of a claim that may not be critical
        self._over: Ballot | None = None  # the tenure that was released
        self._leapt: Cycle | None = None  # when a leap was accepted last
        self._rank = (0.0, False)  # utility and critical of the obeyed tenure
        self._obeyed_at = float("-inf")

    def on_claim(self, claim: Claim) -> bool:
        """Note a claim's ballot; smaller ones are rejected from now on.

        Returns whether the resource is to be rested: the obeyed tenure was released.
        """
        if not self.clock.fresh(claim.cycle) or not self._plausible(claim.ballot):
            return False
        if not self._may(claim.ballot, critical=claim.critical):
            self._barred = claim.ballot
            self._refuse(claim.ballot, Verdict.NOT_CRITICAL)
            return False
        self._learn(claim.ballot)
        if claim.utility is None:
            return self._end(claim.ballot, claim.cycle)
        if claim.ballot == self.obeyed:
            self._rank = (claim.utility, claim.critical)
        return False

    def judge(
        self, command: Command, now: float, *, stopped: bool = False, fault: str = ""
    ) -> Verdict:
        """Decide on a command, by the first reason that holds.

        `stopped`: the robot's stop is latched. `fault` is what is wrong with the action; empty if
        nothing.
        """
        verdict = self._verdict(command, now, stopped=stopped, fault=fault)
        if verdict is Verdict.RELEASED:
            self._learn(command.ballot)
            self._end(command.ballot, command.cycle)
        elif verdict is Verdict.OBEYED:
            ballot = command.ballot
            self._learn(ballot)
            if ballot != self.obeyed:
                self._rank = (ballot.utility, ballot.critical)
            self.obeyed, self.obeyed_cycle = ballot, command.cycle
            self._obeyed_at, self.active = now, True
        else:
            self._refuse(command.ballot, verdict)
        return verdict

    def _refuse(self, ballot: Ballot, verdict: Verdict) -> None:
        by = f"{ballot.instance}: " if verdict is Verdict.NOT_CRITICAL else ""
        self.refusals[f"{by}{verdict}"] += 1

    def _may(self, ballot: Ballot, *, critical: bool = False) -> bool:
        """Return whether an instance may be as critical as its ballot, and its claim, are."""
        if self._may_be_critical is None or not (critical or ballot.critical):
            return True
        return self._may_be_critical(ballot.instance)

    def returned(self) -> None:
        """Discard the obeyed cycle that the clock no longer counts; the largest ballot stays."""
        self.obeyed, self.obeyed_cycle, self._rank = None, None, (0.0, False)

    def rested(self) -> None:
        """End the command timeout: the resource was brought to rest."""
        self.active = False

    @property
    def silent_at(self) -> float | None:
        """When the command timeout ends, s; None if the resource rests."""
        if not self.active:
            return None
        return self._obeyed_at + self.resource.silence(self.clock.period)

    def ack(self, measured: Action) -> Ack | None:
        """Return the acknowledgement of the newest cycle; None before the first."""
        cycle = self.clock.newest
        if cycle is None:
            return None
        return Ack(
            self.resource.name,
            cycle,
            self.largest,
            self.obeyed,
            self.obeyed_cycle,
            *self._rank,
            measured,
        )

    def _verdict(self, command: Command, now: float, *, stopped: bool, fault: str) -> Verdict:
        clock, ballot, cycle = self.clock, command.ballot, command.cycle
        obeyed, at = self.obeyed, self.obeyed_cycle
        # The cycle ended long ago, or the owner hung and the command waited meanwhile.
        if not clock.fresh(cycle) or not clock.alive(now):
            return Verdict.OLD_CYCLE
        if not self._plausible(ballot):
            return Verdict.IMPLAUSIBLE
        if ballot == self._barred or not self._may(ballot):
            return Verdict.NOT_CRITICAL
        if self.largest is not None and ballot < self.largest:
            return Verdict.STALE_BALLOT
        if ballot == self._over:
            return Verdict.OVER
        if obeyed == ballot and at is not None and cycle < at:
            return Verdict.OLD_CYCLE
        if command.action is None:
            return Verdict.RELEASED
        if fault:
            return Verdict.OUT_OF_RANGE
        if stopped:
            return Verdict.STOPPED
        return Verdict.LISTENING if clock.begun_lately else Verdict.OBEYED

    def _plausible(self, ballot: Ballot) -> bool:
        """Return whether a term is near enough to the largest; a leap, if none was just made."""
        if plausible(ballot, self.largest, STEP):
            return True
        since = None if self._leapt is None else self.clock.age(self._leapt)
        return plausible(ballot, self.largest) and (since is None or since >= LEAP_CYCLES)

    def _learn(self, ballot: Ballot) -> None:
        if self.largest is None or ballot > self.largest:
            if not plausible(ballot, self.largest, STEP):
                self._leapt = self.clock.newest
            self.largest = ballot

    def _end(self, ballot: Ballot, cycle: Cycle) -> bool:
        """Note a release, from the command or the claim; return whether to rest the resource."""
        if ballot == self._over or ballot != self.largest:
            return False
        self._over = ballot
        if ballot != self.obeyed:
            return False
        self.obeyed, self.obeyed_cycle, self._rank = None, cycle, (0.0, False)
        return True


def _remember(by_cycle: dict[Cycle, T], cycle: Cycle, value: T) -> None:
    by_cycle[cycle] = value
    while len(by_cycle) > KEPT_CYCLES:
        del by_cycle[next(iter(by_cycle))]
