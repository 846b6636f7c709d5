"""End what `armadico up` keeps up on this machine, and what a run that was killed has left."""

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
    from armadico.launch.pidfile import Share

PATIENCE_S: Final = 20.0
"""What it may take until everything is down: a few seconds for each kind of process."""

KILL_S: Final = 4.0
"""What a process that was left may take to leave before it is killed."""

LOOK_S: Final = 0.05
"""How often it is looked whether it is."""

EXAMPLES: Final = """\
  armadico down
  armadico down --host lab1 --namespace robot2
"""


def main(argv: Sequence[str]) -> int:
    """Have it end, and wait until it has; 0 also if there was nothing."""
    args = parser().parse_args(argv)
    from armadico.launch.pidfile import shares  # noqa: PLC0415 - not for --help
    from armadico.mesh.topology import checked_namespace  # noqa: PLC0415 - not for --help

    namespace = checked_namespace(args.namespace)
    try:
        found = list(shares(namespace, args.host))
    except OSError as error:
        raise FailedError(f"cannot look what is up: {error}") from None
    whose = f"of {args.host} " if args.host else ""
    for share in found:
        _end(share)
    left = [] if args.host else _end_orphans(namespace)
    if left:
        print(f"ended what a killed `armadico run` had left: {', '.join(left)}")
    elif not found:
        print(f"nothing {whose}is up on this machine in namespace {namespace!r}")
    return 0


def _end_orphans(namespace: str) -> list[str]:
    """End the processes of a run whose launcher is gone; their names, in the order of ending."""
    import psutil  # noqa: PLC0415 - not for --help

    from armadico.launch.processes import ROBOT, SIMULATOR, orphans  # noqa: PLC0415 - not for --help

    found = orphans(namespace)
    order = {ROBOT: 1, SIMULATOR: 2}  # behaviours let go, the robot stops, the simulator ends last
    ended: list[str] = []
    for rank in range(3):
        group = [(n, p) for n, p in found if max(order.get(a, 0) for a in n.split("+")) == rank]
        for _, process in group:
            with suppress(psutil.Error):
                process.terminate()
        _, alive = psutil.wait_procs([process for _, process in group], timeout=KILL_S)
        for process in alive:
            with suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(alive, timeout=KILL_S)
        ended += [name for name, _ in group]
    return ended


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico down",
        "End what `armadico up` keeps up on this machine: the agents let go, the robot stops. Other"
        " machines' shares are theirs. What an `armadico run` has left that was killed ends, too;"
        " agents that were started by hand do not.",
        EXAMPLES,
    )
    options.add_namespace_option(made)
    made.add_argument("--host", metavar="H", help="this host's share only (default: all)")
    return made


def _end(share: Share) -> None:
    """Raises FailedError if it may not be ended, or does not end."""
    from armadico.launch.pidfile import PidFile, is_held  # noqa: PLC0415 - not for --help

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
