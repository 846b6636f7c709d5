"""What serves beside a run, as a process of its own: the dashboard, the page."""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from armadico.cli.options import FailedError

PORTS: Final = {"dashboard": ("--port=0", "--web-port=0"), "page": ("--port=0",)}
"""The commands that can be beside a run; each takes ports that are free."""

LEAVE_S: Final = 10.0
"""What it may take to leave before it is killed: a dashboard closes a file and a viewer."""


@contextmanager
def beside(
    args: argparse.Namespace,
    command: str,
    world: str,
    namespaces: Sequence[str] = (),
    *,
    wait: bool = False,
) -> Iterator[None]:
    """A process for a run that ends with it; its link is printed.

    Args:
        args: The run's: with the options of the mesh.
        command: One of `PORTS`.
        world: The run's world, by name or path.
        namespaces: The run's robots; by default the one of the options.
        wait: Until somebody looks; and afterwards it stays until Ctrl-C.

    Raises:
        FailedError: It did not start, and has said why on stderr.
    """
    words = [sys.executable, "-P", "-m", "armadico", command, *PORTS[command], f"--world={world}"]
    words += [f"--namespace={name}" for name in namespaces or (args.namespace,)]
    words += [f"--connect={endpoint}" for endpoint in args.connect]
    words += [f"--{name}={v}" for name in ("host", "hosts") if (v := getattr(args, name))]
    process = subprocess.Popen(
        words,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is the run's; it ends this one
    )
    assert process.stdout is not None, "it was asked for"
    with process, process.stdout:
        try:
            said = process.stdout.readline()  # ends with the process, if that fails
            if not said:
                raise FailedError(f"no {command}, so no run; without --{command} it drives")
            print(said, end="", file=sys.stderr, flush=True)
            if wait:
                _say("open the link: the run begins when somebody looks")
                if not process.stdout.readline():
                    raise FailedError(f"the {command} has ended, so no run")
            yield
            if wait:
                with suppress(KeyboardInterrupt):  # which may come as soon as it is offered
                    _say(f"the run is over; Ctrl-C ends the {command}")
                    process.wait()
        finally:
            _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    """In order, or else by force."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(LEAVE_S)
    except subprocess.TimeoutExpired:
        process.kill()


def _say(text: str) -> None:
    print(f"armadico run: {text}", file=sys.stderr, flush=True)
