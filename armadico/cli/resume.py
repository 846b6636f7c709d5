"""Release the stop, and let the agents drive again."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from armadico.cli import latch
from armadico.cli.parsing import BadValueError, Command, option

EXAMPLES: Final = """\
  armadico resume                       after `armadico stop`
  armadico resume --confirm 7K2PQ9      that stop, and none that came after it
  armadico resume --namespace robot2    the other robot
"""


def _code(text: str) -> str:
    """A stop's code as it is spelt; people type o for 0, and i or l for 1."""
    code = text.strip().upper().translate(str.maketrans("OIL", "011"))
    if not re.fullmatch("[0-9A-HJKMNP-TV-Z]{6}", code):
        raise BadValueError(f"{text!r}: a code has six letters and digits")
    return code


@dataclass(frozen=True, kw_only=True)
class Options(latch.Options):
    confirm: str | None = option(
        "release the stop of this code only: what a program that asks for it is answered",
        read=_code,
        metavar="CODE",
    )


def run(args: Options) -> int:
    """Release the stop, and let the agents drive again."""
    return latch.latch(args, stopped=False, code=args.confirm)


main: Final = Command(
    "armadico resume",
    Options,
    run,
    "Release the stop, and let the agents drive again.",
    EXAMPLES,
)
