"""What the behaviours have in common: they drive a mission's trajectory, and know where on it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Final

from armadico.core import agent
from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import Description, Message, RobotState
from armadico.core.parameters import Safety
from armadico.core.resources import WHEELS
from armadico.mobile.messages import ByHand, Leading, Pose, Trajectory
from armadico.mobile.motion import Body, Speeds, ordered
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.route import Route
from armadico.mobile.safety import Limited, Scene, limit

MARGINS = Safety()
"""Kept by a behaviour that has none of its own."""


UNSURE_M, LOST_M = 0.15, 0.5
"""Standard deviations of the pose, m: beyond the first a behaviour slows down, beyond the second
the robot is lost and no mission is driven."""

BY_HAND: Final = 0.9
"""What a behaviour bids at the most while a hand is on the stick, unless it is critical. With 1.0,
which many reach, the hand would get the wheels from nobody who has them: it can bid no more."""

SURE_M_S, SLOWEST = 1.0, 0.3
"""Cap on the speed of a robot whose pose is just no longer sure, m/s (or its top speed, if that is
less), and the share of it that is left just before it is lost. Not a share of the top speed alone:
0.3 of a Jackal's 2 m/s would be no caution."""


def driven_by(agent: Agent) -> str:
    """Who drives by hand, of the agents that an agent hears (`ByHand`); empty: no person does."""
    return next((each.driven_by for each in agent.each_fresh(ByHand) if each.driven_by), "")


class Behaviour(Agent):
    """An agent that competes for the wheels while there is a trajectory to follow.

    A subclass says in `propose` what it would do. `route` knows the way and how far the robot has
    come on it, `body` what the robot is and can: `robot/description` says it, and no setting does.
    Nobody bids without a goal, unless it says that it needs none, nor before the robot has been
    described; nor while it is lost, but who `seeks`.
    """

    needs_goal: ClassVar[bool] = True
    seeks: ClassVar[bool] = False
    """Whether it drives a robot that is lost, and only then: to find out where it is."""

    needs: ClassVar[tuple[type[Message], ...]] = (Pose, Obstacles)
    hears: ClassVar[tuple[type[Message], ...]] = (
        Trajectory,
        Description,
        Leading,
        ByHand,
    )
    competes_for = (WHEELS,)

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.route = Route()
        self._waits = False
        self._known = (0, 0)  # the trajectory that is followed, by its order
        self._body: Body | None = None
        self._speeds: tuple[Speeds, Speeds] = ((0.0, 0.0), (0.0, 0.0))  # a cycle ago, and now

    @property
    def body(self) -> Body:
        """The robot's outline and limits."""
        assert self._body is not None, "nobody proposes before the robot is described"
        return self._body

    @property
    def measured(self) -> Speeds:
        """(v, w) by the wheels, m/s and rad/s."""
        state = self.latest(RobotState)
        assert state is not None, "nobody bids without robot/state"
        return state.v, state.w

    @property
    def led(self) -> bool:
        """Whether another agent leads the robot, as into a dock: no trajectory is driven then."""
        return any(each.leads for each in self.each_fresh(Leading))

    def scene(self, obstacles: Obstacles) -> Scene:
        """What a wish is held against: the body, how it moves, and what is known around it.

        The cycles that the obstacles are old count, and so do those that a contender's bid may wait
        until it is cast: as long as fresh lasts. A holder's is commanded at once.
        """
        age = max(self.cycles.age(obstacles.cycle) or 0, 0)
        waits = 0 if self.holds(WHEELS) else self.cycles.fresh_cycles
        cycle_s = self.body.cycle_s
        going = ordered(self.body, *self._speeds)
        return Scene(self.body, going, obstacles.points, age * cycle_s, waits * cycle_s)

    def limited(self, v: float, w: float, obstacles: Obstacles, safety: Safety = MARGINS) -> Speeds:
        """The wish (m/s, rad/s), as fast as the obstacles and the pose's uncertainty admit."""
        return self.limited_in(self.scene(obstacles), v, w, safety)[:2]

    def limited_in(self, scene: Scene, v: float, w: float, safety: Safety = MARGINS) -> Limited:
        """The same for a scene that is known already, with the free way of the wish.

        The uncertainty is a cap, not a factor. A behaviour ramps up from what it commanded last, so
        a factor would apply again in each cycle until the robot stands.
        """
        if (sure := self.sureness) < 1.0:
            most = min(self.body.v_max, SURE_M_S) * sure
            v = min(max(v, -most), most)
        return limit(v, w, scene, safety)

    @property
    def sureness(self) -> float:
        """1 with a sure pose; else the share of `SURE_M_S` that the robot may drive."""
        pose = self.latest(Pose)
        off = 0.0 if pose is None or self.seeks else pose.deviation
        return min(max((LOST_M - off) / (LOST_M - UNSURE_M), SLOWEST), 1.0)

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """What it would do now, and how much that helps; None, and `why`, if nothing."""
        raise NotImplementedError("propose(self, pose, obstacles) says what it would do")

    def on_mission(self) -> None:
        """A new mission has begun, or the old one has ended."""

    def on_body(self) -> None:
        """The robot was described for the first time, or differently; or parameters changed."""

    def on_parameters(self, before: Any) -> None:  # noqa: ARG002
        """What is worked out from the body and the parameters is worked out again."""
        if self._body is not None:
            self.on_body()

    def on_robot_state(self, state: RobotState) -> None:
        """How the wheels turn, and how they did."""
        self._speeds = self._speeds[1], (state.v, state.w)

    def on_description(self, said: Description) -> None:
        """What the robot is and can."""
        body = Body.of(said)
        if body != self._body:
            self._body = body
            self.on_body()

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """A new mission, or the old one said again: with how far the run has come since.

        Whoever hung, or was cut off from the poses, has not seen the waypoints passed meanwhile. It
        would lead back to them for ever, straight through what is between.
        """
        if trajectory.order != self._known:
            self._known = trajectory.order
            self.route = Route.of(trajectory)
            self._waits = trajectory.waits
            self.on_mission()
        else:
            self.route.catch_up(trajectory.leg)

    def bid(self, message: Any) -> Bid | None:  # noqa: ARG002 - either starts the turn
        """Follow the route, and propose; a hand on the stick goes first, if nothing is critical."""
        bid = self._proposed()
        if not driven_by(self) or bid is None or bid.critical or bid.utility <= BY_HAND:
            return bid
        return replace(bid, utility=BY_HAND)

    def _proposed(self) -> Bid | None:
        if self.needs_goal and not self.route.waypoints:
            self.why = "no goal"
            return None
        if self._waits and self.needs_goal and not self.seeks:
            self.why = "the mission waits: no way is free"
            return None
        if self.needs_goal and not self.seeks and self.led:
            self.why = "the robot is driven into a dock, or out of it"
            return None
        if self._body is None:
            self.why = "no robot/description"
            return None
        pose, obstacles = self.fresh(Pose), self.fresh(Obstacles)
        assert pose is not None, "the pattern lets nobody bid without what it needs"
        assert obstacles is not None, "nor without that"
        if (pose.deviation > LOST_M) != self.seeks:
            if self.seeks:
                self.why = "the pose is known"
            else:
                self.why, self.lacks = f"lost: +-{pose.deviation:.1f} m", self.key_of(Pose)
            return None
        if not self.seeks:
            self.route.advance(pose.x, pose.y)
        return self.propose(pose, obstacles)
