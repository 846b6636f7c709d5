"""The relocate agent: drives a lost robot until its sensors have localized it."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, inf, radians, sin, tau
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.localization.active_localization import DIRECTIONS, ActiveLocalizer, places_of
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
from armadico.mobile.behaviour import LOST_M, Behaviour
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
    tell_m: Metres = 2.0  # or, on a leg that distinguishes places, chooses the next leg
    off_rad: Annotated[float, Meta(gt=0, le=1)] = 0.2  # it first turns to a leg farther off
    wait_s: Annotated[float, Meta(gt=0, le=60)] = 2.0  # until the next choice if no leg helps
    give_up_s: Annotated[float, Meta(gt=0, le=3600)] = 120.0
    utility_least: Annotated[float, Meta(ge=0, le=1)] = 0.4  # when just lost
    utility_most_m: Metres = 2.0  # standard deviation of the pose at which the utility is 1
    safety: Safety = Safety()


@dataclass(frozen=True)
class EchoAhead:
    """The last echo ahead: when, its distance from the footprint's front, and the odometry then."""

    at: float = -inf  # s; never
    m: float = 0.0
    by: Pose2 = STOOD


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

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._since = -inf  # when the robot got lost
        self._bid_at = -inf
        self._left = 0.0  # of the turn, rad
        self._way = 0.0  # of the leg, m
        self._searched = 0.0  # turned so far in search of a free way, rad
        self._last_echo: EchoAhead | None = None  # None: no sonar yet
        self._stalled_s = 0.0  # driving time without progress, less that of a look around, s
        self._back: bool | None = None  # the free way is backwards
        self._reversals = 0  # changes of the turning direction meanwhile
        self._side = 1.0
        self._gave_up = False
        self._localizer: ActiveLocalizer | None = None
        if self.p.world is not None:
            world, profile = load_world(self.p.world), load_profile(self.p.profile)
            check_extent(world, CELL_M)
            grid = grid_of(world.barriers, world.bounds, CELL_M)
            self._localizer = ActiveLocalizer(
                grid, profile.body.circle_m, min(profile.reach_m, COMPARED_M)
            )
        self._particles: Particles | None = None  # decoded only when needed
        self._placed_at: Pose2 = STOOD  # the odometry when they were received
        self._visited: list[Pose2] = []  # former positions since it is lost, by the odometry
        self._to: Pose2 | None = (
            None  # the end of the leg that distinguishes places, by the odometry
        )
        self._facing = False  # towards that end
        self._chosen_at = -inf

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
        self._begin()
        if self.now - self._since > self.p.give_up_s:
            self.why = f"not localized in {self.p.give_up_s:g} s"
            if not self._gave_up:
                self._gave_up = True
                self.log(f"the robot is lost and was {self.why}: it stays at rest", WARNING)
            return None
        v, w, reason = self._act(obstacles)
        v, w = self.limited(min(v, self._stopping_speed), w, obstacles, self.p.safety)
        share = min(1.0, (pose.deviation - LOST_M) / (self.p.utility_most_m - LOST_M))
        utility = self.p.utility_least + share * (1.0 - self.p.utility_least)
        return Bid(utility, (v, w), reason=reason)

    def _begin(self) -> None:
        """Measure the time, turn and distance since the robot got lost."""
        cycle_s = self.body.cycle_s
        if self.now - self._bid_at > 10.0 * cycle_s:
            self._since, self._gave_up = self.now, False
            self._left, self._way, self._searched = tau, 0.0, -tau
            self._visited, self._to = [], None
            self._stalled_s, self._reversals = -tau / self.p.w, 0
        self._bid_at = self.now
        x, y, _ = here = self._odometry
        if (
            not self._visited
            or hypot(x - self._visited[-1][0], y - self._visited[-1][1]) > self.p.step_m
        ):
            self._visited = [*self._visited[-MOST_VISITED:], here]
            if len(self._visited) > 1:
                self._stalled_s, self._reversals, self._back = 0.0, 0, None
        if self.holds(WHEELS):
            v, w = self.measured
            self._left = max(0.0, self._left - abs(w) * cycle_s)
            self._searched += abs(w) * cycle_s
            self._stalled_s += cycle_s
            self._way += abs(v) * cycle_s

    @property
    def _patience(self) -> float:
        """Time without progress, as a share of the patience; above 1 any free way is taken."""
        return max(self._stalled_s / self.p.patience_s, self._reversals / (2 * MOST_REVERSALS))

    @property
    def _silent(self) -> bool:
        """Whether there is no echo ahead but may be one in another direction."""
        ahead = self._last_echo
        silent = ahead is not None and self.now - ahead.at > self.p.silent_s
        return silent and self._searched < tau

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

    def _act(self, obstacles: Obstacles) -> tuple[float, float, str]:
        p, outline, points = self.p, self.body.outline, obstacles.points
        ahead = free_path(points, 1.0, 0.0, outline, p.safety.margin_m)
        command = self._drive_to_distinguish(obstacles, ahead)
        if command is not None:
            return command
        if self._way > p.leg_m:
            self._left, self._way, self._searched = tau, 0.0, -tau
            self._stalled_s -= tau / p.w
        mirrored = [Point(-point.x, -point.y) for point in points]
        behind = free_path(mirrored, 1.0, 0.0, outline.turned_round, p.safety.margin_m)
        v = min(p.v, p.v_max or inf)
        back = -min(p.v_back, v)
        if self._patience > 1.0:  # no way is open enough: take any
            self._left, self._searched = 0.0, 0.0
            self._back = ahead < behind if self._back is None else self._back
            if (behind if self._back else ahead) > p.back_room_m:
                return back if self._back else v, 0.0, "lost: to where there is room"
            self._stalled_s, self._reversals, self._back = 0.0, 0, None
        self._turn_to_free_space(obstacles, ahead)
        if self._left > 0.0:
            for side in (self._side, -self._side):
                if free_turn(points, side, outline, TURN_MARGIN_M) > p.safety.turn_room:
                    self._reversals += side != self._side
                    self._side = side
                    if self._reversals >= MOST_REVERSALS and self._left < inf:
                        break  # it has seen all there is to see from here
                    return 0.0, side * p.w, "lost: look around"
            self._left = 0.0
        if ahead >= p.ahead_m:
            return v, 0.0, "lost: drive on"
        if behind > p.back_room_m:  # it can neither turn nor drive on: back out the way it came
            self._left = tau
            return back, 0.0, "lost: back out"
        return 0.0, 0.0, "lost: no way on"

    def _turn_to_free_space(self, obstacles: Obstacles, ahead: float) -> None:
        """Start a turn where it cannot drive on, and end it where it can."""
        p, silent = self.p, self._silent
        if self._left <= 0.0 and (ahead < p.ahead_m or silent):
            self._left = inf  # until there is free space
            self._searched = 0.0
            left, right = (
                inf if o is None else hypot(o.x, o.y) for o in (obstacles.left, obstacles.right)
            )
            self._side = (
                1.0 if left > right or (left == right and self.rng.random() < 0.5) else -1.0
            )
            return
        enough = p.open_m if self._patience < 0.5 else p.ahead_m
        if self._left == inf and not silent and ahead > enough:
            self._left = 0.0

    def _drive_to_distinguish(
        self, obstacles: Obstacles, ahead: float
    ) -> tuple[float, float, str] | None:
        """Drive along the leg that distinguishes places, if there is one."""
        p, outline, here = self.p, self.body.outline, self._odometry
        v = min(p.v, p.v_max or inf)
        if self._to is None:
            if self._localizer is None or self._left > 0.0 or self.now < self._chosen_at + p.wait_s:
                return None
            self._chosen_at = self.now
            since = relative(self._placed_at, here)
            drawn = [] if self._particles is None else particles.poses_of(self._particles)
            leg = self._localizer.leg(
                [(compose(pose, since), share) for pose, share in places_of(drawn)],
                [self._room(obstacles, turn * tau / DIRECTIONS) for turn in range(DIRECTIONS)],
                [relative(here, visited)[:2] for visited in self._visited],
                v,
                p.w,
            )
            if leg is None:
                return None
            length = min(leg.length, p.tell_m)
            self._facing = False
            self._to = compose(here, (length * cos(leg.heading), length * sin(leg.heading), 0.0))
        x, y, _ = relative(here, self._to)
        off = wrap(atan2(y, x))
        if not self._facing and abs(off) > p.off_rad:
            for side in (1.0 if off > 0.0 else -1.0, -1.0 if off > 0.0 else 1.0):
                needed = side * off % tau
                if free_turn(obstacles.points, side, outline, TURN_MARGIN_M) > needed:
                    return 0.0, side * p.w, "lost: to where places differ"
            self._to = None
            return None
        self._facing = True
        if x <= NEAR_M or ahead < p.back_room_m:
            self._to, self._chosen_at = None, -inf if ahead >= p.back_room_m else self.now
            self._way, self._left = 0.0, 0.0
            return None
        return v, max(-p.w, min(p.w, off)), "lost: to where places differ"

    def _room(self, obstacles: Obstacles, heading: float) -> float:
        """Free distance in a heading after turning there, m."""
        c, s = cos(heading), sin(heading)
        turned = [Point(c * o.x + s * o.y, c * o.y - s * o.x) for o in obstacles.points]
        return free_path(turned, 1.0, 0.0, self.body.outline, self.p.safety.margin_m)
