"""Asks for a new certificate of this computer's keys: values and files, without a mesh.

The authority's key signs it if it is on this computer. Otherwise the robot's porter does, if the
key is on its computer (`armadico.keys.porter`). It also accepts a certificate that has expired,
because a computer may have been off for long.
"""

from __future__ import annotations

import base64
import json
import re
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Final, NamedTuple

from armadico.core.config_errors import ConfigError
from armadico.keys.store import BACKDATED_S, Identity, Store, write_private
from armadico.mesh import sockets
from armadico.mesh.door import ROBOT

RENEWAL: Final = "armadico-renewal"
"""The application protocol (ALPN) of a client that asks for a new certificate and sends nothing."""

LINKS: Final = ".links"
"""Suffix of the file of the porter's links, beside the router's socket: for each the name, when its
certificate expires, and from when on that is announced, s since 1970."""

PEM: Final = b"-----BEGIN CERTIFICATE-----"
"""How the answer begins; another one says why there is none."""

LARGEST: Final = 16_384
"""Most bytes of an answer."""

WITHIN_S: Final = 2.0

ANNOUNCED_S: Final = 3600.0
"""From so long before its end an expiry is announced, s; of a short life, from its last sixth."""

ROBOTS_S: Final = 14 * 86_400.0
"""The same of the robot's, which a person renews."""


class Validity(NamedTuple):
    """When a certificate is valid, s since 1970."""

    begins: float
    ends: float

    @property
    def life(self) -> float:
        """How long it is valid from its issue on, s."""
        return max(self.ends - self.begins - BACKDATED_S, 1.0)

    @property
    def renew_at(self) -> float:
        return self.ends - self.life / 3

    @property
    def announce_at(self) -> float:
        return self.ends - min(ANNOUNCED_S, self.life / 6)


def validity(certificate: bytes) -> Validity:
    """Return when a certificate of `armadico.keys.authority`, PEM, is valid. Raises ValueError.

    `cryptography` takes 60 ms and 10 MB to import, which is much for each process. In DER the two
    times are adjacent and of fixed length (RFC 5280, 4.1.2.5).
    """
    lines = [line for line in certificate.splitlines() if not line.startswith(b"-----")]
    found = _VALIDITY.search(base64.b64decode(b"".join(lines)))
    if found is None:
        raise ValueError("no certificate")
    begins, ends = (
        datetime.strptime(t.decode(), "%y%m%d%H%M%SZ").replace(tzinfo=UTC).timestamp()
        for t in found.groups()
    )
    return Validity(begins, ends)


_VALIDITY: Final = re.compile(rb"\x30\x1e\x17\x0d(\d{12}Z)\x17\x0d(\d{12}Z)")


def shown(t: float) -> str:
    """Return a time, s since 1970, for people."""
    return f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d %H:%M} UTC"


def ask(
    store: Store,
    identity: Identity,
    endpoint: str,
    within: float = WITHIN_S,
    wall: Callable[[], float] = time.time,
) -> bytes:
    """Return a new certificate for an identity's key from a robot's porter; it is not written.

    Raises ConfigError with the reason why there is none.
    """
    import ssl  # slow, and seldom needed

    from armadico.mesh.handshake import FOREIGN, UNVERIFIED, tls_place

    place = tls_place(endpoint)
    if place is None:
        raise ConfigError(f"{endpoint} is not over TLS")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.set_alpn_protocols([RENEWAL])
    answer = b""
    try:
        context.load_verify_locations(store.authority)
        context.load_cert_chain(identity.certificate, identity.private)
        with (
            socket.create_connection(place, within) as line,
            context.wrap_socket(line, server_hostname=place[0]) as link,
        ):
            while len(answer) < LARGEST and (part := link.recv(LARGEST)):
                answer += part
    except ssl.SSLCertVerificationError as error:
        raise ConfigError(UNVERIFIED.get(error.verify_code, FOREIGN)) from None
    except OSError as error:
        why = error.strerror or str(error)
        raise ConfigError(f"{endpoint} cannot be asked for it: {why}") from None
    if not answer.startswith(PEM):
        raise ConfigError(answer.decode(errors="replace") or f"{endpoint} gave no answer")
    check(identity, answer, endpoint, wall())
    return answer


def check(identity: Identity, certificate: bytes, source: str, now: float) -> None:
    """Raise ConfigError if a new certificate cannot be used by an identity."""
    import ssl  # slow, and seldom needed
    from tempfile import NamedTemporaryFile

    try:
        valid = validity(certificate)
    except ValueError:
        raise ConfigError(f"{source} returned no certificate") from None
    if not valid.begins <= now < valid.ends:
        raise ConfigError(
            f"{source} returned a certificate for {shown(valid.begins)} to {shown(valid.ends)},"
            f" and this computer's clock says {shown(now)}: compare the clocks of both (`date`)"
        )
    with NamedTemporaryFile() as file:  # `ssl` reads certificates from files only
        file.write(certificate)
        file.flush()
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(file.name, identity.private)
        except OSError:
            raise ConfigError(f"{source} returned a certificate of another key") from None


def renewed(
    store: Store,
    identity: Identity,
    endpoints: Sequence[str],
    wall: Callable[[], float] = time.time,
) -> None:
    """Renew a certificate, by the authority's key here or by one of a robot's porters.

    Raises ConfigError with the reasons why there is none.
    """
    if store.issues:
        from armadico.keys.issuing import Issuer  # slow, and seldom needed

        issuer = Issuer.of(store)
        certificate = issuer.again(
            identity.certificate.read_bytes(), datetime.fromtimestamp(wall(), UTC)
        )
        write_private(identity.certificate, certificate)
        return
    reasons = []
    for endpoint in [end for end in endpoints if end.startswith("tls/")]:
        try:
            write_private(identity.certificate, ask(store, identity, endpoint, wall=wall))
        except ConfigError as error:
            reasons.append(str(error))
        else:
            return
    raise ConfigError("; ".join(reasons) or NOBODY)


NOBODY: Final = (
    "the authority's key is not on this computer, and the host table has no port of the robot"
)


def refresh(store: Store, identity: Identity, endpoints: Sequence[str]) -> None:
    """Renew a certificate that has expired; where that fails, joining names what is wrong."""
    with suppress(ConfigError, ValueError, OSError):
        if validity(identity.certificate.read_bytes()).ends <= time.time():
            renewed(store, identity, endpoints)


def ending(store: Store, namespace: str, now: float) -> dict[str, float]:
    """Return the certificates that soon end a link, and in how many seconds (`Door.ending`).

    On the robot's computer those of the porter's links, and the robot's own one.
    """
    robot = store.identity(namespace, ROBOT)
    links = sockets.socket_of(namespace).with_suffix(LINKS)
    found: dict[str, float] = {}
    if robot.certificate.exists():
        with suppress(OSError, ValueError):
            if (left := validity(robot.certificate.read_bytes()).ends - now) < ROBOTS_S:
                found[robot.name] = left
        with suppress(OSError, ValueError):
            rows = json.loads(links.read_text(encoding="utf-8"))
            found |= {name: ends - now for name, ends, announced in rows if now >= announced}
        return found
    for identity in store.identities():
        with suppress(OSError, ValueError):
            valid = validity(identity.certificate.read_bytes())
            if identity.namespace == namespace and now >= valid.announce_at:
                found[identity.name] = valid.ends - now
    return found
