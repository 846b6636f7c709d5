"""End what `armadico up` keeps up on this machine."""

from __future__ import annotations

import argparse
import os
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError

if TYPE_CHECKING:
    from armadico.pidfile import Share

PATIENCE_S: Final = 20.0
"""What it may take until everything is down: a few seconds for each kind of process."""

LOOK_S: Final = 0.05
"""How often it is looked whether it is."""

EXAMPLES: Final = """\
  armadico down
  armadico down --host lab1 --namespace robot2
"""


def main(argv: Sequence[str]) -> int:
    """Have it end, and wait until it has; 0 also if there was nothing."""
    args = _parser().parse_args(argv)
    from armadico.mesh.topology import checked_namespace  # noqa: PLC0415 - not for --help
    from armadico.pidfile import shares  # noqa: PLC0415 - not for --help

    namespace = checked_namespace(args.namespace)
    try:
        found = list(shares(namespace, args.host))
    except OSError as error:
        raise FailedError(f"cannot look what is up: {error}") from None
    whose = f"of {args.host} " if args.host else ""
    if not found:
        print(f"nothing {whose}is up on this machine in namespace {namespace!r}")
    for share in found:
        _end(share)
    return 0


def _parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico down",
        "End what `armadico up` keeps up on this machine: the agents let go, the robot stops. Other"
        " machines' shares are theirs.",
        EXAMPLES,
    )
    options.add_namespace_option(made)
    made.add_argument("--host", metavar="H", help="this host's share only (default: all)")
    return made


def _end(share: Share) -> None:
    """Raises FailedError if it may not be ended, or does not end."""
    from armadico.pidfile import PidFile, is_held  # noqa: PLC0415 - not for --help

    path = PidFile(share.namespace, share.host).path
    try:
        with suppress(ProcessLookupError):
            os.kill(share.pid, signal.SIGTERM)
    except PermissionError:
        raise FailedError(f"process {share.pid} of {share.host} belongs to somebody else") from None
    deadline = time.monotonic() + PATIENCE_S
    while is_held(path):
        if time.monotonic() >= deadline:
            raise FailedError(
                f"{share.host} is not down after {PATIENCE_S:.0f} s; look at process {share.pid},"
                f" its logs are in {share.logs}"
            )
        time.sleep(LOOK_S)
    print(f"{share.host} is down: {', '.join(share.agents)}")
