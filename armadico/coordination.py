"""Who holds a resource: claims, ballots and winner determination, with nobody in charge.

Sans-IO: bids, claims, echoes and the time go in, messages to publish come out. The holder of a
resource publishes, each cycle, its command and then its claim. A contender compares bids **of the
same cycle**: comparing a new bid with an old claim would make two rising utilities swap almost
every cycle. If its own is better it casts a ballot of the next term and takes over at once.
Whoever is beaten says nothing, so what is said per cycle does not grow with the losers.

A **ballot** is (term, rank when cast, instance): totally ordered and fixed for a tenure. The owner
of the resource refuses whatever carries a smaller ballot than the largest it has obeyed or heard,
and its echo tells everybody. It chooses nobody.

The rules are the two tables `TRANSITIONS` and `Owner.judge`; everything else is bookkeeping.
Thesis: 3.3.2, 3.10 and figure 3.30, whose states 1 and 2 are IDLE here, 3 HOLDING, 4 CONTENDING.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, StrEnum
from typing import Final, TypeVar

from armadico.cycles import PERIOD, CycleClock
from armadico.exchange import AT_ONCE, Action, Bid, Exchange, Handover
from armadico.messages import Ballot, Claim, Cycle, Message
from armadico.resources import Resource

SILENCE: Final = 2.3 * PERIOD
"""No claim for so long, in s, and a contender takes over; before the owner's 0.3 s stop."""

GAP: Final = 1.5 * PERIOD
"""Cycles farther apart than this, in s, were missing, and so were the claims that answer them."""

AWAY: Final = 5 * PERIOD
"""Without an echo for so long, in s, this agent itself was away, by a hang or a cut,"""

BACK: Final = 2.0
"""and for so long, in s, after it is back it believes no news of tokens."""

UNOBEYED: Final = 6
"""Cycles that a tenure may go on without being obeyed. With 3, two hops of 0.1 s lock up."""

STAND_BACK: Final = (1.0, 2.0, 4.0)
"""Seconds that a holder who was not obeyed stays away, the first time, the second, ever after."""

LISTEN: Final = 3
"""Cycles for which an owner that has just started only listens."""

TERM_JUMP: Final = 2**20
"""A claim that is more terms than this above the largest known is refused."""

OFFER: Final = 3
"""Cycles for which a holder offers what it has with a bid of utility 0, before it stops."""

REMEMBERED: Final = 4  # cycles whose bids and claims are kept to be compared

T = TypeVar("T")


class State(Enum):
    """Where an agent stands with a resource."""

    IDLE = "idle"
    CONTENDING = "contending"
    HOLDING = "holding"
    STANDING_BACK = "standing back"


class Event(Enum):
    """What may change that."""

    BID = "has a bid"
    NO_BID = "has none"
    BETTER = "its bid beats the holder's of the same cycle"
    SILENCE = "no claim for 2.3 cycles, and no echo of one"
    VACANT = "the holder released, or its token is gone"
    NOBODY_OBEYED = "nobody has been obeyed for 6 cycles"
    OUTBID = "a larger ballot is heard or obeyed"
    NOT_OBEYED = "its own commands were not obeyed for 6 cycles"
    RESTED = "has stood back long enough"


class Step(Enum):
    """What is done on the way."""

    NOTHING = "nothing"
    CAST = "cast a ballot of the next term, command, claim"
    STOP_AND_RELEASE = "command what does nothing, then release"
    RELEASE = "release"
    YIELD = "fall silent, and wait for the silence anew"


TRANSITIONS: Mapping[tuple[State, Event], tuple[State, Step]] = {
    (State.IDLE, Event.BID): (State.CONTENDING, Step.NOTHING),
    (State.CONTENDING, Event.NO_BID): (State.IDLE, Step.NOTHING),
    (State.CONTENDING, Event.BETTER): (State.HOLDING, Step.CAST),
    (State.CONTENDING, Event.SILENCE): (State.HOLDING, Step.CAST),
    (State.CONTENDING, Event.VACANT): (State.HOLDING, Step.CAST),
    (State.CONTENDING, Event.NOBODY_OBEYED): (State.HOLDING, Step.CAST),
    (State.HOLDING, Event.NO_BID): (State.IDLE, Step.STOP_AND_RELEASE),
    (State.HOLDING, Event.OUTBID): (State.CONTENDING, Step.YIELD),
    (State.HOLDING, Event.NOT_OBEYED): (State.STANDING_BACK, Step.RELEASE),
    (State.STANDING_BACK, Event.RESTED): (State.CONTENDING, Step.NOTHING),
}
"""Every change of state; an event that is not here for a state changes nothing."""


def beats(bid: Bid, claim: Claim, margin: float) -> bool:
    """Winner determination (3.10.1): better by more than the margin, or as good and critical.

    Rank is (utility, critical): goto and gothrough reach 1.0 as avoid does, and about to collide
    goes first.
    """
    assert claim.utility is not None, "a release is not a bid"
    if bid.utility > claim.utility + margin:
        return True
    return bid.critical and not claim.critical and bid.utility >= claim.utility


class Contender:
    """One agent's side of one resource."""

    def __init__(
        self,
        resource: Resource,
        instance: str,
        cycles: CycleClock,
        exchange: Exchange,
        margin: float | None = None,
        *,
        same_cycle: bool = True,
    ) -> None:
        """Begin idle.

        `same_cycle` False compares a new bid with the claim last heard, whatever cycle that
        answers: the rule as the thesis wrote it, to measure what comparing like with like is worth.
        """
        self.resource = resource
        self.instance = instance
        self.state = State.IDLE
        self.ballot: Ballot | None = None  # of the tenure that goes on, or of the last one
        self.largest: Ballot | None = None  # heard, cast or echoed: what there is to beat
        self.rival: Claim | None = None  # the holder's newest claim
        self._cycles = cycles
        self._exchange = exchange
        self._margin = resource.margin if margin is None else margin
        self._same_cycle = same_cycle
        self._bids: dict[Cycle, Bid] = {}
        self._claims: dict[Cycle, Claim] = {}  # the rival's, by cycle
        self._measured: Action = resource.neutral
        self._vacated: Claim | None = None  # the last claim of a holder that has gone
        self._heard_at = float("-inf")
        self._looked_at = float("-inf")
        self._echoed_at = float("inf")
        self._back_until = float("-inf")
        self._echoed_cycle: Cycle | None = None
        self._back_at: Cycle | None = None  # the first cycle after many that it missed
        self._rival_since: Cycle | None = None
        self._obeyed: tuple[Ballot, Cycle] | None = None  # by the owner's echo
        self._cast_at: Cycle | None = None
        self._handover: Handover = AT_ONCE
        self._offered = 0
        self._failures = 0
        self._rest_until = 0.0

    # What comes in -------------------------------------------------------------------------------

    def bid(self, cycle: Cycle, bid: Bid | None, measured: Action, now: float) -> list[Message]:
        """Take this cycle's bid, or the lack of one; `measured` is what the resource does now."""
        self._measured = measured
        if bid is None:
            self._bids.clear()
            return self._do(Event.NO_BID, now)
        _remember(self._bids, cycle, bid)
        self._do(Event.BID, now)
        if self.state is State.HOLDING:
            return self._tenure(cycle, bid, now)
        if self.state is State.STANDING_BACK and now >= self._rest_until:
            self._do(Event.RESTED, now)
        return self._consider(now)

    def hear(self, claim: Claim, now: float) -> list[Message]:
        """Take somebody's claim or release."""
        if claim.ballot.instance == self.instance or not self._cycles.fresh(claim.cycle):
            return []
        if not plausible(claim.ballot, self.largest):
            return []
        if self.largest is not None and claim.ballot < self.largest:
            return []  # beaten already; it will hear so from whoever beat it
        self.largest = claim.ballot
        said = self._do(Event.OUTBID, now) if self.state is State.HOLDING else []
        if claim.utility is None:
            self._vacate(claim)
        else:
            self._follow(claim, now)
        return said + self._consider(now)

    def echo(
        self, largest: Ballot | None, obeyed: Ballot | None, at: Cycle | None, now: float
    ) -> list[Message]:
        """Take the owner's echo: the largest ballot it knows, and the last one it obeyed."""
        if largest is not None and (self.largest is None or largest > self.largest):
            self.largest = largest
        if now - self._echoed_at > GAP:  # without cycles nobody could claim: give the holder one
            self._heard_at = max(self._heard_at, now - SILENCE + PERIOD)
        if now - self._echoed_at > AWAY:
            self._back_until = now + BACK
        self._echoed_at = now
        self._notice_missed_cycles()
        self._obeyed = (obeyed, at) if obeyed is not None and at is not None else None
        if self.state is State.HOLDING and obeyed is not None and self.ballot is not None:
            if obeyed == self.ballot:
                self._failures = 0
            elif obeyed > self.ballot:
                return self._do(Event.OUTBID, now)
        return self._consider(now)

    def gone(self, instance: str, now: float) -> list[Message]:
        """Take the news that an instance's liveliness token has gone.

        Whoever hung or was cut off hears on coming back that all others have gone: it was itself
        that was away, and then only silence counts.
        """
        if self.rival is None or self.rival.ballot.instance != instance:
            return []
        if not self._cycles.alive(now) or now < self._back_until:
            return []
        self._vacate(self.rival)
        return self._consider(now)

    def tick(self, now: float) -> list[Message]:
        """Take the time: silence is noticed by a wake-up, not at the next cycle."""
        self._looked_at = now
        return self._consider(now)

    @property
    def wakeup(self) -> float | None:
        """When `tick` should be called, s; None if nothing is waited for.

        One look a silence: if the echo says that the holder is obeyed all the same, the next echo
        or bid looks again.
        """
        due = self._heard_at + SILENCE
        if self.state is State.CONTENDING and self.rival is not None and due > self._looked_at:
            return due
        return None

    @property
    def holding(self) -> bool:
        """Whether this agent holds the resource, as far as it knows."""
        return self.state is State.HOLDING

    # How it is settled ---------------------------------------------------------------------------

    def _consider(self, now: float) -> list[Message]:
        """Take over, if there is a reason to."""
        if self.state is not State.CONTENDING or not self._bids:
            return []
        cycle = next(reversed(self._bids))
        if self._bids[cycle].utility <= 0.0 or not self._cycles.fresh(cycle):
            return []
        if not self._cycles.alive(now):
            return []
        event = self._reason(now)
        return [] if event is None else self._do(event, now)

    def _reason(self, now: float) -> Event | None:
        if self._vacated is not None:
            return Event.VACANT
        if now - self._heard_at >= SILENCE and not self._echoed():
            return Event.SILENCE
        if self._cycles_without(self._rival_since, obeyed_by_anyone=True) >= UNOBEYED:
            return Event.NOBODY_OBEYED
        if not self._same_cycle:
            newest = self._bids[next(reversed(self._bids))]
            outbids = self.rival is not None and beats(newest, self.rival, self._margin)
            return Event.BETTER if outbids else None
        for cycle, bid in self._bids.items():
            claim = self._claims.get(cycle)
            if claim is not None and beats(bid, claim, self._margin):
                return Event.BETTER
        return None

    def _tenure(self, cycle: Cycle, bid: Bid, now: float) -> list[Message]:
        """Speak as the holder, unless it is time to let go."""
        if self._cycles_without(self._cast_at, obeyed_by_anyone=False) >= UNOBEYED:
            return self._do(Event.NOT_OBEYED, now)
        self._offered = self._offered + 1 if bid.utility <= 0.0 else 0
        if self._offered > OFFER:
            return self._do(Event.NO_BID, now)
        return self._speak(cycle, bid)

    def _do(self, event: Event, now: float) -> list[Message]:
        """Look the event up in the table, and act."""
        found = TRANSITIONS.get((self.state, event))
        if found is None:
            return []
        self.state, step = found
        if step is Step.CAST:
            return self._cast(event, now)
        if step is Step.YIELD:
            self._heard_at = now
            return []
        if step is Step.RELEASE:
            self._rest_until = now + STAND_BACK[min(self._failures, len(STAND_BACK) - 1)]
            self._failures += 1
            return self._release(self._cycles.newest, neutral=False)
        if step is Step.STOP_AND_RELEASE:
            return self._release(self._cycles.newest, neutral=True)
        return []

    def _cast(self, event: Event, now: float) -> list[Message]:
        cycle = next(reversed(self._bids))
        bid = self._bids[cycle]
        term = 1 if self.largest is None else self.largest.term + 1
        self.ballot = self.largest = Ballot(term, bid.utility, bid.critical, self.instance)
        loser = self._vacated or self.rival
        # What was commanded long ago is not what the wheels do now: they have been stopped since;
        # nor is the rest that went with a release, while they still brake.
        within = 1 if loser is not None and loser.utility is None else None
        recent = loser is not None and self._cycles.fresh(loser.cycle, within)
        heard = recent and event in (Event.BETTER, Event.VACANT)
        start = self._measured
        if loser is not None and heard and len(loser.commanded) == len(start):
            start = loser.commanded
        weight = bid.utility if loser is None or loser.utility is None else loser.utility
        self._handover = self._exchange.begin(start, weight, bid, self.resource.scale)
        self._cast_at, self._heard_at, self._offered = cycle, now, 0
        self.rival = self._vacated = None
        self._claims.clear()
        return self._speak(cycle, bid)

    def _speak(self, cycle: Cycle, bid: Bid) -> list[Message]:
        """The command, then the claim, with one ballot."""
        assert self.ballot is not None
        since = self._cast_at
        t = cycle.number - since.number + 1 if since and since.epoch == cycle.epoch else 1_000_000
        action = self._handover.action(t, bid)
        return [
            self.resource.command(cycle, self.ballot, action),
            Claim(
                self.resource.name,
                self.ballot,
                cycle,
                bid.utility,
                bid.critical,
                bid.action,
                action,
            ),
        ]

    def _release(self, cycle: Cycle | None, *, neutral: bool) -> list[Message]:
        if cycle is None or self.ballot is None:
            return []
        nothing = self.resource.neutral
        release = Claim(self.resource.name, self.ballot, cycle, None, commanded=nothing)
        self._heard_at = float("-inf")  # nobody holds it now, as far as this agent knows
        if neutral:
            return [self.resource.command(cycle, self.ballot, nothing), release]
        return [release]

    # Bookkeeping ---------------------------------------------------------------------------------

    def _follow(self, claim: Claim, now: float) -> None:
        """Remember a holder's claim."""
        if self.rival is None or self.rival.ballot != claim.ballot:
            self._claims.clear()
            self._rival_since = self._cycles.newest
        self.rival, self._vacated, self._heard_at = claim, None, now
        _remember(self._claims, claim.cycle, claim)

    def _vacate(self, claim: Claim) -> None:
        self.rival, self._vacated = None, claim
        self._claims.clear()

    def _echoed(self) -> bool:
        """Whether the owner obeyed a ballot as large as any known, within the last cycle."""
        if self._obeyed is None or self.largest is None:
            return False
        ballot, at = self._obeyed
        age = self._cycles.age(at)
        return ballot >= self.largest and age is not None and age <= 1

    def _notice_missed_cycles(self) -> None:
        before, newest = self._echoed_cycle, self._cycles.newest
        self._echoed_cycle = newest
        if before is None or newest is None or before.epoch != newest.epoch:
            return
        if newest.number - before.number > UNOBEYED:
            self._back_at = newest

    def _cycles_without(self, since: Cycle | None, *, obeyed_by_anyone: bool) -> int:
        """Cycles since this tenure began or was last obeyed, whichever is later.

        Those that this agent missed while it was away itself do not count.
        """
        newest, first = self._cycles.newest, self._cycles.first
        if newest is None or first is None or since is None:
            return 0
        last = since.number if since.epoch == newest.epoch else first.number
        if self._back_at is not None and self._back_at.epoch == newest.epoch:
            last = max(last, self._back_at.number)
        if self._obeyed is not None and self._obeyed[1].epoch == newest.epoch:
            ballot, at = self._obeyed
            if obeyed_by_anyone or ballot == self.ballot:
                last = max(last, at.number)
        return newest.number - last


class Verdict(StrEnum):
    """What the owner of a resource says to a command."""

    OBEYED = "obeyed"
    LISTENING = "the robot agent has just started and listens for 3 cycles"
    STOPPED = "the robot is stopped"
    OLD_CYCLE = "it answers a cycle that is too old, or not yet there"
    STALE_BALLOT = "its ballot is smaller than the largest obeyed or heard"
    IMPLAUSIBLE = "its term is too far above the largest known"
    OUT_OF_RANGE = "its speeds are outside the profile's limits"


class Owner:
    """The side of whoever owns a resource: it refuses, and never chooses."""

    def __init__(self, cycles: CycleClock) -> None:
        self.largest: Ballot | None = None
        self.obeyed: Ballot | None = None
        self.obeyed_cycle: Cycle | None = None
        self._cycles = cycles

    def hear(self, claim: Claim) -> None:
        """Learn of a ballot: what is smaller is refused from now on."""
        if self._cycles.fresh(claim.cycle) and plausible(claim.ballot, self.largest):
            self._learn(claim.ballot)

    def judge(self, cycle: Cycle, ballot: Ballot, *, stopped: bool, sound: bool) -> Verdict:
        """Obey or refuse a command, the first reason that holds; `sound` is within the limits."""
        verdict = self._verdict(cycle, ballot, stopped=stopped, sound=sound)
        if verdict is Verdict.OBEYED:
            self._learn(ballot)
            self.obeyed, self.obeyed_cycle = ballot, cycle
        return verdict

    def _verdict(self, cycle: Cycle, ballot: Ballot, *, stopped: bool, sound: bool) -> Verdict:
        newest, first = self._cycles.newest, self._cycles.first
        rules = (
            (not self._cycles.fresh(cycle), Verdict.OLD_CYCLE),
            (not plausible(ballot, self.largest), Verdict.IMPLAUSIBLE),
            (self.largest is not None and ballot < self.largest, Verdict.STALE_BALLOT),
            (self.obeyed == ballot and cycle < (self.obeyed_cycle or cycle), Verdict.OLD_CYCLE),
            (not sound, Verdict.OUT_OF_RANGE),
            (stopped, Verdict.STOPPED),
            (not (newest and first) or newest.number < first.number + LISTEN, Verdict.LISTENING),
        )
        return next((verdict for broken, verdict in rules if broken), Verdict.OBEYED)

    def _learn(self, ballot: Ballot) -> None:
        if self.largest is None or ballot > self.largest:
            self.largest = ballot


def plausible(ballot: Ballot, largest: Ballot | None) -> bool:
    """Whether a ballot is not absurdly far ahead: one corrupt term must not end all others."""
    return largest is None or ballot.term <= largest.term + TERM_JUMP


def _remember(by_cycle: dict[Cycle, T], cycle: Cycle, value: T) -> None:
    by_cycle[cycle] = value
    while len(by_cycle) > REMEMBERED:
        del by_cycle[next(iter(by_cycle))]
