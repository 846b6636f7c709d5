"""Framing that both protocols share: valid frames from a stream of bytes; sans-IO."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class Framing(Generic[T]):
    """Extracts the valid frames from a stream of bytes in any fragments.

    After a failed check the search continues right behind the frame's mark, not behind the frame:
    a length field changed by noise would otherwise swallow the valid frames that follow.

    Attributes:
        dropped: Bytes so far that belonged to no valid frame.
        mangled: Frames so far whose check failed.
    """

    def __init__(self, mark: bytes, head: int, quiet_s: float) -> None:
        """Frames begin with `mark`; their length is known from `head` bytes.

        A frame that is incomplete for `quiet_s` is dropped. Otherwise noise that looks like a mark
        with a great length would hold back the next second of commands, including a stop.
        """
        self.dropped = self.mangled = 0
        self._buffer = bytearray()
        self._fed_at = 0.0
        self._mark, self._head, self._quiet_s = mark, head, quiet_s

    @property
    def pending(self) -> int:
        """Bytes kept because they may begin a frame."""
        return len(self._buffer)

    def begin(self) -> None:
        """Drop the buffer: the line was opened again."""
        self._drop(len(self._buffer))

    def feed(self, data: bytes, now: float = 0.0) -> list[T]:
        """Add bytes at time `now` (s, any clock) and return the frames that they complete."""
        if self._buffer and now - self._fed_at > self._quiet_s:
            self._drop(min(len(self._mark), len(self._buffer)))
        self._fed_at = now
        self._buffer += data
        found: list[T] = []
        while (one := self._next()) is not None:
            found.append(one)
        return found

    def _next(self) -> T | None:
        """Remove and return the first good frame; None: more bytes are needed."""
        raise NotImplementedError

    def _find(self) -> bool:
        """Drop what precedes the next mark; return whether the whole head is there."""
        buffer, mark = self._buffer, self._mark
        start = buffer.find(mark)
        if start < 0:
            start = len(buffer)
            for some in range(len(mark) - 1, 0, -1):
                if buffer.endswith(mark[:some]):
                    start -= some
                    break
        self._drop(start)
        return len(buffer) >= self._head

    def _drop(self, count: int) -> None:
        self.dropped += count
        del self._buffer[:count]
