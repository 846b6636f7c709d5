"""The authority of a lab: its certificate, the certificates that it issues, and what is wrong.

Values in, PEM out; the files are in `armadico.keys.store`. Keys are Ed25519 (RFC 8032): one pair
per identity, for TLS and for signatures. Importing this takes 60 ms, so only commands do, and what
explains an error.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from armadico.keys.store import BACKDATED_S

AUTHORITY_DAYS: Final = 3650
ROUTER_DAYS: Final = 365
"""Of the robot's own certificate: Zenoh reads it once, when the robot agent starts."""

CLIENT_HOURS: Final = 24.0

BEFORE: Final = timedelta(seconds=BACKDATED_S)
"""A certificate is valid from so long before it was issued, as the clocks of a lab differ."""

UNREADABLE: Final = (ValueError, TypeError, x509.InvalidVersion, UnsupportedAlgorithm)
"""What the library raises of a certificate that it cannot read or check."""

LONGEST: Final = 64
"""Characters of a common name (RFC 5280, ub-common-name)."""

_COMMON_NAME = re.compile(r"[\w.+/-]+(@\d+)?", re.ASCII)
_COMMON_NAME_OF_AUTHORITY = re.compile(r"[\w.+/ -]+", re.ASCII)


class KeyFileError(ValueError):
    """A key or certificate that cannot be made or used; its text says why, and what to do."""


@dataclass(frozen=True)
class Pair:
    """A certificate and its private key, PEM."""

    certificate: bytes
    private: bytes


@dataclass(frozen=True)
class Facts:
    """What a certificate says of itself.

    Attributes:
        name: Its common name (`common_name`): with several it could be taken for any.
        begins, ends: When it is valid, UTC.
        server: Whether it is a router's.
    """

    name: str
    begins: datetime
    ends: datetime
    server: bool


def create(lab: str, now: datetime) -> Pair:
    """Return a new authority, named after a lab. Raises KeyFileError if the name does not fit."""
    key = Ed25519PrivateKey.generate()
    name = _named(f"{lab} authority", _COMMON_NAME_OF_AUTHORITY)
    certificate = (
        _builder(name, key.public_key(), now, timedelta(days=AUTHORITY_DAYS))
        .issuer_name(name)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .sign(key, None)
    )
    return Pair(certificate.public_bytes(Encoding.PEM), _private(key))


def issue(
    authority: Pair,
    name: str,
    now: datetime,
    *,
    hours: float = CLIENT_HOURS,
    addresses: Sequence[str] = (),
    public: Ed25519PublicKey | None = None,
) -> Pair:
    """Return a new certificate and its private key.

    Args:
        authority: The authority with its private key.
        name: The common name, which is the user name (`armadico.keys.store.user_of`).
        now: The time, with a zone.
        hours: How long it is valid.
        addresses: Names and addresses at which a router listens; without any it is a client's, and
            no process takes it for a router.
        public: The key of a certificate that is renewed: the pair has no private key.

    Raises KeyFileError for an empty or too long name, or one with other characters.
    """
    subject = _named(name, _COMMON_NAME)
    private = Ed25519PrivateKey.generate() if public is None else None
    issuer = x509.load_pem_x509_certificate(authority.certificate)
    signer = load_pem_private_key(authority.private, None)
    assert isinstance(signer, Ed25519PrivateKey), "it was made by `create`"
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    uses += [ExtendedKeyUsageOID.SERVER_AUTH] if addresses else []
    key = public if private is None else private.public_key()
    assert key is not None, "one of the two is given"
    builder = (
        _builder(subject, key, now, timedelta(hours=hours))
        .issuer_name(issuer.subject)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    )
    if addresses:
        names = x509.SubjectAlternativeName([_alternative(each) for each in addresses])
        builder = builder.add_extension(names, critical=False)
    certificate = builder.sign(signer, None).public_bytes(Encoding.PEM)
    return Pair(certificate, b"" if private is None else _private(private))


def facts(certificate: bytes) -> Facts:
    """Return what a certificate says. Raises KeyFileError if it cannot be read."""
    found = _certificate(certificate)
    try:
        uses = found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        server = ExtendedKeyUsageOID.SERVER_AUTH in uses
    except (x509.ExtensionNotFound, ValueError):
        server = False
    return Facts(
        common_name(found),
        found.not_valid_before_utc,
        found.not_valid_after_utc,
        server,
    )


def common_name(certificate: x509.Certificate) -> str:
    """Return the name of a certificate; "" without one, or with several."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if len(names) == 1 else ""


def is_issued_by(certificate: bytes, authority: bytes) -> bool:
    """Return whether an authority, PEM, has signed a certificate. Raises KeyFileError."""
    issued, issuer = _certificate(certificate), _certificate(authority)
    try:
        issued.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def is_pair(certificate: bytes, private: bytes) -> bool:
    """Return whether a private key is that of a certificate. Raises KeyFileError."""
    return certificate_key(certificate) == public_of(private)


def public_of(private: bytes) -> Ed25519PublicKey:
    """Return the public key of a private one, PEM. Raises KeyFileError."""
    try:
        key = load_pem_private_key(private, None)
    except (ValueError, TypeError):
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise KeyFileError("is not a private key in PEM")
    return key.public_key()


def certificate_key(certificate: bytes) -> Ed25519PublicKey:
    """Return the public key of a certificate, PEM. Raises KeyFileError."""
    key = _certificate(certificate).public_key()
    if not isinstance(key, Ed25519PublicKey):
        raise KeyFileError("has no Ed25519 key")
    return key


def _certificate(pem: bytes) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(pem)
    except UNREADABLE:
        raise KeyFileError("is not a certificate in PEM") from None


def _named(name: str, form: re.Pattern[str]) -> x509.Name:
    """Return a subject with a common name: a certificate without one would get a link."""
    if form.fullmatch(name) is None or len(name) > LONGEST:
        raise KeyFileError(
            f"{name!r} cannot be a common name: letters, digits and '._+-/', 1 to {LONGEST} of"
            " them; use a shorter namespace or name"
        )
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _builder(
    subject: x509.Name, key: Ed25519PublicKey, now: datetime, valid: timedelta
) -> x509.CertificateBuilder:
    now = now.astimezone(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BEFORE)
        .not_valid_after(now + valid)
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _alternative(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _private(key: Ed25519PrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
