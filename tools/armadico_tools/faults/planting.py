"""How a defect is planted in an agent that has joined."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from armadico.core.messages import Message

M = TypeVar("M")


class Defect(NamedTuple):
    """What is planted, by agent."""

    text: str
    plants: Mapping[str, Callable[[Any], None]]


def wrap(owner: Any, name: str, by: Callable[..., Any]) -> None:
    """Replace a method of one object by a function of the method and its arguments."""
    method = getattr(owner, name)
    vars(owner)[name] = lambda *args, **named: by(method, *args, **named)


def publishes(agent: Any, kind: type[M], change: Callable[[M], M]) -> None:
    """Change the messages of a kind that an agent publishes."""

    def publish(method: Callable[..., None], message: Message) -> None:
        method(change(message) if isinstance(message, kind) else message)

    wrap(agent, "publish", publish)


class Late(Generic[M]):
    """Values that come some cycles late; at first the oldest one."""

    def __init__(self, cycles: int) -> None:
        self._cycles = cycles
        self._kept: deque[M] = deque()

    def of(self, newest: M) -> M:
        self._kept.append(newest)
        return self._kept.popleft() if len(self._kept) > self._cycles else self._kept[0]
