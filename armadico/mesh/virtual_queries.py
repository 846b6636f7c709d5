"""Queries on the virtual mesh, and their replies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from armadico.core.agent import AskFor
from armadico.core.messages import Message, MessageError, checked
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual_place import CLIENT, Network, Place


@dataclass
class Query:
    asker: Place | None  # none: somebody outside the society
    waits: int  # how many may still reply
    each: Callable[[str, Message], bool]  # takes a reply; whether that is enough
    over: Callable[[], None]  # told that there will be no more


class Queries:
    """The queries that wait for replies."""

    def __init__(self, mesh: Network) -> None:
        self._mesh = mesh
        self._waiting: dict[int, Query] = {}
        self._asked = 0

    def put_first(
        self,
        asker: Place | None,
        ask: AskFor,
        then: Callable[[Message | None], None],
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Put a query of which the first reply counts."""

        def each(_: str, message: Message) -> bool:
            if not isinstance(message, ask.reply):
                return False
            then(message)
            return True

        self.put(asker, ask.key, ask.request, ask.timeout, each, lambda: then(None), namespace)

    def put(
        self,
        asker: Place | None,
        key: str,
        request: Message,
        timeout: float,
        each: Callable[[str, Message], bool],
        over: Callable[[], None],
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Ask everybody who answers on a key, or on the keys of a pattern."""
        self._asked += 1
        number, name, waits = self._asked, CLIENT if asker is None else asker, 0
        shared = sendable(request)
        if isinstance(shared, str):
            if asker is not None:
                asker.unsent(key, shared)
        elif asker is None or not asker.lost:
            for place in self._mesh.others(asker, namespace):
                unknown = asker is not None and not self._mesh.star.knows(asker, place)
                for one in () if place.lost or unknown else place.queried(key):
                    waits += 1
                    self._mesh.later(name, place, place.asked, one, (key, shared, number))
        self._waiting[number] = Query(asker, waits, each, over)
        self._mesh.call_at(self._mesh.now + (timeout if waits else 0.0), self._over, number)

    def reply(self, place: Place, number: int, key: str, message: Message) -> None:
        query = self._waiting.get(number)
        shared = sendable(message)
        if isinstance(shared, str):
            place.unsent(key, shared)
        elif query is not None and not place.lost:
            if query.asker is not None:
                self._mesh.later(place, query.asker, self._replied, number, (key, shared))
                return
            at = self._mesh.link(place.address, CLIENT).arrival(self._mesh.now)
            if at is not None:
                self._mesh.call_at(at, self._replied, number, (key, shared))

    def _replied(self, number: int, what: tuple[str, Message]) -> None:
        query = self._waiting.get(number)
        if query is None:
            return
        query.waits -= 1
        if query.each(what[0], what[1]):
            del self._waiting[number]
        elif not query.waits:
            self._over(number, None)

    def _over(self, number: int, _: Any) -> None:
        query = self._waiting.pop(number, None)
        if query is not None:
            query.over()


def sendable(message: Message) -> Message | str:
    """The message as the others receive it, or why they cannot."""
    try:
        return checked(message)
    except MessageError as error:
        return str(error)
