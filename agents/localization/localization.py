"""The localization agent: estimates the pose on a known map from range sensors (thesis 3.6.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as replaced
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from math import hypot, radians, sqrt
from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from armadico.agents.localization import monte_carlo
from armadico.agents.localization.against_map import Walls
from armadico.agents.localization.array_cache import Arrays, cached_arrays
from armadico.agents.localization.bound import confined, widened
from armadico.agents.localization.compass import DEVIATION, UNLIKELY, Compass
from armadico.agents.localization.global_search import Alternative, Model, Place, Search, apart
from armadico.agents.localization.laser_model import LaserModel, beams_of
from armadico.agents.localization.monte_carlo import Estimate, MonteCarlo, Settings
from armadico.agents.localization.sonar_model import FORMAT, Fields, SonarModel, fields
from armadico.agents.localization.window import Window
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import CELL_M, Grid, check_extent, grid_of
from armadico.agents.methods.odometry import WIDEST, may_apply, out_of_range, was_reset
from armadico.agents.methods.poses import Floats
from armadico.config.places import Places
from armadico.config.profile import Odometry as Wheels
from armadico.config.profile import RobotProfile, load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.messages import Card, Cycle, Message, RobotState, line
from armadico.mobile import particles
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import (
    Correction,
    Echo,
    InitialPose,
    Particles,
    Pose,
    Scan,
    Sonar,
    Trajectory,
)

Metres = Annotated[float, Meta(gt=0, le=100)]
Angle = Annotated[float, Meta(gt=0, le=6.2832)]
Share = Annotated[float, Meta(ge=0, le=1)]
Odds = Annotated[float, Meta(ge=0, le=1000)]
"""Natural logarithm of an odds ratio."""


LARGE = 250_000
"""Maps with more cells than this have their sensor model cached: computing it takes over 0.2 s."""

UNCOUNTED_M, UNCOUNTED_RAD = 0.5, 0.5
"""Standard deviations of the motion that no process counted: 2 s until the controller's watchdog
stops the robot, plus braking, at half the top speed or while turning."""

RECENT = 2
"""Newest readings that may come from another place although no search has shown it yet."""

SEARCH_S = 3.0
"""A search starts after this time with any new reading: a slow robot has few readings."""

UNSETTLED_S = 6.0
"""Time for which a suspected kidnapping, or a fit by chance, may last without a new reading."""

UNMOVED_ODDS = 30.0
"""Prior odds that a lost robot was not moved: unmapped objects make it lost more often than people
lift it. In a room that looks the same from both ends only this prior separates the two poses."""

PARTICLES_S = 0.5
"""Period of the particles that are published for displays."""

SQUARE = sqrt(2.0)
"""The deviation of a position that is known equally well in all directions, over that in one."""

FOUND_RAD = 0.3
"""Standard deviation of the heading of a robot that has just been found, until readings tell it."""

DRIVEN = 0.5
"""A place that a search has found counts as lost until the searches after it confirm it, or until
less than this share of `proved_m` is left: where walls are missing, the readings from one spot may
fit another place in search after search."""

TOLD = 0.5
"""Share of `unproved_m` to which readings have to narrow the bound before they prove a place: along
a corridor without features they fit anywhere."""

MISFIT_S = 15.0
"""Time constant of the running average of the readings' fit, while the robot moves."""

USUAL_FIT = 1.4
"""Initial value of that average, relative to `Confirmation.misfit`."""

WORN = 2.5
"""Wheel errors beyond this many of the profile's standard deviations are reported."""


BY_SCANS = Wheels(alpha1=0.001, alpha2=0.0001, alpha3=0.001)
"""Lasting errors of the motion that scans tell, in place of the wheels' (the random ones come with
each key scan)."""

OFF_MAP, ON_MAP = 0.2, 0.3
"""Mean hit of a laser's rays, 0 to 1, below which a robot is off the map, and above which it is on
it again. On a complete map it is 0.6, off it 0 to 0.15 (logs of five buildings)."""

AGREED = 0.5
"""Share of the particles in one place that brings a robot back on the map."""

WRONG_MATCHES = 0.1
"""Share of the particles that move by the wheels instead of a match."""

AGAINST_GAIN, AGAINST = 0.2, 0.5
"""Weight of the newest scan in the running share of scans by which the map contradicts the pose,
and the share from which it counts: four scans in a row, at least."""

CEASED = 0.6
"""Readings that fit by less than this share of the fit before have ceased to fit. A robot that is
lifted in the simulator falls from 0.98 to 0.3."""

DRIFT = 0.006
"""Least standard deviation that is published off the map, over the way there: walls that are nearly
parallel let the particles agree better than they know. Chosen on freiburg-079, where the pose is
0.5 m off after 88 m. So a robot counts as lost after 83 m at the latest."""

RETURNED = 3.0
"""After a way off the map a place is proved over so many times `proved_m`: the particles may agree
at first on a place that is half a metre away (freiburg-079)."""

LOOKS_OFF = 12
"""New readings from search to search off the map."""


class Confirmation(Struct, frozen=True):
    """Thresholds for giving up a pose and for accepting one on the whole map, for one sensor."""

    verdicts: int  # consecutive searches that must agree on one other place
    odds: float  # least log odds of that place
    fit: float  # least geometric mean of the readings' likelihoods there
    better: float  # least ratio of that fit to the fit at the present pose
    looks_after: int  # steps between new readings after which a lost robot is searched for
    found_fit: float  # least fit at a place where a lost robot is accepted
    misfit: float  # an average fit below this is reported
    clear: int = 3  # verdicts that one clear search counts for, at any place
    clear_odds: float = 7.0  # least log odds of a clear search
    clear_fit: float = 0.85  # least fit of a clear search: as if everything were mapped


SONARS = Confirmation(
    verdicts=1,
    odds=7.5,
    fit=0.42,
    better=1.4,
    looks_after=5,
    found_fit=0.28,
    misfit=0.3,
)
LASER = Confirmation(
    verdicts=5,
    odds=1.5,
    fit=0.7,
    better=1.5,
    looks_after=3,
    found_fit=0.6,
    misfit=0.5,
)
"""Chosen on three logs of real robots (laser), and on simulated kidnappings (sonars).

Unmapped objects fit another place by chance. A laser model cannot excuse ranges that are shorter
than the map's, so one verdict is not enough. The sonar model can (`Search.alternative`), and sonars
are so ambiguous that the best other place changes from one search to the next.
"""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The map, the robot, and the initial belief.

    `start` "pose" starts around the pose that the encoder agent publishes, "anywhere" with uniform
    particles. With `motion` "scans" a robot with a laser moves as its scans tell, and may leave its
    map; with "wheels", and by sonars always, as its odometry tells. Without `confirm` or `filter`
    the sensor's own defaults apply.
    """

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    start: Literal["pose", "anywhere"] = "pose"
    motion: Literal["wheels", "scans"] = "scans"
    start_m: Metres = 0.15  # standard deviation of the position at the start
    start_rad: Angle = radians(6.0)
    lost: Share = 0.15  # lost if the largest cluster has a smaller share of the weight
    lost_m: Metres = 0.5  # lost if that cluster is wider, as a circle of its short axis
    along_m: Metres = 1.5  # lost if its standard deviation along its long axis is larger
    lost_s: Annotated[float, Meta(gt=0, le=60)] = 0.5  # time of either until it counts as lost
    fits: Share = 0.5  # no search while the newest readings fit at least this well
    doubted_after: Annotated[int, Meta(ge=1, le=100)] = 3  # new readings from search to search
    stays: Odds = 3.0  # log odds against all other places that end the searches
    doubts: Odds = 1.5  # log odds of another place that raise suspicion: the robot slows down
    doubt_m: Metres = 0.45  # least standard deviation published while suspicious; most otherwise
    misfit_m: Metres = 0.3  # least standard deviation published while readings fit badly
    adrift_m: Metres = 0.6  # least deviation with two signs of a wrong pose, or without readings
    confirm: Confirmation | None = None  # thresholds for lost and found
    found: Share = 0.95  # share of the weight in one place with which a search has found it
    found_times: Annotated[int, Meta(ge=1, le=100)] = 3  # consecutive searches that must find it
    proved_times: Annotated[int, Meta(ge=0, le=100)] = 4  # further searches that must confirm it
    proved_m: Metres = 1.0  # distance with readings that fit until it counts as proved
    unproved_m: Metres = 0.4  # least standard deviation published until they have
    filter: Settings | None = None


@dataclass(frozen=True)
class Localized:
    """The pose is known."""

    unconfirmed: int = 0  # searches that still have to confirm it
    unproved: float = 0.0  # distance that it still has to drive with readings that fit, m
    off_map: bool = False  # whether the map does not show this place: scans alone tell the motion
    # The least deviations off the map, of a place that was found, and by matches that contradict
    # the wheels, m and rad; they hold until the robot is back, and proved.
    off_m: float = 0.0
    off_rad: float = 0.0
    suspect: bool = False  # whether another place explains the new readings better
    verdicts: int = 0  # consecutive searches that agreed on another place
    agreed: Pose2 = STOOD  # that place
    since: float | None = None  # when the particles began to spread too far, s
    unmoved: Pose2 | None = None  # while unconfirmed: as in `Lost`

    @property
    def is_proved(self) -> bool:
        """Whether nothing is left that has to confirm or prove this place."""
        return self.unconfirmed == 0 and self.unproved <= 0.0

    @property
    def is_sure(self) -> bool:
        """Whether it is proved, on the map."""
        return self.is_proved and not self.off_map


@dataclass(frozen=True)
class Lost:
    """The pose is not known."""

    # Whether it was lost because the particles spread: they may converge again.
    spread: bool = False
    converged: bool = False  # whether they have
    off_map: ClassVar[bool] = False
    sure: int = 0  # consecutive searches in which one place was much better than all others
    agreed: Pose2 = STOOD  # the best place in the last search
    # Whether another place explained the readings better when the pose was lost.
    suspect: bool = False
    unmoved: Pose2 | None = None  # the pose if the robot was not moved when it got lost


@dataclass(frozen=True)
class Odometry:
    """The controller's odometry, and the motion since the cycle before."""

    pose: Pose2
    epoch: int
    motion: Pose2 = STOOD


@dataclass
class Searches:
    """The search in progress, and the start of the last one."""

    running: Search | None = None
    readings: int = 0  # new readings when the last one started
    at: float = 0.0  # when it started, s


@dataclass(frozen=True)
class Fit:
    """The fit of the readings on average, and whether it is below the threshold."""

    average: float
    bad: bool = False


@dataclass(frozen=True)
class Published:
    """The last particles published, with the particle filter's count of changes."""

    at: float
    changes: int
    message: Particles


class Localization(Agent):
    """Estimates the pose on a known map with a particle filter, from a laser or sonars.

    A robot with a laser uses the laser alone: its rays are precise, sonars are not.

    The particles move with the controller's raw odometry, so this agent's output does not return as
    its input through the pose. A correction is the pose of the odometry's origin in the world, as
    tf's transform from map to odom. The encoder agent composes it with the odometry.

    A suspected kidnapping slows the robot down; only confirmation makes it lost. Readings that fit
    badly may come from furniture or people, which fit no place on the map. If another place
    explains them better, searches of the whole map have to confirm it: one for sonars, several
    consecutive ones for a laser.
    """

    name = "localization"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (Sonar, Scan, Pose, InitialPose, Trajectory)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction, Particles)
    parameters = Parameters
    launched_with = ("world", "profile", "start_m", "start_rad")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        world, profile = load_world(self.p.world), load_profile(self.p.profile)
        check_extent(world, CELL_M)
        grid = grid_of(world.outlines, world.bounds, CELL_M)
        rows, columns = np.nonzero(grid.clearance > profile.body.width_m / 2)
        free = np.column_stack([grid.xs[columns], grid.ys[rows]])
        self._places = Places(world, profile.body)
        self._free, inhabited = free, free[self._places.inhabited(free)]
        self._useful = bool(world.outlines) and len(free) > 0
        self._has_laser = profile.laser is not None
        self._by_scans = self._has_laser and self.p.motion == "scans"
        settings = self.p.filter or (monte_carlo.LASER if self._has_laser else Settings())
        if self._by_scans:
            settings = replace(settings, leaves=True)
        self._grid, clear_m = grid, profile.body.width_m / 2 - 2 * CELL_M
        self._confirm = self.p.confirm or (LASER if self._has_laser else SONARS)
        self._filter = MonteCarlo(
            model_of(grid, profile),
            inhabited if len(inhabited) else free,
            np.random.default_rng(self.rng.getrandbits(63)),
            settings,
            BY_SCANS if self._by_scans else profile.wheels,
            lambda x, y: grid.clearances(x, y) > clear_m,
        )
        self._wheels = profile.wheels
        self._window = Window(profile.wheels) if self._by_scans else None
        self._walls = Walls(grid, world.unseen) if self._by_scans else None
        self._compass = Compass()
        self._against = 0.0  # of the newest readings, those by which the map contradicts the pose
        self._fitted = 0.0  # the fit on the map at the last key scan that was not torn
        self._given = self.p.start == "pose"  # the place was given, not found by a search
        self._on_map_m = 0.0  # driven with readings that fit the map at this place
        self._ping_s = 0.0 if self._has_laser else profile.ring.period_s
        self._scan: int | None = None  # number of the last one
        self._odometry: Odometry | None = None
        self._started = False
        self._belief: Localized | Lost = Lost() if self.p.start == "anywhere" else Localized()
        self._estimate: Pose2 | None = None  # the estimate of the last cycle
        self._searches = Searches()
        self._fit = Fit(USUAL_FIT * self._confirm.misfit)
        self._doubts = ""  # of the odometry, as reported
        self._published: Published | None = None

    def on_pose(self, pose: Pose) -> None:
        """Start the filter at the first pose."""
        if self._started or not self._useful or self._odometry is None:
            return
        if out_of_range(pose.x, pose.y):
            return
        self._started = True
        if pose.deviation > self.p.lost_m:  # lost already before this agent started
            self._belief = Lost()
        if self.p.start == "anywhere":
            self._filter.start_anywhere()
        else:
            here = np.array([[pose.x, pose.y]])
            known = isinstance(self._belief, Localized)
            if known and not self._places.inhabited(here).all():
                self._filter.may_be_at(self._free)  # the robot drives outside named rooms too
            off = max(self.p.start_m, pose.deviation)  # of a pose without recent corrections
            turned = max(self.p.start_rad, pose.heading_deviation)
            self._filter.start_at((pose.x, pose.y, pose.theta), off, turned)

    def on_initial_pose(self, initial: InitialPose) -> None:
        """Restart the filter at a pose from the operator, unless it is outside free space."""
        at_rest = may_apply(initial, self.latest(RobotState))
        if not self._useful or self._odometry is None or not at_rest:
            return
        if np.hypot(*(self._free - (initial.x, initial.y)).T).min() > 2.0 * self.p.start_m:
            at = _place((initial.x, initial.y))
            self.log(f"initial pose {at} rejected: no free space there on the map", WARNING)
            return
        pose = initial.x, initial.y, initial.theta
        self._started = True
        self._set_localized(pose, 0)
        self._given, self._on_map_m = True, 0.0
        self._filter.start_at(pose, self.p.start_m, self.p.start_rad)

    def on_robot_state(self, state: RobotState) -> None:
        """Move the particles.

        The controller counts on while the robot agent is down. If the odometry was reset, the
        motion meanwhile is unknown.
        """
        before = self._odometry
        odometry = Odometry((state.x, state.y, state.theta), state.cycle.epoch)
        self._odometry = odometry
        if before is None or not self._started:
            return
        if odometry.epoch != before.epoch and was_reset(before.pose, odometry.pose):
            self._filter.scatter_by(UNCOUNTED_M, UNCOUNTED_RAD)
            if self._by_scans:
                self._window, self._on_map_m = Window(self._wheels), 0.0
            self._searches = Searches(at=self._searches.at)
            self._belief = replaced(self._belief, unmoved=None)
            return
        motion = relative(before.pose, odometry.pose)
        self._odometry = replaced(odometry, motion=motion)
        if self._window is not None:
            self._window.check()
            motion = relative(self._window.pose(before.pose), self._window.pose(odometry.pose))
            self._filter.spread(self._window.reckon(odometry.pose))
        self._move(motion)
        self._advance_search()  # every cycle, even if readings are rare

    def _move(self, motion: Pose2) -> None:
        """Move what is believed by a motion in the robot's frame: m, m, rad."""
        self._filter.move(motion)
        if self._searches.running is not None:
            self._searches.running.move(motion)
        self._estimate = None if self._estimate is None else compose(self._estimate, motion)
        self._belief = self._moved(self._belief, motion)

    @property
    def _follows(self) -> bool:
        """Whether scans tell the motion since the robot was at a place that is believed.

        Not if the map speaks against it, or if no path is free from there.
        """
        if self._window is None or self._contradicted or self._questioned or self._waits:
            return False
        return self._window.follows and (self._given or self._anchored)

    @property
    def _contradicted(self) -> bool:
        """Whether the map contradicts the pose: it shows this place, and shows it otherwise."""
        return self._against > AGAINST

    @property
    def _questioned(self) -> bool:
        """Whether readings have ceased to fit the map, until the next key scan tells more."""
        fits, before, now = self.p.fits, self._fitted, self._filter.fit
        return before >= fits and now < min(fits, CEASED * before)

    @property
    def _anchored(self) -> bool:
        """Whether the robot has driven far enough on the map to be sure of its place there."""
        return self._on_map_m >= self.p.proved_m

    def _see(self, scan: Scan) -> None:
        """Correct the motion by a scan; notice that it contradicts those before."""
        window, odometry = self._window, self._odometry
        if window is None or odometry is None or not self._started:
            return
        before = window.pose(odometry.pose)
        errors = window.see(odometry.pose, scan)
        if errors is None:
            return
        after = window.pose(odometry.pose)
        self._move(relative(before, after))
        self._filter.spread(errors.matched)
        if any(errors.disputed) and isinstance(self._belief, Localized):
            # The map cannot tell which is right: a stuck laser shows a place that fits.
            held, (off_m, off_rad) = self._unproved(self._belief), errors.disputed
            off_m, off_rad = held.off_m + off_m, held.off_rad + off_rad
            self._belief = replaced(held, off_m=off_m, off_rad=off_rad)
        if not self._belief.off_map:  # there the map would tell that the match was wrong
            self._filter.spread(errors.wheels, WRONG_MATCHES, relative(after, before))
        if not window.torn:
            belief = self._belief
            if self._questioned and isinstance(belief, Localized) and not belief.off_map:
                # Another place may look like the one before, and fit the map half a metre away.
                self._belief = self._unproved(belief)
            self._fitted = self._filter.fit
        self._steer(errors.normals)

    def _unproved(self, belief: Localized) -> Localized:
        """The belief with a place that has to be proved again."""
        proof = max(belief.unproved, self.p.proved_m)
        off_m, off_rad = (0.0, 0.0) if belief.is_sure else (belief.off_m, belief.off_rad)
        return replaced(belief, unproved=proof, off_m=off_m, off_rad=off_rad)

    def _steer(self, normals: Floats) -> None:
        """Learn the directions of walls on the map; correct the heading by them off it."""
        belief, pose, compass = self._belief, self._estimate, self._compass
        if isinstance(belief, Lost) or pose is None or belief.unconfirmed:
            return
        off = compass.off(normals, pose[2]) if belief.off_map else None
        covariance = self._filter.scatter()
        variance = float(covariance[2, 2]) + DEVIATION**2
        if off is not None and off**2 < UNLIKELY**2 * variance:
            x, y, theta = (np.array(pose) - covariance[:, 2] * (off / variance)).tolist()
            self._filter.weigh_heading(pose[2] - off, DEVIATION)
            self._estimate = pose = x, y, wrap(theta)
        if not belief.off_map and belief.unproved <= 0.0 and self._filter.fit >= self.p.fits:
            compass.learn(normals, pose[2])

    def _check_against(self, echoes: Sequence[Echo]) -> None:
        """Notice that scans contradict those before, or that the map contradicts the pose."""
        window, fits, belief = self._window, self._filter.fit >= self.p.fits, self._belief
        if window is None or self._walls is None or isinstance(belief, Lost):
            return
        against = False
        if not fits and self._estimate is not None:
            against = self._walls.rays(self._estimate, echoes).contradict
        self._against += AGAINST_GAIN * (against - self._against)
        torn = window.torn and self._questioned and (against or not self._walls.tell_free)
        if torn or (window.carried and (belief.off_map or not fits)):
            self._filter.history.discard_old(window.parameters.lost_scans if window.carried else 1)
            self._set_lost("scans contradict those before: it was carried", unmoved=self._estimate)

    def _moved(self, belief: Localized | Lost, motion: Pose2) -> Localized | Lost:
        """The belief after a motion: its poses move with the robot."""
        before, unmoved = belief.unmoved, None
        if before is not None:
            unmoved = compose(before, motion)
            if self._grid.clearance_between(Placed(*before[:2]), Placed(*unmoved[:2])) == 0.0:
                unmoved = None  # it would have driven through a wall, so it was moved
        belief = replaced(belief, agreed=compose(belief.agreed, motion), unmoved=unmoved)
        if isinstance(belief, Localized) and belief.off_map:
            belief = replaced(belief, off_m=belief.off_m + DRIFT * hypot(*motion[:2]))
        if isinstance(belief, Localized) and belief.unproved > 0.0:
            fits = self._filter.supported and self._filter.fit >= self._confirm.found_fit
            proves = fits and self._filter.bound.most_m < TOLD * self.p.unproved_m
            belief = replaced(belief, unproved=belief.unproved - proves * hypot(*motion[:2]))
        on_map = self._filter.supported and self._filter.fit >= self._confirm.misfit
        if isinstance(belief, Localized) and belief.unproved <= 0.0 and on_map:
            self._on_map_m += hypot(*motion[:2])
        if self._follows:
            return belief
        if isinstance(belief, Localized) and (belief.suspect or self._filter.refuted):
            # It was lifted, or its wheels slipped, by an unknown motion; scans would have told.
            if belief.unproved <= 0.0 and self._window is None:
                self._filter.bound.widen(self.p.unproved_m / SQUARE, FOUND_RAD)
            belief = self._unproved(belief)
        return belief

    def on_sonar(self, sonar: Sonar) -> None:
        if not self._has_laser:
            motion = STOOD if self._odometry is None else self._odometry.motion
            ago = self._ping_s / self.cycles.period
            self._update(sonar.cycle, lambda: as_fired(sonar.echoes, motion, ago))

    def on_scan(self, scan: Scan) -> None:
        """Weigh the particles by a scan. A repeated scan has no new information."""
        if not self._has_laser:
            return
        again, self._scan = scan.number == self._scan, scan.number
        try:
            beams = [] if again else beams_of(scan)
        except ValueError:
            return
        if not again:
            self._see(scan)
        self._update(scan.cycle, lambda: beams)

    def fill_card(self, card: Card) -> Card:
        """Add the estimated wheel errors."""
        learnt = self._worn() if self._started else ""
        return replace(card, learnt=line(learnt), doubts=line(self._doubts))

    @property
    def _wheel_errors(self) -> tuple[float, float, float]:
        """The lasting errors of the wheels: turn (rad/rad), drift (rad/m), distance (m/m)."""
        if self._window is not None:
            return self._window.front.model.systematic
        return self._filter.wheel_errors

    @property
    def _wheels_known(self) -> tuple[float, ...]:
        """As `Correction.wheels`."""
        if self._window is not None:
            return *self._wheel_errors, *self._window.front.model.deviations
        return *self._wheel_errors, *self._filter.wheel_deviations

    def _worn(self) -> str:
        turning, drift, way = self._wheel_errors
        o = self._wheels
        return (
            f"errors of the wheels (and the profile's standard deviations): turns"
            f" {100 * turning:+.1f} % ({100 * o.alpha1:.1f}), ways {100 * way:+.1f} %"
            f" ({100 * o.alpha3:.1f}), drift {drift:+.3f} rad/m ({o.alpha2:.3f})"
        )

    def _check_wheels(self) -> None:
        """Report wheel errors that are far larger than the profile's."""
        o = self._wheels
        limits = zip(self._wheel_errors, (o.alpha1, o.alpha2, o.alpha3), strict=True)
        worn = any(abs(off) > WORN * alpha for off, alpha in limits)
        if isinstance(self._belief, Lost) or self._doubts or not worn:
            return
        self._doubts = f"the odometry is worse than [odometry] of the profile: {self._worn()}"
        self.log(self._doubts, WARNING)

    def _update(self, cycle: Cycle, readings: Callable[[], Sequence[Echo]]) -> None:
        """Weigh the particles and publish the estimate."""
        if not self._started or self._odometry is None:
            return
        echoes: Sequence[Echo] = ()
        if self._filter.due:
            echoes = readings()
            self._filter.weigh(echoes)
            self._update_fit()
            self._check_against(echoes)
            self._update_off_map()
        # A localized robot keeps its cluster: another one that fits equally well, such as the room
        # next door, is no reason to jump.
        found = self._filter.estimate(None if isinstance(self._belief, Lost) else self._estimate)
        if self._belief.off_map and self._estimate is not None:
            wide = self._filter.scatter()
            found = replace(found, pose=self._estimate, covariance=wide, share=1.0)
        elif not self._filter.refuted:
            self._filter.tell(found.pose, echoes)
        self._update_belief(found)
        belief = self._belief
        self._filter.lost = isinstance(belief, Lost) and not belief.spread
        c = found.covariance
        if isinstance(belief, Lost):  # at least 1 m: no place fits
            c = np.clip(self._filter.scatter(), np.eye(3), WIDEST)
        else:
            c = widened(c, self._filter.bound.at(found.pose[2]))
            c = c if belief.off_map else confined(c, self.p.doubt_m)
            more = max(0.0, self._least_m(belief) ** 2 - float(c[0, 0] + c[1, 1]))
            least_rad = 0.0 if belief.is_sure else belief.off_rad
            turned = max(0.0, least_rad**2 - float(c[2, 2]))
            c = c + np.diag([0.5 * more, 0.5 * more, turned])
        self.publish(
            Correction(
                cycle,
                *compose(found.pose, relative(self._odometry.pose, STOOD)),
                covariance=tuple(float(c[i, j]) for i in range(3) for j in range(i, 3)),
                confidence=0.0 if isinstance(belief, Lost) else min(1.0, found.share),
                elsewhere=belief.suspect,
                off_map=belief.off_map,
                wheels=self._wheels_known,
            )
        )
        if self._published is None or self.now - self._published.at >= PARTICLES_S:
            self._publish_particles(cycle)
            self._check_wheels()

    def _update_off_map(self) -> None:
        """Decide whether the map shows this place."""
        belief, hits = self._belief, self._filter.hits
        if isinstance(belief, Lost) or belief.unconfirmed:
            return
        off = hits < OFF_MAP and self._follows
        if belief.off_map:  # it is on the map once half of the particles have agreed on a place
            off = hits < ON_MAP or self._filter.estimate().share < AGREED
        if off and not belief.off_map:
            off_m = belief.off_m if belief.unproved > 0.0 else 0.0
            belief = replaced(belief, off_map=True, off_m=off_m, off_rad=0.0)
            self._belief = replaced(belief, suspect=False, verdicts=0)
            self.log("the robot is off the map: scans alone tell its motion")
        elif belief.off_map and not off:
            off_m = max(belief.off_m, self._filter.bound.most_m)
            self._estimate, proof = None, RETURNED * self.p.proved_m
            self._belief = replaced(belief, off_map=False, off_m=off_m, unproved=proof)
            self.log("the robot is on the map again")

    def _least_m(self, belief: Localized) -> float:
        """Least standard deviation to publish for a localized robot, m."""
        refuted = self._filter.refuted
        if self._questioned:
            return self.p.adrift_m
        if self._follows:
            return 0.0 if belief.is_sure else max(self.p.unproved_m, belief.off_m)
        if belief.suspect or refuted:
            # At rest no new reading can settle it: relocate makes the robot turn.
            rests = self.now - self._searches.at > UNSETTLED_S
            agree = belief.suspect and (refuted or self._fit.bad or belief.verdicts > 1)
            adrift = rests or agree or self._filter.disproved
            return self.p.adrift_m if adrift else self.p.doubt_m
        misfits = self._filter.fit < self._confirm.found_fit
        doubted = misfits or belief.unproved > DRIVEN * self.p.proved_m
        if belief.unconfirmed and doubted:
            return self.p.adrift_m  # no deviation of a place tells how far off another place is
        if self._waits and (misfits or self._proves(belief)):
            return self.p.adrift_m
        if not belief.is_proved:
            return max(self.p.unproved_m, belief.off_m)
        return self.p.misfit_m if self._fit.bad else 0.0

    @property
    def _waits(self) -> bool:
        """Whether the robot stands as no path is free, from where its readings fit badly.

        No new reading can show that it was lifted, and no path is free from where it is not.
        Relocate drives a lost robot, so there are new ones. By scans the particles follow to where
        they fit, so there a place that is not proved counts as well.
        """
        trajectory, belief = self.latest(Trajectory), self._belief
        if trajectory is None or not trajectory.waits:
            return False
        proves = isinstance(belief, Localized) and self._proves(belief)
        return proves or self._filter.fit < self.p.fits

    def _publish_particles(self, cycle: Cycle) -> None:
        """Publish a sample of the particles: the same sample while the robot stands."""
        changes, before = self._filter.changes, self._published
        if before is not None and before.changes == changes:
            message = replace(before.message, cycle=cycle)
        else:
            message = particles.message_of(cycle, self._filter.drawn(particles.MOST).tolist())
        self._published = Published(self.now, changes, message)
        self.publish(message)

    def _update_belief(self, found: Estimate) -> None:
        """Decide by the particles alone whether the robot is lost: they spread, or jump.

        Where few sensed objects are on the map, the particles spread as the odometry does and
        converge again later. An estimate that jumps belongs to another place.
        """
        p, belief, share, width = self.p, self._belief, found.share, found.deviation_m
        leaps = self._estimate is not None and apart(found.pose, self._estimate)
        self._estimate = found.pose
        if isinstance(belief, Lost):
            fits = width < p.misfit_m and found.fit >= p.fits
            converged = belief.spread and share >= p.found and fits
            self._belief = replaced(belief, converged=converged)
            if converged and not self._has_laser:
                self._set_localized(found.pose, proofs=0)  # its particles were tracked all along
            return
        short, long = found.axes_m
        uncertain = share < p.lost or SQUARE * short > p.lost_m or long > p.along_m
        if belief.off_map:
            uncertain, leaps = self._window is not None and self._window.blind, False
        since = (belief.since or self.now) if uncertain else None
        self._belief = replaced(belief, since=since)
        waited = since is not None and self.now - since >= p.lost_s
        if leaps or waited:
            self._set_lost(
                f"at best at {_place(found.pose)}, with {100 * share:.0f} % of the weight,"
                f" +-{width:.2f} m; the readings fit by {found.fit:.2f}",
                spread=not leaps,
            )

    def _advance_search(self) -> None:
        """Do one cycle's share of a search of the whole map, if there is a reason for one."""
        searches = self._searches
        if searches.running is None:
            searches.running = self._begin_search()
        search = searches.running
        if search is None or not search.advance():
            return
        searches.running = None
        belief = self._belief
        if isinstance(belief, Lost) or belief.unconfirmed:
            self._accept_place(search)
        elif self._estimate is not None:
            self._check_kidnapped(search, belief, self._estimate)

    def _begin_search(self) -> Search | None:
        """A search for a lost robot, or for one whose newest readings fit badly; None: no need."""
        particles, history, belief = self._filter, self._filter.history, self._belief
        if isinstance(belief, Lost) or belief.unconfirmed:
            if history.steps < self._confirm.looks_after:
                return None
            history.mark()
            return particles.search()
        proves = self._proves(belief)
        if not belief.suspect and particles.fit >= self.p.fits and not proves:
            self._mark_explained()
            return None
        if self._follows and not proves:
            if not belief.off_map or (self._given and self._anchored):
                self._belief = replaced(belief, suspect=False, verdicts=0)
                self._mark_explained()
            if history.new_readings < LOOKS_OFF:
                return None
        searches = self._searches
        new, waited = history.new_readings - searches.readings, self.now - searches.at
        if new < self.p.doubted_after and not (new > 0 and waited >= SEARCH_S):
            return None
        searches.readings, searches.at = history.new_readings, self.now
        return particles.search(min(history.new_readings, particles.settings.search.doubted))

    def _proves(self, belief: Localized) -> bool:
        """Whether scans have led to a place on the map that is still to be proved."""
        return self._window is not None and belief.unproved > 0.0 and not belief.off_map

    def _mark_explained(self) -> None:
        """Count the readings until now as explained by the present pose."""
        self._filter.history.mark(RECENT)
        self._searches.readings = self._filter.history.new_readings

    def _check_kidnapped(self, search: Search, belief: Localized, here: Pose2) -> None:
        """Decide whether the robot was moved: update suspicion and verdicts."""
        p, confirm = self.p, self._confirm
        other = search.alternative(here, self._filter.settings.trust)
        if other is None or (self._follows and other.odds < confirm.clear_odds):
            self._belief = replaced(belief, suspect=False, verdicts=0)
            self._mark_explained()
            return
        suspect = self._explains_better(other, belief)
        verdicts = 0 if other.throughout < p.doubts else belief.verdicts
        self._belief = belief = replaced(belief, suspect=suspect, verdicts=verdicts)
        if not suspect:
            if other.throughout < -p.stays:
                self._mark_explained()
            return
        if other.odds < confirm.odds or other.fit < confirm.fit:
            return
        clear = self._is_clear(other)
        if self._follows and not clear:
            return
        clear &= not self._follows  # then each of these searches counts as one
        again = verdicts if clear or not apart(other.pose, belief.agreed) else 0
        verdicts = again + (confirm.clear if clear else 1)
        self._belief = replaced(belief, verdicts=verdicts, agreed=other.pose)
        if verdicts >= confirm.verdicts:
            self._filter.history.discard_old(other.readings)
            self._set_lost(
                f"not at {_place(here)}, where the readings fit by {other.stay_fit:.2f}:"
                f" they fit by {other.fit:.2f} at {_place(other.pose)}",
                unmoved=None if self._filter.disproved else here,
            )

    def _explains_better(self, other: Alternative, belief: Localized) -> bool:
        """Whether another place explains the readings, and the present one does not.

        A place that fits well is kept: unmapped objects, and walls that reflect nothing, let other
        places fit a little better all along the way, which adds up to any odds. Against a place
        that fits as if everything were mapped, only the pose itself is kept, and none beside it,
        and not even that while it is still to be proved.
        """
        stay, clear = other.stay_fit, self._is_clear(other)
        if clear:
            stay = min(stay, self._filter.fit)
        return (
            other.odds >= self.p.doubts
            and (stay < self.p.fits or (clear and self._proves(belief)))
            and other.fit >= self._confirm.better * stay
        )

    def _is_clear(self, other: Alternative) -> bool:
        """Whether another place fits as if everything were mapped."""
        return other.odds >= self._confirm.clear_odds and other.fit >= self._confirm.clear_fit

    def _set_lost(self, why: str, *, spread: bool = False, unmoved: Pose2 | None = None) -> None:
        self._given, self._on_map_m, self._against = False, 0.0, 0.0
        self._belief = Lost(spread, suspect=self._belief.suspect, unmoved=unmoved)
        self._searches.running = None
        self.log(f"the robot is lost: {why}", WARNING)

    def _set_localized(self, pose: Pose2, proofs: int) -> None:
        unmoved = self._belief.unmoved
        if not proofs or (unmoved is not None and apart(pose, unmoved)):
            unmoved = None
        proof = off_rad = 0.0
        if isinstance(self._belief, Lost):
            proof, off_rad = self.p.proved_m, FOUND_RAD
            self._filter.require_proof(self.p.unproved_m, FOUND_RAD)
        self._belief = Localized(proofs, proof, off_rad=off_rad, unmoved=unmoved)
        self._estimate = pose
        self._searches = Searches(at=self._searches.at)
        self.log(f"the robot is localized at {_place(pose)}")

    def _accept_place(self, search: Search) -> None:
        """Accept a place on the whole map for a lost robot, or confirm the one accepted last.

        One place has to be much better than all others in several consecutive searches while the
        robot drives: a wrong place is worse than a late one.
        """
        if not (places := search.places):
            return
        unmoved = self._unmoved_place(search)
        if unmoved is not None:
            self._belief = replaced(self._belief, unmoved=unmoved.pose)
        best, belief = unmoved or places[0], self._belief
        if isinstance(belief, Lost) and not belief.spread:
            self._filter.gather(search)  # for the next search, and for relocate's comparison
        sure = best.share >= self.p.found and best.fit >= self._confirm.found_fit
        if isinstance(belief, Localized):
            if self._estimate is None or not apart(best.pose, self._estimate):
                unconfirmed = belief.unconfirmed - (best.share >= self.p.found)
                kept = belief.unmoved if unconfirmed else None
                self._belief = replaced(belief, unconfirmed=unconfirmed, unmoved=kept)
            elif sure:
                self._set_lost(f"the readings since it was found fit better at {_place(best.pose)}")
            return
        again = belief.sure if not apart(best.pose, belief.agreed) else 0
        times = again + 1 if sure else 0
        self._belief = replaced(belief, sure=times, agreed=best.pose)
        # Spread particles mostly still include the true pose, so leaving them takes more searches.
        # They also converge if scans of unmapped objects fit by chance: a search has to agree.
        needed = self.p.found_times * (2 if belief.spread else 1)
        if belief.converged and self._estimate is not None and not apart(best.pose, self._estimate):
            needed = 1
        if times >= needed:
            if belief.spread:
                self._filter.gather(search)
            elif best.pose == belief.unmoved:  # the search may not have it among its best places
                self._filter.start_at(best.pose, self.p.start_m, self.p.start_rad)
            self._set_localized(best.pose, self.p.proved_times)

    def _unmoved_place(self, search: Search) -> Place | None:
        """The pose of a robot that was not moved; None if another place is likelier."""
        before = self._belief.unmoved
        if before is None:
            return None
        place = search.staying(before, UNMOVED_ODDS)
        if place is None or place.share < 0.5 or place.fit < self._confirm.found_fit:
            return None
        return None if apart(place.pose, before) else place

    def _update_fit(self) -> None:
        """Report readings that fit the map badly on average. The robot is slow until they fit."""
        least = self._confirm.misfit
        if isinstance(self._belief, Lost):
            self._fit = Fit(USUAL_FIT * least)
            return
        before, average = self._fit, self._fit.average
        average += self.cycles.period / MISFIT_S * (self._filter.fit - average)
        self._fit = Fit(average, average < least)
        if self._fit.bad and not before.bad:
            self.log(
                f"the readings fit the map badly ({average:.2f} on average): it may be of another"
                " place, or much has changed",
                WARNING,
            )


def _place(pose: Sequence[float]) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"


def as_fired(echoes: Sequence[Echo], motion: Pose2, share: float) -> list[Echo]:
    """The echoes with each sonar mounted where it was when it fired, in the present body frame.

    The sonars fire one after the other, the last on average half a period ago; `share` is the
    period from ping to ping in cycles, `motion` (m, m, rad) that of this cycle. At 0.5 m/s and 40
    ms the shift is 2 cm per sonar, always in the same direction.
    """
    x, y, turn = motion
    shifted = []
    for later, echo in enumerate(reversed(echoes)):
        ago = -(later + 0.5) * share
        mount = compose((ago * x, ago * y, ago * turn), (echo.x, echo.y, echo.bearing))
        shifted.append(Echo(*mount, echo.range))
    return shifted[::-1]


def model_of(grid: Grid, profile: RobotProfile) -> Model:
    """The measurement model of a map: a laser's if the robot has one, else the sonars'."""
    if profile.laser is not None:
        return LaserModel(grid)
    ring = profile.ring
    return sonar_model(grid, radians(ring.cone_deg), ring.max_m)


_small_model = lru_cache(maxsize=2)(SonarModel)
"""Shared by the runs of a series in the same world: a model is immutable."""


def sonar_model(grid: Grid, cone_rad: float, reach_m: float) -> SonarModel:
    """The measurement model for sonars. For a large map its fields are cached on disk."""
    if grid.clearance.size < LARGE:
        return _small_model(grid, cone_rad, reach_m)

    def make() -> Arrays:
        return fields(grid, cone_rad, reach_m)._asdict()

    about = repr((version("armadico"), FORMAT, grid.cell_m, grid.bounds, cone_rad, reach_m))
    key = sha256(about.encode() + grid.walls.tobytes()).hexdigest()[:32]
    return SonarModel(
        grid, cone_rad, reach_m, Fields(**cached_arrays(f"sonars-{key}", Fields._fields, make))
    )
