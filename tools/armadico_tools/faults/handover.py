"""Promises about a takeover: it is blended by the rules, and in time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from math import hypot, inf
from typing import Final, NamedTuple

from armadico.core.coordination import braked
from armadico.core.cycles import PERIOD
from armadico.core.exchange import LONGEST, fuzzy_window
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Action, Ballot, Claim
from armadico.core.resources import WHEELS
from armadico.mobile.obstacles import Obstacles
from armadico.observe.audit.coordination import FRESH_CYCLES, brief
from armadico_tools.faults.fault_types import CLAIMS as STRANGE_CLAIMS
from armadico_tools.faults.fault_types import STRANGE_UTILITY, Promise
from armadico_tools.faults.observations import Faulted, Obeyed, Observation, Published
from armadico_tools.faults.record import Bounds, Record

CLAIMS = 16
LATELY_S = 0.35
"""A takeover begins from a holder whose claim was received within this, s."""

SETTLED_S: Final = 1.0
"""After the network was whole for this time, s, all agents have received the same claims."""

SHARE: Final = 0.005
"""Tolerance of the winner's share of the first action, and of the action, m/s, rad/s. Numbers are
transmitted exactly, so this allows for rounding only."""

HURRIED: Final = frozenset({"avoid"})
"""Agents whose bids may have no time for the whole window (`Bid.within`). They allow half of the
time until they must brake, which no message carries. It is at least half of the true time, with
their margins. So their share lies between the rule's and that window's."""

SEEN_M: Final = 0.25
"""By this, m, an obstacle may seem nearer to a user of sonars: margin, noise, and a cycle's way."""

REACHES_M: Final = 0.3
"""No part of the robot is farther from the middle of its axle."""

DECEL_M_S2, LATENCY_S = 0.4, 0.2
"""The behaviours' assumptions about braking: `armadico.mobile.safety`."""

QUIET_S: Final = 3.0
"""After another fault, no agent is still recovering after this time: on recovery, changes of tokens
are ignored for 2 s."""

NOW_S: Final = 0.15
"""A bid is present if it is of the newest cycle or the one before, s."""

PROVIDERS: Final = frozenset({"robot", "encoder", "sonar", "interface"})
"""Agents from which every contender for the wheels must receive."""


STEPS: Final = 20
"""Steps in which the unknown window of a hurried agent is searched."""

Numbers = tuple[float, ...]


class Start(NamedTuple):
    """A possible start of an exchange: an action, and the loser's weight."""

    action: Numbers
    weight: float


class Exchanged:
    """The first action of a tenure follows the rules of the exchange.

    It is equation 3.10 in its first cycle, over the window t_f that the Sugeno rules give for both
    actions. It starts from a recent command of the loser, or from the measured speeds. A hurried
    agent may use a shorter window, down to none. If the loser was about to collide and fell silent,
    the winner may only brake at first.
    """

    promise = Promise.SMOOTH
    on = (Faulted, Obstacles, Ack, Claim)

    def __init__(self) -> None:
        self._claims: deque[tuple[float, Claim]] = deque(maxlen=CLAIMS)
        self._weights: deque[tuple[str, float]] = deque(maxlen=4 * CLAIMS)  # instance, utility
        self._unseen: set[float] = set()  # utilities of claims that were not observed
        self._largest: Ballot | None = None
        self._speeds: deque[Numbers] = deque(maxlen=FRESH_CYCLES + 2)
        self._near = inf  # lower bound of the distance to the nearest published obstacle, m

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """At the first claim of each tenure."""
        if isinstance(seen, Faulted) and seen.kind in STRANGE_CLAIMS:
            self._unseen.add(STRANGE_UTILITY)
        if not isinstance(seen, Published):
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
        """`least` is the shortest window that the winner may use, cycles."""
        starts = list(self._starts(at, winner))
        wanted, commanded = _numbers(winner.wanted), _numbers(winner.commanded)
        if any(self._explains(start, winner, least) for start in starts):
            return
        # It may only brake if the silent or released holder was about to collide.
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
        weights = {own, *self._unseen, *(u for name, u in self._weights if name != me)}
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
    """A holder of the wheels that falls silent is replaced before the stop, if another bids.

    If it is killed, its token is gone at once, and the next command is obeyed within `killed_s`. If
    it hangs or is disconnected, another takes over after its silence (2.3 cycles), before the
    owner's 0.3 s. If the other still receives it, that takes the 6 cycles without obedience after
    which the holder releases.
    """

    promise = Promise.HANDOVER
    on = (Observation,)

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._obeyed: Obeyed | None = None
        self._others: frozenset[str] = frozenset()  # bidders other than the silent holder
        self._since = self._due = 0.0
        self._hung = False  # the silent holder hangs
        self._quiet_at = 0.0  # when the last fault began or ended

    def check(self, seen: Observation, now: Record) -> Iterator[str]:
        """From the fault on, until another is obeyed."""
        if isinstance(seen, Obeyed):
            holder = self._obeyed
            if holder is None or seen.ballot.instance != holder.ballot.instance:
                self._others = frozenset()
            elif self._hung:  # its last command was still under way
                self._due = seen.at + self._bounds.silent_s
            self._obeyed = seen
        elif isinstance(seen, Faulted):
            self._others = frozenset()
            if seen.began and seen.at - self._quiet_at > QUIET_S:
                self._begins(seen, now)
            self._quiet_at = seen.at
        elif self._others:
            self._others &= frozenset(now.bidders())
            if now.owner.stopped():
                self._others = frozenset()
            if self._others and seen.at > self._due:
                others, self._others = ", ".join(sorted(self._others)), frozenset()
                text = f"not replaced {seen.at - self._since:.3f} s after its holder fell silent"
                yield f"{text}, though these bid: {others}"

    def _begins(self, fault: Faulted, now: Record) -> None:
        last = self._obeyed
        if last is None or len(now.faults.active) != 1 or fault.at - last.at > NOW_S:
            return
        holder = agent_of(last.ballot.instance)
        bounds = self._bounds
        due = {"crash": fault.at + bounds.killed_s, "hang": last.at + bounds.silent_s}
        if fault.kind in due and fault.targets == (holder,):
            here, self._due = {holder}, due[fault.kind]
        elif fault.kind in {"one-way", "partition"} and holder in fault.targets:
            here, self._due = {*fault.targets}, fault.at + bounds.unobeyed_s
            if "robot" not in fault.to or PROVIDERS & here:
                return
        else:
            return
        self._since, self._hung = fault.at, fault.kind == "hang"
        self._others = frozenset(
            instance
            for instance, (at, _) in now.contest.bids.items()
            if instance in now.bidders()
            and fault.at - at <= NOW_S
            and agent_of(instance) not in here
        )


def _least_window(winner: Claim, now: Record, published: float) -> float:
    """The shortest window that a winner's hurry explains, cycles.

    By the true or the published distance, m: an echo may be another sonar's.
    """
    if winner.critical:
        return 0.0
    if agent_of(winner.ballot.instance) not in HURRIED:
        return LONGEST
    truth = now.body.truth
    if truth is None or truth.clearance is None or now.void(Promise.SENSORS):
        return 0.0  # its sensing may show it anything
    v = max(truth.v, 0.0)
    near = min(truth.clearance, published)
    left = near - SEEN_M - v * LATENCY_S - v * v / (2.0 * DECEL_M_S2)
    return max(0.5 * left / max(v, 0.05), 0.0) / PERIOD


def _brakes(start: Start, winner: Claim, least_window: float) -> bool:
    """Whether the command follows the rules, but is no farther from rest than the start."""
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
    """The winner's share of its first action: with the whole window, and with the shortest."""
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
    """An action of the wheels; () for any other."""
    return () if isinstance(action, bytes) or len(action) != len(WHEELS.scale) else action
