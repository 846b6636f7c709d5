"""All that the processes of a virtual society send, as kinds of Zenoh messages with keys."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest

from armadico.core.messages import OLDEST, Message
from armadico.core.services import parent, service_at
from armadico.keys.rights import Does
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual import VirtualMesh
from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import CLIENT, Place
from armadico.mesh.virtual_queries import Queries
from armadico.mobile.messages import Truth
from tests.keys.members import ANNA, LAB, everybody


class Sent(NamedTuple):
    """One kind of message of one identity on a key of its namespace."""

    namespace: str
    identity: str
    does: Does
    key: str

    @property
    def is_allowed(self) -> bool:
        rights = everybody(self.namespace)
        return rights.why(self.identity, self.does, self.key) is not None


class Traffic:
    """What clients of the robots' routers have sent, without repetitions."""

    def __init__(self) -> None:
        self.sent: set[Sent] = set()
        self.nodes: list[Node] = []

    def note(self, place: Place | None, namespace: str, does: Does, key: str) -> None:
        if place is not None and place.is_router:
            return
        space = namespace if place is None else place.namespace
        name = CLIENT if place is None else place.name.partition("@")[0]
        identity = {CLIENT: ANNA, "wakeup": LAB}.get(name, name)
        # The virtual mesh's guests are all called alike.
        key = re.sub(rf"/(guest-)?{CLIENT}$", f"/{ANNA}-1f", key)
        self.sent.add(Sent(space, identity, does, key))

    def finish(self) -> None:
        """Add what each process declares when it joins."""
        for node in self.nodes:
            for to in node.driver.kernel.subscriptions:
                self.note(node, "", Does.SUBSCRIBE, to.pattern)
            for key in node.driver.queries:
                self.note(node, "", Does.ANSWER, key)

    @property
    def refused(self) -> list[str]:
        """What the router would refuse."""
        return sorted(
            f"{sent.identity} {sent.does.value} {sent.key}"
            for sent in self.sent
            if not sent.is_allowed
        )


def _is_guest(publisher: Place | None) -> bool:
    return publisher is None or publisher.name == CLIENT


def _is_of_an_older_protocol(key: str) -> bool:
    """Whether a guest publishes a copy on it that it leaves out in a society with keys."""
    service = service_at(key)
    return service is not None and service.since > OLDEST and key == parent(service.pattern)


@contextmanager
def recorded() -> Iterator[Traffic]:
    """Record all virtual meshes of the block."""
    traffic = Traffic()
    with pytest.MonkeyPatch.context() as patch:
        spread, put, reply = VirtualMesh.spread, Queries.put, Queries.reply
        announce, add = Place.announce, VirtualMesh.add

        def _spread(
            mesh: VirtualMesh,
            sender: str,
            key: str,
            message: Message,
            publisher: Place | None,
            namespace: str = DEFAULT_NAMESPACE,
        ) -> str:
            if type(message) is Truth:
                traffic.sent.add(Sent(namespace, "simulator", Does.PUT, key))
            elif not (_is_guest(publisher) and _is_of_an_older_protocol(key)):
                traffic.note(publisher, namespace, Does.PUT, key)
            return spread(mesh, sender, key, message, publisher, namespace)

        def _put(queries: Queries, client: Place | None, key: str, *more: Any) -> None:
            traffic.note(client, more[4] if len(more) > 4 else DEFAULT_NAMESPACE, Does.QUERY, key)
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
