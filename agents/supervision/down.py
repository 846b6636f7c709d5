"""End the processes of `armadico up` on this machine, and those left by a killed run."""

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

PATIENCE_S: Final = 20.0  # the timeout for all processes: a few seconds for each kind

KILL_S: Final = 4.0  # the time that an orphaned process has before it is killed

POLL_S: Final = 0.05

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
    """End all, and wait for it; also 0 if nothing was running."""
    from armadico.launch.pidfile import shares

    namespace = checked_namespace(args.namespace)
    try:
        hosts = _hosts(args)
        found = [each for each in shares(namespace, args.host) if not hosts or each.host in hosts]
    except OSError as error:
        raise FailedError(f"cannot list the running processes: {error}") from None
    whose = f"of {', '.join(hosts)} " if hosts else ""
    for share in found:
        _end(share)
    left = [] if hosts else _end_orphans(namespace)
    if left:
        print(f"ended the processes left by a killed `armadico run`: {', '.join(left)}")
    elif not found:
        print(f"nothing {whose}is up on this machine in namespace {namespace!r}")
    return 0


def _hosts(args: Options) -> list[str]:
    """Return the selected hosts; empty: all. Raises ConfigError."""
    if args.hosts is None:
        return [args.host] if args.host else []
    from armadico.config.hosts import load_hosts

    table = load_hosts(args.hosts)
    if args.host:
        table.host(args.host)
    return [args.host] if args.host else list(table.hosts)


def _end_orphans(namespace: str) -> list[str]:
    """End the processes of a run whose launcher is gone; return their names in that order."""
    import psutil

    from armadico.launch.processes import SIMULATOR, orphans, owns_wheels

    found = orphans(namespace)
    ended: list[str] = []
    for rank in range(3):  # behaviours release, the robot stops, the simulator ends last
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
    """End a host's share. Raises FailedError if that is not permitted, or times out."""
    from armadico.launch.pidfile import PidFile
    from armadico.mesh.sockets import is_held

    path = PidFile(share.namespace, share.host).path
    try:
        with suppress(ProcessLookupError):
            os.kill(share.pid, signal.SIGTERM)
    except PermissionError:
        raise FailedError(f"process {share.pid} of {share.host} belongs to another user") from None
    deadline = time.monotonic() + PATIENCE_S
    while is_held(path):
        if time.monotonic() >= deadline:
            raise FailedError(
                f"{share.host} is not down after {PATIENCE_S:.0f} s; check process {share.pid},"
                f" its logs are in {share.logs}"
            )
        time.sleep(POLL_S)
    print(f"{share.host} is down: {', '.join(share.agents)}")


main: Final = Command(
    "armadico down",
    Options,
    run,
    "End the processes of `armadico up` on this machine: the agents release their resources, and"
    " the robot stops. Other machines are not affected. Processes left by a killed `armadico run`"
    " end, too; agents that were started by hand do not.",
    EXAMPLES,
)
