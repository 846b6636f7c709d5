"""Queries on the virtual mesh: asked of whoever answers them, the first reply counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from armadico.core.agent import AskFor, Publish
from armadico.core.driver import Reply, sendable
from armadico.core.messages import Message

if TYPE_CHECKING:
    from armadico.mesh.virtual import VirtualMesh
    from armadico.mesh.virtual_node import Node

CLIENT = "client"
"""What whoever asks from outside the society is called."""

Then = Callable[[Message | None], None]


@dataclass(frozen=True)
class Pending:
    """A query that waits for its first reply."""

    node: Node | None  # who asked; None: a client, who is told by `then`
    id: int
    reply: type[Message]
    then: Then | None


class Questions:
    """Carries queries there and replies back."""

    def __init__(self, mesh: VirtualMesh) -> None:
        self._mesh = mesh
        self._pending: dict[int, Pending] = {}
        self._ids = 0

    def put(self, node: Node | None, ask: AskFor, then: Then | None = None) -> None:
        """Ask everybody who answers on that key; no reply within its time is None."""
        self._ids += 1
        mesh, number = self._mesh, self._ids
        self._pending[number] = Pending(node, ask.id, ask.reply, then)
        request = sendable(Publish(ask.key, ask.request))
        if isinstance(request, str):
            self._mesh.unsent(node, ask.key, request)
        elif node is None or not node.lost:
            for other in mesh.nodes:
                there = other.alive and not other.lost and other is not node
                if there and other.driver.answers(ask.key):
                    mesh.later(
                        node.name if node else CLIENT,
                        other,
                        self._asked,
                        (ask.key, request, number),
                    )
        mesh.call_at(mesh.now + ask.timeout, self._replied, number, None)

    def answer(self, node: Node, reply: Reply) -> None:
        """Carry a reply back."""
        pending = self._pending.get(reply.call)
        message = sendable(Publish(reply.key, reply.message))
        if isinstance(message, str):
            self._mesh.unsent(node, reply.key, message)
        if pending is None or node.lost or not isinstance(message, pending.reply):
            return
        target = pending.node.name if pending.node else CLIENT
        at = self._mesh.link(node.name, target).arrival(self._mesh.now)
        if at is not None:
            self._mesh.call_at(at, self._replied, reply.call, message)

    def _asked(self, node: Node, what: tuple[str, Message, int]) -> None:
        key, request, number = what
        self._mesh.hand(
            node, lambda: node.driver.asked(key, request, number, node.time), f"query/{key}"
        )

    def _replied(self, number: int, message: Message | None) -> None:
        pending = self._pending.pop(number, None)
        if pending is None:
            return
        if pending.then is not None:
            pending.then(message)
        node = pending.node
        if node is not None:
            self._mesh.hand(
                node,
                lambda: node.driver.replied(pending.id, message, node.time),
                f"reply/{number}",
            )
