"""What `stop` and `resume` share: the latch that stops the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armadico.cli import options
from armadico.cli.parsing import group

TIMEOUT_S: Final = 5.0
"""As in `armadico.runtime.client`, which --help does without."""


@dataclass(frozen=True, kw_only=True)
class Options:
    timeout: float = options.timeout_option("give up after this", TIMEOUT_S)
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def latch(args: Options, *, stopped: bool, code: str | None = None) -> int:
    """Publish it until the robot agent acknowledges it; returns the exit code."""
    mesh = args.mesh.join()
    from armadico.runtime.client import Client
    from armadico.runtime.errors import AbsentError

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
