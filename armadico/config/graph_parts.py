"""Transfer of a SLAM graph in parts, since a message is limited to 64 KiB."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from typing import Final

from armadico.config.graph_file import MOST_BYTES
from armadico.core.config_errors import ConfigError
from armadico.mobile.messages import MapGraphPart, MapGraphRequest, MapLoadRequest

PART: Final = 60_000
"""Bytes of a part, which leaves room for the message's other fields."""

TRIES: Final = 3
"""Readings of a graph that is replaced meanwhile."""


class Outgoing:
    """The graph that is being read; part 0 takes the present one, so that all parts fit."""

    def __init__(self) -> None:
        """Nothing is being read."""
        self._data, self._digest = b"", 0

    def part(self, request: MapGraphRequest, present: Callable[[], bytes]) -> MapGraphPart:
        """The requested part; of a present graph if the digest is not that of the one being read.

        After the last part the graph is dropped.
        """
        number = request.part
        if number == 0 or request.digest != self._digest or not self._data:
            self._data = present()
            self._digest = zlib.crc32(self._data)
        parts = -(-len(self._data) // PART)
        data = self._data[number * PART : (number + 1) * PART]
        found = MapGraphPart(number, parts, self._digest, data)
        if number + 1 >= parts:
            self._data = b""
        return found


class Incoming:
    """The graph that is being received."""

    def __init__(self) -> None:
        """Nothing was received."""
        self._parts: list[bytes] = []
        self._digest = 0

    def take(self, request: MapLoadRequest) -> bytes | None:
        """Return the graph with the last part. Raises ConfigError for parts that do not fit."""
        if request.part == 0:
            self._parts, self._digest = [], request.digest
        expected = len(self._parts)
        if request.digest != self._digest or request.part != expected:
            raise ConfigError(f"part {request.part}: expected part {expected}; load it again")
        if request.parts * PART > MOST_BYTES:
            raise ConfigError(f"{request.parts} parts; expected at most {MOST_BYTES // PART}")
        self._parts.append(request.data)
        if len(self._parts) < request.parts:
            return None
        data, self._parts = b"".join(self._parts), []
        if zlib.crc32(data) != self._digest:
            raise ConfigError("the parts do not fit each other; load it again")
        return data


def read(ask: Callable[[MapGraphRequest], MapGraphPart | None]) -> bytes | None:
    """The graph of an agent, part by part; None without an answer, empty without a graph.

    Raises ConfigError if it is replaced again and again.
    """
    for _ in range(TRIES):
        first = ask(MapGraphRequest())
        if first is None or not first.parts:
            return None if first is None else b""
        found = [first.data]
        for number in range(1, first.parts):
            part = ask(MapGraphRequest(number, first.digest))
            if part is None:
                return None
            if part.digest != first.digest:
                break
            found.append(part.data)
        data = b"".join(found)
        if len(found) == first.parts and zlib.crc32(data) == first.digest:
            return data
    raise ConfigError("the graph was replaced while it was read: save it again")


def parts_of(data: bytes) -> Iterator[MapLoadRequest]:
    """The requests that load a graph."""
    parts, digest = -(-len(data) // PART), zlib.crc32(data)
    for number in range(parts):
        yield MapLoadRequest(number, parts, digest, data[number * PART : (number + 1) * PART])
