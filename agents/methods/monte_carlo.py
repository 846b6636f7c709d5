"""Monte Carlo localization (thesis 3.6.3): where the robot is on a known map, by many guesses.

After Thrun, Burgard and Fox, *Probabilistic Robotics*: the odometry's motion model (5.4), weights
by a model of the sensor (6.4), low-variance resampling (table 4.4) when the effective sample size
has fallen below a half, and as many particles as the spread needs (KLD sampling, table 8.4). Where
else the robot may be is looked for on the whole map by a stretch of the drive, apart from them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from math import exp, hypot, inf, log, sqrt
from typing import Final, NamedTuple, Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.methods.sonar_model import Poses
from armadico.core.geometry import Pose2, compose, relative, wrap
from armadico.core.messages import Echo

Z_99: Final = 2.326
"""Quantile of the normal distribution: KLD sampling's bound holds with 99 %."""


NEAR_BY: Final = np.array((0.12, 0.12, 0.1), dtype=np.float32)
"""Standard deviations of guesses about one that is worth a closer look: m, m, rad."""


APART_M, APART_RAD = 0.4, 0.4
"""What is nearer to each other is one place."""

GHOST: Final = np.float32(0.1)
"""Least likelihood of an echo in a stretch of the drive: one off several walls is heard again and
again from there, and would outweigh all others."""

PINGS: Final = 16
"""By fewer pings nobody is elsewhere: each sonar twice."""

LEAP_M, LEAP_RAD = 0.5, 0.5
"""Poses that are farther apart are two places."""

LEAST_SHARE: Final = 0.005
"""Of the best place's: where less is believed no guess is put."""

FINER: Final = ((1.0, 60, 5), (0.4, 20, 8), (0.25, 12, 24), (0.12, 12, 40))
"""Rounds in which what fits best is looked for about each place: how far about it, in shares of
`NEAR_BY`, how many places are left then, and how many guesses there are about each."""

FIRST: Final = (4, 8, 16)
"""After so many readings, of all in a random order, the worse two thirds of places are dropped."""

SETTLED: Final = 1e-5
"""A cluster about a place so near to the one before, m and rad, is that one: a float32's noise."""


IN_WALL: Final = log(0.1)
"""Logarithm of how likely a guess is whose body would be in a wall, each time that it is weighed:
a dead wall does not answer, and particles would drift through it. Not impossible, for maps are off
by some centimetres."""

FitsIn = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


class Settings(Struct, frozen=True):
    """What the filter believes of the odometry, and how many particles it takes."""

    least: int = 1_000
    most: int = 10_000
    kld_error: float = 0.04  # of the sampled distribution from the true one, in nats
    bin_m: float = 0.25
    bin_rad: float = 0.175
    turn_per_root_m: float = 0.027  # rad/sqrt(m): the heading wanders with the way,
    turn_per_rad: float = 0.02  # and with turning
    way_per_m: float = 0.04
    drift_rad_m: float = 0.02  # the wheels' own errors, which last: an arc instead of a line,
    turn_error: float = 0.025  # of a turn, and
    way_error: float = 0.015  # of a way: standard deviations, as they are guessed at the start,
    forgets: float = 0.05  # and by what share of that a guess varies when it is drawn again
    moved_m: float = 0.02  # readings are weighed once the robot has come so far,
    moved_rad: float = 0.03  # or turned so far: a robot that stands hears the same again
    trust: float = 0.3  # exponent of a ping's likelihood: neighbouring pings are not independent,
    doubtful: float = 0.2  # less while it is lost: what is alike is told apart by much, or never
    candidates: int = 16_000  # places that are tried when the robot may be elsewhere,
    tries: int = 200  # the best of them that become particles,
    a_cell: float = 0.3  # and at least so many for each free cell of the map,
    most_candidates: int = 64_000  # but not more than this;
    rival: float = 10.0  # a place that fits worse by this has a share that is e times smaller
    remembered: int = 40  # by so many readings of late, and all that was heard with them;
    doubted: int = 16  # by no more than so many, if it is to tell whether the robot is elsewhere
    apart_m: float = 0.15  # each so far from the one before, or turned by so much
    apart_rad: float = 0.2
    whole: bool = False  # a reading tells all around: what is between two that are kept is left out
    judged: int = 24  # newest pings by which it is told how well they fit


LASER: Final = Settings(trust=0.08, doubtful=0.05, rival=20.0, remembered=24, whole=True, judged=72)
"""Of a laser's, whose scan is some dozens of rays at once: each of them counts for less."""


class Model(Protocol):
    """How likely readings are, by a sensor and a map."""

    def likelihood(
        self, poses: Poses, echoes: Sequence[Echo], *, coarse: bool = False
    ) -> NDArray[np.float32]:
        """The likelihood of each reading at each pose, (poses, echoes); 1 is the best there is."""


class Reading(NamedTuple):
    """What was heard while the robot came as far as one reading is from the next."""

    motion: Pose2  # to where it was taken, from where the one before was
    echoes: Sequence[Echo]  # of its cycle,
    more: list[Echo]  # and of those after it, their sonars in the same frame


class Behind(NamedTuple):
    """A reading that was taken on the way here."""

    to: Pose2  # where, from here, by the odometry,
    way: float  # m and
    turn: float  # rad on the way back there
    reading: Reading


class Place(Struct, frozen=True):
    """Where the robot may be, by all that it has heard of late.

    Attributes:
        pose: m, m, rad.
        share: Of all the places that there are, 0 to 1.
        fit: The geometric mean of the echoes' likelihoods there.
    """

    pose: Pose2
    share: float
    fit: float


class Elsewhere(Struct, frozen=True):
    """How much better another place explains what was heard of late, if any does.

    A generalized likelihood ratio: over all other places, and over when the robot was lifted.

    Attributes:
        pose: That place: m, m, rad.
        odds: The logarithm of its likelihood over that of where the particles are, each ping's
            with the power that it has in their weights; by the stretch that speaks for it most,
        readings: which has so many readings,
        fit: and whose echoes have likelihoods of this geometric mean there,
        stay_fit: and of this one where the particles are.
        throughout: The same odds, of the best place by all that was doubted.
    """

    pose: Pose2
    odds: float
    readings: int
    fit: float
    stay_fit: float
    throughout: float


class Estimate(Struct, frozen=True):
    """Where the robot is, by the particles.

    Attributes:
        pose: The mean of the largest cluster: m, m, rad.
        covariance: Of x, y and heading, (3, 3), of that cluster.
        share: Of the weight that is in it, 0 to 1.
        fit: How well the newest pings fit at the particles: the geometric mean of likelihoods.
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
        fits_in: FitsIn | None = None,
    ) -> None:
        """Nowhere yet; see `start_at` and `start_anywhere`.

        Args:
            model: How likely readings are.
            free: Places where the robot may be, (n, 2), m.
            rng: All that is random.
            settings: What is believed of the odometry.
            fits_in: Whether the body fits in at places, by their x and y, m; None: anywhere.
        """
        self._model = model
        self._fits_in = fits_in
        self._free = free.astype(np.float32)
        self._rng = rng
        self.settings = settings
        self.poses: Poses = np.zeros((0, 3), dtype=np.float32)
        self.wheels: Poses = np.zeros((0, 3), dtype=np.float32)  # each guess's drift and errors
        self.weights: NDArray[np.float64] = np.zeros(0)
        self.changes = 0  # of the particles: while it stays, so does all that they say
        self._estimated: tuple[int, Pose2, Estimate] | None = None  # after which, about what
        self.lost = False  # whoever judges that says so
        self._moved = inf
        self._turned = inf
        self._logs: deque[float] = deque(maxlen=settings.judged)  # of the newest pings' likelihoods
        self._since: Pose2 = (0.0, 0.0, 0.0)  # the motion since the last reading that is kept
        self.news = 0  # readings that have been kept since places were looked for
        self._kept: deque[Reading] = deque(maxlen=settings.remembered)

    def may_be_at(self, free: NDArray[np.float64]) -> None:
        """Places where the robot may be, (n, 2), m, from now on."""
        self._free = free.astype(np.float32)

    def start_at(self, pose: Pose2, deviation_m: float, deviation_rad: float) -> None:
        """Begin about a pose."""
        settings = self.settings
        wide = deviation_m > 2.0 * settings.bin_m or deviation_rad > 2.0 * settings.bin_rad
        n = self.settings.most if wide else self.settings.least
        spread = np.array([deviation_m, deviation_m, deviation_rad])
        guesses = np.asarray(pose) + self._rng.standard_normal((n, 3)) * spread
        self._begin(guesses.astype(np.float32))

    def start_anywhere(self) -> None:
        """Begin with no idea of the pose."""
        self._begin(self._anywhere(self.settings.most))

    def scatter_by(self, deviation_m: float, deviation_rad: float) -> None:
        """The robot moved, and nobody knows how: each guess may be so far from where it was."""
        n = self.settings.most
        guesses = self.poses[self._drawn(n)].astype(np.float64)
        spread = np.array([deviation_m, deviation_m, deviation_rad])
        guesses += self._rng.standard_normal((n, 3)) * spread
        self._begin(guesses.astype(np.float32))

    def _begin(self, poses: Poses) -> None:
        self.changes += 1
        self.poses = poses
        self.wheels = self._uncalibrated(len(poses))
        self.weights = np.full(len(poses), 1.0 / len(poses))
        self.forget()  # no motion is known that leads on from there
        self._since = (0.0, 0.0, 0.0)
        self._logs.clear()
        self._moved = self._turned = inf

    def _uncalibrated(self, n: int, share: float = 1.0) -> Poses:
        """Guesses of the drift (rad/m) and of the errors of turns and ways, (n, 3)."""
        settings = self.settings
        spread = (settings.drift_rad_m, settings.turn_error, settings.way_error)
        return (
            self._rng.standard_normal((n, 3), dtype=np.float32)
            * np.float32(share)
            * np.asarray(spread, dtype=np.float32)
        )

    def _anywhere(self, n: int) -> Poses:
        # In order, so that neighbours look up what lies near by: half the time on a large map.
        places = self._free[np.sort(self._rng.integers(len(self._free), size=n))]
        poses = np.empty((n, 3), dtype=np.float32)
        poses[:, :2] = places + self._rng.uniform(-0.05, 0.05, (n, 2))
        poses[:, 2] = self._rng.uniform(-np.pi, np.pi, n)
        return poses

    def move(self, motion: Pose2) -> None:
        """The odometry says that the robot moved so, in its own frame: m, m, rad."""
        dx, dy, turn = motion
        way = hypot(dx, dy)
        self._moved += way
        self._turned += abs(turn)
        self._since = compose(self._since, motion)
        if not way and not turn:
            return
        self.changes += 1
        n, settings = len(self.poses), self.settings
        noise = self._rng.standard_normal((3, n), dtype=np.float32)
        wander = hypot(settings.turn_per_root_m * sqrt(way), settings.turn_per_rad * abs(turn))
        slip = settings.way_per_m * sqrt(way * 0.1)  # drawn anew each 0.1 m of the floor
        drift, turns, ways = self.wheels.T
        turned = np.float32(turn) * (1.0 + turns) + np.float32(dx) * drift
        turned += np.float32(wander) * noise[0]
        # The motion says where an arc ends as it was counted; what was not counted bends its chord.
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
        """Take readings in; resample if few particles carry the weight."""
        if not echoes or not len(self.poses):
            return
        self._moved = self._turned = 0.0
        self.changes += 1
        self._keep(echoes)
        likelihood = self._model.likelihood(self.poses, echoes)
        self._logs.extend((self.weights @ _logs(likelihood)).tolist())
        trust = self.settings.doubtful if self.lost else self.settings.trust
        logs = trust * np.einsum("ij->i", np.log(likelihood), dtype=np.float64)  # faster than sum
        if self._fits_in is not None:
            x, y = self.poses[:, :2].T.astype(np.float64)
            logs[~self._fits_in(x, y)] += IN_WALL
        weights = self.weights * np.exp(logs - logs.max())
        self.weights = weights / weights.sum()
        if 1.0 / float(self.weights @ self.weights) < 0.5 * len(self.poses):
            self._resample()

    def _keep(self, echoes: Sequence[Echo]) -> None:
        """Keep a reading, with the motion that led to it from the one before."""
        x, y, turn = self._since
        far = hypot(x, y) > self.settings.apart_m or abs(turn) > self.settings.apart_rad
        if far or not self._kept:
            self._kept.append(Reading(self._since, echoes, []))
            self._since = (0.0, 0.0, 0.0)
            self.news += 1
            return
        if self.settings.whole:
            return
        self._kept[-1].more.extend(
            Echo(*compose(self._since, (e.x, e.y, e.bearing)), e.range) for e in echoes
        )

    def forget(self, but: int = 0) -> None:
        """What was heard before the newest so many readings was heard elsewhere."""
        while len(self._kept) > but:
            self._kept.popleft()
        self.news = but

    def mark(self, newest: int = 0) -> None:
        """From now on only the newest so many readings are news, and what is heard after them."""
        self.news = min(self.news, newest)

    @property
    def fit(self) -> float:
        """The geometric mean of the newest pings' likelihoods where the particles are."""
        return exp(sum(self._logs) / len(self._logs)) if self._logs else 1.0

    def places(self) -> list[Place]:
        """Where the robot may be by all that is kept, best first; the particles go there.

        For a robot that is lost.
        """
        self.news = 0
        guesses, places = self._search(list(self._readings()))
        if places:
            self._gather(guesses, np.array([place.share for place in places]))
        return places

    def elsewhere(self, here: Pose2) -> Elsewhere | None:
        """The place apart from this one that the news speak for most; the particles stay."""
        settings = self.settings
        stretch = list(islice(self._readings(), min(self.news, settings.doubted)))
        guesses, places = self._search(stretch)
        others = [k for k, place in enumerate(places) if apart(place.pose, here)]
        if not others:
            return None
        drawn = self._drawn(settings.tries)
        known = np.column_stack([self.poses[drawn], self.wheels[drawn, :2]])
        near = np.array([not apart(place.pose, here) for place in places])
        known = np.concatenate([known, guesses[near]])
        stay = np.cumsum([self._likely(known, at) for at in stretch], axis=0).max(axis=1)
        leave = np.cumsum([self._likely(guesses[others], at) for at in stretch], axis=0)
        pings = np.cumsum([len(at.reading.echoes) + len(at.reading.more) for at in stretch])
        odds = settings.trust * (leave - stay[:, None])
        odds[pings < min(PINGS, pings[-1])] = -inf
        back, best = np.unravel_index(int(odds.argmax()), odds.shape)
        return Elsewhere(
            places[others[best]].pose,
            float(odds[back, best]),
            int(back) + 1,
            exp(leave[back, best] / pings[back]),
            exp(stay[back] / pings[back]),
            float(odds[-1].max()),
        )

    def _likely(self, guesses: Poses, at: Behind, *, whole: bool = True) -> NDArray[np.float64]:
        """The logarithm of the likelihood of a reading behind each guess, (guesses,).

        A guess has a pose, the wheels' drift and their turning error.
        """
        to, way, turn, reading = at
        bent = guesses[:, 3] * np.float32(way) + guesses[:, 4] * np.float32(turn)
        poses = guesses[:, :3].copy()
        poses[:, 2] += np.float32(0.5) * bent  # an arc's chord has turned by half
        poses = _moved(poses, to)
        poses[:, 2] += np.float32(0.5) * bent
        echoes = [*reading.echoes, *reading.more] if whole else reading.echoes
        found: NDArray[np.float64] = _logs(self._model.likelihood(poses, echoes)).sum(axis=1)
        return found

    def _search(self, stretch: Sequence[Behind]) -> tuple[Poses, list[Place]]:
        """Places on the whole map by a stretch of the drive, best first, and guesses there.

        A particle filter that has no idea soon loses the right place
        among the many. Here each place is weighed by the whole stretch of the drive: of many a few
        echoes drop the most, and what is left is told apart by all. The wheels' drift and turning
        error are looked for with each place, or they bend the stretch and the right one fits badly.
        """
        settings = self.settings
        if not stretch:
            return self._anywhere(0), []
        drawn = self._drawn(settings.tries)
        guesses = np.concatenate(
            [
                np.pad(self._coarsely(stretch), ((0, 0), (0, 2))),
                np.column_stack([self.poses[drawn], self.wheels[drawn, :2]]),
            ]
        )
        logs = np.zeros(len(guesses))
        for share, most, copies in FINER:
            guesses, logs = self._nearer(guesses, share, most, copies, stretch)
        shares = np.exp((logs - logs.max()) / settings.rival)
        shares /= shares.sum()
        heard = sum(len(at.reading.echoes) + len(at.reading.more) for at in stretch)
        return guesses, [
            Place((float(x), float(y), wrap(float(theta))), float(share), exp(log / heard))
            for (x, y, theta, *_), share, log in zip(guesses, shares, logs, strict=True)
        ]

    def _coarsely(self, stretch: Sequence[Behind]) -> Poses:
        """The best of many places, by readings from all along the way."""
        settings, free = self.settings, len(self._free)
        least = int(settings.a_cell * free)
        poses = self._anywhere(min(max(settings.candidates, least), settings.most_candidates))
        logs = np.zeros(len(poses))
        for k, one in enumerate(self._rng.permutation(len(stretch)), start=1):
            to, echoes = stretch[one].to, stretch[one].reading.echoes
            likelihood = self._model.likelihood(_moved(poses, to), echoes, coarse=True)
            logs += np.log(likelihood).sum(axis=1)
            if k in FIRST:
                best = np.argsort(-logs)[: max(settings.tries, len(logs) // 3)]
                poses, logs = poses[best], logs[best]
        return poses[np.argsort(-logs)[: settings.tries]]

    def _nearer(
        self, guesses: Poses, share: float, most: int, copies: int, stretch: Sequence[Behind]
    ) -> tuple[Poses, NDArray[np.float64]]:
        """The best guess about each place, best first, of places that lie apart; and their logs.

        The first round, the one with most guesses, takes the echoes of one cycle of each reading.
        """
        settings, whole = self.settings, share < 1.0
        wheels = np.array((settings.drift_rad_m, settings.turn_error), dtype=np.float32)
        noise = self._rng.standard_normal((copies * len(guesses), 5), dtype=np.float32)
        noise *= np.concatenate([NEAR_BY, wheels]) * np.float32(share)
        guesses = np.concatenate([guesses, np.repeat(guesses, copies, axis=0) + noise])
        logs = -0.5 * ((guesses[:, 3:] / wheels) ** 2).sum(axis=1, dtype=np.float64)
        for at in stretch:
            logs += self._likely(guesses, at, whole=whole)
        left, best = np.argsort(-logs), list[int]()
        while len(left) and len(best) < most:
            best.append(int(left[0]))
            x, y, theta = guesses[left[0], :3]
            away = np.hypot(guesses[left, 0] - x, guesses[left, 1] - y) > APART_M
            away |= np.abs(_turned(guesses[left, 2], float(theta))) > APART_RAD
            left = left[away]
        return guesses[best], logs[best]

    def _gather(self, guesses: Poses, shares: NDArray[np.float64]) -> None:
        """Put the particles where the robot may be, as many to each place that counts."""
        self.changes += 1
        counts = shares > LEAST_SHARE * shares.max()
        guesses, shares = guesses[counts], shares[counts]
        each = max(1, min(self.settings.most // len(guesses), self.settings.least))
        guesses = np.repeat(guesses, each, axis=0)
        noise = self._rng.standard_normal((len(guesses), 3), dtype=np.float32)
        self.poses = guesses[:, :3] + noise * (np.float32(0.3) * NEAR_BY)
        self.wheels = self._uncalibrated(len(guesses), 0.5)
        self.wheels[:, :2] += guesses[:, 3:]
        self.weights = np.repeat(shares / (each * shares.sum()), each)

    def _readings(self) -> Iterator[Behind]:
        """The readings that are kept, backwards."""
        to = relative(self._since, (0.0, 0.0, 0.0))
        way, _, turn = self._since
        for reading in reversed(self._kept):
            yield Behind(to, -way, -turn, reading)
            to = compose(to, relative(reading.motion, (0.0, 0.0, 0.0)))
            way, turn = way + reading.motion[0], turn + reading.motion[2]

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
        total = np.cumsum(self.weights)
        at = (self._rng.random() + np.arange(n)) * (total[-1] / n)
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
        total = np.cumsum(self.weights)
        drawn = np.searchsorted(total, (np.arange(n) + 0.5) * (total[-1] / n)) if n else []
        return self.poses[drawn].astype(np.float64)

    def scatter(self) -> NDArray[np.float64]:
        """Covariance of all the particles about their mean, (3, 3)."""
        off = self.poses.astype(np.float64)
        off[:, 2] = _turned(off[:, 2], _heading(off[:, 2], self.weights))
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

    def _near(self, pose: Pose2) -> tuple[NDArray[np.intp], NDArray[np.floating]]:
        """Which particles are of the same place as a pose, and how far they are turned from it."""
        near = np.flatnonzero(
            np.hypot(self.poses[:, 0] - pose[0], self.poses[:, 1] - pose[1]) < 0.6
        )
        turned = _turned(self.poses[near, 2], pose[2])
        same = np.abs(turned) < 0.5
        return near[same], turned[same]

    def estimate(self, about: Pose2 | None = None) -> Estimate:
        """The mean of a cluster: the particles within 0.6 m and 0.5 rad of a pose.

        By default of the heaviest bin's. Whoever follows one place gives the one before; while the
        robot stands that is the same again, once it has settled.
        """
        if about is not None and self._estimated is not None:
            changes, before, found = self._estimated
            if changes == self.changes and max(map(abs, relative(before, about))) < SETTLED:
                return found
        x, y, theta = self._heaviest() if about is None else about
        near, turned = self._near((x, y, theta))
        w = self.weights[near]
        share = float(w.sum())
        if share < 1e-6:
            return self.estimate()
        w = w / share
        off = np.column_stack([self.poses[near, 0] - x, self.poses[near, 1] - y, turned])
        mean = w @ off
        off -= mean
        covariance = (off * w[:, None]).T @ off
        pose = (float(x + mean[0]), float(y + mean[1]), wrap(theta + float(mean[2])))
        found = Estimate(pose, covariance, share, self.fit)
        self._estimated = None if about is None else (self.changes, about, found)
        return found


def apart(one: Pose2, other: Pose2) -> bool:
    """Whether these are two places."""
    far = hypot(one[0] - other[0], one[1] - other[1]) > LEAP_M
    return far or abs(wrap(one[2] - other[2])) > LEAP_RAD


def _logs(likelihood: NDArray[np.float32]) -> NDArray[np.float64]:
    """Of echoes' likelihoods, none of which counts for less than `GHOST`."""
    logs: NDArray[np.float64] = np.log(GHOST + (1.0 - GHOST) * likelihood, dtype=np.float64)
    return logs


def _moved(poses: Poses, motion: Pose2) -> Poses:
    """The poses after a motion in their own frames."""
    x, y, turn = (np.float32(value) for value in motion)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack(
        [poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, poses[:, 2] + turn]
    )


def _heading(theta: NDArray[np.floating], weights: NDArray[np.float64]) -> float:
    """The weighted mean of headings, rad."""
    return float(np.arctan2(weights @ np.sin(theta), weights @ np.cos(theta)))


def _turned(theta: NDArray[np.floating], reference: float) -> NDArray[np.floating]:
    """Headings from a reference on, rad, within half a turn."""
    turned: NDArray[np.floating] = np.remainder(theta - reference + np.pi, 2.0 * np.pi) - np.pi
    return turned
