"""Write an archive with the keys of a host of the table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.parsing import Command, argument, group, option, several
from armadico.keys.commands.common import (
    OUT_HELP,
    Society,
    given_out,
    hours_option,
    issuer_of,
)

EXAMPLES: Final = """\
  armadico keys host lab2 --hosts lab.toml
  scp lab2-keys.tar lab2:lab/ && ssh lab2 tar -xf lab/lab2-keys.tar -C lab
  armadico keys host lab2 --person anna --person ben    who uses that computer
  armadico keys host lab2 --out /media/stick/keys       a folder instead of an archive
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    name: str = argument("the host, as the host table names it", metavar="NAME")
    out: Path | None = option(
        f"{OUT_HELP} NAME-keys.tar; of this computer: its folder)", metavar="FILE"
    )
    person: tuple[str, ...] = several(
        "include the key of this person; may be repeated (default: the user of this command)",
        metavar="USER",
    )
    hours: float = hours_option()
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    from armadico.keys.members import of_host

    table, where, users = args.society.table, args.society.where, args.person
    issuer = issuer_of(args.society, args.hours)
    members = of_host(table, args.name, where.namespace, args.society.users(users))
    here = args.out is None and args.name == where.name
    file = None if here else args.out or Path(f"{args.name}-keys.tar")
    given_out(issuer, members, file, args.society)
    return 0


COMMAND: Final = Command(
    "armadico keys host",
    Options,
    run,
    "Write the keys of one host of the table: of its agents, of those that it may take over, of"
    " `armadico up`, the page and its persons. Unpack the archive beside the host table on that"
    " computer. It has no key of the authority, and of another host's agents only those that this"
    " host may take over (`takes`). Unpack it soon: its certificates expire as all others.",
    EXAMPLES,
)
