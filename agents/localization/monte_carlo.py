"""Monte Carlo localization (thesis 3.6.3): a particle filter for the pose on a known map.

After Thrun, Burgard and Fox, *Probabilistic Robotics*: the odometry motion model (5.4), weights by
a measurement model (6.4), low-variance resampling (table 4.4) when the effective sample size falls
below a half, and KLD sampling (table 8.4) for the number of particles. A lost robot is searched for
apart from the particles: see `global_search`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import exp, hypot, inf, log, sqrt
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.localization import global_search
from armadico.agents.localization.bound import Bound, information
from armadico.agents.localization.global_search import (
    NEAR_BY,
    History,
    Model,
    Search,
    log_likelihoods,
    uniform_poses,
)
from armadico.agents.localization.sonar_model import Poses
from armadico.agents.methods.poses import wrapped
from armadico.config.profile import NARROW, Odometry
from armadico.mobile.geometry import STOOD, Pose2, relative, wrap
from armadico.mobile.messages import Echo

Z_99: Final = 2.326
"""Quantile of the normal distribution: the KLD bound holds with probability 0.99."""

LEAST_SHARE: Final = 0.005
"""Places with a smaller share, relative to the best place's, get no particles after a search."""

CLUSTER_M, CLUSTER_RAD = 0.6, 0.5
"""Particles within both of a pose belong to its cluster."""

SETTLED: Final = 1e-5
"""A cluster mean that moves by less than this, m and rad, has settled: float32 noise."""

IN_WALL: Final = log(0.1)
"""Log-likelihood, per weighing, of a particle whose footprint would be in a wall. A wall that
reflects nothing would otherwise let particles drift through. Not impossible: maps are off by some
centimetres."""

TURN_NOISE, DRIFT_NOISE, WAY_NOISE = 1.5, 0.5, 0.8
"""Random part of the odometry errors, relative to `Odometry`'s values: of a turn, of the heading
per square root of a metre, and of a distance per square root of a metre."""

UNMAPPED: Final = (0.1, 0.95)
"""Least and greatest share of a laser's rays that end at unmapped objects."""

MAPPED_HITS: Final = 0.6
"""Mean hit of a laser's rays, 0 to 1, on a complete map: from real logs on maps made from the same
logs (Intel laboratory, Freiburg building 079)."""

UNSEEN, PARTLY = 0.12, 0.3
"""Mean hit of a laser's rays up to which they count nothing, and from which they count fully. Off
the map a few rays end at its walls by chance, which must not draw the particles there."""

UNMAPPED_GAIN: Final = 0.1
"""Weight of the newest scan in the running estimate of that share. During a fast turn few particles
fit, which must not count as an unmapped place."""

REFUTED, REFUTED_MOST = 0.6, 1.8
"""Evidence against the particles' place, in nats, beyond which the readings contradict it, and the
most that is accumulated: echoes that fit then take a few cycles to outweigh it. This and `chance`
were chosen on drives with and without a lift, in sc4 and on four small maps: 0.6 was exceeded in
0 to 1 % of a drive without a lift, in 7 % past an unmapped partition of 1 m."""

FitsIn = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


class Settings(Struct, frozen=True):
    """Numbers of particles, and the weight of a reading."""

    least: int = 2_000  # fewer lose the right particles at the far end of a corridor
    most: int = 10_000
    kld_error: float = 0.04  # of the sampled distribution from the true one, in nats
    bin_m: float = 0.25
    bin_rad: float = 0.175
    forgets: float = 0.15  # share by which resampling varies a particle's wheel errors
    moved_m: float = 0.02  # readings are weighed after this distance
    moved_rad: float = 0.03  # readings are weighed after this turn: at rest they repeat
    trust: float = 0.3  # exponent of an echo's likelihood: neighbouring echoes are not independent
    told: float = 0.1  # that exponent in the bound: echoes of one wall are wrong together
    chance: float = 0.22  # echoes that fit worse than this are evidence against the place
    certain: float = REFUTED_MOST  # evidence that needs no other place to be believed
    doubtful: float = 0.2  # that exponent while the robot is lost: the particles stay spread
    judged: int = 24  # newest echoes over which the fit is averaged
    around_m: float = 1.5  # particles within this of the estimate count in its covariance
    around_rad: float = 1.0
    adaptive: bool = False  # estimate the share of readings from unmapped objects
    leaves: bool = False  # the robot may leave its map, and scans tell its motion there
    search: global_search.Settings = global_search.Settings()


LASER: Final = Settings(
    trust=0.08,
    told=0.08,
    chance=0.3,
    certain=inf,
    doubtful=0.05,
    judged=72,
    adaptive=True,
    search=global_search.LASER,
)
"""A scan has dozens of rays at once, so each ray counts for less."""


class Estimate(Struct, frozen=True):
    """The pose estimate of the particles."""

    pose: Pose2  # the mean of the largest cluster: m, m, rad
    covariance: NDArray[np.float64]  # of x, y and heading, (3, 3), in and around that cluster
    share: float  # share of the weight in the cluster, 0 to 1
    fit: float  # the geometric mean of the newest readings' likelihoods at the particles

    @property
    def axes_m(self) -> tuple[float, float]:
        """Standard deviations along the short and the long axis of the position, m."""
        short, long = np.linalg.eigvalsh(self.covariance[:2, :2]).tolist()
        return sqrt(max(0.0, short)), sqrt(max(0.0, long))

    @property
    def deviation_m(self) -> float:
        return hypot(*self.axes_m)


class MonteCarlo:
    """A particle filter: motions and readings in, an estimate out."""

    def __init__(
        self,
        model: Model,
        free: NDArray[np.float64],
        rng: np.random.Generator,
        settings: Settings = Settings(),  # noqa: B008 - frozen
        odometry: Odometry = NARROW,
        fits_in: FitsIn | None = None,
    ) -> None:
        """Prepare without particles; see `start_at` and `start_anywhere`.

        Args:
            model: The measurement model.
            free: Where the robot may be, (n, 2), m.
            rng: Random numbers.
            settings: Sizes and weights.
            odometry: Standard deviations of the wheel errors.
            fits_in: Whether the footprint is free at positions x, y (m); None: everywhere.
        """
        self._model = model
        self._fits_in = fits_in
        self._free = free.astype(np.float32)
        self._rng = rng
        self.settings = settings
        self.odometry = odometry
        self.poses: Poses = np.zeros((0, 3), dtype=np.float32)
        self.wheels: Poses = np.zeros((0, 3), dtype=np.float32)  # systematic errors per particle
        self.weights: NDArray[np.float64] = np.zeros(0)
        self.changes = 0  # of the particles: while it stays equal, so do all values derived
        self._estimated: tuple[int, Pose2, Estimate] | None = None  # at which change, about what
        self.refuted = self.disproved = False  # by the newest echoes
        self.lost = False  # set by the localization agent
        self._moved = inf
        self._turned = inf
        self._logs: deque[float] = deque(maxlen=settings.judged)  # of the newest likelihoods
        self._weigh_against(0.0)
        # Running mean hit of a laser's rays on the map, 0 to 1, at the particles that fit best.
        self.hits = MAPPED_HITS
        self.history = History(settings.search)
        self.bound = Bound(odometry)  # of the estimate's covariance

    def may_be_at(self, free: NDArray[np.float64]) -> None:
        """Set where the robot may be, (n, 2), m."""
        self._free = free.astype(np.float32)

    def start_at(self, pose: Pose2, deviation_m: float, deviation_rad: float) -> None:
        settings = self.settings
        wide = deviation_m > 2.0 * settings.bin_m or deviation_rad > 2.0 * settings.bin_rad
        about = np.tile(pose, (settings.most if wide else settings.least, 1))
        self._begin_about(about, deviation_m, deviation_rad)
        self.bound.begin(deviation_m, deviation_rad)

    def start_anywhere(self) -> None:
        """Start with particles in all free places."""
        self._begin(uniform_poses(self._free, self.settings.most, self._rng))

    def scatter_by(self, deviation_m: float, deviation_rad: float) -> None:
        """Spread each particle by the standard deviations of an unknown motion."""
        about = self.poses[self._drawn(self.settings.most)]
        self._begin_about(about, deviation_m, deviation_rad)
        self.bound.widen(deviation_m, deviation_rad)

    def _begin_about(self, poses: Poses, deviation_m: float, deviation_rad: float) -> None:
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
        self._weigh_against(0.0)
        self.hits = MAPPED_HITS
        self._moved = self._turned = inf

    def _uncalibrated(self, n: int, share: float = 1.0) -> Poses:
        """Samples of the systematic drift (rad/m), turning and distance errors, (n, 3)."""
        o = self.odometry
        spread = np.asarray((o.alpha2, o.alpha1, o.alpha3), dtype=np.float32)
        return self._rng.standard_normal((n, 3), dtype=np.float32) * np.float32(share) * spread

    def move(self, motion: Pose2) -> None:
        """Move the particles by the odometry, in the robot's frame: m, m, rad."""
        dx, dy, turn = motion
        way = hypot(dx, dy)
        self._moved += way
        self._turned += abs(turn)
        self.history.move(motion)
        if not way and not turn:
            return
        self.bound.move(motion)
        self.changes += 1
        n, o, root = len(self.poses), self.odometry, sqrt(way)
        noise = self._rng.standard_normal((3, n), dtype=np.float32)
        wander = hypot(DRIFT_NOISE * o.alpha2 * root, TURN_NOISE * o.alpha1 * turn)
        slip = hypot(WAY_NOISE * o.alpha3 * root, o.alpha4 * turn)
        drift, turns, ways = self.wheels.T
        turned = np.float32(turn) * (1.0 + turns) + np.float32(dx) * drift
        turned += np.float32(wander) * noise[0]
        # The motion ends where the counted arc ends. The uncounted turn bends its chord by half.
        theta = self.poses[:, 2] + np.float32(0.5) * (turned - np.float32(turn))
        along = np.float32(dx) * (1.0 + ways) + np.float32(slip) * noise[1]
        aside = np.float32(dy) + np.float32(0.3 * slip) * noise[2]
        c, s = np.cos(theta), np.sin(theta)
        self.poses[:, 0] += c * along - s * aside
        self.poses[:, 1] += s * along + c * aside
        self.poses[:, 2] += turned

    def spread(
        self,
        covariance: NDArray[np.float64] | None,
        share: float = 1.0,
        moved: Pose2 = STOOD,
    ) -> None:
        """Add the random errors of a motion to a share of the particles.

        The covariance is (3, 3) in the robot's frame; None: no errors. If the share is not 1, the
        bound stays as it is, and `moved` is a motion of this share, in the robot's frame, m, m,
        rad.
        """
        if covariance is None or not len(self.poses):
            return
        self.changes += 1
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = self._rng.standard_normal(self.poses.shape, dtype=np.float32)
        off = normal @ root.T.astype(np.float32) + np.array(moved, dtype=np.float32)
        if share < 1.0:
            off[self._rng.random(len(off)) >= share] = 0.0
        c, s = np.cos(self.poses[:, 2]), np.sin(self.poses[:, 2])
        self.poses[:, 0] += c * off[:, 0] - s * off[:, 1]
        self.poses[:, 1] += s * off[:, 0] + c * off[:, 1]
        self.poses[:, 2] += off[:, 2]
        if share == 1.0:
            self.bound.add(covariance)

    @property
    def due(self) -> bool:
        """Whether the robot has moved enough to weigh readings."""
        return self._moved >= self.settings.moved_m or self._turned >= self.settings.moved_rad

    def require_proof(self, deviation_m: float, deviation_rad: float) -> None:
        """Start the bound, and the evidence, of a place that has just been found."""
        self.bound.begin(deviation_m, deviation_rad)
        self._weigh_against(REFUTED)

    def _weigh_against(self, evidence: float) -> None:
        """Set the evidence against the place, nats, and what follows: Page's test (CUSUM).

        It compares the readings' likelihoods with those at a wrong place, so it tells that a robot
        was lifted, or that its wheels slipped, before a search has found where it is. `refuted` and
        `disproved` (beyond doubt) hold until echoes have outweighed all of it: no flicker.
        """
        self._against = evidence = min(max(evidence, 0.0), REFUTED_MOST)
        held = evidence > 0.0
        self.refuted = held and (self.refuted or evidence > REFUTED)
        self.disproved = held and (self.disproved or evidence >= self.settings.certain)

    def weigh(self, echoes: Sequence[Echo]) -> None:
        """Weigh the particles by readings; resample if few particles hold the weight."""
        if not echoes or not len(self.poses):
            return
        self._moved = self._turned = 0.0
        self.changes += 1
        self.history.add(echoes)
        likelihood = self._model.likelihood(self.poses, echoes)
        logs = self.weights @ log_likelihoods(likelihood)
        self._logs.extend(logs.tolist())
        heard = [echo.range is not None for echo in echoes]  # silence fits almost anywhere
        against = self.settings.trust * float((log(self.settings.chance) - logs[heard]).sum())
        self._weigh_against(self._against + against)
        if self.settings.adaptive and not self.lost:
            likelihood = self._without_unmapped(likelihood)
        trust = self.settings.doubtful if self.lost else self.settings.trust
        if self.settings.leaves and not self.lost:
            trust *= min(1.0, max(0.0, (self.hits - UNSEEN) / (PARTLY - UNSEEN)))
        logs = trust * np.einsum("ij->i", np.log(likelihood), dtype=np.float64)  # faster than sum
        if self._fits_in is not None:
            x, y = self.poses[:, :2].T.astype(np.float64)
            logs[~self._fits_in(x, y)] += IN_WALL
        self._reweigh(logs)

    def weigh_heading(self, heading: float, deviation: float) -> None:
        """Weigh the particles by a heading that was measured, with its deviation, rad."""
        self.changes += 1
        off = wrapped(self.poses[:, 2] - heading).astype(np.float64)
        self.bound.see(np.diag([0.0, 0.0, deviation**-2]))
        self._reweigh(-0.5 * (off / deviation) ** 2)

    def tell(self, pose: Pose2, echoes: Sequence[Echo]) -> None:
        """Narrow the bound by what readings tell at a pose."""
        self.bound.see(information(self._model, pose, echoes, self.settings.told))

    def _reweigh(self, logs: NDArray[np.float64]) -> None:
        """Multiply the weights by these likelihoods; resample if few particles hold the weight."""
        self.weights = self._weighed(logs)
        if 1.0 / float(self.weights @ self.weights) < 0.5 * len(self.poses):
            self._resample()

    def _weighed(self, logs: NDArray[np.float64]) -> NDArray[np.float64]:
        """The weights times these likelihoods, normalized."""
        weights = self.weights * np.exp(logs - logs.max())
        normalised: NDArray[np.float64] = weights / weights.sum()
        return normalised

    def _without_unmapped(self, likelihood: NDArray[np.float32]) -> NDArray[np.float32]:
        """The likelihoods with a random share equal to the share of rays from unmapped objects.

        Where furniture, people or whole rooms are not on the map, few rays hit it even at the right
        pose. A fixed random share then pulls the particles to where walls happen to fit. The share
        is estimated from the hits at the particles that fit best.
        """
        random = np.float32(UNMAPPED[0])
        hits = (likelihood - random) / (np.float32(1.0) - random)
        logs = self.settings.trust * np.log(likelihood).sum(axis=1, dtype=np.float64)
        seen = float(self._weighed(logs) @ hits.mean(axis=1))
        self.hits += UNMAPPED_GAIN * (seen - self.hits)
        share = np.float32(self.unmapped)
        softer: NDArray[np.float32] = (np.float32(1.0) - share) * hits + share
        return softer

    @property
    def unmapped(self) -> float:
        """Estimated share of a laser's rays that end at unmapped objects."""
        least, most = UNMAPPED
        return min(max(1.0 - self.hits / MAPPED_HITS, least), most)

    @property
    def fit(self) -> float:
        """The geometric mean of the newest readings' likelihoods at the particles."""
        return exp(sum(self._logs) / len(self._logs)) if self._logs else 1.0

    @property
    def supported(self) -> bool:
        """Whether echoes have outweighed all evidence against the place."""
        return self._against <= 0.0

    @property
    def wheel_errors(self) -> tuple[float, float, float]:
        """The systematic wheel errors: turn (rad/rad), drift (rad/m), distance (m/m)."""
        drift, turning, way = (self.weights @ self.wheels).tolist()
        return turning, drift, way

    @property
    def wheel_deviations(self) -> tuple[float, float, float]:
        """The standard deviations of these three among the particles."""
        off = self.wheels - self.weights @ self.wheels
        drift, turning, way = np.sqrt(self.weights @ (off * off)).tolist()
        return turning, drift, way

    def search(self, most: int | None = None) -> Search:
        """A search of the whole map by the newest `most` readings (None: all)."""
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
        """Place the particles where a search has found that the robot may be."""
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
        self.hits = MAPPED_HITS

    def _resample(self) -> None:
        """Resample with low variance; the number of particles is that of KLD sampling."""
        n, forgets = self._needed(), np.float32(self.settings.forgets)
        drawn = self._drawn(n)
        self.poses, self.weights = self.poses.take(drawn, axis=0), np.full(n, 1.0 / n)
        # Shrinking by as much as the noise widens keeps the variance (Liu and West).
        keep = np.sqrt(1.0 - forgets**2)
        self.wheels = keep * self.wheels.take(drawn, axis=0) + self._uncalibrated(n, float(forgets))

    def _drawn(self, n: int) -> NDArray[np.intp]:
        """Indices of `n` particles, drawn with low variance (table 4.4)."""
        return self._by_weight(n, self._rng.random())

    def _by_weight(self, n: int, first: float) -> NDArray[np.intp]:
        """Indices of `n` particles at even steps of the weight; `first`: a share of a step."""
        total = np.cumsum(self.weights)
        at = (first + np.arange(n)) * (total[-1] / n)
        drawn: NDArray[np.intp] = np.minimum(np.searchsorted(total, at), len(total) - 1)
        return drawn

    def _needed(self) -> int:
        """The number of particles by table 8.4's bound, from the bins that hold the weight."""
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
        """A number for the bin of each particle."""
        bins = np.floor(self.poses / (size_m, size_m, size_rad))
        keys: NDArray[np.float64] = bins @ (1.0, 4096.0, 4096.0 * 4096.0)
        return keys

    def drawn(self, most: int) -> NDArray[np.float64]:
        """At most `most` particles, (n, 3), by their weight: m, m, rad.

        Uses no random number, so that reading them does not change the run.
        """
        n = min(most, len(self.poses))
        return self.poses[self._by_weight(n, 0.5) if n else []].astype(np.float64)

    def scatter(self) -> NDArray[np.float64]:
        """The covariance of all particles about their mean, (3, 3)."""
        off = self.poses.astype(np.float64)
        off[:, 2] = wrapped(off[:, 2] - _heading(off[:, 2], self.weights))
        off[:, :2] -= self.weights @ off[:, :2]
        covariance: NDArray[np.float64] = (off * self.weights[:, None]).T @ off
        return covariance

    def _heaviest(self) -> Pose2:
        """The mean of the bin with most weight."""
        _, where = np.unique(self._bins(0.5, 0.35), return_inverse=True)
        chosen = where == np.bincount(where, weights=self.weights).argmax()
        poses, weights = self.poses[chosen].astype(np.float64), self.weights[chosen]
        x, y = (weights @ poses[:, :2]) / weights.sum()
        return float(x), float(y), _heading(poses[:, 2], weights)

    def estimate(self, about: Pose2 | None = None) -> Estimate:
        """The mean of a cluster: the particles within `CLUSTER_M` and `CLUSTER_RAD` of a pose.

        The default is the heaviest bin's mean; to track one place, pass the last estimate. While
        the robot stands, the result stays the same once it has settled. The covariance is that of
        all particles within `around_m`: a cluster cut out of a wide cloud is not narrow.
        """
        if about is not None and self._estimated is not None:
            changes, before, found = self._estimated
            if changes == self.changes and max(map(abs, relative(before, about))) < SETTLED:
                return found
        x, y, theta = self._heaviest() if about is None else about
        turned = wrapped(self.poses[:, 2] - theta)
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
    return float(np.arctan2(weights @ np.sin(theta), weights @ np.cos(theta)))
