"""Sensors and odometry: readings change as the robot moves, and agree with what is there."""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, cos, dist, hypot, inf, pi, sin

from armadico.core.messages import Cycle, Message, RobotState
from armadico.mobile.geometry import Pose2, compose, relative, wrap
from armadico.mobile.messages import InitialPose, Pose, Scan, Sonar, Truth
from armadico.mobile.motion import clearances
from armadico.mobile.scans import points_of
from armadico.mobile.swept_path import Outline
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.scene import Scene

STEP_M = 0.02
SIDEWAYS_RAD = 0.2
"""A step of at least this length is at most this far off the heading. The most in 25 simulated
drives of 2 minutes was 0.05 rad, turns and counts of the encoders included."""

TURN_RAD = 0.03
"""A step that turns by more than this turns in the direction of the measured rate."""

GAP_S = 0.25
"""Cycles farther apart than this, s, have a gap, in which it may have turned both ways."""

MOVED_M, TURNED_RAD = 0.05, 0.05
"""A reading ahead changes over this way, and every reading over this turn."""

NOTHING = {0x00, 0xFF}
"""The bytes of rays without an echo: where nothing is in reach, all scans are the same."""

MOVES_M_S = 0.05
"""Slower than this, the same readings would count again and again."""

AHEAD_RAD = 0.3
"""Bearings of readings ahead: others may stay the same along a wall."""

REPEATS = 8
"""So many readings in a row that should have changed and did not, without one that did, show a
frozen sensor. A sonar's cone hides a turn of some degrees, so some repeat by chance."""

OFF_M = 0.06
"""The readings nearest to the truth are off by no more than this, m. On the shipped scenarios they
were by -0.03 to 0.01 m."""

PINGS = 100
"""Readings near obstacles, of a robot that moves, that show a bias if as many again agree."""

AGREES_M = 0.04
"""A bias stays the same within this, m; obstacles that no sonar sees come and go."""

NEAREST_SHARE = 0.1
"""The share of them that is too short: by people who walk, and by the time since a ping."""

POSES = 64
"""Cycles whose odometry is kept, to be compared with poses."""

STEP_DEVIATIONS, STEP_FREE_M = 4.0, 0.25
"""A pose moves otherwise than the odometry by no more than so many of its deviations before and
after, and the second, m."""

PIECE_M, WINDOW_M = 0.5, 3.0
"""The odometry's way is compared with the robot's in pieces, until they are so long, m."""

SCALE = 0.06
"""The share by which they may differ. Made errors of wheels are 2 %."""

CERTAIN_M = 0.15
"""A pose less certain than this shows no scale, m."""

NEAR_M = 0.8
"""Obstacles nearer than this, m, are in some sonar's range, whatever its cone."""


class Heading(Rule):
    """The steps of the odometry lead along the heading, as a differential drive moves.

    And it turns in the direction of the measured turn rate.

    After a lost link the controller's axes may differ from the pose's. Mixing them up would move
    maps and poses sideways, and every agent would believe it.
    """

    promise = Promise.ODOMETRY
    needs = (RobotState,)

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        before = now.before
        if not isinstance(message, RobotState) or before is None:
            return
        if before.cycle.epoch != message.cycle.epoch:
            return
        self.checked = True
        here = message.x, message.y, message.theta
        x, y, turned = relative((before.x, before.y, before.theta), here)
        off = abs(wrap(atan2(y, x) - 0.5 * turned))
        if now.state_gap_s < GAP_S and abs(turned) > TURN_RAD:
            rates = (before.w, message.w)  # the turn is between them, and the loops may overshoot
            if max(rates) < 0.0 < turned or turned < 0.0 < min(rates):
                what = f"it turned by {turned:.3f} rad while it measured {message.w:.2f} rad/s"
                yield self.found(now, "robot", what)
        most = SIDEWAYS_RAD
        if now.state_gap_s >= GAP_S:  # it may have driven first, and turned then
            most += 0.5 * abs(turned)
        if hypot(x, y) > STEP_M and min(off, pi - off) > most:
            what = f"a step of {hypot(x, y):.3f} m leads {off:.2f} rad off where it heads"
            yield self.found(now, "robot", what)


class Moves(Rule):
    """A pose moves as the odometry does, or by as much as it was uncertain."""

    promise = Promise.POSE
    needs = (RobotState, Pose)
    sees = (InitialPose,)

    def __init__(self) -> None:
        super().__init__()
        self._odometry: dict[Cycle, Pose2] = {}
        self._before: tuple[Pose, Pose2] | None = None

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        if isinstance(message, RobotState):
            self._odometry[message.cycle] = message.x, message.y, message.theta
            if len(self._odometry) > POSES:
                del self._odometry[next(iter(self._odometry))]
        elif isinstance(message, InitialPose):
            self._before = None
        elif isinstance(message, Pose) and message.cycle in self._odometry:
            before, here = self._before, self._odometry[message.cycle]
            self._before = message, here
            if before is None or not before[0].covariance or not message.covariance:
                return
            was = before[0]
            if (was.cycle.epoch, was.revision) != (message.cycle.epoch, message.revision):
                return
            x, y, _ = compose((was.x, was.y, was.theta), relative(before[1], here))
            off = hypot(message.x - x, message.y - y)
            known = max(was.deviation, message.deviation)
            self.checked = True
            if off > STEP_FREE_M + STEP_DEVIATIONS * known and not now.excuse(Excuse.DISTURBED):
                what = f"the pose moved by {off:.2f} m otherwise than the odometry"
                yield self.found(now, "localization", what, f"+-{known:.2f} m")


class Scaled(Rule):
    """The odometry counts as far as the robot moves: in truth, else by poses that are certain."""

    promise = Promise.ODOMETRY
    needs = (RobotState, Pose)
    sees = (Truth,)

    def __init__(self) -> None:
        super().__init__()
        self._from: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._way_m = self._true_m = 0.0  # of this window
        self._off = 0.0  # the share in the window before

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        state, before, at = now.state, now.before, now.truth or now.pose
        if not isinstance(message, RobotState) or state is None or before is None or at is None:
            return
        if (
            (isinstance(at, Pose) and not 0.0 < at.deviation < CERTAIN_M)
            or before.cycle.epoch != state.cycle.epoch
            or now.state_gap_s > GAP_S
            or now.excuse(Excuse.DISTURBED) is not None
        ):
            self._from = None
            return
        here = (state.x, state.y), (at.x, at.y)
        since = self._from = self._from or here
        way = dist(since[0], here[0])
        if way < PIECE_M:
            return
        self._from, self.checked = here, True
        self._way_m += way
        self._true_m += dist(since[1], here[1])
        if self._way_m < WINDOW_M:
            return
        way, true, was = self._way_m, self._true_m, self._off
        self._way_m = self._true_m = 0.0
        self._off = way / max(true, 0.01) - 1.0
        if min(abs(self._off), abs(was)) > SCALE and self._off * was > 0.0:
            self._off = 0.0
            what = f"the odometry counts {way:.2f} m where the robot moved by {true:.2f} m"
            yield self.found(now, "robot", what, "twice")


class Changes(Rule):
    """Readings change as the robot moves: a sensor that repeats them is frozen."""

    promise = Promise.SENSORS
    needs = (RobotState,)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        # By sonar: the last range, and odometer and heading then.
        self._echoes: dict[tuple[float, ...], tuple[float, float, float]] = {}
        self._scan: tuple[int, bytes, float, float] | None = None
        self._way_m = 0.0
        self._repeats: dict[str, int] = {}
        self._named: set[str] = set()

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        state, before = now.state, now.before
        if state is None:
            return
        if isinstance(message, RobotState):
            if before is not None and before.cycle.epoch == state.cycle.epoch:
                step = relative((before.x, before.y, before.theta), (state.x, state.y, 0.0))
                self._way_m += step[0]
        elif isinstance(message, Sonar):
            for echo in message.echoes:
                if echo.range is None:
                    continue
                key = echo.x, echo.y, echo.bearing
                last = self._echoes.get(key)
                ahead = abs(wrap(echo.bearing)) < AHEAD_RAD
                if last is None or not self._moved(last[1:], state, ahead=ahead):
                    self._echoes.setdefault(key, (echo.range, self._way_m, state.theta))
                    continue
                self._echoes[key] = echo.range, self._way_m, state.theta
                yield from self._reads("sonar", now, same=last[0] == echo.range)
        elif isinstance(message, Scan) and set(message.packed) - NOTHING:
            scan = self._scan
            if scan is None or message.number == scan[0]:
                self._scan = scan or (message.number, message.packed, self._way_m, state.theta)
            elif self._moved(scan[2:], state, ahead=True):
                self._scan = message.number, message.packed, self._way_m, state.theta
                yield from self._reads("laser", now, same=scan[1] == message.packed)

    def _moved(self, since: tuple[float, ...], state: RobotState, *, ahead: bool) -> bool:
        way, heading = since
        turned = abs(wrap(state.theta - heading)) > TURNED_RAD
        return turned or (ahead and abs(self._way_m - way) > MOVED_M)

    def _reads(self, sensor: str, now: Scene, *, same: bool) -> Iterator[Finding]:
        self.checked = True
        self._repeats[sensor] = self._repeats.get(sensor, 0) + 1 if same else 0
        if self._repeats[sensor] < REPEATS:
            self._named -= set() if same else {sensor}
            return
        self._repeats[sensor] = 0
        if sensor not in self._named and now.excuse(Excuse.DISTURBED) is None:
            self._named.add(sensor)
            what = f"the {sensor} repeats its readings while the robot moves"
            yield self.found(now, sensor, what, f"{REPEATS} in a row")


class Unbiased(Rule):
    """The nearest echoes are as far as the nearest obstacle is in truth.

    Only a simulator's truth shows that; without it a bias is unknown. Specular reflection lengthens
    most readings at times, so of many the lowest tenth counts.
    """

    promise = Promise.SENSORS
    needs = (RobotState, Truth)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._off: dict[str, list[float]] = {}
        self._before: dict[str, float] = {}  # what the readings before were off by, m
        self._ring: dict[tuple[float, ...], float] = {}  # by sonar, from the footprint, m
        self._named: set[str] = set()

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:
        truth, about = now.truth, now.description
        if truth is None or about is None or not isinstance(message, Sonar | Scan):
            return
        outline = Outline(about.front, about.rear, about.half_width)
        if truth.clearance is None or truth.clearance > NEAR_M or abs(truth.v) < MOVES_M_S:
            self._ring.clear()
        elif isinstance(message, Sonar):
            for echo in message.echoes:
                far = echo.range if echo.range is not None else message.reach
                x, y = echo.x + far * cos(echo.bearing), echo.y + far * sin(echo.bearing)
                self._ring[echo.x, echo.y, echo.bearing] = outline.clearance(x, y)
            if self._ring:
                yield from self._add("sonar", min(self._ring.values()) - truth.clearance, now)
        else:
            away = clearances(outline, *points_of(message).T)
            seen = float(away.min(initial=inf, where=away > 0.0))  # a laser may see its own robot
            if seen < inf:
                yield from self._add("laser", seen - truth.clearance, now)

    def _add(self, sensor: str, off: float, now: Scene) -> Iterator[Finding]:
        offs = self._off.setdefault(sensor, [])
        offs.append(off)
        if len(offs) < PINGS:
            return
        lowest = sorted(offs)[round(NEAREST_SHARE * PINGS)]
        offs.clear()
        self.checked = True
        before, self._before[sensor] = self._before.get(sensor, 0.0), lowest
        agree = min(abs(lowest), abs(before)) > OFF_M and abs(lowest - before) < AGREES_M
        if agree and sensor not in self._named and now.excuse(Excuse.DISTURBED) is None:
            self._named.add(sensor)
            what = f"the {sensor}'s readings are off by {lowest:+.2f} m"
            yield self.found(now, sensor, what, f"{NEAREST_SHARE:.0%} of {PINGS} by less, twice")
