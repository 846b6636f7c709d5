"""Sensors against the walls of the map: none is deaf, and none reads what was there before."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice
from math import ceil, cos, degrees, hypot, inf, isfinite, pi, sin
from statistics import median
from typing import Final

import numpy as np

from armadico.core.messages import Cycle, Description, RobotState
from armadico.mobile.geometry import Pose2, compose, wrap
from armadico.mobile.messages import Pose, Scan, Sonar
from armadico.observe.audit.chart import Chart, Sight
from armadico.observe.audit.poses import CERTAIN_M
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene
from armadico.observe.audit.sensing import rays_of

KEPT: Final = 32
"""Cycles whose poses and readings are kept."""

SQUARE: Final = 0.94
"""The sine at which a wall is met that answers for certain."""

NEAREST_M: Final = 0.2
SONAR_M, LASER_M = 2.0, 4.0
"""Between these distances, m, readings of sonars and of lasers are compared with the map."""

SCANS_S: Final = 0.3
"""Of a laser's scans one in this time, s, is compared: its rays show all of it."""

FITS_M: Final = 0.06
"""A reading within this of a wall's distance fits it, m."""

APART_M: Final = 0.1
LATE_S, MOST_S = 0.25, 0.6
"""A reading is late if it fits best where the robot was so long ago, up to the third, s; the wall
was farther or nearer there by the first, m. A ring of sonars takes 0.16 s to go round."""

TIMES, LATES = 10, 7
"""Of so many such readings in a direction of the map so many are late, and of the opposite one: a
pose that is off makes what is ahead late, and what is behind early."""

BEYOND_M: Final = 0.5
BESIDE_M: Final = 0.3
"""A wall is missed by a reading farther beyond. It is there if others read a place within the
second of it, m."""

HEARD, HEARD_S = 3, 60.0
"""So many readings of other directions within this time, s, show that a wall was there."""

AGAIN_S: Final = 5.0
"""A reading of another direction within this time, s, after a wall was missed shows that it still
is. Else it may have gone: a door that was opened, a box that was taken away."""

SECTOR_RAD: Final = 0.35
"""Rays of a laser within this count as one direction."""

LOOKS, MISSED, WALLS = 15, 13, 2
"""Of so many looks of a sensor at such walls it misses so many, of the third or more."""

Mount = tuple[str, float, float, float]

Read = tuple[float, Mount, int, float, float]
"""When, s, by what, the wall, and x, y on the map, m."""


class Compared(Rule):
    """Readings fit the walls of the map, by their cycle's place: none is late, none is missing.

    What is not on the map fits no wall, and is not counted. A wall counts as missed only where
    other directions of the same sensor read it before and after.
    """

    promise = Promise.SENSORS
    needs = (RobotState, Pose, Description)
    sees = (Sonar, Scan)
    charted = True

    def __init__(self) -> None:
        super().__init__()
        self._places: dict[Cycle, Pose2] = {}  # in truth, else by a certain pose
        self._readings: dict[Cycle, Sonar | Scan] = {}
        self._scan_at = -inf
        self._late: dict[tuple[str, int], deque[float]] = {}  # how late, s, by quadrant
        self._read: deque[Read] = deque()
        self._doubted: deque[Read] = deque()  # missed, and not yet read by others since
        self._missed: dict[Mount, deque[int | None]] = {}

    def on_sonar(self, sonar: Sonar, now: Scene) -> Iterator[Finding]:
        self._readings[sonar.cycle] = sonar
        yield from self._match(sonar.cycle, now)

    def on_scan(self, scan: Scan, now: Scene) -> Iterator[Finding]:
        if now.now - self._scan_at >= SCANS_S:
            self._scan_at = now.now
            self._readings[scan.cycle] = scan
            yield from self._match(scan.cycle, now)

    def on_pose(self, pose: Pose, now: Scene) -> Iterator[Finding]:
        place = now.truth or pose
        if now.truth or (0.0 < pose.deviation < CERTAIN_M and not pose.revision):
            self._places[pose.cycle] = place.x, place.y, place.theta
        yield from self._match(pose.cycle, now)

    def _match(self, cycle: Cycle, now: Scene) -> Iterator[Finding]:
        """Compare a cycle's reading once its place is known, too."""
        for kept in (self._places, self._readings):
            if len(kept) > KEPT:
                del kept[next(iter(kept))]
        here = self._places.get(cycle)
        if here is None or cycle not in self._readings:
            return
        reading = self._readings.pop(cycle)
        if now.chart is not None and now.excuse(Excuse.DISTURBED) is None:
            yield from self._compare(reading, here, now.chart, now)

    def _compare(
        self, reading: Sonar | Scan, here: Pose2, chart: Chart, now: Scene
    ) -> Iterator[Finding]:
        sensor = "sonar" if isinstance(reading, Sonar) else "laser"
        most = SONAR_M if isinstance(reading, Sonar) else LASER_M
        about = now.description
        before = {} if about is None else self._before(reading.cycle, about.cycle_s)
        read: list[tuple[Mount, float, float]] = []
        for x, y, bearing, far in rays_of(reading):
            mount = _mount(sensor, x, y, bearing)
            from_x, from_y, theta = compose(here, (x, y, bearing))
            if far < most:
                read.append((mount, from_x + far * cos(theta), from_y + far * sin(theta)))
            sight = chart.ahead(from_x, from_y, theta)
            if sight is None or not NEAREST_M < sight.far < most or sight.square < SQUARE:
                continue
            place = from_x + sight.far * cos(theta), from_y + sight.far * sin(theta)
            if self._is_there(mount, sight.wall, *place):
                if far > sight.far + BEYOND_M:
                    self._doubted.append((now.now, mount, sight.wall, *place))
                else:
                    self._look(mount, None)
            if before and isfinite(far):
                due = _dues(chart, before, (x, y, bearing), sight, sonar=sensor == "sonar")
                yield from self._time(sensor, theta, far, due, now)
        walls = chart.nearest(np.array([each[1:] for each in read]).reshape(-1, 2))
        new = [
            (now.now, mount, wall, x, y) for (mount, x, y), wall in zip(read, walls, strict=True)
        ]
        yield from self._confirm(new, now)
        self._read.extend(new)
        for kept, at_most in ((self._read, HEARD_S), (self._doubted, AGAIN_S)):
            while kept and now.now - kept[0][0] > at_most:
                kept.popleft()

    def _before(self, cycle: Cycle, cycle_s: float) -> dict[float, Pose2]:
        """Where it was then and before, by how long before, s; empty if one is missing."""
        found = {}
        for cycles in range(min(ceil(MOST_S / cycle_s), cycle.number) + 1):
            place = self._places.get(Cycle(cycle.epoch, cycle.number - cycles))
            if place is None:
                return {}
            found[cycles * cycle_s] = place
        return found

    def _is_there(self, mount: Mount, wall: int, x: float, y: float) -> bool:
        """Whether the same sensor read it in other directions: foam answers no sonar."""
        near = (1 for each in self._read if _shows(each, (0.0, mount, wall, x, y)))
        return sum(islice(near, HEARD)) == HEARD

    def _confirm(self, read: Sequence[Read], now: Scene) -> Iterator[Finding]:
        """Count the walls that were missed and that others read since."""
        for missed in [*self._doubted]:
            at, mount, wall, _, _ = missed
            if at < now.now and any(_shows(each, missed) for each in read):
                self._doubted.remove(missed)
                self._look(mount, wall)
                yield from self._judge(mount, now)

    def _look(self, mount: Mount, missed: int | None) -> None:
        """Add a look at a wall: its number if it was missed."""
        self.checked = True
        self._missed.setdefault(mount, deque(maxlen=LOOKS)).append(missed)

    def _judge(self, mount: Mount, now: Scene) -> Iterator[Finding]:
        walls = [each for each in self._missed[mount] if each is not None]
        if len(walls) < MISSED or len(set(walls)) < WALLS or not self.is_new(str(mount), now):
            return
        sensor, _, _, bearing = mount
        where = f"at {degrees(bearing):.0f} degrees"
        what = f"reads nothing {where}, where the map has walls that others read"
        yield self.found(now, sensor, what, f"{len(walls)} of {LOOKS} readings")

    def _time(
        self, sensor: str, bearing: float, far: float, due: dict[float, float], now: Scene
    ) -> Iterator[Finding]:
        """Judge how old a reading is by the distances of the wall that were due lately, m."""
        if max(due.values()) - min(due.values()) < APART_M:
            return
        late = min(due, key=lambda s: abs(due[s] - far))
        if abs(due[late] - far) > FITS_M:
            return
        self.checked = True
        quadrant = round(2.0 * bearing / pi) % 4
        self._late.setdefault((sensor, quadrant), deque(maxlen=TIMES)).append(late)
        lates = [
            sum(s >= LATE_S for s in self._late.get((sensor, each), ()))
            for each in (quadrant, (quadrant + 2) % 4)
        ]
        if min(lates) >= LATES and self.is_new(f"{sensor} late", now):
            before = median(self._late[sensor, quadrant])
            what = f"its readings fit the map where the robot was {before:.1f} s before"
            yield self.found(now, sensor, what, f"{lates[0]} of {TIMES}, in two directions")


def _shows(read: Read, missed: Read) -> bool:
    """Whether a reading shows the wall that another direction of the same sensor missed."""
    _, mount, wall, x, y = read
    _, other, same, x2, y2 = missed
    others = mount[0] == other[0] and mount != other
    return others and wall == same and hypot(x2 - x, y2 - y) < BESIDE_M


def _mount(sensor: str, x: float, y: float, bearing: float) -> Mount:
    if sensor == "sonar":
        return sensor, x, y, bearing
    return sensor, 0.0, 0.0, SECTOR_RAD * round(wrap(bearing) / SECTOR_RAD)


def _dues(
    chart: Chart, places: dict[float, Pose2], place: Pose2, wall: Sight, *, sonar: bool
) -> dict[float, float]:
    """The distance of a wall in a direction from each place, m; a sonar reads the nearest place."""
    found = {}
    for late, at in places.items():
        x, y, theta = compose(at, place)
        sight = wall if late == 0.0 else chart.ahead(x, y, theta)
        if sight is not None and sight.wall == wall.wall and sight.square > SQUARE:
            found[late] = sight.far * (sight.square if sonar else 1.0)
    return found
