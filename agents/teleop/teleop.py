"""The teleop agent: drives as a hand on a stick says, and lets go when that falls silent."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.methods.controllers import ramp
from armadico.agents.teleop.messages import Stick, TeleopStatus
from armadico.core import agent
from armadico.core.agent import WARNING
from armadico.core.exchange import Bid
from armadico.core.messages import Description, Message, RobotState, line
from armadico.core.parameters import Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.motion import Speeds
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.safety import limit

UTILITY: Final = 1.0
"""While a hand is on the stick: as much as there is. Others offer less meanwhile, unless something
is about to be touched (`Behaviour.bid`)."""

LETTING_GO: Final = 0.3
"""From when the hand is off until the wheels rest: less than who follows a trajectory bids, so that
they take over from the speeds that the robot has, and more than nothing, so that it brakes as it
was driven where nobody does."""

REPORT_S: Final = 1.0
"""The status is published so often while nobody drives."""

LATE_S: Final = 1.0
"""A stick with no greater number than the last one of the same hand is out of order for so long;
later it is that of a hand that was started again under its old name."""

WAITING: Final = 8
"""Hands that are told of as waiting, at the most."""

SLOWER: Final = 0.01
"""Below the stick's speed by more than this (m/s, rad/s), something is in the way."""

Speed = Annotated[float, Meta(gt=0, le=10)]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """What a whole deflection of the stick stands for, and how long a silent hand has it.

    Backwards it drives slowly: most robots sense little there.
    """

    v_max: Speed = 0.5  # m/s
    v_back: Speed = 0.15
    w_max: Annotated[float, Meta(gt=0, le=10)] = 0.8  # rad/s
    silent_s: Annotated[float, Meta(ge=0.2, le=2)] = 0.5
    safety: Safety = Safety(slow=0.12)  # slowly, one may drive up to things


class Teleop(Behaviour):
    """Contends for the wheels while a hand is on the stick, as every behaviour does.

    It needs neither a mission nor a pose: by hand a robot is driven that is lost, too. So an
    uncertain pose does not cap its speed, as it does that of other behaviours. It needs obstacles:
    nobody drives blind. What the stick says is ramped as the robot's controller does it, and slowed
    down until it can be stopped before what is near.
    """

    name = "teleop"
    alone = True  # two would obey one stick
    reacts_to = Obstacles
    needs: ClassVar[tuple[type[Message], ...]] = (Obstacles,)
    hears: ClassVar[tuple[type[Message], ...]] = (Stick, Description)
    provides: ClassVar[tuple[type[Message], ...]] = (TeleopStatus,)
    needs_goal: ClassVar[bool] = False
    parameters = Parameters
    changeable: ClassVar = {
        "v_max": "m/s",
        "v_back": "m/s",
        "w_max": "rad/s",
        "safety.margin_m": "m",
    }
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._hand = ""  # whose hand is on the stick
        self._stick: Stick | None = None  # its newest, or the last one's
        self._heard_at = 0.0
        self._waiting: dict[str, float] = {}  # hands that want it too, and when they last said so
        self._commanded: Speeds = (0.0, 0.0)
        self._slower = ""
        self._told = ("", float("-inf"))  # whose hand it was, and when

    def on_stick(self, stick: Stick) -> None:
        """The first hand has it, until it lets go or falls silent."""
        self._check()
        last = self._stick
        if self._hand not in ("", stick.hand):
            self._wait(stick)
            return
        if last is not None and last.hand == stick.hand:
            if stick.number <= last.number and self.now - self._heard_at < LATE_S:
                return
        elif stick.held:
            self.log(line(f"{stick.hand} has the stick"))
        self._waiting.pop(stick.hand, None)
        self._hand = stick.hand if stick.held else ""
        self._stick, self._heard_at = stick, self.now

    def on_robot_state(self, state: RobotState) -> None:
        super().on_robot_state(state)
        self._check()
        hand, at = self._told
        if self._hand or hand or self.now - at >= REPORT_S:
            self._tell(state)

    def bid(self, message: Any) -> Bid | None:  # noqa: ARG002 - obstacles start the turn
        """What the stick says, as far as it is safe; with no hand on it, to rest."""
        self._check()
        holds = self.holds(WHEELS)
        before = self._commanded if holds else self.measured
        self._commanded, self._slower = (0.0, 0.0), ""
        if self._body is None:
            self.why = "no robot/description"
            return None
        if not self._hand and (not holds or before == (0.0, 0.0)):
            self.why = "no hand is on the stick"
            return None
        obstacles = self.fresh(Obstacles)
        assert obstacles is not None, "the pattern lets nobody bid without what it needs"
        v, w = self._ramped(before, self._wish())
        safe = limit(v, w, self.scene(obstacles), self.p.safety)
        if abs(v - safe.v) > SLOWER or abs(w - safe.w) > SLOWER:
            self._slower = "slower than the stick says: something is in the way"
        self._commanded = safe.v, safe.w
        if not self._hand:
            return Bid(LETTING_GO, self._commanded, reason="the hand is off the stick: to rest")
        return Bid(UTILITY, self._commanded, reason=f"the hand of {self._hand}")

    # Inside --------------------------------------------------------------------------------------

    def _wish(self) -> Speeds:
        """What the stick says, m/s and rad/s; rest, if no hand is on it."""
        stick = self._stick
        if not self._hand or stick is None:
            return 0.0, 0.0
        v_max, w_max = self._most()
        back = min(self.p.v_back, v_max)
        return stick.v * (v_max if stick.v > 0.0 else back), stick.w * w_max

    def _most(self) -> Speeds:
        """What a whole deflection stands for, within what the robot can."""
        return min(self.p.v_max, self.body.v_max), min(self.p.w_max, self.body.w_max)

    def _ramped(self, before: Speeds, wish: Speeds) -> Speeds:
        """The wish, no farther from what was commanded than the robot's ramps get in a cycle."""
        body, s = self.body, self.body.cycle_s
        return (
            ramp(before[0], wish[0], body.v_accel * s, body.v_decel * s),
            ramp(before[1], wish[1], body.w_accel * s, body.w_decel * s),
        )

    def _check(self) -> None:
        """Whether the hand is silent, or still there; and who still waits."""
        if self._hand and self.now - self._heard_at > self.p.silent_s:
            self.log(line(f"{self._hand} is silent: it has the stick no more"), WARNING)
            self._hand, self._stick = "", None
        if self._waiting:
            since = self.now - self.p.silent_s
            self._waiting = {hand: at for hand, at in self._waiting.items() if at >= since}

    def _wait(self, stick: Stick) -> None:
        """Another hand wants it: it is told whose it is (`TeleopStatus`)."""
        if not stick.held:
            self._waiting.pop(stick.hand, None)
        elif stick.hand in self._waiting or len(self._waiting) < WAITING:
            if stick.hand not in self._waiting:
                self.log(line(f"{stick.hand} wants the stick, which {self._hand} has"))
            self._waiting[stick.hand] = self.now

    def _tell(self, state: RobotState) -> None:
        self._told = self._hand, self.now
        v, w = self._commanded
        v_max, w_max = (0.0, 0.0) if self._body is None else self._most()
        waits = tuple(sorted(self._waiting))
        holds = self.holds(WHEELS)
        self.publish(
            TeleopStatus(
                state.cycle, self._hand, holds, v, w, v_max, w_max, waits, self._note(holds=holds)
            )
        )

    def _note(self, *, holds: bool) -> str:
        """Why the robot does less than the stick says."""
        if (stop := self.stopped) is not None:
            return line(f"stopped by {stop.who}")
        if not self._hand:
            return ""
        last = self.bids[-1] if self.bids else None
        if last is not None and last.utility is None:
            return last.reason
        if not holds:
            ack = self.acked(WHEELS)
            who = None if ack is None or ack.obeyed is None else ack.obeyed.instance
            return line(f"{who} has the wheels") if who and who != self.instance else ""
        return self._slower
