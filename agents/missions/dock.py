"""The dock agent: drives the robot into the dock that the charger names, and out of it (3.6.4)."""

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
    """How it drives in, and how near it goes.

    At the speeds that it drives a small margin will do: what is driven up to is a wall.
    """

    v: Speed = 0.12  # m/s
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    gain: Gain = 0.6  # m/s for a metre that is left
    v_least: Speed = 0.03
    there_m: Annotated[float, Meta(ge=0, le=0.05)] = 0.005  # so near to the dock's pose it stands
    aside: Gain = 4.0  # for a metre beside the line it heads 1/m back to it, as the arc tangent,
    head_most: Angle = radians(25)  # by no more than this
    turn: Gain = 1.5  # rad/s for a radian off that
    w_most: Angle = radians(30)  # rad/s
    beside_m: Metres = 0.2  # farther beside the line than this, or turned more, it does not drive
    turned_rad: Angle = radians(40)
    safety: Safety = Safety(slow=0.12)


class Dock(Behaviour):
    """Contends for the wheels while the charger says that the robot is to go in or out."""

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
        """Straight along the dock's line, in or out."""
        p, said = self.p, self.fresh(ChargeStatus)
        if said is None or not said.leads or said.dock is None:
            self.why = "nobody is to be charged"
            return None
        dock = (said.dock.x, said.dock.y, said.dock.theta)
        ahead, aside, turned = relative(dock, (pose.x, pose.y, pose.theta))
        turned = wrap(turned)
        if abs(aside) > p.beside_m or abs(turned) > p.turned_rad:
            self.why = f"not before the dock: {aside:.2f} m aside, {turned:.2f} rad"
            return None
        if said.state is ChargeState.LEAVING:
            v, off = -p.v, -turned
        else:
            left = -ahead - p.there_m
            v = min(p.v, max(p.gain * left, p.v_least)) if left > 0.0 else 0.0
            heading = clip(-atan(p.aside * aside), -p.head_most, p.head_most)
            off = heading - turned if v > 0.0 else 0.0
        most = min(p.v, p.v_max or inf)
        v, w = clip(v, -most, most), clip(p.turn * off, -p.w_most, p.w_most)
        v, w = self.limited(v, w, obstacles, p.safety)
        return Bid(1.0, (v, w), reason=f"{said.state.value}, {-ahead:.2f} m before it")
