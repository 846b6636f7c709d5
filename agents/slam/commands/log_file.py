"""What the commands that read logs share: the log, and errors of its odometry (not a command)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.parsing import between, option
from armadico.core.judgement import Judgement

if TYPE_CHECKING:
    from armadico.agents.slam.logs.logs import Log

PARTS: Final = ("all", "even", "odd", "first", "second")
"""Selections of a log's readings, as in `slam.logs.localizing`, which loads more slowly."""

ERRORS: Final = 0.05
"""Share of ways and turns by which the odometry errs, if a log's odometry is a corrected path."""


USED: Final = "readings used, in the file"


def period() -> Any:
    """The option for logs without useful times."""
    return option(
        "the interval of scans whose times are of no use (default: by the odometry, as if the robot"
        " moved at 0.5 m/s)",
        metavar="S",
        must=between(0.001, 3600),
    )


def conclude(judged: Judgement, passed: str, say: Callable[[str], None]) -> None:
    """Print what a command concludes: the answer, the reason, the cure."""
    if judged.passed:
        say(f"yes: {passed}")
        return
    say(str(judged))
    if judged.cure:
        say(f"-> {judged.cure}")


def read(
    path: Path,
    *,
    reach: float | None,
    corrected: bool | None,
    namespace: str | None,
    period: float | None = None,
) -> Log:
    """Return a log of any format of `slam.logs.logs`. Raises LogError, FailedError."""
    from armadico.agents.slam.logs import logs

    with path.open("rb") as file:
        if file.read(len(logs.MCAP)) == logs.MCAP:
            options.need("mcap", "record")
    return logs.read(path, reach=reach, corrected=corrected, namespace=namespace, period=period)


def with_errors(log: Log, share: float | None, seed: int) -> tuple[Log, float]:
    """The log with errors added to its odometry, and their share; None: the default of the log."""
    from armadico.agents.slam.logs import logs

    if share is None:
        share = 0.0 if log.real else ERRORS
    return (logs.with_errors(log, share, seed) if share else log), share
