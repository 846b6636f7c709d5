"""How a deliberative agent has the robot driven: by the planner, then the trajectory (3.6).

Sans-IO: an agent that competes for both resources keeps an `Errand`, passes it the messages that it
receives, and bids what it returns. There are two resources and no arbiter: another agent may win
the planner or the trajectory in between. The errand goes on afterwards from where the robot is.

An agent whose robot stands for a task bids for the trajectory, too (`stand`): its claim shows the
others the utility of standing.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from math import cos, sin
from typing import ClassVar

from msgspec.structs import replace

from armadico.core.agent import Agent, Identity, Parameters
from armadico.core.exchange import Bid
from armadico.core.messages import Message, Point
from armadico.core.resources import Resource
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.driven import UNDER_WAY, Event, Stage, event_of, following
from armadico.mobile.messages import (
    MissionState,
    MissionStatus,
    Plan,
    Planned,
    PlanTask,
    Pose,
    Terms,
    Trajectory,
    Way,
    Waypoint,
)
from armadico.mobile.resources import PLANNER, TRAJECTORY
from armadico.mobile.route import Route

BITS = 63

# A new path begins where the robot will be on the present one after this time: contending for the
# planner and then for the trajectory takes some cycles of 0.2 s and of 0.5 s.
JOIN_S = 2.0

JOIN_M = 0.3  # the least distance to that place

# A new path joins the present one only if the robot is this near to it.
JOINED_M = 0.5


class PlanDesk:
    """Requests plans from the planner, one at a time."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._task: PlanTask | None = None
        self._then: Callable[[Plan], None] | None = None

    @property
    def busy(self) -> bool:
        """Whether a plan is pending."""
        return self._task is not None

    def request(
        self, start: Waypoint, goal: Waypoint, then: Callable[[Plan], None], why: str = ""
    ) -> None:
        """Request a plan, instead of the one requested before."""
        self._task = PlanTask(self._rng.getrandbits(BITS), start, goal, why)
        self._then = then

    def drop(self) -> None:
        self._task = self._then = None

    def bid(self, utility: float, *, critical: bool = False) -> Bid | None:
        """Return the bid for the planner now."""
        task = self._task
        if task is None:
            return None
        return Bid(utility, task, critical, reason=f"to {_at(task.goal)}")

    def on_plan(self, planned: Planned) -> None:
        """Process a plan, which may be another agent's."""
        if self._task is None or planned.id != self._task.id:
            return
        then = self._then
        self.drop()
        if then is not None:
            then(planned.plan)


class Errand:
    """Drives that an agent has the robot make, one after another.

    The agent passes in messages (`pose`, `trajectory`, `planned`, `status`) and bids what `bid_for`
    returns. If another agent wins the trajectory, the errand is interrupted and contends with the
    rest of its path. The owner of the trajectory has that planned anew if the robot has left it.
    """

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self.desk = PlanDesk(rng)
        self.stage = Stage.NONE  # the progress
        self.goal: Waypoint | None = None
        self.plan: Plan | None = None
        # Of the mission's status. At the goal: why it is unknown whether the robot is there.
        self.note = ""
        self.standing: Way | None = None  # bid for while there is no path of its own
        self.stands = False  # the robot has reached the end of `standing`
        self._way: Way | None = None
        self._driven = Route()  # the path driven now, of any agent
        self._mission = 0
        self._waits = False

    @property
    def way(self) -> int:
        """The number of its path in the trajectory and the mission's status; 0 without a path."""
        return 0 if self._way is None else self._way.id

    @property
    def ways(self) -> set[int]:
        """The numbers of all paths that it bids for."""
        return {way.id for way in (self._way, self.standing) if way is not None}

    @property
    def under_way(self) -> bool:
        """Whether it has begun and not ended."""
        return self.stage in UNDER_WAY

    @property
    def interrupted(self) -> bool:
        """Whether it has a path while another one is driven."""
        return self.stage is Stage.WAITING and self._mission not in (0, self.way)

    def go(self, goal: Waypoint, pose: Pose, v: float = 0.0, why: str = "") -> None:
        """Begin: request a path from where the robot will soon be.

        The goal is in the world frame; `v` is the speed by the wheels, m/s; `why` is the reason in
        the planner's log.
        """
        self.pause()
        self.goal = goal
        if pose.deviation > LOST_M:  # a path from a wrong pose is useless; it is planned later
            self._way = Way(self._rng.getrandbits(BITS), (goal,), Point(pose.x, pose.y))
            self._on(Event.TAKEN)
            return
        self._on(Event.ASKED)
        place = self._ahead(pose, v)
        start = Waypoint(pose.x, pose.y, pose.theta) if place is None else place

        def planned(plan: Plan) -> None:
            if place is not None and _leads_back(place, plan):
                here = Waypoint(pose.x, pose.y, pose.theta)
                self.desk.request(here, goal, lambda again: self._take(again, here), why)
            else:
                self._take(plan, start)

        self.desk.request(start, goal, planned, why)

    def resume(self, goal: Waypoint, way: int) -> bool:
        """Take over a path that is already driven, as after a restart; return whether it is."""
        if not way or way != self._mission or not self._driven.waypoints:
            return False
        self.drop()
        driven = self._driven
        self.goal = goal
        self._on(Event.TAKEN)
        self._way = Way(way, driven.waypoints, driven.start, driven.leg, unseen=driven.unseen)
        return True

    def stand(self, pose: Pose | None, *, planned: bool = True) -> None:
        """Keep the robot where it is, at the end of the path that it has reached or at `pose`.

        A robot that was driven away returns by a planned path, unless `planned` is False.
        """
        if self.stage is Stage.REACHED and self._way is not None:
            self.standing, self.stands = self._way, True
        elif self.standing is None and pose is not None:
            here = Waypoint(pose.x, pose.y, pose.theta)
            number = self._rng.getrandbits(BITS)
            self.standing = Way(number, (here,), Point(here.x, here.y), planned=planned)
        self._end()

    def pause(self) -> None:
        """End the path; until the next one is planned, bid for what is driven now."""
        if self.stage in (Stage.DRIVING, Stage.REACHED):
            self.standing, self.stands = self._way, self.stage is Stage.REACHED
        self._end()

    def drop(self) -> None:
        """End it, and bid for nothing."""
        self.standing, self.stands = None, False
        self._end()

    def _end(self) -> None:
        self.desk.drop()
        self._on(Event.ENDED)
        self.goal, self.plan, self.note, self._way = None, None, "", None

    def _on(self, event: Event) -> None:
        self.stage = following(self.stage, event)

    def bid_for(
        self,
        resource: Resource,
        utility: float,
        *,
        critical: bool = False,
        cleared: bool = True,
        terms: Terms | None = None,
    ) -> Bid | None:
        """Return the bid for the planner or the trajectory now, or None.

        There is no bid for a path that is not `cleared` yet. `terms` are those of its paths.
        """
        if resource is PLANNER:
            return self.desk.bid(utility, critical=critical)
        bids = cleared and self.stage in (Stage.WAITING, Stage.DRIVING, Stage.REACHED)
        if bids and self._way is not None:
            way, to = replace(self._way, terms=terms), self._way.waypoints[-1]
            return Bid(utility, way, critical, reason=f"to {_at(to)}")
        if self.standing is None:
            return None
        reason = f"stands at {_at(self.standing.waypoints[-1])}"
        standing = replace(self.standing, terms=terms)
        return Bid(utility, standing, critical, reason=reason)

    def pose(self, pose: Pose) -> None:
        """Update the progress on the path that is driven."""
        self._driven.advance(pose.x, pose.y)
        self._keep()

    def trajectory(self, trajectory: Trajectory) -> None:
        """Update the path that is driven; its own may have been joined to another or replanned."""
        self._mission, self._waits = trajectory.mission, trajectory.waits
        if trajectory.waypoints != self._driven.waypoints:
            self._driven = Route.of(trajectory)
        else:
            self._driven.catch_up(trajectory.leg)
        self._keep()

    def planned(self, planned: Planned) -> None:
        self.desk.on_plan(planned)

    def status(self, status: MissionStatus) -> None:
        """Update the stage by the status of the path that is driven."""
        if self.standing is not None and status.mission == self.standing.id:
            self.stands = status.state is MissionState.REACHED
        if self._way is None or not self.under_way:
            return
        event = event_of(status, self._way.id)
        self._on(event)
        if event in (Event.DRIVEN, Event.REACHED, Event.FAILED):
            self.note = status.note
        if event is Event.DRIVEN:
            self.standing, self.stands = None, False

    def _ahead(self, pose: Pose, v: float) -> Waypoint | None:
        """Return where to join the driven path; None: the robot stands or is not on it."""
        driven = self._driven
        if not driven.waypoints or self._waits or driven.off(pose.x, pose.y) > JOINED_M:
            return None
        return driven.ahead(pose.x, pose.y, max(JOIN_M, abs(v) * JOIN_S))[0]

    def _take(self, plan: Plan, start: Waypoint) -> None:
        self.plan = plan
        if plan.refusal or not plan.waypoints:
            self._on(Event.REFUSED)
            self.note = plan.refusal or "the plan has no points"
            return
        self._way = Way(
            self._rng.getrandbits(BITS),
            plan.waypoints,
            Point(start.x, start.y),
            unseen=plan.unseen,
        )
        self._on(Event.TAKEN)

    def _keep(self) -> None:
        """Bid for the path as it is driven, and what remains of it."""
        way, driven = self._way, self._driven
        if way is None or way.id != self._mission or not driven.waypoints:
            return
        if way.waypoints != driven.waypoints or way.leg != driven.leg:
            self._way = Way(
                way.id, driven.waypoints, driven.start, driven.leg, way.planned, driven.unseen
            )


class DeliberativeAgent(Agent, hooks=()):
    """An agent that has the robot driven by an errand, to which it passes what it receives.

    A subclass begins a drive (`errand.go`) and bids what `errand.bid_for` returns. It lists these
    messages in its own `receives`, too.
    """

    receives: ClassVar[tuple[type[Message], ...]] = (Pose, Trajectory, Planned, MissionStatus)
    competes_for = (PLANNER, TRAJECTORY)

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.errand = Errand(self.rng)

    def on_pose(self, pose: Pose) -> None:
        self.errand.pose(pose)

    def on_trajectory(self, trajectory: Trajectory) -> None:
        self.errand.trajectory(trajectory)

    def on_planned(self, planned: Planned) -> None:
        self.errand.planned(planned)

    def on_mission_status(self, status: MissionStatus) -> None:
        self.errand.status(status)


def _leads_back(place: Waypoint, plan: Plan) -> bool:
    """Return whether a plan from a place on the path turns back there."""
    if not plan.waypoints:
        return True
    to = plan.waypoints[0]
    return (to.x - place.x) * cos(place.theta) + (to.y - place.y) * sin(place.theta) < 0.0


def _at(place: Waypoint) -> str:
    return f"({place.x:.2f}, {place.y:.2f})"
