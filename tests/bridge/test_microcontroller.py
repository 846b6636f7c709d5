"""The simulated controller behaves as a Pioneer's does."""

from __future__ import annotations

import itertools
import math
import tomllib
from importlib.resources import files

import msgspec
import pytest

from armadico.bridge.p2os.commands import (
    SYNC0,
    SYNC1,
    SYNC2,
    Cmd,
    command,
    set_pose,
    wheel_bits,
)
from armadico.bridge.p2os.configuration import (
    CONFIG,
    ENCODER,
    Encoders,
    decode_configuration,
    decode_encoders,
)
from armadico.bridge.p2os.packets import Decoder, encode
from armadico.bridge.p2os.status import Status, decode_status
from armadico.bridge.profile import RobotProfile, SensorProfile
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant, seeded
from armadico.bridge.simulator.speed_loops import SpeedLoops

DEGREE = math.pi / 180


class Lagging:
    """Wheels that follow the speeds set with a first-order lag of 0.2 s."""

    step_s = 0.005
    lag_s = 0.2

    def __init__(self) -> None:
        self.v = self.w = 0.0
        self.odometry = (0.0, 0.0, 0.0)
        self.encoder_counts = (12, -34)
        self.battery_v = 12.7
        self.blocked = False
        self.pings: list[int] = []
        self.echo: float | None = 1.5
        self.true_pose = (0.0, 0.0, 0.0)
        self.resets = 0

    @property
    def left_m_s(self) -> float:
        return self.v - self.w * 0.1689

    @property
    def right_m_s(self) -> float:
        return self.v + self.w * 0.1689

    def step(self, v: float, w: float) -> None:
        share = self.step_s / self.lag_s
        self.v += (v - self.v) * share
        self.w += (w - self.w) * share
        if abs(self.v) < 1e-4:
            self.v = 0.0
        if abs(self.w) < 1e-4:
            self.w = 0.0
        x, y, theta = self.odometry
        theta += self.w * self.step_s
        way = self.v * self.step_s
        self.odometry = (x + way * math.cos(theta), y + way * math.sin(theta), theta)

    def reset(self) -> None:
        self.resets += 1

    def voltages(
        self, v_set: float, w_set: float, v: float, w: float, dt: float
    ) -> tuple[float, float]:
        return v_set, w_set

    def reset_odometry(self) -> None:
        self.odometry = (0.0, 0.0, 0.0)

    def set_pose(self, x: float, y: float, theta: float) -> None:
        self.true_pose = (x, y, theta)

    def ping(self, index: int) -> float | None:
        self.pings.append(index)
        return self.echo


class Bench:
    """A controller, and hands to type commands with."""

    def __init__(self, profile: RobotProfile) -> None:
        self.profile = profile
        self.plant = Lagging()
        self.controller = Microcontroller(profile, self.plant, self.plant)
        self.decoder = Decoder()
        self.now = 0.0

    def send(self, cmd: Cmd, value: int | bytes | None = None) -> None:
        self.controller.receive(command(cmd, value))

    def run(self, seconds: float) -> list[bytes]:
        self.now = round(self.now + seconds, 9)
        return self.decoder.feed(self.controller.advance(self.now))

    def watched(self, seconds: float) -> list[Status]:
        """Run with a pulse each 0.1 s; the status packets of that time."""
        statuses = []
        for _ in range(round(seconds * 10)):
            self.send(Cmd.PULSE)
            statuses += [p for p in self.run(0.1) if p[0] in {0x32, 0x33}]
        return [decode_status(payload, self.profile.p2os) for payload in statuses]

    def connect(self, *, motors: bool = True) -> None:
        for packet in (SYNC0, SYNC1, SYNC2, command(Cmd.OPEN)):
            self.controller.receive(packet)
        if motors:
            self.send(Cmd.ENABLE, 1)
        self.run(0)


@pytest.fixture
def profile() -> RobotProfile:
    text = (files("armadico.configs") / "robots" / "pioneer-2dx.toml").read_bytes()
    return msgspec.toml.decode(text, type=RobotProfile)


@pytest.fixture
def bench(profile: RobotProfile) -> Bench:
    return Bench(profile)


@pytest.fixture
def robot(bench: Bench) -> Bench:
    bench.connect()
    return bench


def test_sync_packets_are_answered_in_order_and_the_last_names_the_robot(bench: Bench) -> None:
    for packet in (SYNC0, SYNC1, SYNC2):
        bench.controller.receive(packet)
    assert bench.run(0) == [b"\x00", b"\x01", b"\x02Armadico\0Pioneer\0p2dx\0"]


def test_sync_packets_out_of_order_start_again_at_sync0(bench: Bench) -> None:
    for packet in (SYNC0, SYNC2, SYNC1, SYNC2):
        bench.controller.receive(packet)
    assert bench.run(0) == [b"\x00"]
    for packet in (SYNC0, SYNC1, SYNC2):
        bench.controller.receive(packet)
    assert [payload[0] for payload in bench.run(0)] == [0, 1, 2]


def test_a_sync_with_a_bad_checksum_is_not_answered(bench: Bench) -> None:
    bench.controller.receive(SYNC0[:-1] + b"\x01")
    assert bench.run(0.1) == []


def test_before_open_there_is_no_status_and_the_configuration_is_given(bench: Bench) -> None:
    for packet in (SYNC0, SYNC1, SYNC2):
        bench.controller.receive(packet)
    bench.run(0)
    bench.send(Cmd.CONFIG, 1)
    (payload,) = bench.run(1.0)
    configuration = decode_configuration(payload)
    assert payload[0] == CONFIG
    assert configuration.name == "Armadico"
    assert configuration.auto_baud == 0
    assert configuration.v_max == pytest.approx(1.6)
    assert configuration.watchdog_s == pytest.approx(2.0)
    assert configuration.cycle_s == pytest.approx(0.1)


def test_once_open_a_status_comes_each_cycle(robot: Bench) -> None:
    assert robot.controller.next_status_s == pytest.approx(0.1)
    counts = [len(robot.run(0.05)) for _ in range(20)]
    assert counts == [0, 1] * 10


def test_after_connecting_sonar_are_on_and_motors_off(bench: Bench) -> None:
    bench.connect(motors=False)
    status = bench.watched(0.1)[0]
    assert status.sonar_on
    assert not status.motors_enabled
    assert status.flags == 0x1E


def test_speeds_asked_while_motors_are_off_are_not_remembered(bench: Bench) -> None:
    bench.connect(motors=False)
    bench.send(Cmd.VEL, 300)
    bench.send(Cmd.ENABLE, 1)
    assert bench.watched(1.0)[-1].left_m_s == 0


def test_speeds_ramp_and_arrive(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    speeds = [status.left_m_s for status in robot.watched(2.0)]
    assert max(b - a for a, b in itertools.pairwise(speeds)) <= 0.031
    assert speeds[-1] == pytest.approx(0.3, abs=0.002)
    assert [s.moving for s in robot.watched(0.1)] == [True]
    robot.send(Cmd.VEL, 0)
    stopped = robot.watched(2.0)[-1]
    assert (stopped.left_m_s, stopped.moving) == (0, False)


def test_linear_and_angular_speed_are_independent(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.send(Cmd.RVEL, -30)
    robot.watched(2.0)
    robot.send(Cmd.VEL, 200)
    robot.watched(2.0)
    assert (robot.plant.v, robot.plant.w / DEGREE) == pytest.approx((0.2, -30), abs=0.01)


def test_rotate_is_rvel(robot: Bench) -> None:
    robot.send(Cmd.ROTATE, 20)
    robot.watched(2.0)
    assert robot.plant.w == pytest.approx(20 * DEGREE, abs=0.001)


@pytest.mark.parametrize(("left", "right"), [(10, 10), (-10, 10), (5, 15), (-10, -10)])
def test_vel2_sets_each_wheel_in_steps_of_20_mm_s(robot: Bench, left: int, right: int) -> None:
    robot.send(Cmd.VEL2, wheel_bits(left, right))
    status = robot.watched(3.0)[-1]
    assert status.left_m_s == pytest.approx(left * 0.02, abs=0.002)
    assert status.right_m_s == pytest.approx(right * 0.02, abs=0.002)


@pytest.mark.parametrize("way", [500, -500, 40, 3000])
def test_move_drives_a_trapezoid_and_ends_on_its_goal(robot: Bench, way: int) -> None:
    robot.send(Cmd.SETV, 400)
    robot.send(Cmd.MOVE, way)
    speeds = [abs(status.left_m_s) for status in robot.watched(abs(way) / 400 + 5)]
    assert robot.plant.odometry[0] == pytest.approx(way / 1000, abs=0.006)
    assert max(speeds) <= 0.401
    assert speeds[-1] == 0
    if abs(way) == 3000:
        assert sum(speed > 0.38 for speed in speeds) > 45


@pytest.mark.parametrize(
    ("cmd", "value"), [(Cmd.MOVE, 500), (Cmd.MOVE, -1000), (Cmd.HEAD, 90), (Cmd.HEAD, -170)]
)
def test_the_servos_bring_the_real_robot_to_its_goal_without_overshoot(
    profile: RobotProfile, cmd: Cmd, value: int
) -> None:
    ideal = tomllib.loads((files("armadico.configs") / "robots" / "sensors.toml").read_text())
    sensors = msgspec.convert(ideal["ideal"], SensorProfile)
    plant = Plant(profile, sensors, [], (0.0, 0.0, 0.0), seeded(1))
    bench = Bench(profile)
    loops = SpeedLoops(profile.speed_loop, profile.motor.supply_v)
    bench.controller = Microcontroller(profile, plant, loops)
    bench.connect()
    bench.send(cmd, value)
    goal, track = abs(value * cmd.si), []
    for _ in range(80):
        bench.watched(0.1)
        track.append(abs(plant.odometry[0] if cmd is Cmd.MOVE else plant.odometry[2]))
    assert track[-1] == pytest.approx(goal, abs=0.01)
    assert max(track) < goal + 0.01
    assert plant.left_m_s == plant.right_m_s == 0


def test_a_speed_replaces_a_move(robot: Bench) -> None:
    robot.send(Cmd.MOVE, 3000)
    robot.watched(1.0)
    robot.send(Cmd.VEL, 0)
    robot.watched(3.0)
    assert robot.plant.odometry[0] < 0.5


@pytest.mark.parametrize("heading", [90, -90, 179, 270, 10])
def test_head_turns_the_short_way_to_an_absolute_heading(robot: Bench, heading: int) -> None:
    robot.send(Cmd.HEAD, heading)
    last = robot.watched(6.0)[-1]
    short = math.remainder(heading * DEGREE, math.tau)
    assert robot.plant.odometry[2] == pytest.approx(short, abs=0.6 * DEGREE)
    assert last.control_rad == pytest.approx(short, abs=0.002)


def test_a_heading_asked_again_each_cycle_restarts_nothing(profile: RobotProfile) -> None:
    tracks = []
    for again in (False, True):
        bench = Bench(profile)
        bench.connect()
        bench.send(Cmd.HEAD, 120)
        track = []
        for _ in range(50):
            if again:
                bench.send(Cmd.HEAD, 120)
            track.append(bench.watched(0.1)[0].theta_rad)
        tracks.append(track)
    assert tracks[1] == pytest.approx(tracks[0], abs=0.005)


def test_dhead_turns_from_the_heading_and_dchead_from_the_last_one_asked(robot: Bench) -> None:
    robot.send(Cmd.DHEAD, 30)
    robot.watched(0.3)
    robot.send(Cmd.DCHEAD, 15)
    robot.watched(5.0)
    assert robot.plant.odometry[2] == pytest.approx(45 * DEGREE, abs=0.6 * DEGREE)
    robot.send(Cmd.DHEAD, -45)
    robot.watched(5.0)
    assert robot.plant.odometry[2] == pytest.approx(0, abs=1.1 * DEGREE)


def test_a_reset_of_the_odometry_leaves_a_turn_under_way_alone(robot: Bench) -> None:
    robot.send(Cmd.HEAD, 90)
    robot.watched(1.0)
    turned = robot.plant.odometry[2]
    robot.send(Cmd.SETO)
    assert robot.watched(5.0)[-1].x_m == 0
    assert robot.plant.odometry[2] == pytest.approx(90 * DEGREE - turned, abs=0.6 * DEGREE)


def test_limits_and_ramps_can_be_set_and_never_exceed_the_profiles(robot: Bench) -> None:
    for cmd, value in ((Cmd.SETV, 500), (Cmd.SETA, 900), (Cmd.SETA, -800), (Cmd.SETRV, 40)):
        robot.send(cmd, value)
    robot.send(Cmd.SETRA, 50)
    robot.send(Cmd.SETRA, -60)
    robot.send(Cmd.SETA, 0)
    robot.send(Cmd.CONFIG, 1)
    configuration = decode_configuration(robot.run(0)[-1])
    assert (configuration.v_max, configuration.v_accel, configuration.v_decel) == (0.5, 0.9, 0.8)
    assert configuration.w_decel == pytest.approx(60 * DEGREE)
    robot.send(Cmd.VEL, 1000)
    robot.send(Cmd.RVEL, 100)
    robot.watched(2.0)
    assert robot.plant.v == pytest.approx(0.5, abs=0.001)
    assert robot.plant.w == pytest.approx(40 * DEGREE, abs=0.001)
    robot.send(Cmd.SETV, 30000)
    robot.send(Cmd.VEL, 30000)
    robot.watched(5.0)
    assert robot.plant.v == pytest.approx(1.6, abs=0.001)


def test_a_new_session_starts_with_the_profiles_limits(robot: Bench) -> None:
    robot.send(Cmd.SETV, 100)
    robot.send(Cmd.CLOSE)
    robot.connect()
    robot.send(Cmd.VEL, 300)
    robot.watched(3.0)
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)


@pytest.mark.parametrize("cmd", [Cmd.STOP, Cmd.E_STOP])
def test_both_stops_stop_and_leave_the_motors_on(robot: Bench, cmd: Cmd) -> None:
    robot.send(Cmd.VEL, 500)
    robot.watched(2.0)
    robot.send(cmd)
    status = robot.watched(2.5)[-1]
    assert (status.left_m_s, status.motors_enabled) == (0, True)


def test_an_emergency_stop_has_no_ramp_and_ignores_commands_until_the_robot_rests(
    robot: Bench,
) -> None:
    robot.send(Cmd.VEL, 500)
    robot.watched(3.0)
    robot.send(Cmd.E_STOP)
    robot.send(Cmd.VEL, 500)
    assert robot.watched(0.3)[-1].left_m_s < 0.12
    robot.send(Cmd.VEL, 500)
    robot.watched(2.0)
    assert robot.plant.v == 0
    robot.send(Cmd.VEL, 500)
    robot.watched(3.0)
    assert robot.plant.v == pytest.approx(0.5, abs=0.001)


def test_motors_switched_off_forget_what_was_asked(robot: Bench) -> None:
    robot.send(Cmd.VEL, 500)
    robot.watched(1.0)
    robot.send(Cmd.ENABLE, 0)
    robot.send(Cmd.ENABLE, 1)
    assert robot.watched(2.0)[-1].left_m_s == 0


def test_enabling_twice_disturbs_nothing(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.watched(2.0)
    robot.send(Cmd.ENABLE, 1)
    assert robot.watched(0.1)[-1].left_m_s == pytest.approx(0.3, abs=0.002)


def test_the_watchdog_ramps_to_a_stop_and_keeps_the_set_points(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.run(1.9)
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)
    assert len(robot.run(3.0)) == 30
    assert robot.plant.v == 0
    robot.send(Cmd.PULSE)
    robot.run(1.9)
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)


def test_the_watchdog_holds_a_move_and_a_pulse_lets_it_go_on(robot: Bench) -> None:
    robot.send(Cmd.MOVE, 3000)
    robot.run(6.0)
    assert robot.plant.v == 0
    assert robot.plant.odometry[0] < 2.0
    robot.watched(9.0)
    assert robot.plant.odometry[0] == pytest.approx(3.0, abs=0.006)


def test_even_an_unknown_command_feeds_the_watchdog(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    for _ in range(5):
        robot.run(1.5)
        robot.controller.receive(encode(b"\xde\x3b\x01\x00"))
    assert robot.plant.v == pytest.approx(0.3, abs=0.001)


def test_a_still_open_session_takes_sync_for_pulse_open_close_and_ends_closed(
    robot: Bench,
) -> None:
    robot.send(Cmd.VEL, 300)
    robot.run(1.0)
    for packet in (SYNC0, SYNC1, SYNC2):
        robot.controller.receive(packet)
    robot.run(0)
    assert not robot.controller.is_open
    assert robot.run(3.0) == []
    assert robot.plant.v == 0
    for packet in (SYNC0, SYNC1, SYNC2):
        robot.controller.receive(packet)
    assert [payload[0] for payload in robot.run(0)] == [0, 1, 2]


def test_a_connection_that_ends_stops_the_robot_and_frees_it(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.run(1.0)
    robot.controller.disconnect()
    assert robot.run(3.0) == []
    assert robot.plant.v == 0
    robot.connect()
    assert len(robot.run(1.0)) == 10


def test_sonars_fire_in_order_one_each_period_and_are_reported_once(robot: Bench) -> None:
    statuses = robot.watched(0.64)
    assert robot.plant.pings == list(robot.profile.sonar.firing_order * 2)[: len(robot.plant.pings)]
    assert len(robot.plant.pings) == 15
    reported = [index for status in statuses for index, _ in status.echoes]
    assert reported == robot.plant.pings


def test_no_echo_is_reported_as_the_maximum(robot: Bench) -> None:
    robot.plant.echo = None
    ((_, range_m), *_) = robot.watched(0.1)[0].echoes
    assert range_m >= robot.profile.sonar.max_m


def test_sonar_can_be_switched_as_a_whole_and_by_array(robot: Bench) -> None:
    robot.send(Cmd.SONAR, 6)
    assert robot.watched(0.1)[0].sonar_arrays == 0b1011
    robot.send(Cmd.SONAR, 0)
    (status,) = robot.watched(0.1)
    assert (status.sonar_arrays, status.echoes) == (0, ())
    robot.send(Cmd.SONAR, 1)
    assert robot.watched(0.2)[-1].echoes


def test_polling_sets_the_order_and_an_empty_one_is_off(robot: Bench) -> None:
    robot.send(Cmd.POLLING, bytes([8, 1, 99, 0]))
    robot.watched(0.2)
    assert robot.plant.pings[:4] == [7, 0, 7, 0]
    robot.send(Cmd.POLLING, b"")
    robot.plant.pings.clear()
    assert not robot.watched(0.3)[-1].sonar_on
    assert robot.plant.pings == []


def test_stall_is_reported_while_an_obstacle_holds_a_robot_that_wants_to_move(
    robot: Bench,
) -> None:
    robot.plant.blocked = True
    assert not robot.watched(0.1)[0].left_stall
    robot.send(Cmd.VEL, 300)
    (status,) = robot.watched(0.1)
    assert status.left_stall
    assert status.right_stall


def test_encoder_packets_come_once_or_before_each_status(robot: Bench) -> None:
    robot.send(Cmd.ENCODER, 1)
    assert [payload[0] for payload in robot.run(0.2)] == [ENCODER, 0x32, 0x32]
    robot.send(Cmd.ENCODER, 2)
    payloads = robot.run(0.2)
    assert [payload[0] for payload in payloads] == [ENCODER, 0x32] * 2
    assert decode_encoders(payloads[0]) == Encoders(12, -34)
    robot.send(Cmd.ENCODER, 0)
    assert [payload[0] for payload in robot.run(0.1)] == [0x32]


def test_digital_outputs_change_where_the_mask_says(robot: Bench) -> None:
    robot.send(Cmd.DIGOUT, 0xFF0F)
    robot.send(Cmd.DIGOUT, 0x1110)
    assert robot.watched(0.1)[0].digital_out == 0x1E


def test_a_pretended_battery_is_reported_until_zero(robot: Bench) -> None:
    robot.send(Cmd.BATTEST, 105)
    assert robot.watched(0.1)[0].battery_v == pytest.approx(10.5)
    robot.send(Cmd.BATTEST, 0)
    assert robot.watched(0.1)[0].battery_v == pytest.approx(12.7)


def test_a_simulated_robot_can_be_put_elsewhere(robot: Bench) -> None:
    robot.controller.receive(set_pose(1.5, -2.0, math.pi / 2))
    assert robot.plant.true_pose == pytest.approx((1.5, -2.0, math.pi / 2))
    robot.controller.receive(encode(b"\xe0\x3b\x01"))
    assert robot.plant.true_pose[0] == pytest.approx(1.5)


def test_players_malformed_seto_is_obeyed(robot: Bench) -> None:
    robot.send(Cmd.VEL, 300)
    robot.watched(1.0)
    robot.send(Cmd.STOP)
    robot.watched(2.0)
    robot.controller.receive(encode(b"\x07\x3b"))
    assert robot.watched(0.1)[0].x_m == 0


def test_the_same_bytes_at_the_same_times_give_the_same_bytes(profile: RobotProfile) -> None:
    def run(step: float) -> bytes:
        bench = Bench(profile)
        bench.connect()
        bench.send(Cmd.VEL, 400)
        bench.send(Cmd.HEAD, 77)
        return b"".join(bench.controller.advance(n * step) for n in range(1, round(3 / step) + 1))

    assert run(0.1) == run(0.005) == run(3.0)
