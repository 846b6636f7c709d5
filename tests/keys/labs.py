"""Labs with keys: of one computer, and of a table with two hosts."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import NameOID

from armadico.config.hosts import HostTable, load_hosts
from armadico.keys.authority import Pair, create, issue
from armadico.keys.issuing import Issuer
from armadico.keys.members import of_host, of_table
from armadico.keys.store import Identity, Member, Store
from armadico.mesh.door import ROBOT

NAMESPACE = "robot1"
NOW = datetime(2030, 1, 2, 3, 4, 5, tzinfo=UTC)

TABLE = """\
keys = "keys"
[lab1]
router = "tcp/127.0.0.1:{port}"
agents = ["robot", "encoder", "sonar", "goto"]
together = [["encoder", "sonar"]]
[lab2]
address = "127.0.0.2"
agents = ["goto", "avoid"]
takes = ["encoder"]
"""


def table_in(folder: Path, port: int = 7447) -> HostTable:
    file = folder / "lab.toml"
    file.write_text(TABLE.format(port=port))
    return load_hosts(file)


def authority_in(folder: Path, now: datetime = NOW) -> Store:
    store = Store(folder)
    pair = create("lab", now)
    store.begin(pair.certificate, pair.private)
    return store


def lab_in(folder: Path, now: datetime = NOW, port: int = 7447) -> tuple[HostTable, Issuer]:
    """A table, its authority, and the keys of lab1 in its folder."""
    table = table_in(folder, port)
    issuer = Issuer.of(authority_in(folder / "keys", now))
    issuer.list_all(of_table(table, "robot1", ["anna"]))
    addresses = table.host("lab1").addresses
    members = of_host(table, "lab1", "robot1", ["anna"])
    issuer.give(members, "lab1", issuer.store, now, addresses=addresses)
    return table, issuer


def revoke(issuer: Issuer, name: str, now: datetime = NOW) -> list[str]:
    """Revoke all keys of an identity."""
    return issuer.revoke(issuer.store.members()[name].users, now)


NAMES = ("goto", "avoid")


class Lab:
    """An authority, and the identities of a robot's society on one computer."""

    def __init__(self, folder: Path) -> None:
        self.store = authority_in(folder, datetime.now(UTC))
        self.issuer = Issuer.of(self.store)
        self.pair = self.issuer.pair
        self.give(ROBOT, kind=ROBOT)
        for name in NAMES:
            self.give(name)

    def give(self, name: str, *, kind: str = "agent") -> Identity:
        """Issue an identity."""
        member = Member(f"{NAMESPACE}/{name}", kind, (name,))
        self.issuer.give([member], "lab1", self.store, datetime.now(UTC))
        return self.store.of(member.name)

    def revoke(self, name: str) -> None:
        revoke(self.issuer, f"{NAMESPACE}/{name}")

    def pair_of(
        self, name: str, *, begins_s: float = 0.0, lives_s: float = 3600.0, full: bool = False
    ) -> Pair:
        """A certificate of the lab's authority, with any times; the list does not change."""
        at = datetime.now(UTC) + timedelta(seconds=begins_s)
        whole = name if full else f"{NAMESPACE}/{name}"
        return issue(self.pair, whole, at, hours=lives_s / 3600.0)


def named(authority: Pair, *names: str) -> Pair:
    """A certificate for an hour from now with any number of common names."""
    key, now = Ed25519PrivateKey.generate(), datetime.now(UTC)
    signer = load_pem_private_key(authority.private, None)
    assert isinstance(signer, Ed25519PrivateKey)
    issuer = x509.load_pem_x509_certificate(authority.certificate).subject
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name) for name in names])
    certificate = (
        x509.CertificateBuilder(issuer, subject, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(hours=1))
        .sign(signer, None)
    )
    private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return Pair(certificate.public_bytes(Encoding.PEM), private)
