"""Who holds a resource: claims, ballots and winner determination, with nobody in charge.

Sans-IO: bids, claims, acks and the time go in, messages to publish come out. The holder of a
resource publishes, each cycle, its command and then its claim. A contender compares bids **of the
same cycle**. If its own is better it casts a ballot of the next term and takes over at once.
Whoever is beaten publishes nothing, so the talk of a cycle does not grow with the losers.

A **ballot** is a fencing token: (term, rank when cast, instance), totally ordered and fixed for a
tenure. The owner of the resource refuses whatever carries a smaller ballot than the largest it has
obeyed or received, and its ack tells everybody. It chooses nobody.

The rules are the two tables `TRANSITIONS` and `Owner.judge`; everything else is bookkeeping. Two
things do not fit the first table and live in the guards beside it: *listening* (`CycleClock`: who
starts, or has missed cycles, takes nothing over for as many: who was itself away knows nothing of
the others), and the *draw* (where many may take over at once, each waits for a moment).

Thesis: 3.3.2, 3.10 and figure 3.30, whose states 1 and 2 are IDLE here, 3 HOLDING, 4 CONTENDING.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Final, TypeVar

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

SILENCE: Final = 2.3
"""Claim timeout, in cycles: before the owner's stop, and after a claim that is a cycle late. With
1.5 an agent that bids every other cycle makes the wheels change hands ten times a second."""

UNOBEYED: Final = 6
"""Cycles that a tenure may go on without being obeyed; others wait for one more. With 3, two hops
of 0.1 s lock up. With 6 for all, who is deposed just before it would let go does not stand back,
and takes over again at once."""

STAND_BACK: Final[tuple[float, ...]] = (1.0, 2.0, 4.0)
"""Seconds that a holder who was not obeyed stays away, the first time, the second, ever after:
longer each time, or two networks that cannot hear each other fight for ever."""

DRAW: Final = 0.1
"""Where many may take over at once, each waits up to this share of a cycle, the better the less."""

APART: Final = 2
"""Acks in a row whose largest ballot is out of all proportion to one's own, until the owner's word
is taken for it. One may be corrupt; but what the owner does not count with, it never obeys."""

REMEMBERED: Final = 4
"""Cycles whose bids and claims are kept to be compared. A holder that has bid 0 in all of them has
offered the resource long enough, and lets go of it."""

T = TypeVar("T")


class State(Enum):
    """Where an agent stands with a resource."""

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
    """What is done on the way."""

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
"""Every change of state; an event that is not here for a state changes nothing."""


# Winner determination -----------------------------------------------------------------------------


def beats(bid: Bid, claim: Claim, margin: float) -> bool:
    """Winner determination (3.10.1): better by more than the margin, or as good and critical.

    Rank is (utility, critical): goto and gothrough reach 1.0 as avoid does, and about to collide
    goes first.
    """
    assert claim.utility is not None, "a release is not a bid"
    if bid.utility > claim.utility + margin:
        return True
    return bid.critical and not claim.critical and bid.utility >= claim.utility


Bids = dict[Cycle, Bid]
Claims = dict[Cycle, Claim]
Compare = Callable[[Bids, Claims, float], bool]
"""Whether one's bids beat the holder's claims, both by cycle, the newest last, by a margin."""


def same_cycle(bids: Bids, claims: Claims, margin: float) -> bool:
    """Compare bids of one cycle, the newest for which both are there.

    A new bid against an old claim makes two rising utilities swap almost every cycle; and what was
    better in an older cycle may be worse by now.
    """
    for cycle in reversed(bids):
        if cycle in claims:
            return beats(bids[cycle], claims[cycle], margin)
    return False


def last_heard(bids: Bids, claims: Claims, margin: float) -> bool:
    """Compare the newest bid with the newest claim, whatever cycles they answer.

    The rule as the thesis wrote it, to measure what comparing like with like is worth.
    """
    return bool(claims) and beats(
        bids[next(reversed(bids))], claims[next(reversed(claims))], margin
    )


COMPARISONS: Final[Mapping[str, Compare]] = {"same-cycle": same_cycle, "last-heard": last_heard}


def plausible(ballot: Ballot | None, largest: Ballot | None) -> bool:
    """Whether a ballot is not absurdly far ahead: one corrupt term must not end all others."""
    return ballot is None or ballot.term <= (0 if largest is None else largest.term) + JUMP


# A contender --------------------------------------------------------------------------------------


@dataclass
class Tenure:
    """What goes with one's own ballot."""

    ballot: Ballot
    began: Cycle
    handover: Handover
    commanded: Action  # last; before the first command, what the exchange started from
    # The loser was about to collide in this cycle, and is gone. Until one's own inputs are newer
    # than what it knew, one may brake, and not accelerate.
    careful: Cycle | None = None


@dataclass
class Rival:
    """The holder, as far as it is known."""

    claim: Claim  # its newest
    since: Cycle  # when its tenure was first seen
    claims: dict[Cycle, Claim] = field(default_factory=dict)
    gone: bool = False  # it has released, or its process was killed


class Contender:
    """One agent's side of one resource."""

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
        """Begin idle; `margin` None is the resource's own."""
        self.resource = resource
        self.instance = instance
        self.state = State.IDLE
        self.tenure: Tenure | None = None
        self.rival: Rival | None = None
        self.largest: Ballot | None = None  # claimed, cast or acknowledged: what there is to beat
        self.ack: Ack | None = None  # the owner's newest
        self.clock = clock
        self._exchange = exchange
        self._rng = rng
        self._margin = resource.margin if margin is None else margin
        self._compare = compare
        self._bids: dict[Cycle, Bid] = {}
        self._inputs: Cycle | None = None  # the oldest that the newest bid was made of
        self._heard_at = float("-inf")  # when the claim timeout last began
        self._looked_at = float("-inf")
        self._take_at: float | None = None  # what was drawn
        self._apart = 0  # acks in a row that are out of all proportion
        self._failures = 0  # tenures in a row that were not obeyed
        self._rest_until = 0.0

    # What comes in -------------------------------------------------------------------------------

    def bid(
        self, cycle: Cycle, bid: Bid | None, now: float, inputs: Cycle | None = None
    ) -> list[Message]:
        """Take this cycle's bid, or the lack of one; `inputs` is the oldest that it rests on."""
        if bid is None:
            self._bids.clear()
            return self._do(Event.NO_BID, now)
        _remember(self._bids, cycle, bid)
        self._inputs = inputs
        self._do(Event.BID, now)
        if self.state is State.HOLDING:
            return self._hold(cycle, bid, now)
        if self.state is State.STANDING_BACK and now >= self._rest_until:
            self._do(Event.RESTED, now)
        return self._consider(now)

    def on_claim(self, claim: Claim, now: float) -> list[Message]:
        """Take somebody's claim or release."""
        if claim.ballot.instance == self.instance or not self.clock.fresh(claim.cycle):
            return []
        if not plausible(claim.ballot, self.largest):
            return []
        if self.largest is not None and claim.ballot < self.largest:
            return []  # beaten already; it will hear so from whoever beat it
        self.largest = claim.ballot
        said = self._do(Event.OUTBID, now)
        self._follow(claim, now)
        return said + self._consider(now)

    def acked(self, ack: Ack, now: float) -> list[Message]:
        """Take the owner's word: the largest ballot it knows, and the last one it obeyed."""
        self.ack = ack
        self._agree(ack.largest, now)
        largest, tenure, rival = ack.largest, self.tenure, self.rival
        if largest is not None and plausible(largest, self.largest):
            if self.largest is None or largest > self.largest:
                self.largest = largest
                if rival is not None and largest > rival.claim.ballot:
                    # Its successor's claims did not come here: it is given the time to be obeyed.
                    self.rival, self._heard_at = None, now
            if self.state is State.HOLDING and tenure is not None:
                if largest > tenure.ballot:
                    return self._do(Event.OUTBID, now)
                if ack.obeyed == tenure.ballot:
                    self._failures = 0
            if rival is not None and rival.claim.ballot == largest and self._released(ack, rival):
                rival.gone = True  # its release did not come here
            self._follow_ack(ack)
        # An ack comes at the beginning of a cycle. If the bid for that is still to come, it looks
        # instead: or there would be a command by the last bid, and a moment later one by this.
        newest = next(reversed(self._bids), None)
        return [] if newest is not None and newest < ack.cycle else self._consider(now)

    def gone(self, instance: str, now: float) -> list[Message]:
        """Take the news that an instance's liveliness token has gone.

        Only who was just claiming was killed. A token that goes after a second of silence goes by
        the same cut that hides the claims from me, and may hide nothing from the owner.
        """
        rival = self.rival
        if rival is None or rival.claim.ballot.instance != instance:
            return []
        if now < self._silent_at and not self.clock.listening:
            rival.gone = True
        return self._consider(now)

    def returned(self, now: float) -> None:
        """Forget all that answers numbers which its clock no longer counts; the ballot stays.

        Who holds falls silent as one that is outbid: a tenure that began in a cycle which never was
        has no age. It contends anew as all do, by silence.
        """
        self._do(Event.OUTBID, now)
        self.tenure = self.rival = self.ack = self._inputs = None
        self._bids.clear()
        self._heard_at = now

    def tick(self, now: float) -> list[Message]:
        """Take the time: silence is noticed by a wake-up, not at the next cycle."""
        self._looked_at = now
        return self._consider(now)

    @property
    def wakeup(self) -> float | None:
        """When `tick` should be called, s; None if nothing is waited for.

        One look a silence: if the ack shows that the holder is obeyed all the same, the next ack or
        bid looks again.
        """
        if self.state is not State.CONTENDING:
            return None
        if self._take_at is not None:
            return self._take_at
        due = self._silent_at
        return due if self.rival is not None and due > self._looked_at else None

    @property
    def holding(self) -> bool:
        """Whether this agent holds the resource, as far as it knows."""
        return self.state is State.HOLDING

    @property
    def owned(self) -> bool:
        """Whether somebody owns the resource: its ack is fresh."""
        return self.ack is not None and self.clock.fresh(self.ack.cycle)

    @property
    def measured(self) -> Action:
        """What the resource does now, by its owner's word, if that is of its shape."""
        said, resource = self.ack, self.resource
        return resource.neutral if said is None or resource.fault(said.measured) else said.measured

    # How it is settled ---------------------------------------------------------------------------

    def _consider(self, now: float) -> list[Message]:
        """Take over, if there is a reason to."""
        if self.state is not State.CONTENDING or not self._bids:
            return []
        event = self._reason(now)
        if event is None:
            self._take_at = None
            return []
        if event is not Event.BETTER:
            if self._take_at is None:
                rank = 1.0 - self._bids[next(reversed(self._bids))].utility
                share = 0.5 * rank + 0.5 * self._rng.random()
                self._take_at = now + DRAW * self.clock.period * share
            if now < self._take_at:
                return []
        return self._do(event, now)

    def _reason(self, now: float) -> Event | None:
        cycle = next(reversed(self._bids))
        if self._bids[cycle].utility <= 0.0 or not self.clock.fresh(cycle):
            return None  # an offer takes nothing
        if self.clock.listening or not self.clock.alive(now) or not self.owned:
            return None
        if self.largest is not None and self.largest.term >= LARGEST_COUNT:
            return None  # there is no next term; everybody must be started anew
        rival = self.rival
        if rival is not None and rival.gone:
            return Event.VACANT
        if now >= self._silent_at and not self._obeyed():
            return Event.UNOBEYED
        if rival is None:
            return None
        if self._cycles_without(rival.since, None) > UNOBEYED:
            return Event.UNOBEYED
        return Event.BETTER if self._compare(self._bids, rival.claims, self._margin) else None

    def _hold(self, cycle: Cycle, bid: Bid, now: float) -> list[Message]:
        """Speak as the holder, unless it is time to let go."""
        tenure = self.tenure
        assert tenure is not None, "who holds has a ballot"
        if self._cycles_without(tenure.began, tenure.ballot) >= UNOBEYED:
            return self._do(Event.NOT_OBEYED, now)
        # A bid of 0 offers: anybody takes over. Releasing at once would jerk a robot that another
        # drives on.
        if len(self._bids) == REMEMBERED and not any(b.utility > 0 for b in self._bids.values()):
            return self._do(Event.NO_BID, now)
        return self._speak(cycle, bid)

    def _do(self, event: Event, now: float) -> list[Message]:
        """Look the event up in the table, and act."""
        found = TRANSITIONS.get((self.state, event))
        if found is None:
            return []
        self.state, step = found
        self._take_at = None
        if step is Step.CAST:
            return self._cast(event, now)
        if step is Step.YIELD:
            self._heard_at = now  # or the beaten one takes over again before the winner's claim
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
        loser = self.rival.claim if self.rival is not None else None
        start, weight = self.measured, bid.utility
        if loser is not None and loser.utility is not None:
            weight = loser.utility
        # What was commanded long ago is not what the resource does now, nor is the rest that goes
        # with a release, while it still brakes.
        within = 1 if loser is not None and loser.utility is None else None
        recent = loser is not None and self.clock.fresh(loser.cycle, within)
        if loser is not None and recent and event is not Event.UNOBEYED:
            start = start if self.resource.fault(loser.commanded) else loser.commanded
        careful = None
        if loser is not None and loser.critical and event is not Event.BETTER:
            careful = loser.cycle
        handover = self._exchange.begin(self.resource, start, weight, bid, self.clock.period)
        self.tenure = Tenure(ballot, cycle, handover, start, careful)
        self.rival, self._heard_at = None, now
        return self._speak(cycle, bid)

    def _speak(self, cycle: Cycle, bid: Bid) -> list[Message]:
        """The command, then the claim, with one ballot.

        Whoever receives the claim may answer it, and by then the command is on its way.
        """
        tenure, name = self.tenure, self.resource.name
        assert tenure is not None, "who speaks holds"
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
            Claim(name, tenure.ballot, cycle, bid.utility, bid.critical, bid.action, action),
        ]

    def _release(self) -> list[Message]:
        """Either message releases: the owner refuses what is left of the tenure in the other."""
        tenure, cycle, name = self.tenure, self.clock.newest, self.resource.name
        self.tenure, self._heard_at = (
            None,
            float("-inf"),
        )  # nobody holds it now, as far as one knows
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
        """When the claim timeout is over, s: the wake-up and the rule, to the last bit."""
        return self._heard_at + SILENCE * self.clock.period

    def _follow(self, claim: Claim, now: float) -> None:
        """Remember a holder's claim or release."""
        rival = self.rival
        if rival is None or rival.claim.ballot != claim.ballot:
            rival = self.rival = Rival(claim, self.clock.newest or claim.cycle)
        elif rival.gone and rival.claim.utility is None:
            return  # a late claim of a tenure that is over
        rival.claim, rival.gone, self._heard_at = claim, claim.utility is None, now
        if claim.utility is None:
            rival.claims.clear()
        else:
            _remember(rival.claims, claim.cycle, claim)

    def _follow_ack(self, ack: Ack) -> None:
        """Who cannot hear the holder still compares, by what the owner obeys of it."""
        at, ballot = ack.obeyed_cycle, ack.obeyed
        if at is None or ballot is None or ballot != self.largest or not self.clock.fresh(at):
            return
        if ballot.instance == self.instance:
            return
        rival = self.rival
        heard = Claim(self.resource.name, ballot, at, ack.utility, ack.critical)
        if rival is None or rival.claim.ballot != ballot:
            rival = self.rival = Rival(heard, self.clock.newest or at)
        if not rival.gone and at not in rival.claims:
            _remember(rival.claims, at, heard)

    def _agree(self, largest: Ballot | None, now: float) -> None:
        """Believe the owner, up or down, if both could never agree.

        Some may have believed a term that others refused, a few such terms one after another lead
        anywhere, and an owner that starts anew knows of none.
        """
        apart = not (plausible(largest, self.largest) and plausible(self.largest, largest))
        self._apart = self._apart + 1 if apart else 0
        if self._apart >= APART:
            self._apart = 0
            self.largest, self.rival, self._heard_at = largest, None, now

    @staticmethod
    def _released(ack: Ack, rival: Rival) -> bool:
        """Whether the owner had the rival's release: it obeys nobody, and that after its claim."""
        at, claimed = ack.obeyed_cycle, rival.claim.cycle
        over = at is not None and at.epoch == claimed.epoch and at.number >= claimed.number
        return ack.obeyed is None and over

    def _obeyed(self) -> bool:
        """Whether the owner obeyed a ballot as large as any known, within the last cycle."""
        ack = self.ack
        if ack is None or ack.obeyed is None or ack.obeyed_cycle is None or self.largest is None:
            return False
        age = self.clock.age(ack.obeyed_cycle)
        return ack.obeyed >= self.largest and age is not None and age <= 1

    def _cycles_without(self, since: Cycle, ballot: Ballot | None) -> int:
        """Cycles since a tenure began or a ballot (None: any) was last obeyed, whichever is later.

        Those that this agent missed itself do not count.
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
    """An action no farther from the neutral one, number by number, than the last one commanded."""
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
    """What the owner of a resource says to a command."""

    OBEYED = "obeyed"
    RELEASED = "released"
    LISTENING = "its owner has just started and listens for 3 cycles"
    STOPPED = "the robot is stopped"
    OLD_CYCLE = "it answers a cycle that is too old, or not yet there"
    STALE_BALLOT = "its ballot is smaller than the largest obeyed or received"
    OVER = "its tenure has been released"
    IMPLAUSIBLE = "its term is too far above the largest known"
    OUT_OF_RANGE = "its action is not one of this resource, or beyond its limits"
    UNAVAILABLE = "the resource is not ready"


class Owner:
    """The side of whoever owns a resource: it refuses, and never chooses."""

    def __init__(self, resource: Resource, clock: CycleClock) -> None:
        self.resource = resource
        self.largest: Ballot | None = None
        self.obeyed: Ballot | None = None
        self.obeyed_cycle: Cycle | None = None
        self.active = False  # it was last told to do something, and has not rested since
        self.refusals: Counter[str] = Counter()  # since they were last reported, by verdict
        self.clock = clock
        self._over: Ballot | None = None  # the tenure that was released
        self._rank = (0.0, False)  # utility and critical of what is obeyed
        self._obeyed_at = float("-inf")

    def on_claim(self, claim: Claim) -> bool:
        """Learn of a ballot: what is smaller is refused from now on. Whether to rest: a release."""
        if not self.clock.fresh(claim.cycle) or not plausible(claim.ballot, self.largest):
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
        """Obey or refuse a command, by the first reason that holds.

        Args:
            command: What is asked for.
            now: The time, s.
            stopped: Whether the robot's stop is latched.
            fault: What is wrong with the action, if anything.
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
            self.refusals[verdict] += 1
        return verdict

    def returned(self) -> None:
        """Forget whom it obeyed in a cycle that its clock no longer counts; the ballots stay."""
        self.obeyed, self.obeyed_cycle, self._rank = None, None, (0.0, False)

    def rested(self) -> None:
        """The resource was brought to rest: nothing is left to be silent about."""
        self.active = False

    @property
    def silent_at(self) -> float | None:
        """When the resource is to be rested, s, if no valid command comes before."""
        if not self.active:
            return None
        return self._obeyed_at + self.resource.silence(self.clock.period)

    def ack(self, measured: Action) -> Ack | None:
        """The acknowledgement of the newest cycle; None before there is one."""
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
        # A cycle that ended long ago, or the owner hung: what waited meanwhile is old.
        if not clock.fresh(cycle) or not clock.alive(now):
            return Verdict.OLD_CYCLE
        if not plausible(ballot, self.largest):
            return Verdict.IMPLAUSIBLE
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

    def _learn(self, ballot: Ballot) -> None:
        if self.largest is None or ballot > self.largest:
            self.largest = ballot

    def _end(self, ballot: Ballot, cycle: Cycle) -> bool:
        """A tenure is over, by whichever of its two messages comes first."""
        if ballot == self._over or ballot != self.largest:
            return False
        self._over = ballot
        if ballot != self.obeyed:
            return False
        self.obeyed, self.obeyed_cycle, self._rank = None, cycle, (0.0, False)
        return True


def _remember(by_cycle: dict[Cycle, T], cycle: Cycle, value: T) -> None:
    by_cycle[cycle] = value
    while len(by_cycle) > REMEMBERED:
        del by_cycle[next(iter(by_cycle))]
