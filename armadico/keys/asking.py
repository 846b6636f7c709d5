"""Asks for a new certificate of this computer's keys: values and files, without a mesh.

The authority's key signs it if it is on this computer. Otherwise the robot's porter does, if the
key is on its computer (`armadico.keys.admission`). It also accepts a certificate that has expired,
because a computer may have been off for long.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import Final

from armadico.core.config_errors import ConfigError
from armadico.keys.expiry import shown, validity
from armadico.keys.store import Identity, Store, write_private

RENEWAL: Final = "armadico-renewal"
"""The application protocol (ALPN) of a client that asks for a new certificate and sends nothing."""

PEM: Final = b"-----BEGIN CERTIFICATE-----"
"""How the answer begins; another one says why there is none."""

LARGEST: Final = 16_384
"""Most bytes of an answer."""

WITHIN_S: Final = 2.0
"""Timeout of each step of an exchange with a porter, s."""

NO_PORT: Final = (
    "the authority's key is not on this computer, and the host table has no port of the robot"
)


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
        raise ConfigError(f"{endpoint} gives no new certificate: {why}") from None
    if not answer.startswith(PEM):
        raise ConfigError(answer.decode(errors="replace") or f"{endpoint} sent no answer")
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
        with store.changing():  # a command may replace the key meanwhile
            present = identity.certificate.read_bytes()
            certificate = issuer.again(present, datetime.fromtimestamp(wall(), UTC))
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
    raise ConfigError("; ".join(reasons) or NO_PORT)


def refresh(store: Store, identity: Identity, endpoints: Sequence[str]) -> None:
    """Renew a certificate that has expired; where that fails, joining names what is wrong."""
    with suppress(ConfigError, ValueError, OSError):
        if validity(identity.certificate.read_bytes()).ends <= time.time():
            renewed(store, identity, endpoints)
