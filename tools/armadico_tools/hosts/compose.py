"""The demo of several hosts, as containers of Docker Compose: `make demo`.

One host is stopped in the middle of a run, and started again. A host is a service of
deploy/compose.yaml. All output comes from inside: the containers' network may be unreachable from
this machine.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol, Self

from armadico.cli.options import FailedError, end_as_by_ctrl_c, guarded
from armadico.config.hosts import load_hosts
from armadico.runtime.programs import end
from armadico_tools.testbed import TABLE

FILE: Final = Path(__file__).resolve().parents[3] / "deploy" / "compose.yaml"
"""The description of the containers; `COMPOSE_FILE` in the environment names others."""

IMAGE: Final = "armadico"
"""The name of all hosts' image in the compose file."""

LOST: Final = "lab2"
"""The host that is stopped: that of the behaviours."""

SEAT: Final = "lab3"
"""The host that sends the goal; it has the product only."""

DRIVES: Final = ("armadico", "run")

AWAY_S: Final = 4.0
"""How long the lost host stays away."""

START_S: Final = 90
"""Time limit until all containers are healthy."""

INSTEAD: Final = "Without an engine, use `make run`, which needs this machine only."

EXAMPLES: Final = """\
  make demo
  make demo SCENARIO=house
  COMPOSE_FILE=deploy/compose.yaml:mine.yaml make demo    with your own override file
"""


class Hosts(Protocol):
    """Hosts of the demo's host table, real or not."""

    names: tuple[str, ...]

    def start(self, host: str) -> None:
        """Run a host's part of the society; may return before it is ready."""

    def stop(self, host: str) -> None:
        """Stop a host at once."""

    def popen(self, host: str, argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        """Run a command on a host; its output is piped, as text."""


def demo(hosts: Hosts, scenario: str, say: Callable[[str], None]) -> int:
    """Drive, stop a host once one of its agents drives, restart it. Returns the exit code."""
    for host in hosts.names:
        hosts.start(host)
    mine = [f", {name} drives" for name in load_hosts(TABLE).hosts[LOST].agents]
    words = (*DRIVES, scenario, "--attach", "--no-plot", "--host", SEAT, "--hosts", TABLE)
    run = hosts.popen(SEAT, words, stderr=subprocess.STDOUT)
    assert run.stdout is not None, "it is a pipe"
    back_at: float | None = None
    lost = False
    try:
        for line in run.stdout:
            say(line.rstrip())
            if not lost and any(text in line for text in mine):
                say(f"{LOST} is stopped")
                hosts.stop(LOST)
                lost, back_at = True, time.monotonic() + AWAY_S
            elif back_at is not None and time.monotonic() > back_at:
                say(f"{LOST} is started again")
                hosts.start(LOST)
                back_at = None
        return run.wait()
    finally:
        end(run)


class ComposeHosts:
    """The services of a compose file, as a context manager that removes them in the end."""

    def __init__(self, scenario: str, say: Callable[[str], None]) -> None:
        """Prepare.

        Args:
            scenario: The scenario of all hosts.
            say: Called with a line for each step and its duration.
        """
        self.names: tuple[str, ...] = tuple(load_hosts(TABLE).hosts)
        self._say = say
        self._environment = {"COMPOSE_FILE": str(FILE), **os.environ, "SCENARIO": scenario}

    def __enter__(self) -> Self:
        """Build the image and start every host. Raises FailedError."""
        self.down()  # the remains of a demo that was killed
        try:
            began = time.monotonic()
            self._say("building the image")
            self._do("build", "--quiet")
            self._say(f"image built, {_size()}, {time.monotonic() - began:.1f} s")
            began = time.monotonic()
            self._do("up", "--detach", "--wait", "--wait-timeout", str(START_S))
            self._say(f"all containers are healthy, {time.monotonic() - began:.1f} s")
        except BaseException:
            self.down()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._say("removing the containers")
        self.down()

    def start(self, host: str, *, wait: bool = False) -> None:
        """Start a host's container; with `wait`, until it is healthy. No effect if it runs."""
        waiting = ("--wait", "--wait-timeout", str(START_S)) if wait else ()
        self._do("up", "--detach", "--no-deps", "--no-build", *waiting, host)

    def stop(self, host: str) -> None:
        """Kill everything in a host's container, like a power failure."""
        self._do("kill", host)

    def popen(self, host: str, argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        """Start a command in a host's container; its output is piped.

        Ending the result ends this side only; the command ends with the container.
        """
        return _Client(
            ["docker", "compose", "exec", "--no-TTY", host, *argv],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
            start_new_session=True,  # Ctrl-C reaches the demo, which takes the containers down
            **options,
        )

    def down(self) -> None:
        """Remove the containers and their network; a second Ctrl-C does not interrupt it."""
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            self._do("down", "--timeout", "1", "--remove-orphans")
        finally:
            signal.signal(signal.SIGINT, before)

    def _do(self, *words: str) -> None:
        """Run a command of Compose. Raises FailedError with its output."""
        command = ["docker", "compose", *words]
        done = subprocess.run(
            command,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            check=False,
        )
        if done.returncode:
            output = "\n".join(f"    {line}" for line in done.stdout.strip().splitlines()[-15:])
            raise FailedError(f"{' '.join(command)} ended with {done.returncode}:\n{output}")


class _Client(subprocess.Popen[str]):
    """This side of a command in a container: `docker` and its plug-in."""

    def terminate(self) -> None:
        """Kill it: a client that is terminated would print so."""
        self.kill()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)


def _size() -> str:
    """The size of the image, as Docker counts."""
    done = subprocess.run(
        ["docker", "image", "inspect", "--format", "{{.Size}}", IMAGE],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    found = done.stdout.strip()
    return f"{int(found) / 1e6:.0f} MB" if found.isdecimal() else "of unknown size"


def lacking() -> str | None:
    """What this machine lacks for the demo, in a sentence; None if nothing."""
    if shutil.which("docker") is None:
        return "the command docker is missing (Docker Engine, or Docker Desktop)"
    if _failure("docker", "compose", "version") is not None:
        packages = "Docker's repository: docker-compose-plugin; Debian 13: docker-compose"
        return f"docker has no Compose v2 ({packages}; Ubuntu: docker-compose-v2)"
    trouble = _failure("docker", "version")
    if trouble is not None:
        return f"no engine answers: {trouble}"
    if not FILE.exists() and "COMPOSE_FILE" not in os.environ:
        return f"{FILE} is missing: the demo is run from a checkout"
    return None


def _failure(*command: str) -> str | None:
    """The last line of output of a command that failed; None if it succeeded."""
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    lines = (done.stderr or done.stdout).strip().splitlines()
    return (lines[-1] if lines else "no reason given") if done.returncode else None


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo and return the run's exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return guarded("make demo", lambda: _main(arguments))


def _main(arguments: Sequence[str]) -> int:
    args = _parser().parse_args(arguments)
    trouble = lacking()
    if trouble is not None:
        raise FailedError(f"{trouble}\n{INSTEAD}")
    end_as_by_ctrl_c()
    say = partial(print, flush=True)
    with ComposeHosts(args.scenario, say) as hosts:
        return demo(hosts, args.scenario, say)


def _parser() -> argparse.ArgumentParser:
    from armadico.cli.options import parser

    made = parser(
        "make demo",
        "Run four hosts as containers; stop one in the middle of a run, and start it again.",
        EXAMPLES,
    )
    made.add_argument("scenario", nargs="?", default="sc4", help="drive SCENARIO (default: sc4)")
    return made


if __name__ == "__main__":
    sys.exit(main())
