"""What `stop` and `resume` share: the latch that stops the robot."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

from armadico.cli import options
from armadico.cli.echo import seconds

TIMEOUT_S: Final = 5.0
"""As in `armadico.runtime.client`, which --help does without."""


def latch(made: argparse.ArgumentParser, argv: Sequence[str], *, stopped: bool) -> int:
    """Say it until the robot agent shows it; returns the exit code."""
    made.add_argument(
        "--timeout",
        type=seconds,
        default=TIMEOUT_S,
        metavar="S",
        help=f"give up after this (default: {TIMEOUT_S:g} s)",
    )
    options.add_mesh_options(made)
    args = made.parse_args(argv)
    mesh = options.join(args)
    from armadico.runtime.client import Client  # noqa: PLC0415 - not for --help

    with mesh:
        client = Client(mesh)
        (client.stop if stopped else client.resume)(args.timeout, by=made.prog)
        # Before leaving, which may take a while where a host does not answer.
        print(f"the robot is {'stopped' if stopped else 'free to move'}", flush=True)
    return 0
