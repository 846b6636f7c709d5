"""What `stop` and `resume` share: the latch that stops the robot."""

from __future__ import annotations

import argparse
from typing import Final

from armadico.cli import options

TIMEOUT_S: Final = 5.0
"""As in `armadico.runtime.client`, which --help does without."""


def parser(program: str, description: str, examples: str) -> argparse.ArgumentParser:
    """The options of `armadico stop` and `armadico resume`."""
    made = options.parser(program, description, examples)
    options.add_timeout(made, "give up after this", TIMEOUT_S)
    options.add_mesh_options(made)
    return made


def latch(args: argparse.Namespace, *, stopped: bool, code: str | None = None) -> int:
    """Publish it until the robot agent acknowledges it; returns the exit code."""
    mesh = options.join(args)
    from armadico.runtime.client import Client  # noqa: PLC0415 - not for --help
    from armadico.runtime.errors import AbsentError  # noqa: PLC0415

    with mesh:
        client = Client(mesh)
        try:
            if stopped:
                client.stop(args.timeout, by="armadico stop")
            else:
                client.resume(args.timeout, by="armadico resume", code=code)
        except AbsentError:
            if mesh.wait_joined(0.0):
                raise
            what = f"the {'stop' if stopped else 'release'} could not be sent"
            raise options.absent(mesh, args.timeout, what) from None
        # Before leaving, which may take a while where a host does not answer.
        print(f"the robot is {'stopped' if stopped else 'free to move'}", flush=True)
    return 0
