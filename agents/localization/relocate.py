"""The relocate agent: drives a robot that is lost until its sensors have found out where it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, inf, radians, sin, tau
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico.agents.localization.rivals import DIRECTIONS, Rivals, places_of
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

SWINGS = 2
"""Turned back so often on the spot it has seen what it can from there."""

MOST_BEEN = 60
"""Places where it has been that it remembers."""

NEAR_M = 0.1
"""So near to the end of a way is there."""

TELLS_M = 6.0
"""What differs farther away than this tells it too late to look for: a sonar hears no farther."""

AHEAD_RAD = radians(20)
"""A sonar that looks within this of the heading looks ahead."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How it looks around, and for how long; the map, if there is one, and the make of robot."""

    world: Annotated[str, Meta(min_length=1)] | None = None
    profile: str = "pioneer-2dx"
    v: Annotated[float, Meta(gt=0, le=1)] = 0.25  # m/s
    v_max: Annotated[float, Meta(gt=0, le=10)] | None = None  # a scenario's limit
    v_back: Annotated[float, Meta(gt=0, le=1)] = (
        0.08  # backwards where it can neither turn nor go on
    )
    w: Annotated[float, Meta(gt=0, le=2)] = 0.5  # rad/s
    back_room_m: Metres = 0.1  # with more than this remembered free behind
    ahead_m: Metres = 0.35  # with less than this free ahead it turns,
    open_m: Metres = 0.9  # until so much is; or `ahead_m`, half of its patience later; then
    step_m: Metres = 0.3  # it goes so far on, or back, where there is any room,
    patience_s: Annotated[float, Meta(gt=0, le=600)] = 10.0  # if it has not got on for so long
    silent_s: Annotated[float, Meta(gt=0, le=60)] = 1.0  # nothing ahead has answered for so long
    leg_m: Metres = 3.0  # after so much straight ahead it looks around again,
    tell_m: Metres = 2.0  # or chooses anew where to drive to tell places apart,
    off_rad: Annotated[float, Meta(gt=0, le=1)] = 0.2  # turned to where that is; and
    wait_s: Annotated[float, Meta(gt=0, le=60)] = 2.0  # it thinks again if no way tells anything
    give_up_s: Annotated[float, Meta(gt=0, le=3600)] = 120.0
    utility_least: Annotated[float, Meta(ge=0, le=1)] = 0.4  # just lost,
    utility_most_m: Metres = 2.0  # and 1 when the pose is so uncertain
    safety: Safety = Safety()


@dataclass(frozen=True)
class Ahead:
    """What last answered ahead: when, how far before the body's front, and by which odometry."""

    at: float = -inf  # s; never
    m: float = 0.0
    by: Pose2 = STOOD


class Relocate(Behaviour):
    """Turns once on the spot, then drives to where it hears what tells it where it is.

    Of the places where the robot may be it hears from the localization agent. Where these are
    several, and the map is known, it takes a straight way that is free at all of them and along
    which the sensors should tell most different things. With no places to tell apart, or no map, it
    drives to where it is free, and turns again: a place is told from others like it by what comes
    after it. It needs no pose, and keeps off what is near as everybody does.

    A sonar does not hear a smooth wall at a slant, and a map does not help a robot that is lost. So
    it drives to where something answered ahead, no faster than it can stop before that. While
    nothing answers ahead it creeps; if nothing answers all around, it drives on all the same.
    """

    name = "relocate"
    reacts_to = Obstacles
    hears: ClassVar[tuple[type[Message], ...]] = (*Behaviour.hears, Sonar, Particles)
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
        self._since = -inf  # when the robot was lost
        self._bid_at = -inf
        self._left = 0.0  # of the turn, rad
        self._way = 0.0  # of the leg, m
        self._sought = 0.0  # so far it has turned for a way that is free, rad
        self._answered: Ahead | None = None  # None: no sonar yet
        self._stood = 0.0  # s that it drove since it last got on, less those of a look around,
        self._back: bool | None = None  # the way there is room is back
        self._swings = 0  # and how often it turned back meanwhile
        self._side = 1.0
        self._gave_up = False
        self._rivals: Rivals | None = None
        if self.p.world is not None:
            world, profile = load_world(self.p.world), load_profile(self.p.profile)
            check_extent(world, CELL_M)
            grid = grid_of(world.barriers, world.bounds, CELL_M)
            self._rivals = Rivals(grid, profile.body.circle_m, min(profile.reach_m, TELLS_M))
        self._particles: Particles | None = None  # what may be is worked out when it matters
        self._placed_at: Pose2 = STOOD  # the odometry then
        self._been: list[Pose2] = []  # since it is lost, by the odometry
        self._to: Pose2 | None = None  # the end of the way that tells places apart, by it
        self._facing = False  # towards that
        self._thought_at = -inf

    def on_sonar(self, sonar: Sonar) -> None:
        """Whether anything ahead answers, and how far ahead."""
        near = [
            echo.x + echo.range
            for echo in sonar.echoes
            if abs(echo.bearing) < AHEAD_RAD and echo.range is not None
        ]
        if near and self._body is not None:
            front = min(near) - self._body.outline.front
            self._answered = Ahead(self.now, front, self._odometry)
        elif self._answered is None:
            self._answered = Ahead()

    def on_particles(self, said: Particles) -> None:
        """Places where the robot may be."""
        if len(said.packed) % particles.EACH == 0:
            self._particles, self._placed_at = said, self._odometry

    @property
    def _odometry(self) -> Pose2:
        state = self.latest(RobotState)
        return STOOD if state is None else (state.x, state.y, state.theta)

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """Look around, or drive on."""
        self._begin()
        if self.now - self._since > self.p.give_up_s:
            self.why = f"not found in {self.p.give_up_s:g} s"
            if not self._gave_up:
                self._gave_up = True
                self.log(f"the robot is lost, and was {self.why}: it stands", WARNING)
            return None
        v, w, reason = self._act(obstacles)
        v, w = self.limited(min(v, self._stops_before), w, obstacles, self.p.safety)
        share = min(1.0, (pose.deviation - LOST_M) / (self.p.utility_most_m - LOST_M))
        utility = self.p.utility_least + share * (1.0 - self.p.utility_least)
        return Bid(utility, (v, w), reason=reason)

    def _begin(self) -> None:
        """Count from when the robot was lost, and what has been turned and driven since."""
        cycle_s = self.body.cycle_s
        if self.now - self._bid_at > 10.0 * cycle_s:
            self._since, self._gave_up = self.now, False
            self._left, self._way, self._sought = tau, 0.0, -tau
            self._been, self._to = [], None
            self._stood, self._swings = -tau / self.p.w, 0
        self._bid_at = self.now
        x, y, _ = here = self._odometry
        if not self._been or hypot(x - self._been[-1][0], y - self._been[-1][1]) > self.p.step_m:
            self._been = [*self._been[-MOST_BEEN:], here]
            if len(self._been) > 1:
                self._stood, self._swings, self._back = 0.0, 0, None
        if self.holds(WHEELS):
            v, w = self.measured
            self._left = max(0.0, self._left - abs(w) * cycle_s)
            self._sought += abs(w) * cycle_s
            self._stood += cycle_s
            self._way += abs(v) * cycle_s

    @property
    def _patience(self) -> float:
        """How long it has not got on: beyond 1 any way will do."""
        return max(self._stood / self.p.patience_s, self._swings / (2 * SWINGS))

    @property
    def _silent(self) -> bool:
        """Whether nothing ahead answers, and it may do so elsewhere."""
        ahead = self._answered
        silent = ahead is not None and self.now - ahead.at > self.p.silent_s
        return silent and self._sought < tau

    @property
    def _stops_before(self) -> float:
        """The speed from which it stops before what answered ahead, m/s."""
        ahead, p = self._answered, self.p
        if self._silent:
            return p.v_back
        if ahead is None or self.now - ahead.at > p.silent_s:  # a laser, or silence all around
            return inf
        x, y, _ = relative(ahead.by, self._odometry)
        left = ahead.m - hypot(x, y) - p.safety.margin_m
        return max(p.v_back, self.body.stops_within(left))

    def _act(self, obstacles: Obstacles) -> tuple[float, float, str]:
        p, outline, points = self.p, self.body.outline, obstacles.points
        ahead = free_path(points, 1.0, 0.0, outline, p.safety.margin_m)
        told = self._tell_apart(obstacles, ahead)
        if told is not None:
            return told
        if self._way > p.leg_m:
            self._left, self._way, self._sought = tau, 0.0, -tau
            self._stood -= tau / p.w
        mirrored = [Point(-point.x, -point.y) for point in points]
        behind = free_path(mirrored, 1.0, 0.0, outline.turned_round, p.safety.margin_m)
        v = min(p.v, p.v_max or inf)
        back = -min(p.v_back, v)
        if self._patience > 1.0:  # no way is as open as it should be: any will do
            self._left, self._sought = 0.0, 0.0
            self._back = ahead < behind if self._back is None else self._back
            if (behind if self._back else ahead) > p.back_room_m:
                return back if self._back else v, 0.0, "lost: to where there is room"
            self._stood, self._swings, self._back = 0.0, 0, None
        self._seek(obstacles, ahead)
        if self._left > 0.0:
            for side in (self._side, -self._side):
                if free_turn(points, side, outline, TURN_MARGIN_M) > p.safety.turn_room:
                    self._swings += side != self._side
                    self._side = side
                    if self._swings >= SWINGS and self._left < inf:
                        break  # it has seen all that it can from here
                    return 0.0, side * p.w, "lost: look around"
            self._left = 0.0
        if ahead >= p.ahead_m:
            return v, 0.0, "lost: drive on"
        if behind > p.back_room_m:  # it fits neither way round here: out as it came in
            self._left = tau
            return back, 0.0, "lost: back out"
        return 0.0, 0.0, "lost: no way on"

    def _seek(self, obstacles: Obstacles, ahead: float) -> None:
        """Begin to turn where it cannot drive on, and end where it can."""
        p, silent = self.p, self._silent
        if self._left <= 0.0 and (ahead < p.ahead_m or silent):
            self._left = inf  # until there is room
            self._sought = 0.0
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

    def _tell_apart(self, obstacles: Obstacles, ahead: float) -> tuple[float, float, str] | None:
        """On the way that tells places apart, if there is one."""
        p, outline, here = self.p, self.body.outline, self._odometry
        v = min(p.v, p.v_max or inf)
        if self._to is None:
            if self._rivals is None or self._left > 0.0 or self.now < self._thought_at + p.wait_s:
                return None
            self._thought_at = self.now
            since = relative(self._placed_at, here)
            drawn = [] if self._particles is None else particles.poses_of(self._particles)
            leg = self._rivals.leg(
                [(compose(pose, since), share) for pose, share in places_of(drawn)],
                [self._room(obstacles, turn * tau / DIRECTIONS) for turn in range(DIRECTIONS)],
                [relative(here, was)[:2] for was in self._been],
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
            self._to, self._thought_at = None, -inf if ahead >= p.back_room_m else self.now
            self._way, self._left = 0.0, 0.0
            return None
        return v, max(-p.w, min(p.w, off)), "lost: to where places differ"

    def _room(self, obstacles: Obstacles, heading: float) -> float:
        """How far it is free that way, m, once it has turned there."""
        c, s = cos(heading), sin(heading)
        turned = [Point(c * o.x + s * o.y, c * o.y - s * o.x) for o in obstacles.points]
        return free_path(turned, 1.0, 0.0, self.body.outline, self.p.safety.margin_m)
