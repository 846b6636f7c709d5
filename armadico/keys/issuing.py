"""Issuing on the computer that has the authority's key: identities into folders and archives."""

from __future__ import annotations

import os
import tarfile
from collections.abc import Iterable, Mapping, Sequence
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
    issue,
    public_of,
)
from armadico.keys.derived import derive_again, file_of, load, save
from armadico.keys.store import Identity, Member, Store, check_private
from armadico.mesh.door import ROBOT

HERE = ("localhost", "127.0.0.1", "::1")
"""Addresses of a robot's certificate besides those of the table."""


@dataclass(frozen=True)
class Issuer:
    """What issues identities.

    Attributes:
        store: The folder with the authority's key.
        pair: The authority.
        hours: How long a client's certificate is valid.
    """

    store: Store
    pair: Pair
    hours: float = CLIENT_HOURS

    @staticmethod
    def of(found: Store, hours: float = CLIENT_HOURS) -> Issuer:
        """The authority of a folder. Raises ConfigError if its key is not there."""
        if not found.issues:
            raise ConfigError(
                f"{found.authority_key} is missing: run this on the computer on which `armadico"
                " keys init` was run, or make an authority here with `armadico keys init`"
            )
        found.check()
        check_private(found.authority_key)
        pair = Pair(found.authority.read_bytes(), found.authority_key.read_bytes())
        return Issuer(found, pair, hours)

    def list_all(self, members: Mapping[str, Member]) -> None:
        """List identities, also those that are issued later, as the router admits listed ones."""
        listed = self.store.members()
        now = {name: _listed(member, listed.get(name)) for name, member in members.items()}
        self._list(listed, listed | now)

    def give(
        self,
        members: Iterable[Member],
        into: Store,
        now: datetime,
        *,
        addresses: Iterable[str] = (),
    ) -> tuple[Member, ...]:
        """Issue identities into a folder, and list them; returns them as they are listed.

        Args:
            members: The identities; one that is listed keeps its number, and a revoked one gets
                the next number.
            into: The folder, which may be the authority's.
            now: The time, with a zone.
            addresses: The addresses of the robot's router.

        Raises ConfigError for a name that no certificate can have.
        """
        listed = self.store.members()
        given = tuple(_again(member, listed.get(member.name)) for member in members)
        known = tuple(addresses)
        pairs = [self._issue(member, now, known) for member in given]
        self._list(listed, listed | {member.name: member for member in given})
        for member, pair in zip(given, pairs, strict=True):
            into.save(member, pair.certificate, pair.private, self.store.password(member))
        if into.folder != self.store.folder:
            into.copy(self.store, robots=any(map(_server, given)))
            for namespace in {member.namespace for member in given}:
                save(into, namespace, load(self.store, namespace))
        return given

    def _list(self, before: Mapping[str, Member], now: Mapping[str, Member]) -> None:
        """List the members, and derive the rights of namespaces with other agents."""
        self.store.save_members(now)
        for namespace in sorted({member.namespace for member in now.values()}):
            other = _agents(before, namespace) != _agents(now, namespace)
            if other or not file_of(self.store, namespace).exists():
                derive_again(self.store, namespace)

    def renew(
        self, identities: Iterable[Identity], now: datetime, *, addresses: Iterable[str] = ()
    ) -> tuple[list[str], list[str]]:
        """Write new certificates for the private keys of a computer.

        Returns the names, and a sentence for each that cannot be renewed.
        """
        known = tuple(addresses)
        renewed: list[str] = []
        refused: list[str] = []
        for identity in identities:
            try:
                member = self._renewable(identity.name)
                public = public_of(identity.private.read_bytes())
            except ConfigError as error:
                refused.append(str(error))
            except KeyFileError as error:
                refused.append(f"{identity.private} {error}: `armadico keys host` makes a new one")
            else:
                pair = self._issue(member, now, known, public)
                self.store.save(member, pair.certificate, b"", self.store.password(member))
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
        member = self._renewable(about.name)
        if _server(member):
            raise ConfigError(f"{about.name} is the robot's: `armadico keys renew` renews it")
        hours = (about.ends - about.begins - BEFORE) / timedelta(hours=1)
        key = certificate_key(certificate)
        return replace(self, hours=hours)._issue(member, now, (), key).certificate

    def _renewable(self, name: str) -> Member:
        """A listed identity that is not revoked. Raises ConfigError."""
        member = self.store.members().get(name)
        if member is None:
            raise ConfigError(f"{name} is not in the list of identities")
        if member.revoked:
            raise ConfigError(
                f"{name} was revoked {member.revoked}: `armadico keys host`, `agent` or `person`"
                " makes a new key"
            )
        return member

    def revoke(self, names: Iterable[str], now: datetime) -> list[str]:
        """Revoke identities in the list; returns those that were not revoked before."""
        listed = self.store.members()
        new = {
            name: replace(listed[name], revoked=now.isoformat(timespec="seconds"))
            for name in names
            if not listed[name].revoked
        }
        self.store.save_members(listed | new)
        return list(new)

    def _issue(
        self,
        member: Member,
        now: datetime,
        addresses: Sequence[str],
        public: Ed25519PublicKey | None = None,
    ) -> Pair:
        server = _server(member)
        try:
            return issue(
                self.pair,
                member.name,
                now,
                hours=24.0 * ROUTER_DAYS if server else self.hours,
                addresses=tuple(dict.fromkeys((*addresses, *HERE))) if server else (),
                public=public,
            )
        except KeyFileError as error:
            raise ConfigError(str(error)) from None


def _server(member: Member) -> bool:
    """Whether a member's process listens."""
    return member.kind == ROBOT


def _listed(member: Member, before: Member | None) -> Member:
    """An identity as it is listed, whether it has been issued or not."""
    return member if before is None else replace(before, hosts=_both(before.hosts, member.hosts))


def _both(one: Sequence[str], other: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*one, *other)))


def _agents(members: Mapping[str, Member], namespace: str) -> dict[str, tuple[str, ...]]:
    return {name: m.agents for name, m in members.items() if m.namespace == namespace}


def _again(member: Member, before: Member | None) -> Member:
    """An identity as it is listed once it is issued."""
    if before is None:
        return member
    issued = before.issue + 1 if before.revoked else before.issue
    return replace(member, issue=issued, hosts=_both(before.hosts, member.hosts))


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
