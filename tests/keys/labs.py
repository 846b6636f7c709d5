"""A lab of two hosts with keys, for tests."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from armadico.config.hosts import HostTable, load_hosts
from armadico.keys.authority import create
from armadico.keys.issuing import Issuer
from armadico.keys.members import of_host, of_table
from armadico.keys.store import Store

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
    issuer.give(of_host(table, "lab1", "robot1", ["anna"]), issuer.store, now, addresses=addresses)
    return table, issuer
