"""The contract of a kind of robot: its driver, its simulator and its profile, checked together.

    class TestCreate2(RobotContract):
        profile = "create2"

The driver is connected to the simulated robot as by a cable, with the time set by hand; the truth
comes from the simulator, and what a collision is comes from the kit's own wall. The last check
drives `sc1` with all agents.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from math import cos, hypot, inf, isfinite, radians, remainder, sin, tau
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

from msgspec.structs import replace

from armadico.bridge.kind import RobotKind, kind_of
from armadico.bridge.reflex import reaction_s
from armadico.bridge.session import Connected, LinkLost, Noted, Reported, Session, Unanswered
from armadico.bridge.simulator.plant import seeded
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.config.profile import NEVER_S, RobotProfile, load_profile
from armadico.config.scenarios import Scenario, ideal
from armadico.contracts.contract import Contract
from armadico.core.judgement import Judgement, all_of, no, unknown, whether, yes
from armadico.mobile.messages import Truth
from armadico.mobile.scans import message_of, points_of

STEP_S = 0.02
"""Time between two calls of the driver."""

OPENS_S = 5.0
"""An answering robot is open within this time, also after it was lost."""

PULSE_S = 0.5
"""The robot agent feeds the watchdog this often."""

ODOMETRY = 0.02
"""Greatest error of the odometry with ideal sensors, relative to the way or the angle."""

MOST_AT_ONCE = 50
"""Greatest number of reports from one call, however many frames have piled up."""

WALL = """2D-Map
LineMinPos: -20000 -20000
LineMaxPos: 20000 20000
NumLines: 1
LINES
{x} -3000 {x} 3000
DATA
"""


class Bench:
    """A driver and the simulated robot at the two ends of one line.

    Attributes:
        profile: The robot's.
        session: The driver.
        robot: The simulated robot.
        now: The time, s.
        events: All that the driver has returned.
        order: The speeds that are ordered in each cycle, m/s and rad/s; None: none.
        through: Changes the robot's bytes on their way, each step.
    """

    def __init__(self, profile: RobotProfile, world: str = "empty") -> None:
        """Place the robot at the origin, with ideal sensors."""
        self.profile = profile
        self._kind: RobotKind[Any] = kind_of(profile)
        self._scenario = Scenario(world=world, start=(0.0, 0.0, 0.0), robot=profile.name)
        self.robot = self.placed()
        self.now = self._pulsed_at = 0.0
        self._began = 0.0  # of the simulated robot's time
        self.session: Session = self._kind.session(profile, 0.0, (0.0, 0.0))
        self.events: list[object] = []
        self.order: tuple[float, float] | None = None
        self._order_at = 0.0
        self.through: Callable[[bytes], list[bytes]] = lambda data: [data] if data else []

    def placed(self) -> SimulatedRobot:
        """A simulated robot that was just switched on."""
        return self._kind.in_scenario(ideal(self._scenario), seeded(1))

    def exchange(self) -> None:
        """Another controller answers on the line from now on: the robot was off and on."""
        self.robot, self._began = self.placed(), self.now

    def run(self, seconds: float, *, calls: bool = True, answers: bool = True) -> None:
        """Let time pass.

        Args:
            seconds: s.
            calls: Whether the driver's process runs; it hangs without.
            answers: Whether the robot's bytes arrive; they are lost without.
        """
        for _ in range(round(seconds / STEP_S)):
            self.now = round(self.now + STEP_S, 6)
            if calls:
                due = self.session.next_wakeup
                if due is not None and self.now >= due:
                    self._note(self.session.tick(self.now))
                if self.order is not None and self.now >= self._order_at:
                    self._order_at = self.now + self.profile.cycle_s
                    self.session.drive(*self.order)
                if self.session.is_open and self.now - self._pulsed_at >= PULSE_S:
                    self.session.pulse()
                self._write()
            data = self.robot.advance(self.now - self._began)
            if not answers:
                continue
            for part in self.through(data):
                self._note(self.session.receive(part, self.now))
            if calls:
                self._write()

    def _write(self) -> None:
        data = self.session.outgoing()
        if data:
            self._pulsed_at = self.now
            self.robot.receive(data, self.now - self._began)

    def restart(self) -> None:
        """The port is opened again."""
        self._note(self.session.restart(self.now))
        self._write()

    def close(self) -> None:
        """End the driver in order."""
        self.order = None
        self.session.close()
        self._write()

    def drive(self, v: float, w: float, seconds: float) -> None:
        """Order speeds, m/s and rad/s, once in a cycle as the robot agent does, for a time."""
        self.order, self._order_at = (v, w), self.now
        self.run(seconds)

    def _note(self, events: Iterable[object]) -> None:
        self.events += events

    @property
    def reports(self) -> list[Reported]:
        return [event for event in self.events if isinstance(event, Reported)]

    @property
    def last(self) -> Reported:
        """The newest report."""
        return self.reports[-1]

    @property
    def truth(self) -> Truth:
        return self.robot.truth()

    def opened(self) -> Bench:
        """Return this bench with the robot open. Raises AssertionError."""
        for _ in range(round(OPENS_S / 0.1)):
            self.run(0.1)
            if self.session.is_open and self.reports:
                self.run(0.3)
                return self
        raise AssertionError(f"the driver did not open the simulated robot in {OPENS_S:g} s")


class RobotContract(Contract):
    """The checks of one profile's kind of robot.

    Attributes:
        profile: The profile: a name, or a file.
        scenario: Driven with all agents by the last check.
    """

    profile: ClassVar[str | Path] = ""
    scenario: ClassVar[str] = "sc1"

    @cached_property
    def robot(self) -> RobotProfile:
        """The profile that was read."""
        # The simulator and the agents read the profile by this name, too.
        return replace(load_profile(self.profile), name=str(self.profile))

    def bench(self, world: str = "empty") -> Bench:
        """A new bench, with the robot open."""
        return Bench(self.robot, world).opened()

    @property
    def v(self) -> float:
        """A moderate speed, m/s."""
        return min(0.5 * self.robot.limits.v_max, 0.4)

    @property
    def w(self) -> float:
        """A moderate turn rate, rad/s."""
        return min(0.5 * self.robot.limits.w_max, 0.8)

    # Opening and reporting ------------------------------------------------------------------------

    def check_opens_and_reports_each_cycle(self) -> Judgement:
        """It says that it is connected, then reports once in a cycle, with finite numbers."""
        bench = self.bench()
        before = len(bench.reports)
        bench.run(5.0)
        rate = (len(bench.reports) - before) / (5.0 / self.robot.cycle_s)
        kinds = [Reported if isinstance(e, Reported) else type(e) for e in bench.events]
        return all_of(
            (
                whether(
                    Connected in kinds and kinds.index(Connected) < kinds.index(Reported),
                    "no Connected before the first report",
                ),
                whether(
                    0.9 < rate < 1.1,
                    f"{rate:.2f} reports in a cycle of {self.robot.cycle_s:g} s",
                    "one Reported per cycle; correct cycle_s in the profile",
                ),
                whether(bench.last.motors, "the motors are off after opening"),
                _finite(bench),
            )
        )

    def check_odometry_agrees_with_the_truth(self) -> Judgement:
        """Ahead, left and in an arc, the pose and the speeds are those of the base."""
        bench = self.bench()
        found = [_finite(bench)]
        for v, w, seconds in ((self.v, 0.0, 4.0), (0.0, self.w, 3.0), (self.v, -self.w, 3.0)):
            bench.drive(v, w, seconds)
            if not w:
                found.append(_agrees(bench, way=4.0 * v, angle=0.0))
            report, true = bench.last, bench.truth
            off_v, off_w = abs(report.v - true.v), abs(report.w - true.w)
            found.append(
                whether(
                    off_v < 0.1 * self.v + 0.02 and off_w < 0.1 * self.w + 0.05,
                    f"reports {report.v:.2f} m/s, {report.w:.2f} rad/s; in truth {true.v:.2f},"
                    f" {true.w:.2f}",
                )
            )
            obeys = (
                abs(true.v - v) < 0.15 * self.v + 0.02 and abs(true.w - w) < 0.15 * self.w + 0.05
            )
            found.append(
                whether(
                    obeys,
                    f"ordered {v:.2f} m/s, {w:.2f} rad/s; drives {true.v:.2f}, {true.w:.2f}",
                )
            )
        bench.drive(0.0, 0.0, 3.0)
        return all_of((*found, _agrees(bench, way=4.0 * self.v * 2, angle=6.0 * self.w)))

    def check_sees_a_wall_where_it_is(self) -> Judgement:
        """The sensors see a wall ahead at its distance."""
        away = min(0.5 * self.robot.reach_m, 1.5)
        with _walled(self.robot.body.front_m + away) as (world, wall_x):
            bench = self.bench(world)
            bench.run(2.0)
            seen = list(_points(self.robot, bench.reports[-round(1.5 / self.robot.cycle_s) :]))
        ahead = [x for x, y in seen if abs(y) < 0.3 * x]
        if not ahead:
            return unknown("no sensor saw the wall ahead", "compare [sonar] or [laser]")
        nearest = min(ahead)
        return whether(
            abs(nearest - wall_x) < 0.05 + 0.05 * wall_x,
            f"a wall {wall_x:.2f} m ahead of the axle is seen at {nearest:.2f} m",
        )

    # Stopping -------------------------------------------------------------------------------------

    def check_stops_within_its_bound(self) -> Judgement:
        """From its top speed it stops by the profile's ramp, and at least so by emergency."""
        limits = self.robot.limits
        bound = limits.v_max * reaction_s(self.robot) + limits.v_max**2 / (2 * limits.v_decel)
        found = []
        for what, stop in (("stop", "stop"), ("emergency stop", "emergency_stop")):
            bench = self.bench()
            bench.drive(limits.v_max, 0.0, 2.0 + limits.v_max / limits.v_accel)
            before = bench.truth
            bench.order = None
            getattr(bench.session, stop)()
            bench.run(1.0 + 1.5 * limits.v_max / limits.v_decel)
            rolled = hypot(bench.truth.x - before.x, bench.truth.y - before.y)
            found.append(
                whether(before.v > 0.8 * limits.v_max, f"reached only {before.v:.2f} m/s in time")
            )
            found.append(
                whether(
                    rolled < 1.1 * bound + 0.02 and abs(bench.truth.v) < 0.02,
                    f"{what}: {rolled:.2f} m and {bench.truth.v:.2f} m/s; its ramps allow"
                    f" {bound:.2f} m",
                    "correct v_decel in [limits], by which behaviours plan their stops",
                )
            )
        return all_of(found)

    def check_stops_when_its_driver_hangs(self) -> Judgement:
        """The watchdog stops it in the profile's time; without one the driver says so."""
        bench = self.bench()
        if self.robot.watchdog_s >= NEVER_S:
            said = any(isinstance(each, Noted) and "watchdog" in each.text for each in bench.events)
            return whether(
                said,
                "the profile has no watchdog_s, and the driver gives no notice of it",
                "return Noted('... has no watchdog: ...') with Connected",
            )
        bench.drive(self.v, 0.0, 3.0)
        limits, watchdog_s = self.robot.limits, self.robot.watchdog_s
        ramp_s = self.v / limits.v_decel
        bench.run(watchdog_s + 1.2 * ramp_s + 0.3, calls=False, answers=False)
        v = bench.truth.v
        return whether(
            abs(v) < 0.02,
            f"{v:.2f} m/s after its driver hung for longer than watchdog_s = {watchdog_s:g}",
            "leave watchdog_s out of the profile if the robot has none",
        )

    def check_drives_on_while_it_is_ordered_to(self) -> Judgement:
        """It drives on while it is ordered to in each cycle, beyond the watchdog's time."""
        bench = self.bench()
        seconds = min(self.robot.watchdog_s, 5.0) + 3.0
        bench.drive(self.v, 0.0, seconds)
        v = bench.truth.v
        return whether(abs(v - self.v) < 0.15 * self.v + 0.02, f"{v:.2f} m/s after {seconds:g} s")

    def check_is_at_rest_after_its_driver_ends(self) -> Judgement:
        """`close` stops the wheels."""
        bench = self.bench()
        bench.drive(self.v, self.w, 2.0)
        bench.close()
        limits = self.robot.limits
        ramp_s = max(self.v / limits.v_decel, self.w / limits.w_decel)
        bench.run(1.2 * ramp_s + 0.5, calls=False, answers=False)  # less than a watchdog's time
        true = bench.truth
        still = abs(true.v) < 0.02 and abs(true.w) < 0.05
        return whether(still, f"drives on at {true.v:.2f} m/s, {true.w:.2f} rad/s")

    def check_refuses_orders_that_are_no_numbers(self) -> Judgement:
        """NaN and infinity are refused with an error, and nothing moves."""
        bench = self.bench()
        for v, w in ((float("nan"), 0.0), (0.0, inf)):
            try:
                bench.session.drive(v, w)
            except (ValueError, OverflowError):
                continue
            return no(f"drive({v}, {w}) was accepted", "call armadico.bridge.ramps.finite")
        bench.run(1.0)
        return whether(abs(bench.truth.v) < 0.01, f"moves at {bench.truth.v:.2f} m/s")

    # The line -------------------------------------------------------------------------------------

    def check_survives_damaged_bytes(self) -> Judgement:
        """With bytes changed, lost and added it goes on, counts them, and keeps its pose."""
        bench, chance = self.bench(), random.Random(1)
        bench.through = lambda data: _damaged(data, chance)
        for _ in range(5):
            bench.drive(self.v, 0.0, 2.0)
            bench.drive(0.0, self.w, 2.0)
        bench.through = lambda data: [data] if data else []
        bench.drive(0.0, 0.0, 3.0)
        line = bench.session.line
        counted = line.dropped + line.mangled + line.malformed + line.absurd
        return all_of(
            (
                _finite(bench),
                whether(bench.session.is_open, "the link is lost for good"),
                whether(counted > 0, "no damaged byte was counted in `line`"),
                # Frames may be lost, so a turn between two others is known less well.
                _agrees(bench, way=10.0 * self.v, angle=10.0 * self.w, times=3.0),
            )
        )

    def check_survives_late_bytes(self) -> Judgement:
        """Bytes that come one by one, or together after half a second, give the same pose."""
        poses = []
        for way in ("at once", "one by one", "late"):
            bench = self.bench()
            kept = bytearray()

            def delayed(data: bytes, kept: bytearray = kept) -> list[bytes]:
                kept += data
                if round(bench.now / STEP_S) % 25:  # noqa: B023 - of this turn of the loop
                    return []
                found = [bytes(kept)]
                kept.clear()
                return found

            if way == "one by one":
                bench.through = lambda data: [data[k : k + 1] for k in range(len(data))]
            elif way == "late":
                bench.through = delayed
            bench.drive(self.v, self.w, 4.0)
            bench.drive(0.0, 0.0, 3.0)
            poses.append((way, _agrees(bench, way=4.0 * self.v, angle=4.0 * self.w)))
        return all_of(
            each if each.passed else no(f"bytes {way}: {each.reason}") for way, each in poses
        )

    def check_survives_a_burst(self) -> Judgement:
        """After its process hung for 3 s it reports where the robot is now, and not all before."""
        bench = self.bench()
        bench.drive(self.v, 0.0, 2.0)
        kept = bytearray()

        def keep(data: bytes) -> list[bytes]:
            kept.extend(data)
            return []

        bench.through = keep
        bench.run(3.0, calls=False)
        bench.through = lambda data: [data] if data else []
        before = len(bench.reports)
        bench._note(bench.session.receive(bytes(kept), bench.now))
        count = len(bench.reports) - before
        bench.drive(0.0, 0.0, 4.0)
        return all_of(
            (
                whether(
                    count <= MOST_AT_ONCE,
                    f"{count} reports from one call delay a stop",
                    "return the newest report, and count the others in `line.surplus`",
                ),
                whether(bench.session.is_open, "it did not open the robot again"),
                _agrees(bench, way=6.0 * self.v, angle=0.5, times=2.0),
            )
        )

    def check_finds_that_the_robot_is_silent_and_back(self) -> Judgement:
        """A silent robot is not open within 3 s, and open again soon after it answers."""
        bench = self.bench()
        bench.run(3.0, answers=False)
        kinds = {type(event) for event in bench.events}
        lost = not bench.session.is_open and kinds & {LinkLost, Unanswered}
        bench.run(OPENS_S)
        return all_of(
            (
                whether(
                    bool(lost),
                    "silent for 3 s, and still open, or neither LinkLost nor"
                    " Unanswered was returned",
                ),
                whether(bench.session.is_open, f"not open {OPENS_S:g} s after it answered again"),
            )
        )

    def check_continues_when_the_controller_restarts(self) -> Judgement:
        """A controller that was off and counts from 0 does not move the pose, and is driven."""
        found = []
        for what in ("the port was opened again", "it was silent for 3 s"):
            bench = self.bench()
            bench.drive(self.v, 0.0, 3.0)
            bench.drive(0.0, 0.0, 3.0)
            before = bench.last.pose
            bench.exchange()
            if what.startswith("the port"):
                bench.restart()
            else:
                bench.run(3.0, answers=False)
            bench.run(OPENS_S)
            after = bench.last.pose
            jump = hypot(after.x - before.x, after.y - before.y)
            bench.drive(self.v, 0.0, 2.0)
            found += [
                whether(jump < 0.1, f"the pose jumps by {jump:.2f} m when {what}"),
                whether(
                    abs(bench.truth.v - self.v) < 0.15 * self.v + 0.02,
                    f"ordered {self.v:.2f} m/s, drives {bench.truth.v:.2f} after {what}",
                ),
            ]
        return all_of(found)

    # The truth ------------------------------------------------------------------------------------

    def check_counts_a_collision(self) -> Judgement:
        """Driven into a wall that the kit put there, it is held by it, and counts one collision."""
        body = self.robot.body
        with _walled(body.front_m + 0.6) as (world, wall_x):
            bench = self.bench(world)
            seconds = 0.6 / self.v + 3.0
            bench.drive(self.v, 0.0, seconds)
            true = bench.truth
        front = true.x + body.front_m * cos(true.theta)
        if front > wall_x + 0.05:
            return no(f"it drove {front - wall_x:.2f} m through a wall")
        if front < wall_x - 0.05:
            return unknown(f"it stopped {wall_x - front:.2f} m before the wall, so none was tried")
        return all_of(
            (
                whether(
                    true.collisions == 1,
                    f"it stands at the wall, and {true.collisions} collisions are counted",
                    "count contacts in the simulator (`Plant.touches`)",
                ),
                whether(
                    None if true.clearance is None else true.clearance < 0.03,
                    f"it stands at the wall with a clearance of {true.clearance}",
                ),
            )
        )

    def check_drives_a_scenario_with_all_agents(self) -> Judgement:
        """`sc1` is reached without a collision, and the run knows that there was none."""
        from armadico.launch.api import run

        done = run(self.scenario, virtual=True, seed=1, sensors="ideal", profile=str(self.profile))
        result = done.measures
        return all_of(
            (
                whether(result.reached, f"{self.scenario}: {result.outcome}"),
                whether(
                    None if result.collisions is None else result.collisions == 0,
                    f"{self.scenario}: collisions {_said(result.collisions)}",
                    "the simulator's truth has to reach the run (docs/own-robot.md)",
                ),
            )
        )


def _said(count: int | None) -> str:
    return "unknown" if count is None else str(count)


def _finite(bench: Bench) -> Judgement:
    """Whether every number of every report is one."""
    for report in bench.reports:
        pose = report.pose
        numbers = {
            "pose.x": pose.x,
            "pose.y": pose.y,
            "pose.theta": pose.theta,
            "v": report.v,
            "w": report.w,
            "battery_v": report.battery_v,
            **{f"echoes[{index}]": distance for index, distance in report.echoes},
        }
        for name, value in numbers.items():
            if not isfinite(value):
                return no(f"a report has {name} = {value}", "leave out what is not known")
    return yes()


def _agrees(bench: Bench, way: float, angle: float, times: float = 1.0) -> Judgement:
    """Whether the odometry's pose is the true one, after a way (m) and turns (rad)."""
    pose, true = bench.last.pose, bench.truth
    off = hypot(pose.x - true.x, pose.y - true.y)
    turned = abs(remainder(pose.theta - true.theta, tau))
    most_turn = times * (ODOMETRY * angle + 0.02)
    most = times * (ODOMETRY * way + 0.02) + way * most_turn
    return all_of(
        (
            whether(
                off < most,
                f"the odometry is {off:.2f} m off after {way:.1f} m; expected less than {most:.2f}",
                "compare the counts per metre",
            ),
            whether(
                turned < most_turn,
                f"the heading is {turned:.2f} rad off; expected less than {most_turn:.2f}",
                "compare half_track_m",
            ),
        )
    )


def _points(profile: RobotProfile, reports: list[Reported]) -> Iterator[tuple[float, float]]:
    """The points that reports show, in the body's frame, m."""
    ring = profile.sonar
    for report in reports:
        for index, distance in report.echoes:
            if ring is not None and distance < 0.999 * ring.max_m:
                x, y, bearing = ring.sonars[index].place
                if abs(bearing) < radians(20.0):
                    yield x + distance * cos(bearing), y + distance * sin(bearing)
    scan = next((each.scan for each in reversed(reports) if each.scan is not None), None)
    if scan is not None:
        from armadico.core.messages import Cycle

        message = message_of(
            Cycle(1, 1), scan.ranges, (scan.first, scan.step), (scan.least, scan.most), scan.mount,
            upside_down=scan.upside_down, since=scan.since, number=scan.number,
        )  # fmt: skip
        yield from ((float(x), float(y)) for x, y in points_of(message))


def _damaged(data: bytes, chance: random.Random) -> list[bytes]:
    """The bytes with one in a few hundred changed, lost or added."""
    out = bytearray()
    for byte in data:
        drawn = chance.random()
        if drawn < 0.0005:
            continue
        out.append(chance.randrange(256) if drawn < 0.0015 else byte)
        if drawn > 0.9995:
            out.append(chance.randrange(256))
    return [bytes(out)] if out else []


@contextmanager
def _walled(x: float) -> Iterator[tuple[str, float]]:
    """A world with one wall across the way, and its x, m (whole millimetres)."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "wall.map"
        file.write_text(WALL.format(x=round(1000.0 * x)), encoding="utf-8")
        yield str(file), round(x, 3)
