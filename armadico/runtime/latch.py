"""The latched stop (e-stop), as tools publish it.

A stop is a state, not an edge: it is published again and again until the robot agent's own states
show it, and go on showing it. A release is one message about one stop, whoever pressed that; it
ends nothing that was pressed since.
"""

from __future__ import annotations

from typing import Final

from armadico.core.hands import remedy
from armadico.core.messages import Cycle, RobotState, Stop, counts_beyond, next_count

HELD_S: Final = 1.0
"""The robot counts as stopped once its states have acknowledged it for so long."""

SILENT_S: Final = 0.5
"""After a longer silence of the robot agent it has to acknowledge for as long again."""

REST_M_S: Final = 0.02
REST_RAD_S: Final = 0.1
"""Wheels that are measured slower than this rest: a stop is an order to brake, and braking takes
its time."""


def rests(v: float, w: float) -> bool:
    """Whether wheels that are measured at these speeds (m/s, rad/s) rest."""
    return abs(v) <= REST_M_S and abs(w) <= REST_RAD_S


class Latching:
    """One press of the stop, or the release of one: what to publish, and what came of it.

    Sans-IO: the robot agent's states and the time go in.

    Attributes:
        known: The latch by the robot agent's newest state; None if nothing is heard of it.
        latched: Whether the stop holds, by the robot agent's word.
        done: Whether the robot is stopped and its wheels rest, or is free, by that word.
        refusal: Why it cannot be done.
    """

    def __init__(self, *, stopped: bool, by: str, press: int, code: str | None = None) -> None:
        """Begin.

        Args:
            stopped: To stop the robot, or to release it.
            by: Who does, for people.
            press: What tells this stop from all others; a release has that of what it releases.
            code: Of the only stop that is to be released; None: whichever there is.
        """
        self.known: Stop | None = None
        self.latched = False
        self.done = False
        self.refusal = ""
        self._stopped, self._by, self._press, self._code = stopped, by, press, code
        self._release: Stop | None = None
        self._cycle: Cycle | None = None
        self._speeds = (0.0, 0.0)  # measured, m/s and rad/s
        self._motors = True  # on
        self._heard_at = float("-inf")
        self._since: float | None = None  # acknowledged by the robot agent without a break

    def on_robot_state(self, state: RobotState, now: float) -> None:
        """Take the robot agent's newest state at a time, s; one that was taken already is none."""
        if state.cycle == self._cycle:
            return
        self._cycle, self.known = state.cycle, state.stop
        self._speeds, self._motors = (state.v, state.w), state.motors
        if self._stopped:
            self._hear_stopped(state.stop, now)
        else:
            self._hear_released(state.stop)
        self._heard_at = now

    def message(self) -> Stop | None:
        """What to publish now; None if that is not known yet, or nothing is to be published."""
        if not self._stopped:
            return self._release
        known = self.known or Stop()
        ours = known.stopped and known.press == self._press
        counter = known.counter if ours else next_count(known.counter)
        return Stop(counter, True, self._by, self._press)

    @property
    def rolling(self) -> str:
        """How the wheels still turn, for people; "" once they rest."""
        v, w = self._speeds
        if rests(v, w):
            return ""
        return f"the wheels still turn, at {v:.2f} m/s and {w:.2f} rad/s"

    def _hear_stopped(self, stop: Stop, now: float) -> None:
        if not stop.stopped:
            self._since, self.latched = None, False
        elif self._since is None or now - self._heard_at > SILENT_S:
            self._since, self.latched = now, False
        elif now - self._since >= HELD_S:
            self.latched = True
        self.done = self.latched and not self.rolling

    def _hear_released(self, stop: Stop) -> None:
        release = self._release
        late = release is not None and counts_beyond(release.counter, stop.counter)
        if not stop.stopped:
            self.done = not late
        elif release is None and self._code not in (None, stop.code):
            self.refusal = f"it is stopped by {stop.who}, and the code of that is"
            self.refusal += f" {stop.code}: {self._code} was another stop's"
        elif release is None or (not late and stop.press == release.press):
            self._release = Stop(next_count(stop.counter), False, self._by, stop.press)
        elif not late:
            self.refusal = f"it was stopped again meanwhile, by {stop.who}"
            if first := remedy(stop, motors=self._motors):
                self.refusal = f"{first}, then `armadico resume` again"
