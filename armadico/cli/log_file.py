"""What the commands that read logs share: the log, and errors of its odometry (not a command)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options

if TYPE_CHECKING:
    from armadico.observe.logs import Log

PARTS: Final = ("all", "even", "odd", "first", "second")
"""Selections of a log's readings, as in `armadico.observe.localizing`, which loads more slowly."""

ERRORS: Final = 0.05
"""Share of ways and turns by which the odometry errs, if a log's odometry is a corrected path."""


def read(path: Path, *, reach: float | None, corrected: bool | None, namespace: str | None) -> Log:
    """Return a log of any format of `armadico.observe.logs`. Raises LogError, FailedError."""
    from armadico.observe import logs

    with path.open("rb") as file:
        if file.read(len(logs.MCAP)) == logs.MCAP:
            options.need("mcap", "record")
    return logs.read(path, reach=reach, corrected=corrected, namespace=namespace)


def with_errors(log: Log, share: float | None, seed: int) -> tuple[Log, float]:
    """The log with errors added to its odometry, and their share; None: the default of the log."""
    from armadico.observe import logs

    if share is None:
        share = 0.0 if log.real else ERRORS
    return (logs.with_errors(log, share, seed) if share else log), share
