"""Credentials that must get no link: certificates by the authority's own key and by others.

They are made here with `cryptography` and not with the authority's code, because that would refuse
to make most of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final, NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from armadico.keys.door import open_door
from armadico.keys.store import AUTHORITY_KEY, Store
from armadico.mesh.door import TLS, USER
from armadico_tools.attacks.victim import Victim

MEMBER: Final = "goto"
PAIR: Final = (f"{TLS}connect_certificate", f"{TLS}connect_private_key")


class Stranger(NamedTuple):
    """An attacker: at which endpoint it tries, and with which settings of Zenoh."""

    name: str
    endpoint: str
    settings: Mapping[str, object]


class Signer(NamedTuple):
    certificate: x509.Certificate
    key: Ed25519PrivateKey


def member(victim: Victim, name: str) -> Stranger:
    """A member, with its true key, on the port."""
    door = open_door(victim.where, name).abroad()
    return Stranger(name, victim.endpoint, door.current())


def strangers(victim: Victim) -> list[Stranger]:
    """All that must not get a link to a society with keys."""
    keys, port, socket = victim.where.keys, victim.endpoint, victim.socket
    assert keys is not None, "it has keys"
    true = dict(member(victim, MEMBER).settings)
    login = {name: value for name, value in true.items() if name.startswith(USER)}
    tls = {name: value for name, value in true.items() if name not in login}
    trusts = {f"{TLS}root_ca_certificate": str(Store(keys).authority)}
    plain = port.replace("tls/", "tcp/")
    user, password = f"{USER}user", f"{USER}password"
    rows: list[tuple[str, str, Mapping[str, object]]] = [
        ("plain TCP on the port", plain, login),
        ("plain TCP, no password", plain, {}),
        ("no certificate", port, trusts | login),
        ("no certificate, no password", port, trusts),
        *((name, port, true | files) for name, files in _certificates(victim.namespace, keys, tls)),
        ("wrong password", port, true | {password: "0" * 64}),
        ("no password", port, true | {password: ""}),
        ("another's name, own password", port, true | {user: f"{victim.namespace}/robot"}),
        ("certificate alone", port, tls),
        ("Unix socket, no password", socket, {}),
        ("Unix socket, wrong password", socket, login | {password: "0" * 64}),
    ]
    return [Stranger(*row) for row in rows]


def _certificates(
    namespace: str, keys: Path, tls: Mapping[str, object]
) -> Iterator[tuple[str, dict[str, object]]]:
    """Certificates that must not be accepted, as settings; `tls` are a member's own."""
    ours = _signer(Store(keys).authority, keys / AUTHORITY_KEY)
    leaf = _signer(*(Path(str(tls[name])) for name in PAIR))
    foreign = Signer(ours.certificate, Ed25519PrivateKey.generate())  # of the same name
    name = f"{namespace}/{MEMBER}"
    # Common names; from when and until when it is valid, hours from now; who signs it.
    table: dict[str, tuple[tuple[str, ...], int, int, Signer | None]] = {
        "foreign authority": ((name,), -1, 24, foreign),
        "signed by itself": ((name,), -1, 24, None),
        "expired an hour ago": ((name,), -24, -1, ours),
        "valid from tomorrow": ((name,), 24, 48, ours),
        "valid a year ago": ((name,), -8784, -8760, ours),
        "no common name": ((), -1, 24, ours),
        "two common names": ((name, f"{namespace}/robot"), -1, 24, ours),
        "another namespace": ((f"other/{MEMBER}",), -1, 24, ours),
        "unknown member": ((f"{namespace}/nobody",), -1, 24, ours),
        "signed by a member": ((name,), -1, 24, leaf),
    }
    for label, (names, begins, ends, by) in table.items():
        key = Ed25519PrivateKey.generate()
        pem = _certificate(key, names, timedelta(hours=begins), timedelta(hours=ends), by)
        if by is leaf:  # with the chain to the authority
            pem += leaf.certificate.public_bytes(Encoding.PEM)
        private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        files = [keys.parent / f"{label}{end}" for end in (".pem", ".key")]
        for file, data in zip(files, (pem, private), strict=True):
            file.write_bytes(data)
        yield label, dict(zip(PAIR, map(str, files), strict=True))


def _signer(certificate: Path, private: Path) -> Signer:
    key = load_pem_private_key(private.read_bytes(), None)
    assert isinstance(key, Ed25519PrivateKey), "all keys of a society are"
    return Signer(x509.load_pem_x509_certificate(certificate.read_bytes()), key)


def _certificate(
    key: Ed25519PrivateKey,
    names: Sequence[str],
    begins: timedelta,
    ends: timedelta,
    by: Signer | None,
) -> bytes:
    """A certificate with these common names; without a signer it is signed by its own key."""
    now = datetime.now(UTC)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name) for name in names])
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if by is None else by.certificate.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + begins)
        .not_valid_after(now + ends)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .sign(key if by is None else by.key, None)
        .public_bytes(Encoding.PEM)
    )
