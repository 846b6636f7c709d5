"""Sensors against the walls of the map: none is deaf, and none reads what was there before."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice
from math import ceil, cos, degrees, hypot, inf, isfinite, pi, sin
from statistics import median
from typing import Final

from armadico.core.messages import Cycle, Message, RobotState
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
"""So many readings of other directions within this time, s, show that a wall is there."""

SECTOR_RAD: Final = 0.35
"""Rays of a laser within this count as one direction."""

LOOKS, MISSED, WALLS = 15, 13, 2
"""Of so many looks of a sensor at such walls it misses so many, of the third or more."""

Mount = tuple[str, float, float, float]


class Compared(Rule):
    """Readings fit the walls of the map, by their cycle's place: none is late, none is missing.

    What is not on the map fits no wall, and is not counted. A wall counts as missed only where
    other sensors read it.
    """

    promise = Promise.SENSORS
    needs = (RobotState, Pose)
    sees = (Sonar, Scan)
    charted = True

    def __init__(self) -> None:
        super().__init__()
        self._places: dict[Cycle, Pose2] = {}  # in truth, else by a certain pose
        self._readings: dict[Cycle, Sonar | Scan] = {}
        self._scan_at = -inf
        self._late: dict[tuple[str, int], deque[float]] = {}  # how late, s, by quadrant
        self._read: deque[tuple[float, Mount, float, float]] = deque()  # s; x, y on the map, m
        self._missed: dict[Mount, deque[int | None]] = {}

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, Sonar):
            self._readings[message.cycle] = message
        elif isinstance(message, Scan) and now.now - self._scan_at >= SCANS_S:
            self._scan_at = now.now
            self._readings[message.cycle] = message
        elif isinstance(message, Pose):
            place = now.truth or message
            if now.truth or (0.0 < message.deviation < CERTAIN_M and not message.revision):
                self._places[message.cycle] = place.x, place.y, place.theta
        else:
            return
        for kept in (self._places, self._readings):
            if len(kept) > KEPT:
                del kept[next(iter(kept))]
        here = self._places.get(message.cycle)
        if here is None or message.cycle not in self._readings:
            return
        reading = self._readings.pop(message.cycle)
        if now.chart is not None and now.excuse(Excuse.DISTURBED) is None:
            yield from self._compare(reading, here, now.chart, now)

    def _compare(
        self, reading: Sonar | Scan, here: Pose2, chart: Chart, now: Scene
    ) -> Iterator[Finding]:
        sensor = "sonar" if isinstance(reading, Sonar) else "laser"
        most = SONAR_M if isinstance(reading, Sonar) else LASER_M
        about = now.description
        before = {} if about is None else self._before(reading.cycle, about.cycle_s)
        mounts: list[tuple[Mount, float, float]] = []
        for x, y, bearing, far in rays_of(reading):
            mount = _mount(sensor, x, y, bearing)
            from_x, from_y, theta = compose(here, (x, y, bearing))
            if far < most:
                mounts.append((mount, from_x + far * cos(theta), from_y + far * sin(theta)))
            sight = chart.ahead(from_x, from_y, theta)
            if sight is None or not NEAREST_M < sight.far < most or sight.square < SQUARE:
                continue
            place = from_x + sight.far * cos(theta), from_y + sight.far * sin(theta)
            if self._is_there(mount, *place):
                missed = sight.wall if far > sight.far + BEYOND_M else None
                yield from self._look(mount, missed, now)
            if before and isfinite(far):
                due = _dues(chart, before, (x, y, bearing), sight, sonar=sensor == "sonar")
                yield from self._time(sensor, theta, far, due, now)
        self._read.extend((now.now, *each) for each in mounts)
        while self._read and now.now - self._read[0][0] > HEARD_S:
            self._read.popleft()

    def _before(self, cycle: Cycle, cycle_s: float) -> dict[float, Pose2]:
        """Where it was then and before, by how long before, s; empty if one is missing."""
        found = {}
        for cycles in range(min(ceil(MOST_S / cycle_s), cycle.number) + 1):
            place = self._places.get(Cycle(cycle.epoch, cycle.number - cycles))
            if place is None:
                return {}
            found[cycles * cycle_s] = place
        return found

    def _is_there(self, mount: Mount, x: float, y: float) -> bool:
        """Whether the same sensor reads it in other directions: foam answers no sonar."""
        others = (e for e in self._read if e[1][0] == mount[0] and e[1] != mount)
        near = (1 for _, _, x2, y2 in others if hypot(x2 - x, y2 - y) < BESIDE_M)
        return sum(islice(near, HEARD)) == HEARD

    def _look(self, mount: Mount, missed: int | None, now: Scene) -> Iterator[Finding]:
        """Add a look at a wall: its number if it was missed."""
        self.checked = True
        lately = self._missed.setdefault(mount, deque(maxlen=LOOKS))
        lately.append(missed)
        walls = [each for each in lately if each is not None]
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
