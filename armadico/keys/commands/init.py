"""Make the authority of a lab, and the keys of this computer."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import FailedError
from armadico.cli.parsing import Command, flag, group, several
from armadico.keys.commands.common import Society, given_out, hours_option, issuer_of, now

EXAMPLES: Final = """\
  armadico keys init --hosts lab.toml
  armadico keys init --hosts lab.toml --namespace lab/r2    a second robot of the same authority
  armadico keys init --hosts lab.toml --anew                replace the authority: all keys are void
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    anew: bool = flag("replace an authority that is there; the keys of all computers become void")
    person: tuple[str, ...] = several(
        "make a key for this person; may be repeated (default: the user of this command)",
        metavar="USER",
    )
    hours: float = hours_option()
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    from armadico.keys.authority import create
    from armadico.keys.members import for_person, of_host
    from armadico.mesh.topology import checked_namespace

    table, store, where = args.society.table, args.society.store, args.society.where
    namespace = checked_namespace(args.society.namespace)
    before = set[str]()
    if args.anew or not store.authority.exists():
        pair = create(socket.gethostname(), now())
        store.begin(pair.certificate, pair.private)
    elif not store.issues:
        raise FailedError(
            f"{store.folder} has keys of an authority of another computer; `armadico keys host`"
            " there makes new ones, and --anew here another authority"
        )
    else:
        before = {identity.name for identity in store.identities()}
        print(
            f"{store.folder}: the authority exists already and was left alone, so keys of other"
            " computers stay valid; --anew replaces it"
        )
    users = args.society.users(args.person)
    issuer = issuer_of(args.society, args.hours)
    if where.name is None:  # it only issues, and its users command
        members = tuple(member for user in users for member in for_person(namespace, user))
    else:
        members = of_host(table, where.name, namespace, users)
    given = {member.name for member in given_out(issuer, members, "", None, args.society)}
    if before:
        print(
            f"of the {len(before)} keys that existed here, {len(before & given)} were made anew and"
            f" {len(before - given)} left alone"
        )
    here = "no host" if where.name is None else f"the host {where.name}"
    print(f"this computer is {here} of {table.file}")
    for name in (name for name in table.hosts if name != where.name):
        print(f"next: armadico keys host {name} --hosts {table.file}")
    return 0


COMMAND: Final = Command(
    "armadico keys init",
    Options,
    run,
    "Make the authority of a lab, and the keys of this computer. The folder is the one that the"
    ' host table names by keys = "FOLDER". Only the computer with the authority\'s key can make'
    " keys for others, and if it is the robot's, certificates are renewed without a person.",
    EXAMPLES,
)
