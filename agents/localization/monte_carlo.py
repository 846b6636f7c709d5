"""Monte Carlo localization (thesis 3.6.3): a particle filter for the pose on a known map.

After Thrun, Burgard and Fox, *Probabilistic Robotics*: the odometry's motion model (5.4), weights
by a model of the sensor (6.4), low-variance resampling (table 4.4) when the effective sample size
has fallen below a half, and as many particles as the spread needs (KLD sampling, table 8.4). A
robot that is lost is looked for apart from the particles: see `global_search`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import exp, hypot, inf, log, sqrt
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.localization import global_search
from armadico.agents.localization.global_search import (
    NEAR_BY,
    History,
    Model,
    Search,
    anywhere,
    logs_of,
    turned_from,
)
from armadico.agents.localization.sonar_model import Poses
from armadico.config.profile import NARROW, Odometry
from armadico.mobile.geometry import Pose2, relative, wrap
from armadico.mobile.messages import Echo

Z_99: Final = 2.326
"""Quantile of the normal distribution: KLD sampling's bound holds with 99 %."""

LEAST_SHARE: Final = 0.005
"""Of the best place's share: places with less get no particles after a search."""

CLUSTER_M, CLUSTER_RAD = 0.6, 0.5
"""Particles within this of a pose are at one place with it."""

SETTLED: Final = 1e-5
"""A cluster mean that moves by less than this, m and rad, is the same: a float32's noise."""

IN_WALL: Final = log(0.1)
"""Log-likelihood of a particle whose body would be in a wall, each time that it is weighed: a wall
that reflects nothing would let particles drift through. Not impossible, for maps are off by some
centimetres."""

TURN_NOISE, DRIFT_NOISE, WAY_NOISE = 1.5, 0.5, 0.8
"""Random part of the odometry's errors, in shares of `Odometry`'s: of a turn, of the heading over
the square root of a metre, and of a way over that."""

UNMAPPED: Final = (0.1, 0.95)
"""Least and greatest share of a laser's rays that may end at something that is not on the map."""

MAPPED_HITS: Final = 0.6
"""Mean hit of a laser's rays, 0 to 1, where the map is complete: from real logs on maps made from
themselves (Intel laboratory, Freiburg building 079)."""

UNMAPPED_GAIN: Final = 0.1
"""Weight of the newest scan in the running estimate of that share: a fast turn, during which few
particles fit, must not pass for a place that is on no map."""

FitsIn = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


class Settings(Struct, frozen=True):
    """Numbers of particles, and how much a reading counts."""

    least: int = 2_000  # fewer, and a corridor's far end loses the particles that are right
    most: int = 10_000
    kld_error: float = 0.04  # of the sampled distribution from the true one, in nats
    bin_m: float = 0.25
    bin_rad: float = 0.175
    forgets: float = 0.15  # share by which a particle's wheel errors vary when it is resampled
    moved_m: float = 0.02  # readings are weighed once the robot has come so far,
    moved_rad: float = 0.03  # or turned so far: a robot that stands receives the same again
    trust: float = 0.3  # exponent of an echo's likelihood: neighbouring echoes are not independent,
    doubtful: float = 0.2  # smaller while the robot is lost, so that the particles stay spread
    judged: int = 24  # newest echoes that tell how well the readings fit
    around_m: float = CLUSTER_M  # particles within this of the estimate count in its covariance
    around_rad: float = CLUSTER_RAD
    adaptive: bool = False  # estimate the share of readings that are off the map
    search: global_search.Settings = global_search.Settings()


LASER: Final = Settings(
    trust=0.08,
    doubtful=0.05,
    judged=72,
    around_m=1.5,
    around_rad=1.0,
    adaptive=True,
    search=global_search.LASER,
)
"""A scan is some dozens of rays at once: each of them counts for less."""


class Estimate(Struct, frozen=True):
    """Where the robot is, by the particles.

    Attributes:
        pose: The mean of the largest cluster: m, m, rad.
        covariance: Of x, y and heading, (3, 3), in and around that cluster.
        share: Of the weight that is in it, 0 to 1.
        fit: How well the newest readings fit at the particles: the geometric mean of likelihoods.
    """

    pose: Pose2
    covariance: NDArray[np.float64]
    share: float
    fit: float

    @property
    def deviation_m(self) -> float:
        """Standard deviation of the position, m."""
        return sqrt(max(0.0, float(self.covariance[0, 0] + self.covariance[1, 1])))


class MonteCarlo:
    """The particles. Motion and readings in, an estimate out."""

    def __init__(
        self,
        model: Model,
        free: NDArray[np.float64],
        rng: np.random.Generator,
        settings: Settings = Settings(),  # noqa: B008 - frozen
        odometry: Odometry = NARROW,
        fits_in: FitsIn | None = None,
    ) -> None:
        """No particles yet; see `start_at` and `start_anywhere`.

        Args:
            model: How likely readings are.
            free: Places where the robot may be, (n, 2), m.
            rng: All that is random.
            settings: Sizes and weights.
            odometry: How wrong the wheels' counts may be.
            fits_in: Whether the body fits in at places, by their x and y, m; None: anywhere.
        """
        self._model = model
        self._fits_in = fits_in
        self._free = free.astype(np.float32)
        self._rng = rng
        self.settings = settings
        self.odometry = odometry
        self.poses: Poses = np.zeros((0, 3), dtype=np.float32)
        self.wheels: Poses = np.zeros((0, 3), dtype=np.float32)  # each particle's lasting errors
        self.weights: NDArray[np.float64] = np.zeros(0)
        self.changes = 0  # of the particles: while it stays, so does all that is derived from them
        self._estimated: tuple[int, Pose2, Estimate] | None = None  # after which, about what
        self.lost = False  # set from outside
        self._moved = inf
        self._turned = inf
        self._logs: deque[float] = deque(maxlen=settings.judged)  # of the newest likelihoods
        self._hits = MAPPED_HITS  # running mean of the rays' hits
        self.history = History(settings.search)

    def may_be_at(self, free: NDArray[np.float64]) -> None:
        """Places where the robot may be, (n, 2), m, from now on."""
        self._free = free.astype(np.float32)

    def start_at(self, pose: Pose2, deviation_m: float, deviation_rad: float) -> None:
        """Begin about a pose."""
        settings = self.settings
        wide = deviation_m > 2.0 * settings.bin_m or deviation_rad > 2.0 * settings.bin_rad
        about = np.tile(pose, (settings.most if wide else settings.least, 1))
        self._begin_about(about, deviation_m, deviation_rad)

    def start_anywhere(self) -> None:
        """Begin with no idea of the pose."""
        self._begin(anywhere(self._free, self.settings.most, self._rng))

    def scatter_by(self, deviation_m: float, deviation_rad: float) -> None:
        """The robot made a motion that is not known: spread each particle by so much."""
        about = self.poses[self._drawn(self.settings.most)]
        self._begin_about(about, deviation_m, deviation_rad)

    def _begin_about(self, poses: NDArray[Any], deviation_m: float, deviation_rad: float) -> None:
        spread = np.array([deviation_m, deviation_m, deviation_rad])
        off = self._rng.standard_normal(poses.shape) * spread
        self._begin((poses.astype(np.float64) + off).astype(np.float32))

    def _begin(self, poses: Poses) -> None:
        self.changes += 1
        self.poses = poses
        self.wheels = self._uncalibrated(len(poses))
        self.weights = np.full(len(poses), 1.0 / len(poses))
        self.history.clear()
        self._logs.clear()
        self._hits = MAPPED_HITS
        self._moved = self._turned = inf

    def _uncalibrated(self, n: int, share: float = 1.0) -> Poses:
        """Draws of the lasting drift (rad/m), turning error and way error, (n, 3)."""
        o = self.odometry
        spread = np.asarray((o.alpha2, o.alpha1, o.alpha3), dtype=np.float32)
        return self._rng.standard_normal((n, 3), dtype=np.float32) * np.float32(share) * spread

    def move(self, motion: Pose2) -> None:
        """The robot moved so by its odometry, in its own frame: m, m, rad."""
        dx, dy, turn = motion
        way = hypot(dx, dy)
        self._moved += way
        self._turned += abs(turn)
        self.history.move(motion)
        if not way and not turn:
            return
        self.changes += 1
        n, o, root = len(self.poses), self.odometry, sqrt(way)
        noise = self._rng.standard_normal((3, n), dtype=np.float32)
        wander = hypot(DRIFT_NOISE * o.alpha2 * root, TURN_NOISE * o.alpha1 * turn)
        slip = hypot(WAY_NOISE * o.alpha3 * root, o.alpha4 * turn)
        drift, turns, ways = self.wheels.T
        turned = np.float32(turn) * (1.0 + turns) + np.float32(dx) * drift
        turned += np.float32(wander) * noise[0]
        # The motion ends where the counted arc ends; what was not counted bends its chord.
        theta = self.poses[:, 2] + np.float32(0.5) * (turned - np.float32(turn))
        along = np.float32(dx) * (1.0 + ways) + np.float32(slip) * noise[1]
        aside = np.float32(dy) + np.float32(0.3 * slip) * noise[2]
        c, s = np.cos(theta), np.sin(theta)
        self.poses[:, 0] += c * along - s * aside
        self.poses[:, 1] += s * along + c * aside
        self.poses[:, 2] += turned

    @property
    def due(self) -> bool:
        """Whether the robot has moved enough to weigh readings."""
        return self._moved >= self.settings.moved_m or self._turned >= self.settings.moved_rad

    def weigh(self, echoes: Sequence[Echo]) -> None:
        """Weigh the particles by readings; resample if few particles carry the weight."""
        if not echoes or not len(self.poses):
            return
        self._moved = self._turned = 0.0
        self.changes += 1
        self.history.add(echoes)
        likelihood = self._model.likelihood(self.poses, echoes)
        self._logs.extend((self.weights @ logs_of(likelihood)).tolist())
        if self.settings.adaptive and not self.lost:
            likelihood = self._without_unmapped(likelihood)
        trust = self.settings.doubtful if self.lost else self.settings.trust
        logs = trust * np.einsum("ij->i", np.log(likelihood), dtype=np.float64)  # faster than sum
        if self._fits_in is not None:
            x, y = self.poses[:, :2].T.astype(np.float64)
            logs[~self._fits_in(x, y)] += IN_WALL
        self.weights = self._weighed(logs)
        if 1.0 / float(self.weights @ self.weights) < 0.5 * len(self.poses):
            self._resample()

    def _weighed(self, logs: NDArray[np.float64]) -> NDArray[np.float64]:
        """The weights times these likelihoods, normalised."""
        weights = self.weights * np.exp(logs - logs.max())
        normalised: NDArray[np.float64] = weights / weights.sum()
        return normalised

    def _without_unmapped(self, likelihood: NDArray[np.float32]) -> NDArray[np.float32]:
        """The likelihoods with a random share as large as the share of rays that are off the map.

        Where furniture, people or whole rooms are not on the map, few rays hit it even at the right
        pose, and a fixed share of random readings pulls the particles to wherever walls happen to
        fit. The share is estimated from the hits at the particles that fit best.
        """
        random = np.float32(UNMAPPED[0])
        hits = (likelihood - random) / (np.float32(1.0) - random)
        logs = self.settings.trust * np.log(likelihood).sum(axis=1, dtype=np.float64)
        seen = float(self._weighed(logs) @ hits.mean(axis=1))
        self._hits += UNMAPPED_GAIN * (seen - self._hits)
        share = np.float32(self.unmapped)
        softer: NDArray[np.float32] = (np.float32(1.0) - share) * hits + share
        return softer

    @property
    def unmapped(self) -> float:
        """Estimated share of a laser's rays that end at something that is not on the map."""
        least, most = UNMAPPED
        return min(max(1.0 - self._hits / MAPPED_HITS, least), most)

    @property
    def fit(self) -> float:
        """The geometric mean of the newest readings' likelihoods where the particles are."""
        return exp(sum(self._logs) / len(self._logs)) if self._logs else 1.0

    @property
    def learnt(self) -> tuple[float, float, float]:
        """The wheels' lasting errors: of a turn (rad/rad), by driving (rad/m), of a way (m/m)."""
        drift, turning, way = (self.weights @ self.wheels).tolist()
        return turning, drift, way

    def search(self, most: int | None = None) -> Search:
        """A search of the whole map by the newest `most` readings, or by all."""
        drawn = self._drawn(self.settings.search.tries)
        return Search(
            self._model,
            self._free,
            self.odometry,
            self.settings.search,
            self.history.stretch(most),
            np.column_stack([self.poses[drawn], self.wheels[drawn]]),
            self._rng,
        )

    def gather(self, search: Search) -> None:
        """Put the particles where a search has found that the robot may be."""
        places = search.places
        if not places:
            return
        self.changes += 1
        shares = np.array([place.share for place in places])
        counts = shares > LEAST_SHARE * shares.max()
        guesses, shares = search.guesses[counts], shares[counts]
        each = max(1, min(self.settings.most // len(guesses), self.settings.least))
        guesses = np.repeat(guesses, each, axis=0)
        noise = self._rng.standard_normal((len(guesses), 3), dtype=np.float32)
        self.poses = guesses[:, :3] + noise * (np.float32(0.3) * NEAR_BY)
        self.wheels = self._uncalibrated(len(guesses), 0.5)
        self.wheels += guesses[:, 3:]
        self.weights = np.repeat(shares / (each * shares.sum()), each)
        self._hits = MAPPED_HITS

    def _resample(self) -> None:
        """Low variance, as many as KLD sampling asks for."""
        n, forgets = self._needed(), np.float32(self.settings.forgets)
        drawn = self._drawn(n)
        self.poses, self.weights = self.poses.take(drawn, axis=0), np.full(n, 1.0 / n)
        # Shrunk by as much as the noise widens it, a guess stays as wide as it is (Liu and West).
        keep = np.sqrt(1.0 - forgets**2)
        self.wheels = keep * self.wheels.take(drawn, axis=0) + self._uncalibrated(n, float(forgets))

    def _drawn(self, n: int) -> NDArray[np.intp]:
        """So many of them by low variance (table 4.4)."""
        return self._by_weight(n, self._rng.random())

    def _by_weight(self, n: int, first: float) -> NDArray[np.intp]:
        """So many particles at even steps of the weight, the first one at this share of a step."""
        total = np.cumsum(self.weights)
        at = (first + np.arange(n)) * (total[-1] / n)
        drawn: NDArray[np.intp] = np.minimum(np.searchsorted(total, at), len(total) - 1)
        return drawn

    def _needed(self) -> int:
        """How many particles the spread needs: the bins that hold weight, by table 8.4's bound."""
        settings = self.settings
        keys = self._bins(settings.bin_m, settings.bin_rad)
        order = np.argsort(-self.weights)
        held = order[: np.searchsorted(np.cumsum(self.weights[order]), 0.99) + 1]
        k = len(np.unique(keys[held]))
        if k < 2:
            return settings.least
        a = 2.0 / (9.0 * (k - 1))
        needed = (k - 1) / (2.0 * settings.kld_error) * (1.0 - a + sqrt(a) * Z_99) ** 3
        return int(min(max(needed, settings.least), settings.most))

    def _bins(self, size_m: float, size_rad: float) -> NDArray[np.float64]:
        """A number for the bin that each particle is in."""
        bins = np.floor(self.poses / (size_m, size_m, size_rad))
        keys: NDArray[np.float64] = bins @ (1.0, 4096.0, 4096.0 * 4096.0)
        return keys

    def drawn(self, most: int) -> NDArray[np.float64]:
        """At most so many of the particles, (n, 3), by their weight: m, m, rad.

        By low variance, and without a random number: to look changes nothing.
        """
        n = min(most, len(self.poses))
        return self.poses[self._by_weight(n, 0.5) if n else []].astype(np.float64)

    def scatter(self) -> NDArray[np.float64]:
        """Covariance of all the particles about their mean, (3, 3)."""
        off = self.poses.astype(np.float64)
        off[:, 2] = turned_from(off[:, 2], _heading(off[:, 2], self.weights))
        off[:, :2] -= self.weights @ off[:, :2]
        covariance: NDArray[np.float64] = (off * self.weights[:, None]).T @ off
        return covariance

    def _heaviest(self) -> Pose2:
        """The mean of the bin that holds most weight."""
        _, where = np.unique(self._bins(0.5, 0.35), return_inverse=True)
        chosen = where == np.bincount(where, weights=self.weights).argmax()
        poses, weights = self.poses[chosen].astype(np.float64), self.weights[chosen]
        x, y = (weights @ poses[:, :2]) / weights.sum()
        return float(x), float(y), _heading(poses[:, 2], weights)

    def estimate(self, about: Pose2 | None = None) -> Estimate:
        """The mean of a cluster: the particles within `CLUSTER_M` and `CLUSTER_RAD` of a pose.

        By default of the heaviest bin's; to follow one place, give the estimate before. While the
        robot stands that is the same again, once it has settled. The covariance is that of all
        particles within `around_m`: a cluster that is cut out of a wide cloud is no narrow one.
        """
        if about is not None and self._estimated is not None:
            changes, before, found = self._estimated
            if changes == self.changes and max(map(abs, relative(before, about))) < SETTLED:
                return found
        x, y, theta = self._heaviest() if about is None else about
        turned = turned_from(self.poses[:, 2], theta)
        off = np.column_stack([self.poses[:, 0] - x, self.poses[:, 1] - y, turned])
        far = np.hypot(off[:, 0], off[:, 1])
        near = (far < CLUSTER_M) & (np.abs(turned) < CLUSTER_RAD)
        share = float(self.weights[near].sum())
        if share < 1e-6:
            return self.estimate()
        mean = self.weights[near] @ off[near] / share
        around = (far < self.settings.around_m) & (np.abs(turned) < self.settings.around_rad)
        off, w = off[around] - mean, self.weights[around]
        covariance = (off * (w / w.sum())[:, None]).T @ off
        pose = (float(x + mean[0]), float(y + mean[1]), wrap(theta + float(mean[2])))
        found = Estimate(pose, covariance, share, self.fit)
        self._estimated = None if about is None else (self.changes, about, found)
        return found


def _heading(theta: NDArray[np.floating], weights: NDArray[np.float64]) -> float:
    """The weighted mean of headings, rad."""
    return float(np.arctan2(weights @ np.sin(theta), weights @ np.cos(theta)))
