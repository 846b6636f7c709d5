"""The common part of `stop` and `resume`: they publish the latched stop."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import group
from armadico.core.config_errors import ConfigError
from armadico.mesh.topology import TopologyError

if TYPE_CHECKING:
    from armadico.mesh.sockets import Stopped

LATE_S: Final = 2.0
"""So long a guard is asked what it did, after the robot agent has not confirmed the stop."""

REPAIR: Final = "Look at the robot; `armadico why --live` tells more"

TIMEOUT_S: Final = 5.0
"""As in `armadico.launch.client`, which --help does not import."""


@dataclass(frozen=True, kw_only=True)
class Options:
    timeout: float = options.timeout_option("wait at most so long", TIMEOUT_S)
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def _unseen(told: Stopped | None, *, joined: bool) -> None:
    """Report what is known of a stop while no state of the robot confirms it."""
    if told is not None and told.latched:
        why = "so its controller does not answer" if joined else "as this command has no link"
        options.report(
            f"the robot agent (process {told.pid}) has latched the stop; no state of the robot"
            f" arrives, {why}, and it is not known whether the wheels rest. Still waiting"
        )


def latch(args: Options, *, stopped: bool, code: str | None = None) -> int:
    """Publish the stop or its release until the robot agent acknowledges it.

    The society's processes on this computer are told without the mesh, too. Raises UnknownError if
    the robot agent has not confirmed that.
    """
    told = None
    if stopped and not args.mesh.connect:
        from armadico.mesh.sockets import stop

        with suppress(TopologyError, OSError):  # joining names what is wrong, if it needs it
            told = stop(args.mesh.namespace)  # first: the mesh may be slow, or its listener full
    guard = told.guard if told is not None and not told.latched else None
    if guard is not None:
        options.report(f"{guard.did}; the robot agent (process {guard.agent}) does not answer")
    try:
        mesh = args.mesh.join()
    except (ConfigError, TopologyError, OSError) as error:  # no usable key, table or folder
        if told is None or (told.pid is None and told.guard is None):
            raise
        raise options.UnknownError(
            f"the society on this computer was told to stop, and nothing confirms it: {error}."
            f" {REPAIR}"
        ) from None
    from armadico.launch.client import Client
    from armadico.mesh.sockets import guard_now
    from armadico.runtime.errors import AbsentError

    with mesh:
        client = Client(mesh)
        try:
            if guard is not None and not mesh.wait_joined(min(options.JOIN_S, args.timeout)):
                raise AbsentError("the guard alone has the stop")
            if stopped:
                client.stop(
                    args.timeout,
                    by="armadico stop",
                    unseen=lambda: _unseen(told, joined=mesh.wait_joined(0.0)),
                )
            else:
                client.resume(args.timeout, by="armadico resume", code=code)
        except AbsentError:
            if told is not None and not told.latched:
                # A busy one answers late.
                guard = guard_now(args.mesh.namespace, min(args.timeout, LATE_S)) or guard
            if guard is not None and guard.word == "holds":
                raise options.UnknownError(
                    f"{guard.did}; the robot agent (process {guard.agent}) has not confirmed the"
                    f" stop: it hangs, or its computer is overloaded. The guard holds the stop"
                    f" until it has. {REPAIR}"
                ) from None
            if told is not None and told.pid is not None:
                done = "has latched the stop, and" if told.latched else "was told to stop, and"
                raise options.UnknownError(
                    f"process {told.pid} of the society {done} no state of the robot confirms it."
                    f" {REPAIR}"
                ) from None
            if mesh.wait_joined(0.0):
                raise
            what = f"the {'stop' if stopped else 'release'} could not be sent"
            raise options.FailedError(f"{what}: {mesh.missing}") from None
        # Printed first: closing the mesh takes a while if a host does not answer.
        print(f"the robot is {'stopped' if stopped else 'free to move'}", flush=True)
    return 0
