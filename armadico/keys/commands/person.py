"""Make the key of a person."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, group, option
from armadico.keys.commands.common import (
    OUT_HELP,
    Society,
    given_out,
    hours_option,
    issuer_of,
)
from armadico.mesh.door import LONGEST_NAME, PERSON, person

EXAMPLES: Final = """\
  armadico keys person anna                        on this computer
  armadico keys person anna --out anna-keys.tar    for a computer of hers
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    user: str = argument("the name with which the person logs in", metavar="USER")
    out: Path | None = option(f"{OUT_HELP} this computer's folder)", metavar="FILE")
    hours: float = hours_option()
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    from armadico.keys.members import for_person

    if not args.user or person(args.user) != f"{PERSON}{args.user}":
        raise UsageError(
            f"{args.user!r}: expected a user's name of letters, digits, '.', '_' and '-', at most"
            f" {LONGEST_NAME - len(PERSON)}"
        )
    issuer, namespace = issuer_of(args.society, args.hours), args.society.where.namespace
    given_out(issuer, for_person(namespace, args.user), args.out, args.society)
    return 0


COMMAND: Final = Command(
    "armadico keys person",
    Options,
    run,
    "Make the key of a person, who may look, drive, stop and release, and the keys of what runs"
    " beside a command: the page, the gateways and the agent for driving by hand.",
    EXAMPLES,
)
