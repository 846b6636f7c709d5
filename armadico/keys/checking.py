"""What is wrong with the keys of a computer: which file, since when, and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

from armadico.core.config_errors import ConfigError
from armadico.keys.authority import Facts, KeyFileError, facts, is_issued_by, is_pair
from armadico.keys.expiry import shown, user_in
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

SOON: Final = timedelta(hours=1)
"""A certificate that expires within so long is announced."""

CLOCK_OFF: Final = timedelta(days=30)
"""By so much no certificate of a client is late: then the clock is a likely cause, too."""


class Checks:
    """The checks of one folder of keys, at one time."""

    def __init__(self, store: Store, now: datetime) -> None:
        self._store, self._now = store, now

    def everything(self) -> Iterator[str]:
        """What is wrong with the folder and each identity in it."""
        found = False
        try:
            self._store.check()
            if self._store.issues:
                from armadico.keys.issuing import Issuer  # imports all agents

                Issuer.of(self._store)
        except ConfigError as error:
            yield str(error)
        listed: Mapping[str, Member] = {}
        try:
            listed = self._store.members_here()
        except ConfigError as error:
            yield str(error)
        for identity in self._store.identities():
            found = True
            yield from self.of(identity)
            if listed:
                yield from self._revoked(identity, listed)
        if not found:
            verb = "init" if self._store.issues else "host"
            yield f"{self._store.folder} has no identity: `armadico keys {verb}` makes them"
        yield from self._rights(listed)

    def _rights(self, listed: Mapping[str, Member]) -> Iterator[str]:
        """How the tables of rights differ from the classes, where the list of identities is."""
        from armadico.keys import derived  # imports all agents

        for namespace in sorted({member.namespace for member in listed.values()}):
            try:
                stored = derived.load(self._store, namespace)
                now = derived.derive(listed.values(), namespace)
            except ConfigError as error:
                yield str(error)
                continue
            found = derived.contradictions(stored, now)
            yield from derived.named(self._store, namespace, found)
            for agent in now.silent:
                yield (
                    f"the class of agent {agent} declares nothing, so it may do only what every"
                    " agent may: add `provides`, `receives` or `competes_for`"
                )

    def _revoked(self, identity: Identity, listed: Mapping[str, Member]) -> Iterator[str]:
        """Whether an identity of this computer is void, where the list of identities is."""
        member = listed.get(identity.name, Member(identity.name, ""))
        try:
            user = self._store.user_with(identity.read_password(), member)
            said = facts(identity.certificate.read_bytes()).name
        except ConfigError as error:
            yield str(error)
            return
        except (OSError, KeyFileError):
            return  # `of` names it
        if user == said:
            return
        if user:  # of a folder of before issues had numbers
            yield f"{identity.certificate} does not tell its issue: {self._remedy()}"
            return
        why = why_void(said, listed)
        yield f"{identity.folder}: {why or f'its password is not that of {said}: {ANEW}'}"

    def of(self, identity: Identity) -> Iterator[str]:
        """What is wrong with an identity, for a link from another computer."""
        yield from self._private(identity)
        try:
            authority = self._store.authority.read_bytes()
            certificate, private = identity.certificate.read_bytes(), identity.private.read_bytes()
        except OSError as error:
            yield f"{error.filename} cannot be read: {error.strerror}"
            return
        file = self._store.authority
        try:
            todo = "restore it from an archive of keys, or `armadico keys init --anew`"
            yield from self._times(file, facts(authority), "`armadico keys init --anew`")
            file, todo = identity.certificate, self._remedy()
            about = facts(certificate)
            yield from self._times(file, about, self._remedy())
            if name_in(about.name) != identity.name:
                named = about.name or "no single name"
                yield f"{file} is of {named}, not of {identity.name}: {self._remedy()}"
            if not is_issued_by(certificate, authority):
                yield f"{file} is not of the authority in {self._store.authority}: {self._remedy()}"
            file, todo = identity.private, ANEW
            if not is_pair(certificate, private):
                yield f"{file} is not the key of its certificate: {self._remedy()}"
        except KeyFileError as error:
            yield f"{file} {error}: {todo}"

    def on_socket(self, identity: Identity) -> Iterator[str]:
        """What is wrong with an identity, for a link by the socket on the robot's computer."""
        yield from self._private(identity)
        users = self._store.identity(identity.namespace, ROBOT).users
        try:
            known = users.read_text(encoding="utf-8").splitlines()
            user = user_in(identity.certificate.read_bytes())
            line = f"{user}:{identity.read_password()}"
        except (OSError, ValueError):
            return
        if line not in known:
            yield (
                "the robot agent does not know this key: it was revoked, or issued after the robot"
                " agent started (`armadico keys check`)"
            )

    def expiring(self, identity: Identity) -> str:
        """When a certificate expires, if that is soon; "" otherwise."""
        try:
            about = facts(identity.certificate.read_bytes())
        except (OSError, KeyFileError):
            return ""
        if not timedelta() < about.ends - self._now <= SOON:
            return ""
        left = _span(about.ends - self._now)
        return f"{identity.certificate} expires in {left}: {self._remedy()}"

    def _private(self, identity: Identity) -> Iterator[str]:
        for file in (identity.private, identity.password):
            try:
                check_private(file)
            except ConfigError as error:
                yield str(error)

    def _times(self, file: Path, about: Facts, todo: str) -> Iterator[str]:
        clock = f"this computer's clock says {shown(self._now.timestamp())}"
        if self._now < about.begins:
            ahead = _span(about.begins - self._now)
            yield (
                f"{file} is not valid before {shown(about.begins.timestamp())}, in {ahead};"
                f" {clock}: set the clock, or {todo}"
            )
        if self._now > about.ends:
            ago = self._now - about.ends
            doubt = f"; {clock}: set it, if it is wrong, or" if ago > CLOCK_OFF else ":"
            yield f"{file} expired {shown(about.ends.timestamp())}, {_span(ago)} ago{doubt} {todo}"

    def _remedy(self) -> str:
        if self._store.issues:
            return "`armadico keys renew` makes a new one"
        return (
            "`armadico keys host` on the computer that has the authority's key writes new ones for"
            " this computer"
        )


def _span(span: timedelta) -> str:
    """A time span for people."""
    seconds = span.total_seconds()
    for unit, size in (("days", 86_400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
