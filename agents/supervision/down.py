"""End what `armadico up` keeps up on this machine, and what a run that was killed has left."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli.options import NAMESPACE_HELP, FailedError
from armadico.cli.parsing import Command, option
from armadico.mesh.topology import checked_namespace, default_namespace

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
  armadico down --hosts lab.toml
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    namespace: str = option(NAMESPACE_HELP, metavar="NS", factory=default_namespace)
    host: str | None = option("this host's share only (default: all)", metavar="H")
    hosts: str | None = option(
        "the shares of this host table's hosts only (default: all)", metavar="TABLE"
    )


def run(args: Options) -> int:
    """Have it end, and wait until it has; 0 also if there was nothing."""
    from armadico.launch.pidfile import shares

    namespace = checked_namespace(args.namespace)
    try:
        hosts = _hosts(args)
        found = [each for each in shares(namespace, args.host) if not hosts or each.host in hosts]
    except OSError as error:
        raise FailedError(f"cannot look what is up: {error}") from None
    whose = f"of {', '.join(hosts)} " if hosts else ""
    for share in found:
        _end(share)
    left = [] if hosts else _end_orphans(namespace)
    if left:
        print(f"ended what a killed `armadico run` had left: {', '.join(left)}")
    elif not found:
        print(f"nothing {whose}is up on this machine in namespace {namespace!r}")
    return 0


def _hosts(args: Options) -> list[str]:
    """The hosts whose shares are meant; none: all. Raises ConfigError."""
    if args.hosts is None:
        return [args.host] if args.host else []
    from armadico.config.hosts import load_hosts

    table = load_hosts(args.hosts)
    if args.host:
        table.host(args.host)
    return [args.host] if args.host else list(table.hosts)


def _end_orphans(namespace: str) -> list[str]:
    """End the processes of a run whose launcher is gone; their names, in the order of ending."""
    import psutil

    from armadico.launch.processes import SIMULATOR, orphans, owns_wheels

    found = orphans(namespace)
    ended: list[str] = []
    for rank in range(3):  # behaviours let go, the robot stops, the simulator ends last
        group = [(n, p) for n, p in found if 2 * (n == SIMULATOR) + owns_wheels(n) == rank]
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


def _end(share: Share) -> None:
    """Raises FailedError if it may not be ended, or does not end."""
    from armadico.launch.pidfile import PidFile
    from armadico.mesh.sockets import is_held

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


main: Final = Command(
    "armadico down",
    Options,
    run,
    "End what `armadico up` keeps up on this machine: the agents let go, the robot stops. Other"
    " machines' shares are theirs. What an `armadico run` has left that was killed ends, too;"
    " agents that were started by hand do not.",
    EXAMPLES,
)
