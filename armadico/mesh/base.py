"""What a mesh is to whoever is on it: clients and hosts of agents take either of the two.

`zenoh` is between processes, `virtual_session` in one thread under a virtual clock. The time is
part of it, because under a virtual clock it is waiting that moves it. The tests of what a mesh
promises run on both.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from armadico.core.messages import Message, MessageError, decode, line

logger = logging.getLogger("armadico.mesh")

M = TypeVar("M", bound=Message)

Receiver = Callable[[str, bytes], None]
"""Takes a key and a payload, on a thread of the mesh's, and returns soon."""

REPORT_S: Final = 5.0
"""What is refused is reported at most so often."""

REFUSED_KEYS: Final = 1000
"""Keys on which refusals are counted one by one."""


class Bell(Protocol):
    """A lock that is open while it rings: whoever waits for it acquires it."""

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Whether it rang in time."""

    def locked(self) -> bool:
        """Whether it is silent."""


class Time(Protocol):
    """What passes while one waits."""

    def now(self) -> float:
        """The time, s from anywhere; it never goes back."""

    def wait(self, bell: Bell, timeout: float) -> bool:
        """Let time pass until a bell rings; False if it has not in time, s. Below 0 is for ever."""


class Call(Protocol):
    """A query that waits for its answer; one that is let go of unanswered is simply over."""

    key: str
    payload: bytes

    def reply(self, key: str, message: Message) -> None:
        """Answer, from a key that the query's covers, and be done with it."""


class Mesh(Time, Protocol):
    """One process's place on a mesh, within one robot's namespace."""

    namespace: str
    refused: Counter[str]
    """What was no message, or came by a wildcard, by its key."""

    def wait_joined(self, timeout: float) -> bool:
        """Whether it has been linked to its router, within `timeout` (s)."""

    def publish(self, key: str, message: Message, data: bytes | None = None) -> None:
        """Publish a message, by its `data` if it is encoded already; one's own do not receive it.

        Raises MessageError for what could not be decoded. What one publishes arrives in order.
        """

    def has_said(self, key: str) -> bool:
        """Whether publishing on a key asks nothing of the mesh but to pass it on."""

    def subscribe(self, pattern: str, receiver: Receiver) -> None:
        """Have what is published on the keys of a pattern handed over."""

    def ask(
        self,
        key: str,
        request: Message,
        timeout: float,
        each: Receiver,
        done: Callable[[], None],
    ) -> None:
        """Put a query: `each` takes every reply as it comes, then `done` is called, once.

        Args:
            key: May be a pattern; everybody who answers on it is asked.
            request: The question.
            timeout: When to stop waiting, s.
            each: Takes a reply.
            done: Told that there will be no more: all have replied, nobody could, or time is up.
        """

    def answer(self, key: str, receiver: Callable[[Call], None]) -> None:
        """Have the queries on a key handed over."""

    def declare_alive(self, name: str, instance: str) -> None:
        """Show the liveliness token of an agent until the mesh is left."""

    def watch_alive(self, changed: Callable[[str, str, bool], None]) -> None:
        """Subscribe to others' liveliness tokens, as (name, instance, alive): those of now, too.

        The same news may come twice: treat it as a set. Nobody is reported as gone while the
        robot's router cannot be reached (`presence`).
        """

    @property
    def reachable(self) -> bool:
        """Whether the robot's router can be reached."""

    def watch_router(self, changed: Callable[[bool], None]) -> None:
        """Have it said whether the robot's router can be reached, now and whenever that changes."""

    def read(self, kind: type[M], key: str, data: bytes) -> M | None:
        """The message in a payload; None, counted and now and then reported, if there is none."""

    def close(self) -> bool:
        """Leave; False if that goes on by itself. What was published before is still received."""


class Monotonic:
    """The time of this machine."""

    def now(self) -> float:
        return time.monotonic()

    def wait(self, bell: Bell, timeout: float) -> bool:
        return bell.acquire(timeout=timeout)


class Reader:
    """Reads payloads, and counts what it refuses."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self._reported_at = float("-inf")

    def read(self, kind: type[M], key: str, data: bytes) -> M | None:
        try:
            return decode(data, kind)
        except MessageError as error:
            self.refuse(key, str(error))
            return None

    def refuse(self, key: str, why: str) -> None:
        """Count what was refused, and now and then report it."""
        if len(self.refused) < REFUSED_KEYS or key in self.refused:
            self.refused[key] += 1
        now = time.monotonic()
        if now - self._reported_at >= REPORT_S:
            self._reported_at = now
            words = line(f"refused on {key}: {why} ({self.refused.total()} refused so far)")
            logger.warning("%s", words)
