"""Promises about a change of hands: it is blended as the rules say, and in time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from math import hypot, inf
from typing import Final, NamedTuple

from armadico.core.coordination import braked
from armadico.core.cycles import PERIOD
from armadico.core.exchange import LONGEST, fuzzy_window
from armadico.core.messages import Ack, Action, Ballot, Claim
from armadico.core.resources import WHEELS
from armadico.mobile.obstacles import Obstacles
from armadico.observe.view import agent_of
from armadico_tools.faults.ballots import brief
from armadico_tools.faults.fault_types import CLAIMS as STRANGE_CLAIMS
from armadico_tools.faults.fault_types import STRANGE_UTILITY, Promise
from armadico_tools.faults.record import (
    FRESH_CYCLES,
    Bounds,
    Faulted,
    Obeyed,
    Observation,
    Record,
    Said,
)

CLAIMS = 16
LATELY_S = 0.35
"""A take-over begins from a holder whose claim was received within this, s."""

SETTLED_S: Final = 1.0
"""Only where the network has been whole for so long, s, have all received the same claims."""

SHARE: Final = 0.005
"""The winner's share of the first action may be off by so much, and so may the action, m/s, rad/s:
numbers travel whole, so this is room for rounding and for nothing else."""

HURRIED: Final = frozenset({"avoid"})
"""Agents whose bids may have no time for the whole window (`Bid.within`): half of what is left
until they must brake, which no message carries. It is at least half of what the truth leaves,
with the margins that they keep, so their share lies between the rule's and that window's."""

SEEN_M: Final = 0.25
"""What lies nearer by this, m, for who sees it by sonars: margin, noise, and a cycle's way."""

REACHES_M: Final = 0.3
"""No part of the robot is farther from the middle of its axle."""

DECEL_M_S2, LATENCY_S = 0.4, 0.2
"""What the behaviours count on when they brake: `armadico.mobile.safety`."""

QUIET_S: Final = 3.0
"""So long after another fault no agent is just coming back: on coming back, no news of tokens
is believed for 2 s."""

NOW_S: Final = 0.15
"""A bid of the newest cycle or of the one before, s."""

PROVIDERS: Final = frozenset({"robot", "encoder", "sonar", "interface"})
"""Agents that every contender for the wheels must receive."""


STEPS: Final = 20
"""A hurry that no message carries is tried in so many steps."""

Numbers = tuple[float, ...]


class Start(NamedTuple):
    """What an exchange may have begun from: an action, and the loser's weight."""

    action: Numbers
    weight: float


class Exchanged:
    """The first action of a tenure is what the exchange's rules make of both.

    Equation 3.10 in its first cycle, over the window t_f that the Sugeno rules give for the two
    actions. It began from what a loser commanded of late, or from what was measured. Who is in a
    hurry may take a shorter window, and at once is the shortest. Where the loser was about to
    collide and fell silent, the winner may only brake at first.
    """

    promise = Promise.SMOOTH

    def __init__(self) -> None:
        self._claims: deque[tuple[float, Claim]] = deque(maxlen=CLAIMS)
        self._weights: deque[tuple[str, float]] = deque(maxlen=4 * CLAIMS)  # whose, last published
        self._unseen: set[float] = set()  # utilities of who claimed, and was not seen to
        self._largest: Ballot | None = None
        self._speeds: deque[Numbers] = deque(maxlen=FRESH_CYCLES + 2)
        self._near = inf  # the nearest thing that was published, m from the robot's edge at least

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At the first claim of each tenure."""
        if isinstance(seen, Faulted) and seen.kind in STRANGE_CLAIMS:
            self._unseen.add(STRANGE_UTILITY)
        if not isinstance(seen, Said):
            return
        message = seen.message
        if isinstance(message, Obstacles):
            points = (hypot(point.x, point.y) for point in message.points)
            self._near = min(points, default=inf) - REACHES_M
        elif isinstance(message, Ack) and message.resource == WHEELS.name:
            self._speeds.append(_numbers(message.measured))
            if message.obeyed is not None:
                self._weights.append((message.obeyed.instance, message.utility))
        elif isinstance(message, Claim) and message.resource == WHEELS.name:
            if self._largest is None or message.ballot > self._largest:
                self._largest = message.ballot
                if message.utility and now.whole_for() > SETTLED_S and self._speeds:
                    least = _least_window(message, now, self._near)
                    yield from self._begins(seen.at, message, least)
            self._claims.append((seen.at, message))
            if message.utility is not None:
                self._weights.append((message.ballot.instance, message.utility))

    def _begins(self, at: float, winner: Claim, least: float) -> Iterator[str]:
        """`least` is the shortest window that the winner may take, cycles."""
        starts = list(self._starts(at, winner))
        wanted, commanded = _numbers(winner.wanted), _numbers(winner.commanded)
        if any(self._explains(start, winner, least) for start in starts):
            return
        # It may only brake if who fell silent or let go was about to collide.
        others = [claim for _, claim in self._claims if claim.ballot < winner.ballot]
        careful = any(claim.critical for claim in others[-FRESH_CYCLES - 2 :])
        if careful and any(_brakes(start, winner, least) for start in starts):
            return
        nearest = min(starts, key=lambda start: _far(start.action, commanded))
        window = _window(nearest.action, wanted)
        yield (
            f"{brief(winner.ballot)} commands {_plain(commanded)} on taking over and"
            f" wants {_plain(wanted)}: not what {window:.1f} cycles make of that and"
            f" {_plain(nearest.action)}"
        )

    def _starts(self, at: float, winner: Claim) -> Iterator[Start]:
        own, me = winner.utility or 0.0, winner.ballot.instance
        for when, claim in self._claims:
            commanded = _numbers(claim.commanded)
            if at - when <= LATELY_S and claim.ballot.instance != me and commanded:
                yield Start(commanded, own if claim.utility is None else claim.utility)
        weights = {own, *self._unseen, *(u for who, u in self._weights if who != me)}
        for speeds in self._speeds:
            for weight in sorted(weights):
                yield Start(speeds, weight)

    @staticmethod
    def _explains(start: Start, winner: Claim, least_window: float) -> bool:
        wanted, commanded = _numbers(winner.wanted), _numbers(winner.commanded)
        least, most = _shares(start, winner, least_window)
        pairs = list(zip(start.action, wanted, commanded, strict=True))
        lost, won, sent = max(pairs, key=lambda axis: abs(axis[1] - axis[0]))
        if abs(won - lost) < SHARE:
            return _far(wanted, commanded) < SHARE
        share = (sent - lost) / (won - lost)
        if not least - SHARE <= share <= most + SHARE:
            return False
        return all(abs(lo + share * (wo - lo) - sa) < SHARE for lo, wo, sa in pairs)


class Replaced:
    """Who holds the wheels and falls silent is replaced before the stop, if another bids.

    Killed, its token is gone at once, and the next command is obeyed within `killed_s`. Hung or cut
    off, another takes over after its silence (2.3 cycles), before the owner's 0.3 s; where the
    other still receives it, after the 6 cycles for which it was not obeyed: it lets go.
    """

    promise = Promise.HANDOVER

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._obeyed: Obeyed | None = None
        self._others: frozenset[str] = frozenset()  # who bids, and is not who fell silent
        self._since = self._due = 0.0
        self._hung = False  # who fell silent hangs
        self._quiet_at = 0.0  # when the last fault began or ended

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """From the fault on, until another is obeyed."""
        if isinstance(seen, Obeyed):
            holder = self._obeyed
            if holder is None or seen.ballot.instance != holder.ballot.instance:
                self._others = frozenset()
            elif self._hung:  # its last command was still on its way
                self._due = seen.at + self._bounds.silent_s
            self._obeyed = seen
        elif isinstance(seen, Faulted):
            self._others = frozenset()
            if seen.began and seen.at - self._quiet_at > QUIET_S:
                self._begins(seen, now)
            self._quiet_at = seen.at
        elif self._others:
            self._others &= frozenset(now.bidders())
            if now.stopped():
                self._others = frozenset()
            if self._others and seen.at > self._due:
                who, self._others = ", ".join(sorted(self._others)), frozenset()
                yield f"{seen.at - self._since:.3f} s after its holder fell silent, though {who}"

    def _begins(self, fault: Faulted, now: Record) -> None:
        last = self._obeyed
        if last is None or len(now.active) != 1 or fault.at - last.at > NOW_S:
            return
        holder = agent_of(last.ballot.instance)
        bounds = self._bounds
        due = {"crash": fault.at + bounds.killed_s, "hang": last.at + bounds.silent_s}
        if fault.kind in due and fault.whom == (holder,):
            here, self._due = {holder}, due[fault.kind]
        elif fault.kind in {"one-way", "partition"} and holder in fault.whom:
            here, self._due = {*fault.whom}, fault.at + bounds.unobeyed_s
            if "robot" not in fault.to or PROVIDERS & here:
                return
        else:
            return
        self._since, self._hung = fault.at, fault.kind == "hang"
        self._others = frozenset(
            instance
            for instance, (at, _) in now.bids.items()
            if instance in now.bidders()
            and fault.at - at <= NOW_S
            and agent_of(instance) not in here
        )


def _least_window(winner: Claim, now: Record, published: float) -> float:
    """The shortest window that a winner's hurry explains, cycles.

    By what there is, or by what it was told is there, m: an echo may be another sonar's.
    """
    if winner.critical:
        return 0.0
    if agent_of(winner.ballot.instance) not in HURRIED:
        return LONGEST
    truth = now.truth
    if truth is None or truth.clearance is None or now.void(Promise.COLLISION):
        return 0.0  # sensing that is not honest may show it anything
    v = max(truth.v, 0.0)
    near = min(truth.clearance, published)
    left = near - SEEN_M - v * LATENCY_S - v * v / (2.0 * DECEL_M_S2)
    return max(0.5 * left / max(v, 0.05), 0.0) / PERIOD


def _brakes(start: Start, winner: Claim, least_window: float) -> bool:
    """Whether it is what the rules make of both, but no farther from rest than it began."""
    wanted, commanded = _numbers(winner.wanted), _numbers(winner.commanded)
    least, most = _shares(start, winner, least_window)
    for step in range(STEPS + 1):
        share = least + (most - least) * step / STEPS
        mixed = [
            lost + share * (won - lost) for lost, won in zip(start.action, wanted, strict=True)
        ]
        held = braked(tuple(mixed), start.action, WHEELS.neutral)
        if _far(_numbers(held), commanded) < SHARE:
            return True
        if most - least < SHARE:
            return False
    return False


def _shares(start: Start, winner: Claim, least_window: float) -> tuple[float, float]:
    """The winner's share of its first action: by the whole window, and by the shortest."""
    window = _window(start.action, _numbers(winner.wanted))
    return (
        _share(winner, start.weight, window),
        _share(winner, start.weight, min(window, least_window)),
    )


def _share(winner: Claim, weight: float, window: float) -> float:
    """The winner's share of its first action, by equations 3.10 to 3.12 in their first cycle."""
    own = winner.utility or 0.0
    return own / (own + weight * (window - 1.0)) if window >= 1.0 else 1.0


def _window(start: Numbers, wanted: Numbers) -> float:
    """Cycles of an exchange, by the Sugeno rules."""
    pairs = zip(start, wanted, WHEELS.scale, strict=True)
    return min(fuzzy_window(max(abs(won - lost) / scale for lost, won, scale in pairs)), LONGEST)


def _far(one: Numbers, other: Numbers) -> float:
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


def _plain(action: Numbers) -> str:
    return "(" + ", ".join(f"{number:.3f}" for number in action) + ")"


def _numbers(action: Action) -> Numbers:
    """An action of the wheels; nothing, if it is none."""
    return () if isinstance(action, bytes) or len(action) != len(WHEELS.scale) else action
