"""Contacts: by the simulator's count where there is one, else by the robot's own feeling."""

from __future__ import annotations

from collections.abc import Iterator

from armadico.core.messages import RobotState
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
    sees = (RobotState, Truth)

    def __init__(self) -> None:
        super().__init__()
        self.checked = True  # whatever it does, it may touch
        self._truth: Truth | None = None

    @property
    def pending(self) -> str:
        return "no Truth received" if self._truth is None else ""

    @property
    def due(self) -> bool:
        return self._truth is None

    def on_truth(self, truth: Truth, now: Scene) -> Iterator[Finding]:
        before, self._truth = self._truth, truth
        if before is None:
            return
        new = truth.collisions - truth.bumped - (before.collisions - before.bumped)
        at = f"at ({truth.x:.2f}, {truth.y:.2f}), {truth.v:.2f} m/s"
        for _ in range(new):
            yield self.found(now, now.who, "it touched something", at)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        felt = now.before is not None and now.before.stalled
        if self._truth is None and state.stalled and not felt:
            touch = state.touch
            at = "" if touch is None else f"at ({touch.x:.2f}, {touch.y:.2f}) on its edge"
            yield self.found(now, now.who, "it touched something, or is held", at)
