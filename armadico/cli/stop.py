"""Stop the robot; it stays stopped until `armadico resume`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from armadico.cli import options
from armadico.cli.latch import latch

EXAMPLES: Final = """\
  armadico stop                       nobody drives it until `armadico resume`
  armadico stop --namespace robot2    the other robot
"""


def main(argv: Sequence[str]) -> int:
    """Stop the robot; it stays stopped until `armadico resume`."""
    made = options.parser(
        "armadico stop",
        "Stop the robot, whoever drives it. It stays stopped until `armadico resume`.",
        EXAMPLES,
    )
    return latch(made, argv, stopped=True)
