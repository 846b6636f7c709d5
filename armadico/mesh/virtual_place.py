"""A process on the virtual mesh, as the network sees it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Any, Final

from armadico.core.messages import Message
from armadico.mesh.presence import Presence
from armadico.mesh.topology import DEFAULT_NAMESPACE

if TYPE_CHECKING:
    from armadico.mesh.virtual import VirtualMesh

CLIENT: Final = "client"
"""The name of those who publish or query from outside the society."""

Step = Callable[[Any, Any], None]
"""What happens at a time."""


def address(namespace: str, name: str) -> str:
    """What a process is called among all robots': by its name alone where there is one robot."""
    return name if namespace == DEFAULT_NAMESPACE else f"{namespace}/{name}"


class Place:
    """A process on the mesh, as the network sees it."""

    def __init__(self, mesh: VirtualMesh, namespace: str, name: str) -> None:
        self.namespace = namespace
        self.name = name
        self.address = address(namespace, name)  # by which its links are known
        self.alive = True
        self.hung = False
        self.lost = False  # hung for longer than the lease, and not found again yet
        self.tokens: list[tuple[str, str]] = []  # (name, instance) of those that can be seen
        self.mesh = mesh
        self.uplink: object = None  # what it is linked to: who has the same reaches it
        self.presence = Presence(self.tell, self.tell_router, reachable=True)
        self._look_at = inf

    @property
    def is_router(self) -> bool:
        """Whether it is a robot's process."""
        return False

    def see(self, name: str, instance: str, there: bool) -> None:
        """A token has come, or gone."""
        self.presence.token(name, instance, there)
        self.mind_presence()

    def mind_presence(self) -> None:
        """See that it looks again when that is due."""
        due = self.presence.due
        if due < self._look_at:
            self._look_at = due
            self.mesh.call_at(due, self._look, due)

    def _look(self, due: float, _: Any) -> None:
        if due == self._look_at:
            self._look_at = inf
            if self.alive:
                self.presence.look(self.mesh.now)
                self.mind_presence()

    def listeners(self) -> list[tuple[str, Step, Any]]:
        """The patterns that it listens to, what takes a delivery, and as what."""
        raise NotImplementedError

    def queried(self, pattern: str) -> list[Any]:
        """What of it answers queries on the keys of a pattern."""
        raise NotImplementedError

    def asked(self, one: Any, what: tuple[str, Message, int]) -> None:
        """One of them takes a query: the key asked for, the request, and the query's number."""
        raise NotImplementedError

    def tell(self, name: str, instance: str, alive: bool) -> None:
        """Take the news of a token."""
        raise NotImplementedError

    def tell_router(self, there: bool) -> None:
        """Take the news that the robot's router can be reached, or cannot."""
        raise NotImplementedError

    def unsent(self, key: str, why: str) -> None:
        """Something was not sent."""

    def refuse(self, _: Any, what: tuple[str, Message]) -> None:
        """Something was published by a wildcard: nobody takes it."""

    def show(self, name: str, instance: str) -> None:
        self.tokens.append((name, instance))
        self.mesh.liveliness.join(self, name, instance)

    def kill(self) -> None:
        """SIGKILL: it publishes nothing more, and its tokens go."""
        self.alive = False
        self.mesh.forget_routes()
        self.mesh.liveliness.killed(self)


Route = tuple[Place, Step, Any]
"""Who receives, what takes it, and as what."""
