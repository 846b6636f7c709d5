"""A limited number of places for connections, of which the newest always gets one (sans-IO).

If all places are taken, one connection has to leave: of the lowest rank, then of the source with
most of that rank, then the oldest. So a source that floods the server displaces its own
connections, and a person who connects is served before strangers who connected earlier.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from typing import Generic, TypeVar

C = TypeVar("C", bound=Hashable)


class Places(Generic[C]):
    """The connections that have a place."""

    def __init__(self, most: int) -> None:
        """Begin with so many free places."""
        self._most = most
        self._taken: dict[C, tuple[int, str]] = {}  # ranks and sources, the oldest first

    def enter(self, connection: C, source: str, rank: int = 0) -> C | None:
        """Give a connection a place; return the one that has lost its place, if any.

        It is this one only if all others have a higher rank: those of a lower one leave first. The
        source is that of `armadico.mesh.sources.source_of`.
        """
        self._taken[connection] = (rank, source)
        if len(self._taken) <= self._most:
            return None
        lowest = min(rank for rank, _ in self._taken.values())
        sources = Counter(source for rank, source in self._taken.values() if rank == lowest)
        crowd = max(sources.values())
        leaves = next(
            each
            for each, (rank, source) in self._taken.items()
            if rank == lowest and sources[source] == crowd
        )
        self.leave(leaves)
        return leaves

    def leave(self, connection: C) -> None:
        """Free the place of a connection; one without a place is ignored."""
        self._taken.pop(connection, None)
