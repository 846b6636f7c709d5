"""Revoke identities, or what a computer or a person was given."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, flag, group
from armadico.core.errors import UnknownNameError
from armadico.keys.commands.common import AUTHORITY, Society, now
from armadico.keys.store import MEMBERS, Issue, Member, user_of
from armadico.mesh.door import CLIENT, PERSON, ROBOT

if TYPE_CHECKING:
    from armadico.config.endpoints import Endpoints

EXAMPLES: Final = """\
  armadico keys revoke person-anna     anna's key on each computer, and all that her archive holds
  armadico keys revoke lab2            everything that the computer lab2 was given
  armadico keys revoke goto            goto's keys on all computers
  armadico keys revoke goto@1          one of them (`armadico keys list`)
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument(
        "hosts, persons, identities, or single keys", nargs="+", metavar="NAME"
    )
    yes: bool = flag("also revoke what other computers have, too, and were not named")
    society: Society = group(Society, "the society")


@dataclass(frozen=True)
class Key:
    """A key that is to be revoked: its user name, its identity and its issue."""

    user: str
    member: Member
    issue: Issue

    @property
    def last(self) -> str:
        return self.member.name.rpartition("/")[2]

    def is_of(self, names: Collection[str]) -> bool:
        """Return whether full names have its identity, or this key with its number."""
        return self.member.name in names or f"{self.member.name}@{self.issue.number}" in names

    @property
    def losers(self) -> list[str]:
        """Its holders that have no newer key of the identity."""
        given = [each for each in self.member.users.values() if each.given]
        newer = {each.holders for each in given if each is not self.issue}
        return [each for each in self.issue.holders if (each,) not in newer]


def run(args: Options) -> int:
    from armadico.keys.issuing import Issuer

    issuer = Issuer.of(args.society.store)
    where = args.society.where
    members, namespace = issuer.store.members(), where.namespace
    chosen: dict[str, Key] = {}
    before: list[Key] = []
    for name in args.names:
        meant = _meant(name, namespace, members)
        valid = {key.user: key for key in meant if not key.issue.revoked}
        chosen |= valid
        before += () if valid else meant
    if any(key.member.kind == ROBOT for key in chosen.values()):
        # Without a new authority the other computers would go on trusting it.
        raise UsageError(
            "the robot's key cannot be revoked: if it was stolen, `armadico keys init --anew` makes"
            " a new authority, and then `armadico keys host` new archives for all computers"
        )
    named = {full for name in args.names for full in (name, f"{namespace}/{name}")}
    others = set[str]()
    ends: dict[str, list[Key]] = {}
    for key in chosen.values():
        for holder in key.losers:
            ends.setdefault(holder, []).append(key)
            if holder not in args.names and not key.is_of(named):
                others.add(holder)
    for holder, keys in sorted(ends.items()):
        lost = ", ".join(sorted(key.last for key in keys))
        print(f"{holder} loses {lost}; new keys for it: {_anew(holder, keys, where)}")
    if others and not args.yes:
        raise UsageError(
            f"nothing was revoked: processes on {', '.join(sorted(others))} would end, too. Make"
            " new keys for them first, by the commands above, as they have the same keys; or add"
            " --yes"
        )
    for user in issuer.revoke(chosen, now()):
        print(f"{user} is revoked")
    for key in before:
        print(f"{key.user} was revoked before, {key.issue.revoked}")
    print(f"the robot refuses it once its computer has this list: {issuer.store.folder / MEMBERS}")
    robots = {
        each for m in members.values() if m.kind == ROBOT for i in m.issues for each in i.holders
    }
    for key in chosen.values():
        for holder in {*key.issue.holders} - {*args.names, key.last}:
            if key.member.kind == "person":
                verb = "init --anew" if holder in robots else f"revoke {holder}"
                print(
                    f"{key.last} had a key on {holder}, whose other keys stay valid, such as the"
                    f" page's: `armadico keys {verb}` ends them, too"
                )
    return 0


def _meant(name: str, namespace: str, members: Mapping[str, Member]) -> list[Key]:
    """The keys of a name: an identity's and its archive's, a host's, or one key.

    Raises UnknownNameError if there are none.
    """
    full, found = {name, f"{namespace}/{name}"}, list[Key]()
    known = set[str]()
    for member in members.values():
        known |= {member.name}
        for issue in member.issues:
            known |= {*issue.holders}
            key = Key(user_of(member.name, issue.number), member, issue)
            if key.is_of(full) or name.rpartition("/")[2] in issue.holders:
                found.append(key)
    if not found:
        raise UnknownNameError("identity or host with keys", name, known)
    return found


def _anew(holder: str, keys: Sequence[Key], where: Endpoints) -> str:
    """The commands that make new keys for a holder that loses some."""
    from armadico.keys.members import of_host

    for kind, verb in ((PERSON, "person"), (CLIENT, "client")):
        if holder.startswith(kind):
            return f"`armadico keys {verb} {holder.removeprefix(kind)} --out FILE`"
    agents = {key.last for key in keys if key.member.kind == "agent"}
    if holder in agents:  # the archive of `armadico keys agent`
        return f"`armadico keys agent {holder.replace('+', ' ')} --out FILE`"
    made = set[str]()
    if where.table is not None and holder in where.table.hosts:
        made = {each.name for each in of_host(where.table, holder, where.namespace, ())}
        agents = {key.last for key in keys if key.last in agents and key.member.name not in made}
    own = (
        [f"armadico keys agent {name.replace('+', ' ')}" for name in sorted(agents)] if made else []
    )
    persons = [key.last.removeprefix(PERSON) for key in keys if key.member.kind == "person"]
    verb = "init" if holder == AUTHORITY else f"host {holder}"
    if persons or len(own) < len(keys):
        own.insert(
            0,
            " ".join([f"armadico keys {verb}", *(f"--person {user}" for user in sorted(persons))]),
        )
    return ", ".join(f"`{command}`" for command in own)


COMMAND: Final = Command(
    "armadico keys revoke",
    Options,
    run,
    "Revoke keys: the robot accepts no new link with them, closes those that exist, and renews no"
    " certificate. Each computer and each archive has keys of its own, so the others drive on. It"
    " prints what ends, and asks for --yes if other computers have the same keys.",
    EXAMPLES,
)
