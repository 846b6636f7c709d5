"""Signatures under what others repeat: its author is known, whichever process repeats it.

A signature carries its author's certificate, so a receiver needs the authority's alone. It counts
as long as that certificate is valid, which is a day, unless the key was revoked meanwhile.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection
from datetime import datetime
from pathlib import Path
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509 import Certificate, load_der_x509_certificate, load_pem_x509_certificate

from armadico.keys.authority import UNREADABLE, common_name
from armadico.keys.store import Identity, name_in

LENGTH: Final = 64
"""Bytes of an Ed25519 signature (RFC 8032)."""

LONGEST: Final = 2048
"""Bytes of a certificate (DER); those that `authority.issue` makes have about 320."""

CONTEXT: Final = b"armadico signed\0"
"""Before what is signed, as TLS signs with the same keys: its messages begin otherwise."""

AUTHORS: Final = 256
"""Certificates that a verifier remembers."""


def sign(identity: Identity, data: bytes) -> bytes:
    """Return the author's certificate (DER), and its signature, 64 bytes.

    It reads the files, as the certificate is renewed. Raises OSError or ValueError.
    """
    certificate = load_pem_x509_certificate(identity.certificate.read_bytes())
    key = load_pem_private_key(identity.private.read_bytes(), None)
    if not isinstance(key, Ed25519PrivateKey):
        raise ValueError(f"{identity.private} is not an Ed25519 key")
    return certificate.public_bytes(Encoding.DER) + key.sign(CONTEXT + data)


class Verifier:
    """Checks the signatures of a namespace's identities."""

    def __init__(
        self,
        namespace: str,
        authority: Path,
        now: Callable[[], datetime],
        void: Callable[[], Collection[str] | None],
    ) -> None:
        """Read the authority's certificate. Raises OSError or ValueError.

        `void` returns the user names whose keys count no more; None while that is not known.
        """
        self._namespace, self._now, self._void = namespace, now, void
        self._authority = load_pem_x509_certificate(authority.read_bytes())
        self._authors: dict[bytes, Certificate] = {}  # of this authority, by DER

    def __call__(self, name: str, data: bytes, signed: bytes) -> bool:
        """Return whether an identity, without its namespace, has signed data (`sign`)."""
        der, signature = signed[:-LENGTH], signed[-LENGTH:]
        author = self._authors.get(der) or self._author(der)
        void = self._void()
        if author is None or void is None:
            return False
        user = common_name(author)
        if user in void or name_in(user) != f"{self._namespace}/{name}":
            return False
        if not author.not_valid_before_utc <= self._now() <= author.not_valid_after_utc:
            return False
        key = author.public_key()
        try:
            assert isinstance(key, Ed25519PublicKey), "`_author` has checked it"
            key.verify(signature, CONTEXT + data)
        except InvalidSignature:
            return False
        return True

    def _author(self, der: bytes) -> Certificate | None:
        """Return a certificate of this authority; None for another one."""
        if len(der) > LONGEST:
            return None
        try:
            with warnings.catch_warnings():  # of a strange serial number; the next line decides
                warnings.simplefilter("ignore")
                found = load_der_x509_certificate(der)
            found.verify_directly_issued_by(self._authority)
            usable = isinstance(found.public_key(), Ed25519PublicKey)
        except (*UNREADABLE, InvalidSignature):
            return None
        if not usable:
            return None
        if len(self._authors) >= AUTHORS:
            self._authors.clear()
        self._authors[der] = found
        return found
