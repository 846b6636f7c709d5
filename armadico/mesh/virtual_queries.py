"""Queries on the virtual mesh, and their replies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from armadico.core.messages import Message, MessageError, checked
from armadico.core.outgoing import SendQuery
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual_place import CLIENT, Network, Place


@dataclass
class Query:
    client: Place | None  # None: outside the society
    waits: int  # how many may still reply
    each: Callable[[str, Message], bool]  # called with a reply; returns whether that is enough
    over: Callable[[], None]  # called after the last reply


class Queries:
    """The queries that wait for replies."""

    def __init__(self, mesh: Network) -> None:
        self._mesh = mesh
        self._waiting: dict[int, Query] = {}
        self._last = 0

    def put_first(
        self,
        client: Place | None,
        query: SendQuery,
        then: Callable[[Message | None], None],
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Send a query of which only the first reply counts."""

        def each(_: str, message: Message) -> bool:
            if not isinstance(message, query.reply):
                return False
            then(message)
            return True

        key, request, timeout = query.key, query.request, query.timeout
        self.put(client, key, request, timeout, each, lambda: then(None), namespace)

    def put(
        self,
        client: Place | None,
        key: str,
        request: Message,
        timeout: float,
        each: Callable[[str, Message], bool],
        over: Callable[[], None],
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Send a query to all that answer on a key, or on the keys of a pattern.

        A client outside the society is linked to its router, as a command-line tool is.
        """
        self._last += 1
        number, source, waits = self._last, CLIENT if client is None else client, 0
        star = self._mesh.star
        shared = sendable(request)
        if isinstance(shared, str):
            if client is not None:
                client.unsent(key, shared)
        elif client is None or not client.lost:
            for place in self._mesh.others(client, namespace):
                known = not place.lost and star.knows(client, place)
                for one in place.queryables(key) if known else ():
                    waits += 1
                    if client is not None or star.serves(place):
                        self._mesh.later(source, place, place.on_query, one, (key, shared, number))
        self._waiting[number] = Query(client, waits, each, over)
        self._mesh.call_at(self._mesh.now + (timeout if waits else 0.0), self._over, number)

    def reply(self, place: Place, number: int, key: str, message: Message) -> None:
        query = self._waiting.get(number)
        shared = sendable(message)
        if isinstance(shared, str):
            place.unsent(key, shared)
        elif query is not None and not place.lost:
            if query.client is not None:
                self._mesh.later(place, query.client, self._replied, number, (key, shared))
                return
            at = self._mesh.link(place.address, CLIENT).arrival(self._mesh.now)
            if at is not None and self._mesh.star.serves(place, back=True):
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

    def _over(self, number: int, _: object) -> None:
        query = self._waiting.pop(number, None)
        if query is not None:
            query.over()


def sendable(message: Message) -> Message | str:
    """Return the message as receivers decode it, or why it cannot be sent."""
    try:
        return checked(message)
    except MessageError as error:
        return str(error)
