"""Where on the whole map a robot may be, by the readings of the last metres of its drive.

A particle filter with no idea of its pose soon loses the right place among the many. Here each
place is weighed by a whole stretch of the drive instead: a few readings of many places drop the
most, and what is left is told apart by all of them. The wheels' drift and turning error are
estimated with each place; otherwise they bend the stretch, and the right place fits badly.

A search takes longer than a cycle. It is done in pieces, while the filter goes on tracking.
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
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import Echo

if TYPE_CHECKING:
    from armadico.config.profile import Odometry

EXACT: Final = 1e-4
"""Least standard deviation of the wheels' errors in a search: one of 0 could not be divided by."""

NEAR_BY: Final = np.array((0.12, 0.12, 0.1), dtype=np.float32)
"""Standard deviations of guesses about one that is worth a closer look: m, m, rad."""

APART_M, APART_RAD = 0.4, 0.4
"""Guesses that are nearer to each other are one place."""

LEAP_M, LEAP_RAD = 0.5, 0.5
"""Poses that are farther apart are two places."""

GHOST: Final = np.float32(0.1)
"""Least likelihood of an echo in a stretch of the drive: an echo off several walls repeats along
the way, and would outweigh all others."""

PINGS: Final = 16
"""Fewer pings do not speak for another place: each sonar twice."""

FINER: Final = ((1.0, 60, 5), (0.4, 20, 8), (0.25, 12, 24), (0.12, 12, 40))
"""Rounds in which the best guess about each place is refined: the spread in shares of `NEAR_BY`,
the number of places that are left then, and the number of guesses about each."""

STAYING: Final = 60
"""Guesses about the pose of a robot that was not moved."""

FIRST: Final = (4, 8, 16)
"""After so many readings, of all in a random order, the worse two thirds of places are dropped."""


class Settings(Struct, frozen=True):
    """Sizes of a search, and how much of the drive it uses."""

    candidates: int = 16_000  # places that are tried on the whole map,
    a_cell: float = 0.3  # at least so many for each free cell of the map,
    most_candidates: int = 64_000  # but not more than this;
    tries: int = 200  # the best of them are refined, with so many of the filter's particles
    rival: float = 10.0  # a place that fits worse by this has a share that is e times smaller
    remembered: int = 40  # newest readings that are kept,
    reach_m: float = 12.0  # and used, back to here: the wheels' errors bend a longer way too far
    doubted: int = 16  # newest readings that may show that the robot is elsewhere
    apart_m: float = 0.15  # from one reading that is kept to the next, m,
    apart_rad: float = 0.2  # or rad
    whole: bool = False  # one reading covers all directions: what lies between two is left out
    work: int = 200_000  # likelihoods of one echo at one pose that fit into a cycle: 30 ms


LASER: Final = Settings(rival=20.0, remembered=24, whole=True, work=2_000_000)


class Model(Protocol):
    """How likely readings are, by a sensor and a map."""

    def likelihood(
        self,
        poses: Poses,
        echoes: Sequence[Echo],
        *,
        coarse: bool = False,
        excused: bool = False,
    ) -> NDArray[np.float32]:
        """The likelihood of each reading at each pose, (poses, echoes); 1 is the best there is.

        Args:
            poses: Where, (n, 3): m, m, rad.
            echoes: What was read.
            coarse: The poses are guesses that lie far apart.
            excused: A reading that is shorter than by the map counts little against a pose.
        """


class Reading(NamedTuple):
    """One reading that is kept, with the motion that led to it."""

    motion: Pose2  # from where the reading before was taken, in that frame
    echoes: Sequence[Echo]  # of its cycle,
    more: list[Echo]  # and of the cycles until the next one, their sonars in the same frame


class Behind(NamedTuple):
    """A reading as seen from the robot's present pose."""

    to: Pose2  # where it was taken, by the odometry,
    way: float  # m and
    turn: float  # rad on the way back there
    reading: Reading

    @property
    def pings(self) -> int:
        """Its echoes, all together."""
        return len(self.reading.echoes) + len(self.reading.more)


class Place(Struct, frozen=True):
    """Where the robot may be, by a stretch of its drive.

    Attributes:
        pose: m, m, rad.
        share: Of all the places that there are, 0 to 1.
        fit: The geometric mean of the echoes' likelihoods there.
    """

    pose: Pose2
    share: float
    fit: float


class Alternative(Struct, frozen=True):
    """How much better another place explains the newest readings.

    A generalized likelihood ratio: over all other places, and over the moment of a kidnapping.

    Attributes:
        pose: That place: m, m, rad.
        odds: Natural logarithm of its likelihood over that of the filter's particles, each echo's
            with the exponent that the filter uses, over the newest readings that speak for it most,
        readings: their number,
        fit: the geometric mean of their likelihoods there,
        stay_fit: and at the filter's particles.
        throughout: The same odds of the best place over the whole stretch.
    """

    pose: Pose2
    odds: float
    readings: int
    fit: float
    stay_fit: float
    throughout: float


class History:
    """The readings of the last metres of the drive, and how the robot moved between them.

    `news` counts the readings that no search has used yet, `steps` the distances between them, in
    multiples of the least one: more than `news` where a scanner is slow or its scans are rare.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._since: Pose2 = STOOD  # the motion since the last reading that is kept
        self._kept: deque[Reading] = deque(maxlen=settings.remembered)
        self.news = self.steps = 0

    def __len__(self) -> int:
        return len(self._kept)

    def clear(self) -> None:
        """Forget all: no known motion leads on from there."""
        self._kept.clear()
        self.news = self.steps = 0
        self._since = STOOD

    def move(self, motion: Pose2) -> None:
        """The robot moved so in its own frame, by the odometry: m, m, rad."""
        self._since = compose(self._since, motion)

    def add(self, echoes: Sequence[Echo]) -> None:
        """Keep a reading, if the robot has moved far enough since the last one."""
        settings = self._settings
        way, turn = hypot(*self._since[:2]), abs(self._since[2])
        if way > settings.apart_m or turn > settings.apart_rad or not self._kept:
            self._kept.append(Reading(self._since, echoes, []))
            self._since = STOOD
            self.news += 1
            self.steps += max(1, int(way / settings.apart_m), int(turn / settings.apart_rad))
        elif not settings.whole:
            self._kept[-1].more.extend(
                Echo(*compose(self._since, (e.x, e.y, e.bearing)), e.range) for e in echoes
            )

    def forget(self, but: int = 0) -> None:
        """Drop all readings but the newest `but`: they were taken at another place."""
        while len(self._kept) > but:
            self._kept.popleft()
        self.news = self.steps = but

    def mark(self, newest: int = 0) -> None:
        """From now on at most the newest `newest` readings count as news."""
        self.news, self.steps = min(self.news, newest), min(self.steps, newest)

    def stretch(self, most: int | None = None) -> list[Behind]:
        """The newest readings, backwards, as seen from the robot's present pose."""
        near = takewhile(lambda at: abs(at.way) < self._settings.reach_m, self._backwards())
        return list(islice(near, most))

    def _backwards(self) -> Iterator[Behind]:
        to = relative(self._since, STOOD)
        way, _, turn = self._since
        for reading in reversed(self._kept):
            yield Behind(to, -way, -turn, reading)
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
        stretch: Sequence[Behind],
        particles: Poses,
        rng: np.random.Generator,
    ) -> None:
        """Prepare.

        Args:
            model: How likely readings are.
            free: Places where the robot may be, (n, 2), m.
            odometry: How wrong the wheels' counts may be.
            settings: Sizes.
            stretch: The readings to explain, newest first.
            particles: Where the filter believes the robot to be, (n, 6): x, y, heading, the
                wheels' drift (rad/m), turning error (rad/rad) and way error (m/m).
            rng: For all that is random.
        """
        self._model, self._free, self._rng = model, free, rng
        self._settings, self._stretch, self._particles = settings, stretch, particles
        wheels = odometry.alpha2, odometry.alpha1, odometry.alpha3
        self._wheels = np.maximum(wheels, EXACT, dtype=np.float32)
        self._motion: Pose2 = STOOD
        self._way = self._turn = 0.0
        self._guesses: Poses = np.zeros((0, 6), dtype=np.float32)
        self._logs: NDArray[np.float64] = np.zeros(0)
        self._pieces = self._run()
        self._ahead = 0  # work done beyond what was asked for

    def move(self, motion: Pose2) -> None:
        """The robot moved so while the search goes on, in its own frame: m, m, rad."""
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
        """Where the robot may be now, best first, (n, 6): as the particles."""
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
        moved[:, :3] = _bent(guesses, self._motion, self._way, self._turn)
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
        """The best place apart from this one; None if all places are here.

        At this place readings that are too short are excused: a box that is on no map explains
        them as well as another place does. Only what is heard through the map's walls, or from
        farther than anything that should have answered, speaks against it.

        Args:
            here: Where the robot is now by the filter: m, m, rad.
            trust: Exponent of an echo's likelihood in the filter.
        """
        places = self.places
        others = [k for k, place in enumerate(places) if apart(place.pose, here)]
        if not others:
            return None
        near = np.array([not apart(place.pose, here) for place in places])
        stays = np.concatenate([self._particles, self._guesses[near]])
        stay = np.cumsum(
            [self._likely(stays, at, excused=True) for at in self._stretch], axis=0
        ).max(axis=1)
        leaves = self._guesses[others]
        leave = np.cumsum([self._likely(leaves, at) for at in self._stretch], axis=0)
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
        """The best place near a pose, by itself so many times as likely as each other one.

        Readings that are too short there are excused in its share, as in `alternative`. They are
        not in its fit: in a hall all that is heard in a closet is too short, and would fit. None if
        there is no result.

        Args:
            here: Where the robot is now if it was not moved: m, m, rad.
            odds: Before any reading.
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
            logs += self._likely(guesses, at, excused=True)
        best = int(logs.argmax())
        plain = np.sum([self._likely(guesses[[best]], at) for at in self._stretch], axis=0)
        others = self._logs[~np.array(near)]
        against = np.exp((others - logs[best]) / self._settings.rival).sum() / odds
        return self._places(guesses[[best]], np.array([1.0 / (1.0 + against)]), plain)[0]

    # Inside: generators, which yield the work that was just done ----------------------------------

    def _run(self) -> Iterator[int]:
        if not self._stretch:
            return
        coarse = yield from self._coarsely()
        guesses = np.concatenate([np.pad(coarse, ((0, 0), (0, 3))), self._particles])
        logs = np.zeros(len(guesses))
        for share, most, copies in FINER:
            guesses, logs = yield from self._nearer(guesses, share, most, copies)
        self._guesses, self._logs = guesses, logs

    def _coarsely(self) -> Generator[int, None, Poses]:
        """The best of many places, by readings from all along the stretch."""
        settings, free = self._settings, len(self._free)
        least = int(settings.a_cell * free)
        count = min(max(settings.candidates, least), settings.most_candidates)
        poses = anywhere(self._free, count, self._rng)
        logs = np.zeros(len(poses))
        for k, one in enumerate(self._rng.permutation(len(self._stretch)), start=1):
            to, echoes = self._stretch[one].to, self._stretch[one].reading.echoes
            at_once = max(1, settings.work // max(1, len(echoes)))
            for begin in range(0, len(poses), at_once):
                part = slice(begin, begin + at_once)
                likelihood = self._model.likelihood(_moved(poses[part], to), echoes, coarse=True)
                logs[part] += np.log(likelihood).sum(axis=1)
                yield likelihood.size
            if k in FIRST:
                best = np.argsort(-logs)[: max(settings.tries, len(logs) // 3)]
                poses, logs = poses[best], logs[best]
        return poses[np.argsort(-logs)[: settings.tries]]

    def _nearer(
        self, guesses: Poses, share: float, most: int, copies: int
    ) -> Generator[int, None, tuple[Poses, NDArray[np.float64]]]:
        """The best guess about each place, best first, of places that lie apart; and their logs.

        The first round, the one with most guesses, uses the echoes of one cycle of each reading.
        """
        whole = share < 1.0
        noise = self._rng.standard_normal((copies * len(guesses), 6), dtype=np.float32)
        noise *= np.concatenate([NEAR_BY, self._wheels]) * np.float32(share)
        guesses = np.concatenate([guesses, np.repeat(guesses, copies, axis=0) + noise])
        logs = self._wheels_logs(guesses)
        for at in self._stretch:
            logs += self._likely(guesses, at, whole=whole)
            yield len(guesses) * (at.pings if whole else len(at.reading.echoes))
        left, best = np.argsort(-logs), list[int]()
        while len(left) and len(best) < most:
            best.append(int(left[0]))
            x, y, theta = guesses[left[0], :3]
            away = np.hypot(guesses[left, 0] - x, guesses[left, 1] - y) > APART_M
            away |= np.abs(turned_from(guesses[left, 2], float(theta))) > APART_RAD
            left = left[away]
        return guesses[best], logs[best]

    def _wheels_logs(self, guesses: Poses) -> NDArray[np.float64]:
        """The logarithm of the likelihood of each guess's errors of the wheels, (guesses,)."""
        errors = guesses[:, 3:] / self._wheels
        logs: NDArray[np.float64] = -0.5 * (errors**2).sum(axis=1, dtype=np.float64)
        return logs

    def _likely(
        self, guesses: Poses, at: Behind, *, whole: bool = True, excused: bool = False
    ) -> NDArray[np.float64]:
        """The logarithm of the likelihood of a reading behind each guess, (guesses,)."""
        poses = _bent(guesses, at.to, at.way, at.turn)
        echoes = [*at.reading.echoes, *at.reading.more] if whole else at.reading.echoes
        likelihood = self._model.likelihood(poses, echoes, excused=excused)
        found: NDArray[np.float64] = logs_of(likelihood).sum(axis=1)
        return found


def apart(one: Pose2, other: Pose2) -> bool:
    """Whether these are two places."""
    far = hypot(one[0] - other[0], one[1] - other[1]) > LEAP_M
    return far or abs(wrap(one[2] - other[2])) > LEAP_RAD


def anywhere(free: Poses, count: int, rng: np.random.Generator) -> Poses:
    """So many poses at places drawn from `free`, (n, 2), with any heading."""
    # In order, so that neighbours look up what lies near by: half the time on a large map.
    places = free[np.sort(rng.integers(len(free), size=count))]
    poses = np.empty((count, 3), dtype=np.float32)
    poses[:, :2] = places + rng.uniform(-0.05, 0.05, (count, 2))
    poses[:, 2] = rng.uniform(-np.pi, np.pi, count)
    return poses


def logs_of(likelihood: NDArray[np.float32]) -> NDArray[np.float64]:
    """Logarithms of echoes' likelihoods, none of which counts for less than `GHOST`."""
    logs: NDArray[np.float64] = np.log(GHOST + (1.0 - GHOST) * likelihood, dtype=np.float64)
    return logs


def turned_from(theta: NDArray[np.floating], reference: float) -> NDArray[np.floating]:
    """Headings relative to a reference, rad, within half a turn."""
    turned: NDArray[np.floating] = np.remainder(theta - reference + np.pi, 2.0 * np.pi) - np.pi
    return turned


def _bent(guesses: Poses, motion: Pose2, way: float, turn: float) -> Poses:
    """The poses of guesses after a motion, with each guess's errors of the wheels, (n, 3)."""
    bent = guesses[:, 3] * np.float32(way) + guesses[:, 4] * np.float32(turn)
    poses = guesses[:, :3].copy()
    poses[:, 2] += np.float32(0.5) * bent  # an arc's chord has turned by half
    poses = _moved(poses, motion, 1.0 + guesses[:, 5])
    poses[:, 2] += np.float32(0.5) * bent
    return poses


def _moved(poses: Poses, motion: Pose2, longer: NDArray[np.float32] | float = 1.0) -> Poses:
    """The poses after a motion in their own frames, whose way was longer than counted."""
    turn = np.float32(motion[2])
    x, y = (np.float32(way) * longer for way in motion[:2])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack(
        [poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, poses[:, 2] + turn]
    )
