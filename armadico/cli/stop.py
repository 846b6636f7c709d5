"""Stop the robot; it stays stopped until `armadico resume`."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from armadico.cli import options
from armadico.cli.latch import Options, latch
from armadico.cli.parsing import Command
from armadico.mesh.topology import TopologyError

EXAMPLES: Final = """\
  armadico stop                       no agent drives it until `armadico resume`
  armadico stop --namespace robot2    the other robot
"""


def run(args: Options) -> int:
    """Stop the robot; each end without its confirmation says so, and is no success."""
    try:
        code = latch(args, stopped=True)
    except options.WRONGLY_USED as error:
        raise options.UsageError(_not(error)) from None
    except options.UnknownError as error:
        raise options.UnknownError(_not(error)) from None
    except (*options.BROKEN, OSError) as error:
        if isinstance(error, OSError) and error.errno in (errno.EPIPE, errno.ENOSPC):
            raise  # it is stopped, and that could not be printed
        raise options.FailedError(_not(error, args.mesh.namespace)) from None
    except KeyboardInterrupt:
        options.report(_not("interrupted before the robot agent confirmed the stop"))
        raise
    if others := _others(args.mesh.namespace):
        options.report(
            f"only {args.mesh.namespace} is stopped. {others} on this computer can drive on:"
            f" `armadico stop --namespace {others.partition(',')[0]}`"
        )
    return code


def _not(why: object, namespace: str = "") -> str:
    text = f"NOT stopped: {why}"
    others = _others(namespace) if namespace else ""
    return f"{text}. Robots on this computer are {others}" if others else text


def _others(namespace: str) -> str:
    """The other robots of this computer, with commas."""
    from armadico.mesh.sockets import robots_here

    with suppress(TopologyError):
        return ", ".join(name for name in robots_here() if name != namespace)
    return ""


class _Stop(Command[Options]):
    """The command; a wrong command line stops nothing, and says so."""

    def parse(self, argv: Sequence[str]) -> Options:
        try:
            return super().parse(argv)
        except SystemExit as end:
            if end.code:
                options.report(f"{self.program}: {_not('the command line is wrong')}")
            raise


main: Final = _Stop(
    "armadico stop",
    Options,
    run,
    "Stop the robot, whichever agent drives. It stays stopped until `armadico resume`.",
    EXAMPLES,
)
