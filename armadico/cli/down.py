"""End the agents that `armadico up` runs on this machine, and processes that a killed run left."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli.options import NAMESPACE_HELP, FailedError, report
from armadico.cli.parsing import Command, option
from armadico.mesh.topology import checked_namespace, default_namespace

if TYPE_CHECKING:
    from armadico.launch.pidfile import Share

DOWN_S: Final = 20.0
"""Timeout for a share to end, s: a few seconds for each kind of process."""

KILL_S: Final = 4.0
"""Timeout after SIGTERM before an orphan is killed, s."""

POLL_S: Final = 0.05
"""Polling period, s."""

EXAMPLES: Final = """\
  armadico down
  armadico down --host lab1 --namespace robot2
  armadico down --hosts lab.toml
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    namespace: str = option(NAMESPACE_HELP, metavar="NS", factory=default_namespace)
    host: str | None = option("end this host's share only (default: all)", metavar="H")
    hosts: str | None = option(
        "end the shares of this host table's hosts only (default: all)", metavar="TABLE"
    )


def run(args: Options) -> int:
    """End the shares and wait for them. Return 0, also if nothing was running."""
    from armadico.launch.pidfile import clear, shares
    from armadico.mesh import sockets

    namespace = checked_namespace(args.namespace)
    try:
        hosts = _hosts(args)
        found = [each for each in shares(namespace, args.host) if not hosts or each.host in hosts]
    except OSError as error:
        raise FailedError(f"cannot read what is up: {error}") from None
    where = f"of {', '.join(hosts)} " if hosts else ""
    for share in found:
        _end_share(share)
    left = [] if hosts else _end_orphans(namespace)
    killed = clear(namespace, hosts)
    sockets.clear(namespace)
    if left:
        print(f"ended the processes left by a killed launcher: {', '.join(left)}")
    for share in killed:
        logs = f"; its logs stay in {share.logs}" if Path(share.logs).is_dir() else ""
        print(f"{share.host} was killed: its files are removed{logs}")
    if not (left or killed or found):
        print(f"nothing {where}is up on this machine in namespace {namespace!r}")
        if others := sorted({*sockets.robots_here()} - {namespace}):
            report(f"armadico down: still up on this machine: {', '.join(others)}")
    return 0


def _hosts(args: Options) -> list[str]:
    """The hosts whose shares are ended; empty: all. Raises ConfigError."""
    if args.hosts is None:
        return [args.host] if args.host else []
    from armadico.config.hosts import load_hosts

    table = load_hosts(args.hosts)
    if args.host:
        table.host(args.host)
    return [args.host] if args.host else list(table.hosts)


def _end_orphans(namespace: str) -> list[str]:
    """End the processes of a run whose launcher is gone. Return their names, in that order."""
    import psutil

    from armadico.launch.processes import SIMULATOR, orphans, owns_wheels

    found = orphans(namespace)
    ended: list[str] = []
    # Behaviours first, then the robot agent, which stops the robot, then the simulator.
    for rank in range(3):
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


def _end_share(share: Share) -> None:
    """End a share. Raises FailedError if that is not permitted or times out."""
    from armadico.mesh.sockets import is_held, share_of

    path = share_of(share.namespace, share.host)
    try:
        with suppress(ProcessLookupError):
            os.kill(share.pid, signal.SIGTERM)
    except PermissionError:
        raise FailedError(f"process {share.pid} of {share.host} belongs to another user") from None
    deadline = time.monotonic() + DOWN_S
    while is_held(path):
        if time.monotonic() >= deadline:
            raise FailedError(
                f"{share.host} is not down after {DOWN_S:.0f} s; check process {share.pid}"
                f" (logs: {share.logs})"
            )
        time.sleep(POLL_S)
    print(f"{share.host} is down: {', '.join(share.agents)}")


main: Final = Command(
    "armadico down",
    Options,
    run,
    "End the agents that `armadico up` runs on this machine, and stop the robot. Processes that a"
    " killed `armadico run` left end, too. Other machines' agents and agents that were started by"
    " hand continue.",
    EXAMPLES,
)
