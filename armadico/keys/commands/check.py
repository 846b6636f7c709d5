"""Check the keys of this computer."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import FAILED, shown
from armadico.cli.parsing import Command, flag, group
from armadico.keys.commands.common import Society, now
from armadico.keys.store import Store

EXAMPLES: Final = """\
  armadico keys check --hosts lab.toml
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    json: bool = flag("print a JSON array of sentences")
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    """Print what is wrong; the exit code is 1 if something is."""
    from armadico.keys.checking import Checks

    store = args.society.store
    checks = Checks(store, now())
    faults = [*dict.fromkeys((*checks.everything(), *_missing(args.society, store)))]
    soon = [line for each in store.identities() if (line := checks.expiring(each))]
    if args.json:
        print(json.dumps(faults + soon, indent=2))
        return FAILED if faults else 0
    for line in faults:
        print(shown(f"wrong: {line}"))
    for line in soon:
        print(shown(f"soon: {line}"))
    if not faults:
        print(f"{store.folder}: {len([*store.identities()])} keys, nothing is wrong")
    return FAILED if faults else 0


def _missing(society: Society, store: Store) -> Iterator[str]:
    """The identities of this host that have no key here."""
    from armadico.keys.members import of_host

    where = society.where
    if where.table is None or where.name is None:
        return
    lacking = [
        member.name
        for member in of_host(where.table, where.name, where.namespace, ())
        if not store.of(member.name).certificate.is_file()
    ]
    if lacking:
        yield (
            f"{store.folder} has no key of {', '.join(lacking)}: `armadico keys host {where.name}`"
            " on the computer of the authority makes it"
        )


COMMAND: Final = Command(
    "armadico keys check",
    Options,
    run,
    "Check the keys of this computer: that no other user can read them, that each certificate is"
    " valid now, of the authority, and fits its private key, and that none of this host is missing."
    " The exit code is 1 if something is wrong.",
    EXAMPLES,
)
