"""Localization on a log by the installed agents, sans-IO, and its errors.

One agent publishes a `Correction`, another one a `Pose` from it. They receive a `RobotState` each
cycle and the readings of the log, under the log's own clock. The measured estimate is the odometry
with the newest correction. The published pose, which follows it slowly, is measured too.

A map can be made from a log at its reference poses, with the mapper of the mapping agent.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import ceil, degrees, hypot, nan, radians, sqrt
from random import Random
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.agents.slam.logs.logs import Log, LogError
from armadico.config import grid_map
from armadico.config.grid_map import Cells, new_mapper
from armadico.config.loading import load_parameters
from armadico.config.profile import RobotProfile
from armadico.core.agent import Agent, Identity
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import agent_class, providers
from armadico.core.judgement import Judgement, all_of, no, unknown
from armadico.core.messages import Cycle, Message, RobotState
from armadico.core.outgoing import Publish
from armadico.core.services import service_of
from armadico.mobile.geometry import STOOD, Pose2, compose, relative, wrap
from armadico.mobile.messages import Correction, OccupancyGrid, Pose, Scan

Floats = NDArray[np.float64]

CYCLE_S: Final = 0.1
BEFORE_S: Final = 0.3  # duration of odometry before the first reading

OFF_M: Final = 0.3  # an estimate with a larger error counts as off

# An estimate counts as wrong and sure if its error is larger than WRONG_M, its reported deviation
# smaller than SURE_M, and it is not reported as lost.
WRONG_M: Final = 0.5
SURE_M: Final = 0.5

# Above this share of readings reported lost, or off, the map may be of another place.
MOST_LOST: Final = 0.5

# Above this share of readings lost or off, after the first that is not lost, it is not known that
# the robot was localized.
ADRIFT: Final = 0.1

VOLTS: Final = 12.0
ANYWHERE: Final = "anywhere"


def correctors() -> tuple[str, ...]:
    """The installed agents that correct the pose on a map that they are given."""
    mappers = providers(service_of(OccupancyGrid).key)
    return tuple(name for name in providers(service_of(Correction).key) if name not in mappers)


def mapping(log: Log, name: str) -> list[int]:
    """The readings for a map: those of a part that have a reference pose."""
    return log.part(name, [int(i) for i in np.flatnonzero(log.known)])


def mapped(
    log: Log, name: str, profile: RobotProfile, step: Callable[[], None] = lambda: None
) -> Cells:
    """The map that the installed mapper makes from a part of a log, at the reference poses.

    The part has the name `name` (`Log.part`), the profile the cones of the sonars; `step` is called
    for each reading. Raises LogError without reference poses or walls.
    """
    readings = mapping(log, name)
    if not readings:
        raise LogError(f"{log.name} has no reference poses to make a map from: name a map")
    cone = 0.0 if profile.sonar is None else profile.sonar.cone_deg
    mapper = new_mapper(radians(cone) / 2.0)
    for number, i in enumerate(readings):
        at = log.where(i)
        assert at is not None, "all have a reference pose"
        cycle = Cycle(1, number)
        pose = Pose(cycle, *at)
        reading = log.readings.message(i, cycle, STOOD, number)
        if isinstance(reading, Scan):
            mapper.see(pose, reading)
        else:
            for echo in reading.echoes:
                mapper.add(pose, echo)
        step()
    cells = mapper.cells()
    if not cells.area(grid_map.OCCUPIED):
        raise LogError(f"{log.name}: its readings at the reference poses show no wall")
    return cells


def _make_agent(name: str, seed: int, facts: dict[str, object], sets: Sequence[str] = ()) -> Agent:
    """An agent with the parameters that a launcher sets. Raises ConfigError."""
    kind = agent_class(name)
    wanted = {fact: facts[fact] for fact in kind.launched_with if facts.get(fact) is not None}
    given = [*sets, *(f"{fact}={json.dumps(value)}" for fact, value in wanted.items())]
    parameters = load_parameters(kind.parameters, None, given)
    return kind(Identity(f"{name}-1", rng=Random(seed)), parameters)


class Moment(NamedTuple):
    """The estimates at a reading."""

    reading: int
    t: float  # s since the run began
    way: float  # distance by the odometry, m
    estimate: Pose2
    published: Pose2 | None
    reference: Pose2 | None
    alone: Pose2  # odometry alone, from the same start
    deviation: float  # m
    lost: bool
    off_map: bool = False


class Event(Struct, frozen=True):
    """The agent reported the robot as lost, or localized again."""

    t: float  # s
    event: str  # "lost" or "found"
    x: float  # of the estimate, m
    y: float
    off_m: float | None  # error of the estimate; None without a reference


@dataclass
class Track:
    """The result of a run over a log."""

    moments: list[Moment] = field(default_factory=list)
    # Processor time of each cycle with a reading, and of each other cycle.
    scan_s: list[float] = field(default_factory=list)
    other_s: list[float] = field(default_factory=list)
    readings: int = 0


@dataclass(frozen=True)
class Chosen:
    """The settings of a run over a log."""

    world: str
    profile: str
    readings: Sequence[int]
    agent: str
    start: Pose2 | None = None  # of the robot at the first reading; None: the reference
    anywhere: bool = False  # the start is unknown
    seed: int = 0
    sets: tuple[str, ...] = ()  # parameters of the correcting agent, each KEY=VALUE


class Run:
    """One run over a log; call `go` once."""

    def __init__(self, log: Log, chosen: Chosen, clock: Callable[[], float]) -> None:
        """Make the agents.

        `clock` returns the processor time, s. Raises ConfigError for invalid parameters, LogError
        without a start pose.
        """
        self._log, self._clock = log, clock
        self._readings, start = _start_of(log, chosen)
        self._first = log.odometry_at(log.time(self._readings[0]))
        self._start = start
        self._ticks = self._times()
        begin = compose(start, relative(self._first, log.odometry_at(self._ticks[0])))
        facts: dict[str, object] = dict(zip(("x", "y", "theta"), begin, strict=True))
        facts |= {"world": chosen.world, "profile": chosen.profile}
        sets = [*chosen.sets]
        if chosen.anywhere:
            sets.append(f"start={json.dumps(ANYWHERE)}")
        (poser,) = providers(service_of(Pose).key)[:1] or [""]
        if not poser:
            raise LogError("no agent is installed that publishes the pose")
        self._pose = _make_agent(poser, chosen.seed, facts)
        try:
            self._agent = _make_agent(chosen.agent, chosen.seed, facts, sets)
        except ConfigError as error:
            raise ConfigError(f"{chosen.agent}: {error}") from None
        self._subscribed = {to.message for to in self._agent.kernel.subscriptions}
        self._correction: Correction | None = None
        self._published: Pose | None = None
        self._took = 0.0

    def _times(self) -> list[float]:
        """The times of the cycles, s of the log."""
        log = self._log
        first, last = (log.time(self._readings[end]) for end in (0, -1))
        if log.cycles:
            inside = (log.times >= first - BEFORE_S) & (log.times <= last)
            times: list[float] = log.times[inside].tolist()
            return times
        count = ceil((last - first + BEFORE_S) / CYCLE_S) + 1
        return [first - BEFORE_S + CYCLE_S * tick for tick in range(1, count + 1)]

    def go(self, step: Callable[[], None] = lambda: None) -> Track:
        """Run over the whole log; `step` is called for each reading."""
        log, track, due = self._log, Track(), 0
        begun, way, before, heading = self._ticks[0], 0.0, None, None
        begun -= CYCLE_S
        self._agent.kernel.start(0.0)
        self._pose.kernel.start(0.0)
        for tick, t in enumerate(self._ticks, start=1):
            x, y, theta = log.odometry_at(t)
            heading = theta if heading is None else heading + wrap(theta - heading)
            here = (x, y, heading)  # a controller's heading is not wrapped
            way += 0.0 if before is None else hypot(x - before[0], y - before[1])
            before = here
            now, cycle = t - begun, Cycle(1, tick)
            self._took = 0.0
            self._wake(now)
            self._cycle(RobotState(cycle, *here, 0.0, 0.0, VOLTS, True, False), now)
            newest: dict[type, int] = {}
            while due < len(self._readings) and log.time(self._readings[due]) <= t:
                newest[log.readings.kind(self._readings[due])] = due
                due += 1
                step()
            for at in newest.values():
                i = self._readings[at]
                since = relative(here, log.odometry_at(log.time(i)))
                self._deliver(log.readings.message(i, cycle, since, track.readings + 1), now)
            if newest:
                track.scan_s.append(self._took)
                track.readings += 1
                self._note(track, self._readings[max(newest.values())], now, way, here)
            else:
                track.other_s.append(self._took)
            if due == len(self._readings):
                break
        return track

    def _cycle(self, state: RobotState, now: float) -> None:
        """Deliver the odometry of a cycle, and the pose that results from it."""
        self._pose.kernel.receive(state, now)
        self._deliver(state, now)
        kernel = self._pose.kernel
        sent, kernel.outbox = kernel.outbox, []
        for out in sent:
            if isinstance(out, Publish) and isinstance(out.message, Pose):
                self._published = out.message
                self._deliver(out.message, now)

    def _wake(self, now: float) -> None:
        due = self._agent.kernel.wakeup
        if due is not None and due <= now:
            began = self._clock()
            self._agent.kernel.wake(now)
            self._took += self._clock() - began
            self._collect(now)

    def _deliver(self, message: Message, now: float) -> None:
        """Deliver a message to the agent, and collect its publications."""
        if type(message) not in self._subscribed:
            return
        began = self._clock()
        self._agent.kernel.receive(message, now)
        self._took += self._clock() - began
        self._collect(now)

    def _collect(self, now: float) -> None:
        kernel = self._agent.kernel
        sent, kernel.outbox = kernel.outbox, []
        for out in sent:
            if isinstance(out, Publish) and isinstance(out.message, Correction):
                self._correction = out.message
                self._pose.kernel.receive(out.message, now)

    def _note(self, track: Track, reading: int, now: float, way: float, here: Pose2) -> None:
        correction, log = self._correction, self._log
        if correction is None:
            return
        c = correction.covariance
        then = log.where(reading)
        moved = relative(log.odometry_at(log.time(reading)), here)
        seen = self._published
        track.moments.append(
            Moment(
                reading,
                now,
                way,
                compose((correction.x, correction.y, correction.theta), here),
                None if seen is None else (seen.x, seen.y, seen.theta),
                None if then is None else compose(then, moved),  # the reference, moved to now
                compose(self._start, relative(self._first, here)),
                sqrt(max(0.0, c[0] + c[3])),
                correction.confidence <= 0.0,
                correction.off_map,
            )
        )


def _start_of(log: Log, chosen: Chosen) -> tuple[list[int], Pose2]:
    """The readings of the run, and the pose at the first of them. Raises LogError."""
    readings = list(chosen.readings)
    if not readings:
        raise LogError(f"{log.name}: no readings are chosen")
    if chosen.start is not None:
        return readings, chosen.start
    while readings and log.where(readings[0]) is None:
        del readings[0]
    if readings:
        at = log.where(readings[0])
        assert at is not None, "the loop removed the others"
        return readings, at
    if chosen.anywhere:
        return list(chosen.readings), STOOD
    raise LogError(f"{log.name} has no reference poses: name the start")


# Results ------------------------------------------------------------------------------------------


class Summary(Struct, frozen=True, kw_only=True):
    """A run over a log in numbers. Errors and what depends on them are None without a reference.

    Shares are of the readings, 0 to 1. Errors are those of the estimate: the odometry with the
    newest correction.
    """

    scans: int  # readings with an estimate
    compared: int  # of these, with a reference
    seconds: float
    metres: float  # by the odometry
    error_median_m: float | None
    error_95_m: float | None
    error_most_m: float | None
    heading_median_deg: float | None
    heading_95_deg: float | None
    off_share: float | None  # over 0.3 m
    off_longest_s: float | None
    off_longest_m: float | None  # distance meanwhile
    far_share: float | None  # over 0.5 m
    wrong_sure_share: float | None  # over 0.5 m off, deviation under 0.5 m, not reported lost
    wrong_sure_longest_s: float | None
    lost_share: float  # reported lost
    off_map_share: float  # reported off the map
    adrift_share: float  # lost, or over 0.3 m off, since it was first not lost
    unchecked_longest_m: float  # distance without a reading that has a reference
    deviation_median_m: float | None  # while not lost
    published_median_m: float | None  # error of the published pose
    published_95_m: float | None
    odometry_most_m: float | None  # error of the odometry alone
    found_s: float | None  # time until it was localized, of a run that starts lost
    found_off_m: float | None
    scan_median_ms: float  # processor time of a cycle with a reading
    scan_95_ms: float
    most_ms: float  # of any cycle
    events: tuple[Event, ...]


def judgement(log: Log, found: Summary) -> Judgement:
    """Whether the robot was localized, and known to be where it was not."""
    said = [log.judgement]
    if found.lost_share > MOST_LOST:
        why = f"the robot was reported lost at {100.0 * found.lost_share:.0f} % of the readings"
        said.append(no(why, "check that the map is of this place, and the start"))
    if found.off_map_share > MOST_LOST:
        why = f"the robot was off the map at {100.0 * found.off_map_share:.0f} % of the readings"
        said.append(unknown(why, "check that the map is of this place"))
    if found.scans < 2:
        why = "one reading is no way: nothing was tested"
        said.append(unknown(why, "use a log in which the robot drives"))
    if not found.lost_share > MOST_LOST and found.adrift_share > ADRIFT:
        share = 100.0 * found.adrift_share
        why = f"the pose was lost, or more than {OFF_M:g} m off, at {share:.0f} % of the readings"
        answer = no if found.adrift_share > MOST_LOST else unknown
        said.append(answer(why, "check that the map is of this place, and the start"))
    if found.off_share is not None and found.unchecked_longest_m > MOST_LOST * found.metres:
        why = f"over {found.unchecked_longest_m:.0f} of {found.metres:.0f} m there is no reference"
        said.append(unknown(why, "use a log with reference poses all along the way"))
    if found.off_share is None:
        cure = "use a log with reference poses"
        said.append(unknown("the log has no reference: the error is not known", cure))
    elif found.wrong_sure_share:
        share = 100.0 * found.wrong_sure_share
        why = f"the pose was wrong and sure at {share:.1f} % of the readings"
        said.append(no(why, "see the picture (--picture) for the places"))
    elif found.off_share > MOST_LOST:
        why = f"the pose was more than {OFF_M:g} m off at {100.0 * found.off_share:.0f} %"
        said.append(no(why, "check that the map is of this place, and the start"))
    return all_of(said)


def summary(track: Track) -> Summary:
    """The numbers of a run. Raises LogError if there was no estimate."""
    moments = track.moments
    if not moments:
        raise LogError("no correction was published: the map or the readings show no walls")
    t, way = (np.array([getattr(one, name) for one in moments]) for name in ("t", "way"))
    deviation, lost = np.array([m.deviation for m in moments]), np.array([m.lost for m in moments])
    off, turned = errors(moments, "estimate")
    published, _ = errors(moments, "published")
    alone, _ = errors(moments, "alone")
    known = np.isfinite(off)
    wrong = (off > WRONG_M) & (deviation < SURE_M) & ~lost
    far_s, far_m = _longest(off[known] > OFF_M, t[known], way[known])
    wrong_s, _ = _longest(wrong[known], t[known], way[known])
    since = int(np.argmin(lost))
    found = since if lost[0] and not lost.all() else None
    spent = np.array(track.scan_s) * 1e3
    all_spent = np.array([*track.scan_s, *track.other_s]) * 1e3
    none = not known.any()
    return Summary(
        scans=len(moments),
        compared=int(known.sum()),
        seconds=round(float(t[-1]), 1),
        metres=round(float(way[-1]), 1),
        error_median_m=_quantile(off[known], 0.5),
        error_95_m=_quantile(off[known], 0.95),
        error_most_m=_quantile(off[known], 1.0),
        heading_median_deg=_quantile(turned[known], 0.5),
        heading_95_deg=_quantile(turned[known], 0.95),
        off_share=None if none else _share(off[known] > OFF_M),
        off_longest_s=None if none else far_s,
        off_longest_m=None if none else far_m,
        far_share=None if none else _share(off[known] > WRONG_M),
        wrong_sure_share=None if none else _share(wrong[known]),
        wrong_sure_longest_s=None if none else wrong_s,
        lost_share=_share(lost),
        off_map_share=_share(np.array([m.off_map for m in moments])),
        adrift_share=_share((lost | (off > OFF_M))[since:]),
        unchecked_longest_m=_longest(~known, t, way)[1],
        deviation_median_m=_quantile(deviation[~lost], 0.5),
        published_median_m=_quantile(published[np.isfinite(published)], 0.5),
        published_95_m=_quantile(published[np.isfinite(published)], 0.95),
        odometry_most_m=_quantile(alone[known], 1.0),
        found_s=None if found is None else round(float(t[found]), 1),
        found_off_m=None if found is None or not known[found] else round(float(off[found]), 3),
        scan_median_ms=_quantile(spent, 0.5) or 0.0,
        scan_95_ms=_quantile(spent, 0.95) or 0.0,
        most_ms=_quantile(all_spent, 1.0) or 0.0,
        events=_events(moments, off),
    )


def errors(moments: Sequence[Moment], name: str) -> tuple[Floats, Floats]:
    """The error of a pose at each reading, m and degrees; NaN where unknown."""
    found: list[tuple[float, float]] = []
    for one in moments:
        at: Pose2 | None = getattr(one, name)
        to = one.reference
        if at is None or to is None:
            found.append((nan, nan))
            continue
        off = hypot(at[0] - to[0], at[1] - to[1])
        found.append((off, degrees(abs(wrap(at[2] - to[2])))))
    both = np.array(found)
    return both[:, 0], both[:, 1]


def _quantile(values: Floats, share: float) -> float | None:
    return round(float(np.quantile(values, share)), 4) if len(values) else None


def _share(flags: NDArray[np.bool_]) -> float:
    return round(float(np.mean(flags)), 5) if len(flags) else 0.0


def _longest(flags: NDArray[np.bool_], t: Floats, way: Floats) -> tuple[float, float]:
    """The longest period in which a flag is set, s, and the distance meanwhile, m."""
    best, begin = (0.0, 0.0), None
    for at, flag in enumerate(flags):
        if flag and begin is None:
            begin = at
        if begin is not None and (not flag or at == len(flags) - 1):
            best = max(best, (float(t[at] - t[begin]), float(way[at] - way[begin])))
        if not flag:
            begin = None
    return round(best[0], 1), round(best[1], 1)


def _events(moments: Sequence[Moment], off: Floats) -> tuple[Event, ...]:
    found = []
    for at in range(1, len(moments)):
        one = moments[at]
        if one.lost != moments[at - 1].lost:
            error = None if off[at] != off[at] else round(float(off[at]), 3)
            x, y = round(one.estimate[0], 2), round(one.estimate[1], 2)
            found.append(Event(round(one.t, 1), "lost" if one.lost else "found", x, y, error))
    return tuple(found)
