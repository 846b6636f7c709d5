"""A guest's session on the virtual mesh."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import inf
from typing import Self

from armadico.core.messages import M, Message, encode
from armadico.core.services import matches
from armadico.mesh.base import Bell, Call, Reader, Receiver
from armadico.mesh.topology import DEFAULT_NAMESPACE, MeshError
from armadico.mesh.virtual import VirtualMesh
from armadico.mesh.virtual_clock import Step
from armadico.mesh.virtual_place import CLIENT, Place, guest


class VirtualSession(Place):
    """A guest's session on a virtual mesh: a `Mesh`. Waiting on it advances the clock."""

    def __init__(
        self, mesh: VirtualMesh, namespace: str = DEFAULT_NAMESPACE, name: str = CLIENT
    ) -> None:
        """Join; the name identifies its links."""
        super().__init__(mesh, namespace, name)
        self.guest = guest(name)
        self.closed = False
        self._reader = Reader()
        self.refused: Counter[str] = self._reader.refused
        self._listeners: list[tuple[str, Step, object]] = []
        self._answers: list[tuple[str, Callable[[Call], None]]] = []
        self._changed: list[Callable[[str, str, bool], None]] = []
        self._router_changed: list[Callable[[bool], None]] = []
        mesh.add_place(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # A mesh --------------------------------------------------------------------------------------

    def now(self) -> float:
        return self.mesh.now

    def wait(self, bell: Bell, timeout: float) -> bool:
        """See `Mesh`. Raises `MeshError` if it would wait forever."""
        if bell.locked():
            until = inf if timeout < 0.0 else self.mesh.now + timeout
            self.mesh.run(until, lambda: not bell.locked())
            if until == inf and bell.locked():
                raise MeshError("nothing more will ever happen on this mesh")
        return bell.acquire(blocking=False)

    def publish(self, key: str, message: Message, data: bytes | None = None) -> None:  # noqa: ARG002
        self._joined()
        encode(message)
        self.mesh.spread(self.address, key, message, self)

    def is_declared(self, key: str) -> bool:  # noqa: ARG002
        return True

    def subscribe(self, pattern: str, receiver: Receiver) -> None:
        self._joined()
        self._listeners.append((pattern, self._deliver, receiver))
        self.mesh.forget_routes()

    def query(
        self,
        key: str,
        request: Message,
        timeout: float,
        each: Receiver,
        done: Callable[[], None],
    ) -> None:
        self._joined()
        encode(request)

        def on_reply(where: str, message: Message) -> bool:
            if self.alive:
                each(where, encode(message))
            return False

        self.mesh.queries.put(
            self, key, request, timeout, on_reply, lambda: done() if self.alive else None
        )

    def answer(self, key: str, receiver: Callable[[Call], None]) -> None:
        self._joined()
        self._answers.append((key, receiver))

    def declare_alive(self, name: str, instance: str) -> None:
        self._joined()
        self.announce(name, instance)

    def watch_alive(self, changed: Callable[[str, str, bool], None]) -> None:
        self._joined()
        self._changed.append(changed)
        self.mesh.liveliness.introduce(self)

    @property
    def reachable(self) -> bool:
        return self.presence.reachable

    def watch_router(self, changed: Callable[[bool], None]) -> None:
        self._router_changed.append(changed)
        changed(self.reachable)

    def wait_joined(self, timeout: float) -> bool:  # noqa: ARG002
        return True

    def read(self, kind: type[M], key: str, data: bytes) -> M | None:
        return self._reader.read(kind, key, data)

    def close(self) -> bool:
        if self.alive:
            self.kill()
        return True

    def _joined(self) -> None:
        if not self.alive:
            raise MeshError("the mesh has been left")

    # A place -------------------------------------------------------------------------------------

    def listeners(self) -> list[tuple[str, Step, object]]:
        return self._listeners

    def _deliver(self, receiver: Receiver, what: tuple[str, Message | bytes]) -> None:
        if self.alive:
            key, message = what
            receiver(key, message if isinstance(message, bytes) else encode(message))

    def refuse(self, _: object, what: tuple[str, Message]) -> None:
        self._reader.refuse(what[0], "published by wildcard")

    def queryables(self, pattern: str) -> list[Callable[[Call], None]]:
        return [receiver for key, receiver in self._answers if matches(pattern, key)]

    def on_query(self, queryable: Callable[[Call], None], what: tuple[str, Message, int]) -> None:
        if self.alive:
            queryable(VirtualCall(self, what[0], encode(what[1]), what[2]))

    def on_token(self, name: str, instance: str, alive: bool) -> None:
        for changed in self._changed:
            changed(name, instance, alive)

    def on_router(self, there: bool) -> None:
        for changed in self._router_changed:
            changed(there)


class VirtualCall:
    """A `Call` on a guest."""

    def __init__(self, session: VirtualSession, key: str, payload: bytes, number: int) -> None:
        self._session = session
        self.key = key
        self.payload = payload
        self._number = number

    def reply(self, key: str, message: Message) -> None:
        encode(message)
        self._session.mesh.queries.reply(self._session, self._number, key, message)
