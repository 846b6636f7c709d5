"""From the mesh to the scenes: listens, asks for cards and bids, and draws; one thread.

Nobody on the mesh feels it. It has no token and answers nothing; agents publish with congestion
control DROP, so what it does not read in time is dropped at its link; its inbox keeps the newest
of each state and 256 events; and what it asks for is answered from what agents keep anyway.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from armadico.core.mailbox import EVENTS
from armadico.core.messages import Ask, BidHistory, Card, Message
from armadico.core.resources import WHEELS
from armadico.core.services import BIDS, CARD, Kind, Service, service_of
from armadico.mesh.zenoh import ZenohMesh
from armadico.observe.dashboard.scene import SHOWN, Scene
from armadico.runtime.inbox import Inbox

ASK_S: Final = 1.0
"""How often everybody is asked for their recent bids and their card."""

ANSWER_S: Final = 0.8
"""What an answer may take."""

TURN_S: Final = 0.25
"""The loop looks up this often, however silent the mesh."""

ALONE_S: Final = 10.0
"""Without a robot for so long, the user is told."""


class Feed:
    """One namespace, drawn into one scene."""

    def __init__(self, mesh: ZenohMesh, scene: Scene, inbox: Inbox, began: float) -> None:
        """`began` is the time, by the monotonic clock, that the scene calls 0."""
        self.namespace = mesh.namespace
        self._robot_seen = False
        self.scene = scene
        self._mesh = mesh
        self._inbox = inbox
        self._began = began

    def join(self) -> None:
        """Listen to everything that is shown; the mesh must have been opened."""
        for kind in SHOWN:
            self._listen(kind, service_of(kind))
        self._mesh.watch_alive(self._token)

    def turn(self) -> None:
        """Draw what is drawn by time."""
        self.scene.refresh(self._now())

    def ask(self) -> None:
        """Ask everybody for their recent bids and card.

        An answer may take less than the time to the next question, so none pile up.
        """
        for service, kind in ((BIDS, BidHistory), (CARD, Card)):
            receiver = self._receiver(kind, Kind.STATE)
            self._mesh.ask(service.pattern, Ask(), ANSWER_S, receiver, lambda: None)

    def robot_was_there(self) -> bool:
        """Whether an owner of the wheels has, or was once seen to have, a card here."""
        cards = self.scene.view.cards.values()
        self._robot_seen = self._robot_seen or any(WHEELS.name in card.owns for card in cards)
        return self._robot_seen

    # On Zenoh's thread ---------------------------------------------------------------------------

    def _listen(self, kind: type[Message], service: Service) -> None:
        self._mesh.subscribe(service.pattern, self._receiver(kind, service.kind))

    def _receiver(self, kind: type[Message], how: Kind) -> Callable[[str, bytes], None]:
        def arrived(key: str, data: bytes) -> None:
            at = self._now()

            def deliver() -> None:
                message = self._mesh.read(kind, key, data)
                if message is not None:
                    self.scene.take(key, message, at)

            keep = 1 if how is Kind.STATE else EVENTS
            self._inbox.put(f"{self.namespace} {key}", deliver, keep=keep)

        return arrived

    def _token(self, _name: str, instance: str, there: bool) -> None:
        at = self._now()
        self._inbox.put(
            f"{self.namespace} token/{instance}",
            lambda: self.scene.alive(instance, there, at),
            keep=1,
        )

    def _now(self) -> float:
        return time.monotonic() - self._began


class Live:
    def __init__(self, warn: Callable[[str], None]) -> None:
        """`warn` is told what the user should know, a line at a time."""
        self.inbox = Inbox()
        self.began = time.monotonic()
        self.feeds: list[Feed] = []
        self._warn = warn
        self._stopping = False
        self._alone: set[str] = set()

    def add(self, mesh: ZenohMesh, scene: Scene) -> None:
        feed = Feed(mesh, scene, self.inbox, self.began)
        feed.join()
        self.feeds.append(feed)

    def stop(self) -> None:
        """Have `run` return soon; may be called from a signal handler or another thread."""
        self._stopping = True
        self.inbox.ring()

    def run(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Draw what comes, until `stop`, or until `ended` says so (asked 4 times a second)."""
        ask_at = turn_at = self.began
        while not self._stopping:
            item = self.inbox.take(TURN_S)
            if item is not None:
                call, args = item
                call(*args)
            now = time.monotonic()
            if now >= turn_at:
                turn_at = now + TURN_S
                if ended():
                    return
                for feed in self.feeds:
                    feed.turn()
                self._report(now)
            if now >= ask_at:
                ask_at = now + ASK_S
                for feed in self.feeds:
                    feed.ask()

    def _report(self, now: float) -> None:
        """What is lost, and where nobody is: once each, until it is another."""
        dropped = sum(self.inbox.take_dropped().values())
        if dropped:
            self._warn(f"too slow: {dropped} messages were left out")
        if now - self.began < ALONE_S:
            return
        alone = {feed.namespace for feed in self.feeds if not feed.robot_was_there()}
        for namespace in sorted(alone - self._alone):
            self._warn(
                f"no robot in namespace {namespace!r}; waiting for one (`armadico ps` shows who is"
                " there, --namespace and --connect say where to look)"
            )
        self._alone = alone
