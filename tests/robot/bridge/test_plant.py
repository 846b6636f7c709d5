"""The simulated Pioneer among walls: it stops at them, counts them, and gets off them."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, degrees, hypot, inf, pi, radians, sin
from random import Random

import msgspec
import pytest

from armadico.bridge.simulator.encoders import TICKS_PER_M
from armadico.bridge.simulator.plant import Plant, Site, seeded
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.bridge.simulator.walls import Wall
from armadico.config.profile import SensorProfile
from armadico.core.config_errors import ConfigError
from armadico.mobile.geometry import Pose2, compose
from tests.robot.bridge.kit import HOME, IDEAL, PROFILE, REAL

FRONT, REAR, SIDE = PROFILE.body.front_m, PROFILE.body.rear_m, PROFILE.body.width_m / 2
PENETRATION_M = 0.001  # no corner is ever farther behind a wall
AHEAD = 3  # the sonar
DOCK = (2.0, -1.0, pi / 2)
ROOM = [
    (-2.0, -2.0, 4.0, -2.0),
    (4.0, -2.0, 4.0, 2.0),
    (4.0, 2.0, -2.0, 2.0),
    (-2.0, 2.0, -2.0, -2.0),
]


def plant(
    walls: list[Wall] | None = None,
    start: tuple[float, float, float] = HOME,
    sensors: SensorProfile = IDEAL,
    seed: int = 1,
) -> Plant:
    return Plant(PROFILE, sensors, Site(walls or [], start), seeded(seed))


def drive(
    robot: Plant,
    v: float,
    w: float,
    seconds: float,
    each: Callable[[], object] = lambda: None,
    pi: SpeedLoops | None = None,
) -> None:
    """Closed loop at set-points."""
    pi = pi or SpeedLoops(PROFILE.speed_loop, PROFILE.motor.supply_v)
    for _ in range(round(seconds / robot.step_s)):
        robot.step(*pi.voltages(v, w, robot.v, robot.w, robot.step_s))
        each()


def corners(robot: Plant) -> list[tuple[float, float]]:
    x, y, theta = robot.pose
    c, s = cos(theta), sin(theta)
    return [
        (x + c * ahead - s * left, y + s * ahead + c * left)
        for ahead in (FRONT, -REAR)
        for left in (SIDE, -SIDE)
    ]


# Walls ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("volts", [2.0, 6.0, 12.0])
@pytest.mark.parametrize("heading", [0.0, 0.2, -0.7])
def test_driving_into_a_wall_stops_there_and_counts_once(volts: float, heading: float) -> None:
    robot = plant([(1.0, -15.0, 1.0, 15.0)], (0.0, 0.0, heading))
    deepest = -inf

    def watch() -> None:
        nonlocal deepest
        deepest = max(deepest, *(x - 1.0 for x, _ in corners(robot)))

    for _ in range(1200):
        robot.step(volts, volts)
        watch()
    assert deepest < PENETRATION_M
    assert robot.touches.collisions == 1
    if heading != -0.7:  # there it slides along the wall, and a little off
        assert robot.clearance() == 0.0


@pytest.mark.parametrize("sensors", [IDEAL, REAL], ids=["ideal", "real"])
def test_steps_in_one_go_are_those_one_by_one(sensors: SensorProfile) -> None:
    """Ahead, into a wall and along it, turning off it, and at rest."""
    at_once, singly = (plant(ROOM, (3.0, 0.0, 0.1), sensors) for _ in range(2))
    phases = [(8.0, 8.5)] * 60 + [(-9.0, 9.0)] * 40 + [(0.0, 0.0)] * 20 + [(-6.0, -5.0)] * 40
    blocked = 0
    for left_v, right_v in phases:
        at_once.run(8, lambda _v, _w, volts=(left_v, right_v): volts)  # type: ignore[misc]
        for _ in range(8):
            singly.step(left_v, right_v)
        blocked += singly.blocked
        assert state(at_once) == state(singly)
    assert singly.touches.collisions
    assert 0 < blocked < len(phases)


def state(robot: Plant) -> tuple[object, ...]:
    return (
        *(robot.pose, robot.speeds, robot.odometry, robot.encoder_counts, robot.v, robot.w),
        *(robot.battery.volts, robot.blocked, robot.touches.collisions, robot.ping(AHEAD)),
    )


def test_head_on_it_is_blocked_until_the_voltage_goes() -> None:
    robot = plant([(1.0, -5.0, 1.0, 5.0)])
    held = []
    drive(robot, 0.5, 0.0, 4.0, lambda: held.append(robot.blocked))
    assert (robot.v, robot.w) == (0.0, 0.0)
    robot.step(0.0, 0.0)
    held.append(robot.blocked)
    first = held.index(True)
    assert first * robot.step_s > 1.5
    assert held[first:] == [True] * (len(held) - first - 1) + [False]
    for _ in range(20):
        robot.step(-4.0, -4.0)
        assert not robot.blocked


@pytest.mark.parametrize("turn", [9.0, -9.0])
def test_flush_along_a_wall_it_can_turn_away_if_it_pushes_hard(turn: float) -> None:
    weak, strong = plant([(-5.0, SIDE, 5.0, SIDE)]), plant([(-5.0, SIDE, 5.0, SIDE)])
    for _ in range(200):
        weak.step(-0.3 * turn, 0.3 * turn)
        strong.step(-turn, turn)
    assert weak.blocked
    assert weak.pose[2] == pytest.approx(0.0, abs=1e-6)
    assert abs(degrees(strong.pose[2])) > 45.0
    assert max(y for _, y in corners(strong)) < SIDE + PENETRATION_M


def test_it_slides_along_a_wall_that_it_meets_at_a_slant() -> None:
    robot = plant([(1.0, -5.0, 1.0, 9.0)], (0.0, 0.0, 1.2))
    drive(robot, 0.4, 0.0, 12.0)
    assert degrees(robot.pose[2]) == pytest.approx(90.0, abs=0.5)
    assert robot.pose[1] > 2.0
    assert not robot.blocked


def test_the_end_of_a_wall_stops_it_and_turns_it() -> None:
    robot = plant([(1.0, 0.05, 3.0, 0.05)])
    drive(robot, 0.5, 0.0, 4.0)
    x, y, theta = robot.pose
    ahead = cos(theta) * (1.0 - x) + sin(theta) * (0.05 - y)
    assert ahead > FRONT - PENETRATION_M
    assert abs(theta) > 0.1
    assert robot.touches.collisions == 1


def test_contacts_less_than_half_a_second_apart_are_one_collision() -> None:
    for apart_s, expected in ((0.05, 1), (1.5, 2)):
        robot = plant([(1.0, -5.0, 1.0, 5.0)])
        drive(robot, 0.5, 0.0, 3.0)
        for volts in (-4.0, 4.0):
            for _ in range(round(apart_s / robot.step_s)):
                robot.step(volts, volts)
        drive(robot, 0.5, 0.0, 3.0)
        assert robot.touches.collisions == expected


def test_resting_against_a_wall_is_the_same_collision() -> None:
    robot = plant([(1.0, -5.0, 1.0, 5.0)])
    drive(robot, 0.5, 0.0, 3.0)
    drive(robot, 0.0, 0.0, 3.0)
    pose = robot.pose
    drive(robot, 0.0, 0.0, 3.0)
    assert robot.pose == pose
    drive(robot, 0.5, 0.0, 1.0)
    assert robot.touches.collisions == 1


def test_nothing_is_counted_that_is_not_touched() -> None:
    robot = plant([(-5.0, SIDE + 0.002, 5.0, SIDE + 0.002), (1.0, -9.0, 1.0, -SIDE - 0.002)])
    drive(robot, 0.5, 0.0, 4.0)
    assert robot.pose[0] > 1.5
    assert robot.touches.collisions == 0


def test_a_wild_drive_never_leaves_the_room() -> None:
    rng = Random(7)
    robot = plant(ROOM)
    deepest = -inf
    for _ in range(150):
        left, right = rng.uniform(-4, 12), rng.uniform(-4, 12)
        for _ in range(80):
            robot.step(left, right)
            for x, y in corners(robot):
                deepest = max(deepest, x - 4.0, -2.0 - x, y - 2.0, -2.0 - y)
    assert robot.touches.collisions > 5
    assert deepest < PENETRATION_M


def test_knocks_never_add_energy() -> None:
    """Coasting about in a narrow cell, sideways sliding included."""
    rng = Random(4)
    cell: list[Wall] = [(-0.5, -0.5, 0.5, -0.5), (0.5, -0.5, 0.5, 0.5)]
    cell += [(0.5, 0.5, -0.5, 0.5), (-0.5, 0.5, -0.5, -0.5)]
    knocks = 0
    for _ in range(60):
        start = (rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(-pi, pi))
        robot = plant(cell, start)
        body = robot._dynamics
        body.v, body.w = rng.uniform(-1.6, 1.6), rng.uniform(-5, 5)
        before = body.energy()
        for _ in range(300):
            robot.step(0.0, 0.0)
            after = body.energy() + 0.5 * robot._outline.mass_kg * robot._sideways**2
            assert after <= before
            before = after
        knocks += robot.touches.collisions
    assert knocks > 10


def test_a_robot_set_down_in_a_wall_is_pushed_out() -> None:
    robot = plant([(0.2, -5.0, 0.2, 5.0)])
    for _ in range(400):
        robot.step(3.0, 3.0)
    assert robot.pose[0] + FRONT < 0.2 + PENETRATION_M


def test_walls_can_be_added_while_it_drives() -> None:
    robot = plant()
    drive(robot, 0.5, 0.0, 1.0)
    robot.add_walls([(1.0, -1.0, 1.0, 1.0)])
    drive(robot, 0.5, 0.0, 4.0)
    assert robot.blocked
    assert robot.pose[0] + FRONT == pytest.approx(1.0, abs=PENETRATION_M)


@pytest.mark.parametrize("every", [1, 3])
def test_asking_for_contacts_only_where_they_are_possible_changes_no_bit(every: int) -> None:
    """Against a plant that queries contacts in every step in which it moves."""
    rng = Random(3)
    lazy, eager = plant(ROOM, sensors=REAL), plant(ROOM, sensors=REAL)
    for k in range(4000):
        if k % 50 == 0:
            turn = rng.uniform(-2, 2)
            left, right = 6 - turn, 6 + turn
            if k % 500 >= 400:
                left = right = -6.0
        eager._margin = 0.0
        if k % every == 0:
            lazy.clearance()
        lazy.step(left, right)
        eager.step(left, right)
        assert lazy.pose == eager.pose
    assert (lazy.touches.collisions, lazy.odometry) == (eager.touches.collisions, eager.odometry)
    assert lazy.touches.collisions > 2


# Motion and its measures ------------------------------------------------------------------------


def test_odometry_of_an_ideal_robot_is_its_pose_to_a_tick() -> None:
    robot = plant(start=(1.0, 2.0, pi / 2))
    drive(robot, 0.4, 0.3, 5.0)
    drive(robot, 0.3, -0.5, 5.0)
    x, y, theta = robot.odometry
    assert hypot(robot.pose[0] - (1.0 - y), robot.pose[1] - (2.0 + x)) < 2e-4
    assert robot.pose[2] - pi / 2 == pytest.approx(theta, abs=1e-3)
    left, right = robot.encoder_counts
    turned = (right - left) / TICKS_PER_M / (2 * PROFILE.body.half_track_m)
    assert turned == pytest.approx(theta, abs=1e-9)


def test_reset_and_set_pose() -> None:
    robot = plant()
    drive(robot, 0.4, 0.3, 2.0)
    counts = robot.encoder_counts
    robot.reset_odometry()
    assert robot.odometry == HOME
    assert robot.encoder_counts == counts
    robot.set_pose(3.0, 4.0, 1.0)
    robot.step(0.0, 0.0)
    assert robot.pose == (3.0, 4.0, 1.0)
    assert robot.odometry == HOME


def test_set_down_at_another_wall_it_meets_that_too() -> None:
    robot = plant([(1.0, -1.0, 1.0, 1.0), (30.0, -1.0, 30.0, 1.0)])
    robot.clearance()
    for x in (1.0, 30.0, 1.0):
        robot.set_pose(x - FRONT - 0.005, 0.0, 0.0)
        for _ in range(60):
            robot.step(6.0, 6.0)
        assert robot.pose[0] + FRONT == pytest.approx(x, abs=PENETRATION_M)
    assert robot.touches.collisions == 3


def drift_after(sensors: SensorProfile, seed: int = 1) -> float:
    """Heading error after 20 m straight on by the encoders, rad."""
    robot = plant(sensors=sensors, seed=seed)
    drive(robot, 0.5, 0.0, 40.0)
    return robot.odometry[2] - robot.pose[2]


def miscalibrated(seed: int, **sizes: float) -> Plant:
    return plant(sensors=msgspec.structs.replace(IDEAL, **sizes), seed=seed)


def test_drift_grows_with_the_way_and_is_drawn_anew_in_each_run() -> None:
    drifts = []
    for seed in range(8):
        robot = miscalibrated(seed, drift_rad_m=0.01)
        off = []
        for _ in range(2):
            for _ in range(1000):
                robot.step(4.0, 4.0)
            off.append((robot.odometry[2] - robot.pose[2]) / robot.pose[0])
        assert off[0] == pytest.approx(off[1], abs=2e-5)
        drifts.append(off[1])
    assert -0.0101 < min(drifts) < -0.002
    assert 0.002 < max(drifts) < 0.0101


def test_turning_and_ways_are_measured_too_large_or_too_small() -> None:
    turns, ways = [], []
    for seed in range(8):
        robot = miscalibrated(seed, turn_error=0.03)
        drive(robot, 0.0, 0.5, 10.0)
        turns.append(robot.odometry[2] / robot.pose[2] - 1.0)
        robot = miscalibrated(seed, way_error=0.02)
        drive(robot, 0.5, 0.0, 5.0)
        ways.append(robot.odometry[0] / robot.pose[0] - 1.0)
        assert robot.odometry[2] == pytest.approx(robot.pose[2], abs=1e-4)
    for errors, most in ((turns, 0.032), (ways, 0.021)):
        assert -most < min(errors) < -0.2 * most
        assert 0.2 * most < max(errors) < most


def test_slip_wanders_and_an_ideal_robot_does_not() -> None:
    slipping = msgspec.structs.replace(IDEAL, slip=0.02)
    errors = [drift_after(slipping, seed) for seed in range(6)]
    assert abs(drift_after(IDEAL)) < 1e-4
    assert max(errors) > 0.02
    assert min(errors) < -0.02
    assert max(map(abs, errors)) < 0.5


def test_the_battery_drains_with_the_motors_and_sags_under_load() -> None:
    resting, driving, pressing = plant(), plant(), plant([(0.22, -1.0, 0.22, 1.0)])
    full = resting.battery.volts
    for _ in range(4000):
        resting.step(0.0, 0.0)
        driving.step(6.0, 6.0)
        pressing.step(12.0, 12.0)
    assert full > resting.battery.volts > driving.battery.volts > pressing.battery.volts
    amperes = 2 * 12.0 / PROFILE.motor.resistance_ohm
    sag = full - pressing.battery.volts
    assert sag == pytest.approx(PROFILE.battery.internal_ohm * amperes, rel=0.15)
    driving.step(0.0, 0.0)
    assert driving.battery.volts < resting.battery.volts
    assert driving.battery.charge < resting.battery.charge


def docked(at: Pose2, charge: float = 0.5) -> Plant:
    return Plant(PROFILE, IDEAL, Site(start=at, docks=[DOCK], charge=charge), seeded(1))


def test_it_is_charged_while_its_contacts_meet_those_of_a_dock() -> None:
    x, y, theta = DOCK
    robot = docked(DOCK)
    before = robot.battery.volts
    robot.run(1, lambda _v, _w: (0.0, 0.0))
    assert robot.battery.charging
    assert robot.battery.volts > before  # a charger lifts the voltage
    robot.run(round(360.0 / robot.step_s), lambda _v, _w: (0.0, 0.0))
    battery = PROFILE.battery
    gained = 0.1 * (battery.charge_a - battery.idle_a) / battery.capacity_ah
    assert robot.battery.charge == pytest.approx(0.5 + gained, rel=1e-3)
    robot.set_pose(x + 0.2, y, theta)
    robot.run(1, lambda _v, _w: (0.0, 0.0))
    assert not robot.battery.charging


@pytest.mark.parametrize(
    ("off", "charged"),
    [
        ((0.0, 0.0, 0.0), True),
        ((0.045, -0.045, radians(7)), True),
        ((0.06, 0.0, 0.0), False),
        ((0.0, 0.06, 0.0), False),
        ((0.0, 0.0, radians(9)), False),
        ((0.0, 0.0, 2 * pi), True),
    ],
)
def test_a_few_centimetres_and_degrees_off_is_no_contact(off: Pose2, charged: bool) -> None:
    robot = docked(compose(DOCK, off))
    robot.run(1, lambda _v, _w: (0.0, 0.0))
    assert robot.battery.charging is charged


def test_the_charger_gives_less_and_less_and_fills_no_more_than_the_battery_holds() -> None:
    robot = docked(DOCK, 0.97)
    robot.run(round(600.0 / robot.step_s), lambda _v, _w: (0.0, 0.0))
    most = PROFILE.battery
    rest = (1.0 - most.taper_from) * most.idle_a / most.charge_a  # it gives what the robot takes
    assert 0.97 < robot.battery.charge < 1.0 - rest


def test_what_is_used_is_counted_in_joules() -> None:
    robot = plant()
    robot.run(round(10.0 / robot.step_s), lambda _v, _w: (0.0, 0.0))
    watts = PROFILE.battery.idle_a * PROFILE.battery.full_v
    assert robot.battery.used_j == pytest.approx(10.0 * watts, rel=0.01)


def test_no_motor_gets_more_than_the_battery_has() -> None:
    one, other = plant(), plant()
    for _ in range(200):
        one.step(100.0, -100.0)
        other.step(other.battery.volts, -other.battery.volts)
        assert one.pose == other.pose


# Repeatability ----------------------------------------------------------------------------------


def diary(seed: int) -> list[object]:
    robot = plant(ROOM, sensors=REAL, seed=seed)
    pi_loops, entries = SpeedLoops(PROFILE.speed_loop, 12.0), []
    for k in range(3000):
        v, w = 0.4, 0.8 * sin(k / 300)
        robot.step(*pi_loops.voltages(v, w, robot.v, robot.w, robot.step_s))
        if k % 8 == 0:
            entries.append(
                (robot.ping(k // 8 % 8), robot.pose, robot.odometry, robot.battery.volts)
            )
    return [*entries, robot.encoder_counts, robot.touches.collisions, robot.clearance()]


def test_the_same_seed_is_the_same_run_bit_for_bit() -> None:
    assert diary(5) == diary(5)
    assert diary(5) != diary(6)


def test_dead_walls_come_from_the_seed_and_more_walls_change_none() -> None:
    walls: list[Wall] = [(float(x), 1.0, x + 0.9, 1.0) for x in range(40)]
    dead = msgspec.structs.replace(IDEAL, dead_walls=0.2, dropout=0.0)

    def echoes_of(walls: list[Wall], seed: int) -> list[bool]:
        robot = plant(walls, sensors=dead, seed=seed)
        return [_has_echo(robot, x) for x in range(40)]

    first = echoes_of(walls, 1)
    assert 24 < sum(first) < 40
    assert echoes_of([*walls, (0.0, -3.0, 1.0, -3.0)], 1) == first
    assert echoes_of(walls, 2) != first


def _has_echo(robot: Plant, x: int) -> bool:
    """Whether the wall from x to x + 0.9 answers the left sonar, close to it."""
    robot.set_pose(x + 0.45 - 0.069, 0.6, 0.0)
    return robot.ping(0) is not None


def test_a_robot_too_light_for_the_steps_is_reported() -> None:
    caster = msgspec.structs.replace(PROFILE.caster, trail_m=1e-6)
    stiff = msgspec.structs.replace(PROFILE, caster=caster)
    robot = Plant(stiff, IDEAL, Site(), seeded(0))
    with pytest.raises(ConfigError, match="grow without bound"):
        drive(robot, 0.3, 0.5, 3.0)
