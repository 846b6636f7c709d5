"""The localization agent: where the robot is on the map, by its sensors (thesis 3.6.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from math import hypot, radians
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.methods.grid import CELL_M, Grid, check_extent, grid_of
from armadico.agents.methods.laser_model import LaserModel, beams_of
from armadico.agents.methods.monte_carlo import (
    LASER,
    Elsewhere,
    Estimate,
    Model,
    MonteCarlo,
    Settings,
    apart,
)
from armadico.agents.methods.odometry import begun_anew
from armadico.agents.methods.sonar_model import FORMAT, Fields, SonarModel, fields
from armadico.config.kept import Arrays, arrays
from armadico.config.places import Places
from armadico.config.profile import RobotProfile, load_profile
from armadico.config.worlds import load_world
from armadico.core import agent, particles
from armadico.core.agent import WARNING, Agent
from armadico.core.geometry import Pose2, compose, relative
from armadico.core.messages import (
    Correction,
    Cycle,
    Echo,
    Message,
    Particles,
    Pose,
    RobotState,
    Scan,
    Sonar,
)

Metres = Annotated[float, Meta(gt=0, le=100)]
Angle = Annotated[float, Meta(gt=0, le=6.2832)]
Share = Annotated[float, Meta(ge=0, le=1)]
Odds = Annotated[float, Meta(ge=0, le=1000)]
"""A natural logarithm."""


LARGE = 250_000
"""Cells from which on what is made of a map is kept: a fifth of a second's work and more."""

STOOD: Pose2 = (0.0, 0.0, 0.0)

UNCOUNTED_M, UNCOUNTED_RAD = 0.5, 0.5
"""Standard deviations of what rolled while nobody counted: two seconds until the controller's
watchdog, and braking, at half the top speed, or turning."""

HEARD, SEEN = (5, 0.28), (3, 0.6)
"""New readings after which a lost robot is looked for, and how well they have to fit where it is
found: by sonars, of which many hear what is on no map, and by a laser."""

UNDOUBTED = 2
"""Newest readings that may be of another place though nobody has doubted yet."""

STANDS_S = 3.0
"""Who has doubted for so long without having come far is looked for by the little that is new."""

PARTICLES_S = 0.5
"""From one publication of particles to the next: for those who watch."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The map, the robot, and what is believed at the start.

    `start` "pose" begins about the pose that the encoder agent publishes, "anywhere" with no idea.
    What is none is as is good for the sensor.
    """

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    start: Literal["pose", "anywhere"] = "pose"
    start_m: Metres = 0.15  # standard deviation about that pose
    start_rad: Angle = radians(6.0)
    lost: Share = 0.15  # with less than this of the weight in one place it is lost,
    lost_m: Metres = 0.5  # or in one so wide,
    lost_s: Annotated[float, Meta(gt=0, le=60)] = 0.5  # for so long
    fits: Share = 0.5  # while the newest pings fit so well nobody looks whether it is elsewhere,
    doubted_after: Annotated[int, Meta(ge=1, le=100)] = 3  # else after so many more readings:
    stays: Odds = 3.0  # until all other places have such odds against them;
    fits_better: Annotated[float, Meta(ge=1, le=100)] = 1.5  # or one fits so many times better
    doubts: Odds = 1.5  # with such odds for it: then it is
    doubt_m: Metres = 0.35  # no surer than this;
    carried: Odds = 7.5  # and lost with such odds,
    doubt_s: Annotated[float, Meta(gt=0, le=60)] = 8.0  # or if it has doubted for so long
    stands_m: Metres = 0.5  # and not come so far meanwhile
    looks_after: Annotated[int, Meta(ge=1, le=100)] | None = None  # new readings, on all the map
    found: Share = 0.95  # and found with this much in one of all the places that fit,
    found_fit: Share | None = None  # where the readings fit so well, by their geometric mean,
    found_times: Annotated[int, Meta(ge=1, le=100)] = 3  # so often in a row;
    proved_times: Annotated[int, Meta(ge=0, le=100)] = 4  # sure of it, once it has so often been
    unproved_m: Metres = 0.4  # the best one since: until then nobody drives fast by it
    filter: Settings | None = None


class Localization(Agent):
    """Moves its particles with the odometry, weighs them by what is heard or seen, and says where.

    By the laser, if the robot has one, else by the sonars: what a laser sees is sure, and narrow.

    It works on the odometry as the controller counts it, so what it publishes does not come back to
    it by the pose: a correction is where the odometry's origin lies in the world, as tf's
    transform from map to odom. The encoder agent composes it.
    """

    name = "localization"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Sonar, Scan, Pose)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction, Particles)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        world, profile = load_world(self.p.world), load_profile(self.p.profile)
        check_extent(world, CELL_M)
        grid = grid_of(world.outlines, world.bounds, CELL_M)
        rows, columns = np.nonzero(grid.clearance > profile.body.width_m / 2)
        free = np.column_stack([grid.xs[columns], grid.ys[rows]])
        self._places = Places(world, profile.body)
        self._free, inhabited = free, free[self._places.inhabited(free)]
        self._useful = bool(world.outlines) and len(free) > 0
        self._sees = profile.laser is not None
        self._filter = MonteCarlo(
            model_of(grid, profile),
            inhabited if len(inhabited) else free,
            np.random.default_rng(self.rng.getrandbits(63)),
            self.p.filter or (LASER if self._sees else Settings()),
            lambda x, y: grid.clearances(x, y) > profile.body.width_m / 2 - 2 * CELL_M,
        )
        self._ping_s = 0.0 if self._sees else profile.ring.period_s
        self._scan: int | None = None  # the last one's number
        by_sensor = SEEN if self._sees else HEARD
        self._looks_after = self.p.looks_after or by_sensor[0]
        self._found_fit = by_sensor[1] if self.p.found_fit is None else self.p.found_fit
        self._odometry: Pose2 | None = None
        self._motion: Pose2 = STOOD  # in the last cycle
        self._epoch: int | None = None
        self._begun = False
        self._lost = self.p.start == "anywhere"
        self._at: Pose2 | None = None  # the estimate a cycle ago
        self._since: float | None = None  # when it began to seem lost
        self._doubted: tuple[float, Pose2] | None = None  # since when it may be elsewhere, where
        self._looked_at = 0.0  # when that was last looked for,
        self._looked = 0  # with so many readings
        self._sure = 0  # so often in a row one place has been much better than all others,
        self._best: Pose2 = STOOD  # this one,
        self._unproved = 0  # and so often it has to be that yet
        self._shown_at = float("-inf")
        self._shown: tuple[int, Particles] | None = None  # of which change of the particles

    def on_pose(self, pose: Pose) -> None:
        """Where to begin."""
        if self._begun or not self._useful or self._odometry is None:
            return
        self._begun = True
        self._lost = self._lost or pose.deviation > self.p.lost_m  # and was so before it started
        if self.p.start == "anywhere":
            self._filter.start_anywhere()
        else:
            here = np.array([[pose.x, pose.y]])
            if not self._lost and not self._places.inhabited(here).all():
                self._filter.may_be_at(self._free)  # names tell nothing of where this one drives
            off = max(self.p.start_m, pose.deviation)  # of a pose that nobody corrected lately
            turned = max(self.p.start_rad, pose.heading_deviation)
            self._filter.start_at((pose.x, pose.y, pose.theta), off, turned)

    def on_robot_state(self, state: RobotState) -> None:
        """Move the particles.

        The controller counts while there is no robot agent. If it has begun anew, nobody knows what
        the robot rolled meanwhile.
        """
        odometry, before = (state.x, state.y, state.theta), self._odometry
        another = state.cycle.epoch != self._epoch
        self._motion = STOOD
        self._odometry, self._epoch = odometry, state.cycle.epoch
        if before is None or not self._begun:
            return
        if another and begun_anew(before, odometry):
            self._filter.scatter_by(UNCOUNTED_M, UNCOUNTED_RAD)
            return
        self._motion = motion = relative(before, odometry)
        self._filter.move(motion)
        self._at = None if self._at is None else compose(self._at, motion)
        self._best = compose(self._best, motion)

    def on_sonar(self, sonar: Sonar) -> None:
        """Weigh the particles by what was heard."""
        if not self._sees:
            ago = self._ping_s / self.cycles.period
            self._weigh(sonar.cycle, lambda: as_fired(sonar.echoes, self._motion, ago))

    def on_scan(self, scan: Scan) -> None:
        """Weigh the particles by what was seen; a scan that is said again tells nothing new."""
        if not self._sees:
            return
        again, self._scan = scan.number == self._scan, scan.number
        try:
            beams = [] if again else beams_of(scan)
        except ValueError:
            return
        self._weigh(scan.cycle, lambda: beams)

    def _weigh(self, cycle: Cycle, readings: Callable[[], Sequence[Echo]]) -> None:
        """Weigh the particles, and publish where they are."""
        if not self._begun or self._odometry is None:
            return
        if self._filter.due:
            self._filter.weigh(readings())
        if (self._lost or self._unproved) and self._filter.news >= self._looks_after:
            self._look()
        # While it knows where it is it stays with that place: another one that fits as well, the
        # room next door, is no reason to leave it before it no longer fits.
        found = self._filter.estimate(None if self._lost else self._at)
        self._judge(found)
        self._filter.lost = self._lost
        c = found.covariance
        if self._lost:  # who fits nowhere is nowhere: at least a metre off
            c = np.maximum(self._filter.scatter(), np.eye(3))
        elif self._unproved:
            c = c + np.diag([0.5 * self.p.unproved_m**2] * 2 + [0.0])
        elif self._doubted is not None and found.deviation_m < self.p.doubt_m:
            c = c + np.diag([0.5 * self.p.doubt_m**2] * 2 + [0.0])
        self.publish(
            Correction(
                cycle,
                *compose(found.pose, relative(self._odometry, (0.0, 0.0, 0.0))),
                covariance=tuple(float(c[i, j]) for i in range(3) for j in range(i, 3)),
                confidence=0.0 if self._lost else min(1.0, found.share),
                elsewhere=self._doubted is not None,
            )
        )
        if self.now - self._shown_at >= PARTICLES_S:
            self._shown_at = self.now
            self._show(cycle)

    def _show(self, cycle: Cycle) -> None:
        """Publish some particles: the same again while the robot stands."""
        changes = self._filter.changes
        if self._shown is not None and self._shown[0] == changes:
            said = replace(self._shown[1], cycle=cycle)
        else:
            said = particles.message_of(cycle, self._filter.drawn(particles.MOST).tolist())
        self._shown = changes, said
        self.publish(said)

    def _judge(self, found: Estimate) -> None:
        """Whether it is lost: if it seems so for a while, and found once it has been sure.

        An estimate that leaps is of another place: the robot is lost until it is found there.
        """
        p, x, y = self.p, found.pose[0], found.pose[1]
        wide, share = found.deviation_m, found.share
        leaps = self._at is not None and apart(found.pose, self._at)
        self._at = found.pose
        if not self._lost:
            carried = None if self._unproved else self._elsewhere(found)
            doubtful = share < p.lost or wide > p.lost_m
            self._since = (self._since or self.now) if doubtful else None
            waited = self._since is not None and self.now - self._since >= p.lost_s
            if carried is not None:
                self._filter.forget(carried.readings)
                self._lose(
                    f"not at ({x:.2f}, {y:.2f}), where the readings fit by {found.fit:.2f}:"
                    f" what it heard fits by {carried.fit:.2f} elsewhere"
                )
            elif waited or leaps:
                if not self._unproved:
                    self._filter.forget()
                self._lose(
                    f"at best at ({x:.2f}, {y:.2f}), with {100 * share:.0f} % of the"
                    f" weight, +-{wide:.2f} m; the readings fit by {found.fit:.2f}"
                )
        elif self._sure >= p.found_times:
            self._lost, self._since, self._unproved = False, None, p.proved_times
            self._doubted = None
            self._looked, self._looked_at = 0, self.now
            self.log(f"the robot is found: at ({x:.2f}, {y:.2f})")

    def _elsewhere(self, found: Estimate) -> Elsewhere | None:
        """Where it may have been carried to, if it must have been.

        Readings that fit badly may be people's, and those fit nowhere on the map; what a robot that
        was carried away hears fits where it is now. So it is asked how much better another place
        explains what was heard since nothing else did. Until it is known, it slows down.
        """
        p, f = self.p, self._filter
        if self._doubted is None and f.fit >= p.fits:
            f.mark(UNDOUBTED)
            self._looked, self._looked_at = f.news, self.now
            return None
        new = f.news - self._looked
        if new < p.doubted_after and not (new and self.now - self._looked_at >= STANDS_S):
            return None
        self._looked, self._looked_at = f.news, self.now
        other = f.elsewhere(found.pose)
        # What is not on the map, and walls that are dead, let places elsewhere fit a little better
        # all along the way: that adds up to any odds.
        better = other is not None and other.fit >= p.fits_better * other.stay_fit
        if other is None or not better or other.odds < p.doubts:
            self._doubted = None
            if other is None or other.throughout < -p.stays:
                f.mark(UNDOUBTED)
                self._looked = f.news
            return None
        self._doubted = self._doubted or (self.now, found.pose)
        since, (x, y, _) = self._doubted
        stands = hypot(found.pose[0] - x, found.pose[1] - y) < p.stands_m
        lifted = other.odds >= p.carried or (stands and self.now - since >= p.doubt_s)
        return other if lifted else None

    def _lose(self, why: str) -> None:
        self._lost, self._since, self._sure, self._unproved = True, None, 0, 0
        self.log(f"the robot is lost: {why}", WARNING)

    def _look(self) -> None:
        """Look for it on the whole map, by all that it has heard of late.

        One place has to be much better than all others, again and again while the robot goes on:
        to be found wrongly is worse than to be found late.
        """
        best, *_ = self._filter.places()
        x, y, _ = best.pose
        if not self._lost and self._at is not None:
            if apart(best.pose, self._at):
                self._lose(f"what it heard since it was found fits better at ({x:.2f}, {y:.2f})")
            elif best.share >= self.p.found:
                self._unproved -= 1
            return
        sure = best.share >= self.p.found and best.fit >= self._found_fit
        again = self._sure if not apart(best.pose, self._best) else 0
        self._sure, self._best = (again + 1 if sure else 0), best.pose


def as_fired(echoes: Sequence[Echo], motion: Pose2, share: float) -> list[Echo]:
    """The echoes with their sonars where they were when they fired, in the frame of now.

    One fires after the other, the last on average half a period ago. At 0.5 m/s and 40 ms that is
    2 cm for each, always the same way.

    Args:
        echoes: In the order in which their sonars fired.
        motion: In this cycle: m, m, rad.
        share: From one ping to the next, in cycles.
    """
    x, y, turn = motion
    shifted = []
    for later, echo in enumerate(reversed(echoes)):
        ago = -(later + 0.5) * share
        mount = compose((ago * x, ago * y, ago * turn), (echo.x, echo.y, echo.bearing))
        shifted.append(Echo(*mount, echo.range))
    return shifted[::-1]


def model_of(grid: Grid, profile: RobotProfile) -> Model:
    """The model of a map for the sensor that tells most."""
    if profile.laser is not None:
        return LaserModel(grid)
    ring = profile.ring
    return sonar_model(grid, radians(ring.cone_deg), ring.max_m)


_small_model = lru_cache(maxsize=2)(SonarModel)
"""Shared by the runs of a series, which are in the same world; nothing changes a model."""


def sonar_model(grid: Grid, cone_rad: float, reach_m: float) -> SonarModel:
    """The model of a map. What a large map needs for it is kept for the next time."""
    if grid.clearance.size < LARGE:
        return _small_model(grid, cone_rad, reach_m)

    def make() -> Arrays:
        return fields(grid, cone_rad, reach_m)._asdict()

    about = repr((version("armadico"), FORMAT, grid.cell_m, grid.bounds, cone_rad, reach_m))
    key = sha256(about.encode() + grid.walls.tobytes()).hexdigest()[:32]
    return SonarModel(
        grid, cone_rad, reach_m, Fields(**arrays(f"sonars-{key}", Fields._fields, make))
    )
