"""A hand that drives the robot for a while, by a stick, and lets go: orderly, or without a word."""

from __future__ import annotations

from random import Random
from typing import Final

from armadico.core.messages import Message, RobotState
from armadico.launch.virtual import Rehearsal
from armadico.watch.teleop.messages import Stick

PERIOD_S: Final = 0.1
ON_S: Final = (1.0, 8.0)
"""How long the hand is on the stick."""

OFF_S: Final = (5.0, 25.0)
TURNS_S: Final = 1.5
"""The hand moves the stick this often on average."""

SILENT: Final = 0.3
"""The share of releases without a message, as by a page that is closed."""


class Hand:
    """Publishes a stick's positions at random times, from a stream of its own."""

    def __init__(self, rehearsal: Rehearsal, seed: int) -> None:
        self._mesh, self._rng = rehearsal.mesh, Random(f"hand/{seed}")
        self._state: RobotState | None = None
        self._number = self._held = 0
        self._until = self._mesh.now
        self._v = self._w = 0.0
        self._mesh.watch(self._on_state, RobotState)
        self._mesh.call_at(self._mesh.now + self._rng.uniform(*OFF_S), self._grip)

    def _on_state(self, _key: str, message: Message, _now: float) -> None:
        assert isinstance(message, RobotState)
        self._state = message

    def _grip(self, _a: object = None, _b: object = None) -> None:
        self._held += 1
        self._until = self._mesh.now + self._rng.uniform(*ON_S)
        self._v, self._w = self._draw()
        self._hold()

    def _hold(self, _a: object = None, _b: object = None) -> None:
        now = self._mesh.now
        if now >= self._until:
            if self._rng.random() >= SILENT:
                self._publish(0.0, 0.0, held=False)
            self._mesh.call_at(now + self._rng.uniform(*OFF_S), self._grip)
            return
        if self._rng.random() < PERIOD_S / TURNS_S:
            self._v, self._w = self._draw()
        self._publish(self._v, self._w, held=True)
        self._mesh.call_at(now + PERIOD_S, self._hold)

    def _draw(self) -> tuple[float, float]:
        return self._rng.uniform(-0.5, 1.0), self._rng.choice((0.0, self._rng.uniform(-1.0, 1.0)))

    def _publish(self, v: float, w: float, *, held: bool) -> None:
        if self._state is not None:
            self._number += 1
            hand = f"hand-{self._held}"
            self._mesh.publish(Stick(self._state.cycle, hand, self._number, v, w, held))
