"""Which worlds are equal from here on: a key without absolute times and counts.

Cycles and times count back from now, terms from the smallest that is left, and long past ones are
not distinguished. The key only decides what is explored once: a mistake here may hide a run, but
never invents one.

The key relies on these properties:

- Cycles are only compared with the newest (at most 6 back), or with each other while they are fresh
  (bids with claims). So cycles beyond `LONG` are equal. `Contender._released` compares two that may
  be older, so the key has its answer instead.
- Claims without a bid for their cycle, now or later, are compared with nothing.
- Times are only compared with now: the claim timeout (2.3 cycles), freshness (3), the rest, the
  draw.
- Terms are compared, and one is added to the largest known. A gap of more than `GAP` between two
  terms equals one of `GAP`, until a contender casts that often without receiving a larger one.
  The same holds above 0, from which a newcomer casts.
- Attributes of a subclass are compared unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from armadico.core.coordination import Contender, Owner, Rival
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.messages import Ack, Ballot, Claim, Command, Cycle
from armadico_tools.explore.world import AWAY, CYCLE, LEASE, SECOND, Side, World

LONG: Final = 12
"""Cycles: longer than any wait except the stand-back, which is a time."""

GAP: Final = 4

_PAST: Final = int(4.5 * CYCLE)
_FAR: Final = 100_000  # added to possibly negative numbers: -1 and -2 have the same hash

_CONTENDER: Final = frozenset(
    (
        *("resource", "instance", "state", "tenure", "rival", "largest", "ack", "clock"),
        *("_exchange", "_rng", "_margin", "_compare", "_bids", "_inputs", "_claimed_at"),
        *("_checked_at", "_cast_at", "_failures", "_rest_until"),
    )
)
_OWNER: Final = frozenset(
    (
        *("resource", "largest", "obeyed", "obeyed_cycle", "active", "refusals", "clock"),
        *("_over", "_rank", "_obeyed_at"),
    )
)

Key = tuple[object, ...]


def key(world: World) -> int:
    """A key that is equal for worlds that are equal from here on."""
    return hash(_Keyed(world).key())


class _Keyed:
    """Computes the key of one world."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.tick = (world.n + 1) * CYCLE
        self.here = Cycle(world.epoch, world.number)
        self.terms = _mapped({ballot.term for ballot in _ballots(world) if ballot is not None})

    def key(self) -> Key:
        world = self.world
        n = world.n
        flights = tuple(
            (f.due - self.tick + _FAR, f.to, f.sender, self._message(f.message))
            for f in world.flights
        )
        cuts = tuple(
            (
                tuple(sorted(c.links)),
                min(n - c.since, LEASE + 1),
                None if c.until is None else c.until - n,
            )
            for c in world.cuts
        )
        return (
            tuple(self._side(side) for side in world.sides),
            self._owner(world.owner),
            world.epoch,
            world.owner_down if world.owner_down <= AWAY else -7,
            world.owner_starts,
            world.active,
            max(world.stopped_until - n, 0),
            world.rising,
            flights,
            cuts,
            self._ballot(world.top),
            _ago(world.top_at, self.here),
            self._ballot(world.released) if world.released == world.top else None,
            world.obeyed_now,
            min(self.tick - world.obeyed_at, _PAST) if world.active else None,
        )

    # Parts ---------------------------------------------------------------------------------------

    def _side(self, side: Side) -> Key:
        hung = side.hung_until
        about = (
            side.bid,
            side.starts,
            side.down if side.down <= AWAY else -7,
            None if hung is None else max(hung - self.world.n, 0),
            0 if hung == 0 else min(self.world.n - side.hung_since, LEASE + 1),
            tuple((f.sender, self._message(f.message)) for f in side.waiting),
        )
        if side.contender is None:
            return about
        turned = side.turned
        newest = side.contender.clock.newest
        return (
            *about,
            None if turned is None else (turned.epoch, turned == newest),
            self._contender(side, side.contender),
        )

    def _contender(self, side: Side, c: Contender) -> Key:
        clock, tenure, rival, ack = c.clock, c.tenure, c.rival, c.ack
        newest, silent_at = clock.newest, c._silent_at
        extra = vars(c).keys() - _CONTENDER
        return (
            c.state.value,
            None if tenure is None else (self._ballot(tenure.ballot), _ago(tenure.began, newest)),
            self._rival(rival, c._bids, side.turned, clock.newest),
            self._ballot(c.largest),
            self._known_ack(ack, rival, newest),
            self._clock(clock),
            self._by_cycle(c._bids, clock.newest),
            self._since(c._claimed_at),
            silent_at > c._checked_at,
            None if c._cast_at is None else round((c._cast_at * SECOND - self.tick) * 64) + _FAR,
            min(c._failures, 3),
            max(round(c._rest_until * SECOND) - self.tick, 0),
            tuple((name, vars(c)[name]) for name in sorted(extra)) if extra else (),
        )

    def _rival(
        self,
        rival: Rival | None,
        bids: dict[Cycle, Bid],
        turned: Cycle | None,
        newest: Cycle | None,
    ) -> Key | None:
        if rival is None:
            return None
        claim = rival.claim
        owner = self.world.owner
        at = None if owner is None else owner.obeyed_cycle
        return (
            self._ballot(claim.ballot),
            _ago(claim.cycle, newest),
            # The owner's ack is compared with this when it arrives.
            at is not None and at.epoch == claim.cycle.epoch and at.number >= claim.cycle.number,
            claim.utility,
            claim.critical,
            _ago(rival.since, newest),
            tuple(
                (_exactly(cycle, newest), each.utility, each.critical)
                for cycle, each in self._comparable(rival, bids, turned)
            ),
            rival.gone,
        )

    @staticmethod
    def _comparable(
        rival: Rival, bids: dict[Cycle, Bid], turned: Cycle | None
    ) -> list[tuple[Cycle, Claim]]:
        """The claims without the first ones that no bid will be compared with.

        The first are dropped first, so the rest are dropped as if these did not exist.
        """
        claims = list(rival.claims.items())
        while claims and claims[0][0] not in bids:
            cycle = claims[0][0]
            if turned is None or (cycle.epoch == turned.epoch and cycle.number > turned.number):
                break
            del claims[0]
        return claims

    def _known_ack(self, ack: Ack | None, rival: Rival | None, newest: Cycle | None) -> Key | None:
        if ack is None:
            return None
        return (
            _ago(ack.cycle, newest),
            self._ballot(ack.largest),
            self._ballot(ack.obeyed),
            _ago(ack.obeyed_cycle, newest),
            ack.utility,
            ack.critical,
            rival is not None and Contender._released(ack, rival),
        )

    def _clock(self, clock: CycleClock) -> Key:
        newest = clock.newest
        return (
            _ago(newest, self.here),
            _ago(clock.first, newest),
            _ago(clock.resumed, newest),
            self._since(clock.received_at),
            0 if newest is None else max(clock._listens_until - newest.number, 0),
            tuple((epoch, self._left(epoch, last)) for epoch, last in clock._left.items()),
            round(max(clock._lead, 0.0), 1),
            clock._steady,
        )

    def _left(self, epoch: int, last: int) -> object:
        """Numbers of a past epoch matter only while an ack of it is under way."""
        under_way = [
            f.message.cycle.number
            for f in self.world.flights
            if isinstance(f.message, Ack) and f.message.cycle.epoch == epoch
        ]
        return tuple(number - last + _FAR for number in under_way)

    def _owner(self, owner: Owner | None) -> Key | None:
        if owner is None:
            return None
        extra = vars(owner).keys() - _OWNER
        return (
            self._ballot(owner.largest),
            self._ballot(owner.obeyed),
            _ago(owner.obeyed_cycle, self.here),
            owner.active,
            owner._over is not None and owner._over == owner.largest,
            owner._rank,
            self._since(owner._obeyed_at) if owner.active else None,
            self._clock(owner.clock),
            tuple((name, vars(owner)[name]) for name in sorted(extra)) if extra else (),
        )

    def _message(self, message: object) -> object:
        if isinstance(message, Claim):
            at = _exactly(message.cycle, self.here)
            return ("claim", self._ballot(message.ballot), at, message.utility, message.critical)
        if isinstance(message, Command):
            at = _exactly(message.cycle, self.here)
            return ("command", self._ballot(message.ballot), at, message.action is None)
        if isinstance(message, Ack):
            return (
                "ack",
                _exactly(message.cycle, self.here),
                self._ballot(message.largest),
                self._ballot(message.obeyed),
                _ago(message.obeyed_cycle, self.here),
                message.utility,
                message.critical,
            )
        return _exactly(message, self.here) if isinstance(message, Cycle) else message

    # Numbers -------------------------------------------------------------------------------------

    def _since(self, at: float) -> int:
        """Time since, in ticks; equal beyond the longest interval in use."""
        past = self.tick - at * SECOND
        return _PAST if past > _PAST else round(past) + 1

    def _by_cycle(self, bids: dict[Cycle, Bid], newest: Cycle | None) -> Key:
        return tuple(
            (_exactly(cycle, newest), bid.utility, bid.critical) for cycle, bid in bids.items()
        )

    def _ballot(self, ballot: Ballot | None) -> object:
        if ballot is None:
            return None
        return (self.terms[ballot.term], ballot.utility, ballot.critical, ballot.instance)


def _ago(cycle: Cycle | None, newest: Cycle | None) -> object:
    """Cycles before the newest; equal beyond `LONG`."""
    if cycle is None:
        return None
    if newest is None or cycle.epoch != newest.epoch:
        return (cycle.epoch,)
    return min(newest.number - cycle.number, LONG) + _FAR


def _exactly(cycle: Cycle, newest: Cycle | None) -> object:
    if newest is None or cycle.epoch != newest.epoch:
        return (cycle.epoch, cycle.number)
    return newest.number - cycle.number + _FAR


def _ballots(world: World) -> Iterator[Ballot | None]:
    """Every ballot that is left in a world."""
    messages = [flight.message for flight in world.flights]
    for side in world.sides:
        messages += [flight.message for flight in side.waiting]
        contender = side.contender
        if contender is not None:
            yield contender.largest
            messages.append(contender.ack)
            if contender.tenure is not None:
                yield contender.tenure.ballot
            if contender.rival is not None:
                yield contender.rival.claim.ballot
    for message in messages:
        if isinstance(message, Claim | Command):
            yield message.ballot
        elif isinstance(message, Ack):
            yield message.largest
            yield message.obeyed
    if world.owner is not None:
        yield world.owner.largest
        yield world.owner.obeyed
        yield world.owner._over
    yield world.top
    yield world.released


def _mapped(found: set[int]) -> dict[int, int]:
    """Terms counted from the smallest, with gaps no longer than `GAP`."""
    mapped: dict[int, int] = {}
    last = at = 0
    for term in sorted(found):
        at += min(term - last, GAP)
        mapped[term], last = at, term
    return mapped
