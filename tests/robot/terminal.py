"""A small society that a thread of a test plays on real Zenoh, and commands that look at it."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from armadico.core.messages import (
    PROTOCOL,
    Ack,
    Ballot,
    BidHistory,
    BidRecord,
    Card,
    Claim,
    Cycle,
    Log,
    RobotState,
)
from armadico.core.services import BIDS, CARD
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import Call, ZenohMesh
from armadico.mobile.messages import Pose
from tests.programs import Done, call

NAMESPACE = "terminal-test"


WHO = {"name": "goto", "instance": "goto-00000000000000aa"}


SOON = 40.0


Run = Callable[..., Done]


class Society:
    """One agent that holds the wheels, and a robot: what they would say each cycle."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self.number = 0
        self._mesh = mesh
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live)

    def __enter__(self) -> Society:
        card = Card(
            **WHO,
            host=socket.gethostname(),
            pid=os.getpid(),
            version="1",
            protocol=PROTOCOL,
            provides=(),
            requests=("encoder/pose",),
            resources=("wheels",),
        )
        self._answer(CARD.key_for(**WHO), lambda: card)
        self._answer(BIDS.key_for(**WHO), self._bids)
        self._mesh.declare_alive(WHO["name"], WHO["instance"])
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _answer(self, key: str, reply: Callable[[], Any]) -> None:
        def arrived(call: Call) -> None:
            call.reply(key, reply())

        self._mesh.answer(key, arrived)

    def _bids(self) -> BidHistory:
        newest = self.number
        numbers = range(max(newest - 40, 1), newest + 1)
        return BidHistory(
            WHO["instance"],
            tuple(BidRecord(Cycle(1, n), "wheels", 0.4, False, (0.0, 0.0), "") for n in numbers),
        )

    def _live(self) -> None:
        ballot = Ballot(4, 0.6, False, WHO["instance"])
        while not self._over.wait(0.02):
            self.number += 1
            cycle = Cycle(1, self.number)
            x = float(self.number)
            state = RobotState(cycle, x, 0, 0, 0.25, 0, 12.5, True, False)
            self._mesh.publish("robot/state", state)
            ack = Ack("wheels", cycle, ballot, ballot, cycle, 0.6)
            self._mesh.publish("resource/wheels/ack", ack)
            self._mesh.publish("encoder/pose", Pose(cycle, x, 0, 0))
            self._mesh.publish("resource/wheels/utility", Claim("wheels", ballot, cycle, 0.6))
            self._mesh.publish(f"log/{WHO['instance']}", Log(30, "a wall is near"))


@pytest.fixture
def environment() -> dict[str, str]:
    return os.environ | {
        "ARMADICO_NAMESPACE": NAMESPACE,
        "COLUMNS": "100",
        "LINES": "40",
        "TERM": "xterm",
    }


@pytest.fixture
def router() -> Iterator[ZenohMesh]:
    """The router that a robot agent would be."""
    with ZenohMesh(NAMESPACE, topology(router=True)) as mesh:
        yield mesh


@pytest.fixture
def society(router: ZenohMesh) -> Iterator[Society]:
    with Society(router) as played:
        yield played


@pytest.fixture
def run(environment: dict[str, str]) -> Run:
    return partial(call, env=environment)
