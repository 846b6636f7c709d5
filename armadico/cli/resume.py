"""Release the stop, and let the agents drive again."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

from armadico.cli import latch

EXAMPLES: Final = """\
  armadico resume                       after `armadico stop`
  armadico resume --namespace robot2    the other robot
"""


def main(argv: Sequence[str]) -> int:
    """Release the stop, and let the agents drive again."""
    return latch.latch(parser().parse_args(argv), stopped=False)


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    return latch.parser(
        "armadico resume", "Release the stop, and let the agents drive again.", EXAMPLES
    )
