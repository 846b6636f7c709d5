"""A folder of keys, and what can be made with its authority."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from armadico.keys.authority import Pair, create, issue
from armadico.keys.issuing import Issuer
from armadico.keys.store import Identity, Member, Store
from armadico.mesh.door import ROBOT

NAMESPACE = "robot1"
NAMES = ("goto", "avoid")


class Lab:
    """An authority, and the identities of a robot's society on one computer."""

    def __init__(self, folder: Path, hours: float = 24.0) -> None:
        self.store = Store(folder)
        self.pair = create("lab", datetime.now(UTC))
        self.store.begin(self.pair.certificate, self.pair.private)
        self.issuer = Issuer.of(self.store, hours)
        self.give(ROBOT, kind=ROBOT)
        for name in NAMES:
            self.give(name)

    def give(self, name: str, *, kind: str = "agent", namespace: str = NAMESPACE) -> Identity:
        """Issue an identity."""
        member = Member(f"{namespace}/{name}", kind, (name,))
        self.issuer.give([member], self.store, datetime.now(UTC))
        return self.store.of(member.name)

    def revoke(self, name: str) -> None:
        self.issuer.revoke([f"{NAMESPACE}/{name}"], datetime.now(UTC))

    def pair_of(
        self, name: str, *, begins_s: float = 0.0, lives_s: float = 3600.0, full: bool = False
    ) -> Pair:
        """A certificate of the lab's authority, with any times; the list does not change."""
        at = datetime.now(UTC) + timedelta(seconds=begins_s)
        whole = name if full else f"{NAMESPACE}/{name}"
        return issue(self.pair, whole, at, hours=lives_s / 3600.0)


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path / "keys")


MakeLab = Callable[..., Lab]


@pytest.fixture
def make_lab(tmp_path: Path) -> MakeLab:
    def make(name: str = "keys", hours: float = 24.0) -> Lab:
        return Lab(tmp_path / name, hours)

    return make
