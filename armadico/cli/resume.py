"""Release the stop, and let the agents drive again."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Final

from armadico.cli import latch

EXAMPLES: Final = """\
  armadico resume                       after `armadico stop`
  armadico resume --confirm 7K2PQ9      that stop, and none that came after it
  armadico resume --namespace robot2    the other robot
"""


def main(argv: Sequence[str]) -> int:
    """Release the stop, and let the agents drive again."""
    args = parser().parse_args(argv)
    return latch.latch(args, stopped=False, code=args.confirm)


def parser() -> argparse.ArgumentParser:
    made = latch.parser(
        "armadico resume", "Release the stop, and let the agents drive again.", EXAMPLES
    )
    made.add_argument(
        "--confirm",
        type=_code,
        metavar="CODE",
        help="release the stop of this code only: what a program that asks for it is answered",
    )
    return made


def _code(text: str) -> str:
    """A stop's code as it is spelt; people type o for 0, and i or l for 1."""
    code = text.strip().upper().translate(str.maketrans("OIL", "011"))
    if not re.fullmatch("[0-9A-HJKMNP-TV-Z]{6}", code):
        raise argparse.ArgumentTypeError(f"{text!r}: a code has six letters and digits")
    return code
