"""The checker of promises on a recording: what `armadico record` kept of any society."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from armadico.core.cycles import PERIOD
from armadico.core.messages import (
    Ack,
    BidRecord,
    Claim,
    Command,
    Cycle,
    MessageError,
    MissionStatus,
    Obstacles,
    RobotState,
    Truth,
)
from armadico.observe.recordings import HERE, Row, rows
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.observations import (
    Bids,
    Left,
    Observation,
    Passed,
    Said,
    of_the_wheels,
)

SHOWN = (RobotState, Ack, Claim, Command, MissionStatus, Truth, Obstacles)


def check(path: Path, namespace: str | None, warn: Callable[[str], None]) -> Checker:
    """Look at a recording, of one namespace if there are several.

    What no recording shows is not looked at: the line to the controller, and which faults were
    made. So a promise that a fault takes away (`kinds.voided`) counts as broken here.
    Raises RecordingError and OSError.
    """
    checker = Checker()
    checker.take_all(
        observations(row for row in rows(path, warn) if namespace in (None, row.namespace))
    )
    return checker


def observations(recorded: Iterable[Row]) -> Iterator[Observation]:
    """What the checker is shown of a recording; times are s."""
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
            yield Bids(at, instance, message, _age(message.cycle, newest))
        elif isinstance(message, SHOWN) and of_the_wheels(message):
            yield Said(at, message)
        else:
            yield Passed(at)


def _age(cycle: Cycle, newest: Cycle | None) -> float:
    """How long ago a cycle was, s; bids are queried, and come some time after they were made."""
    if newest is None or newest.epoch != cycle.epoch:
        return 0.0
    return max(newest.number - cycle.number, 0) * PERIOD
