"""A world of real contenders and a real owner, cycle by cycle, with the messages under way.

Each side processes messages as `Agent` does. Time is in 1/1024 s, and a cycle is 102 of them, a
little less than its nominal 0.1 s. So differences of times are exact, and equal worlds are equal at
any time. A message takes 2 units by default.

A resource may have its own cycle, that of its owner's acks. With `apart` it is like the wheels:
their cycle is the robot's state, and the ack is another message.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from math import ceil
from random import Random
from typing import Any, Final, TypeVar, cast

from armadico.core.coordination import Contender, Owner, Rival, Tenure, Verdict, beats
from armadico.core.cycles import CycleClock
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.messages import Ack, Ballot, Claim, Command, Cycle, Message
from armadico.core.resources import Resource
from armadico_tools.explore.picks import Picker

T = TypeVar("T")

SECOND: Final = 1024
CYCLE: Final = 102
LATENCY: Final = 2

FRESH: Final = 3
"""Cycles: an older command may not be obeyed."""

LEASE: Final = 10
"""Cycles after which a cut has removed the tokens."""

SPINS: Final = 20
"""Most wake-ups at one instant; more would never end."""

AWAY: Final = 8
"""Cycles within which a crashed contender or owner restarts, or never."""

STOPPED: Final = 4
"""Cycles for which a stop is latched."""

FATES: Final = ("now", "late 1", "late 4", "lost", "twice")
"""Alternatives for a message; late by so many cycles."""

OWNER: Final = -1

NO_BALLOT: Final = Ballot(0, 0.0, False, "")

BIDS: Final[dict[str, Bid | None]] = {
    "-": None,
    "0": Bid(0.0, (0.0,)),
    "0.5": Bid(0.5, (0.0,)),
    "0.53": Bid(0.53, (0.0,)),
    "0.6": Bid(0.6, (0.0,)),
    "0.5!": Bid(0.5, (0.0,), critical=True),
}
"""Bids by name; the margin is 0.05, and ! is critical."""

OWN: Final = Resource("task", ("v",), (1.0,), (0.0,), exchange="abrupt", period_s=0.1)
WHEELS_LIKE: Final = Resource("reel", ("v",), (1.0,), (0.0,), exchange="abrupt")

RISE: Final = (0.1, 0.2, 0.3)
"""By how much all bids rise in successive cycles: each is higher, but none better than the
others."""

HIGHER: Final[dict[tuple[Bid, int], Bid]] = {
    (bid, ago): replace(bid, utility=bid.utility + more)
    for bid in BIDS.values()
    if bid is not None
    for ago, more in enumerate(RISE)
}

KINDS: Final = ("fates", "crash", "owner", "cut", "hang", "bids", "rise", "stop")
"""Alternatives: the fate of a message, a crash of a contender or the owner, a cut, a hang, another
bid, all bids rise together, a stop."""

KEPT: Final = 4
"""Cycles whose bids are compared, to judge whether a takeover was by a better bid."""


@dataclass(frozen=True)
class Setup:
    """The start of a run: bids, and the delay from the owner's cycle to each contender."""

    bids: tuple[str, ...]
    stagger: tuple[int, ...] = ()
    apart: bool = False
    kinds: tuple[str, ...] = KINDS
    # Cycles of a cut or a hang: within timeouts, beyond them, beyond the lease, forever.
    lasts: tuple[int | None, ...] = (3, 8, 12, None)
    changes: tuple[str, ...] = tuple(BIDS)


@dataclass
class Parts:
    """The classes of a world: the real ones, or some with a planted bug."""

    contender: type[Contender] = Contender
    owner: type[Owner] = Owner
    clock: type[CycleClock] = CycleClock


class Draws:
    """The random number of a draw, picked. It replaces a `random.Random`."""

    def __init__(self) -> None:
        self.picker: Picker | None = None
        self.name = ""  # of the contender that draws

    def random(self) -> float:
        """0 or 1: the soonest or the latest."""
        assert self.picker is not None, "draws happen within a step"
        way = self.picker.pick(f"draw of {self.name}", ("soon", "late"), 0)
        return 0.0 if way == "soon" else 1


DRAWS: Final = Draws()


@dataclass
class Flight:
    due: int
    to: int
    sender: int
    message: Any


@dataclass
class Cut:
    """Messages between two of them are lost until a cycle; None: forever."""

    links: frozenset[tuple[int, int]]
    since: int
    until: int | None


class Side:
    """One contender, and the work of its agent."""

    def __init__(self, index: int, bid: str, resource: Resource, parts: Parts) -> None:
        self.index = index
        self.name = "abcdef"[index]
        self.bid = bid
        self.starts = 0
        self.contender: Contender | None = None  # None after a crash
        self.turned: Cycle | None = None
        self.down = 0  # cycles since it crashed
        self.hung_until: int | None = 0  # None: forever
        self.hung_since = 0
        self.waiting: list[Flight] = []
        self.made: tuple[tuple[Cycle, Bid], ...] = ()  # its bids of the last cycles
        self.used: Ballot | None = None  # of its last message
        self._resource, self._parts = resource, parts

    def start(self) -> None:
        """Make a new instance of its contender."""
        self.starts += 1
        self.down = 0
        clock = self._parts.clock(0.1)
        self.contender = self._parts.contender(
            self._resource, self.instance, clock, EXCHANGES["abrupt"], cast("Random", DRAWS)
        )
        self.turned = self.used = None
        self.made = ()

    @property
    def instance(self) -> str:
        return f"{self.name}-{self.starts}"

    def twin(self) -> Side:
        """An independent copy."""
        made = object.__new__(Side)
        made.__dict__.update(self.__dict__)
        made.waiting = list(self.waiting)
        made.contender = _twin(self.contender)
        return made


_CHANGING: Final = {
    Contender: ("tenure", "rival", "clock", "_bids"),
    Owner: ("clock",),
    Rival: ("claims",),
    CycleClock: ("_left",),
    Tenure: (),
}
"""Attributes that a copy must not share: the only ones that are changed in place."""


def _twin(thing: T) -> T:
    """An independent copy of a contender or an owner."""
    if thing is None:
        return thing
    if isinstance(thing, dict):
        return cast("T", thing.copy())
    made = object.__new__(type(thing))
    into = made.__dict__
    into.update(thing.__dict__)
    for kind in type(thing).__mro__:
        names = _CHANGING.get(kind)
        if names is not None:
            for name in names:
                into[name] = _twin(into[name])
            break
    return made


class BrokenError(Exception):
    """A promise was broken: its name, and details."""

    def __init__(self, promise: str, how: str) -> None:
        super().__init__(f"{promise}: {how}")
        self.promise, self.how = promise, how


class World:
    """The whole state at the end of a cycle."""

    def __init__(self, setup: Setup, parts: Parts | None = None) -> None:
        self.setup = setup
        self.parts = parts or Parts()
        self.resource = WHEELS_LIKE if setup.apart else OWN
        self.n = 0  # cycles since the start
        self.sides = [Side(i, b, self.resource, self.parts) for i, b in enumerate(setup.bids)]
        for side in self.sides:
            side.start()
        self.flights: list[Flight] = []
        self.cuts: list[Cut] = []
        self.owner: Owner | None = None
        self.epoch = 1
        self.number = 0
        self.owner_down = 0
        self.owner_starts = 0
        self.active = False  # the resource was commanded, and not rested since
        self.stopped_until = 0
        self.risen: Cycle | None = None  # the first cycle in which all bid more
        self._start_owner()
        # Observations for judging the promises, not used above.
        self.top: Ballot | None = None  # the largest obeyed in this epoch
        self.top_at: Cycle | None = None  # the newest cycle of `top`
        self.obeyed_at = -(10**6)  # when `top` was last obeyed
        self.released: Ballot | None = None
        self.highest = 0  # term of all ballots ever cast
        self.obeyed_now = False  # in this cycle
        self._picker: Picker | None = None

    def twin(self) -> World:
        """An independent copy."""
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__)
        made.sides = [side.twin() for side in self.sides]
        made.flights = list(self.flights)
        made.cuts = list(self.cuts)
        if self.owner is not None:
            made.owner = owner = _twin(self.owner)
            owner.refusals = Counter()
        return made

    # A cycle -------------------------------------------------------------------------------------

    def step(self, picker: Picker) -> None:
        """Advance by one cycle. Raises BrokenError at the first broken promise."""
        self._picker = DRAWS.picker = picker
        self.n += 1
        begins = self.n * CYCLE
        self.obeyed_now = False
        self.cuts = [c for c in self.cuts if c.until is None or c.until > self.n]
        self._befall()
        self._return()
        for cut in self.cuts:
            if self.n == cut.since + LEASE:
                self._hide_tokens(cut)
        for side in self.sides:
            if side.hung_until != 0 and self.n == side.hung_since + LEASE:
                self._lose_token(side)
        if self.owner is not None:
            self._begin_cycle(begins)
        self._pass(begins, begins + CYCLE)
        self._picker = DRAWS.picker = None

    def _befall(self) -> None:
        """Apply the fault at the beginning of a cycle, if any."""
        picker = self._picker
        assert picker is not None, "within a step"
        what = picker.pick("event", self._events(), 1)
        if what == "nothing":
            return
        words = what.split()
        if words[0] == "stop":
            self.stopped_until = self.n + STOPPED
            self._rest()
        elif words[0] == "crash" and words[1] == "owner":
            self.owner, self.owner_down = None, 1
            self.active = False  # a restarted owner rests it first
        elif words[0] == "crash":
            side = self._side(words[1])
            gone = side.instance
            side.contender, side.down, side.waiting = None, 1, []
            for other in self.sides:
                if other.contender is not None and self.reaches(side.index, other.index):
                    self._send(f"token of {side.name}>{other.name}", side.index, other.index, gone)
        elif words[0] == "hang":
            side = self._side(words[1])
            side.hung_until, side.hung_since = self._until(words[-1]), self.n
        elif words[0] == "rise":
            self.risen = Cycle(self.epoch, self.number + 1)
        elif words[0] == "bid":
            self._side(words[1]).bid = words[2]
        else:
            self.cuts.append(Cut(self._links(words[1]), self.n, self._until(words[-1])))

    def _until(self, word: str) -> int | None:
        return None if word == "ever" else self.n + int(word)

    def _side(self, name: str) -> Side:
        return next(side for side in self.sides if side.name == name)

    def _events(self) -> list[str]:
        kinds, found = self.setup.kinds, ["nothing"]
        alive = [side for side in self.sides if side.contender is not None]
        lasts = ["ever" if last is None else str(last) for last in self.setup.lasts]
        if "bids" in kinds:
            changes = self.setup.changes
            found += [f"bid {s.name} {b}" for s in alive for b in changes if b != s.bid]
        if "crash" in kinds and all(s.starts == 1 and s.contender for s in self.sides):
            found += [f"crash {side.name}" for side in alive]
        if "owner" in kinds and self.owner_starts == 1 and self.owner is not None:
            found.append("crash owner")
        if "hang" in kinds:
            awake = [side for side in alive if side.hung_until == 0]
            found += [f"hang {s.name} {last}" for s in awake for last in lasts if last != "ever"]
        if "cut" in kinds and not self.cuts:
            found += [f"cut {where} {last}" for where in self._places() for last in lasts]
        if "rise" in kinds and self.rising is None and self.owner is not None:
            found.append("rise")
        if "stop" in kinds and not self.stopped and self.owner is not None:
            found.append("stop")
        return found

    def _places(self) -> list[str]:
        """Links to cut: both directions, one direction, and all of one side."""
        names = [*(side.name for side in self.sides), "owner"]
        found = []
        for i, one in enumerate(names):
            for other in names[i + 1 :]:
                found += [f"{one}-{other}", f"{one}>{other}", f"{other}>{one}"]
            if len(names) > 2:
                found.append(f"{one}-all")
        return found

    def _links(self, where: str) -> frozenset[tuple[int, int]]:
        index = {side.name: side.index for side in self.sides} | {"owner": OWNER}
        if ">" in where:
            one, other = where.split(">")
            return frozenset([(index[one], index[other])])
        one, other = where.split("-")
        others = (
            [i for i in index.values() if i != index[one]] if other == "all" else [index[other]]
        )
        ways = [[(index[one], i), (i, index[one])] for i in others]
        return frozenset(way for both in ways for way in both)

    def _return(self) -> None:
        """Restart crashed sides, and resume hung ones."""
        picker = self._picker
        assert picker is not None, "within a step"
        for side in self.sides:
            if 0 < side.down <= AWAY:
                side.down += 1
                if picker.pick(f"start {side.name}", ("not yet", "now"), 0) == "now":
                    side.start()
            if side.hung_until == self.n:
                side.hung_until = 0
                waiting = self._kept(side.waiting)
                if self.n - side.hung_since > LEASE:
                    waiting = self._missed_tokens(side, waiting)
                for late in waiting:
                    self.flights.append(Flight(self.n * CYCLE, late.to, late.sender, late.message))
                side.waiting = []
        if 0 < self.owner_down <= AWAY:
            self.owner_down += 1
            how = picker.pick("start owner", ("not yet", "larger epoch", "smaller epoch"), 0)
            if how != "not yet":
                self.epoch += 1 if how == "larger epoch" else -1
                self._start_owner()

    def _missed_tokens(self, side: Side, waiting: list[Flight]) -> list[Flight]:
        """After a hang beyond the lease: add that all others have gone, early or late."""
        picker = self._picker
        assert picker is not None, "within a step"
        tokens = [
            Flight(self.n * CYCLE, side.index, other.index, other.instance)
            for other in self.sides
            if other is not side and other.contender is not None
        ]
        when = picker.pick(f"tokens at {side.name}", ("after the rest", "before it"), 0)
        return waiting + tokens if when == "after the rest" else tokens + waiting

    def _lose_token(self, side: Side) -> None:
        for other in self.sides:
            if other is not side and other.contender is not None and side.contender is not None:
                self.flights.append(Flight(self.n * CYCLE, other.index, side.index, side.instance))

    @staticmethod
    def _kept(waiting: list[Flight]) -> list[Flight]:
        """The mailbox after a hang: of states the latest, in the place of the first."""
        kept: dict[object, Flight] = {}
        for position, flight in enumerate(waiting):
            state = isinstance(flight.message, Ack | Cycle)
            kept[type(flight.message) if state else position] = flight
        return list(kept.values())

    def _start_owner(self) -> None:
        self.owner = self.parts.owner(self.resource, self.parts.clock(0.1))
        self.owner_starts += 1
        self.number = self.owner_down = 0
        self.active = False
        self.top = self.top_at = self.released = None

    def _hide_tokens(self, cut: Cut) -> None:
        for one, other in {tuple(sorted(link)) for link in cut.links}:
            for to, of in ((one, other), (other, one)):
                if to >= 0 and of >= 0 and self.sides[of].contender is not None:
                    token = self.sides[of].instance
                    self.flights.append(Flight(self.n * CYCLE, to, of, token))

    def _begin_cycle(self, begins: int) -> None:
        owner = self.owner
        assert owner is not None, "called with an owner"
        self.number += 1
        cycle = Cycle(self.epoch, self.number)
        owner.clock.advance(cycle, begins / SECOND)
        ack = owner.ack((0.0,))
        for side in self.sides:
            if side.contender is None:
                continue
            stagger = self.setup.stagger[side.index] if self.setup.stagger else 0
            if self.setup.apart:
                self._send(f"state>{side.name}", OWNER, side.index, cycle, stagger)
            self._send(f"ack>{side.name}", OWNER, side.index, ack, stagger)

    def _pass(self, begins: int, ends: int) -> None:
        """Process arrivals and wake-ups within one cycle."""
        now, spins = begins, 0
        while True:
            due, what = self._next(now, ends)
            if what is None:
                return
            spins = spins + 1 if due == now and not isinstance(what, Flight) else 0
            if spins > SPINS:
                raise BrokenError("no busy loop", "woken at one instant again and again")
            now = due
            if isinstance(what, Flight):
                self.flights.remove(what)
                self._arrive(what, now)
            elif isinstance(what, Owner):
                self._rest()
            else:
                DRAWS.name = what.name
                self._publish(what, cast("Contender", what.contender).tick(now / SECOND), now)
            if self.active and now - self.obeyed_at > 3 * CYCLE + LATENCY + FRESH:
                raise BrokenError("silence stops", "no valid command, and it goes on")

    def _next(self, now: int, ends: int) -> tuple[int, Flight | Side | Owner | None]:
        """The first event before the end of the cycle, and its time."""
        due: int = ends
        what: Flight | Side | Owner | None = None
        for flight in self.flights:
            if flight.due < due:
                due, what = flight.due, flight
        for side in self.sides:
            contender = side.contender
            if contender is None or side.hung_until != 0:
                continue
            at = contender.wakeup
            if at is not None and (tick := max(ceil(at * SECOND), now)) < due:
                due, what = tick, side
        owner = self.owner
        if owner is not None and (silent_at := owner.silent_at) is not None:
            tick = max(ceil(silent_at * SECOND), now)
            if tick < due:
                due, what = tick, owner
        return due, what

    # Messages ------------------------------------------------------------------------------------

    def reaches(self, one: int, other: int) -> bool:
        """Whether messages from one reach the other."""
        return not self.cuts or not any((one, other) in cut.links for cut in self.cuts)

    def _send(
        self, what: str, sender: int, to: int, message: Any, later: int = 0, now: int | None = None
    ) -> None:
        if not self.reaches(sender, to):
            return
        picker = self._picker
        assert picker is not None, "within a step"
        fate = "now"
        if "fates" in self.setup.kinds:
            fate = picker.pick(what, FATES, 1)
        at = (self.n * CYCLE if now is None else now) + LATENCY + later
        if fate in {"now", "twice"}:
            self.flights.append(Flight(at, to, sender, message))
        if fate in {"late 1", "twice"}:
            self.flights.append(Flight(at + CYCLE, to, sender, message))
        elif fate == "late 4":
            self.flights.append(Flight(at + 4 * CYCLE, to, sender, message))

    def _arrive(self, flight: Flight, now: int) -> None:
        message = flight.message
        if flight.to == OWNER:
            if self.owner is not None:
                self._to_owner(self.owner, message, now)
            return
        side = self.sides[flight.to]
        if side.contender is None:
            return
        if side.hung_until != 0:
            side.waiting.append(flight)
            return
        DRAWS.name = side.name
        contender, at = side.contender, now / SECOND
        if isinstance(message, Claim):
            self._publish(side, contender.on_claim(message, at), now)
        elif isinstance(message, Cycle):
            contender.clock.advance(message, at)
        elif isinstance(message, Ack):
            self._on_ack(side, contender, message, now)
        else:
            self._publish(side, contender.gone(message, at), now)

    def _on_ack(self, side: Side, contender: Contender, ack: Ack, now: int) -> None:
        """Process an ack as `Agent` does: clock, newest ack only, one turn per cycle."""
        at, clock = now / SECOND, contender.clock
        if not self.setup.apart:
            if not clock.advance(ack.cycle, at):
                return
        elif not clock.fresh(ack.cycle):
            return
        known = ack.cycle if contender.ack is None else contender.ack.cycle
        if known.epoch == ack.cycle.epoch and known.number > ack.cycle.number:
            return
        self._publish(side, contender.acked(ack, at), now)
        last = side.turned
        if last is not None and last.epoch == ack.cycle.epoch and ack.cycle.number <= last.number:
            return
        side.turned = ack.cycle
        able = clock.alive(at) and contender.owned and not self.stopped
        bid = self._bid(side, ack.cycle) if able else None
        if bid is not None:
            side.made = (*side.made[1 - KEPT :], (ack.cycle, bid))
        self._publish(side, contender.bid(ack.cycle, bid, at, None), now)

    @property
    def rising(self) -> int | None:
        """Cycles since all bids began to rise; None after the end of it."""
        risen = self.risen
        if risen is None or risen.epoch != self.epoch:
            return None
        ago = self.number - risen.number
        return ago if ago <= len(RISE) + FRESH else None

    def _bid(self, side: Side, cycle: Cycle) -> Bid | None:
        """Its bid in a cycle; no bid, or an offer of 0, does not rise."""
        bid, risen = BIDS[side.bid], self.risen
        if bid is None or bid.utility <= 0.0 or risen is None or risen.epoch != cycle.epoch:
            return bid
        ago = cycle.number - risen.number
        return HIGHER[bid, ago] if 0 <= ago < len(RISE) else bid

    def _publish(self, side: Side, messages: list[Message], now: int) -> None:
        for message in messages:
            assert isinstance(message, Command | Claim), "a contender publishes nothing else"
            self._watch_ballot(message.ballot, side, now)
            kind = "command" if isinstance(message, Command) else "claim"
            self._send(f"{kind} {side.name}>owner", side.index, OWNER, message, 0, now)
            if isinstance(message, Claim):
                for other in self.sides:
                    if other is not side and other.contender is not None:
                        what = f"claim {side.name}>{other.name}"
                        self._send(what, side.index, other.index, message, 0, now)

    def _to_owner(self, owner: Owner, message: object, now: int) -> None:
        if isinstance(message, Claim):
            if message.utility is None:
                self._watch_release(owner, message)
            if owner.on_claim(message):
                self._rest()
            return
        command = cast("Command", message)
        if command.action is None:
            self._watch_release(owner, command)
        verdict = owner.judge(command, now / SECOND, stopped=self.stopped)
        if verdict is Verdict.OBEYED:
            self._watch_obeyed(command)
            self.active, self.obeyed_at, self.obeyed_now = True, now, True
        elif verdict is Verdict.RELEASED:
            self._rest()

    def _rest(self) -> None:
        if self.owner is not None:
            self.owner.rested()
        self.active = False

    # Promises at every instant -------------------------------------------------------------------

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self.n < self.stopped_until

    def _watch_release(self, owner: Owner, message: Claim | Command) -> None:
        """Remember a release of the tenure that the owner would obey."""
        age = self.number - message.cycle.number
        in_time = message.cycle.epoch == self.epoch and age <= FRESH
        if in_time and message.ballot == owner.largest:
            self.released = message.ballot

    def _watch_ballot(self, ballot: Ballot, side: Side, now: int) -> None:
        if ballot.instance != side.instance:
            raise BrokenError("own ballots", f"{side.instance} speaks by {ballot}")
        if ballot.term > self.highest + 1:
            raise BrokenError("terms bounded", f"{ballot.term} is cast after {self.highest}")
        self.highest = max(self.highest, ballot.term)
        if ballot != side.used:
            side.used = ballot
            self._watch_cast(ballot, side, now)

    def _watch_cast(self, ballot: Ballot, side: Side, now: int) -> None:
        """A new ballot: only a better bid takes over from a holder that is well.

        A holder is well if it is obeyed by the last ack that the other one has, and no link is cut.
        A contender that casts no larger term than the holder's did not know of it.
        """
        top, owner, contender = self.top, self.owner, side.contender
        assert contender is not None, "it has just published"
        if top is None or owner is None or owner.obeyed != top or ballot.term <= top.term:
            return
        known = contender.ack
        if known is None or known.obeyed != top or now - self.obeyed_at > 3 * CYCLE or self.cuts:
            return
        if known.obeyed_cycle is None or known.cycle.number > known.obeyed_cycle.number + 1:
            return  # not obeyed in the last cycle by that ack: its silence may be intended
        holder = next((each for each in self.sides if each.instance == top.instance), side)
        if holder is side or holder.contender is None or holder.hung_until != 0:
            return
        tenure = holder.contender.tenure
        if tenure is None or tenure.ballot != top:
            return
        theirs = dict(holder.made)
        for cycle, bid in side.made:
            other = theirs.get(cycle)
            if other is not None and _better(bid, other, self.resource.margin):
                return
        raise BrokenError("only the better takes over", f"{side.instance} from {top.instance}")

    def _watch_obeyed(self, command: Command) -> None:
        ballot, cycle, top = command.ballot, command.cycle, self.top
        if self.stopped:
            raise BrokenError("a stop stops", f"{ballot.instance} is obeyed while it is latched")
        if cycle.epoch != self.epoch or self.number - cycle.number > FRESH:
            raise BrokenError("fresh", f"{cycle} is obeyed in ({self.epoch}, {self.number})")
        if top is not None and ballot < top:
            raise BrokenError("ballots never go down", f"{ballot} is obeyed after {top}")
        if ballot == self.released:
            raise BrokenError("a release ends a tenure", f"{ballot} is obeyed after it")
        if ballot == top and self.top_at is not None and cycle < self.top_at:
            raise BrokenError("in order", f"{cycle} is obeyed after {self.top_at}")
        self.top, self.top_at = ballot, cycle

    # Promises in the long run --------------------------------------------------------------------

    @property
    def whole(self) -> bool:
        """Whether there is no cut, hang or stop, and the owner is alive."""
        hung = any(side.hung_until != 0 for side in self.sides)
        return self.owner is not None and not self.cuts and not hung and not self.stopped

    @property
    def starved(self) -> bool:
        """Whether no contender was obeyed in this cycle, though one bids that reaches the owner."""
        if self.owner is None or self.stopped or self.obeyed_now:
            return False
        return any(
            side.contender is not None
            and side.hung_until == 0
            and _wants(side)
            and self.reaches(side.index, OWNER)
            and self.reaches(OWNER, side.index)
            for side in self.sides
        )

    @property
    def unsettled(self) -> str:
        """Why the resource is not with the right holder; "" if it is. For a whole world."""
        alive = [side for side in self.sides if side.contender is not None]
        holders = [side for side in alive if cast("Contender", side.contender).holding]
        if not any(_wants(side) for side in alive):
            return "held for nothing" if holders else ""
        if len(holders) != 1:
            return f"{len(holders)} hold it"
        holder = cast("Contender", holders[0].contender)
        owner = self.owner
        assert owner is not None, "the world is whole"
        assert holder.tenure is not None, "a holder has a ballot"
        if not self.obeyed_now or owner.obeyed != holder.tenure.ballot:
            return f"{holders[0].name} holds it and is not obeyed"
        bid = BIDS[holders[0].bid]
        if bid is None:
            return f"{holders[0].name} holds it and has no bid"
        for side in alive:
            other = BIDS[side.bid]
            if side is not holders[0] and other is not None:  # noqa: SIM102 - else too long
                if _better(other, bid, self.resource.margin):
                    return f"{holders[0].name} holds it and {side.name} is better"
        return ""


def _wants(side: Side) -> bool:
    bid = BIDS[side.bid]
    return bid is not None and bid.utility > 0.0


def _better(bid: Bid, than: Bid, margin: float) -> bool:
    return beats(bid, Claim("", NO_BALLOT, Cycle(0, 0), than.utility, than.critical), margin)
