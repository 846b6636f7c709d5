"""Revoke identities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, group
from armadico.core.errors import UnknownNameError
from armadico.keys.commands.common import Society, now
from armadico.keys.store import MEMBERS, Member

EXAMPLES: Final = """\
  armadico keys revoke person-anna
  armadico keys revoke goto
  armadico keys revoke lab2          everything that the computer lab2 was given
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument("identities, or hosts", nargs="+", metavar="NAME")
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    from armadico.keys.issuing import Issuer

    issuer = Issuer.of(args.society.store)
    members, namespace = issuer.store.members(), args.society.where.namespace
    chosen = [m for name in args.names for m in _meant(name, namespace, members)]
    if any(member.kind == "robot" for member in chosen):
        # The other computers have no list of who is revoked, so they would go on trusting it.
        raise UsageError(
            "the robot's key cannot be revoked: if it was stolen, `armadico keys init --anew` makes"
            " a new authority, and new archives for all computers"
        )
    revoked = issuer.revoke([member.name for member in chosen], now())
    for name in revoked:
        print(f"{name} is revoked")
    others = sorted({host for member in chosen for host in member.hosts} - {*args.names})
    file = issuer.store.folder / MEMBERS
    print(f"the robot refuses them once its computer has this list: {file}")
    for host in others:
        print(f"{host} had some of them, too; new ones for it: armadico keys host {host}")
    return 0


def _meant(name: str, namespace: str, members: dict[str, Member]) -> list[Member]:
    """The identities of a name: an identity's, with or without its namespace, or a host's."""
    for full in (name, f"{namespace}/{name}"):
        if full in members:
            return [members[full]]
    found = [member for member in members.values() if name in member.hosts]
    if not found:
        hosts = {host for member in members.values() for host in member.hosts}
        raise UnknownNameError("identity or host", name, sorted({*members, *hosts}))
    return found


COMMAND: Final = Command(
    "armadico keys revoke",
    Options,
    run,
    "Revoke identities: their passwords are void, so the robot accepts no new link of theirs, and"
    " gives none of its rights. `keys host`, `agent` or `person` makes a new key of the same name.",
    EXAMPLES,
)
