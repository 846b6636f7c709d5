"""Which certificates get a link at a robot's TLS port, by the files of keys as they are now.

The porter has one `Admission`. It reads the porter's own certificate and the list of identities
again when they change, so a revoked name loses its link. It also issues a new certificate for the
key of a present or expired one (`armadico.keys.asking`), if the authority's key is on this
computer.
"""

from __future__ import annotations

import logging
import ssl
from datetime import UTC, datetime
from typing import Any, Final, cast

from armadico.core.config_errors import ConfigError
from armadico.keys.asking import RENEWAL
from armadico.keys.expiry import Validity
from armadico.keys.store import MEMBERS, Member, Store, admits, stamp, why_void
from armadico.mesh.door import ROBOT

logger = logging.getLogger("armadico.keys")

EXPIRED_S: Final = 30 * 86_400.0
"""A certificate that expired longer ago is not renewed, s."""

NO_CHECK_TIME: Final = 0x200000
"""OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which `ssl` does not name."""

FOREIGN: Final = "its certificate was not issued by this lab's authority"

UNVERIFIED: Final = {
    9: "its certificate is not valid yet: one of the two clocks is wrong",
    10: "its certificate has expired, or one of the two clocks is wrong",
} | dict.fromkeys((7, 18, 19, 20, 21), FOREIGN)
"""By OpenSSL's codes (x509_vfy.h)."""

NO_TLS: Final = "does not use TLS"
CUT_OFF: Final = "ended its connection within the handshake"

REASONS: Final = {
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "has no certificate",
    "WRONG_VERSION_NUMBER": NO_TLS,
    "HTTP_REQUEST": NO_TLS,
    "UNEXPECTED_EOF_WHILE_READING": CUT_OFF,
    "TLSV1_ALERT_UNKNOWN_CA": "does not know this lab's authority",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "takes the robot's certificate for expired",
    "SSLV3_ALERT_BAD_CERTIFICATE": "does not accept the robot's certificate",
    "SSLV3_ALERT_CERTIFICATE_UNKNOWN": "does not accept the robot's certificate",
}
"""By OpenSSL's names."""


class Admission:
    """Who gets a link, by the present files.

    Attributes:
        context: What a handshake is made with.
        lenient: The same for a client that asks for a new certificate: also with an expired one.
    """

    def __init__(self, namespace: str, store: Store) -> None:
        """Read the files. Raises ConfigError."""
        self._namespace, self._store = namespace, store
        self._own = store.checked(namespace, ROBOT)
        self._members: dict[str, Member] = {}
        self._users = frozenset[str]()
        self._read()

    def look(self) -> bool:
        """Read changed files; return whether there were any. Files that fail change nothing."""
        if self._stamp() == self._seen:
            return False
        try:
            self._read()
        except ConfigError as error:
            logger.error("the keys that were read before stay in use: %s", error)
            return False
        return True

    def refusal(self, user: str) -> str:
        """Why the keys of a user name are not admitted; "" if they are."""
        if user in self._users:
            return ""
        if not user:
            return "its certificate has no common name"
        return why_void(user, self._members) or f"{user} is no member of {self._namespace}"

    def renewal(self, client: ssl.SSLSocket, expired: float) -> bytes:
        """Return a new certificate for the key of a client's, PEM, or why there is none.

        `expired` is how long ago the client's one has expired, s; below 0, if it has not.
        """
        der = client.getpeercert(binary_form=True)
        if client.selected_alpn_protocol() != RENEWAL or der is None:
            return b""
        if expired > EXPIRED_S:
            return b"it expired more than 30 days ago: `armadico keys host` makes new keys"
        if not self._store.issues:
            return (
                b"the authority's key is not on the robot's computer: run `armadico keys host` on"
                b" the one that has it"
            )
        from armadico.keys.authority import KeyFileError
        from armadico.keys.issuing import Issuer

        present = ssl.DER_cert_to_PEM_cert(der).encode()
        try:
            return Issuer.of(self._store).again(present, datetime.now(UTC))
        except (ConfigError, KeyFileError) as error:
            return str(error).encode()

    def _stamp(self) -> list[object]:
        store, own = self._store, self._own
        files = (store.authority, store.folder / MEMBERS, own.certificate, own.private)
        return [stamp(file) for file in files]

    def _read(self) -> None:
        self._seen = self._stamp()
        self._members = self._store.members()
        self.context, self.lenient = self._context(), self._context()
        self.lenient.verify_flags |= NO_CHECK_TIME
        self.lenient.set_alpn_protocols([RENEWAL])
        self._users = frozenset(
            user
            for member in self._members.values()
            if admits(member, self._namespace)
            for user in member.users
        )

    def _context(self) -> ssl.SSLContext:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.verify_mode = ssl.CERT_REQUIRED
        context.num_tickets = 0  # a resumed session would not show its certificate
        path = self._store.authority
        try:
            context.load_verify_locations(path)
            path = self._own.certificate
            context.load_cert_chain(path, self._own.private)
        except OSError as error:
            why = getattr(error, "reason", None) or error.strerror
            raise ConfigError(f"cannot be used for TLS: {why}", path) from None
        return context


def introduced(client: ssl.SSLSocket) -> tuple[str, Validity]:
    """Return the common name of a client's certificate, and when it is valid.

    The name is "" without one, and with several, which would be several identities.
    """
    found = cast("dict[str, Any]", client.getpeercert())
    names = [value for part in found["subject"] for key, value in part if key == "commonName"]
    begins, ends = (ssl.cert_time_to_seconds(found[key]) for key in ("notBefore", "notAfter"))
    return str(names[0]) if len(names) == 1 else "", Validity(begins, ends)


def failure(error: OSError) -> str:
    """Return why a handshake failed, for people."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return UNVERIFIED.get(error.verify_code, error.verify_message)
    if isinstance(error, ssl.SSLError):
        reason = str(error.reason)
        return REASONS.get(reason, reason.lower().replace("_", " "))
    return CUT_OFF
