"""The robot agent with a robot that speaks ROS 2: the same promises, over another line."""

from __future__ import annotations

import random
import subprocess
import sys

import numpy as np
import pytest

from armadico.bridge.robot import Parameters, Robot
from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode
from armadico.bridge.ros2.frames import Decoder, Seen, control_frame, frame
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.core.agent import Identity
from armadico.core.config_errors import ConfigError
from armadico.core.cycles import LISTEN
from armadico.core.messages import (
    Ballot,
    Command,
    Description,
    Log,
    LogEvent,
    Message,
    RobotState,
    Stop,
)
from armadico.core.outgoing import Publish, Write
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Scan, Sonar
from armadico.mobile.scans import bearings_of, points_of, ranges_of
from tests.ros2.kit import JACKAL
from tests.ros2.robot import CLOCK_S, hazards, odometry, ranged, scan

BALLOT = Ballot(5, 0.6, False, "goto-1")


class Bench:
    """The agent, what the robot publishes each 20 ms, and the time."""

    def __init__(self, profile: str = "jackal", seed: int = 1) -> None:
        identity = Identity("robot-1", rng=random.Random(seed))
        self.agent = Robot(identity, Parameters(port="memory:", profile=profile))
        assert isinstance(self.agent.profile, Ros2Robot)
        self.ros2 = self.agent.profile.ros2
        self.now = 0.0
        self.speeds = (0.0, 0.0)
        self.x = 0.0
        self.published: list[Message] = []
        self.commands: list[tuple[float, float, float]] = []
        self.decoder = Decoder()
        self.ranges: list[float] | None = [2.0] * 21
        self.step = 0.1
        self.agent.kernel.start(0.0)
        self.agent.kernel.on_link(True, "", 0.0)
        self.take()

    def take(self) -> None:
        for item in self.agent.kernel.outbox:
            if isinstance(item, Publish):
                self.published.append(item.message)
            elif isinstance(item, Write):
                for topic, payload in self.decoder.feed(item.data, self.now):
                    if topic == "cmd_vel":
                        if self.ros2.stamped:
                            twist = decode(types.TwistStamped, payload).twist
                        else:
                            twist = decode(types.Twist, payload)
                        self.commands.append((self.now, twist.linear.x, twist.angular.z))
        self.agent.kernel.outbox.clear()

    def raw(self, data: bytes) -> None:
        self.agent.kernel.on_bytes(data, self.now)
        self.take()

    def go(
        self, seconds: float, *, silent: bool = False, command: tuple[float, float] = ()
    ) -> None:
        """Let time pass; a holder commands in each cycle, if there is a command.

        The wheels then obey.
        """
        for _ in range(round(seconds * 100)):
            self.now = round(self.now + 0.01, 6)
            if round(self.now * 100) % 2 == 0 and not silent:
                self.x += 0.02 * self.speeds[0]
                if self.ranges is not None and round(self.now * 100) % 4 == 0:
                    data = scan(CLOCK_S + self.now, self.ranges, step=self.step, most=30.0)
                    assert self.ros2.scan is not None
                    self.raw(frame(self.ros2.scan.name, data))
                v, w = self.speeds
                if command and self.commands:
                    v, w = self.speeds = self.commands[-1][1:]
                data = odometry(CLOCK_S + self.now, x=self.x, v=v, w=w)
                cycles = len(self.all(RobotState))
                self.raw(frame(self.ros2.odom.name, data))
                if command and len(self.all(RobotState)) > cycles:
                    self.command(*command)
            due = self.agent.kernel.wakeup
            if due is not None and self.now >= due:
                self.agent.kernel.wake(self.now)
                self.take()

    def command(self, v: float, w: float = 0.0, ballot: Ballot = BALLOT) -> None:
        self.hand(Command("wheels", self.all(RobotState)[-1].cycle, ballot, (v, w)))

    def hand(self, message: Message) -> None:
        self.agent.kernel.receive(message, self.now)
        self.take()

    def all(self, kind: type) -> list:
        return [m for m in self.published if isinstance(m, kind)]

    def logs(self) -> str:
        return "\n".join(m.text for m in self.all(Log))


@pytest.fixture
def ready() -> Bench:
    bench = Bench()
    bench.go(0.1 * (LISTEN + 3))
    return bench


def test_its_cycles_are_published_ten_times_a_second_with_the_pose(ready: Bench) -> None:
    count = len(ready.all(RobotState))
    ready.speeds = (0.5, 0.1)
    ready.go(2.0)
    states = ready.all(RobotState)
    assert len(states) - count == pytest.approx(20, abs=1)
    assert states[-1].x == pytest.approx(1.0, abs=0.06)
    assert (states[-1].v, states[-1].w) == (0.5, 0.1)
    assert "connected to" in ready.logs()


def test_its_scans_are_where_the_laser_was(ready: Bench) -> None:
    scan = ready.all(Scan)[-1]
    assert scan.cycle == ready.all(RobotState)[-1].cycle
    assert np.allclose(ranges_of(scan), 2.0, atol=1e-3)
    assert bearings_of(scan)[0] == pytest.approx(-1.0)
    assert points_of(scan)[10] == pytest.approx((2.12, 0.0), abs=0.01)


def test_a_scan_is_moved_by_what_the_robot_has_driven_since(ready: Bench) -> None:
    ready.speeds = (1.0, 0.0)
    ready.ranges = None
    ready.go(0.04)
    ready.raw(frame("sensors/lidar2d_0/scan", scan(CLOCK_S + ready.now, [2.0] * 21, most=30.0)))
    ready.go(0.16)
    last = ready.all(Scan)[-1]
    late = ready.all(RobotState)[-1]
    assert 0.12 - 0.2 <= last.x < 0.12
    assert late.v == 1.0


def test_silence_of_the_holder_is_zero_after_300_ms(ready: Bench) -> None:
    ready.go(1.0, command=(0.6, 0.0))
    ready.speeds = (0.6, 0.0)
    begun = ready.now
    ready.go(1.0)
    slower = next(at for at, v, _ in ready.commands if at > begun and v < 0.6)
    assert slower - begun <= 0.3 + 0.02
    assert ready.commands[-1][1:] == (0.0, 0.0)


def test_a_stop_is_zero_and_no_command_is_obeyed_until_the_release(ready: Bench) -> None:
    ready.go(1.0, command=(0.6, 0.0))
    ready.hand(Stop(1, stopped=True, by="somebody", press=7))
    ready.go(1.0, command=(0.6, 0.0))
    assert ready.commands[-1][1:] == (0.0, 0.0)
    assert ready.all(RobotState)[-1].stop.stopped
    ready.hand(Stop(2, stopped=False, by="somebody", press=7))
    ready.go(1.0, command=(0.6, 0.0))
    assert ready.commands[-1][1] == 0.6


def test_a_robot_that_falls_silent_gets_no_commands_and_is_found_again(ready: Bench) -> None:
    ready.go(1.5, silent=True)
    assert "no odometry for 1.0 s" in ready.logs()
    commands = len(ready.commands)
    ready.command(0.6)
    assert [v for _, v, _ in ready.commands[commands:]] == []
    ready.go(0.6)
    assert ready.logs().count("connected to") == 2
    ready.go(1.0, command=(0.6, 0.0))
    assert ready.commands[-1][1] == 0.6


def test_a_laser_that_stops_is_stale_and_reported(ready: Bench) -> None:
    count = len(ready.all(Scan))
    ready.ranges = None
    ready.go(1.5)
    assert len(ready.all(Scan)) - count <= 2
    assert "no scan on sensors/lidar2d_0/scan for 4 cycles" in ready.logs()


def test_widely_spaced_rays_limit_the_speed_and_the_state_says_why() -> None:
    bench = Bench()
    bench.step = 0.7
    bench.ranges = [20.0] * 8
    bench.go(0.1 * (LISTEN + 3))
    assert bench.all(Description)[-1].v_max == JACKAL.limits.v_max
    commands = len(bench.commands)
    bench.go(2.0, command=(JACKAL.limits.v_max, 1.0))
    top, turn = bench.commands[-1][1:]
    assert (top >= 0.1, turn) == (True, 1.0)
    assert max(v for _, v, _ in bench.commands[commands:]) < 0.5 * JACKAL.limits.v_max
    assert "not seen to be free" in {state.capped for state in bench.all(RobotState)[-5:]}


def test_a_robot_that_is_otherwise_than_its_profile_is_doubted_and_driven() -> None:
    bench = Bench()
    bench.go(1.0)
    assert "8 rays" not in bench.logs()
    assert "21 rays" in bench.logs()
    assert "21 rays" in bench.agent.kernel.card().doubts
    assert bench.agent.unavailable(WHEELS) == ""


def test_a_missing_watchdog_is_reported() -> None:
    bench = Bench("turtlebot3-burger")
    bench.raw(frame("odom", odometry(CLOCK_S)))
    assert "has no watchdog" in bench.logs()


@pytest.mark.parametrize("port", ["ros2://", "ros2+zenoh://10.0.0.7"])
def test_a_robot_of_p2os_is_not_looked_for_among_ros_2s(port: str) -> None:
    with pytest.raises(ConfigError, match="robot = 'turtlebot4'"):
        Robot(Identity("robot-1", rng=random.Random(1)), Parameters(port=port))


def test_a_robot_that_was_started_again_does_not_drive_off(ready: Bench) -> None:
    ready.go(3.0, command=(0.6, 0.0))
    assert ready.x > 0.5
    ready.go(2.0, silent=True)
    ready.x, ready.speeds, begun = 0.0, (0.0, 0.0), ready.now
    ready.go(2.0, command=(0.6, 0.0))
    assert {each[1:] for each in ready.commands if each[0] > begun} <= {(0.0, 0.0)}
    assert ready.all(RobotState)[-1].stop.stopped


# --- more than a laser


def test_sonars_and_a_laser_are_published_together_each_with_its_mount() -> None:
    bench = Bench("jackal-sonars")
    for _ in range(10):
        for k in range(8):
            bench.raw(frame("sonar", ranged(f"sonar_{k}", CLOCK_S + bench.now, 1.0 + k)))
        bench.go(0.1)
    described = bench.all(Description)[-1]
    assert described.sensors == ("sonar", "laser")
    assert (described.cone, described.nearest) == (pytest.approx(0.5236, abs=1e-4), 0.1)
    sonar, scan = bench.all(Sonar)[-1], bench.all(Scan)[-1]
    assert abs(sonar.cycle.number - scan.cycle.number) <= 1
    (ahead,) = (echo for echo in sonar.echoes if (echo.x, echo.y) == (0.25, 0.035))
    assert ahead.range == 4.0
    assert {echo.range for echo in sonar.echoes} == {1.0, 2.0, 3.0, 4.0, None}  # 5 m is the most


def felt(kind: int) -> Bench:
    """A Create 3 that drives ahead, and feels something; it drives on if it is let."""
    bench = Bench("create3")
    bench.go(0.1 * (LISTEN + 3))
    bench.go(1.5, command=(0.2, 0.0))
    assert bench.commands[-1][1] == 0.2
    for _ in range(10):
        bench.raw(frame("hazard_detection", hazards((kind, "front"))))
        bench.go(0.1, command=(0.2, 0.0))
    return bench


@pytest.mark.parametrize("kind", [types.BUMP, types.CLIFF, types.STALL])
def test_a_bumper_and_a_cliff_stop_it_as_a_pioneers_bumpers_do(kind: int) -> None:
    bench = felt(kind)
    assert bench.commands[-1][1:] == (0.0, 0.0)
    state = bench.all(RobotState)[-1]
    assert state.stalled
    assert state.touch is not None
    assert state.touch.x == pytest.approx(0.171)
    assert not state.stop.stopped
    assert "touched an obstacle ahead" in bench.logs()
    bench.go(1.0, command=(-0.1, 0.0))  # away from it
    assert bench.commands[-1][1] == pytest.approx(-0.1)


def test_one_that_backs_no_farther_is_driven_ahead_and_not_back() -> None:
    bench = felt(types.BACKUP_LIMIT)
    assert bench.commands[-1][1] == 0.2
    assert "limit of backing" in bench.logs()


def test_one_that_is_lifted_is_stopped_until_it_is_released() -> None:
    bench = felt(types.WHEEL_DROP)
    assert bench.commands[-1][1:] == (0.0, 0.0)
    assert "a wheel of the robot hanging in the air" in bench.logs()
    bench.go(2.0, command=(0.2, 0.0))  # put down again
    assert bench.commands[-1][1:] == (0.0, 0.0)
    assert bench.all(RobotState)[-1].stop.stopped


# --- an agent that was stopped for a while


@pytest.mark.parametrize("first", ["wake", "bytes", "command"])
@pytest.mark.parametrize("paused", [0.31, 0.4, 0.55, 0.7, 3.0])
@pytest.mark.parametrize("climbing", [False, True])
def test_after_a_pause_beyond_the_silence_nothing_old_is_sent(
    ready: Bench, first: str, paused: float, climbing: bool
) -> None:
    """Whatever waited for it meanwhile and comes first: from its first word on it slows down."""
    ready.go(0.5 if climbing else 2.0, command=(1.8, 0.0))
    before, cycle = ready.commands[-1][1], ready.all(RobotState)[-1].cycle
    assert (before < 1.8) is climbing
    ready.now, commands = round(ready.now + paused, 6), len(ready.commands)
    if first == "command":
        ready.hand(Command("wheels", cycle, BALLOT, (1.8, 0.0)))
    elif first == "bytes":
        data = odometry(CLOCK_S + ready.now - paused + 0.1, x=ready.x, v=before)
        ready.raw(frame(ready.ros2.odom.name, data))
    ready.agent.kernel.wake(ready.now)
    ready.take()
    ready.go(1.5)
    speeds = [v for _, v, _ in ready.commands[commands:]]
    assert speeds[0] < before
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == 0.0


WITHOUT = """
import importlib.util, sys
sys.modules["pycdr2"] = None
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "pycdr2" else found(name, *rest)
from armadico.cli import main
sys.exit(main(sys.argv[1:]))
"""
"""A command where the module of the extra `ros2` is not installed."""


def without(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_without_the_extra_a_pioneer_drives_and_a_jackal_names_the_package() -> None:
    run = ("run", "sc1", "--virtual", "--goal", "0.5", "0", "0", "--profile")
    pioneer, jackal = (without(*run, name) for name in ("pioneer-2dx", "jackal"))
    assert pioneer.returncode == 0, pioneer.stderr
    assert jackal.returncode == 2, "its configuration is at fault"
    assert "[ros2] in its profile needs the module pycdr2" in jackal.stderr
    assert "pip install 'armadico[ros2]'" in jackal.stderr
    assert len(jackal.stderr.splitlines()) == 1


def test_without_the_extra_the_gateway_names_the_package() -> None:
    done = without("ros2", "--world", "sc1")
    assert done.returncode == 1
    assert "pip install 'armadico[ros2]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_base_that_does_not_read_its_commands_is_not_driven_and_says_why(ready: Bench) -> None:
    why = "/base reads /cmd_vel as Twist"
    ready.raw(control_frame(Seen("/base", unread=why)))
    ready.go(0.5, command=(0.3, 0.0))
    assert ready.commands[-1][1:] == (0.0, 0.0)
    assert ready.all(RobotState)[-1].fault == why
    assert ready.agent.kernel.card().fault == why
    assert [log.text for log in ready.all(Log) if log.event == LogEvent.UNFIT] == [
        f"no command reaches the robot: {why}"
    ]
    ready.raw(control_frame(Seen("/base")))
    ready.go(1.0, command=(0.3, 0.0))
    assert ready.commands[-1][1] == 0.3
    assert not ready.all(RobotState)[-1].fault


def test_a_name_that_comes_late_is_no_other_robot_and_another_name_is_reported() -> None:
    bench = Bench()
    bench.go(0.5)
    assert not bench.all(Description)[-1].controller
    bench.raw(control_frame(Seen("/base")))
    bench.go(0.5)
    assert bench.all(Description)[-1].controller == "/base"
    bench.go(1.5, silent=True)
    bench.raw(control_frame(Seen()))
    bench.go(0.5)
    bench.raw(control_frame(Seen("/base")))
    bench.go(0.5)
    assert "is it the same robot" not in bench.logs()
    bench.raw(control_frame(Seen("/base_2")))
    assert "it was /base (ros 2) before: is it the same robot" in bench.logs()
