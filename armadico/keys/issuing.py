"""Issuing on the computer that has the authority's key: identities into folders and archives."""

from __future__ import annotations

import os
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from armadico.core.config_errors import ConfigError
from armadico.keys.authority import (
    BEFORE,
    CLIENT_HOURS,
    ROUTER_DAYS,
    KeyFileError,
    Pair,
    certificate_key,
    facts,
    is_issued_by,
    is_pair,
    issue,
    public_of,
)
from armadico.keys.derived import derive, file_of, load, save
from armadico.keys.store import (
    ANEW,
    Identity,
    Member,
    Store,
    check_private,
    name_in,
    why_void,
)
from armadico.mesh.door import ROBOT

HERE = ("localhost", "127.0.0.1", "::1")
"""Addresses of a robot's certificate besides those of the table."""


@dataclass(frozen=True)
class Issuer:
    """What issues identities."""

    store: Store  # the folder with the authority's key
    pair: Pair  # the authority
    hours: float = CLIENT_HOURS  # how long a client's certificate is valid

    @staticmethod
    def of(found: Store, hours: float = CLIENT_HOURS) -> Issuer:
        """The authority of a folder. Raises ConfigError if its key is not there, or another's."""
        if not found.issues:
            raise ConfigError(
                f"{found.authority_key} is missing: run this on the computer on which `armadico"
                " keys init` was run, or make an authority here with `armadico keys init`"
            )
        found.check()
        check_private(found.authority_key)
        pair = Pair(found.authority.read_bytes(), found.authority_key.read_bytes())
        try:
            why = "" if is_pair(pair.certificate, pair.private) else "do not belong together"
        except KeyFileError:
            why = "cannot both be read"
        if why:
            raise ConfigError(
                f"{found.authority} and {found.authority_key} {why}: restore both from a copy, or"
                " make another authority with `armadico keys init --anew`"
            )
        return Issuer(found, pair, hours)

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """`Store.changing`, unless another command has made a new authority. Raises ConfigError."""
        with self.store.changing():
            if self.store.authority.read_bytes() != self.pair.certificate:
                raise ConfigError(
                    f"another command has replaced {self.store.authority} meanwhile; run this again"
                )
            yield

    def list_all(self, members: Mapping[str, Iterable[Member]]) -> None:
        """List the identities of holders, also those that are issued later.

        The router admits listed ones, so it need not open its session anew then.
        """
        with self._changing():
            listed = self.store.members()
            now = dict(listed)
            for holder, of_holder in members.items():
                now |= {each.name: _listed(each, now, holder) for each in of_holder}
            self._list(listed, now)

    def give(
        self,
        members: Iterable[Member],
        holder: str,
        into: Store,
        now: datetime,
        *,
        addresses: Iterable[str] = (),
    ) -> tuple[Member, ...]:
        """Issue identities into a folder, and list them; returns them as they are listed.

        Args:
            members: The identities. An issue of the holder's keeps its number; if there is none,
                or it was revoked, it gets the next number.
            holder: What gets the keys (`Issue.holders`).
            into: The folder, which may be the authority's.
            now: The time, with a zone.
            addresses: The addresses of the robot's router.

        Raises ConfigError for a name that no certificate can have.
        """
        known = tuple(addresses)
        with self._changing():
            listed = self.store.members()
            given = {member.name: _listed(member, listed, holder) for member in members}
            users = {name: member.user(holder) for name, member in given.items()}
            for name, member in given.items():
                made = replace(member.users[users[name]], given=_written(now))
                given[name] = member.with_issue(made)
            pairs = [self._issue(users[name], _server(given[name]), now, known) for name in given]
            self._list(listed, listed | given)
            for member, pair in zip(given.values(), pairs, strict=True):
                password = self.store.password(users[member.name])
                into.save(member, pair.certificate, pair.private, password)
        if into.folder != self.store.folder:
            into.copy(self.store, robots=any(map(_server, given.values())))
            for namespace in {member.namespace for member in given.values()}:
                save(into, namespace, load(self.store, namespace))
        return tuple(given.values())

    def _list(self, before: Mapping[str, Member], now: Mapping[str, Member]) -> None:
        """List the members, and derive the rights of namespaces with other agents.

        The rights are written first: after an interruption the list still lacks the agents, so the
        next command derives them again.
        """
        for namespace in sorted({member.namespace for member in now.values()}):
            other = _agents(before, namespace) != _agents(now, namespace)
            if other or not file_of(self.store, namespace).exists():
                save(self.store, namespace, derive(now.values(), namespace))
        self.store.save_members(now)

    def renew(
        self, identities: Iterable[Identity], now: datetime, *, addresses: Iterable[str] = ()
    ) -> tuple[list[str], list[str]]:
        """Write new certificates for the private keys of a computer.

        The password tells which issue a key is of. Returns the names, and a sentence for each that
        cannot be renewed.
        """
        known = tuple(addresses)
        renewed: list[str] = []
        refused: list[str] = []
        with self._changing():
            listed = self.store.members()
            for identity in identities:
                try:
                    user = self._renewable(identity, listed)
                    public = public_of(identity.private.read_bytes())
                except (ConfigError, OSError) as error:
                    refused.append(str(error))
                except KeyFileError as error:
                    refused.append(f"{identity.private} {error}: {ANEW}")
                else:
                    member = listed[identity.name]
                    pair = self._issue(user, _server(member), now, known, public)
                    self.store.save(member, pair.certificate, b"", self.store.password(user))
                    renewed.append(identity.name)
        return renewed, refused

    def again(self, certificate: bytes, now: datetime) -> bytes:
        """Return a new certificate, PEM, of the same name and key as a client's present one.

        It lives as long as the present one, which may have expired. Raises ConfigError or
        KeyFileError if there is none.
        """
        about = facts(certificate)
        if not is_issued_by(certificate, self.pair.certificate):
            raise ConfigError(f"the certificate of {about.name} is of another authority")
        members = self.store.members()
        if why := why_void(about.name, members):
            raise ConfigError(why)
        if _server(members[name_in(about.name)]):
            raise ConfigError(f"{about.name} is the robot's: `armadico keys renew` renews it")
        hours = (about.ends - about.begins - BEFORE) / timedelta(hours=1)
        key = certificate_key(certificate)
        return replace(self, hours=hours)._issue(about.name, False, now, (), key).certificate

    def _renewable(self, identity: Identity, members: Mapping[str, Member]) -> str:
        """Return the user name of keys that count. Raises ConfigError, KeyFileError or OSError.

        The password tells it: certificates of older folders have no number.
        """
        member = members.get(identity.name, Member(identity.name, ""))
        user = self.store.user_with(identity.read_password(), member)
        if not user:
            said = facts(identity.certificate.read_bytes()).name
            why = why_void(said, members)
            raise ConfigError(why or f"{identity.password} is not the password of {said}: {ANEW}")
        return user

    def revoke(self, users: Iterable[str], now: datetime) -> list[str]:
        """Revoke issues by their user names; returns those that were not revoked before."""
        with self._changing():
            listed = self.store.members()
            new: list[str] = []
            for user in users:
                member = listed[name_in(user)]
                if user in member.users:
                    gone = replace(member.users[user], revoked=_written(now))
                    listed[member.name] = member.with_issue(gone)
                    new.append(user)
            self.store.save_members(listed)
        return new

    def _issue(
        self,
        user: str,
        server: bool,
        now: datetime,
        addresses: Sequence[str],
        public: Ed25519PublicKey | None = None,
    ) -> Pair:
        try:
            return issue(
                self.pair,
                user,
                now,
                hours=24.0 * ROUTER_DAYS if server else self.hours,
                addresses=tuple(dict.fromkeys((*addresses, *HERE))) if server else (),
                public=public,
            )
        except KeyFileError as error:
            raise ConfigError(str(error)) from None


def _written(t: datetime) -> str:
    return t.isoformat(timespec="seconds")


def _server(member: Member) -> bool:
    """Whether a member's process listens."""
    return member.kind == ROBOT


def _listed(member: Member, listed: Mapping[str, Member], holder: str) -> Member:
    """An identity as it is listed once a holder has keys of it."""
    before = listed.get(member.name, member)
    return replace(member, issues=before.issues).held(holder)


def _agents(members: Mapping[str, Member], namespace: str) -> dict[str, tuple[str, ...]]:
    return {name: m.agents for name, m in members.items() if m.namespace == namespace}


def archive(folder: Path, name: str, file: Path) -> None:
    """Write a folder of keys as a tar archive, below `name`; only this user can read it."""
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.fchmod(descriptor, 0o600)  # it may have existed
    with (
        open(descriptor, "wb") as raw,  # noqa: PTH123 - a path has no mode
        tarfile.open(fileobj=raw, mode="w") as tar,
    ):
        tar.add(folder, name, filter=_anybody)


def _anybody(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """An entry that belongs to the user who unpacks it."""
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    return entry
