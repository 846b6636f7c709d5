"""The explore agent: has the robot driven from frontier to frontier of the map, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import inf, pi
from typing import Annotated, ClassVar, Final

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
from armadico.mobile.driven import Event as Driven
from armadico.mobile.driven import Ordered
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


class Event(Enum):
    KNOWN = "everything reachable is known"
    OPEN = "on the way home a frontier was seen again"
    BACK = "the robot is back"
    FAILED = "it cannot go on"


TRANSITIONS: Final[Mapping[tuple[ExploreState, Event], ExploreState]] = {
    (ExploreState.EXPLORING, Event.KNOWN): ExploreState.RETURNING,
    (ExploreState.EXPLORING, Event.FAILED): ExploreState.FAILED,
    (ExploreState.RETURNING, Event.OPEN): ExploreState.EXPLORING,
    (ExploreState.RETURNING, Event.BACK): ExploreState.DONE,
    (ExploreState.RETURNING, Event.FAILED): ExploreState.FAILED,
}
"""All changes of state after the request, which begins it."""

WORKING: Final = (ExploreState.EXPLORING, ExploreState.RETURNING)


@dataclass(frozen=True)
class Map:
    """The newest map."""

    number: int
    revision: int
    cells: Cells
    known: float  # the free area, m^2


@dataclass
class Places:
    """The places of an exploration, which move with the map."""

    revision: int  # of the map on which they lie
    home: Waypoint
    home_moves: bool
    was_placed: bool  # the place of the robot on the map was known at the last correction
    avoided: list[Placed] = field(default_factory=list)  # places given up
    way: list[Placed] = field(default_factory=list)  # of the current order; empty: no target

    @property
    def target(self) -> Placed | None:
        return self.way[-1] if self.way else None

    def move(self, change: MapMoved) -> None:
        """Move them with the map."""
        if change.revision <= self.revision:
            return
        self.revision = change.revision
        if self.home_moves:
            home = self.home
            self.home = Waypoint(*moved(change, home.x, home.y, home.theta))
        self.avoided = [Placed(*moved(change, *place)) for place in self.avoided]
        self.way = [Placed(*moved(change, *place)) for place in self.way]

    def correct(self, revision: int, *, is_placed: bool) -> None:
        """Keep home where it lies while the robot maps a part of its own: it was carried."""
        if self.was_placed and not is_placed:
            self.home_moves = False
        elif is_placed and self.revision >= revision:
            self.home_moves = True  # the part has been joined, and its change is done
        self.was_placed = is_placed


@dataclass
class Exploration:
    """What one request has begun."""

    number: int
    within: tuple[float, float, float, float]
    places: Places
    map_at: float  # when the timeout for a map began, s
    state: ExploreState = ExploreState.EXPLORING
    note: str = ""
    paused: bool = False  # while the robot is charging, in each of `WORKING`
    anew: bool = False  # the map has moved: choose another target
    mission: int = 0  # the newest that was accepted
    driven_to: int = 0  # places
    failures: int = 0
    resumed: int = 0  # how often it went on at home
    second_look: bool = False  # at the places given up


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

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        body = load_profile(self.p.profile).body
        self._tries = [Margins(r) for r in (body.circle_m + TURNING_M, *radii(body))]
        self._narrow = Margins(body.width_m / 2)  # out of a gap that the map has closed behind it
        self._map: Map | None = None
        self._exploration: Exploration | None = None  # the newest
        self._order = Ordered()

    def on_start(self) -> None:
        """Begin to publish regularly."""
        self.wake_at(self.now + 1.0)

    def on_explore_request(self, request: ExploreRequest, _question: Question) -> MissionReply:
        """Begin at once; an earlier exploration ends."""
        pose = self.fresh(Pose)
        if pose is None:
            return self._refuse("the robot's pose is not known: no fresh encoder/pose")
        if self._map is None:
            return self._refuse("there is no map yet: no mapping/grid")
        within = (request.x1, request.y1, request.x2, request.y2)
        width, height = within[2] - within[0], within[3] - within[1]
        if not (width > 0 < height and (self._in(within, pose) or not self._is_placed)):
            return self._refuse("the robot is not in the rectangle that is to be explored")
        # A given home of a robot without a place lies on the map that it continues, which stays.
        home_moves = self._is_placed or request.home is None
        home = request.home or Waypoint(pose.x, pose.y, pose.theta)
        # The first target waits for the next map.
        places = Places(self._map.revision, home, home_moves, self._is_placed)
        exploration = Exploration(self.rng.getrandbits(63), within, places, self.now)
        self._exploration = exploration
        self._order.own.clear()
        self._report()
        self._drop(exploration)
        return MissionReply(exploration.number, length=min(width * height / LANE_M, 1e6))

    def on_occupancy_grid(self, grid: OccupancyGrid) -> None:
        """Update the map; choose another target if the present one has become pointless."""
        try:
            cells = cells_of(grid)
        except ValueError as error:
            self.log(f"mapping/grid: {error}", WARNING)
            return
        before, self._map = self._map, Map(grid.map_id, grid.revision, cells, cells.area(FREE))
        exploration = self._at_work
        if exploration is None or before is None:
            return
        exploration.map_at = self.now
        if grid.revision == before.revision:
            # `MapMoved` was lost if it did not come in a period.
            exploration.places.revision = grid.revision
        else:
            exploration.anew = True
        if grid.map_id != before.number:
            self._abort(exploration, LOST_MAP)
        self._choose()

    def on_map_moved(self, change: MapMoved) -> None:
        if self._exploration is not None:
            self._exploration.places.move(change)

    def on_correction(self, correction: Correction) -> None:
        if self._exploration is not None:
            self._exploration.places.correct(correction.revision, is_placed=self._is_placed)

    def on_pose(self, _pose: Pose) -> None:
        """Choose another target as soon as map, places and pose are of the same revision."""
        if self._exploration is not None and self._exploration.anew:
            self._choose()

    def _choose(self) -> None:
        """Choose another target if there is none or the present one has become pointless."""
        pose, exploration, chart = self.latest(Pose), self._at_work, self._map
        if exploration is None or self._order.pending or exploration.paused:
            return
        if chart is None or pose is None:
            return
        places = exploration.places
        if not pose.revision == places.revision == chart.revision:
            return
        if exploration.anew or not self._worth(exploration, chart):
            exploration.anew = False
            self._go_on(exploration, chart)

    def on_mission_status(self, status: MissionStatus) -> None:
        """Detect arrival, progress, and drives for other agents."""
        exploration = self._at_work
        if exploration is None:
            return
        event = self._order.update(status, self.now)
        if event is Driven.REACHED:
            self._arrived(exploration, status.doubt)
        elif event is Driven.INTERRUPTED and status.mission not in self._order.own:
            if self._charges:
                # It waits for the charger; the next target is chosen afterwards.
                self.log("the robot is charged first")
                self._drop(exploration)
                exploration.paused = True
            else:
                self._fail(exploration, "the robot was sent elsewhere")

    def on_wakeup(self) -> None:
        """Publish the status; give up targets that are not reached."""
        self.wake_at(self.now + 1.0)
        exploration = self._at_work
        if exploration is not None and exploration.paused:
            self._order.nearer_at = exploration.map_at = self.now
            if not self._charges or self._is_charged:
                exploration.paused = False
                self.log("goes on exploring")
        elif exploration is not None:
            if self.stopped is not None:
                self._order.nearer_at = self.now
            if self.now - exploration.map_at > self.p.map_s:
                self._abort(exploration, f"no map for {self.p.map_s:g} s")
            elif self.now - self._order.nearer_at > self.p.stuck_s:
                self._give_up(exploration, "no nearer")
        self._publish()

    # Implementation ------------------------------------------------------------------------------

    @property
    def _at_work(self) -> Exploration | None:
        """The newest exploration while it is under way."""
        exploration = self._exploration
        return exploration if exploration is not None and exploration.state in WORKING else None

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

    def _chart(self, exploration: Exploration, known: Map) -> Chart:
        within = exploration.within if self._is_placed else (-inf, -inf, inf, inf)
        return Chart(known.cells, within)

    def _in(self, within: tuple[float, float, float, float], at: Pose) -> bool:
        return within[0] <= at.x <= within[2] and within[1] <= at.y <= within[3]

    def _drop(self, exploration: Exploration) -> None:
        """Drop the current target."""
        exploration.places.way = []
        self._order.drop()
        self._order.nearer_at = exploration.map_at = self.now

    def _worth(self, exploration: Exploration, known: Map) -> bool:
        """Return whether a target is still unknown, or home, with nothing detected on the path."""
        pose, places = self.latest(Pose), exploration.places
        if places.target is None:
            return False
        if pose is not None:
            left = [Placed(pose.x, pose.y), *places.way[self._order.leg + 1 :]]
            if crossed(known.cells, left):
                return False
        if exploration.state is ExploreState.RETURNING:
            return True
        return self._chart(exploration, known).unknown_at(places.target, self._tries[0])

    def _go_on(self, exploration: Exploration, known: Map) -> None:
        """Drive to the next frontier, or home if there is none."""
        pose, places, chart = self.fresh(Pose), exploration.places, self._chart(exploration, known)
        if pose is None:
            return
        here, home = Placed(pose.x, pose.y, pose.theta), Placed(places.home.x, places.home.y)
        if exploration.state is ExploreState.EXPLORING:
            way = self._to_frontier(chart, here, places)
            if way is None and places.avoided and not exploration.second_look:
                # Obstacles may have gone, or never been there.
                exploration.second_look, places.avoided = True, []
                way = self._to_frontier(chart, here, places)
            if way is not None:
                exploration.driven_to += 1
                before = way[-2] if len(way) > 1 else here
                self._drive(exploration, way, direction(before, way[-1]))
                return
            if not self._is_placed:
                self._fail(exploration, "all around is known, but not its place on the map before")
                return
            self._on(exploration, Event.KNOWN)
        way = chart.way(here, home, [*self._tries, self._narrow])
        if way is None:
            self._failed(exploration, "there is no way back")
        else:
            self._drive(exploration, way, places.home.theta)

    def _to_frontier(self, chart: Chart, here: Placed, places: Places) -> list[Placed] | None:
        """Return the path to the next frontier, or None."""
        home = Placed(places.home.x, places.home.y)
        way = chart.to_frontier(here, self._tries, places.avoided)
        if way is not None or chart.way(here, home, self._tries) is not None:
            return way
        return chart.to_frontier(here, [*self._tries, self._narrow], places.avoided)

    def _drive(self, exploration: Exploration, way: list[Placed], theta: float) -> None:
        """Request the drive from the interface agent."""
        end = way[-1]
        through = tuple(Waypoint(p.x, p.y, p.theta) for p in headed(way))
        goal = Waypoint(end.x, end.y, theta if abs(theta) <= pi else 0.0)
        self._drop(exploration)
        exploration.places.way = way
        self._order.request(self.now)

        def on_reply(reply: MissionReply | None) -> None:
            refusal = self._order.answered(reply, self.now)
            newest = self._exploration or exploration
            newest.mission = (
                reply.mission if reply is not None and reply.mission else newest.mission
            )
            if self._at_work is None:  # it ended meanwhile
                self._hold(newest)
            elif refusal:
                self._failed(newest, f"a mission was refused: {refusal}")

        revision = 0 if self._map is None else self._map.revision
        self.query(
            MissionRequest(goal, through, planned=False, revision=revision, by=self.name), on_reply
        )

    def _arrived(self, exploration: Exploration, doubt: str) -> None:
        if exploration.state is ExploreState.RETURNING:
            left = len(exploration.places.avoided)
            if self._is_open(exploration):
                exploration.resumed += 1
                self._on(exploration, Event.OPEN)
                self._drop(exploration)
            elif left:
                self._fail(exploration, f"{left} places could not be reached")
            else:
                exploration.note = doubt
                self._on(exploration, Event.BACK)
            return
        target = exploration.places.target
        if self._map is not None and target is not None:
            chart = self._chart(exploration, self._map)
            if chart.unknown_at(target, self._tries[0]):
                self._give_up(exploration, "still unknown from there")
        exploration.places.way = []

    def _is_open(self, exploration: Exploration) -> bool:
        """Whether there is a frontier again, by what was seen on the way home."""
        pose = self.latest(Pose)
        if self._map is None or pose is None or exploration.resumed >= self.p.tries:
            return False
        here, chart = Placed(pose.x, pose.y, pose.theta), self._chart(exploration, self._map)
        return self._to_frontier(chart, here, exploration.places) is not None

    def _give_up(self, exploration: Exploration, why: str) -> None:
        """Leave the target for later; failing to reach home is a failure."""
        target = exploration.places.target
        if exploration.state is ExploreState.RETURNING or target is None:
            self._failed(exploration, f"no way on: {why}")
            return
        self.log(f"({target.x:.2f}, {target.y:.2f}) is left for later: {why}", WARNING)
        exploration.places.avoided.append(target)
        self._drop(exploration)

    def _failed(self, exploration: Exploration, why: str) -> None:
        """Try again with the next map, up to `tries` times."""
        self._drop(exploration)
        exploration.failures += 1
        if exploration.failures >= self.p.tries:
            self._abort(exploration, why)

    def _abort(self, exploration: Exploration, why: str) -> None:
        """End the exploration while the robot is under way, and have it stop where it is."""
        self._fail(exploration, why)
        self._drop(exploration)
        self._hold(exploration)

    def _hold(self, exploration: Exploration) -> None:
        """Replace the newest mission of this agent by one to the present pose."""
        pose = self.latest(Pose)
        if pose is not None and exploration.mission:
            here = Waypoint(pose.x, pose.y, pose.theta)
            request = MissionRequest(here, planned=False, replaces=exploration.mission)
            self.query(request, lambda _reply: None)

    def _fail(self, exploration: Exploration, why: str) -> None:
        exploration.note = line(why)
        self._on(exploration, Event.FAILED)

    def _on(self, exploration: Exploration, event: Event) -> None:
        exploration.state = TRANSITIONS[exploration.state, event]
        self._report()

    def _report(self) -> None:
        """Log the state, and publish it."""
        status = self._status()
        note = f": {status.note}" if status.note else ""
        level = WARNING if status.state is ExploreState.FAILED else agent.INFO
        self.log(f"{status.state.value}, {status.known:.0f} m^2 known{note}", level)
        self.publish(status)

    def _refuse(self, why: str) -> MissionReply:
        self.log(f"refused: {why}", WARNING)
        return MissionReply(0, line(why))

    def _publish(self) -> None:
        self.publish(self._status())

    def _status(self) -> ExploreStatus:
        known, newest = 0.0 if self._map is None else self._map.known, self._exploration
        if newest is None:
            return ExploreStatus(0, ExploreState.NONE, known)
        given_up = len(newest.places.avoided)
        return ExploreStatus(
            newest.number, newest.state, known, newest.driven_to, given_up, newest.note
        )
