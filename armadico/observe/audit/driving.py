"""How it is driven: at the speed that may be, without standing, hunting or lying, and it brakes."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from math import atan2, cos, inf, pi, sin
from typing import Final

import numpy as np

from armadico.bridge.seen import KEPT_S
from armadico.core.cycles import PERIOD
from armadico.core.hands import Hand
from armadico.core.judgement import Answer
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Cycle, Description, RobotState
from armadico.core.resources import WHEELS
from armadico.mobile.admissible import UNSEEN
from armadico.mobile.geometry import relative
from armadico.mobile.messages import (
    Echo,
    MissionStatus,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Truth,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.route import Route
from armadico.mobile.scans import Floats, points_of
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico.observe.audit.rules import AGAIN_S, Rule
from armadico.observe.audit.scene import RESTS_M_S, SILENT_S, Scene
from armadico.observe.audit.sensed import REMEMBERS_S

STANDS_S: Final = 15.0
"""Standing on a free path for this time, s, needs a reason."""

FORBIDDEN: Final = 8
OF_CYCLES: Final = 10
"""A holder that commands what the readings forbid in so many of so many cycles is not honest. A
second has ten; people who step in front of the robot cost it five or six, in which it brakes."""

FAST_M_S: Final = 0.1
"""Slower commands may be attempts to creep away from what is touched."""

CAPPED, OF_OBEYED = 10, 20
"""Or of which the robot agent caps so many of so many that it obeyed, not always in a row. Its own
readings may show first what others learn some cycles later: in 17 drives of the fault bed 6 at
most. A liar is found 1.0 to 1.3 s after it begins."""

NO_READING: Final = ("", UNSEEN)
"""Caps by which no reading of this cycle forbids anything."""

PRESSES_M_S: Final = 0.15
"""Slower orders that are capped creep along what is near, and the cap is part of it, m/s."""

ADMITTED_SHARE: Final = 0.5
"""A command of which less is let through is forbidden."""

REACTION_S: Final = 0.2
"""Least time from a reading until the wheels follow, s (`bridge.reflex`)."""

ALONG_M: Final = 0.02
"""Between places of an arc at which it is asked whether an obstacle is met, m."""

Spots = tuple[tuple[tuple[float, float], ...], ...]
"""What readings show: of each, points of which one is an obstacle, body frame, m."""

EARNED_CYCLES: Final = 3
"""A speed that readings forbid is reduced within a cycle or two of them."""

READ_S: Final = 0.45
TURNS_RAD_S: Final = 0.3
"""A reading older than the first, a turn of the sonars, or of a robot that turns faster than the
second, forbids nothing: it may have turned away."""

TAKES: Final = 10
TAKES_S: Final = 10.0
"""An agent takes the wheels fewer times than this in this time, s. In 40 drives of two minutes
under faults it was 6 times at most."""

MOST_CYCLES: Final = 8
"""Of the last ten cycles on such a path."""

ORDERED_SHARE: Final = 0.6
"""Least share of the cruising speed that is ordered on a free, long and straight path. Measured on
the shipped scenarios: 0.67 (avoid, which has a top speed of its own) to 1."""

DRIVEN_SHARE: Final = 0.6
"""Least share of the ordered speed that the base drives after a second."""

GAINS_SHARE: Final = 0.35
"""Getting faster or slower by less than this share of the ramp is not following it."""

LAG_CYCLES: Final = 4
"""Cycles from an order until the wheels follow, and one status packet lost."""

BRAKES_LAG, BRAKES_CYCLES = 3, 3
BRAKES_SHARE: Final = 0.5
"""After a lag of so many cycles it brakes over so many by at least this share of its ramp."""

BRAKINGS, DUE_CYCLES, SETTLED_M_S, WEAK_SHARE = 6, 3, 0.06, 0.4
"""In so many cycles of braking, each due for the second, by more than the third, m/s, it got slower
by more than the fourth of what the ramp makes. In 14 undisturbed drives the least was 0.47 to 0.74;
a robot that brakes three times as slowly has 0.32."""

TURNED, FASTER, TURNS_LEAST_RAD_S = 40, 1.15, 0.15
"""In so many cycles a base turns by less than the second of the most that was let through, if that
is more than the third: enough of them, as a speed loop that friction held overshoots for a second.
Turning too slowly is none: on the spot, or to and fro, friction and ramps take more than half."""

SKIPPED: Final = 3
"""States that are fewer cycles apart are still of one motion."""

ROLLS_M_S: Final = 0.1
"""Driving faster than ordered by this, m/s, is not the lag of the ramp alone."""

LONG_M, PARKS_M, ASIDE_M, STRAIGHT_RAD = 2.0, 0.5, 0.4, 0.15
"""A path is free, long and straight if it leads on for the first (and does not end within the
second of that), nothing is within the third of the robot's flanks, and it bends by less."""

SURE_M: Final = 0.1
"""Behaviours slow down with a pose less certain than this, m."""

UNSEEN_M: Final = 3.0
"""So near to a part of the path that nobody has seen, the speed is that of sight, m."""

SPEEDS_UP_S: Final = 1.0
"""Time to speed up, s."""


class Stands(Rule):
    """A robot with a free path does not stand: the agent that is obeyed says how to go on."""

    promise = Promise.STANDS
    needs = (RobotState, MissionStatus, Trajectory, Pose, Ack, Obstacles, Description)

    def __init__(self) -> None:
        super().__init__()
        self._stood_s = 0.0
        self._holders: Counter[str] = Counter()

    def on_robot_state(self, _: RobotState, now: Scene) -> Iterator[Finding]:
        self.checked = self.checked or now.driving
        if not now.rests or not now.driving or now.excuse(*STANDING) is not None:
            self._stood_s = 0.0
            self._holders.clear()
            return
        if now.excuse(Excuse.DISTURBED) is not None:
            return  # a disturbance postpones what is due; while it stands, it forgives nothing
        # Less than `passed_s`: while the robot agent is silent, a reason to stand may come and go.
        self._stood_s += min(now.state_gap_s, SILENT_S)
        self._holders[now.who] += 1
        if self._stood_s > STANDS_S:
            ((who, _count),) = self._holders.most_common(1)
            what = f"stands for {STANDS_S:.0f} s on a free path"
            yield self.found(now, who, what if who else f"{what}, and nobody drives it")
            self._stood_s = 0.0


STANDING: Final = (
    *(Excuse.STOPPED, Excuse.BY_HAND, Excuse.LED, Excuse.LOST, Excuse.WAITS),
    Excuse.BLOCKED,
)


class Honest(Rule):
    """No agent keeps commanding what readings forbid.

    A command is forbidden if the robot, on the commanded arc, could not stop before a published
    obstacle although it began at once, and if it does not brake. Or if the robot agent published
    that it let less than half of it through.
    """

    promise = Promise.HONEST
    needs = (RobotState, Ack, Obstacles, Description)

    def __init__(self) -> None:
        super().__init__()
        self._lately: dict[str, tuple[deque[bool], deque[bool]]] = {}  # forbidden, capped

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        if not now.holder:
            return
        why = self._forbidden(now), _presses(state)
        if why[0] is None:
            return
        self.checked = True
        new = deque[bool](maxlen=OF_CYCLES), deque[bool](maxlen=OF_OBEYED)
        lately = self._lately.setdefault(now.holder, new)
        for each, is_so in zip(lately, why, strict=True):
            each.append(bool(is_so))
        found = [
            what
            for each, most, what in zip(lately, (FORBIDDEN, CAPPED), why, strict=True)
            if what and sum(each) >= most
        ]
        if found and self.is_new(now.holder, now, AGAIN_S):
            what = "keeps commanding what the readings forbid"
            yield self.found(now, now.who, what, found[0])

    @staticmethod
    def _forbidden(now: Scene) -> str | None:
        """Why the order is forbidden; "" if it is not; None if nobody can tell."""
        order, about, seen, state = now.ordered, now.description, now.obstacles, now.state
        if order is None or about is None or seen is None or state is None:
            return None
        if not now.present(seen):
            return None
        v, w = order
        if v < FAST_M_S or v < state.v - RESTS_M_S:
            return ""
        needs = state.v * REACTION_S + state.v**2 / (2.0 * about.v_decel)
        free = _free(seen, about, w / v, needs)
        if free >= needs:
            return ""
        return f"{v:.2f} m/s, where {free:.2f} m ahead are free"


def _free(seen: Obstacles, about: Description, bend: float, most: float) -> float:
    """The way on an arc (bend in 1/m) to the first obstacle within a way, m; inf: none is.

    On a tight arc the robot turns away from what is straight ahead, so the arc is followed.
    """
    points = np.array([(p.x, p.y) for p in seen.points]).reshape(-1, 2)
    for way in np.arange(0.0, most + ALONG_M, ALONG_M):
        turned = bend * way
        at = way * np.sinc(0.5 * turned / pi)  # the chord
        x, y = points[:, 0] - at * cos(0.5 * turned), points[:, 1] - at * sin(0.5 * turned)
        ahead = cos(turned) * x + sin(turned) * y
        aside = np.abs(cos(turned) * y - sin(turned) * x)
        if ((ahead > 0.0) & (ahead < about.front) & (aside < about.half_width)).any():
            return float(way)
    return inf


def _presses(state: RobotState) -> str:
    """Why the order is one of which less than half is let through; "" if it is not."""
    v, admitted = state.ordered.v, state.admitted.v
    forbids = state.capped not in NO_READING
    if not forbids or v < PRESSES_M_S or admitted >= ADMITTED_SHARE * v:
        return ""
    return f"{v:.2f} m/s, of which {admitted:.2f} are let through: {state.capped}"


class Earned(Rule):
    """The robot agent lets no speed through from which a reading of it forbids to drive on.

    Whoever commands it: even if the wheels braked as soon as they can, it would touch what a sensor
    showed just before, on the arc of its order. An echo counts if its whole cone is in the way.
    """

    promise = Promise.EARNED
    needs = (RobotState, Description)
    sees = (Sonar, Scan)

    def __init__(self) -> None:
        super().__init__()
        self._read: dict[tuple[float, ...], tuple[Cycle, Spots]] = {}  # by sonar, or of the laser
        self._lately: deque[str] = deque(maxlen=OF_CYCLES)

    def on_scan(self, scan: Scan, _: Scene) -> None:
        self._read[()] = scan.cycle, tuple(((x, y),) for x, y in points_of(scan))

    def on_sonar(self, sonar: Sonar, now: Scene) -> None:
        if now.description is not None:
            for echo in sonar.echoes:
                key = echo.x, echo.y, echo.bearing
                self._read[key] = sonar.cycle, _cone(echo, now.description)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        if now.admitted is not None:
            yield from self._judge(state, now)

    def _judge(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        about, v = now.description, now.admitted
        if about is None or v is None:
            return
        # A state that comes after readings of its own cycle was published before them.
        ages = range(1, int(READ_S / about.cycle_s) + 1)
        epoch, number = state.cycle.epoch, state.cycle.number
        fresh = [
            spots
            for cycle, spots in self._read.values()
            if cycle.epoch == epoch and number - cycle.number in ages
        ]
        if not fresh:
            return
        self.checked = True
        bend = 0.5 * state.admitted.w / v if v >= FAST_M_S else 0.0
        half = about.half_width
        ahead = [
            min(x for x, _ in spot)
            for spots in fresh
            for spot in spots
            if all(x > about.front and abs(y - bend * x * x) < half for x, y in spot)
        ]
        free = min(ahead, default=inf) - about.front
        drives_on = v >= FAST_M_S and v >= state.v - RESTS_M_S and abs(state.w) < TURNS_RAD_S
        reached = min(v, max(state.v, 0.0) + about.v_accel * REACTION_S)
        forbidden = drives_on and free < reached * REACTION_S + reached**2 / (2.0 * about.v_decel)
        at = f"{v:.2f} m/s, where a reading shows {free:.2f} m" if forbidden else ""
        self._lately.append(at)
        often = sum(map(bool, self._lately)) >= EARNED_CYCLES
        if at and often and self.is_new("robot", now, AGAIN_S):
            what = f"lets through what its readings forbid ({EARNED_CYCLES} of {OF_CYCLES} cycles)"
            yield self.found(now, "robot", what, at)


def _cone(echo: Echo, about: Description) -> Spots:
    """The middle and the ends of an echo's arc, body frame, m; nothing without an echo."""
    far = echo.range
    if far is None or far < about.nearest:
        return ()
    angles = (echo.bearing + share * about.cone for share in (-0.5, 0.0, 0.5))
    return (tuple((echo.x + far * cos(a), echo.y + far * sin(a)) for a in angles),)


class Steady(Rule):
    """No agent takes and loses the wheels again and again."""

    promise = Promise.STEADY
    needs = (Ack,)

    def __init__(self) -> None:
        super().__init__()
        self._holder = ""
        self._takes: dict[str, deque[Cycle]] = {}
        self.most = 0

    def on_ack(self, ack: Ack, now: Scene) -> Iterator[Finding]:
        if ack.resource != WHEELS.name:
            return
        before, self._holder = self._holder, now.holder
        self.checked |= bool(now.holder)
        if not now.holder or now.holder == before:
            return
        takes = self._takes.setdefault(now.holder, deque(maxlen=TAKES))
        takes.append(ack.cycle)
        lasted = [
            now.cycle_s * (ack.cycle.number - each.number)
            for each in takes
            if each.epoch == ack.cycle.epoch
        ]
        recent = [each for each in lasted if 0.0 <= each < TAKES_S]
        self.most = max(self.most, len(recent))
        if len(recent) < TAKES:
            return
        takes.clear()
        what = f"took the wheels {TAKES} times in {recent[0]:.1f} s"
        yield self.found(now, agent_of(now.holder), what)


class Speed(Rule):
    """On a free, long and straight path the robot drives as fast as it may, or the reason is known.

    The agent that is obeyed orders a share of the cruising speed; the robot agent lets it through,
    or publishes why not; and the base drives what is let through.
    """

    promise = Promise.SPEED
    needs = (RobotState, MissionStatus, Trajectory, Pose, Ack, Obstacles, Description)

    def __init__(self) -> None:
        super().__init__()
        self._route = Route(())
        self._path: Trajectory | None = None
        self._free_s = 0.0  # for so long its path is free, long and straight
        self._orders: dict[str, deque[float]] = {}  # on free, long and straight paths, by agent
        self._capped: deque[bool] = deque(maxlen=OF_CYCLES)  # by readings, on such paths
        self._follows = Follows()

    def on_trajectory(self, path: Trajectory, _: Scene) -> None:
        if self._path is None or path.waypoints != self._path.waypoints:
            self._path, self._route = path, Route.of(path)

    def on_pose(self, pose: Pose, _: Scene) -> None:
        if self._route.waypoints:
            self._route.advance(pose.x, pose.y)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        yield from self._base(state, now)
        if not self._is_free(now):
            self._free_s = 0.0
            return
        yield from self._caps(state, now)
        if now.excuse(Excuse.CAPPED) is not None:
            self._free_s = 0.0
            return
        self._free_s += now.cycle_s
        if self._free_s > SPEEDS_UP_S and now.ordered is not None:
            yield from self._orders_less(now.ordered[0], now)

    def _orders_less(self, v: float, now: Scene) -> Iterator[Finding]:
        orders = self._orders.setdefault(now.who, deque(maxlen=OF_CYCLES))
        orders.append(v)
        known, least = now.cruise
        slow = sum(each < ORDERED_SHARE * known for each in orders)
        self.checked |= slow < MOST_CYCLES
        if slow < MOST_CYCLES or _was_near(now, KEPT_S) or not self.is_new(now.who, now):
            return
        what = f"orders {max(orders):.2f} m/s on a free, long and straight path"
        if max(orders) < ORDERED_SHARE * least:
            yield self.found(now, now.who, what, f"cruising speed {least:.2f} m/s or more")
        else:
            why = f"{what}; whether a limit is set is unknown (`v_max` of goto)"
            yield self.found(now, now.who, why, f"without: {known:.2f} m/s", Answer.UNKNOWN)

    def _caps(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        """A cap by readings, where none shows anything."""
        v, admitted = state.ordered.v, state.admitted.v
        sensed = bool(state.capped) and state.capped not in NO_READING
        self._capped.append(sensed and v >= FAST_M_S and admitted < ORDERED_SHARE * v)
        if sum(self._capped) < MOST_CYCLES or _was_near(now, REMEMBERS_S):
            return
        if not self.is_new("robot's cap", now, AGAIN_S):
            return
        what = f"lets {admitted:.2f} of {v:.2f} m/s through on a free, long and straight path"
        yield self.found(
            now,
            "robot",
            what,
            f"nothing was sensed there for {REMEMBERS_S:.0f} s; it says: {state.capped}",
        )

    def _base(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        admitted, about = now.admitted, now.description
        if admitted is None or about is None:
            return
        self._follows.add(now, admitted)
        # A stop, and a fault that the robot agent found, let nothing through.
        excused = state.stalled or now.excuse(Excuse.DISTURBED)
        if excused or not self._follows.lags(about) or not self.is_new("robot", now):
            return
        what = f"drives {state.v:.2f} m/s, where {admitted:.2f} m/s are ordered"
        reason = state.fault or "no reason is published"
        yield self.found(now, "robot", f"{what}; {reason}")

    def _is_free(self, now: Scene) -> bool:
        """Whether its path is free, long and straight, and it knows where it is."""
        pose, about, seen = now.pose, now.description, now.obstacles
        if not now.driving or pose is None or about is None or seen is None or not now.holder:
            return False
        if not pose.covariance or pose.deviation > SURE_M or not self._route.waypoints:
            return False
        if not (now.present(pose) and now.present(seen)):
            return False
        if self._route.to_go(pose.x, pose.y) < LONG_M + PARKS_M:
            return False
        if self._route.off_unseen(pose.x, pose.y) < UNSEEN_M:
            return False
        for share in (0.33, 0.67, 1.0):
            to = self._route.ahead(pose.x, pose.y, share * LONG_M)[0]
            x, y, _ = relative((pose.x, pose.y, pose.theta), (to.x, to.y, 0.0))
            if abs(atan2(y, x)) > STRAIGHT_RAD:
                return False
        near = _near(np.array([(p.x, p.y) for p in seen.points]).reshape(-1, 2), about)
        return not near and now.excuse(*STANDING, Excuse.DISTURBED) is None


def _near(points: Floats, about: Description) -> bool:
    """Whether one of these places (n x 2, body frame, m) is near to the way ahead.

    Those within the footprint are the robot's own, such as a mast that its laser sees.
    """
    x, aside = points[:, 0], np.abs(points[:, 1])
    ahead = (x > -about.rear) & (x < about.front + LONG_M)
    own = (x < about.front) & (aside < about.half_width)
    return bool((ahead & ~own & (aside < about.half_width + ASIDE_M)).any())


def _was_near(now: Scene, within_s: float) -> bool:
    """Whether something was sensed near to the way ahead within a time, s.

    What a single reading showed is in the way until another one looks through its place, or for
    `KEPT_S`, and longer if the robot stands so near to it that its sensors are blind there.
    """
    pose, about = now.pose, now.description
    if pose is None or about is None:
        return True
    c, s = cos(pose.theta), sin(pose.theta)
    places = now.sensed.places(now.now - within_s) - (pose.x, pose.y)
    return _near(places @ np.array([[c, -s], [s, c]]), about)


class Brakes(Rule):
    """The robot brakes along its ramp once it is ordered to be slower."""

    promise = Promise.BRAKES
    needs = (RobotState, Description)
    sees = (Truth,)

    def __init__(self) -> None:
        super().__init__()
        self._follows = Follows()
        self._contacts = 0
        self._slowed: deque[tuple[float, float]] = deque(maxlen=BRAKINGS)  # and what was due, m/s

    def on_truth(self, truth: Truth, _: Scene) -> Iterator[Finding]:
        if truth.collisions > self._contacts:  # a push turns the wheels, also that of a person
            self._contacts, self._follows = truth.collisions, Follows()
        yield from ()

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        if now.description is None:
            return
        admitted = 0.0 if state.stop.stopped else now.admitted
        # A wheel that comes to rest or turns around in a bend is held for some cycles by friction.
        if admitted is None or state.v < abs(state.w) * now.description.half_width:
            return
        self._follows.add(now, admitted)
        slowed = self._follows.brakes(now.description.v_decel)
        if slowed is None or now.excuse(Excuse.DISTURBED) is not None:
            return
        self.checked = True
        self._slowed.append(slowed)
        ramp = f"its ramp is {now.description.v_decel:.2f} m/s^2"
        share = sum(by for by, _ in self._slowed) / sum(due for _, due in self._slowed)
        if self._follows.rolls(now.description):
            if self.is_new("robot", now):
                what = f"still drives {state.v:.2f} m/s, where {admitted:.2f} m/s are ordered"
                cycles = BRAKES_LAG + BRAKES_CYCLES
                yield self.found(now, "robot", what, f"for {cycles} cycles; {ramp}")
        elif len(self._slowed) == BRAKINGS and share < WEAK_SHARE and self.is_new("robot", now):
            what = f"brakes by {share:.0%} of its ramp"
            yield self.found(now, "robot", what, f"in {BRAKINGS} cycles; {ramp}")


class Turns(Rule):
    """The base turns no faster than is let through.

    Nor does the robot agent have to stop it, as it does not move as ordered: that comes first if
    the base is far too fast.
    """

    promise = Promise.ORDERED
    needs = (RobotState,)

    def __init__(self) -> None:
        super().__init__()
        self._rates: deque[float] = deque(maxlen=LAG_CYCLES + 1)  # let through, rad/s
        # Measured, and the most that was let through just before.
        self._turned: deque[tuple[float, float]] = deque(maxlen=TURNED)

    def on_robot_state(self, state: RobotState, now: Scene) -> Iterator[Finding]:
        if state.stop.by == Hand.DISOBEYS and self.is_new(f"stop {state.stop.press}", now):
            self.checked = True
            if now.excuse(Excuse.DISTURBED) is None:
                yield self.found(now, "robot", f"was stopped, because of {state.stop.by}")
        excused = now.excuse(Excuse.DISTURBED)
        if state.stalled or excused or not now.follows or not now.publishes_orders:
            self._rates.clear()
            return
        self._rates.append(state.admitted.w)
        one_way = min(self._rates) > TURNS_LEAST_RAD_S or max(self._rates) < -TURNS_LEAST_RAD_S
        if len(self._rates) <= LAG_CYCLES or not one_way:
            return
        self.checked = True
        self._turned.append((abs(state.w), max(map(abs, self._rates))))
        turned, most = (sum(each) / len(self._turned) for each in zip(*self._turned, strict=True))
        faster = len(self._turned) == TURNED and turned > FASTER * most
        if faster and self.is_new("robot", now, AGAIN_S):
            what = f"turns by {turned:.2f} rad/s, where at most {most:.2f} rad/s are ordered"
            yield self.found(now, "robot", what, f"on average of {TURNED} cycles")


class Follows:
    """The speeds that were let through in the last cycles, and the measured ones, m/s.

    Times are by the base's cycles. After a gap it begins anew.
    """

    def __init__(self) -> None:
        self._last: deque[tuple[int, float, float]] = deque(maxlen=OF_CYCLES + LAG_CYCLES)
        self._cycle_s = PERIOD

    def add(self, now: Scene, admitted: float) -> None:
        assert now.state is not None, "it is judged"
        number, self._cycle_s = now.state.cycle.number, now.cycle_s
        if self._last and not (now.follows and number - self._last[-1][0] < SKIPPED):
            self._last.clear()
        self._last.append((number, admitted, now.state.v))

    def _of_ramp(self, ramp: float, lag: int, cycles: int) -> float | None:
        """The change of speed as a share of what the ramp would have made; None: too few cycles."""
        if len(self._last) < lag + cycles:
            return None
        (begun, _, before), (ended, _, after) = self._last[-cycles], self._last[-1]
        return (after - before) / (ramp * self._cycle_s * (ended - begun))

    def lags(self, about: Description) -> bool:
        """Whether it drives much less than was let through all the time, and gets no faster."""
        gains = self._of_ramp(about.v_accel, LAG_CYCLES, OF_CYCLES)
        slow = all(v > FAST_M_S and m < DRIVEN_SHARE * v for _, v, m in self._last)
        return gains is not None and slow and gains < GAINS_SHARE

    def brakes(self, ramp: float) -> tuple[float, float] | None:
        """By how much it got slower in the last cycle, and should have; None if it was not due."""
        due = [*self._last][-DUE_CYCLES:]
        if len(due) < DUE_CYCLES:
            return None
        (begun, _, before), (ended, _, after) = due[-2:]
        over = before - max(v for _, v, _ in due)
        if min(v for _, v, _ in due) < 0.0 or over < SETTLED_M_S:
            return None
        return before - after, min(ramp * self._cycle_s * (ended - begun), over)

    def rolls(self, about: Description) -> bool:
        """Whether it drives much more than was let through all the time, and gets no slower."""
        gains = self._of_ramp(about.v_decel, BRAKES_LAG, BRAKES_CYCLES)
        lately = [*self._last][-BRAKES_LAG - BRAKES_CYCLES :]
        fast = all(v >= 0.0 and m > v + ROLLS_M_S for _, v, m in lately)
        return gains is not None and fast and -gains < BRAKES_SHARE
