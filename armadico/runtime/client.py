"""The mesh for command-line tools: listen, ask, wait; one thread, nothing to declare."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar, cast

from armadico.core.mailbox import EVENTS
from armadico.core.messages import Ask, Card, Message
from armadico.core.services import CARD, Kind, rows_of, service_of
from armadico.mesh.base import Mesh
from armadico.runtime.inbox import Inbox

M = TypeVar("M", bound=Message)
T = TypeVar("T")

AGAIN_S: Final = 0.1
"""A query that nobody is there to answer is put again after this."""

QUIET_S: Final = 0.3
"""Nobody new for so long, and everybody who is there is taken to be known."""


class Client:
    """A guest on either mesh: it has no token, and agents do not see it. Times are the mesh's."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.alive: set[tuple[str, str]] = set()  # (name, instance) of the tokens that are there
        self.key = ""  # of the message that is being handed on
        self.ahead: dict[str, float] = {}  # s; by instance, of the clocks that cards have said
        self._inbox = Inbox(mesh)
        self._latest: dict[type[Message], tuple[Message, float]] = {}
        self._changed_at = self.mesh.now()
        mesh.watch_alive(self._token)

    def listen(
        self, *kinds: type[Message], then: Callable[[Message, float], None] | None = None
    ) -> None:
        """Keep the latest message of each kind; `then` is shown each one, and when it came (s)."""
        for kind in kinds:
            self._listen(kind, then)

    def latest(self, kind: type[M]) -> M | None:
        """The newest message of a kind that was listened for."""
        message, _ = self._latest.get(kind, (None, 0.0))
        return cast("M | None", message)

    def age(self, kind: type[Message]) -> float:
        """Seconds since the newest message of a kind came; infinite if none did."""
        found = self._latest.get(kind)
        return float("inf") if found is None else self.mesh.now() - found[1]

    def publish(self, message: Message) -> None:
        """Say something on its service's key."""
        self.mesh.publish(service_of(type(message)).key, message)

    def wait_for(self, condition: Callable[[], T | None], timeout: float) -> T | None:
        """What a condition gives as soon as that is true, asked after everything that arrives.

        Returns its last value if that does not happen within `timeout` (s).
        """
        deadline = self.mesh.now() + timeout
        while not (value := condition()):
            left = deadline - self.mesh.now()
            if left <= 0:
                return value
            self._take(left)
        return value

    def ask(
        self, request: Message, timeout: float, patience: float | None = None
    ) -> Message | None:
        """The first answer to a query; None if nobody gave one within `timeout` (s).

        As long as nobody is there to answer, it asks again, since links come up in the background;
        for `patience` s at most, if that is given.
        """
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        begun = self.mesh.now()
        while (gone := self.mesh.now() - begun) < timeout:
            replies = self._ask(service.key, request, service.reply, timeout - gone, enough=1)
            if replies:
                return next(iter(replies.values()))
            if patience is not None and self.mesh.now() - begun >= patience:
                return None
            self.wait_for(lambda: None, AGAIN_S)
        return None

    def cards(self, timeout: float = 1.0) -> dict[tuple[str, str], Card | None]:
        """The cards of everybody whose token is there; None for who does not answer in time."""
        self.settle()
        everybody = CARD.key_for(name="*", instance="*")
        replies = self._ask(everybody, Ask(), Card, timeout, enough=len(self.alive))
        keys = {who: CARD.key_for(name=who[0], instance=who[1]) for who in sorted(self.alive)}
        return {who: _own(replies.get(key), who[1]) for who, key in keys.items()}

    def card(self, name: str, instance: str, timeout: float = 1.0) -> Card | None:
        """The card of one agent; None if it does not answer within `timeout` (s)."""
        key = CARD.key_for(name=name, instance=instance)
        return _own(self._ask(key, Ask(), Card, timeout, enough=1).get(key), instance)

    def request_card(
        self, name: str, instance: str, timeout: float, then: Callable[[Card | None], None]
    ) -> None:
        """Ask for the card of one agent, and go on: `then` gets it, or None, in a later wait."""
        key = CARD.key_for(name=name, instance=instance)
        answered: list[bool] = []

        def each(where: str, card: Card) -> None:
            if where == key and not answered:
                answered.append(True)
                then(_own(card, instance))

        def over() -> None:
            if not answered:
                then(None)

        self._put(key, Ask(), Card, timeout, each, over)

    def settle(self, timeout: float = 2.0) -> None:
        """Wait until the links are up and no token has come or gone for a while."""

        def quiet() -> bool:
            return self.mesh.now() - self._changed_at >= QUIET_S

        deadline = self.mesh.now() + timeout
        while not quiet() and self.mesh.now() < deadline:
            self._take(QUIET_S)

    # Inside --------------------------------------------------------------------------------------

    def _take(self, timeout: float) -> None:
        item = self._inbox.take(timeout)
        if item is not None:
            call, args = item
            call(*args)

    def _listen(self, kind: type[Message], then: Callable[[Message, float], None] | None) -> None:
        service = service_of(kind)

        def arrived(key: str, data: bytes) -> None:
            def deliver() -> None:
                message = self.mesh.read(kind, key, data)
                if message is not None:
                    now = self.mesh.now()
                    self._latest[kind] = (message, now)
                    self.key = key
                    if then is not None:
                        then(message, now)

            self._inbox.put(key, deliver, keep=1 if service.kind is Kind.STATE else EVENTS)

        for row in rows_of(kind):
            self.mesh.subscribe(row.pattern, arrived)

    def _token(self, name: str, instance: str, there: bool) -> None:
        def deliver() -> None:
            who = (name, instance)
            if there != (who in self.alive):
                (self.alive.add if there else self.alive.discard)(who)
                self._changed_at = self.mesh.now()

        self._inbox.put(f"token/{instance}", deliver, keep=1)

    def _ask(
        self, key: str, request: Message, reply: type[M], timeout: float, enough: int
    ) -> dict[str, M]:
        """Replies by key, until there are enough, everybody has answered, or time is up."""
        replies: dict[str, M] = {}
        over: list[bool] = []
        self._put(key, request, reply, timeout, replies.__setitem__, lambda: over.append(True))
        self.wait_for(lambda: len(replies) >= enough or bool(over), timeout)
        return replies

    def _put(
        self,
        key: str,
        request: Message,
        reply: type[M],
        timeout: float,
        each: Callable[[str, M], None],
        over: Callable[[], None],
    ) -> None:
        """Put a query; each reply and its key, and then its end, are handed over while it waits."""

        def arrived(where: str, data: bytes) -> None:
            def deliver() -> None:
                message = self.mesh.read(reply, where, data)
                if message is not None:
                    each(where, message)
                    if isinstance(message, Card) and message.clock:
                        self.ahead[message.instance] = message.clock - time.time()

            self._inbox.put(f"reply/{where}", deliver)

        self.mesh.ask(key, request, timeout, arrived, lambda: self._inbox.put(f"over/{key}", over))


def _own(card: Card | None, instance: str) -> Card | None:
    """A card, if it is the instance's own: nobody speaks for others."""
    return card if card is not None and card.instance == instance else None
