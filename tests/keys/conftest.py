"""A folder of keys, what can be made with its authority, and a society that runs on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from armadico.keys.authority import Pair, issue
from armadico.keys.issuing import Issuer
from armadico.keys.store import Identity, Member
from armadico.mesh.door import ROBOT
from tests.keys.labs import authority_in
from tests.keys.society import Society

NAMESPACE = "robot1"
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


@pytest.fixture
def society(tmp_path: Path) -> Iterator[Society]:
    with ExitStack() as stack:
        yield Society(tmp_path, stack)
