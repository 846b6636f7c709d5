"""What `stop` and `resume` share: the latch that stops the robot."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.echo import seconds

if TYPE_CHECKING:
    from armadico.client import Client
    from armadico.messages import Stop

FIND_S: Final = 2.0
"""How long the robot is looked for."""


def latch(made: argparse.ArgumentParser, argv: Sequence[str], *, stopped: bool) -> int:
    """Say it until the robot agent shows it; returns the exit code."""
    made.add_argument(
        "--timeout",
        type=seconds,
        default=3.0,
        metavar="S",
        help="give up after this (default: 3 s)",
    )
    options.add_mesh_options(made)
    args = made.parse_args(argv)
    mesh = options.join(args)
    from armadico.client import Client  # noqa: PLC0415 - not for --help

    with mesh:
        said = _say(Client(mesh), args, stopped)
        # Before leaving, which may take a while where a host does not answer.
        print(f"the robot is {'stopped' if said.stopped else 'free to move'}", flush=True)
    return 0


def _say(client: Client, args: argparse.Namespace, stopped: bool) -> Stop:
    """Say it until it is echoed; returns what the robot agent says."""
    from armadico.latch import say  # noqa: PLC0415 - not for --help
    from armadico.messages import RobotState  # noqa: PLC0415 - not for --help

    client.listen(RobotState)
    state = client.wait_for(lambda: client.latest(RobotState), FIND_S)
    if state is None and not stopped:
        raise options.nobody(args, "no robot answers")
    by = "armadico stop" if stopped else "armadico resume"
    done = say(client, stopped=stopped, by=by, timeout=args.timeout)
    if done is not None:
        return done
    word = "the stop" if stopped else "the release"
    raise options.nobody(args, f"no robot answers: {word} was said, and nobody confirmed it")
