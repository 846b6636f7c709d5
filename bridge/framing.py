"""What is framed in a stream of bytes, however that is cut; sans-IO, for every kind of line."""

from __future__ import annotations

from typing import ClassVar, Generic, TypeVar

from armadico.core.compiled import mypyc_attr

F = TypeVar("F")


@mypyc_attr(allow_interpreted_subclasses=True)
class Deframer(Generic[F]):
    """Takes bytes in, and gives the good frames among them.

    Attributes:
        dropped: Bytes so far that belonged to no good frame.
        mangled: Frames so far whose check was bad.
    """

    magic: ClassVar[bytes]
    """Each frame begins so."""
    head: ClassVar[int]
    """Bytes, the magic among them, that tell how long a frame is."""
    quiet_s: ClassVar[float]
    """A frame broken off for this long is given up."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.dropped = 0
        self.mangled = 0
        self._buffer = bytearray()
        self._fed_at = 0.0

    @property
    def pending(self) -> int:
        """Bytes kept because they may begin a frame."""
        return len(self._buffer)

    def begin(self) -> None:
        """What comes next has nothing to do with what came: the line was opened again."""
        self._drop(len(self._buffer))

    def feed(self, data: bytes, now: float = 0.0) -> list[F]:
        """Take bytes in at time `now` (s, any clock) and return the frames that they complete.

        A frame left unfinished for `quiet_s` is given up first. Otherwise a magic in noise, with a
        long count, would sit on the next second of commands: a stop among them.
        """
        if self._buffer and now - self._fed_at > self.quiet_s:
            self._drop(min(len(self.magic), len(self._buffer)))
        self._fed_at = now
        self._buffer += data
        found: list[F] = []
        while (one := self._next()) is not None:
            found.append(one)
        return found

    def _next(self) -> F | None:
        """Remove and return the first good frame; None: more bytes are needed.

        After a bad check the search goes on right behind the magic, not behind the frame: a count
        that noise made larger would otherwise swallow the good frames that follow.
        """
        raise NotImplementedError

    def _find_head(self) -> bool:
        """Drop what stands before the next magic; return whether the whole head has come."""
        buffer, magic = self._buffer, self.magic
        start = buffer.find(magic)
        if start < 0:
            lengths = range(len(magic) - 1, 0, -1)
            start = len(buffer) - next((k for k in lengths if buffer.endswith(magic[:k])), 0)
        self._drop(start)
        return len(buffer) >= self.head

    def _drop(self, count: int) -> None:
        self.dropped += count
        del self._buffer[:count]
