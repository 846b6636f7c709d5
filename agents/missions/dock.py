"""The dock agent: drives the robot into the dock named by the charger, and out again (3.6.4)."""

from __future__ import annotations

from math import atan, inf, radians
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.methods.geometry import clip
from armadico.agents.missions.messages import ChargeState, ChargeStatus
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.parameters import Safety
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.geometry import relative, wrap
from armadico.mobile.messages import Pose
from armadico.mobile.obstacles import Obstacles

Speed = Annotated[float, Meta(gt=0, le=1)]
Metres = Annotated[float, Meta(gt=0, le=1)]
Angle = Annotated[float, Meta(gt=0, le=1.5)]
Gain = Annotated[float, Meta(gt=0, le=20)]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The speeds and gains of docking.

    A small safety margin suffices at these low speeds: the robot drives up to a wall.
    """

    v: Speed = 0.12  # m/s
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    gain: Gain = 0.6  # m/s per metre of remaining distance
    v_least: Speed = 0.03
    there_m: Annotated[float, Meta(ge=0, le=0.05)] = 0.005  # it stops this near to the dock's pose
    aside: Gain = 4.0  # 1/m: tangent of the heading back to the line, per metre of offset
    head_most: Angle = radians(25)  # limit of that heading
    turn: Gain = 1.5  # rad/s per radian of heading error
    w_most: Angle = radians(30)  # rad/s
    beside_m: Metres = 0.2  # it does not drive if farther beside the line, or turned more
    turned_rad: Angle = radians(40)
    safety: Safety = Safety(slow=0.12)


class Dock(Behaviour):
    """Contends for the wheels while the charger reports that the robot is to go in or out."""

    name = "dock"
    reacts_to = Pose
    parameters = Parameters
    launched_with = ("v_max",)
    changeable: ClassVar = {
        "v_max": "m/s",
        "v": "m/s",
    }
    needs_goal: ClassVar[bool] = False
    p: Parameters

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """Follow the dock's line, in or out."""
        p, status = self.p, self.fresh(ChargeStatus)
        if status is None or not status.leads or status.dock is None:
            self.why = "no order to dock"
            return None
        dock = (status.dock.x, status.dock.y, status.dock.theta)
        ahead, aside, turned = relative(dock, (pose.x, pose.y, pose.theta))
        turned = wrap(turned)
        if abs(aside) > p.beside_m or abs(turned) > p.turned_rad:
            self.why = f"not before the dock: {aside:.2f} m aside, {turned:.2f} rad"
            return None
        if status.state is ChargeState.LEAVING:
            v, off = -p.v, -turned
        else:
            left = -ahead - p.there_m
            v = min(p.v, max(p.gain * left, p.v_least)) if left > 0.0 else 0.0
            heading = clip(-atan(p.aside * aside), -p.head_most, p.head_most)
            off = heading - turned if v > 0.0 else 0.0
        most = min(p.v, p.v_max or inf)
        v, w = clip(v, -most, most), clip(p.turn * off, -p.w_most, p.w_most)
        v, w = self.limited(v, w, obstacles, p.safety)
        return Bid(1.0, (v, w), reason=f"{status.state.value}, {-ahead:.2f} m before it")
