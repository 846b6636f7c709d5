"""The localization agent: where the robot is on the map, by its sensors (thesis 3.6.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as replaced
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from math import radians
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from armadico.agents.localization import monte_carlo
from armadico.agents.localization.global_search import Alternative, Model, Place, Search, apart
from armadico.agents.localization.kept import Arrays, arrays
from armadico.agents.localization.laser_model import LaserModel, beams_of
from armadico.agents.localization.monte_carlo import Estimate, MonteCarlo, Settings
from armadico.agents.localization.sonar_model import FORMAT, Fields, SonarModel, fields
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.grid import CELL_M, Grid, check_extent, grid_of
from armadico.agents.methods.odometry import WIDEST, begun_anew, may_stand_at, nowhere
from armadico.config.places import Places
from armadico.config.profile import RobotProfile, load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.messages import Card, Cycle, Message, RobotState, line
from armadico.mobile import particles
from armadico.mobile.geometry import STOOD, Pose2, compose, relative
from armadico.mobile.messages import Correction, Echo, InitialPose, Particles, Pose, Scan, Sonar

Metres = Annotated[float, Meta(gt=0, le=100)]
Angle = Annotated[float, Meta(gt=0, le=6.2832)]
Share = Annotated[float, Meta(ge=0, le=1)]
Odds = Annotated[float, Meta(ge=0, le=1000)]
"""A natural logarithm."""


LARGE = 250_000
"""Cells from which on what is derived from a map is kept: a fifth of a second's work and more."""

UNCOUNTED_M, UNCOUNTED_RAD = 0.5, 0.5
"""Standard deviations of what rolled while no process counted: two seconds until the controller's
watchdog, and braking, at half the top speed, or turning."""

UNDOUBTED = 2
"""Newest readings that may be of another place though there is no doubt yet."""

AGAIN_S = 3.0
"""A search begins after so long by whatever is new: a slow robot has few readings."""

UNSETTLED_S = 6.0
"""So long a doubt may last without a new reading, and so may readings that fit by chance."""

STAYED = 30.0
"""So many times likelier than each other place is the one where the robot would be if it had not
been moved: readings of what is on no map make it lost more often than people lift it. In a room
that looks the same from both ends only this tells the two apart."""

PARTICLES_S = 0.5
"""From one publication of particles to the next, for displays."""

MISFIT_S = 15.0
"""Time constant of the average over how well readings fit the map, while the robot moves."""

USUAL = 1.4
"""Where that average begins, in shares of what counts as bad."""

WORN = 2.5
"""Wheel errors beyond so many of the profile's standard deviations are reported."""


class Confirmation(Struct, frozen=True):
    """What it takes to give up a pose, and to accept one on the whole map, by a sensor."""

    verdicts: int  # searches in a row that have to agree on one other place,
    odds: float  # with such odds, a natural logarithm,
    fit: float  # where the readings fit so well in absolute terms, by their geometric mean,
    better: float  # and so much better than here
    looks_after: int  # steps between new readings after which a lost robot is searched for,
    found_fit: float  # and how well they have to fit where it is found
    misfit: float  # a worse fit than this on average is reported,
    chance: float  # and no better than this they fit anywhere
    clear: int = 3  # verdicts that a search counts for, whichever place it finds,
    clear_odds: float = 7.0  # with such odds,
    clear_fit: float = 0.85  # if the readings fit there as if everything were mapped


SONARS = Confirmation(
    verdicts=1,
    odds=7.5,
    fit=0.42,
    better=1.4,
    looks_after=5,
    found_fit=0.28,
    misfit=0.3,
    chance=0.0,
)
LASER = Confirmation(
    verdicts=5,
    odds=1.5,
    fit=0.7,
    better=1.5,
    looks_after=3,
    found_fit=0.6,
    misfit=0.5,
    chance=0.3,
)
"""Chosen on three logs of real robots (laser), and on simulated kidnappings (sonars).

What is on no map fits another place by chance. A laser does not see that it is nearer than the map
has it, so that one verdict is not enough. Of sonars it is known (`Search.alternative`), and they
are so ambiguous that the best other place changes from one search to the next.
"""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The map, the robot, and what is believed at the start.

    `start` "pose" begins about the pose that the encoder agent publishes, "anywhere" with no idea.
    A value of none means the sensor's own default.
    """

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    start: Literal["pose", "anywhere"] = "pose"
    start_m: Metres = 0.15  # standard deviation about that pose
    start_rad: Angle = radians(6.0)
    lost: Share = 0.15  # with less than this of the weight in one place the robot is lost,
    lost_m: Metres = 0.5  # or in one so wide,
    lost_s: Annotated[float, Meta(gt=0, le=60)] = 0.5  # for so long
    fits: Share = 0.5  # while the newest readings fit so well there is no search,
    doubted_after: Annotated[int, Meta(ge=1, le=100)] = 3  # else one after so many more readings,
    stays: Odds = 3.0  # until all other places have such odds against them;
    doubts: Odds = 1.5  # with such odds a place elsewhere raises doubt, and the robot slows down:
    doubt_m: Metres = 0.45  # its pose is no surer than this,
    misfit_m: Metres = 0.3  # and no surer than this while the readings fit badly all along;
    adrift_m: Metres = 0.6  # both at once, a second verdict, no reading, or a bad fit once found
    confirm: Confirmation | None = None  # what makes it lost, and found
    found: Share = 0.95  # found with this much of the weight in one of all the places that fit,
    found_times: Annotated[int, Meta(ge=1, le=100)] = 3  # in so many searches in a row;
    proved_times: Annotated[int, Meta(ge=0, le=100)] = 4  # and sure of it after so many more,
    unproved_m: Metres = 0.4  # until when its pose is no surer than this
    filter: Settings | None = None


@dataclass(frozen=True)
class Localized:
    """That the pose is known.

    Attributes:
        unproved: Searches that have to confirm it yet.
        doubted: Whether another place explains the news better.
        verdicts: Searches in a row that agreed on another place.
        since: When the particles began to spread too far, s.
    """

    unproved: int = 0
    doubted: bool = False
    verdicts: int = 0
    since: float | None = None


@dataclass(frozen=True)
class Lost:
    """That the pose is not known.

    Attributes:
        spread: Whether it is lost since the particles spread: they may converge again.
        converged: Whether they have.
        sure: Searches in a row in which one place was much better than all others.
        doubted: Whether another place explained the news better when it got lost.
    """

    spread: bool = False
    converged: bool = False
    sure: int = 0
    doubted: bool = False


class Localization(Agent):
    """Estimates the pose on a known map with a particle filter, by laser or sonars.

    A robot that has a laser uses it alone: its rays are precise, sonars are not.

    The particles move with the odometry as the controller counts it, so what this agent publishes
    does not come back to it by the pose: a correction is where the odometry's origin lies in the
    world, as tf's transform from map to odom. The encoder agent composes it.

    Doubt slows the robot down; only confirmation makes it lost. Readings that fit badly may be of
    furniture or people, which fit no place on the map. Where another place explains them better,
    searches of the whole map have to confirm it, by a laser several in a row.
    """

    name = "localization"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Sonar, Scan, Pose, InitialPose)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction, Particles)
    parameters = Parameters
    launched_with = ("world", "profile", "start_m", "start_rad")
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
        self._grid, clear_m = grid, profile.body.width_m / 2 - 2 * CELL_M
        self._confirm = self.p.confirm or (LASER if self._sees else SONARS)
        self._filter = MonteCarlo(
            model_of(grid, profile),
            inhabited if len(inhabited) else free,
            np.random.default_rng(self.rng.getrandbits(63)),
            self.p.filter or (monte_carlo.LASER if self._sees else Settings()),
            profile.wheels,
            lambda x, y: grid.clearances(x, y) > clear_m,
        )
        self._ping_s = 0.0 if self._sees else profile.ring.period_s
        self._scan: int | None = None  # the last one's number
        self._odometry: Pose2 | None = None
        self._motion: Pose2 = STOOD  # in the last cycle
        self._epoch: int | None = None
        self._begun = False
        self._belief: Localized | Lost = Lost() if self.p.start == "anywhere" else Localized()
        self._at: Pose2 | None = None  # the estimate a cycle ago
        self._stayed: Pose2 | None = None  # where it is if it was not moved when it got lost
        self._search: Search | None = None  # under way
        self._searched = 0  # news when the last search began,
        self._searched_at = 0.0  # and when that was
        self._elsewhere: Pose2 = STOOD  # the other place that searches agreed on
        self._best: Pose2 = STOOD  # the place that was best in the last search of a lost robot
        self._fit = USUAL * self._confirm.misfit  # of the readings, on average,
        self._misfit = False  # and whether that is bad
        self._doubts = ""  # of the odometry, as reported
        self._shown_at = float("-inf")
        self._shown: tuple[int, Particles] | None = None  # of which change of the particles

    def on_pose(self, pose: Pose) -> None:
        """Begin about the first pose."""
        if self._begun or not self._useful or self._odometry is None:
            return
        if nowhere(pose.x, pose.y):
            return
        self._begun = True
        if pose.deviation > self.p.lost_m:  # and was so before it started
            self._belief = Lost()
        if self.p.start == "anywhere":
            self._filter.start_anywhere()
        else:
            here = np.array([[pose.x, pose.y]])
            known = isinstance(self._belief, Localized)
            if known and not self._places.inhabited(here).all():
                self._filter.may_be_at(self._free)  # names tell nothing of where this one drives
            off = max(self.p.start_m, pose.deviation)  # of a pose that was not corrected lately
            turned = max(self.p.start_rad, pose.heading_deviation)
            self._filter.start_at((pose.x, pose.y, pose.theta), off, turned)

    def on_initial_pose(self, told: InitialPose) -> None:
        """Begin again about a pose that people know, unless the robot cannot be there."""
        at_rest = may_stand_at(told, self.latest(RobotState))
        if not self._useful or self._odometry is None or not at_rest:
            return
        if np.hypot(*(self._free - (told.x, told.y)).T).min() > 2.0 * self.p.start_m:
            at = _place((told.x, told.y))
            self.log(f"initial pose {at} rejected: no free space there on the map", WARNING)
            return
        pose = told.x, told.y, told.theta
        self._begun = True
        self._find(pose, 0)
        self._filter.start_at(pose, self.p.start_m, self.p.start_rad)

    def on_robot_state(self, state: RobotState) -> None:
        """Move the particles.

        The controller counts on while the robot agent is down. If it has begun anew, what the robot
        rolled meanwhile is not known.
        """
        odometry, before = (state.x, state.y, state.theta), self._odometry
        another = state.cycle.epoch != self._epoch
        self._motion = STOOD
        self._odometry, self._epoch = odometry, state.cycle.epoch
        if before is None or not self._begun:
            return
        if another and begun_anew(before, odometry):
            self._filter.scatter_by(UNCOUNTED_M, UNCOUNTED_RAD)
            self._search, self._searched, self._stayed = None, 0, None
            return
        self._motion = motion = relative(before, odometry)
        self._filter.move(motion)
        if self._search is not None:
            self._search.move(motion)
        self._at = None if self._at is None else compose(self._at, motion)
        if self._stayed is not None:
            before, self._stayed = self._stayed, compose(self._stayed, motion)
            if self._grid.clearance_between(Placed(*before[:2]), Placed(*self._stayed[:2])) == 0.0:
                self._stayed = None  # it would have driven through a wall: it was moved
        self._best = compose(self._best, motion)
        self._elsewhere = compose(self._elsewhere, motion)
        self._seek()  # each cycle, however seldom there are readings

    def on_sonar(self, sonar: Sonar) -> None:
        """Weigh the particles by echoes."""
        if not self._sees:
            ago = self._ping_s / self.cycles.period
            self._weigh(sonar.cycle, lambda: as_fired(sonar.echoes, self._motion, ago))

    def on_scan(self, scan: Scan) -> None:
        """Weigh the particles by a scan; one that is repeated tells nothing new."""
        if not self._sees:
            return
        again, self._scan = scan.number == self._scan, scan.number
        try:
            beams = [] if again else beams_of(scan)
        except ValueError:
            return
        self._weigh(scan.cycle, lambda: beams)

    def card(self) -> Card:
        """With what was learnt of the wheels."""
        learnt = self._wheels() if self._begun else ""
        return replace(super().card(), learnt=line(learnt), doubts=line(self._doubts))

    def _wheels(self) -> str:
        turning, drift, way = self._filter.learnt
        o = self._filter.odometry
        return (
            f"errors of the wheels (and the profile's standard deviations): turns"
            f" {100 * turning:+.1f} % ({100 * o.alpha1:.1f}), ways {100 * way:+.1f} %"
            f" ({100 * o.alpha3:.1f}), drift {drift:+.3f} rad/m ({o.alpha2:.3f})"
        )

    def _watch_wheels(self) -> None:
        """Report wheels that are far worse than the profile says."""
        o = self._filter.odometry
        limits = zip(self._filter.learnt, (o.alpha1, o.alpha2, o.alpha3), strict=True)
        worn = any(abs(off) > WORN * alpha for off, alpha in limits)
        if isinstance(self._belief, Lost) or self._doubts or not worn:
            return
        self._doubts = f"the odometry is worse than [odometry] of the profile: {self._wheels()}"
        self.log(self._doubts, WARNING)

    def _weigh(self, cycle: Cycle, readings: Callable[[], Sequence[Echo]]) -> None:
        """Weigh the particles, and publish where they are."""
        if not self._begun or self._odometry is None:
            return
        if self._filter.due:
            self._filter.weigh(readings())
            self._watch_fit()
        # While it is localized it stays with that place: another one that fits as well, the room
        # next door, is no reason to leave it before it no longer fits.
        found = self._filter.estimate(None if isinstance(self._belief, Lost) else self._at)
        self._judge(found)
        belief = self._belief
        self._filter.lost = isinstance(belief, Lost) and not belief.spread
        c = found.covariance
        if isinstance(belief, Lost):  # at least a metre off: no place fits
            c = np.clip(self._filter.scatter(), np.eye(3), WIDEST)
        else:
            more = max(0.0, self._least_m(belief) ** 2 - found.deviation_m**2)
            c = c + np.diag([0.5 * more, 0.5 * more, 0.0])
        self.publish(
            Correction(
                cycle,
                *compose(found.pose, relative(self._odometry, STOOD)),
                covariance=tuple(float(c[i, j]) for i in range(3) for j in range(i, 3)),
                confidence=0.0 if isinstance(belief, Lost) else min(1.0, found.share),
                elsewhere=belief.doubted,
            )
        )
        if self.now - self._shown_at >= PARTICLES_S:
            self._shown_at = self.now
            self._publish_particles(cycle)
            self._watch_wheels()

    def _least_m(self, belief: Localized) -> float:
        """Least standard deviation that is published of a localized robot, m."""
        chance = self._filter.fit < self._confirm.chance
        if belief.doubted or chance:
            # At rest there is no new reading to settle it by: relocate makes the robot turn.
            rests = self.now - self._searched_at > UNSETTLED_S
            agree = chance or self._misfit or belief.verdicts > 1
            if rests or (belief.doubted and agree):
                return self.p.adrift_m
        if belief.doubted:
            return self.p.doubt_m
        if belief.unproved:
            fits = self._filter.fit >= self._confirm.found_fit
            return self.p.unproved_m if fits else self.p.adrift_m
        return self.p.misfit_m if self._misfit else 0.0

    def _publish_particles(self, cycle: Cycle) -> None:
        """Publish some particles: the same again while the robot stands."""
        changes = self._filter.changes
        if self._shown is not None and self._shown[0] == changes:
            said = replace(self._shown[1], cycle=cycle)
        else:
            said = particles.message_of(cycle, self._filter.drawn(particles.MOST).tolist())
        self._shown = changes, said
        self.publish(said)

    def _judge(self, found: Estimate) -> None:
        """Decide by the particles alone whether the robot is lost: they spread, or leap.

        Where little that the sensors see is on the map the particles spread as the odometry does,
        and converge again where the map goes on. An estimate that leaps is of another place.
        """
        p, belief, share, width = self.p, self._belief, found.share, found.deviation_m
        leaps = self._at is not None and apart(found.pose, self._at)
        self._at = found.pose
        if isinstance(belief, Lost):
            fits = width < p.misfit_m and found.fit >= p.fits
            converged = belief.spread and share >= p.found and fits
            self._belief = replaced(belief, converged=converged)
            if converged and not self._sees:
                self._find(found.pose, proofs=0)  # it was followed all along
            return
        doubtful = share < p.lost or width > p.lost_m
        since = (belief.since or self.now) if doubtful else None
        self._belief = replaced(belief, since=since)
        waited = since is not None and self.now - since >= p.lost_s
        if leaps or waited:
            self._lose(
                f"at best at {_place(found.pose)}, with {100 * share:.0f} % of the weight,"
                f" +-{width:.2f} m; the readings fit by {found.fit:.2f}",
                spread=not leaps,
            )

    def _seek(self) -> None:
        """Search the whole map where there is reason to, a piece of it in each cycle."""
        if self._search is None:
            self._search = self._begin_search()
        if self._search is None or not self._search.advance():
            return
        search, self._search = self._search, None
        belief = self._belief
        if isinstance(belief, Lost) or belief.unproved:
            self._locate(search)
        elif self._at is not None:
            self._check(search, belief, self._at)

    def _begin_search(self) -> Search | None:
        """A search: of a lost robot, or of one whose readings fit badly, by its newest readings."""
        particles, history, belief = self._filter, self._filter.history, self._belief
        if isinstance(belief, Lost) or belief.unproved:
            if history.steps < self._confirm.looks_after:
                return None
            history.mark()
            return particles.search()
        if not belief.doubted and particles.fit >= self.p.fits:
            self._trust()
            return None
        new, waited = history.news - self._searched, self.now - self._searched_at
        if new < self.p.doubted_after and not (new > 0 and waited >= AGAIN_S):
            return None
        self._searched, self._searched_at = history.news, self.now
        return particles.search(min(history.news, particles.settings.search.doubted))

    def _trust(self) -> None:
        """The readings until now are of this place."""
        self._filter.history.mark(UNDOUBTED)
        self._searched = self._filter.history.news

    def _check(self, search: Search, belief: Localized, here: Pose2) -> None:
        """Whether the robot was moved elsewhere: doubt, or a verdict, or neither."""
        p, confirm = self.p, self._confirm
        other = search.alternative(here, self._filter.settings.trust)
        if other is None:
            self._belief = replaced(belief, doubted=False, verdicts=0)
            self._trust()
            return
        doubted = self._better(other)
        verdicts = 0 if other.throughout < p.doubts else belief.verdicts
        self._belief = belief = replaced(belief, doubted=doubted, verdicts=verdicts)
        if not doubted:
            if other.throughout < -p.stays:
                self._trust()
            return
        if other.odds < confirm.odds or other.fit < confirm.fit:
            return
        clear = other.odds >= confirm.clear_odds and other.fit >= confirm.clear_fit
        again = verdicts if clear or not apart(other.pose, self._elsewhere) else 0
        verdicts = again + (confirm.clear if clear else 1)
        self._belief, self._elsewhere = replaced(belief, verdicts=verdicts), other.pose
        if verdicts >= confirm.verdicts:
            self._filter.history.forget(other.readings)
            self._lose(
                f"not at {_place(here)}, where the readings fit by {other.stay_fit:.2f}:"
                f" they fit by {other.fit:.2f} at {_place(other.pose)}"
            )
            self._stayed = here

    def _better(self, other: Alternative) -> bool:
        """Whether another place explains the readings, and this one does not.

        Where this one fits well it is not so: what is on no map, and walls that reflect nothing,
        let other places fit a little better all along the way, which adds up to any odds.
        """
        return (
            other.odds >= self.p.doubts
            and other.stay_fit < self.p.fits
            and other.fit >= self._confirm.better * other.stay_fit
        )

    def _lose(self, why: str, *, spread: bool = False) -> None:
        self._belief = Lost(spread, doubted=self._belief.doubted)
        self._search = self._stayed = None
        self.log(f"the robot is lost: {why}", WARNING)

    def _find(self, pose: Pose2, proofs: int) -> None:
        self._belief, self._searched = Localized(proofs), 0
        if not proofs or (self._stayed is not None and apart(pose, self._stayed)):
            self._stayed = None
        self._search, self._at = None, pose
        self.log(f"the robot is found: at {_place(pose)}")

    def _locate(self, search: Search) -> None:
        """Accept a place on the whole map for a lost robot, or confirm the one accepted last.

        One place has to be much better than all others, several times in a row while the robot goes
        on: a wrong place is worse than a late one.
        """
        if not (places := search.places):
            return
        best, belief = self._staying(search) or places[0], self._belief
        if isinstance(belief, Lost) and not belief.spread:
            self._filter.gather(search)  # for the next search, and for what relocate compares
        sure = best.share >= self.p.found and best.fit >= self._confirm.found_fit
        if isinstance(belief, Localized):
            if self._at is None or not apart(best.pose, self._at):
                unproved = belief.unproved - (best.share >= self.p.found)
                self._belief = replaced(belief, unproved=unproved)
                self._stayed = self._stayed if unproved else None
            elif sure:
                self._lose(f"the readings since it was found fit better at {_place(best.pose)}")
            return
        again = belief.sure if not apart(best.pose, self._best) else 0
        times, self._best = (again + 1 if sure else 0), best.pose
        self._belief = replaced(belief, sure=times)
        # Particles that have spread mostly still hold the true pose: leaving them takes more. They
        # converge also where scans of what is not on the map fit by chance: a search has to agree.
        needed = self.p.found_times * (2 if belief.spread else 1)
        if belief.converged and self._at is not None and not apart(best.pose, self._at):
            needed = 1
        if times >= needed:
            if belief.spread:
                self._filter.gather(search)
            elif best.pose == self._stayed:  # which the search itself may not have among its best
                self._filter.start_at(best.pose, self.p.start_m, self.p.start_rad)
            self._find(best.pose, self.p.proved_times)

    def _staying(self, search: Search) -> Place | None:
        """Where the robot is if it was not moved; None if it is likelier elsewhere."""
        if self._stayed is None:
            return None
        place = search.staying(self._stayed, STAYED)
        if place is None or place.share < 0.5 or place.fit < self._confirm.found_fit:
            return None
        if apart(place.pose, self._stayed):
            return None
        self._stayed = place.pose
        return place

    def _watch_fit(self) -> None:
        """Report readings that fit the map badly on average; the robot is slow until they fit."""
        least = self._confirm.misfit
        if isinstance(self._belief, Lost):
            self._fit, self._misfit = USUAL * least, False
            return
        self._fit += self.cycles.period / MISFIT_S * (self._filter.fit - self._fit)
        before, self._misfit = self._misfit, self._fit < least
        if self._misfit and not before:
            self.log(
                f"the readings fit the map badly ({self._fit:.2f} on average): it may be of another"
                " place, or much has changed",
                WARNING,
            )


def _place(pose: Sequence[float]) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"


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
