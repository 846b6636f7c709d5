"""Stop the robot; it stays stopped until `armadico resume`."""

from __future__ import annotations

from typing import Final

from armadico.cli.latch import Options, latch
from armadico.cli.parsing import Command

EXAMPLES: Final = """\
  armadico stop                       no agent drives it until `armadico resume`
  armadico stop --namespace robot2    the other robot
"""


def run(args: Options) -> int:
    return latch(args, stopped=True)


main: Final = Command(
    "armadico stop",
    Options,
    run,
    "Stop the robot, whichever agent drives. It stays stopped until `armadico resume`.",
    EXAMPLES,
)
