"""Sensors: readings change as the robot moves, and agree with what is there."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from math import cos, dist, hypot, inf, isfinite, sin
from statistics import median
from typing import Final, NamedTuple

import numpy as np

from armadico.core.messages import Cycle, Description, Point, RobotState
from armadico.mobile.geometry import compose, wrap
from armadico.mobile.messages import Pose, Scan, Sonar, Truth
from armadico.mobile.motion import clearances
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import Floats, bearings_of, points_of, ranges_of
from armadico.mobile.swept_path import Outline
from armadico.observe.audit.chart import Chart, Sight
from armadico.observe.audit.poses import CERTAIN_M
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import AGAIN_S, Rule
from armadico.observe.audit.scene import STATES, Scene
from armadico.observe.audit.sensed import NOTHING, echoes_of

MOVED_M, TURNED_RAD = 0.05, 0.05
"""A reading ahead changes over this way, and every reading over this turn."""

MOVES_M_S = 0.05
"""Slower than this, the same readings would count again and again."""

RENEWS_M_S = 0.1
"""At this speed obstacles move by 1 cm between two messages of them."""

AHEAD_RAD = 0.3
"""Bearings of readings ahead: others may stay the same along a wall."""

REPEATS = 8
"""So many readings in a row that should have changed and did not, without one that did, show a
frozen sensor. A sonar's cone hides a turn of some degrees, so some repeat by chance."""

SONAR_M, LASER_M = 1.5, 4.0
"""Readings of sonars and of lasers are near within this, m: a cone is wide farther away."""

RAYS, SCANS_S = 16, 0.3
"""So many rays of a scan are compared, with the map once in this time, s."""

READINGS, OFF_M, DEVIATIONS = 50, 0.15, 2.0
"""Of so many readings half are off the map by no more than the second, m, and so many deviations
of the pose. In drives by sonar the most was 0.12 m, by laser 0.05 m, people aside."""

BEAM: Final = np.array([0.0, -0.25, 0.25, -0.5, 0.5])
"""Directions within a sonar's cone, as shares of it: an echo may come from any of them."""

BEFORE_M: Final = 3.0
"""What is nearer than the map's walls may be none of them, such as a person: over this way, m, the
sensor is wrong. It is chosen: a robot passes a person on a third of it."""

SHOWN_M, BESIDE_M = 0.6, 0.25
"""A reading within the first of the footprint has an obstacle within the second, m."""

READ, HIDDEN = 20, 15
"""Of so many readings of a side in a row fewer than the second lack an obstacle, or miss a wall. In
24 drives of the fault bed it was 7 at most."""

ALIKE = 5
"""So many readings of one wall count. Chosen: three walls that are missed suffice."""

LOOKS_M, NEAREST_M, SQUARE, BEYOND_M, WALLS = 1.2, 0.15, 0.94, 0.5, 3
"""A wall within the first of a sonar (twice that of a laser), and not within the second, m, met at
this sine at least, is missed by a reading farther beyond; so many walls must be missed."""


class Changes(Rule):
    """Readings change as the robot moves: a sensor that repeats them is frozen."""

    promise = Promise.SENSORS
    needs = (RobotState,)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        # By sonar: the last range, and the robot's state then.
        self._echoes: dict[tuple[float, ...], tuple[float, RobotState]] = {}
        self._scan: tuple[int, bytes, RobotState] | None = None
        self._repeats: dict[str, int] = {}

    def on_sonar(self, sonar: Sonar, now: Scene) -> Iterator[Finding]:
        state = now.states.get(sonar.cycle)
        if state is None:
            return
        for echo in sonar.echoes:
            if echo.range is None:
                continue
            key = echo.x, echo.y, echo.bearing
            last = self._echoes.get(key)
            ahead = abs(wrap(echo.bearing)) < AHEAD_RAD
            if last is None or last[1].cycle.epoch != state.cycle.epoch:
                self._echoes[key] = echo.range, state  # of another odometry
                continue
            if not _moved(last[1], state, ahead=ahead):
                continue
            self._echoes[key] = echo.range, state
            yield from self._reads("sonar", now, same=last[0] == echo.range)

    def on_scan(self, scan: Scan, now: Scene) -> Iterator[Finding]:
        state, known = now.states.get(scan.cycle), self._scan
        if state is None or not scan.packed.strip(NOTHING):
            return
        if known is None or known[2].cycle.epoch != state.cycle.epoch:
            self._scan = scan.number, scan.packed, state
        elif scan.number == known[0]:
            return
        elif _moved(known[2], state, ahead=True):
            self._scan = scan.number, scan.packed, state
            yield from self._reads("laser", now, same=known[1] == scan.packed)

    def _reads(self, sensor: str, now: Scene, *, same: bool) -> Iterator[Finding]:
        self.checked = True
        self._repeats[sensor] = self._repeats.get(sensor, 0) + 1 if same else 0
        if self._repeats[sensor] < REPEATS:
            return
        self._repeats[sensor] = 0
        if now.excuse(Excuse.DISTURBED) is None and self.is_new(sensor, now, AGAIN_S):
            what = f"the {sensor} repeats its readings while the robot moves"
            yield self.found(now, sensor, what, f"{REPEATS} in a row")


def _moved(since: RobotState, to: RobotState, *, ahead: bool) -> bool:
    turned = abs(wrap(to.theta - since.theta)) > TURNED_RAD
    return turned or (ahead and hypot(to.x - since.x, to.y - since.y) > MOVED_M)


class Renewed(Rule):
    """Obstacles move in the body frame as the robot moves: the same ones again are old."""

    promise = Promise.SENSORS
    needs = (RobotState, Obstacles)

    def __init__(self) -> None:
        super().__init__()
        self._shown: dict[str, tuple[Point, ...]] = {}
        self._repeats: Counter[str] = Counter()

    def on_obstacles(self, message: Obstacles, now: Scene) -> Iterator[Finding]:
        state = now.states.get(message.cycle)
        if not message.points or state is None:
            return
        before = self._shown.get(message.sensor)
        self._shown[message.sensor] = message.points
        if abs(state.v) < RENEWS_M_S:
            return
        sensor, self.checked = message.sensor, True
        self._repeats[sensor] = self._repeats[sensor] + 1 if before == message.points else 0
        often = self._repeats[sensor] >= REPEATS and now.excuse(Excuse.DISTURBED) is None
        if often and self.is_new(sensor, now, AGAIN_S):
            what = "publishes the same obstacles while the robot moves"
            yield self.found(now, sensor, what, f"{REPEATS} times in a row")


class _Mapped(Rule):
    """Judges readings on the way by the map; of a laser one scan in `SCANS_S`."""

    promise = Promise.SENSORS
    needs = (RobotState, Pose, Description)
    sees = (Sonar, Scan, Truth)
    charted = True

    def __init__(self) -> None:
        super().__init__()
        self._scan_at = -inf

    def on_sonar(self, message: Sonar | Scan, now: Scene) -> Iterator[Finding]:
        state = now.states.get(message.cycle)
        if now.chart is None or state is None or abs(state.v) < MOVES_M_S:
            return
        # Else its place may be that of another moment.
        if not now.paced or not now.present(message):
            return
        if now.excuse(Excuse.DISTURBED) is None:
            yield from self.judge(message, now.chart, now)

    on_scan = on_sonar

    @abstractmethod
    def judge(self, message: Sonar | Scan, chart: Chart, now: Scene) -> Iterator[Finding]:
        """Judge readings by the map."""

    def _is_due(self, message: Sonar | Scan, now: Scene) -> bool:
        if isinstance(message, Scan):
            if now.now - self._scan_at < SCANS_S:
                return False
            self._scan_at = now.now
        return True


class Fits(_Mapped):
    """Near readings lie on the walls of the map: by the true pose, else by a pose that is certain.

    By the truth a sensor is wrong (too long, too short, or the wrong way round), and by a pose
    alone the pose or the sensor. What is not on the map, such as people, is before its walls, and
    not all along the way.
    """

    def __init__(self) -> None:
        super().__init__()
        # By sensor, and whether by truth: how far off readings are, m, and if behind a wall.
        self._off: dict[tuple[str, bool], list[tuple[float, bool]]] = {}
        # Likewise: from where on, m of the way, those before were off the map.
        self._since: dict[tuple[str, bool], float] = {}
        self._here: tuple[float, float] | None = None
        self._way_m = 0.0

    def judge(self, message: Sonar | Scan, chart: Chart, now: Scene) -> Iterator[Finding]:
        if not self._is_due(message, now) or now.description is None:
            return
        pose, here = now.pose, now.truth or now.pose
        if here is None:
            return
        self._way_m += 0.0 if self._here is None else dist(self._here, (here.x, here.y))
        self._here = here.x, here.y
        sensor, near, cone = "laser", LASER_M, 0.0
        if isinstance(message, Sonar):
            sensor, near, cone = "sonar", SONAR_M, now.description.cone
        rays = [ray for ray in rays_of(message) if ray[3] < near]
        if not rays or chart.off(np.array([[here.x, here.y]]))[0] > SONAR_M:
            return  # what is near is none of the map's walls
        if now.truth is not None:
            yield from self._add(sensor, now.truth, _off_map(rays, cone, now.truth, chart), now)
        if pose is not None and 0.0 < pose.deviation < CERTAIN_M and not pose.revision:
            yield from self._add(sensor, pose, _off_map(rays, cone, pose, chart), now)

    def _add(
        self, sensor: str, at: Pose | Truth, off: list[tuple[float, bool]], now: Scene
    ) -> Iterator[Finding]:
        key = sensor, isinstance(at, Truth)
        offs = self._off.setdefault(key, [])
        offs += off
        if len(offs) < READINGS:
            return
        middle = median(each for each, _ in offs)
        behind = sum(each > OFF_M and through for each, through in offs)
        offs.clear()
        self.checked = True
        known = at.deviation if isinstance(at, Pose) else 0.0
        if middle <= OFF_M + DEVIATIONS * known:
            self._since.pop(key, None)
            return
        first = key not in self._since
        way = self._way_m - self._since.setdefault(key, self._way_m)
        enough = 2 * behind > READINGS or way > BEFORE_M
        if first or not enough or not self.is_new(sensor, now):
            return
        what = f"half of the {sensor}'s near readings lie {middle:.2f} m off the map's walls"
        if isinstance(at, Truth):
            yield self.found(now, sensor, what, f"{READINGS} readings, twice")
        else:
            by = f"by a pose known to +-{known:.2f} m"
            yield replace(self.found(now, "localization", f"{what}, {by}"), promise=Promise.POSE)


def _off_map(
    rays: list[tuple[float, float, float, float]], cone: float, at: Pose | Truth, chart: Chart
) -> list[tuple[float, bool]]:
    """How far readings are off the map's walls, m, at best, and whether they are behind one."""
    found = []
    for ray in rays:
        met = compared(ray, cone, at, chart)
        # A cone is wide: its edge may meet another wall, and a wall was to be heard before.
        found.append((met.behind if cone and met.behind > 0.0 else met.off, met.behind > 0.0))
    return found


class Met(NamedTuple):
    """A reading by the map.

    Attributes:
        off: The distance of its end from the nearest wall, m, at best of a cone; inf without walls.
        nearest: That wall's number.
        first: The first wall in its way; None: there is none.
        behind: How far behind that its end is, m; negative: before it.
    """

    off: float
    nearest: int
    first: Sight | None
    behind: float


def compared(
    ray: tuple[float, float, float, float], cone: float, at: Pose | Truth, chart: Chart
) -> Met:
    """What a reading (see `rays_of`) of a cone, rad, meets on the map; 0 rad: of a laser."""
    x, y, bearing, far = ray
    from_x, from_y, theta = compose((at.x, at.y, at.theta), (x, y, bearing))
    angles = theta + cone * (BEAM if cone else BEAM[:1])
    ends = np.column_stack((from_x + far * np.cos(angles), from_y + far * np.sin(angles)))
    sights = [chart.ahead(from_x, from_y, float(angle)) for angle in angles]
    first = min((sight for sight in sights if sight is not None), default=None)
    offs = chart.off(ends)
    best = int(offs.argmin())
    nearest = chart.nearest(ends[best : best + 1])[0]
    return Met(float(offs[best]), nearest, first, -inf if first is None else far - first.far)


class Sees(_Mapped):
    """On each side a sensor reads the walls of the map that are near and square to it.

    Some walls may be gone, or return nothing, so several must be missed, and of each missed wall
    only the newest readings count: beside a long one the robot takes many.
    """

    def __init__(self) -> None:
        super().__init__()
        # Of each wall whether it was missed, by sensor and side.
        self._missed: dict[tuple[str, str], deque[tuple[int, bool]]] = {}

    def judge(self, message: Sonar | Scan, chart: Chart, now: Scene) -> Iterator[Finding]:
        pose = now.pose
        certain = pose is not None and 0.0 < pose.deviation < CERTAIN_M and not pose.revision
        at = now.truth or (pose if certain else None)
        if at is None:
            return
        if not self._is_due(message, now):
            return
        scanned = isinstance(message, Scan)
        sensor, most = ("laser", 2.0 * LOOKS_M) if scanned else ("sonar", LOOKS_M)
        for x, y, bearing, far in rays_of(message):
            from_x, from_y, theta = compose((at.x, at.y, at.theta), (x, y, bearing))
            sight = chart.ahead(from_x, from_y, theta)
            if sight is not None and NEAREST_M < sight.far < most and sight.square > SQUARE:
                read = sight.wall, far > sight.far + BEYOND_M
                yield from self._add(sensor, _side(cos(bearing), sin(bearing)), read, now)

    def _add(self, sensor: str, side: str, read: tuple[int, bool], now: Scene) -> Iterator[Finding]:
        self.checked = True
        lately = self._missed.setdefault((sensor, side), deque(maxlen=READ))
        if read[1] and lately.count(read) >= ALIKE:
            lately.remove(read)
        lately.append(read)
        walls = [wall for wall, missed in lately if missed]
        often = len(walls) >= HIDDEN and len(set(walls)) >= WALLS
        if often and self.is_new(f"{sensor} {side}", now):
            what = f"reads nothing {side}, where the map has walls"
            yield self.found(now, sensor, what, f"{len(walls)} of {READ} readings")


class Shown(Rule):
    """What a sensor reads near the robot is published as an obstacle."""

    promise = Promise.SENSORS
    needs = (RobotState, Obstacles, Description)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._read: dict[tuple[str, Cycle], Sonar | Scan] = {}  # by sensor and cycle
        self._hidden: dict[tuple[str, str], deque[bool]] = {}  # by sensor and side

    def on_sonar(self, message: Sonar | Scan, _: Scene) -> None:
        sensor = "laser" if isinstance(message, Scan) else "sonar"
        self._read[sensor, message.cycle] = message
        if len(self._read) > STATES:
            del self._read[next(iter(self._read))]

    on_scan = on_sonar

    def on_obstacles(self, message: Obstacles, now: Scene) -> Iterator[Finding]:
        state, about = now.states.get(message.cycle), now.description
        if state is None or about is None:
            return
        read = self._read.pop((message.sensor, message.cycle), None)
        if read is None or abs(state.v) < MOVES_M_S or now.excuse(Excuse.DISTURBED) is not None:
            return
        outline, points = Outline(about.front, about.rear, about.half_width), _near(read)
        gaps = clearances(outline, *points.T)
        points = points[(gaps > 0.0) & (gaps < SHOWN_M)]  # a laser may see its own robot
        if len(points):
            yield from self._compare(message, points, now)

    def _compare(self, shown: Obstacles, points: Floats, now: Scene) -> Iterator[Finding]:
        self.checked = True
        places = np.array([(p.x, p.y) for p in shown.points]).reshape(-1, 2)
        away = np.linalg.norm(points[:, None, :] - places, axis=2).min(axis=1, initial=inf)
        for (x, y), gap in zip(points, away, strict=True):
            side = shown.sensor, _side(x, y)
            lately = self._hidden.setdefault(side, deque(maxlen=READ))
            lately.append(bool(gap > BESIDE_M))
            often = len(lately) == READ and sum(lately) >= HIDDEN
            if often and self.is_new(" ".join(side), now):
                what = f"leaves out obstacles that the {shown.sensor} reads {side[1]}"
                yield self.found(now, shown.sensor, what, f"{sum(lately)} of {READ} readings")


def _near(message: Sonar | Scan) -> Floats:
    """The places (n x 2, body frame, m) of readings that are near enough to be exact."""
    if isinstance(message, Scan):
        points = points_of(message)
        points = points[:: max(len(points) // RAYS, 1)]
        near: Floats = points[np.hypot(*points.T) < LASER_M]
        return near
    return echoes_of(message, SONAR_M)


def rays_of(message: Sonar | Scan) -> list[tuple[float, float, float, float]]:
    """Where readings are taken (x, y, bearing, body frame) and the range, m; inf: nothing."""
    if isinstance(message, Sonar):
        echoes = message.echoes
        return [(e.x, e.y, e.bearing, inf if e.range is None else e.range) for e in echoes]
    ranges, bearings = ranges_of(message), bearings_of(message)
    few = slice(None, None, max(len(ranges) // RAYS, 1))
    pairs = zip(bearings[few].tolist(), ranges[few].tolist(), strict=True)
    return [(message.x, message.y, b, far if isfinite(far) else inf) for b, far in pairs]


def _side(x: float, y: float) -> str:
    if abs(y) < abs(x):
        return "ahead" if x > 0.0 else "behind"
    return "on its left" if y > 0.0 else "on its right"
