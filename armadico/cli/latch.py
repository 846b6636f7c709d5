"""The common part of `stop` and `resume`: they publish the latched stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armadico.cli import options
from armadico.cli.parsing import group

TIMEOUT_S: Final = 5.0
"""As in `armadico.launch.client`, which --help does not import."""


@dataclass(frozen=True, kw_only=True)
class Options:
    timeout: float = options.timeout_option("wait at most so long", TIMEOUT_S)
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def latch(args: Options, *, stopped: bool, code: str | None = None) -> int:
    """Publish the stop or its release until the robot agent acknowledges it.

    The society's processes on this computer are told without the mesh, too. Raises UnknownError if
    the robot agent has not confirmed that.
    """
    pid = None
    if stopped and not args.mesh.connect:
        from armadico.mesh.sockets import stop

        pid = stop(args.mesh.namespace)  # first: the mesh may be slow, or its listener full
    mesh = args.mesh.join()
    from armadico.launch.client import Client
    from armadico.runtime.errors import AbsentError

    with mesh:
        client = Client(mesh)
        try:
            if stopped:
                client.stop(args.timeout, by="armadico stop")
            else:
                client.resume(args.timeout, by="armadico resume", code=code)
        except AbsentError:
            if pid is not None:
                raise options.UnknownError(
                    f"process {pid} of the society was told to stop the robot, and the robot agent"
                    " has not confirmed it: look at the robot; `armadico why --live` tells more"
                ) from None
            if mesh.wait_joined(0.0):
                raise
            what = f"the {'stop' if stopped else 'release'} could not be sent"
            raise options.absent(mesh, args.timeout, what) from None
        # Printed first: closing the mesh takes a while if a host does not answer.
        print(f"the robot is {'stopped' if stopped else 'free to move'}", flush=True)
    return 0
