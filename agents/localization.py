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
from armadico.agents.methods.laser_model import BEAMS, LaserModel, beams_of
from armadico.agents.methods.monte_carlo import LASER, Estimate, Model, MonteCarlo, Settings
from armadico.agents.methods.odometry import begun_anew
from armadico.agents.methods.sonar_model import FORMAT, Fields, SonarModel, fields
from armadico.config.kept import Arrays, arrays
from armadico.config.places import Places
from armadico.config.profile import RobotProfile, load_profile
from armadico.config.worlds import load_world
from armadico.core import agent, particles
from armadico.core.agent import WARNING, Agent
from armadico.core.geometry import Pose2, compose, relative, wrap
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


LARGE = 250_000
"""Cells from which on what is made of a map is kept: half a second's work and more."""

STOOD: Pose2 = (0.0, 0.0, 0.0)

LEAP_M, LEAP_RAD = 0.5, 0.5
"""An estimate that changes by more in a cycle is of another place."""

UNCOUNTED_M, UNCOUNTED_RAD = 0.5, 0.5
"""Standard deviations of what rolled while nobody counted: two seconds until the controller's
watchdog, and braking, at half the top speed, or turning."""

HEARD, SEEN = (5, 0.28), (3, 0.6)
"""New readings after which a lost robot is looked for, and how well they have to fit where it is
found: by sonars, of which many hear what is on no map, and by a laser."""

PINGS_A_SCAN = 5
"""A scan tells as much as a cycle's pings do, and more."""

STANDS_S = 3.0
"""Who has doubted for so long is looked for by what was seen, few scans as that may be."""

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
    lost_fit: Share = 0.55  # or if the readings fit so much worse than they usually do
    lost_way_m: Metres = 1.0  # all along such a way,
    lost_turn_rad: Angle = 3.0  # or such a turn, or a part of both:
    carried_fit: Share = 0.55  # or if what it has heard meanwhile fits so well elsewhere,
    carried_pings: Annotated[int, Meta(ge=1, le=1000)] = 15  # looked for after so many more:
    doubt_m: Metres = 0.35  # before that it is no surer than this,
    fits_again: Share = 0.8  # nor until the readings fit so well again
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
        )
        self._ping_s = 0.0 if self._sees else profile.ring.period_s
        self._scan: int | None = None  # the last one's number
        by_sensor = SEEN if self._sees else HEARD
        self._looks_after = self.p.looks_after or by_sensor[0]
        self._found_fit = by_sensor[1] if self.p.found_fit is None else self.p.found_fit
        # Readings that tell as much as a ping does: of a scan's rays, which are many and alike.
        self._doubted_after = self.p.carried_pings * (BEAMS // PINGS_A_SCAN if self._sees else 1)
        self._odometry: Pose2 | None = None
        self._motion: Pose2 = STOOD  # in the last cycle
        self._epoch: int | None = None
        self._begun = False
        self._lost = self.p.start == "anywhere"
        self._at: Pose2 | None = None  # the estimate a cycle ago
        self._since: float | None = None  # when it began to seem lost
        self._doubts = False  # the readings fit badly,
        self._misfit = 0.0  # and have done so for such a share of the way that it takes to be lost
        self._doubts_since = 0.0
        self._looked = 0  # and so many pings of them have been looked for elsewhere
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
        elif self._doubts and found.deviation_m < self.p.doubt_m:
            c = c + np.diag([0.5 * self.p.doubt_m**2] * 2 + [0.0])
        self.publish(
            Correction(
                cycle,
                *compose(found.pose, relative(self._odometry, (0.0, 0.0, 0.0))),
                covariance=tuple(float(c[i, j]) for i in range(3) for j in range(i, 3)),
                confidence=0.0 if self._lost else min(1.0, found.share),
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
        Readings that fit badly may be people's: it slows down. What people let it hear fits nowhere
        on the map; what a robot that was carried away hears fits where it is now.
        """
        p, x, y = self.p, found.pose[0], found.pose[1]
        wide, share = found.deviation_m, found.share
        leaps = self._at is not None and apart(found.pose, self._at)
        self._at = found.pose
        if not self._lost:
            carried = self._doubt(found)
            doubtful = share < p.lost or wide > p.lost_m
            self._since = (self._since or self.now) if doubtful else None
            waited = self._since is not None and self.now - self._since >= p.lost_s
            if not (waited or leaps or carried):
                return
            if not self._unproved:  # it may have been carried here when it began to doubt
                self._filter.forget(self._filter.news if self._doubts else 0)
            self._lose(
                f"at best at ({x:.2f}, {y:.2f}), with {100 * share:.0f} % of the"
                f" weight, +-{wide:.2f} m; the readings fit by {found.fit:.2f}"
            )
        elif self._sure >= p.found_times:
            self._lost, self._since, self._unproved = False, None, p.proved_times
            self.log(f"the robot is found: at ({x:.2f}, {y:.2f})")

    def _doubt(self, found: Estimate) -> bool:
        """Take how well the readings fit; whether it must have been carried away."""
        p, usual = (
            self.p,
            max(found.usual, self._filter.settings.fits),
        )  # a wrong place is no standard
        badly = found.fit < p.lost_fit * usual
        doubted = self._doubts
        self._doubts = badly or (doubted and found.fit < p.fits_again * usual)
        x, y, turn = self._motion
        moved = hypot(x, y) / p.lost_way_m + abs(turn) / p.lost_turn_rad
        self._misfit = self._misfit + moved if badly else 0.0
        if not self._doubts:
            return False
        if not doubted:
            self._filter.mark()
            self._looked, self._doubts_since = 0, self.now
        heard = self._filter.echoes_of_news
        # Who stands, because no way is free where it believes to be, sees no more than it has.
        stands = self._sees and heard > self._looked and self.now - self._doubts_since >= STANDS_S
        if heard - self._looked < self._doubted_after and not stands:
            return self._misfit >= 1.0
        self._looked = heard
        best, *_ = self._filter.rivals()
        elsewhere = best.fit >= p.carried_fit and apart(best.pose, found.pose)
        return elsewhere or self._misfit >= 1.0

    def _lose(self, why: str) -> None:
        self._lost, self._since, self._sure, self._unproved = True, None, 0, 0
        self._doubts, self._misfit = False, 0.0
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


def apart(one: Pose2, other: Pose2) -> bool:
    """Whether these are two places."""
    far = hypot(one[0] - other[0], one[1] - other[1]) > LEAP_M
    return far or abs(wrap(one[2] - other[2])) > LEAP_RAD


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
        return LaserModel(grid, profile.laser.max_m)
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
