"""Revoke identities, or what a computer or a person was given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, flag, group
from armadico.core.errors import UnknownNameError
from armadico.keys.commands.common import AUTHORITY, Society, now
from armadico.keys.store import MEMBERS, Issue, Member
from armadico.mesh.door import PERSON, ROBOT

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
    yes: bool = flag("also stop processes on computers that are not named")
    society: Society = group(Society, "the society")


@dataclass(frozen=True)
class Key:
    """A key that is to be revoked: its user name, its identity and its issue."""

    user: str
    member: Member
    issue: Issue
    alone: bool  # it was named by its number

    @property
    def last(self) -> str:
        return self.member.name.rpartition("/")[2]

    @property
    def losers(self) -> list[str]:
        """Its holders that have no newer key of the identity."""
        given = [each for each in self.member.users.values() if each.given]
        newer = {each.holders for each in given if each is not self.issue}
        return [each for each in self.issue.holders if (each,) not in newer]


def run(args: Options) -> int:
    from armadico.keys.issuing import Issuer

    issuer = Issuer.of(args.society.store)
    members, namespace = issuer.store.members(), args.society.where.namespace
    chosen = {key.user: key for n in args.names for key in _meant(n, namespace, members)}
    if any(key.member.kind == ROBOT for key in chosen.values()):
        # Without a new authority the other computers would go on trusting it.
        raise UsageError(
            "the robot's key cannot be revoked: if it was stolen, `armadico keys init --anew` makes"
            " a new authority, and then `armadico keys host` new archives for all computers"
        )
    others = set[str]()
    ends: dict[str, list[str]] = {}
    for key in chosen.values():
        for holder in key.losers:
            ends.setdefault(holder, []).append(key.last)
            if holder not in args.names and key.member.kind != "person" and not key.alone:
                others.add(holder)
    for holder, names in sorted(ends.items()):
        print(f"{holder} loses {', '.join(sorted(names))}; new keys for it: {_anew(holder)}")
    if others and not args.yes:
        raise UsageError(
            f"nothing was revoked: processes on {', '.join(sorted(others))} would end, too. Make"
            " new keys for them first, if these had the same keys as what is revoked; or add --yes;"
            " or revoke one key by its number (`armadico keys list`)"
        )
    for user in issuer.revoke(chosen, now()):
        print(f"{user} is revoked")
    print(f"the robot refuses it once its computer has this list: {issuer.store.folder / MEMBERS}")
    for key in chosen.values():
        for holder in {*key.issue.holders} - {*args.names, key.last}:
            if key.member.kind == "person":
                print(
                    f"{key.last} had a key on {holder}, whose other keys stay valid, such as the"
                    f" page's: `armadico keys revoke {holder}` revokes them, too"
                )
    return 0


def _meant(name: str, namespace: str, members: Mapping[str, Member]) -> list[Key]:
    """The keys of a name that count: an identity's and its archive's, a host's, or one key."""
    full, found = {name, f"{namespace}/{name}"}, list[Key]()
    known = set[str]()
    for member in members.values():
        known |= {member.name}
        for user, issue in member.users.items():
            known |= {*issue.holders}
            alone = f"{member.name}@{issue.number}" in full
            if alone or member.name in full or name.rpartition("/")[2] in issue.holders:
                found.append(Key(user, member, issue, alone))
    if not found:
        raise UnknownNameError("identity or host with keys that count", name, known)
    return found


def _anew(holder: str) -> str:
    """The command that makes new keys for a holder."""
    if holder == AUTHORITY:
        return "`armadico keys init`"
    if holder.startswith(PERSON):
        return f"`armadico keys person {holder.removeprefix(PERSON)} --out FILE`"
    return f"`armadico keys host {holder}`"


COMMAND: Final = Command(
    "armadico keys revoke",
    Options,
    run,
    "Revoke keys: the robot accepts no new link with them, closes those that exist, and renews no"
    " certificate. Each computer and each archive has keys of its own, so the others drive on. It"
    " prints what ends, and asks for --yes if that is on a computer that is not named.",
    EXAMPLES,
)
