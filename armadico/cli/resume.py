"""Release the stop, and let the agents drive again."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from armadico.cli import latch
from armadico.cli.parsing import BadValueError, Command, option

EXAMPLES: Final = """\
  armadico resume                       after `armadico stop`
  armadico resume --confirm 7K2PQ9      only that stop, not a later one
  armadico resume --namespace robot2    the other robot
"""


def _code(text: str) -> str:
    """The code of a stop, with o read as 0, and i and l as 1."""
    code = text.strip().upper().translate(str.maketrans("OIL", "011"))
    if not re.fullmatch("[0-9A-HJKMNP-TV-Z]{6}", code):
        raise BadValueError(f"{text!r}: expected a code of six letters and digits")
    return code


@dataclass(frozen=True, kw_only=True)
class Options(latch.Options):
    confirm: str | None = option(
        "release only the stop with this code, which a program's request to resume returns",
        read=_code,
        metavar="CODE",
    )


def run(args: Options) -> int:
    return latch.latch(args, stopped=False, code=args.confirm)


main: Final = Command(
    "armadico resume",
    Options,
    run,
    "Release the stop, so that the agents can drive again.",
    EXAMPLES,
)
