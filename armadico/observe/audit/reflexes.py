"""What the robot agent lets through, compared with what its reflex has to by the same readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from math import copysign, dist, hypot
from typing import Final

from armadico.bridge.reflex import Reflex
from armadico.bridge.seen import KEPT_S, LATELY_S, NEAR_M
from armadico.config.profile import load_profile
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle, Description, RobotState, Twist
from armadico.mobile.messages import Scan, Sonar
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import AGAIN_S, Rule
from armadico.observe.audit.scene import Scene

WAITS: Final = 3
"""A cycle is judged once so many further ones have begun: readings may come after states."""

LEARNS_S: Final = LATELY_S + 1.0
"""What the robot agent knows to be free is at most so old, s, with a margin. Until then, and after
a gap, it knows what the auditor does not."""

OFF_M_S, OFF_RAD_S = 0.1, 0.2
"""Speeds that differ by more from what the reflex admits differ by more than its search's step, or
the clock of its ages."""

CLOCKS: Final = (0.97, 1.03)
"""The robot agent's clock is not known to the moment, and what it knows depends on ages. So orders
are judged by a slow clock and by a fast one, and one that either of both admits is admissible."""

OFF, OF_ORDERS = 4, 30
"""So many of so many orders are let through, or held back, against the reflex. In 15 undisturbed
drives of six robots it was one at most, while a person came near."""

REMEMBERS: Final = "it may remember obstacles beside it from before the readings received"


class Reflexes(Rule):
    """The robot agent lets through what its reflex admits, no less and no more.

    The reflex is a function of what is published: readings, odometry and orders (`bridge.reflex`).
    So the auditor applies it, too. `Earned` judges by braking distances alone, which forbid less.

    What the robot agent sensed beside itself it remembers for as long as it stays beside it. An
    auditor that did not receive its first readings thus calls no speed too low until the robot has
    left that place. After each gap in what is received it begins anew: whether a sensor was silent
    or its readings were lost is not known, nor what these showed.
    """

    promise = Promise.EARNED
    needs = (RobotState, Description)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._reflexes: tuple[Reflex, ...] = ()  # one for each clock
        self._robot = ""
        self._states: deque[RobotState] = deque(maxlen=WAITS + 1)
        self._read: dict[Cycle, tuple[Sonar | None, Scan | None]] = {}
        self._learnt_s = 0.0
        self._recalls = False  # all that the robot agent may remember
        self._first: Cycle | None = None  # of those that were received
        self._beside: tuple[float, float] | None = None  # where it may remember older obstacles
        self._over: deque[bool] = deque(maxlen=OF_ORDERS)
        self._under: deque[bool] = deque(maxlen=OF_ORDERS)
        self._unknown = ""
        self._judged = self._judged_low = False  # whether speeds were too high, and too low

    @property
    def pending(self) -> str:
        if self._unknown or self._judged_low:
            return self._unknown
        if self._judged:
            return f"speeds lower than its reflex admits: {REMEMBERS}"
        return f"no {LEARNS_S:.0f} s of readings without a gap"

    def on_sonar(self, sonar: Sonar, _: Scene) -> None:
        self._read[sonar.cycle] = sonar, self._read.get(sonar.cycle, (None, None))[1]

    def on_scan(self, scan: Scan, _: Scene) -> None:
        self._read[scan.cycle] = self._read.get(scan.cycle, (None, None))[0], scan

    def on_description(self, about: Description, _: Scene) -> None:
        if about.robot == self._robot:
            return
        self._robot, self._reflexes, self._unknown = about.robot, (), ""
        try:
            self._begin(about)
        except ConfigError:
            self._unknown, self.checked = f"the profile {about.robot} is not at hand", True

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        states, about = self._states, now.description
        if not self._reflexes or about is None:
            return
        before = states[-1].cycle if states else state.cycle
        if state.cycle.epoch != before.epoch or state.cycle.number > before.number + 1:
            self._begin(about)
        elif state.cycle.number <= before.number and states:
            return
        states.append(state)
        if len(states) <= WAITS:
            return
        here, then = states[0], states[1]
        if not self._update(here, about):
            self.checked = True
            if self._learnt_s:
                self._begin(about)
            return
        self._recall(here, about)
        if then.ordered == Twist(0.0, 0.0) or self._learnt_s < LEARNS_S:
            return
        yield from self._judge(here, then, now)

    def _begin(self, about: Description) -> None:
        """Begin anew after a gap."""
        profile = load_profile(about.robot)
        self._reflexes = tuple(Reflex(profile) for _ in CLOCKS)
        self._states.clear()
        self._read.clear()
        self._learnt_s = 0.0
        self._recalls, self._first, self._beside = False, None, None

    def _recall(self, here: RobotState, about: Description) -> None:
        """Note whether all that the robot agent may remember came since the first cycle."""
        first = self._first = self._first or here.cycle
        if self._recalls or first.number <= WAITS:  # the robot agent began then
            self._recalls = True
            return
        if (here.cycle.number - first.number) * about.cycle_s < KEPT_S:
            return
        # From now on what came before is remembered only while it is beside the robot.
        x, y = self._beside = self._beside or (here.x, here.y)
        reach = hypot(max(about.front, about.rear) + NEAR_M, about.half_width + NEAR_M)
        self._recalls = dist((x, y), (here.x, here.y)) > 2.0 * reach

    def _update(self, here: RobotState, about: Description) -> bool:
        """Add a cycle, as the robot agent does; False if readings of it were not received."""
        sonar, scan = self._read.pop(here.cycle, (None, None))
        if any({"sonar": sonar, "laser": scan}.get(name, here) is None for name in about.sensors):
            return False
        for cycle in [each for each in self._read if each.number < here.cycle.number]:
            del self._read[cycle]
        self._learnt_s += about.cycle_s
        for reflex, clock in zip(self._reflexes, CLOCKS, strict=True):
            reflex.update(
                () if sonar is None else sonar.echoes,
                (here.x, here.y, here.theta),
                (here.v, here.w),
                clock * here.cycle.number * about.cycle_s,
                scan,
                (here.admitted.v, here.admitted.w),
            )
        return True

    def _judge(self, here: RobotState, then: RobotState, now: Scene) -> Iterator[Finding]:
        assert now.description is not None, "it is described"
        v, w, top = then.ordered.v, then.ordered.w, now.description.v_max
        if abs(v) > top:
            v, w = copysign(top, v), w * top / abs(v)
        obeyed_v, obeyed_w = abs(then.admitted.v), abs(then.admitted.w)
        over = under = True
        for reflex in self._reflexes:  # the second one only if by the first one the order is off
            may_v, may_w = map(abs, reflex.cap(v, w))
            turns_more = obeyed_w > may_w + OFF_RAD_S and obeyed_v > may_v - OFF_M_S
            over = over and (obeyed_v > may_v + OFF_M_S or turns_more)
            under = under and obeyed_v < may_v - OFF_M_S
            if not (over or under):
                break
        under = under and self._recalls and not (here.stalled or then.stalled)
        self._over.append(over)
        self._under.append(under)
        self.checked = self._judged = True
        self._judged_low |= self._recalls
        if now.excuse(Excuse.DISTURBED) is not None:
            return
        orders, why = f"in {OFF} of {OF_ORDERS} orders", self._reflexes[0].why
        obeyed = f"{_so(then.admitted)} of {_so(then.ordered)}"
        if over and sum(self._over) >= OFF and self.is_new("over", now, AGAIN_S):
            evidence = f"{obeyed}; {_so(Twist(may_v, may_w))} are admissible: {why}"
            what = f"lets through what its reflex forbids, {orders}"
            yield self.found(now, "robot", what, evidence)
        if under and sum(self._under) >= OFF and self.is_new("under", now, AGAIN_S):
            evidence = f"{obeyed}; {may_v:.2f} m/s are admissible; it says: {then.capped}"
            what = f"holds back what its readings admit, {orders}"
            yield replace(self.found(now, "robot", what, evidence), promise=Promise.SPEED)


def _so(speeds: Twist) -> str:
    return f"{speeds.v:.2f} m/s, {speeds.w:.2f} rad/s"
