"""The explore agent: has the robot driven from frontier to frontier of the map, and back."""

from __future__ import annotations

from math import inf, pi
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.methods.geometry import Placed, direction
from armadico.agents.methods.grid import Margins
from armadico.agents.methods.planning import headed, radii
from armadico.agents.missions.frontiers import Chart, crossed
from armadico.agents.missions.messages import (
    ChargeState,
    ChargeStatus,
    ExploreRequest,
    ExploreState,
    ExploreStatus,
)
from armadico.config.grid_map import FREE, Cells, cells_of
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.messages import Message, line
from armadico.mobile.driven import Event, Ordered
from armadico.mobile.messages import (
    BatteryLevel,
    Correction,
    MapMoved,
    MissionReply,
    MissionRequest,
    MissionStatus,
    OccupancyGrid,
    Pose,
    Waypoint,
)
from armadico.mobile.moving import moved


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The robot, and how long something is tried before it is given up."""

    profile: str = "pioneer-2dx"
    stuck_s: Annotated[float, Meta(ge=1, le=600)] = 15.0  # timeout without coming nearer
    map_s: Annotated[float, Meta(ge=1, le=600)] = 15.0  # timeout for a map
    tries: Annotated[int, Meta(ge=1, le=100)] = 5  # to have a mission accepted, or to get home
    charged: Annotated[float, Meta(gt=0, le=1)] = 0.8  # share from which it leaves the dock


LOST_MAP: Final = "the map was lost: its agent began another one; explore again"

# With less confidence the robot has not found its place on the map that it continues. It maps a
# part of its own, in which neither the rectangle nor home have their places.
PLACED = 0.75

# A frontier is this much farther away than the turning circle: beyond it nothing is known yet.
TURNING_M = 0.05

# The longest path expected: lanes of this width over the whole rectangle.
LANE_M = 1.0


class Explore(Agent):
    """Requests one mission after another from the interface agent; does not drive itself.

    The next frontier is chosen as soon as the last one is known, usually on the way to it.
    """

    name = "explore"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (
        *(Pose, OccupancyGrid, MissionStatus),
        *(ChargeStatus, BatteryLevel, Correction, MapMoved),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (ExploreStatus,)
    answers: ClassVar[tuple[type[Message], ...]] = (ExploreRequest,)
    queries: ClassVar[tuple[type[Message], ...]] = (MissionRequest,)
    parameters = Parameters
    launched_with = ("profile",)
    changeable: ClassVar = {"stuck_s": "s", "tries": "", "charged": ""}
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        body = load_profile(self.p.profile).body
        self._tries = [Margins(r) for r in (body.circle_m + TURNING_M, *radii(body))]
        self._narrow = Margins(body.width_m / 2)  # out of a gap that the map has closed behind it
        self._exploration = 0
        self._state = ExploreState.NONE
        self._note = ""
        self._cells: Cells | None = None
        self._known = 0.0
        self._map_id = 0
        self._revision = 0  # of the map,
        self._placed = 0  # and of that on which the places below lie
        self._anew = False  # the map has moved: choose another target
        self._within = (0.0, 0.0, 0.0, 0.0)
        self._home, self._home_moves = Waypoint(0.0, 0.0, 0.0), True
        self._was_placed = True
        self._places = self._failures = 0
        self._resumed = 0  # explorations that went on at home
        self._avoided: list[Placed] = []  # places given up
        self._second_look = False
        self._order = Ordered()
        self._mission = 0  # the newest that was accepted
        self._target: Placed | None = None  # the place of the current order
        self._way: list[Placed] = []
        self._paused = False  # while the robot is charging
        self._map_at = 0.0

    def on_start(self) -> None:
        """Begin to publish regularly."""
        self.wake_at(self.now + 1.0)

    def on_explore_request(self, request: ExploreRequest, _question: Question) -> MissionReply:
        """Begin at once; an earlier exploration ends."""
        pose = self.fresh(Pose)
        if pose is None:
            return self._refuse("the robot's pose is not known: no fresh encoder/pose")
        if self._cells is None:
            return self._refuse("there is no map yet: no mapping/grid")
        within = (request.x1, request.y1, request.x2, request.y2)
        width, height = within[2] - within[0], within[3] - within[1]
        if not (width > 0 < height and (self._in(within, pose) or not self._is_placed)):
            return self._refuse("the robot is not in the rectangle that is to be explored")
        self._exploration = self.rng.getrandbits(63)
        self._placed, self._anew = self._revision, False  # the first target waits for the next map
        # A given home of a robot without a place lies on the map that it continues, which stays.
        self._home_moves = self._is_placed or request.home is None
        self._was_placed = self._is_placed
        self._within = within
        self._home = request.home or Waypoint(pose.x, pose.y, pose.theta)
        self._places = self._failures = self._resumed = 0
        self._avoided = []
        self._second_look = False
        self._order.own.clear()
        self._mission = 0
        self._paused = False
        self._became(ExploreState.EXPLORING)
        self._drop()
        return MissionReply(self._exploration, length=min(width * height / LANE_M, 1e6))

    def on_occupancy_grid(self, grid: OccupancyGrid) -> None:
        """Update the map; choose another target if the present one has become pointless."""
        try:
            self._cells = cells_of(grid)
        except ValueError as error:
            self.log(f"mapping/grid: {error}", WARNING)
            return
        self._map_at = self.now
        if grid.revision == self._revision:
            self._placed = grid.revision  # `MapMoved` was lost if it did not come in a period
        else:
            self._revision, self._anew = grid.revision, True
        another, self._map_id = grid.map_id != self._map_id, grid.map_id
        self._known = self._cells.area(FREE)
        if another and self._at_work:
            self._abort(LOST_MAP)
        self._choose()

    def on_map_moved(self, change: MapMoved) -> None:
        """Move the places with the map."""
        if change.revision <= self._placed:
            return
        self._placed = change.revision
        if self._home_moves:
            home = self._home
            self._home = Waypoint(*moved(change, home.x, home.y, home.theta))
        self._avoided = [Placed(*moved(change, *place)) for place in self._avoided]
        self._way = [Placed(*moved(change, *place)) for place in self._way]
        self._target = self._way[-1] if self._way else None

    def on_correction(self, correction: Correction) -> None:
        """Keep home where it lies while the robot maps a part of its own: it was carried."""
        if self._was_placed and not self._is_placed:
            self._home_moves = False
        elif self._is_placed and self._placed >= correction.revision:
            self._home_moves = True  # the part has been joined, and its change is done
        self._was_placed = self._is_placed

    def on_pose(self, _pose: Pose) -> None:
        """Choose another target as soon as map, places and pose are of the same revision."""
        if self._anew:
            self._choose()

    def _choose(self) -> None:
        """Choose another target if there is none or the present one has become pointless."""
        pose = self.latest(Pose)
        if not self._at_work or self._order.pending or self._paused:
            return
        if (
            self._cells is None
            or pose is None
            or not (pose.revision == self._placed == self._revision)
        ):
            return
        chart = self._chart(self._cells)
        if self._anew or self._target is None or not self._worth(chart, self._target):
            self._anew = False
            self._go_on(chart)

    def on_mission_status(self, status: MissionStatus) -> None:
        """Detect arrival, progress, and drives for other agents."""
        if not self._at_work:
            return
        event = self._order.update(status, self.now)
        if event is Event.REACHED:
            self._arrived()
        elif event is Event.INTERRUPTED and status.mission not in self._order.own:
            if self._charges:
                self._pause()
            else:
                self._fail("the robot was sent elsewhere")

    def on_wakeup(self) -> None:
        """Publish the status; give up targets that are not reached."""
        self.wake_at(self.now + 1.0)
        if self._at_work and self._paused:
            self._order.nearer_at = self._map_at = self.now
            if not self._charges or self._is_charged:
                self._paused = False
                self.log("goes on exploring")
        elif self._at_work:
            if self.stopped is not None:
                self._order.nearer_at = self.now
            if self.now - self._map_at > self.p.map_s:
                self._abort(f"no map for {self.p.map_s:g} s")
            elif self.now - self._order.nearer_at > self.p.stuck_s:
                self._give_up("no nearer")
        self._publish()

    # Implementation ------------------------------------------------------------------------------

    @property
    def _at_work(self) -> bool:
        return self._state in (ExploreState.EXPLORING, ExploreState.RETURNING)

    @property
    def _charges(self) -> bool:
        """Whether the charger has the robot driven or holds it in a dock."""
        status = self.latest(ChargeStatus)
        return status is not None and status.state is not ChargeState.NONE

    @property
    def _is_charged(self) -> bool:
        """Whether the robot is charged enough to leave the dock."""
        status, level = self.latest(ChargeStatus), self.latest(BatteryLevel)
        docked = status is not None and status.state is ChargeState.CHARGING
        return docked and level is not None and level.share >= self.p.charged

    @property
    def _is_placed(self) -> bool:
        """Whether the place of the robot on the map is known."""
        correction = self.latest(Correction)
        return correction is None or not 0.0 < correction.confidence < PLACED

    def _chart(self, cells: Cells) -> Chart:
        return Chart(cells, self._within if self._is_placed else (-inf, -inf, inf, inf))

    def _pause(self) -> None:
        """Wait for the charger; the next target is chosen afterwards."""
        self.log("the robot is charged first")
        self._drop()
        self._paused = True

    def _in(self, within: tuple[float, float, float, float], at: Pose) -> bool:
        return within[0] <= at.x <= within[2] and within[1] <= at.y <= within[3]

    def _drop(self) -> None:
        """Drop the current target."""
        self._target = None
        self._way = []
        self._order.drop()
        self._order.nearer_at = self._map_at = self.now

    def _worth(self, chart: Chart, target: Placed) -> bool:
        """Return whether a target is still unknown, or home, with nothing detected on the path."""
        pose = self.latest(Pose)
        if pose is not None and self._cells is not None:
            left = [Placed(pose.x, pose.y), *self._way[self._order.leg + 1 :]]
            if crossed(self._cells, left):
                return False
        home = self._state is ExploreState.RETURNING
        return home or chart.unknown_at(target, self._tries[0])

    def _go_on(self, chart: Chart) -> None:
        """Drive to the next frontier, or home if there is none."""
        pose = self.fresh(Pose)
        if pose is None:
            return
        here, home = Placed(pose.x, pose.y, pose.theta), Placed(self._home.x, self._home.y)
        if self._state is ExploreState.EXPLORING:
            places = self._to_frontier(chart, here, home)
            if places is not None:
                self._places += 1
                before = places[-2] if len(places) > 1 else here
                self._drive(places, direction(before, places[-1]))
                return
            if self._avoided and not self._second_look:
                self._second_look = True  # obstacles may have gone, or never been there
                self._avoided = []
                self._go_on(chart)
                return
            if not self._is_placed:
                self._fail("all around is known, but not its place on the map before")
                return
            self._became(ExploreState.RETURNING)
        way = chart.way(here, home, [*self._tries, self._narrow])
        if way is None:
            self._failed("there is no way back")
        else:
            self._drive(way, self._home.theta)

    def _to_frontier(self, chart: Chart, here: Placed, home: Placed) -> list[Placed] | None:
        """Return the path to the next frontier, or None."""
        places = chart.to_frontier(here, self._tries, self._avoided)
        if places is not None or chart.way(here, home, self._tries) is not None:
            return places
        return chart.to_frontier(here, [*self._tries, self._narrow], self._avoided)

    def _drive(self, places: list[Placed], theta: float) -> None:
        """Request the drive from the interface agent."""
        end = places[-1]
        through = tuple(Waypoint(p.x, p.y, p.theta) for p in headed(places))
        goal = Waypoint(end.x, end.y, theta if abs(theta) <= pi else 0.0)
        self._drop()
        self._target, self._way = end, places
        self._order.request(self.now)

        def on_reply(reply: MissionReply | None) -> None:
            refusal = self._order.answered(reply, self.now)
            self._mission = reply.mission if reply is not None and reply.mission else self._mission
            if not self._at_work:  # it ended meanwhile
                self._hold()
            elif refusal:
                self._failed(f"a mission was refused: {refusal}")

        request = MissionRequest(goal, through, planned=False, revision=self._revision)
        self.query(request, on_reply)

    def _arrived(self) -> None:
        if self._state is ExploreState.RETURNING:
            left = len(self._avoided)
            if self._is_open():
                self._resumed += 1
                self._became(ExploreState.EXPLORING)
                self._drop()
            elif left:
                self._fail(f"{left} places could not be reached")
            else:
                self._became(ExploreState.DONE)
            return
        if self._cells is not None and self._target is not None:
            chart = self._chart(self._cells)
            if chart.unknown_at(self._target, self._tries[0]):
                self._give_up("still unknown from there")
        self._target = None

    def _is_open(self) -> bool:
        """Whether there is a frontier again, by what was seen on the way home."""
        pose = self.latest(Pose)
        if self._cells is None or pose is None or self._resumed >= self.p.tries:
            return False
        here, home = Placed(pose.x, pose.y, pose.theta), Placed(self._home.x, self._home.y)
        return self._to_frontier(self._chart(self._cells), here, home) is not None

    def _give_up(self, why: str) -> None:
        """Leave the target for later; failing to reach home is a failure."""
        if self._state is ExploreState.RETURNING or self._target is None:
            self._failed(f"no way on: {why}")
            return
        self.log(f"({self._target.x:.2f}, {self._target.y:.2f}) is left for later: {why}", WARNING)
        self._avoided.append(self._target)
        self._drop()

    def _failed(self, why: str) -> None:
        """Try again with the next map, up to `tries` times."""
        self._drop()
        self._failures += 1
        if self._failures >= self.p.tries:
            self._abort(why)

    def _abort(self, why: str) -> None:
        """End the exploration while the robot is under way, and have it stop where it is."""
        self._fail(why)
        self._drop()
        self._hold()

    def _hold(self) -> None:
        """Replace the newest mission of this agent by one to the present pose."""
        pose = self.latest(Pose)
        if pose is not None and self._mission:
            here = Waypoint(pose.x, pose.y, pose.theta)
            request = MissionRequest(here, planned=False, replaces=self._mission)
            self.query(request, lambda _reply: None)

    def _fail(self, why: str) -> None:
        self._note = line(why)
        self._became(ExploreState.FAILED)

    def _became(self, state: ExploreState) -> None:
        self._state = state
        if state is ExploreState.EXPLORING:
            self._note = ""
        note = f": {self._note}" if self._note else ""
        level = WARNING if state is ExploreState.FAILED else agent.INFO
        self.log(f"{state.value}, {self._known:.0f} m^2 known{note}", level)
        self._publish()

    def _refuse(self, why: str) -> MissionReply:
        self.log(f"refused: {why}", WARNING)
        return MissionReply(0, line(why))

    def _publish(self) -> None:
        given_up = len(self._avoided) if self._exploration else 0
        places = self._places if self._exploration else 0
        self.publish(
            ExploreStatus(self._exploration, self._state, self._known, places, given_up, self._note)
        )
