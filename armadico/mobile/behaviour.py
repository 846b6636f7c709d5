"""The base class of behaviours, which drive along a mission's trajectory."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from math import ceil, copysign, inf, sqrt
from typing import ClassVar, Final

from msgspec import structs

from armadico.core import agent
from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import Description, Message, Point, RobotState
from armadico.core.parameters import Parameters, Safety
from armadico.core.resources import WHEELS
from armadico.mobile.geometry import relative
from armadico.mobile.messages import ByHand, Leading, Pose, Trajectory
from armadico.mobile.motion import Body, Speeds, ordered
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.offers import along, near, speeds_of
from armadico.mobile.route import Route
from armadico.mobile.safety import Scene, limit
from armadico.mobile.sight import in_sight

MARGINS = Safety()  # the default of behaviours without their own margins
UNKNOWN: Final = (inf, inf)  # an order, m/s and rad/s

# Standard deviations of the pose, m. Beyond the first a behaviour slows down; beyond the second the
# robot is lost and no mission is driven.
UNSURE_M, LOST_M = 0.15, 0.5

FOUND_S: Final = 60.0
"""A lost robot on a mission is found within this time, s, or not: the search ends, the mission
fails, and the auditor reports it. `armadico experiment lifted` counts robots as found by the same
limit. A choice: lasers needed 12 s in the median, and most searches that took longer went on
without an end."""

# The largest uncritical bid of a behaviour while a person drives by hand. Many behaviours reach
# 1.0, the largest bid there is: teleop could not take the wheels from them.
BY_HAND: Final = 0.9

# How far the sensors see reliably, m, where nobody has seen the map: as far as the local map of
# points reaches. A sonar's is shorter, since echoes from farther away come from side lobes, too.
SIGHT_M: Final = {"laser": 4.0, "sonar": 1.5}

CREEP_M: Final = 0.15
"""Least visible path that is assumed. Otherwise the robot would stop and never see more; at the
resulting speed near obstacles are known by their points."""

# The speed limit, m/s, when the deviation is just above `UNSURE_M`, and its share at `LOST_M`.
# A share of the top speed would be wrong: too fast for a Jackal, and 0.1 m/s for a slow robot. At
# 0.28 it is slower than 0.3 m/s also if the wheels count 7 % too little.
SURE_M_S, SLOWEST = 1.0, 0.28

MOSTLY: Final = 0.5
"""From this share of the wheels on, a behaviour takes its own command for what the robot does."""

HEEDS, HEEDS_M_S = 2.0, 0.14
"""Once the robot agent has reduced an order, the next is at most so many times what was let
through, or the second, m/s. Its readings may show what the obstacles do not yet: a behaviour that
speeds up against them would start with a leap once they are gone."""

REFUSED_CYCLES, REFUSED_FOR_S = 5, 4.0
"""A motion of which the robot agent lets nothing through, in so many cycles in which the robot
stands, is not tried again for the second, s: its readings show what the published obstacles do not.
A cycle in which it lets something through counts anew. In that time the robot turns round the other
way. Both are chosen."""

RESTS_M_S, RESTS_RAD_S = 0.02, 0.05
"""Slower than this it stands."""

Motion = tuple[int, int]
"""The signs of v and w."""

STANDS: Final[Motion] = (0, 0)


def heeded(admitted: float) -> float:
    """Return a behaviour's highest order after it was reduced to `admitted`, m/s."""
    return max(HEEDS * abs(admitted), HEEDS_M_S)


def driven_by(agent: Agent) -> str:
    """Return the person who drives by hand, by an agent's messages (`ByHand`); "" if none does."""
    return next((each.driven_by for each in agent.each_fresh(ByHand) if each.driven_by), "")


class Behaviour(Agent, hooks=("propose", "rate", "vector")):
    """An agent that competes for the wheels while there is a trajectory to follow.

    A subclass returns its bid in `propose`. `route` has the trajectory and the robot's progress,
    `body` the robot's footprint and limits by `robot/description`. A behaviour does not bid without
    a goal (unless `needs_goal` is false), before the robot's description, or while the robot is
    lost (unless it `seeks`).
    """

    needs_goal: ClassVar[bool] = True
    seeks: ClassVar[bool] = False
    """Whether it drives a lost robot, and only that, to localize it."""

    needs: ClassVar[tuple[type[Message], ...]] = (Pose, Obstacles)
    receives: ClassVar[tuple[type[Message], ...]] = (
        Trajectory,
        Description,
        Leading,
        ByHand,
    )
    competes_for = (WHEELS,)

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.route = Route()
        self._waits = False
        self._known = (0, 0)  # the newest trajectory, by its order
        self._upcoming: Trajectory | None = None  # it waits for a pose on its revision of the map
        self._body: Body | None = None
        self._by_laser = False
        self._speeds: tuple[Speeds, Speeds] = ((0.0, 0.0), (0.0, 0.0))  # a cycle ago, and now
        self._orders: deque[Speeds] = deque([UNKNOWN], maxlen=1)  # that its ramps may follow now
        self._stood: Counter[Motion] = Counter()  # cycles in which it stood, by its order
        self._refused: dict[Motion, float] = {}  # until when, s

    @property
    def body(self) -> Body:
        """The robot's footprint and limits."""
        assert self._body is not None, "`propose` is called after the robot's description"
        return self._body

    @property
    def measured(self) -> Speeds:
        """The measured (v, w), m/s and rad/s."""
        state = self.latest(RobotState)
        assert state is not None, "`propose` is called after robot/state"
        return state.v, state.w

    @property
    def led(self) -> bool:
        """Whether another agent leads the robot, such as into a dock: no trajectory is driven."""
        return any(each.leads for each in self.each_fresh(Leading))

    def scene(self, obstacles: Obstacles) -> Scene:
        """Return the scene in which wanted speeds are limited.

        It includes the age of the obstacles, and how long the bid may wait before it is commanded:
        up to `fresh_cycles` for a contender, 0 for the holder.
        """
        age = max(self.cycles.age(obstacles.cycle) or 0, 0)
        waits = 0 if self.share(WHEELS) > 0.0 else self.cycles.fresh_cycles
        cycle_s = self.body.cycle_s
        most_v, most_w = (max(each) for each in zip(*self._orders, strict=True))
        going = ordered(self.body, *self._speeds, (most_v, most_w))
        return Scene(self.body, going, obstacles.points, age * cycle_s, waits * cycle_s)

    def limited(self, v: float, w: float, obstacles: Obstacles, safety: Safety = MARGINS) -> Speeds:
        """Return wanted speeds (m/s, rad/s), limited by obstacles and the pose's uncertainty."""
        return self.limited_in(self.scene(obstacles), v, w, safety)

    def limited_in(self, scene: Scene, v: float, w: float, safety: Safety = MARGINS) -> Speeds:
        """Do the same for a given scene."""
        # The uncertainty is a limit, not a factor. A behaviour ramps up from its last command, so a
        # factor would apply again in each cycle until the robot stands.
        if (sure := self.pose_confidence) < 1.0:
            most = SURE_M_S * sure
            v = min(max(v, -most), most)
        if self.route.unseen:
            v, safety = self._by_sight(v, scene, safety)
        state = self.latest(RobotState)
        if state is not None and state.capped and self.drives(WHEELS, state.driver):
            most = heeded(state.admitted.v)
            v = min(max(v, -most), most)
        return limit(v, w, scene, safety)

    def _by_sight(self, v: float, scene: Scene, safety: Safety) -> tuple[float, Safety]:
        """Return the speed and the margins on a path through what nobody has seen.

        There it can stop within the visible part of its path, and by sonar within the nearest
        point's distance, as without a map. It brakes in time before.
        """
        pose, body = self.latest(Pose), self.body
        if pose is None:
            return v, safety
        off = self.route.off_unseen(pose.x, pose.y)
        if off > body.stopping_distance(body.v_max) + body.outline.front + safety.margin_m:
            return v, safety
        reach = SIGHT_M["laser" if self._by_laser else "sonar"]
        seen = self.seen_ahead(pose, scene.points, reach)
        free = max(seen - body.outline.front - safety.margin_m, CREEP_M)
        safety = safety if self._by_laser else structs.replace(safety, unmapped=True)
        return min(v, body.stops_within(free, scene.age)), safety

    def seen_ahead(self, pose: Pose, points: Sequence[Point], reach: float) -> float:
        """Return how far the path ahead is visible among points in the body frame, m."""
        here = (pose.x, pose.y, pose.theta)
        left = self.route.waypoints[self.route.leg :]
        places = [(0.0, 0.0), *(relative(here, (to.x, to.y, 0.0))[:2] for to in left)]
        return in_sight(points, places, reach)

    @property
    def pose_confidence(self) -> float:
        """1 with a certain pose; else the share of `SURE_M_S` that the robot may drive."""
        pose = self.latest(Pose)
        if pose is None or self.seeks:
            return 1.0
        # Along a corridor walls of the map are expected nearer by the deviation, and sensors show
        # the walls beside. With the same deviation in both directions the two are equal.
        off = min(pose.deviation, sqrt(2.0) * pose.deviation_across)
        return min(max((LOST_M - off) / (LOST_M - UNSURE_M), SLOWEST), 1.0)

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """Return the bid; None without one, with the reason in `why`."""
        raise NotImplementedError("propose(self, pose, obstacles) returns the bid")

    def rate(self, bid: Bid | None, actions: Sequence[Speeds]) -> Sequence[float]:
        """Return how good actions (m/s, rad/s) would be, from -1, never, to 1; none: no opinion.

        For coordinations that weigh what every behaviour says of every action. By default the
        nearer to this cycle's bid, the better.
        """
        if bid is None or bid.utility <= 0.0:
            return ()
        return near(speeds_of(bid), actions)

    def vector(self, bid: Bid | None) -> Speeds:
        """Return where the robot should move, in the body frame, of a length up to about 1.

        For coordinations that sum vectors (motor schemas). By default the direction of this cycle's
        bid.
        """
        return along(bid, self.body)

    def on_mission(self) -> None:
        """Called when a mission begins or ends."""

    def on_body(self) -> None:
        """Called when the robot's description or the parameters have changed."""

    def on_parameters(self, before: object) -> None:  # noqa: ARG002
        if self._body is not None:
            self.on_body()

    def refuses(self, v: float, w: float) -> bool:
        """Whether the robot agent lately let nothing through of such a motion of this agent.

        Only the signs of v and w count.
        """
        return self.now < self._refused.get(_motion(v, w), -inf)

    def on_refused(self, w: float) -> None:
        """Called when a motion is found to be refused; w: the sign of its turn, 0 if straight."""

    def _note_refused(self, state: RobotState) -> None:
        """Note which of its motions the robot agent refuses."""
        if not self.drives(WHEELS, state.driver):
            return
        if _motion(state.v, state.w) != STANDS:
            self._stood.clear()  # not by a cycle that is let through: nothing may come of it
            return
        refused = state.capped and _motion(state.admitted.v, state.admitted.w) == STANDS
        if refused and not state.stalled:  # what stalls is known by `stalled`
            motion = _motion(state.ordered.v, state.ordered.w)
            self._stood[motion] += motion != STANDS
            if self._stood[motion] >= REFUSED_CYCLES:
                self._stood[motion] = 0
                self._refused[motion] = self.now + REFUSED_FOR_S
                self.on_refused(float(motion[1]))

    def on_robot_state(self, state: RobotState) -> None:
        self._note_refused(state)
        self._speeds = self._speeds[1], (state.v, state.w)
        # Without a driver what moves the robot is unknown: a hand, or another program.
        admitted = abs(state.admitted.v), abs(state.admitted.w)
        self._orders.append(admitted if state.driver else UNKNOWN)

    def on_description(self, description: Description) -> None:
        self._by_laser = "laser" in description.sensors
        body = Body.of(description)
        if body != self._body:
            self._body = body
            self._orders = deque(self._orders, maxlen=ceil(body.dead_s / body.cycle_s) + 1)
            self.on_body()

    def on_trajectory(self, trajectory: Trajectory) -> None:
        # An agent that hung, or did not receive the poses, has not seen the robot pass waypoints.
        # Without the published leg it would drive back to them, through anything between.
        if trajectory.order == self._known:
            if self._upcoming is None:
                self.route.catch_up(trajectory.leg)
            return
        self._known = trajectory.order
        if self._fits(trajectory):
            self._take(trajectory)
        else:
            self._upcoming = trajectory

    def _fits(self, trajectory: Trajectory) -> bool:
        """Whether the pose lies on the map of a trajectory. If the map moved, it follows soon."""
        pose = self.latest(Pose)
        ends = not trajectory.waypoints
        return ends or pose is None or pose.revision >= trajectory.revision

    def _take(self, trajectory: Trajectory) -> None:
        self._upcoming = None
        self.route = Route.of(trajectory)
        self._waits = trajectory.waits
        self.on_mission()

    def bid(self, message: object) -> Bid | None:  # noqa: ARG002 - either starts the turn
        """Advance on the route and propose; the bid is limited while a person drives by hand."""
        bid = self._proposed()
        if not driven_by(self) or bid is None or bid.critical or bid.utility <= BY_HAND:
            return bid
        return replace(bid, utility=BY_HAND)

    def _proposed(self) -> Bid | None:
        pose = self.latest(Pose)
        if (
            self._upcoming is not None
            and pose is not None
            and pose.revision >= self._upcoming.revision
        ):
            self._take(self._upcoming)
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
        assert pose is not None, "all needs are fresh"
        assert obstacles is not None, "all needs are fresh"
        if (pose.deviation > LOST_M) != self.seeks:
            if self.seeks:
                self.why = "the pose is known"
            else:
                self.why, self.lacks = f"lost: +-{pose.deviation:.1f} m", self.key_of(Pose)
            return None
        if not self.seeks:
            self.route.advance(pose.x, pose.y)
        return self.propose(pose, obstacles)


def _motion(v: float, w: float) -> Motion:
    """The direction of speeds."""
    ahead, left = abs(v) >= RESTS_M_S, abs(w) >= RESTS_RAD_S
    return ahead * int(copysign(1, v)), left * int(copysign(1, w))
