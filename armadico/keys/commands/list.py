"""List all identities."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import shown
from armadico.cli.parsing import Command, flag, group
from armadico.keys.commands.common import Society, now
from armadico.keys.store import MEMBERS, Identity, Member, Store

EXAMPLES: Final = """\
  armadico keys list
  armadico keys list --json | jq '.[] | select(.revoked != "")'
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    json: bool = flag("print a JSON array")
    society: Society = group(Society, "the society")


@dataclass(frozen=True)
class Row:
    """An identity: until when its certificate here is valid ("" if it is not here)."""

    name: str
    kind: str
    hosts: tuple[str, ...]
    ends: str
    fault: str
    revoked: str


def run(args: Options) -> int:
    rows = list(_rows(args.society.store))
    if args.json:
        print(json.dumps([vars(row) for row in rows], indent=2))
        return 0
    head = ("IDENTITY", "KIND", "HOSTS", "HERE VALID UNTIL", "")
    lines = [head, *(_line(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print(shown("  ".join(cells).rstrip()))
    return 0


def _line(row: Row) -> tuple[str, ...]:
    state = f"revoked {row.revoked[:16]}" if row.revoked else row.fault
    return (row.name, row.kind, ", ".join(row.hosts), row.ends[:16].replace("T", " "), state)


def _rows(store: Store) -> Iterator[Row]:
    """All identities of the list, if it is here, else those of this computer."""
    from armadico.keys.checking import Checks
    from armadico.keys.members import kind_of

    store.check()
    here = {identity.name: identity for identity in store.identities()}
    listed = store.members() if (store.folder / MEMBERS).exists() else {}
    checks = Checks(store, now())
    for name in sorted(here.keys() | listed.keys()):
        member = listed.get(name) or Member(name, kind_of(name))
        identity = here.get(name)
        faults = () if identity is None else (*checks.of(identity), checks.expiring(identity))
        fault = next(filter(None, faults), "")
        yield Row(name, member.kind, member.hosts, _ends(identity), fault, member.revoked)


def _ends(identity: Identity | None) -> str:
    from armadico.keys.authority import KeyFileError, facts

    if identity is None:
        return ""
    try:
        return facts(identity.certificate.read_bytes()).ends.isoformat()
    except (OSError, KeyFileError):
        return "unreadable"


COMMAND: Final = Command(
    "armadico keys list",
    Options,
    run,
    "List the identities of this computer, with the time, UTC, until which each certificate is"
    " valid; on the authority's computer and on the robot's, all identities.",
    EXAMPLES,
)
