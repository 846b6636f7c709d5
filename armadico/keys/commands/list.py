"""List all keys."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import shown
from armadico.cli.parsing import Command, flag, group
from armadico.keys.commands.common import Society, now
from armadico.keys.expiry import user_in
from armadico.keys.store import MEMBERS, Identity, Issue, Member, Store, user_of

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
    """A key: its holders, and until when its certificate is valid if it is here ("" if not)."""

    name: str
    kind: str
    holders: tuple[str, ...]
    ends: str
    fault: str
    revoked: str


def run(args: Options) -> int:
    rows = list(_rows(args.society.store))
    if args.json:
        print(json.dumps([vars(row) for row in rows], indent=2))
        return 0
    head = ("KEY", "KIND", "HELD BY", "HERE VALID UNTIL", "")
    lines = [head, *(_line(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print(shown("  ".join(cells).rstrip()))
    return 0


def _line(row: Row) -> tuple[str, ...]:
    state = f"revoked {row.revoked[:16]}" if row.revoked else row.fault
    return (row.name, row.kind, ", ".join(row.holders), row.ends[:16].replace("T", " "), state)


def _rows(store: Store) -> Iterator[Row]:
    """All identities of the list, if it is here, else those of this computer."""
    from armadico.keys.checking import Checks
    from armadico.keys.members import kind_of

    store.check()
    here = {identity.name: identity for identity in store.identities()}
    listed = store.members() if (store.folder / MEMBERS).exists() else {}
    checks = Checks(store, now())
    for name in sorted(here.keys() | listed.keys()):
        identity = here.get(name)
        user = "" if identity is None else _user(identity)
        faults = () if identity is None else (*checks.of(identity), checks.expiring(identity))
        fault = next(filter(None, faults), "")
        member = listed.get(name) or Member(name, kind_of(name))
        known = {user_of(name, issue.number): issue for issue in member.issues}
        if user and user not in known:  # there is no list here, or it has no such issue
            known[user] = Issue(0)
        for each, issue in known.items():
            mine = identity if each == user else None
            state = fault if mine is not None else "" if issue.given or not listed else "not made"
            yield Row(each, member.kind, issue.holders, _ends(mine), state, issue.revoked)


def _user(identity: Identity) -> str:
    try:
        return user_in(identity.certificate.read_bytes())
    except (OSError, ValueError):
        return identity.name


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
    "List the keys of this computer, with the time, UTC, until which each certificate is valid; on"
    " the authority's computer and on the robot's, all keys, and which computer or archive has"
    " each. `goto@1` is a second key of goto.",
    EXAMPLES,
)
