"""Agents that compete for the wheels in experiments, which measure what a mechanism makes of them.

The liar and the bystander are of no use. Visit and recharge have goals of their own, which no
trajectory leads to: what they want conflicts with the mission at the wheels.
"""

from __future__ import annotations

from math import hypot
from typing import Annotated, ClassVar, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.driving import goto
from armadico.agents.methods.utility import CHARGE_NOW, CHARGE_SOON, ramp_down
from armadico.agents.missions.messages import ChargeState, ChargeStatus
from armadico.config.worlds import DOCK_LANE_M, before, load_world
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Message, Point, RobotState
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.messages import BatteryLevel, Pose, Trajectory, Waypoint
from armadico.mobile.motion import Speeds
from armadico.mobile.obstacles import Obstacles

Share = Annotated[float, Meta(ge=0, le=1)]


class LiarParameters(agent.Parameters, frozen=True, kw_only=True):
    """The liar's parameters."""

    utility: Share = 0.99
    v: Annotated[float, Meta(ge=-2, le=2)] = 0.2  # m/s
    w: Annotated[float, Meta(ge=-5, le=5)] = 0.0  # rad/s


class Liar(Behaviour):
    """Says in each cycle that its motion, straight ahead, is nearly the best one there is."""

    name = "liar"
    parameters = LiarParameters
    p: LiarParameters

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:  # noqa: ARG002
        return Bid(self.p.utility, (self.p.v, self.p.w), reason="it says so")


class Bystander(Behaviour):
    """Bids in each cycle, by a utility drawn anew, for what goto could do as well: to go on slowly.

    It is for counting messages: a mechanism has one more contender, who seldom wins.
    """

    name = "bystander"

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:  # noqa: ARG002
        v, w = self.limited(0.1, 0.0, obstacles)
        return Bid(self.rng.uniform(0.01, 0.1), (v, w), reason="it might go on")


class SeekerParameters(goto.Parameters, frozen=True, kw_only=True):
    """Those of goto, and the map that has the goal."""

    world: Annotated[str, Meta(min_length=1)] = "empty"


class Seeker(goto.Goto):
    """Drives as goto does, on a way of its own: straight to a goal that is on the map."""

    parameters = SeekerParameters
    launched_with = (*goto.Goto.launched_with, "world")
    needs_goal: ClassVar[bool] = False
    p: SeekerParameters

    def __init__(
        self, identity: agent.Identity, parameters: SeekerParameters | None = None
    ) -> None:
        super().__init__(identity, parameters)
        self._ways = 0

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """The mission's way is not its own."""

    def seek(self, pose: Pose, *waypoints: Waypoint) -> None:
        """Begin a way of its own, here."""
        self._ways += 1
        here = Point(pose.x, pose.y)
        way = Trajectory(self._ways, 0, waypoints, here, revision=pose.revision)
        super().on_trajectory(way)

    def forget(self, pose: Pose) -> None:
        """End its way."""
        if self.route.waypoints:
            self.seek(pose)


PLACE: Final = "place"
"""The name on the map of the place that is worth a visit."""

VISITED_M: Final = 0.25
"""Within this of it, the place has been visited."""


class VisitParameters(SeekerParameters, frozen=True, kw_only=True):
    """Equation 3.6, as goto's, over a longer distance: the place is worth more the nearer it is.

    It bids less than avoid does for a robot that is stuck.
    """

    p_max: Share = 0.9
    u_low_m: goto.Metres = 0.5
    u_high_m: goto.Metres = 2.5  # from farther away it does not want to go there


class Visit(Seeker):
    """Wants to pass a place that is worth a visit, once, when the robot comes near it."""

    name = "visit"
    parameters = VisitParameters
    p: VisitParameters

    def __init__(self, identity: agent.Identity, parameters: VisitParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._place = load_world(self.p.world).goals.get(PLACE)
        self._visited = False

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """The speeds to the place."""
        if self._place is None or self._visited:
            self.why = "the place has been visited" if self._visited else "no place on the map"
            return None
        off = hypot(self._place[0] - pose.x, self._place[1] - pose.y)
        self._visited = off <= VISITED_M
        if off > self.p.u_high_m or self._visited:
            self.why = f"the place is {off:.2f} m away"
            self.forget(pose)
            return None
        if not self.route.waypoints:
            self.seek(pose, Waypoint(*self._place))
        return super().propose(pose, obstacles)

    def vector(self, bid: Bid | None) -> Speeds:
        """Towards the place, as long from everywhere: goto's gets shorter within `u_high_m`."""
        x, y = super().vector(bid)
        length = hypot(x, y) or 1.0
        return x / length, y / length


class RechargeParameters(SeekerParameters, frozen=True, kw_only=True):
    """The shares of the charge between which the utility rises, and from which on it has enough.

    They are those of the battery charger.
    """

    urgent: Share = 0.2
    below: Share = 0.5
    ready: Share = 0.8


class Recharge(Seeker):
    """Drives to the dock by itself, with a utility that rises as the charge falls, and stays there.

    It is the battery charger's purpose, at the wheels: the charger has the robot driven there by
    the planner and the trajectory, where no mechanism for the wheels decides. In the lane of the
    dock it says so as the charger does, and agents that drive along the trajectory do not bid.
    """

    name = "recharge"
    parameters = RechargeParameters
    provides: ClassVar[tuple[type[Message], ...]] = (ChargeStatus,)
    receives: ClassVar[tuple[type[Message], ...]] = (*Seeker.receives, BatteryLevel, RobotState)
    p: RechargeParameters

    def __init__(
        self, identity: agent.Identity, parameters: RechargeParameters | None = None
    ) -> None:
        super().__init__(identity, parameters)
        self._dock = next(iter(load_world(self.p.world).docks.values()), None)
        self._wants = False

    def on_body(self) -> None:
        """The contacts of a dock meet within 5 cm: it parks nearer than goto."""
        super().on_body()
        settings = self._controller.settings
        self._controller.settings = replace(settings, stop_m=0.02, beside_m=0.04)

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """The speeds to the dock; there to stand."""
        p, state, level = self.p, self.latest(RobotState), self.latest(BatteryLevel)
        if self._dock is None or state is None or level is None:
            self.why = "no dock on the map" if self._dock is None else "the charge is not known"
            return None
        self._wants = level.share < (p.ready if self._wants else p.below)
        if not self._wants:
            self.why = f"{100.0 * level.share:.0f} % are left"
            self.forget(pose)
            return None
        x, y, _ = self._dock
        if hypot(x - pose.x, y - pose.y) <= DOCK_LANE_M:
            self.publish(ChargeStatus(pose.cycle, ChargeState.DOCKING, Waypoint(*self._dock)))
        if state.charging:
            return Bid(CHARGE_NOW, (0.0, 0.0), reason="it is charged")
        if not self.route.waypoints:
            self.seek(pose, Waypoint(*before(self._dock)), Waypoint(*self._dock))
        if self._controller.parked:  # though there is no contact
            self._controller.reset()
        return super().propose(pose, obstacles)

    def _utility(self, pose: Pose) -> float:  # noqa: ARG002
        level = self.latest(BatteryLevel)
        assert level is not None, "`propose` has it"
        return ramp_down(level.share, self.p.urgent, self.p.below, CHARGE_SOON)
