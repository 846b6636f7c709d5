"""Check the keys of this computer."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import FAILED, UNKNOWN, shown
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
    """Print what is wrong; the exit code is 1 if something is, 3 if something is not known."""
    from armadico.keys.checking import Checks

    store = args.society.store
    checks = Checks(store, now())
    faults = [*dict.fromkeys((*checks.everything(), *_missing(args.society, store)))]
    soon = [line for each in store.identities() if (line := checks.expiring(each))]
    unknown = [*_unknown(args.society, store)]
    if args.json:
        print(json.dumps(faults + unknown + soon, indent=2))
    else:
        for verdict, lines in (("wrong", faults), ("unknown", unknown), ("soon", soon)):
            for line in lines:
                print(shown(f"{verdict}: {line}"))
        if not faults and not unknown:
            print(f"{store.folder}: {len([*store.identities()])} keys, nothing is wrong")
    return FAILED if faults else UNKNOWN if unknown else 0


def _unknown(society: Society, store: Store) -> Iterator[str]:
    """That what is missing here is not known."""
    if society.where.name is None and not store.issues:
        yield (
            f"which keys {store.folder} needs is not known, as this computer is no host of the"
            " table: --host NAME says which one it is"
        )


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
    " The exit code is 1 if something is wrong, and 3 if nothing is wrong and which keys this"
    " computer needs is not known, as it is no host of the table.",
    EXAMPLES,
)
