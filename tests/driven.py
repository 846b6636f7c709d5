"""A virtual run that a test meddles with, and what is said in it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self, TypeVar

from armadico.core.messages import Message
from armadico.core.resources import WHEELS
from armadico.launch.virtual import Rehearsal

M = TypeVar("M", bound=Message)


class Driven:
    """Keeps what is said of some kinds, with the times, s."""

    def __init__(self, run: Rehearsal, *kinds: type[Message]) -> None:
        """Nobody has started yet."""
        self.run = run
        self.mesh = run.mesh
        self.said: list[tuple[float, Message]] = []
        self.mesh.watch(self._keep, *kinds)

    def _keep(self, _key: str, message: Message, now: float) -> None:
        self.said.append((now, message))

    def begin(self) -> Self:
        """Everybody starts, and is sent to the goal."""
        self.run.start()
        self.run.begin()
        return self

    def let_pass(self, seconds: float) -> Self:
        self.mesh.run(self.mesh.now + seconds)
        return self

    def until(self, condition: Callable[[], bool], limit: float = 30.0) -> float:
        """Go on until then; how long that took, s. 0: it never came."""
        begun = self.mesh.now
        self.mesh.run(begun + limit, condition)
        return max(self.mesh.now - begun, 1e-9) if condition() else 0.0

    def of(self, kind: type[M], since: float = 0.0) -> list[M]:
        """What was said of a kind; of the wheels, where it is of a resource."""
        found = [m for at, m in self.said if type(m) is kind and at > since]
        return [m for m in found if getattr(m, "resource", WHEELS.name) == WHEELS.name]

    def last(self, kind: type[M]) -> M:
        """The newest of a kind, of whatever resource."""
        return next(m for _, m in reversed(self.said) if type(m) is kind)
