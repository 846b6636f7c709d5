"""The interface of a mesh for clients and hosts of agents.

`zenoh` connects processes; `virtual_session` works in one thread under a virtual clock. The
interface includes the time, because waiting advances a virtual clock. The same tests run on both.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from armadico.core.membership import agent_of
from armadico.core.messages import Message, MessageError, decode, line
from armadico.core.services import keys_of, service_of

logger = logging.getLogger("armadico.mesh")

M = TypeVar("M", bound=Message)

Receiver = Callable[[str, bytes], None]
"""Called with a key and a payload on a thread of the mesh; must return soon."""

REPORT_S: Final = 5.0  # shortest time between two reports of rejected payloads, s
REFUSED_KEYS: Final = 1000  # keys whose rejected payloads are counted separately


class Bell(Protocol):
    """A lock that is open while it rings; waiting for it acquires it."""

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Return whether it rang before the timeout, s."""

    def locked(self) -> bool:
        """Return whether it is not ringing."""


class Time(Protocol):
    def now(self) -> float:
        """Return a monotonic time, s."""

    def wait(self, bell: Bell, timeout: float) -> bool:
        """Wait until a bell rings; False after the timeout, s. Below 0: without a timeout."""


class Call(Protocol):
    """A received query. It may stay unanswered."""

    key: str
    payload: bytes

    def reply(self, key: str, message: Message) -> None:
        """Send the only reply, from a key that the query's key matches."""


class Mesh(Time, Protocol):
    """One process's session on a mesh, within one robot's namespace."""

    namespace: str
    guest: str
    """The id of a program that publishes here and is no agent: the last part of shared keys."""

    closed: bool
    """Whether only processes with an identity join. Then none has an older protocol."""

    refused: Counter[str]
    """Payloads that were no message or were published by a wildcard, counted by key."""

    def wait_joined(self, timeout: float) -> bool:
        """Return whether it was linked to its router within `timeout` (s)."""

    def publish(self, key: str, message: Message, data: bytes | None = None) -> None:
        """Publish a message, as `data` if it is encoded already; not to one's own subscriptions.

        Messages of one process arrive in order. Raises MessageError if it could not be decoded.
        """

    def is_declared(self, key: str) -> bool:
        """Return whether publishing on a key only sends, without a declaration before."""

    def subscribe(self, pattern: str, receiver: Receiver) -> None:
        """Call the receiver with publications on the keys of a pattern."""

    def query(
        self,
        key: str,
        request: Message,
        timeout: float,
        each: Receiver,
        done: Callable[[], None],
    ) -> None:
        """Send a query, to all that answer on the keys of `key`, which may be a pattern.

        `each` is called with each reply, and `done` once after the last one: all have replied, none
        could, or the timeout (s) is over.
        """

    def answer(self, key: str, receiver: Callable[[Call], None]) -> None:
        """Call the receiver with the queries on a key."""

    def declare_alive(self, name: str, instance: str) -> None:
        """Declare an agent's liveliness token until the mesh is left."""

    def watch_alive(self, changed: Callable[[str, str, bool], None]) -> None:
        """Subscribe to others' liveliness tokens, as (name, instance, alive), with present ones.

        A token may be reported twice: treat them as a set. No agent is reported as gone while the
        robot's router cannot be reached (`presence`).
        """

    @property
    def reachable(self) -> bool:
        """Whether the robot's router can be reached."""

    def watch_router(self, changed: Callable[[bool], None]) -> None:
        """Report whether the robot's router can be reached, now and at each change."""

    def read(self, kind: type[M], key: str, data: bytes) -> M | None:
        """Return the message in a payload; None if it is rejected, which is counted and logged."""

    def close(self) -> bool:
        """Leave; False if that continues in the background. Earlier publications still arrive."""


def publish(mesh: Mesh, message: Message) -> None:
    """Publish a guest's message on its service's keys.

    Raises MessageError if it could not be decoded.
    """
    own, *older = keys_of(message, mesh.guest)
    for key in (own,) if mesh.closed else (own, *older):
        mesh.publish(key, message)


def asked_on(mesh: Mesh, request: Message) -> str:
    """Return the key on which a guest sends a query: with keys it may name the guest's identity."""
    identity = agent_of(mesh.guest) if mesh.closed else ""
    return service_of(type(request)).asked_by(identity)


class Monotonic:
    def now(self) -> float:
        return time.monotonic()

    def wait(self, bell: Bell, timeout: float) -> bool:
        return bell.acquire(timeout=timeout)


class Reader:
    """Decodes payloads and counts the rejected ones."""

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
        """Count a rejected payload; log it at intervals."""
        if len(self.refused) < REFUSED_KEYS or key in self.refused:
            self.refused[key] += 1
        now = time.monotonic()
        if now - self._reported_at >= REPORT_S:
            self._reported_at = now
            words = line(f"refused on {key}: {why} ({self.refused.total()} refused so far)")
            logger.warning("%s", words)
