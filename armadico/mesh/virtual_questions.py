"""Queries on the virtual mesh: asked of whoever answers them, the first reply counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from armadico.agent import Agent, Answer, AskFor, Question
from armadico.messages import Message, decode, encode
from armadico.services import service_of

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
        self._pending[self._ids] = Pending(node, ask.id, ask.reply, then)
        request = decode(encode(ask.request), type(ask.request))
        mesh = self._mesh
        if node is None or not node.lost:
            for other in mesh.nodes:
                there = other.alive and not other.lost
                if there and answers(other.agent, ask.key, request):
                    question = Question(self._ids, request)
                    mesh.later(node.name if node else CLIENT, other, self._asked, question)
        mesh.call_at(mesh.now + ask.timeout, self._replied, self._ids, None)

    def answer(self, node: Node, answer: Answer) -> None:
        """Carry a reply back."""
        pending = self._pending.get(answer.id)
        if pending is None or node.lost:
            return
        message = decode(encode(answer.message), pending.reply)
        target = pending.node.name if pending.node else CLIENT
        at = self._mesh.link(node.name, target).arrival(self._mesh.now)
        if at is not None:
            self._mesh.call_at(at, self._replied, answer.id, message)

    def _asked(self, node: Node, question: Any) -> None:
        self._mesh.hand(node, lambda: node.agent.asked(question, node.time))

    def _replied(self, number: int, message: Message | None) -> None:
        pending = self._pending.pop(number, None)
        if pending is None:
            return
        if pending.then is not None:
            pending.then(message)
        node = pending.node
        if node is not None:
            self._mesh.hand(node, lambda: node.agent.replied(pending.id, message, node.time))


def answers(agent: Agent, key: str, request: Message) -> bool:
    """Whether an agent answers a query on a key."""
    return type(request) in agent.answers and service_of(type(request)).key == key
