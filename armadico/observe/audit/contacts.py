"""Contacts: by the simulator's count where there is one, else by the robot's own feeling."""

from __future__ import annotations

from collections.abc import Iterator

from armadico.core.messages import Message, RobotState
from armadico.mobile.messages import Truth
from armadico.observe.audit.promises import Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene


class Touched(Rule):
    """Nothing is touched.

    The simulator's truth counts contacts; those of people who walk into the robot are not its own.
    A robot without a truth feels some: by stall bits, bumpers, or wheels that do not turn. That it
    felt none is not known to be none.
    """

    promise = Promise.COLLISION
    needs = (RobotState, Truth)

    def __init__(self) -> None:
        super().__init__()
        self._truth: Truth | None = None

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, Truth):
            before, self._truth, self.checked = self._truth, message, True
            if before is None:
                return
            new = message.collisions - message.bumped - (before.collisions - before.bumped)
            at = f"at ({message.x:.2f}, {message.y:.2f}), {message.v:.2f} m/s"
            for _ in range(new):
                yield self.found(now, now.who, "it touched something", at)
        elif isinstance(message, RobotState) and self._truth is None:
            felt = now.before is not None and now.before.stalled
            if message.stalled and not felt:
                touch = message.touch
                at = "" if touch is None else f"at ({touch.x:.2f}, {touch.y:.2f}) on its edge"
                yield self.found(now, now.who, "it touched something, or is held", at)
