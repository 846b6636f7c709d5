"""The relocate agent: drives a lost robot until its sensors have localized it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import atan2, cos, hypot, inf, radians, sin, tau
from typing import Annotated, ClassVar, Final, NamedTuple

from msgspec import Meta

from armadico.agents.localization.active_localization import DIRECTIONS, ActiveLocalizer, places_of
from armadico.agents.methods.geometry import rotated
from armadico.agents.methods.grid import CELL_M, check_extent, grid_of
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING
from armadico.core.exchange import Bid
from armadico.core.messages import Message, Point, RobotState
from armadico.core.parameters import TURN_MARGIN_M, Safety
from armadico.core.resources import WHEELS
from armadico.mobile import particles
from armadico.mobile.behaviour import FOUND_S, LOST_M, Behaviour
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import Particles, Pose, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import free_path, free_turn

Metres = Annotated[float, Meta(gt=0, le=10)]

MOST_REVERSALS = 2
"""Changes of the turning direction on the spot after which it stops looking around there."""

MOST_VISITED = 60
"""Former positions that are remembered."""

NEAR_M = 0.1
"""A leg's end is reached at this distance."""

COMPARED_M = 6.0
"""Greatest range that is compared between places: a sonar's reach."""

AHEAD_RAD = radians(20)
"""A sonar within this angle of the heading looks ahead."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How it looks around, and for how long; the map, if there is one, and the robot profile."""

    world: Annotated[str, Meta(min_length=1)] | None = None
    profile: str = "pioneer-2dx"
    v: Annotated[float, Meta(gt=0, le=1)] = 0.25  # m/s
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    v_back: Annotated[float, Meta(gt=0, le=1)] = 0.08  # m/s backwards, or towards silence
    w: Annotated[float, Meta(gt=0, le=2)] = 0.5  # rad/s
    back_room_m: Metres = 0.1  # least free distance behind for backing out
    ahead_m: Metres = 0.35  # with less free distance ahead it turns
    open_m: Metres = 0.9  # free distance that ends the turn; `ahead_m` after half of patience_s
    step_m: Metres = 0.3  # distance between former positions: progress
    patience_s: Annotated[float, Meta(gt=0, le=600)] = 10.0  # without progress: any free way
    silent_s: Annotated[float, Meta(gt=0, le=60)] = 1.0  # without an echo ahead it creeps
    leg_m: Metres = 3.0  # after this distance straight ahead it looks around again
    tell_m: Metres = 2.0  # greatest length of a leg that distinguishes places
    off_rad: Annotated[float, Meta(gt=0, le=1)] = 0.2  # it first turns to a leg farther off
    wait_s: Annotated[float, Meta(gt=0, le=60)] = 2.0  # until the next choice if no leg helps
    give_up_s: Annotated[float, Meta(gt=0, le=3600)] = FOUND_S
    utility_least: Annotated[float, Meta(ge=0, le=1)] = 0.4  # when just lost
    utility_most_m: Metres = 2.0  # standard deviation of the pose at which the utility is 1
    safety: Safety = Safety()


Command = tuple[float, float, str]
"""A speed (m/s), a turn rate (rad/s) and the reason."""


class Phase(Enum):
    """What a lost robot does."""

    LOOK = "turns once on the spot"
    SEARCH = "turns until the way ahead is open"
    DRIVE = "drives straight on"
    ESCAPE = "drives any free way"
    FACE = "turns to a leg that distinguishes places"
    LEG = "drives along it"


class Event(Enum):
    TURNED = "it has turned once, or cannot turn"
    SHUT = "there is no room ahead, or no echo"
    OPEN = "there is room ahead, and an echo"
    BOXED_IN = "it can neither turn nor drive on"
    FAR = "it has driven `leg_m` since it looked around"
    STALLED = "it has made no progress for `patience_s`"
    NO_ROOM = "there is no room, neither ahead nor behind"
    PROGRESS = "it has made progress"
    FOUND = "a leg distinguishes places"
    FACING = "it faces the leg's end"
    ENDED = "the leg's end is reached, or it is blocked"


TRANSITIONS: Final[Mapping[tuple[Phase, Event], Phase]] = {
    (Phase.LOOK, Event.TURNED): Phase.DRIVE,
    (Phase.LOOK, Event.STALLED): Phase.ESCAPE,
    (Phase.SEARCH, Event.TURNED): Phase.DRIVE,
    (Phase.SEARCH, Event.OPEN): Phase.DRIVE,
    (Phase.SEARCH, Event.FAR): Phase.LOOK,
    (Phase.SEARCH, Event.STALLED): Phase.ESCAPE,
    (Phase.DRIVE, Event.SHUT): Phase.SEARCH,
    (Phase.DRIVE, Event.BOXED_IN): Phase.LOOK,
    (Phase.DRIVE, Event.FAR): Phase.LOOK,
    (Phase.DRIVE, Event.STALLED): Phase.ESCAPE,
    (Phase.DRIVE, Event.FOUND): Phase.FACE,
    (Phase.ESCAPE, Event.PROGRESS): Phase.DRIVE,
    (Phase.ESCAPE, Event.NO_ROOM): Phase.DRIVE,
    (Phase.ESCAPE, Event.FAR): Phase.LOOK,
    (Phase.ESCAPE, Event.FOUND): Phase.FACE,
    (Phase.FACE, Event.FACING): Phase.LEG,
    (Phase.FACE, Event.ENDED): Phase.DRIVE,
    (Phase.LEG, Event.ENDED): Phase.DRIVE,
}
"""All changes of phase. An event without an entry for the phase changes nothing."""


@dataclass(frozen=True)
class EchoAhead:
    """The last echo ahead: when, its distance from the footprint's front, and the odometry then."""

    at: float = -inf  # s; never
    m: float = 0.0
    by: Pose2 = STOOD


@dataclass
class Stall:
    """How long it has made no progress."""

    driving_s: float = 0.0  # less the time of looking around
    reversals: int = 0  # changes of the turning direction meanwhile
    back: bool | None = None  # the free way is backwards


@dataclass
class Recovery:
    """One attempt to localize a lost robot; poses are by the odometry."""

    since: float  # when the robot got lost, s
    bid_at: float  # the last bid, s
    stall: Stall
    phase: Phase = Phase.LOOK
    left: float = tau  # of the turn in LOOK, rad
    way_m: float = 0.0  # driven since it looked around
    searched: float = -tau  # turned since it looked around or searched for a free way, rad
    visited: list[Pose2] = field(default_factory=list)
    leg_end: Pose2 = STOOD  # in FACE and LEG
    chosen_at: float = -inf  # the last choice of a leg, s
    gave_up: bool = False

    def on(self, event: Event) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)


class Room(NamedTuple):
    """The obstacles of this cycle, and the free distances ahead and behind, m."""

    obstacles: Obstacles
    ahead: float
    behind: float


class Relocate(Behaviour):
    """Turns once on the spot, then drives where its sensors are likely to localize it.

    The localization agent publishes the places where the robot may be. If there are several and the
    map is known, it takes a straight leg that is free at all of them and along which the expected
    ranges differ most. Without places or a map it drives where it is free and turns again: similar
    places differ in what follows them. It needs no pose, and keeps the safety margins.

    A sonar receives no echo from a smooth wall at a slant, and a map does not help a lost robot. So
    it drives towards the last echo ahead, no faster than it can stop before it. While there is no
    echo ahead it creeps; if there is none all around, it drives on.
    """

    name = "relocate"
    reacts_to = Obstacles
    receives: ClassVar[tuple[type[Message], ...]] = (*Behaviour.receives, Sonar, Particles)
    parameters = Parameters
    launched_with = ("v_max", "world", "profile")
    changeable: ClassVar = {
        "v_max": "m/s",
        "v": "m/s",
        "w": "rad/s",
        "give_up_s": "s",
        "safety.margin_m": "m",
    }
    seeks = True
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._recovery = Recovery(-inf, -inf, Stall())
        self._side = 1.0  # of turns on the spot: 1 left, -1 right
        self._last_echo: EchoAhead | None = None  # None: no sonar yet
        self._particles: Particles | None = None  # decoded only when needed
        self._placed_at: Pose2 = STOOD  # the odometry when they were received
        self._localizer: ActiveLocalizer | None = None
        if self.p.world is not None:
            world, profile = load_world(self.p.world), load_profile(self.p.profile)
            check_extent(world, CELL_M)
            grid = grid_of(world.barriers, world.bounds, CELL_M)
            self._localizer = ActiveLocalizer(
                grid, profile.body.circle_m, min(profile.reach_m, COMPARED_M)
            )

    def on_sonar(self, sonar: Sonar) -> None:
        """Store the nearest echo ahead."""
        near = [
            echo.x + echo.range
            for echo in sonar.echoes
            if abs(echo.bearing) < AHEAD_RAD and echo.range is not None
        ]
        if near and self._body is not None:
            front = min(near) - self._body.outline.front
            self._last_echo = EchoAhead(self.now, front, self._odometry)
        elif self._last_echo is None:
            self._last_echo = EchoAhead()

    def on_particles(self, message: Particles) -> None:
        if len(message.packed) % particles.EACH == 0:
            self._particles, self._placed_at = message, self._odometry

    @property
    def _odometry(self) -> Pose2:
        state = self.latest(RobotState)
        return STOOD if state is None else (state.x, state.y, state.theta)

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        self._update_recovery()
        if self.now - self._recovery.since > self.p.give_up_s:
            self.why = f"not localized in {self.p.give_up_s:g} s"
            if not self._recovery.gave_up:
                self._recovery.gave_up = True
                self.log(f"the robot is lost and was {self.why}: it stays at rest", WARNING)
            return None
        v, w, reason = self._act(obstacles)
        v, w = self.limited(min(v, self._stopping_speed), w, obstacles, self.p.safety)
        share = min(1.0, (pose.deviation - LOST_M) / (self.p.utility_most_m - LOST_M))
        utility = self.p.utility_least + share * (1.0 - self.p.utility_least)
        return Bid(utility, (v, w), reason=reason)

    def _update_recovery(self) -> None:
        """Measure the time, turn and distance since the robot got lost."""
        cycle_s = self.body.cycle_s
        if self.now - self._recovery.bid_at > 10.0 * cycle_s:
            self._recovery = Recovery(self.now, self.now, Stall(-tau / self.p.w))
        recovery = self._recovery
        recovery.bid_at = self.now
        x, y, _ = here = self._odometry
        visited = recovery.visited
        if not visited or hypot(x - visited[-1][0], y - visited[-1][1]) > self.p.step_m:
            recovery.visited = [*visited[-MOST_VISITED:], here]
            if len(recovery.visited) > 1:
                recovery.stall = Stall()
        if self.holds(WHEELS):
            v, w = self.measured
            recovery.left = max(0.0, recovery.left - abs(w) * cycle_s)
            recovery.searched += abs(w) * cycle_s
            recovery.stall.driving_s += cycle_s
            recovery.way_m += abs(v) * cycle_s
        if recovery.phase is Phase.LOOK and recovery.left <= 0.0:
            recovery.on(Event.TURNED)

    @property
    def _patience(self) -> float:
        """Time without progress, as a share of the patience; above 1 any free way is taken."""
        stall = self._recovery.stall
        return max(stall.driving_s / self.p.patience_s, stall.reversals / (2 * MOST_REVERSALS))

    @property
    def _silent(self) -> bool:
        """Whether there is no echo ahead but may be one in another direction."""
        ahead = self._last_echo
        silent = ahead is not None and self.now - ahead.at > self.p.silent_s
        return silent and self._recovery.searched < tau

    @property
    def _speed(self) -> float:
        """The speed forwards, m/s."""
        return min(self.p.v, self.p.v_max or inf)

    @property
    def _slow(self) -> float:
        """The speed backwards, m/s."""
        return min(self.p.v_back, self._speed)

    @property
    def _stopping_speed(self) -> float:
        """The speed from which it stops before the last echo ahead, m/s."""
        ahead, p = self._last_echo, self.p
        if self._silent:
            return p.v_back
        if ahead is None or self.now - ahead.at > p.silent_s:  # a laser, or no echo all around
            return inf
        x, y, _ = relative(ahead.by, self._odometry)
        left = ahead.m - hypot(x, y) - p.safety.margin_m
        return max(p.v_back, self.body.stops_within(left))

    # Changes of phase ----------------------------------------------------------------------------

    def _act(self, obstacles: Obstacles) -> Command:
        """Change the phase by the events of this cycle, and act by it."""
        p, outline, points = self.p, self.body.outline, obstacles.points
        mirrored = [Point(-point.x, -point.y) for point in points]
        ahead = free_path(points, 1.0, 0.0, outline, p.safety.margin_m)
        behind = free_path(mirrored, 1.0, 0.0, outline.turned_round, p.safety.margin_m)
        # Where the robot agent lets nothing through there is no room, whatever the obstacles show.
        room = Room(
            obstacles,
            0.0 if self.refuses(self._speed, 0.0) else ahead,
            0.0 if self.refuses(-self._slow, 0.0) else behind,
        )
        self._check_leg(room)
        if self._recovery.phase not in (Phase.FACE, Phase.LEG):
            self._check_progress(room)
            self._check_ahead(room)
            self._check_turn(room)
        match self._recovery.phase:
            case Phase.LOOK | Phase.SEARCH:
                return 0.0, self._side * p.w, "lost: look around"
            case Phase.DRIVE:
                return self._drive(room)
            case Phase.ESCAPE:
                v = -self._slow if self._recovery.stall.back else self._speed
                return v, 0.0, "lost: to where there is room"
            case Phase.FACE:
                side = self._side_to(self._to_leg_end()[1], room) or 0.0
                return 0.0, side * p.w, "lost: to where places differ"
            case Phase.LEG:
                off = self._to_leg_end()[1]
                return self._speed, self._leg_turn(off), "lost: to where places differ"

    def _check_leg(self, room: Room) -> None:
        """Find a leg that distinguishes places, or end it."""
        p, recovery = self.p, self._recovery
        if recovery.phase in (Phase.DRIVE, Phase.ESCAPE):
            self._find_leg(room)
        if recovery.phase not in (Phase.FACE, Phase.LEG):
            return
        x, off = self._to_leg_end()
        if recovery.phase is Phase.FACE and abs(off) > p.off_rad:
            if self._side_to(off, room) is None:
                recovery.on(Event.ENDED)
            return
        recovery.on(Event.FACING)
        turn = self._leg_turn(off) if recovery.phase is Phase.LEG else 0.0
        blocked = room.ahead < p.back_room_m or self.refuses(self._speed, turn)
        if x <= NEAR_M or blocked:
            recovery.on(Event.ENDED)
            recovery.way_m, recovery.chosen_at = 0.0, self.now if blocked else -inf

    def _find_leg(self, room: Room) -> None:
        p, recovery, here = self.p, self._recovery, self._odometry
        if self._localizer is None or self.now < recovery.chosen_at + p.wait_s:
            return
        recovery.chosen_at = self.now
        since = relative(self._placed_at, here)
        drawn = [] if self._particles is None else particles.poses_of(self._particles)
        leg = self._localizer.leg(
            [(compose(pose, since), share) for pose, share in places_of(drawn)],
            [self._room_in(room.obstacles, turn * tau / DIRECTIONS) for turn in range(DIRECTIONS)],
            [relative(here, visited)[:2] for visited in recovery.visited],
            self._speed,
            p.w,
        )
        if leg is not None:
            length = min(leg.length, p.tell_m)
            end = (length * cos(leg.heading), length * sin(leg.heading), 0.0)
            recovery.leg_end = compose(here, end)
            recovery.on(Event.FOUND)

    def _check_progress(self, room: Room) -> None:
        """Look around after a while; take any way if there is no progress."""
        p, recovery = self.p, self._recovery
        if recovery.way_m > p.leg_m:
            recovery.on(Event.FAR)
            recovery.left, recovery.way_m, recovery.searched = tau, 0.0, -tau
            recovery.stall.driving_s -= tau / p.w
        if self._patience <= 1.0:
            recovery.on(Event.PROGRESS)
            return
        recovery.on(Event.STALLED)
        recovery.searched, stall = 0.0, recovery.stall
        stall.back = room.ahead < room.behind if stall.back is None else stall.back
        if (room.behind if stall.back else room.ahead) <= p.back_room_m:
            recovery.on(Event.NO_ROOM)
            recovery.stall = Stall()

    def _check_ahead(self, room: Room) -> None:
        """Start a turn where it cannot drive on, and end it where it can."""
        p, recovery, silent = self.p, self._recovery, self._silent
        if recovery.phase is Phase.DRIVE and (room.ahead < p.ahead_m or silent):
            recovery.on(Event.SHUT)
            recovery.searched = 0.0
            left, right = (
                inf if o is None else hypot(o.x, o.y)
                for o in (room.obstacles.left, room.obstacles.right)
            )
            self._side = (
                1.0 if left > right or (left == right and self.rng.random() < 0.5) else -1.0
            )
            return
        enough = p.open_m if self._patience < 0.5 else p.ahead_m
        if not silent and room.ahead > enough:
            recovery.on(Event.OPEN)

    def _check_turn(self, room: Room) -> None:
        """Choose the side to turn to, if there is one."""
        recovery = self._recovery
        if recovery.phase not in (Phase.LOOK, Phase.SEARCH):
            return
        points, turn_room = room.obstacles.points, self.p.safety.turn_room
        for side in (self._side, -self._side):
            if self.refuses(0.0, side * self.p.w):
                continue
            if free_turn(points, side, self.body.outline, TURN_MARGIN_M) > turn_room:
                recovery.stall.reversals += side != self._side
                self._side = side
                if recovery.phase is Phase.LOOK and recovery.stall.reversals >= MOST_REVERSALS:
                    break  # it has seen all there is to see from here
                return
        recovery.on(Event.TURNED)

    def _drive(self, room: Room) -> Command:
        if room.ahead >= self.p.ahead_m:
            return self._speed, 0.0, "lost: drive on"
        if room.behind <= self.p.back_room_m:
            if room.ahead > self.p.back_room_m:  # it backed off from there, or cannot turn yet
                return self._slow, 0.0, "lost: on, as far as there is room"
            return 0.0, 0.0, "lost: no way on"
        # It backs out the way it came, and looks around again.
        self._recovery.on(Event.BOXED_IN)
        self._recovery.left = tau
        return -self._slow, 0.0, "lost: back out"

    # Geometry ------------------------------------------------------------------------------------

    def _to_leg_end(self) -> tuple[float, float]:
        """The distance ahead (m) and the bearing (rad) of the leg's end."""
        x, y, _ = relative(self._odometry, self._recovery.leg_end)
        return x, wrap(atan2(y, x))

    def _leg_turn(self, off: float) -> float:
        """The turn rate towards a bearing while it drives there, rad/s."""
        return max(-self.p.w, min(self.p.w, off))

    def _side_to(self, off: float, room: Room) -> float | None:
        """The side by which it can turn to a bearing, the shorter way first: 1 left, -1 right."""
        for side in (1.0, -1.0) if off > 0.0 else (-1.0, 1.0):
            free = free_turn(room.obstacles.points, side, self.body.outline, TURN_MARGIN_M)
            if free > side * off % tau and not self.refuses(0.0, side * self.p.w):
                return side
        return None

    def _room_in(self, obstacles: Obstacles, heading: float) -> float:
        """Free distance in a heading after turning there, m."""
        turned = rotated(obstacles.points, heading)
        return free_path(turned, 1.0, 0.0, self.body.outline, self.p.safety.margin_m)
