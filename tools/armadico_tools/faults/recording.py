"""The checker of promises on a recording, which `armadico record` made of any society."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from armadico.core.messages import (
    Ballot,
    BidRecord,
    Claim,
    Command,
    Cycle,
    Message,
    MessageError,
    RobotState,
)
from armadico.observe.audit.auditor import watched
from armadico.watch.recordings import HERE, Row, rows
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.observations import (
    Bids,
    Left,
    Observation,
    Passed,
    Published,
    of_the_wheels,
)
from armadico_tools.faults.record import seconds_since

AT_ONCE_S: Final = 0.02
"""Messages received within this of each other count as simultaneous: each publisher has its own
connection to the recorder, so they may be recorded in either order."""

SHOWN: Final[tuple[type[Message], ...]] = (*watched(), Claim)


def check(path: Path, namespace: str | None, warn: Callable[[str], None]) -> Checker:
    """Check a recording, of one namespace if there are several.

    A recording has neither the line to the controller nor the faults. So a promise that a fault
    voids (`fault_types.voided`) counts as broken here. Raises RecordingError and OSError.
    """
    checker = Checker()
    checker.update_all(
        observations(row for row in rows(path, warn) if namespace in (None, row.namespace))
    )
    return checker


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
        yield seen if rank is None else replace(next(contend)[1], at=seen.at)


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
