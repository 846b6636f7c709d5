"""Release the stop, and let the agents drive again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from armadico.cli import options
from armadico.cli.latch import latch

EXAMPLES: Final = """\
  armadico resume                       after `armadico stop`
  armadico resume --namespace robot2    the other robot
"""


def main(argv: Sequence[str]) -> int:
    """Release the stop, and let the agents drive again."""
    made = options.parser(
        "armadico resume", "Release the stop, and let the agents drive again.", EXAMPLES
    )
    return latch(made, argv, stopped=False)
