"""The teleop agent: drives as a hand's stick demands, and stops when that is silent."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.agents.methods.controllers import ramp
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
from armadico.watch.teleop.messages import Stick, TeleopStatus

# The utility while a hand is on the stick. Other agents bid less meanwhile, unless a collision
# is imminent (`Behaviour.bid`).
UTILITY: Final = 1.0

# The utility from the release until the wheels rest. It is less than that of agents that follow a
# trajectory, which so take over at the robot's present speed. Without them the teleop agent brakes.
RELEASED: Final = 0.3

REPORT_S: Final = 1.0  # the period of the status while no hand drives

# For this time, a message whose number is not greater than the last one's is out of order. Later it
# comes from a hand that was restarted under the same name.
LATE_S: Final = 1.0

WAITING: Final = 8  # waiting hands that are published

SLOWER: Final = 0.01  # m/s, rad/s below the stick's speed: an obstacle slows the robot down

Speed = Annotated[float, Meta(gt=0, le=10)]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The speeds of a full deflection, and the timeout of a silent hand.

    The robot drives slowly backwards: most robots sense little there.
    """

    v_max: Speed = 0.5  # m/s
    v_back: Speed = 0.15
    w_max: Annotated[float, Meta(gt=0, le=10)] = 0.8  # rad/s
    silent_s: Annotated[float, Meta(ge=0.2, le=2)] = 0.5
    safety: Safety = Safety(slow=0.12)  # a low speed allows driving up to objects


class Teleop(Behaviour):
    """Contends for the wheels while a hand is on the stick, as every behaviour does.

    It needs neither a mission nor a pose: a lost robot can be driven by hand, too. So an uncertain
    pose does not limit its speed, as it does that of other behaviours. It does need obstacles. The
    stick's speed is ramped as in the robot's controller, and reduced so that the robot can stop
    before obstacles.
    """

    name = "teleop"
    alone = True  # two would obey one stick
    reacts_to = Obstacles
    needs: ClassVar[tuple[type[Message], ...]] = (Obstacles,)
    receives: ClassVar[tuple[type[Message], ...]] = (Stick, Description)
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

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._hand = ""  # the hand that has the stick
        self._stick: Stick | None = None  # its newest message, or the last hand's
        self._received_at = 0.0
        self._waiting: dict[str, float] = {}  # other hands, with the time of their last message
        self._commanded: Speeds = (0.0, 0.0)
        self._slower = ""
        self._reported = ("", float("-inf"))  # the hand in the last report, and its time

    def on_stick(self, stick: Stick) -> None:
        """Give the stick to the first hand, until it is released or silent."""
        self._check()
        last = self._stick
        if self._hand not in ("", stick.hand):
            self._wait(stick)
            return
        if last is not None and last.hand == stick.hand:
            if stick.number <= last.number and self.now - self._received_at < LATE_S:
                return
        elif stick.held:
            self.log(line(f"{stick.hand} has the stick"))
        self._waiting.pop(stick.hand, None)
        self._hand = stick.hand if stick.held else ""
        self._stick, self._received_at = stick, self.now

    def on_robot_state(self, state: RobotState) -> None:
        super().on_robot_state(state)
        self._check()
        hand, at = self._reported
        if self._hand or hand or self.now - at >= REPORT_S:
            self._report(state)

    def bid(self, message: object) -> Bid | None:  # noqa: ARG002 - obstacles start the turn
        """Bid the stick's speeds, as far as they are safe; without a hand, brake to rest."""
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
        assert obstacles is not None, "no behaviour bids without the messages that it needs"
        v, w = self._ramped(before, self._demand())
        self._commanded = safe_v, safe_w = limit(v, w, self.scene(obstacles), self.p.safety)
        if abs(v - safe_v) > SLOWER or abs(w - safe_w) > SLOWER:
            self._slower = "slower than the stick says: something is in the way"
        if not self._hand:
            return Bid(RELEASED, self._commanded, reason="the hand is off the stick: to rest")
        return Bid(UTILITY, self._commanded, reason=f"the hand of {self._hand}")

    # Implementation ------------------------------------------------------------------------------

    def _demand(self) -> Speeds:
        """Return the stick's speeds, m/s and rad/s; zero without a hand."""
        stick = self._stick
        if not self._hand or stick is None:
            return 0.0, 0.0
        v_max, w_max = self._most()
        back = min(self.p.v_back, v_max)
        return stick.v * (v_max if stick.v > 0.0 else back), stick.w * w_max

    def _most(self) -> Speeds:
        """Return the speeds of a full deflection, within the robot's limits."""
        return min(self.p.v_max, self.body.v_max), min(self.p.w_max, self.body.w_max)

    def _ramped(self, before: Speeds, demand: Speeds) -> Speeds:
        """Return the demand, limited by the robot's accelerations for one cycle."""
        body, s = self.body, self.body.cycle_s
        return (
            ramp(before[0], demand[0], body.v_accel * s, body.v_decel * s),
            ramp(before[1], demand[1], body.w_accel * s, body.w_decel * s),
        )

    def _check(self) -> None:
        """Remove hands that have timed out."""
        if self._hand and self.now - self._received_at > self.p.silent_s:
            self.log(line(f"{self._hand} is silent: it has lost the stick"), WARNING)
            self._hand, self._stick = "", None
        if self._waiting:
            since = self.now - self.p.silent_s
            self._waiting = {hand: at for hand, at in self._waiting.items() if at >= since}

    def _wait(self, stick: Stick) -> None:
        """Add another hand to those that wait; it sees in the status which hand drives."""
        if not stick.held:
            self._waiting.pop(stick.hand, None)
        elif stick.hand in self._waiting or len(self._waiting) < WAITING:
            if stick.hand not in self._waiting:
                self.log(line(f"{stick.hand} wants the stick, which {self._hand} has"))
            self._waiting[stick.hand] = self.now

    def _report(self, state: RobotState) -> None:
        self._reported = self._hand, self.now
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
        """Return why the robot is slower than the stick demands."""
        if (stop := self.stopped) is not None:
            return line(f"stopped by {stop.requester}")
        if not self._hand:
            return ""
        last = self.kernel.bids[-1] if self.kernel.bids else None
        if last is not None and last.utility is None:
            return last.reason
        if not holds:
            ack = self.acked(WHEELS)
            holder = None if ack is None or ack.obeyed is None else ack.obeyed.instance
            return line(f"{holder} has the wheels") if holder not in (None, self.instance) else ""
        return self._slower
