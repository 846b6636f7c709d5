"""All that the processes of a virtual society send, as kinds of Zenoh messages with keys."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest

from armadico.core.messages import Message
from armadico.keys.rights import Does
from armadico.launch.client import Client
from armadico.mesh.virtual import VirtualMesh
from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import Place
from armadico.mesh.virtual_queries import Queries


class Sent(NamedTuple):
    """One kind of message of one process on a key of its namespace."""

    namespace: str
    process: str  # an agent's name, or "client"
    does: Does
    key: str


class Traffic:
    """The set of what was sent, without repetitions.

    Attributes:
        sent: Everything that the live mesh would send for it.
        instances: Of the processes' agents.
    """

    def __init__(self) -> None:
        self.sent: set[Sent] = set()
        self.nodes: list[Node] = []

    def note(self, place: Place | None, namespace: str, does: Does, key: str) -> None:
        if place is None:
            self.sent.add(Sent(namespace, "client", does, key))
        elif not place.is_router:
            self.sent.add(Sent(place.namespace, place.name, does, key))

    def finish(self) -> None:
        """Add what each process declares when it joins."""
        for node in self.nodes:
            for to in node.driver.kernel.subscriptions:
                self.note(node, "", Does.SUBSCRIBE, to.pattern)
            for key in node.driver.queries:
                self.note(node, "", Does.ANSWER, key)


@contextmanager
def recorded() -> Iterator[Traffic]:
    """Record all virtual meshes of the block."""
    traffic = Traffic()
    with pytest.MonkeyPatch.context() as patch:
        spread, put, reply = VirtualMesh.spread, Queries.put, Queries.reply
        announce, add = Place.announce, VirtualMesh.add
        listen = Client._listen

        def _spread(
            mesh: VirtualMesh,
            sender: str,
            key: str,
            message: Message,
            publisher: Place | None,
            namespace: str = "robot1",
        ) -> str:
            traffic.note(publisher, namespace, Does.PUT, key)
            return spread(mesh, sender, key, message, publisher, namespace)

        def _put(queries: Queries, client: Place | None, key: str, *more: Any) -> None:
            namespace = more[4] if len(more) > 4 else "robot1"
            traffic.note(client, namespace, Does.QUERY, key)
            put(queries, client, key, *more)

        def _reply(queries: Queries, place: Place, number: int, key: str, message: Message) -> None:
            traffic.note(place, "", Does.REPLY, key)
            reply(queries, place, number, key, message)

        def _announce(place: Place, name: str, instance: str) -> None:
            traffic.note(place, "", Does.TOKEN, f"agent/{name}/{instance}")
            announce(place, name, instance)

        def _add(mesh: VirtualMesh, *arguments: Any, **more: Any) -> Node:
            node = add(mesh, *arguments, **more)
            traffic.nodes.append(node)
            return node

        patch.setattr(VirtualMesh, "spread", _spread)
        patch.setattr(VirtualMesh, "add", _add)
        patch.setattr(Queries, "put", _put)
        patch.setattr(Queries, "reply", _reply)
        patch.setattr(Place, "announce", _announce)
        yield traffic
        traffic.finish()
        del listen
