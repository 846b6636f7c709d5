"""Credentials that must get no link: certificates by the authority's own key and by others.

They are made here with `cryptography` and not with the authority's code, because that would refuse
to make most of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from armadico.keys.issuing import Issuer
from armadico.keys.store import AUTHORITY_KEY, Store
from armadico.mesh.door import TLS, USER
from armadico_tools.attacks.victim import Victim

MEMBER: Final = "goto"
HOUR: Final = timedelta(hours=1)


class Stranger(NamedTuple):
    """Who tries, at which endpoint, with which settings of Zenoh."""

    name: str
    endpoint: str
    settings: Mapping[str, object]


def member(victim: Victim, name: str) -> Stranger:
    """A member, with its true key, on the port."""
    door = open_door(victim.where, name).abroad()
    return Stranger(name, victim.endpoint, door.current())


def strangers(victim: Victim) -> Iterator[Stranger]:
    """All that must not get a link to a society with keys."""
    keys = victim.where.keys
    assert keys is not None, "it has keys"
    store, made = Store(keys), _Maker(victim.folder / "strangers", keys)
    name = f"{victim.namespace}/{MEMBER}"
    true = dict(member(victim, MEMBER).settings)
    password = {k: v for k, v in true.items() if k.startswith(USER)}
    trusts = {f"{TLS}root_ca_certificate": str(store.authority)}
    plain = victim.endpoint.replace("tls/", "tcp/")
    yield Stranger("plain TCP on the port", plain, password)
    yield Stranger("plain TCP, no password", plain, {})
    yield Stranger("no certificate", victim.endpoint, trusts | password)
    yield Stranger("no certificate, no password", victim.endpoint, trusts)

    def tls(label: str, files: dict[str, object], **other: object) -> Stranger:
        return Stranger(
            label, victim.endpoint, true | files | {f"{USER}{k}": v for k, v in other.items()}
        )

    yield tls("foreign authority", made.pair("foreign", name, foreign=True))
    yield tls("signed by itself", made.pair("itself", name, itself=True))
    yield tls("expired an hour ago", made.pair("expired", name, begins=-24 * HOUR, ends=-HOUR))
    yield tls("valid from tomorrow", made.pair("future", name, begins=24 * HOUR, ends=48 * HOUR))
    yield tls("valid a year ago", made.pair("year", name, begins=-8784 * HOUR, ends=-8760 * HOUR))
    yield tls("no common name", made.pair("nocn", ""))
    yield tls("two common names", made.pair("twocn", name, f"{victim.namespace}/robot"))
    yield tls("another namespace", made.pair("other", f"other/{MEMBER}"))
    yield tls("unknown member", made.pair("unknown", f"{victim.namespace}/nobody"))
    yield tls("signed by a member", made.pair("leaf", name, signer=victim))
    yield tls("wrong password", {}, password="0" * 64)
    yield tls("no password", {}, password="")
    yield tls("another's name, own password", {}, user=f"{victim.namespace}/robot")
    no_user = {k: v for k, v in true.items() if not k.startswith(USER)}
    yield Stranger("certificate alone", victim.endpoint, no_user)
    socket = {k: v for k, v in true.items() if k.startswith(USER)}
    yield Stranger("Unix socket, no password", victim.socket, {})
    wrong = socket | {f"{USER}password": "0" * 64}
    yield Stranger("Unix socket, wrong password", victim.socket, wrong)


def revoked(victim: Victim, name: str) -> None:
    """Revoke all keys of a member."""
    keys = victim.where.keys
    assert keys is not None, "it has keys"
    issuer = Issuer.of(Store(keys))
    member = issuer.store.members()[f"{victim.namespace}/{name}"]
    issuer.revoke(member.users, datetime.now(UTC))


class _Maker:
    """Makes certificates and keys in a folder."""

    def __init__(self, folder: Path, keys: Path) -> None:
        folder.mkdir(exist_ok=True)
        self._folder = folder
        self._authority = x509.load_pem_x509_certificate((keys / "authority.pem").read_bytes())
        found = load_pem_private_key((keys / AUTHORITY_KEY).read_bytes(), None)
        assert isinstance(found, Ed25519PrivateKey), "the authority's key is one"
        self._key = found

    def pair(
        self,
        file: str,
        *names: str,
        begins: timedelta = -HOUR,
        ends: timedelta = 24 * HOUR,
        foreign: bool = False,
        itself: bool = False,
        signer: Victim | None = None,
    ) -> dict[str, object]:
        """Make a certificate with these common names; return the settings with its files.

        By default it is signed by the authority. Else by a `foreign` one of the same name, by
        `itself`, or by the key of a member of the `signer` society.
        """
        key = Ed25519PrivateKey.generate()
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, n) for n in names if n])
        issuer, by = self._authority.subject, self._key
        if foreign:
            by = Ed25519PrivateKey.generate()
        elif itself:
            issuer, by = subject, key
        elif signer is not None:
            settings = member(signer, MEMBER).settings
            own = Path(str(settings[f"{TLS}connect_certificate"])).read_bytes()
            private = Path(str(settings[f"{TLS}connect_private_key"])).read_bytes()
            issuer = x509.load_pem_x509_certificate(own).subject
            found = load_pem_private_key(private, None)
            assert isinstance(found, Ed25519PrivateKey), "a member's key is one"
            by = found
        now = datetime.now(UTC)
        uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        made = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(issuer)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now + begins)
            .not_valid_after(now + ends)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .sign(by, None)
            .public_bytes(Encoding.PEM)
        )
        if signer is not None:  # with the chain to the authority
            made += own
        pem, private_file = self._folder / f"{file}.pem", self._folder / f"{file}.key"
        pem.write_bytes(made)
        private_file.write_bytes(
            key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        )
        return {
            f"{TLS}connect_certificate": str(pem),
            f"{TLS}connect_private_key": str(private_file),
        }
