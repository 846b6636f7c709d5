"""Somebody who sees a society from outside, and waits until things are so."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Card
from armadico.core.resources import WHEELS
from armadico.launch.client import Client
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import Pose
from armadico.observe.view import View
from tests.whole.docs.shell import Shell

SOON = 60.0  # s; a deadline, not an expectation


class Watcher:
    """Sees who is there and who is obeyed, from outside."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self.client = Client(mesh)
        self.view = View()
        self.client.listen(Ack, then=self.view.learn)
        self.client.listen(Pose)

    def until(self, condition: Callable[[], object], what: str) -> None:
        assert self.client.wait_for(condition, SOON), f"not within {SOON:.0f} s: {what}"

    def everybody(self, names: set[str]) -> None:
        self.until(lambda: {name for name, _ in self.client.alive} == names, f"tokens: {names}")
        self.until(lambda: self.client.age(Pose) < 1.0, "the robot talks")

    def cards(self) -> dict[str, Card]:
        """Everybody's card, asked again until all answer."""

        def answered() -> dict[str, Card] | None:
            found = self.client.cards(SOON)
            cards = {name: card for (name, _), card in found.items() if card is not None}
            return cards if len(cards) == len(found) else None

        cards = self.client.wait_for(answered, SOON)
        assert cards is not None, "everybody answers"
        return cards

    def driven_by(self, name: str) -> None:
        def obeyed() -> bool:
            driver = self.view.driver(WHEELS.name, time.monotonic())
            return driver is not None and agent_of(driver) == name

        self.until(obeyed, f"{name} is obeyed")


@contextmanager
def watching(shell: Shell) -> Iterator[Watcher]:
    """Watch the society of a shell."""
    with ZenohMesh(shell.namespace, topology(connect=shell.router), starts=True) as mesh:
        yield Watcher(mesh)
