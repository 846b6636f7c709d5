"""Stop the robot; it stays stopped until `armadico resume`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

from armadico.cli import latch

EXAMPLES: Final = """\
  armadico stop                       nobody drives it until `armadico resume`
  armadico stop --namespace robot2    the other robot
"""


def main(argv: Sequence[str]) -> int:
    """Stop the robot; it stays stopped until `armadico resume`."""
    return latch.latch(parser().parse_args(argv), stopped=True)


def parser() -> argparse.ArgumentParser:
    return latch.parser(
        "armadico stop",
        "Stop the robot, whoever drives it. It stays stopped until `armadico resume`.",
        EXAMPLES,
    )
