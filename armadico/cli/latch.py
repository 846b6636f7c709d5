"""What `stop` and `resume` share: the latch that stops the robot."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.echo import seconds

if TYPE_CHECKING:
    from armadico.runtime.client import Client

TIMEOUT_S: Final = 5.0
"""What finding the robot agent, its acknowledgement and braking may take: a Pioneer at full speed
brakes for 3 s."""


def parser(program: str, description: str, examples: str) -> argparse.ArgumentParser:
    """The options of `armadico stop` and `armadico resume`."""
    made = options.parser(program, description, examples)
    made.add_argument(
        "--timeout",
        type=seconds,
        default=TIMEOUT_S,
        metavar="S",
        help=f"give up after this (default: {TIMEOUT_S:g} s)",
    )
    options.add_mesh_options(made)
    return made


def latch(args: argparse.Namespace, *, stopped: bool) -> int:
    """Publish it until the robot agent acknowledges it; returns the exit code."""
    mesh = options.join(args)
    from armadico.runtime.client import Client  # noqa: PLC0415 - not for --help

    with mesh:
        _say(Client(mesh), args, stopped)
        # Before leaving, which may take a while where a host does not answer.
        print(f"the robot is {'stopped' if stopped else 'free to move'}", flush=True)
    return 0


def _say(client: Client, args: argparse.Namespace, stopped: bool) -> None:
    """Say it until it is acknowledged. Raises `FailedError` if it is not."""
    from armadico.core.messages import RobotState  # noqa: PLC0415 - not for --help
    from armadico.runtime.latch import say  # noqa: PLC0415 - not for --help

    client.listen(RobotState)
    by = "armadico stop" if stopped else "armadico resume"
    said = say(client, stopped=stopped, by=by, timeout=args.timeout)
    if said.done:
        return
    if said.refusal:
        raise options.FailedError(f"the robot is not released: {said.refusal}")
    if not stopped and said.known is None:
        raise options.nobody(args, "no robot answers: nothing is known that could be released")
    if said.latched:
        raise options.FailedError(f"the stop is latched, and {said.rolling}: look after the robot")
    what = f"the {'stop' if stopped else 'release'} was sent, not acknowledged"
    if said.known is None:
        raise options.nobody(args, f"{what}: no robot answers")
    still = "stopped" if said.known.stopped else "free to move"
    raise options.FailedError(
        f"{what}: the robot agent did not go on saying so; it last said {still}"
    )
