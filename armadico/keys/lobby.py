"""Which of the connections that have not introduced themselves are served next: sans-IO.

Anybody who reaches the port can open connections, and a handshake costs the porter about a
millisecond. So they wait here. A connection that sends nothing costs its place alone: where a
source has too many, its oldest one goes, and one that introduces itself at once is served before
that. Handshakes are rationed by source, and sources take turns, so a source that floods the port
keeps no other one out. The addresses of the host table are served before all others.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Final, Generic, TypeVar

from armadico.mesh.sources import Ration

MOST_OF_A_SOURCE: Final = 64  # connections that wait; a host with 30 agents starts them at once
MOST: Final = 512
INTRODUCTION_S: Final = 2.0  # from the connection to the end of the handshake, s

RATE_HZ: Final = 100.0  # handshakes of one source that do not succeed
BURST: Final = 200.0
REFUND: Final = 0.5  # of a handshake that succeeds: a member may flood the port, too
RATE_OF_STRANGERS_HZ: Final = 200.0  # together; a fifth of a core
MOST_SOURCES: Final = 4096  # whose rations are remembered

C = TypeVar("C")  # a connection


class Lobby(Generic[C]):
    """The connections that have not introduced themselves."""

    def __init__(self, named: frozenset[str] = frozenset()) -> None:
        """Begin without connections."""
        self.named = named  # the sources that are served before others
        # All of them, and where each comes from.
        self.waiting: OrderedDict[C, tuple[str, float]] = OrderedDict()
        self._of: dict[str, OrderedDict[C, None]] = {}
        self._ready: OrderedDict[str, OrderedDict[C, None]] = OrderedDict()  # sources take turns
        self._rations: OrderedDict[str, Ration] = OrderedDict()
        self._strangers = Ration(RATE_OF_STRANGERS_HZ, RATE_OF_STRANGERS_HZ)

    def enter(self, connection: C, source: str, now: float) -> C | None:
        """Add a connection; return the one that has to go for it, if any."""
        self.waiting[connection] = (source, now)
        mine = self._of.setdefault(source, OrderedDict())
        mine[connection] = None
        if len(mine) > MOST_OF_A_SOURCE:
            crowd = mine
        elif len(self.waiting) > MOST:
            strangers = [c for s, c in self._of.items() if s not in self.named]
            crowd = max(strangers or self._of.values(), key=len)
        else:
            return None
        oldest = next(iter(crowd))
        self.leave(oldest)
        return oldest

    def ready(self, connection: C) -> None:
        """Note that a connection has sent something, so that its handshake can begin."""
        source, _ = self.waiting[connection]
        self._ready.setdefault(source, OrderedDict())[connection] = None

    def next(self, now: float) -> C | None:
        """Return the connection whose handshake begins now; None if none may."""
        for source in sorted(self._ready, key=self._is_stranger):  # stable: they take turns
            rations = self._rations_of(source, now)
            if min(each.left for each in rations) < 1.0:
                continue
            for each in rations:
                each.left -= 1.0
            queue = self._ready[source]
            connection, _ = queue.popitem()  # the newest: it is the last to give up
            self._ready.move_to_end(source)
            if not queue:
                del self._ready[source]
            return connection
        return None

    def due(self, now: float) -> float | None:
        """How long until `next` or `late` may return something, s; None: not before a change."""
        waits = [
            max(ration.until_one() for ration in self._rations_of(source, now))
            for source in self._ready
        ]
        first = next(iter(self.waiting.values()), None)
        if first is not None:
            waits.append(max(first[1] + INTRODUCTION_S - now, 0.0))
        return min(waits, default=None)

    def introduced(self, connection: C, now: float) -> None:
        """Remove a connection whose handshake succeeded, which costs its source less."""
        source, _ = self.waiting[connection]
        self.leave(connection)
        for ration in self._rations_of(source, now):
            ration.left = min(ration.left + REFUND, ration.burst)

    def leave(self, connection: C) -> None:
        """Remove a connection; one that is not here is ignored."""
        source, _ = self.waiting.pop(connection, ("", 0.0))
        for places in (self._of, self._ready):
            if source in places:
                places[source].pop(connection, None)
                if not places[source]:
                    del places[source]

    def late(self, now: float) -> list[C]:
        """Remove the connections that took too long, and return them."""
        found = []
        for connection, (_, since) in self.waiting.items():
            if now - since < INTRODUCTION_S:
                break
            found.append(connection)
        for connection in found:
            self.leave(connection)
        return found

    def _is_stranger(self, source: str) -> bool:
        return source not in self.named

    def _rations_of(self, source: str, now: float) -> list[Ration]:
        """The rations that a handshake of a source takes from, refilled."""
        own = self._rations.setdefault(source, Ration(RATE_HZ, BURST, now))
        self._rations.move_to_end(source)
        if len(self._rations) > MOST_SOURCES:
            self._rations.popitem(last=False)
        rations = [own, self._strangers] if self._is_stranger(source) else [own]
        for ration in rations:
            ration.refill(now)
        return rations
