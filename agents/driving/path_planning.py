"""The path planning agent: plans paths over rooms, doors and cells (thesis 3.6.2)."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.driving.seen import Seen
from armadico.agents.methods.energy import Pace, energy
from armadico.agents.methods.grid import CELL_M, check_extent, grid_in
from armadico.agents.methods.known_grid import KnownGrid
from armadico.agents.methods.planning import Plan as Way
from armadico.agents.methods.planning import PlanError, plan, plan_on_map, unknown
from armadico.config.grid_map import cells_of
from armadico.config.profile import load_profile
from armadico.config.worlds import World, load_world
from armadico.core import agent
from armadico.core.agent import INFO, WARNING, Agent, Question
from armadico.core.messages import Message, RobotState, line
from armadico.core.resources import Resource
from armadico.core.unseen import DRIVE, REFUSE, Rule
from armadico.mobile.behaviour import UNSURE_M
from armadico.mobile.messages import (
    WAYPOINTS,
    OccupancyGrid,
    Plan,
    Planned,
    PlanRequest,
    PlanTask,
    Pose,
    Scan,
    Sonar,
    Stretch,
    Waypoint,
    through_unseen,
)
from armadico.mobile.resources import PLANNER


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The world and the robot to plan for, and the robot's pace.

    Without a world it plans on the map that slam makes. Without slam it plans over what the sensors
    saw, and everything else is free.
    """

    world: Annotated[str, Meta(min_length=1)] | None = None
    profile: str = "pioneer-2dx"
    recent_s: Annotated[float, Meta(ge=0, le=60)] = 3.0  # without a map: age of obstacles to keep
    round_corners: bool = False  # for the brisk controller; the thesis's turns at each waypoint
    pace: Pace = Pace()
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit, m/s
    unseen: Rule | None = None  # where nobody has seen; None: the map's rule


class PathPlanning(Agent):
    """Returns paths and their costs in a world of walls, rooms and doors.

    It plans for the agent that holds it (3.6.2), and for other requests in between: the operator's,
    and those of the trajectory's owner when its path is blocked.

    It remembers sensed obstacles that are not on the map for a while, and plans around them. While
    the pose is uncertain it adds none: a wall beside its true place would close a door.

    Without a map it remembers all obstacles. If no path is left, some of them were wrong: then it
    drops all but the latest.

    In a world with cells that nobody has seen, it plans around them, and through them only where no
    other path leads to the goal. `unseen = "refuse"` refuses that.

    On a map that slam makes, unknown cells are closed. The map remembers the obstacles; those of
    the newest scan are added.
    """

    name = "path-planning"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Pose, Sonar, Scan, OccupancyGrid)
    provides: ClassVar[tuple[type[Message], ...]] = (Planned,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)
    owns = (PLANNER,)
    parameters = Parameters
    launched_with = ("world", "profile", "v_max", "unseen")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._world = None if self.p.world is None else load_world(self.p.world)
        if self._world is not None:
            check_extent(self._world, CELL_M)
        self._profile = load_profile(self.p.profile)
        self._seen: Seen | None = None
        self._grid: OccupancyGrid | None = None  # the newest map of slam
        self._chart: KnownGrid | None = None  # the same for planning, once it is needed
        self._newest: tuple[Pose, Scan] | None = None  # scan, and the pose of its cycle
        self._task: int | None = None  # the holder's
        self._planned: Planned | None = None  # the result of that task, or of one before

    def obey(self, resource: Resource, action: PlanTask) -> None:  # noqa: ARG002
        """Plan for the holder and publish the plan, again each cycle until it is released.

        It plans in the second cycle of a holder: by then an agent with a better bid has taken over.
        """
        if self._task != action.id:
            self._task = action.id
            return
        if self._planned is None or self._planned.id != action.id:
            plan = self._plan(PlanRequest(action.start, action.goal, action.why))
            self._planned = Planned(action.id, plan)
        self.publish(self._planned)

    def on_pose(self, pose: Pose) -> None:
        """Add the pings and the scan of this cycle, if they have arrived."""
        self._match(pose, self.latest(Sonar))
        self._match(pose, self.latest(Scan))

    def on_sonar(self, sonar: Sonar) -> None:
        self._match(self.latest(Pose), sonar)

    def on_scan(self, scan: Scan) -> None:
        self._match(self.latest(Pose), scan)

    def on_occupancy_grid(self, grid: OccupancyGrid) -> None:
        """Plan on it from now on, if no world is known and slam makes it."""
        if self._world is None and grid.revision and grid.rows and grid.columns:
            self._grid, self._chart, self._seen = grid, None, None

    def on_plan_request(self, request: PlanRequest, _question: Question) -> Plan:
        """The waypoints, or the reason why there is no path."""
        return self._plan(request)

    def _plan(self, request: PlanRequest) -> Plan:
        try:
            way = self._way(request)
        except PlanError as error:
            if self._world is not None or self._seen is None:
                return Plan((), refusal=line(str(error)))
            self._seen.forget(self.now, self.p.recent_s)
            try:
                way = self._way(request)
            except PlanError as again:
                return Plan((), refusal=line(str(again)))
        waypoints = tuple(Waypoint(p.x, p.y, p.theta) for p in way.waypoints)
        if len(waypoints) > WAYPOINTS:
            return Plan((), refusal=f"the path has {len(waypoints):,} turns, at most {WAYPOINTS:,}")
        state = self.latest(RobotState)
        cost = energy(
            (request.start, *waypoints),
            self._profile,
            self.p.pace,
            self.p.v_max,
            volts=None if state is None else state.battery_v,
        )
        doors = f" through {', '.join(way.doors)}" if way.doors else ""
        why = f": {request.why}" if request.why else ""
        unseen = tuple(Stretch(*part) for part in way.unseen)
        told = f"; {through_unseen(unseen)}, at the speed of sight" if unseen else ""
        planned = f"planned {way.length_m:.1f} m{doors}, {cost.joules:.0f} J{why}{told}"
        self.log(planned, WARNING if unseen else INFO)
        revision = 0 if self._grid is None else self._grid.revision
        return Plan(waypoints, way.length_m, cost.joules, revision=revision, unseen=unseen)

    def _way(self, request: PlanRequest) -> Way:
        """Plan by the map and the obstacles seen. Raises PlanError."""
        if self._grid is not None:
            return self._on_map(self._grid, request)
        seen = () if self._seen is None else self._seen.points(self.now)
        world = self._world
        if world is None:
            world = unknown(request.start, request.goal, seen)
        return plan(
            world,
            request.start,
            request.goal,
            self._profile.body,
            round_corners=self.p.round_corners,
            seen=seen,
            under_way=bool(request.why) or self._world is None,
            refuse=self._rule(request, world) == REFUSE,
        )

    def _rule(self, request: PlanRequest, world: World) -> Rule:
        """The request's rule for what nobody has seen, else the scenario's, else the map's."""
        if request.rule is not None:
            return request.rule
        if self.p.unseen is not None:
            return self.p.unseen
        refused = world.unseen is not None and world.unseen.refused
        return REFUSE if refused else DRIVE

    def _on_map(self, grid: OccupancyGrid, request: PlanRequest) -> Way:
        """Plan on the map that slam makes, and the newest scan. Raises PlanError."""
        if self._chart is None:
            try:
                self._chart = KnownGrid(cells_of(grid))
            except ValueError as error:
                raise PlanError(f"mapping/grid: {error}") from None
        seen = Seen(self._chart)
        if self._newest is not None:
            pose, scan = self._newest
            if self.cycles.fresh(scan.cycle) and pose.revision == grid.revision:
                with suppress(ValueError):  # the laser agent reports invalid scans
                    seen.add_scan(pose, scan, pose.deviation, self.now)
        return plan_on_map(
            self._chart,
            request.start,
            request.goal,
            self._profile.body,
            round_corners=self.p.round_corners,
            seen=seen.points(self.now),
        )

    def _match(self, pose: Pose | None, reading: Sonar | Scan | None) -> None:
        """Add a cycle's pings or scan once both messages have arrived, in any order."""
        if (
            pose is None
            or reading is None
            or pose.cycle != reading.cycle
            or pose.deviation > UNSURE_M
        ):
            return
        if self._grid is not None:
            if isinstance(reading, Scan):
                self._newest = pose, reading
            return
        if self._seen is None:
            self._seen = Seen(None if self._world is None else grid_in(self._world))
        self._seen.move(pose)
        if isinstance(reading, Scan):
            with suppress(ValueError):  # the laser agent reports invalid scans
                self._seen.add_scan(pose, reading, pose.deviation, self.now)
        else:
            for echo in reading.echoes:
                self._seen.add(pose, echo, pose.deviation, self.now)
        state = self.latest(RobotState)
        if state is not None and state.touch is not None and state.cycle == pose.cycle:
            self._seen.touch(pose, state.touch.x, state.touch.y, self.now)
