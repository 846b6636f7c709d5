"""The latched stop (emergency stop), as tools publish it.

A stop is published repeatedly until the robot agent's states show it, and go on showing it. A
release is one message about one stop; it does not end a later stop.
"""

from __future__ import annotations

from typing import Final

from armadico.core.hands import remedy
from armadico.core.messages import Cycle, RobotState, Stop, counts_beyond, next_count

HELD_S: Final = 1.0  # how long the robot's states must acknowledge a stop, s
SILENT_S: Final = 0.5  # after this time without a state, the acknowledgement begins again, s

BLIND: Final = 3  # a stop waits for a first state for so many calls of `message`
LOST: Final = 5  # after so many calls without a new state the robot agent may be another one

# Measured speeds (m/s, rad/s) up to which the wheels count as resting. Braking takes time after a
# stop.
REST_M_S: Final = 0.02
REST_RAD_S: Final = 0.1


def rests(v: float, w: float) -> bool:
    """Return whether the wheels rest at measured speeds (m/s, rad/s)."""
    return abs(v) <= REST_M_S and abs(w) <= REST_RAD_S


class Latching:
    """One stop or one release: the message to publish, and the outcome.

    Sans-IO: the robot agent's states and the time go in.
    """

    def __init__(self, *, stopped: bool, by: str, press: int, code: str | None = None) -> None:
        """Begin to stop the robot, or to release it.

        `by` is the person or program, for people; `press` the random number of this stop, or of the
        one that is released; `code` that of the only stop to release, None: any.
        """
        # The stop in the robot agent's newest state; None without a state.
        self.known: Stop | None = None
        self.latched = False  # whether the robot agent has acknowledged the stop for `HELD_S`
        self.done = False  # whether the robot is stopped and its wheels rest, or it is released
        self.refusal = ""  # why it cannot be done
        self._stopped, self._by, self._press, self._code = stopped, by, press, code
        self._release: Stop | None = None
        self._blind = 0  # calls since the last new state
        self._cycle: Cycle | None = None
        self._speeds = (0.0, 0.0)  # measured, m/s and rad/s
        self._motors = True  # on
        self._received_at = float("-inf")
        self._since: float | None = None  # acknowledged by the robot agent without a break

    def on_robot_state(self, state: RobotState, now: float) -> None:
        """Process the robot agent's newest state at a time, s; the same state counts once."""
        if state.cycle == self._cycle:
            return
        self._cycle, self.known, self._blind = state.cycle, state.stop, 0
        self._speeds, self._motors = (state.v, state.w), state.motors
        if self._stopped:
            self._update_stop(state.stop, now)
        else:
            self._update_release(state.stop)
        self._received_at = now

    def message(self) -> Stop | None:
        """Return the message to publish now, or None.

        A stop without the epoch of the robot's cycles always counts, also from an old recording. So
        it waits for the first state, for a moment. One of another epoch does not count. So it has
        none once no state arrives: the robot agent may have restarted, and have no states yet.
        """
        if not self._stopped:
            return self._release
        self._blind += 1
        if self.known is None and self._blind <= BLIND:
            return None
        known = self.known or Stop()
        ours = known.stopped and known.press == self._press
        counter = known.counter if ours else next_count(known.counter)
        return Stop(counter, True, self._by, self._press, self._epoch)

    @property
    def _epoch(self) -> int:
        return 0 if self._cycle is None or self._blind > LOST else self._cycle.epoch

    @property
    def rolling(self) -> str:
        """The speeds of the wheels, for people; "" once they rest."""
        v, w = self._speeds
        if rests(v, w):
            return ""
        return f"the wheels still turn, at {v:.2f} m/s and {w:.2f} rad/s"

    def _update_stop(self, stop: Stop, now: float) -> None:
        if not stop.stopped:
            if stop.press == self._press:  # released meanwhile: it stops again, as another one
                self._press = (self._press + 1) % 2**63
            self._since, self.latched = None, False
        elif self._since is None or now - self._received_at > SILENT_S:
            self._since, self.latched = now, False
        elif now - self._since >= HELD_S:
            self.latched = True
        self.done = self.latched and not self.rolling

    def _update_release(self, stop: Stop) -> None:
        release = self._release
        late = release is not None and counts_beyond(release.counter, stop.counter)
        if not stop.stopped:
            self.done = not late
        elif release is None and self._code not in (None, stop.code):
            self.refusal = f"it is stopped by {stop.requester} with the code {stop.code};"
            self.refusal += f" {self._code} is the code of another stop"
        elif release is None or (not late and stop.press == release.press):
            self._release = Stop(next_count(stop.counter), False, self._by, stop.press)
        elif not late:
            self.refusal = f"it was stopped again by {stop.requester}"
            if first := remedy(stop, motors=self._motors):
                self.refusal = f"{first}, then `armadico resume` again"
