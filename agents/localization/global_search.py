"""Search of the whole map for a robot's pose, by the readings of the last metres of its drive.

A particle filter without an initial pose soon loses the right place among many. Here each place is
weighed by a whole stretch of the drive: a few readings discard most places, and all readings
separate the rest. The drift and the turning error of the wheels are estimated with each place;
otherwise they bend the stretch, and the right place fits badly.

A search takes longer than a cycle. It runs in pieces while the filter continues to track.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator, Sequence
from itertools import islice, takewhile
from math import exp, hypot, inf
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.localization.sonar_model import Poses
from armadico.agents.methods.poses import wrapped
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import Echo

if TYPE_CHECKING:
    from armadico.config.profile import Odometry

LEAST_DEVIATION: Final = 1e-4
"""Least standard deviation of the wheel errors in a search, which divides by it."""

NEAR_BY: Final = np.array((0.12, 0.12, 0.1), dtype=np.float32)
"""Standard deviations of new guesses around a good one: m, m, rad."""

APART_M, APART_RAD = 0.4, 0.4
"""Guesses closer than both of these are one place."""

LEAP_M, LEAP_RAD = 0.5, 0.5
"""Poses farther apart than one of these are two places."""

LEAST_LIKELIHOOD: Final = np.float32(0.1)
"""Least likelihood of an echo in a stretch of the drive. An echo off several walls repeats along
the way and would otherwise outweigh all others."""

PINGS: Final = 16
"""Fewer pings (two of each sonar) are no evidence for another place."""

ROUNDS: Final = ((1.0, 60, 5), (0.4, 20, 8), (0.25, 12, 24), (0.12, 12, 40))
"""Rounds that refine the best guess at each place: the spread relative to `NEAR_BY`, the number of
places kept, and the number of guesses around each."""

STAYING: Final = 60
"""Guesses around the pose of a robot that was not moved."""

DISCARD_AFTER: Final = (4, 8, 16)
"""After this many readings, in random order, the worse two thirds of the places are discarded."""


class Settings(Struct, frozen=True):
    """Sizes of a search, and how much of the drive it uses."""

    candidates: int = 16_000  # least number of poses tried on the whole map
    a_cell: float = 0.3  # least number of poses for each free cell of the map
    most_candidates: int = 64_000  # greatest number of poses
    tries: int = 200  # best poses that are refined, and particles that are refined with them
    rival: float = 10.0  # a place worse by this log-likelihood has a share e times smaller
    remembered: int = 40  # newest readings that are kept
    reach_m: float = 12.0  # distance back to the oldest reading used: wheel errors bend the drive
    doubted: int = 16  # newest readings that may show that the robot is elsewhere
    apart_m: float = 0.15  # least distance from one kept reading to the next
    apart_rad: float = 0.2  # least turn from one kept reading to the next
    whole: bool = False  # one reading covers all directions: readings in between are dropped
    work: int = 200_000  # likelihoods of one echo at one pose per cycle: 30 ms


LASER: Final = Settings(rival=20.0, remembered=24, whole=True, work=2_000_000)


class Model(Protocol):
    """A measurement model: the likelihood of readings for one sensor and one map."""

    def likelihood(
        self,
        poses: Poses,
        echoes: Sequence[Echo],
        *,
        coarse: bool = False,
        excused: bool = False,
    ) -> NDArray[np.float32]:
        """The likelihood of each reading at each pose, (poses, echoes); the greatest is 1.

        Poses are (n, 3): m, m, rad. With `coarse` they are guesses that lie far apart; with
        `excused` a range shorter than the map's counts little against a pose.
        """


class Reading(NamedTuple):
    """A kept reading, with the motion that led to it."""

    motion: Pose2  # from the reading before, in its frame
    echoes: Sequence[Echo]  # of its cycle
    more: list[Echo]  # of the cycles until the next reading, their sonars in the same frame


class PastReading(NamedTuple):
    """A reading as seen from the robot's present pose."""

    to: Pose2  # where it was taken, by the odometry
    way: float  # distance back to it, m
    turn: float  # turn back to it, rad
    reading: Reading

    @property
    def pings(self) -> int:
        return len(self.reading.echoes) + len(self.reading.more)


class Place(Struct, frozen=True):
    """A pose where the robot may be, by a stretch of its drive."""

    pose: Pose2  # m, m, rad
    share: float  # its share of the weight of all places, 0 to 1
    fit: float  # the geometric mean of the echoes' likelihoods there


class Alternative(Struct, frozen=True):
    """How much better another place explains the newest readings.

    A generalized likelihood ratio: over all other places, and over the moment of a kidnapping.
    """

    pose: Pose2  # that place: m, m, rad
    # Log-likelihood ratio of that place to the filter's particles, each echo with the filter's
    # exponent, over the number of newest readings that maximizes it.
    odds: float
    readings: int  # that number
    fit: float  # the geometric mean of their likelihoods at that place
    stay_fit: float  # the same at the filter's particles
    throughout: float  # the log-likelihood ratio of the best place over the whole stretch


class History:
    """The readings of the last metres of the drive, and the motions between them.

    `new_readings` counts the readings that no search has used yet. `steps` counts the distances
    between them in multiples of the least one: more than `new_readings` if scans are rare.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._since: Pose2 = STOOD  # the motion since the last kept reading
        self._readings: deque[Reading] = deque(maxlen=settings.remembered)
        self.new_readings = self.steps = 0

    def __len__(self) -> int:
        return len(self._readings)

    def clear(self) -> None:
        """Discard all readings: the motion since is unknown."""
        self._readings.clear()
        self.new_readings = self.steps = 0
        self._since = STOOD

    def move(self, motion: Pose2) -> None:
        """Add a motion by the odometry, in the robot's frame: m, m, rad."""
        self._since = compose(self._since, motion)

    def add(self, echoes: Sequence[Echo]) -> None:
        """Keep a reading if the robot has moved far enough since the last one."""
        settings = self._settings
        way, turn = hypot(*self._since[:2]), abs(self._since[2])
        if way > settings.apart_m or turn > settings.apart_rad or not self._readings:
            self._readings.append(Reading(self._since, echoes, []))
            self._since = STOOD
            self.new_readings += 1
            self.steps += max(1, int(way / settings.apart_m), int(turn / settings.apart_rad))
        elif not settings.whole:
            self._readings[-1].more.extend(
                Echo(*compose(self._since, (e.x, e.y, e.bearing)), e.range) for e in echoes
            )

    def discard_old(self, but: int = 0) -> None:
        """Discard all readings except the newest `but`: they were taken at another place."""
        while len(self._readings) > but:
            self._readings.popleft()
        self.new_readings = self.steps = but

    def mark(self, newest: int = 0) -> None:
        """From now on count at most the newest `newest` readings as new."""
        self.new_readings, self.steps = min(self.new_readings, newest), min(self.steps, newest)

    def stretch(self, most: int | None = None) -> list[PastReading]:
        """The newest readings, backwards, as seen from the present pose."""
        near = takewhile(lambda at: abs(at.way) < self._settings.reach_m, self._backwards())
        return list(islice(near, most))

    def _backwards(self) -> Iterator[PastReading]:
        to = relative(self._since, STOOD)
        way, _, turn = self._since
        for reading in reversed(self._readings):
            yield PastReading(to, -way, -turn, reading)
            to = compose(to, relative(reading.motion, STOOD))
            way, turn = way + reading.motion[0], turn + reading.motion[2]


class Search:
    """One search of the whole map. `advance` does a piece of it; `places` is the result."""

    def __init__(
        self,
        model: Model,
        free: Poses,
        odometry: Odometry,
        settings: Settings,
        stretch: Sequence[PastReading],
        particles: Poses,
        rng: np.random.Generator,
    ) -> None:
        """Prepare a search.

        Args:
            model: The measurement model.
            free: Where the robot may be, (n, 2), m.
            odometry: Standard deviations of the wheel errors.
            settings: Sizes.
            stretch: The readings to explain, newest first.
            particles: The filter's particles, (n, 6): x, y, heading, and the wheels' drift
                (rad/m), turning error (rad/rad) and distance error (m/m).
            rng: Random numbers.
        """
        self._model, self._free, self._rng = model, free, rng
        self._settings, self._stretch, self._particles = settings, stretch, particles
        wheels = odometry.alpha2, odometry.alpha1, odometry.alpha3
        self._wheels = np.maximum(wheels, LEAST_DEVIATION, dtype=np.float32)
        self._motion: Pose2 = STOOD
        self._way = self._turn = 0.0
        self._guesses: Poses = np.zeros((0, 6), dtype=np.float32)
        self._logs: NDArray[np.float64] = np.zeros(0)
        self._pieces = self._run()
        self._ahead = 0  # work done beyond the share requested

    def move(self, motion: Pose2) -> None:
        """Add a motion during the search, in the robot's frame: m, m, rad."""
        self._motion = compose(self._motion, motion)
        self._way, self._turn = self._way + motion[0], self._turn + motion[2]

    def advance(self, work: int | None = None) -> bool:
        """Do a cycle's share of the work; True once the search is finished."""
        self._ahead -= self._settings.work if work is None else work
        while self._ahead < 0:
            piece = next(self._pieces, None)
            if piece is None:
                return True
            self._ahead += piece
        return False

    @property
    def guesses(self) -> Poses:
        """Where the robot may be now, best first, (n, 6): columns as of the particles."""
        return self._now(self._guesses)

    @property
    def places(self) -> list[Place]:
        """Where the robot may be now, best first."""
        if not len(self._logs):
            return []
        shares = np.exp((self._logs - self._logs.max()) / self._settings.rival)
        return self._places(self._guesses, shares / shares.sum(), self._logs)

    def _now(self, guesses: Poses) -> Poses:
        moved = guesses.copy()
        moved[:, :3] = _moved_with_errors(guesses, self._motion, self._way, self._turn)
        return moved

    def _places(
        self, guesses: Poses, shares: NDArray[np.float64], logs: NDArray[np.float64]
    ) -> list[Place]:
        pings = sum(at.pings for at in self._stretch)
        return [
            Place((float(x), float(y), wrap(float(theta))), float(share), exp(log / pings))
            for (x, y, theta, *_), share, log in zip(self._now(guesses), shares, logs, strict=True)
        ]

    def alternative(self, here: Pose2, trust: float) -> Alternative | None:
        """The best other place; None if all places are near this one.

        At `here` (m, m, rad), the filter's present estimate, ranges that are too short are excused:
        an unmapped box explains them as well as another place does. Only echoes from behind the
        map's walls, or from farther than anything that should have answered, are evidence against
        it. `trust` is the exponent of an echo's likelihood in the filter.
        """
        places = self.places
        others = [k for k, place in enumerate(places) if apart(place.pose, here)]
        if not others:
            return None
        near = np.array([not apart(place.pose, here) for place in places])
        stays = np.concatenate([self._particles, self._guesses[near]])
        stay = np.cumsum(
            [self._log_likelihood(stays, at, excused=True) for at in self._stretch], axis=0
        ).max(axis=1)
        leaves = self._guesses[others]
        leave = np.cumsum([self._log_likelihood(leaves, at) for at in self._stretch], axis=0)
        pings = np.cumsum([at.pings for at in self._stretch])
        odds = trust * (leave - stay[:, None])
        odds[pings < min(PINGS, pings[-1])] = -inf
        back, best = np.unravel_index(int(odds.argmax()), odds.shape)
        return Alternative(
            places[others[best]].pose,
            float(odds[back, best]),
            int(back) + 1,
            exp(leave[back, best] / pings[back]),
            exp(stay[back] / pings[back]),
            float(odds[-1].max()),
        )

    def staying(self, here: Pose2, odds: float) -> Place | None:
        """The best pose near `here`, with a prior that favours it; None if there is no result.

        `here` is the present pose if the robot was not moved, m, m, rad, with prior `odds` to each
        other place. Its share excuses ranges that are too short, as in `alternative`. Its fit does
        not: in a hall all echoes in a closet are too short, and would fit.
        """
        if not len(self._logs):
            return None
        begun = np.array([*compose(here, relative(self._motion, STOOD)), 0.0, 0.0, 0.0], np.float32)
        noise = self._rng.standard_normal((STAYING, 6), dtype=np.float32)
        about = begun + noise * np.concatenate([NEAR_BY, self._wheels])
        near = [not apart(place.pose, here) for place in self.places]
        guesses = np.concatenate([begun[None], about, self._guesses[near]])
        logs = self._wheels_logs(guesses)
        for at in self._stretch:
            logs += self._log_likelihood(guesses, at, excused=True)
        best = int(logs.argmax())
        plain = np.sum([self._log_likelihood(guesses[[best]], at) for at in self._stretch], axis=0)
        others = self._logs[~np.array(near)]
        against = np.exp((others - logs[best]) / self._settings.rival).sum() / odds
        return self._places(guesses[[best]], np.array([1.0 / (1.0 + against)]), plain)[0]

    # Generators that yield the work just done -----------------------------------------------------

    def _run(self) -> Iterator[int]:
        if not self._stretch:
            return
        coarse = yield from self._coarse()
        guesses = np.concatenate([np.pad(coarse, ((0, 0), (0, 3))), self._particles])
        logs = np.zeros(len(guesses))
        for share, most, copies in ROUNDS:
            guesses, logs = yield from self._refine(guesses, share, most, copies)
        self._guesses, self._logs = guesses, logs

    def _coarse(self) -> Generator[int, None, Poses]:
        """The best of many poses, by readings from all along the stretch."""
        settings, free = self._settings, len(self._free)
        least = int(settings.a_cell * free)
        count = min(max(settings.candidates, least), settings.most_candidates)
        poses = uniform_poses(self._free, count, self._rng)
        logs = np.zeros(len(poses))
        for k, one in enumerate(self._rng.permutation(len(self._stretch)), start=1):
            to, echoes = self._stretch[one].to, self._stretch[one].reading.echoes
            at_once = max(1, settings.work // max(1, len(echoes)))
            for begin in range(0, len(poses), at_once):
                part = slice(begin, begin + at_once)
                likelihood = self._model.likelihood(_moved(poses[part], to), echoes, coarse=True)
                logs[part] += np.log(likelihood).sum(axis=1)
                yield likelihood.size
            if k in DISCARD_AFTER:
                best = np.argsort(-logs)[: max(settings.tries, len(logs) // 3)]
                poses, logs = poses[best], logs[best]
        return poses[np.argsort(-logs)[: settings.tries]]

    def _refine(
        self, guesses: Poses, share: float, most: int, copies: int
    ) -> Generator[int, None, tuple[Poses, NDArray[np.float64]]]:
        """The best guess at each place, best first, and their log-likelihoods.

        The first round, with most guesses, uses the echoes of one cycle of each reading.
        """
        whole = share < 1.0
        noise = self._rng.standard_normal((copies * len(guesses), 6), dtype=np.float32)
        noise *= np.concatenate([NEAR_BY, self._wheels]) * np.float32(share)
        guesses = np.concatenate([guesses, np.repeat(guesses, copies, axis=0) + noise])
        logs = self._wheels_logs(guesses)
        for at in self._stretch:
            logs += self._log_likelihood(guesses, at, whole=whole)
            yield len(guesses) * (at.pings if whole else len(at.reading.echoes))
        left, best = np.argsort(-logs), list[int]()
        x, y, theta = (guesses[left, column] for column in range(3))
        while len(left) and len(best) < most:
            best.append(int(left[0]))
            away = np.hypot(x - x[0], y - y[0]) > APART_M
            near = np.flatnonzero(~away)  # only their headings matter, and angles are slow
            away[near] = np.abs(wrapped(theta[near] - float(theta[0]))) > APART_RAD
            left, x, y, theta = left[away], x[away], y[away], theta[away]
        return guesses[best], logs[best]

    def _wheels_logs(self, guesses: Poses) -> NDArray[np.float64]:
        """The log-likelihood of each guess's wheel errors, (guesses,)."""
        errors = guesses[:, 3:] / self._wheels
        logs: NDArray[np.float64] = -0.5 * (errors**2).sum(axis=1, dtype=np.float64)
        return logs

    def _log_likelihood(
        self, guesses: Poses, at: PastReading, *, whole: bool = True, excused: bool = False
    ) -> NDArray[np.float64]:
        """The log-likelihood of a past reading for each guess, (guesses,)."""
        poses = _moved_with_errors(guesses, at.to, at.way, at.turn)
        echoes = [*at.reading.echoes, *at.reading.more] if whole else at.reading.echoes
        likelihood = self._model.likelihood(poses, echoes, excused=excused)
        found: NDArray[np.float64] = log_likelihoods(likelihood).sum(axis=1)
        return found


def apart(one: Pose2, other: Pose2) -> bool:
    """Whether two poses are two places."""
    far = hypot(one[0] - other[0], one[1] - other[1]) > LEAP_M
    return far or abs(wrap(one[2] - other[2])) > LEAP_RAD


def uniform_poses(free: Poses, count: int, rng: np.random.Generator) -> Poses:
    """`count` poses at places drawn from `free`, (n, 2), with any heading."""
    # Sorted, so that neighbours look up neighbouring cells: half the time on a large map.
    places = free[np.sort(rng.integers(len(free), size=count))]
    poses = np.empty((count, 3), dtype=np.float32)
    poses[:, :2] = places + rng.uniform(-0.05, 0.05, (count, 2))
    poses[:, 2] = rng.uniform(-np.pi, np.pi, count)
    return poses


def log_likelihoods(likelihood: NDArray[np.float32]) -> NDArray[np.float64]:
    """Log-likelihoods of echoes, none of which counts for less than `LEAST_LIKELIHOOD`."""
    logs: NDArray[np.float64] = np.log(
        LEAST_LIKELIHOOD + (1.0 - LEAST_LIKELIHOOD) * likelihood, dtype=np.float64
    )
    return logs


def _moved_with_errors(guesses: Poses, motion: Pose2, way: float, turn: float) -> Poses:
    """The poses of guesses after a motion, with each guess's wheel errors, (n, 3)."""
    bent = guesses[:, 3] * np.float32(way) + guesses[:, 4] * np.float32(turn)
    poses = guesses[:, :3].copy()
    poses[:, 2] += np.float32(0.5) * bent  # the chord of an arc turns by half of it
    poses = _moved(poses, motion, 1.0 + guesses[:, 5])
    poses[:, 2] += np.float32(0.5) * bent
    return poses


def _moved(poses: Poses, motion: Pose2, longer: NDArray[np.float32] | float = 1.0) -> Poses:
    """The poses after a motion in their own frames, its length scaled by `longer`."""
    turn = np.float32(motion[2])
    x, y = (np.float32(way) * longer for way in motion[:2])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack(
        [poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, poses[:, 2] + turn]
    )
