"""The checker of promises on a recording, which `armadico record` made of any society."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Final, NamedTuple

from msgspec import structs

from armadico.core.mechanisms import deciding
from armadico.core.messages import (
    BALLOTS,
    Ballot,
    BidRecord,
    Card,
    Claim,
    Command,
    Cycle,
    Description,
    Message,
    MessageError,
    RobotState,
)
from armadico.core.resources import WHEELS
from armadico.observe.audit.auditor import watched
from armadico.observe.audit.live import learn
from armadico.observe.pauses import PAUSE_S
from armadico.watch.recorder import REFUSED, SCHEMA_PREFIX
from armadico.watch.recordings import HERE, Past, RecordingError, Row
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import (
    Bids,
    Left,
    Observation,
    Passed,
    Published,
    of_the_wheels,
)
from armadico_tools.faults.record import Bounds, described_bounds, seconds_since

AT_ONCE_S: Final = 0.02
"""Messages received within this of each other count as simultaneous: each publisher has its own
connection to the recorder, so they may be recorded in either order."""

SHOWN: Final[tuple[type[Message], ...]] = (*watched(), Claim)

STATE: Final = SCHEMA_PREFIX + RobotState.__name__
NAMED: Final = frozenset(SCHEMA_PREFIX + kind.__name__ for kind in (Description, Card))
"""Messages that tell of the robot and what decides who drives."""


UNRECORDED: Final = (Promise.SILENCE, Promise.WATCHDOG, Promise.NO_ERROR, Promise.HANDOVER)
"""What needs the line to the controller, the agents' errors or the faults, which no recording has.
"""


def check(path: Path, namespace: str | None, warn: Callable[[str], None]) -> Checker:
    """Check a recording of one robot, by the ramps and the map that its messages name.

    A recording has neither the line to the controller nor the faults. So `UNRECORDED` is not
    checked, and a promise that a fault voids (`fault_types.voided`) counts as broken here.

    Raises RecordingError, also if there are several robots and none is named, or the named one is
    not there, and OSError.
    """
    about = _read(Past(path, lambda _: None), namespace)
    if about.refused:
        warn(f"{path} holds {about.refused} messages that could not be decoded")
    checker = Checker(about.bounds)
    for card in about.cards:
        learn(checker.auditor, card)
    # Under another mechanism a contender keeps no bids.
    past, bidding = Past(path, warn), Bidding({} if about.bounds.coordination else about.contenders)
    checker.update_all(
        bidding.seen(
            observations(row for row in past.rows() if about.namespace in (None, row.namespace))
        )
    )
    for gap in bidding.gaps():
        warn(f"whether an agent bid is unknown: {gap}")
    return checker


class Bidding:
    """Whether each agent's bids were recorded without a gap, by the cycles that they are for.

    An agent keeps its bid of each cycle, or the reason for none. Without them "no agent bids"
    would explain what is late.
    """

    def __init__(self, contenders: Mapping[str, float]) -> None:
        """`contenders` are the instances that bid, with the times since which they are alive, s."""
        self._awaited = dict(contenders)
        self._newest: Cycle | None = None
        self._last: dict[str, Cycle] = {}  # by instance
        self._gaps: dict[str, str] = {}  # the first one of each

    def seen(self, observed: Iterable[Observation]) -> Iterator[Observation]:
        """Pass observations on."""
        for each in observed:
            if isinstance(each, Bids):
                self._add(each.instance, each.record.cycle)
                self._last[each.instance] = each.record.cycle
            elif isinstance(each, Left):
                self._last.pop(each.instance, None)
                self._awaited.pop(each.instance, None)
            elif isinstance(each, Published) and isinstance(each.message, RobotState):
                self._newest = each.message.cycle
                for instance in [one for one, since in self._awaited.items() if since <= each.at]:
                    del self._awaited[instance]
                    self._last.setdefault(instance, self._newest)
            yield each

    def _add(self, instance: str, cycle: Cycle) -> None:
        last = self._last.get(instance, cycle)
        if seconds_since(last, cycle) > PAUSE_S:
            cycles = f"between cycles {last.number} and {cycle.number}"
            self._gaps.setdefault(instance, f"no bids of {instance} {cycles}")

    def gaps(self) -> list[str]:
        """The first gap of each agent, in words; an agent that is alive bids until the end."""
        for instance in (*self._last,):
            if self._newest is not None:
                self._add(instance, self._newest)
        return [*self._gaps.values()]


class _About(NamedTuple):
    namespace: str | None
    bounds: Bounds
    cards: tuple[Card, ...]
    refused: int  # messages that could not be decoded
    contenders: dict[str, float]  # the instances that compete for the wheels; when a card came, s


def _read(past: Past, namespace: str | None) -> _About:
    """What a recording tells of the robot. Raises RecordingError and OSError."""
    past.check()
    robots, described, cards = set[str](), dict[str, Description](), list[tuple[str, Card]]()
    refused = Counter[str]()  # has each namespace, also with 0
    contenders: dict[tuple[str, str], float] = {}
    for row in past.rows():
        refused[row.namespace] += row.key.endswith(REFUSED)
        if row.schema == STATE:
            robots.add(row.namespace)
        message = row.received if row.schema in NAMED else None
        if isinstance(message, Description):
            described.setdefault(row.namespace, message)
        elif isinstance(message, Card):
            cards.append((row.namespace, message))
            if WHEELS.name in message.resources:
                contenders.setdefault((row.namespace, message.instance), row.t / 1e9)
    if namespace is None and len(robots) > 1:
        names = ", ".join(sorted(robots))
        raise RecordingError(f"{past.path} holds {names}; name one robot: --namespace NS")
    if namespace and refused and namespace not in refused:
        names = ", ".join(sorted(refused))
        raise RecordingError(
            f"{past.path} holds no messages of {namespace!r}; --namespace: {names}"
        )
    robot = namespace or next(iter(robots), None)
    own = tuple(card for where, card in cards if where == robot)
    others = ", ".join(each for each in deciding(own) if each != BALLOTS)
    bounds = described_bounds(described.get(robot or ""))
    return _About(
        robot,
        replace(bounds, coordination=others),
        own,
        refused[robot or ""],
        {instance: at for (where, instance), at in contenders.items() if where == robot},
    )


def observations(recorded: Iterable[Row]) -> Iterator[Observation]:
    """The observations in a recording; times are s.

    Of simultaneous claims the smaller ballot is first: an agent that took over had received the
    claim of the one before it.
    """
    held: list[Observation] = []
    for seen in chain(_observed(recorded), (None,)):
        if held and (seen is None or seen.at > held[0].at + AT_ONCE_S):
            yield from _by_ballots(held)
            held = []
        if seen is not None and (held or _ballot(seen) is not None):
            held.append(seen)
        elif seen is not None:
            yield seen


def _by_ballots(held: Sequence[Observation]) -> Iterator[Observation]:
    """The same times, with claims and commands in the order of cycles and ballots."""
    ranked = [(_ballot(seen), seen) for seen in held]
    contend = iter(sorted((each for each in ranked if each[0] is not None), key=itemgetter(0)))
    for rank, seen in ranked:
        yield seen if rank is None else structs.replace(next(contend)[1], at=seen.at)


def _ballot(seen: Observation) -> tuple[int, int, Ballot] | None:
    if isinstance(seen, Published) and isinstance(seen.message, Claim | Command):
        message = seen.message
        return message.cycle.epoch, message.cycle.number, message.ballot
    return None


def _observed(recorded: Iterable[Row]) -> Iterator[Observation]:
    newest: Cycle | None = None
    for row in recorded:
        at = row.t / 1e9
        if row.schema == HERE:
            if not row.fields["there"]:
                yield Left(at, str(row.fields["instance"]))
            continue
        try:
            message = row.message
        except MessageError:
            continue
        if isinstance(message, RobotState):
            newest = message.cycle
        if isinstance(message, BidRecord):
            instance = row.key.split("/")[2]  # agent/NAME/INSTANCE/bids
            yield Bids(at, instance, message, seconds_since(message.cycle, newest))
        elif isinstance(message, SHOWN) and of_the_wheels(message):
            yield Published(at, message)
        else:
            yield Passed(at)
