"""What a wall that holds the robot does to its controller, and what the controller does then."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import SYNC0, SYNC1, SYNC2, Cmd, command, set_pose
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.pioneer import Pioneer
from armadico.bridge.simulator.plant import Plant, Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.speed_loops import SpeedLoops
from tests.robot.bridge.kit import IDEAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Bench

    from armadico.bridge.simulator.plant import Driver

WALL_X = 1.0


class Metered(Plant):
    """Notes the greatest voltage."""

    most_v = 0.0

    def run(self, steps: int, driver: Driver) -> None:
        def metered(v: float, w: float) -> tuple[float, float]:
            volts = driver(v, w)
            self.most_v = max(self.most_v, *map(abs, volts))
            return volts

        super().run(steps, metered)


@pytest.fixture
def walled(make: Callable[..., Bench], profile: P2osRobot) -> tuple[Bench, Metered]:
    """A robot that has pushed a wall ahead of it for two seconds, at 0.3 m/s."""
    wall = (WALL_X, -3.0, WALL_X, 3.0)
    plant = Metered(profile, IDEAL, Site([wall], (0.3, 0.0, 0.0)), seeded(1))
    bench = make(profile)
    loops = SpeedLoops(profile.speed_loop, profile.motor.supply_v)
    bench.controller = Microcontroller(profile, plant, loops)
    bench.connect()
    bench.send(Cmd.VEL, 300)
    while not plant.blocked:
        bench.watched(0.1)
    bench.watched(2.0)
    return bench, plant


def test_a_robot_that_pushes_a_wall_reports_a_stall(walled: tuple[Bench, Metered]) -> None:
    """But for two packets a second: motors that come on again do not push yet."""
    bench, _ = walled
    stalls = [(status.left_stall, status.right_stall) for status in bench.watched(10.0)]
    assert all((True, True) in stalls[n : n + 3] for n in range(len(stalls) - 2))
    assert set(stalls) <= {(True, True), (False, False)}


def test_stalled_motors_are_off_before_they_pull_with_all_their_might(
    walled: tuple[Bench, Metered], profile: P2osRobot
) -> None:
    bench, plant = walled
    bench.watched(10.0)
    assert plant.most_v < 0.6 * profile.motor.supply_v


@pytest.mark.parametrize("after", [0.0, 0.5, 1.1])
def test_it_backs_off_as_soon_as_it_is_commanded(
    walled: tuple[Bench, Metered], after: float
) -> None:
    bench, plant = walled
    bench.watched(after)
    bench.send(Cmd.VEL, -150)
    statuses = bench.watched(2.0)
    assert WALL_X - 0.21 - plant.pose[0] > 0.15  # AMRISim: 0.25
    assert not any(status.left_stall for status in statuses[4:])


def test_commanded_to_turn_instead_it_does_not_spin(walled: tuple[Bench, Metered]) -> None:
    bench, plant = walled
    bench.send(Cmd.VEL, 0)
    bench.send(Cmd.RVEL, -60)
    statuses = bench.watched(3.0)
    assert plant.pose[2] < -math.pi / 4
    set_point = math.radians(60) * 0.1689
    assert max(abs(status.left_m_s) for status in statuses) < 2.5 * set_point


def test_commanded_to_stop_it_pushes_no_more(walled: tuple[Bench, Metered]) -> None:
    bench, plant = walled
    bench.send(Cmd.STOP)
    bench.watched(0.3)
    plant.most_v = 0.0
    assert not bench.watched(0.5)[-1].left_stall
    assert plant.most_v == 0.0


def test_set_points_are_kept(walled: tuple[Bench, Metered]) -> None:
    bench, plant = walled
    bench.controller.receive(set_pose(-5.0, 0.0, 0.0))
    bench.watched(3.0)
    assert plant.v == pytest.approx(0.3, abs=0.01)


def test_a_move_that_was_held_goes_on_from_where_the_wheels_are(
    walled: tuple[Bench, Metered],
) -> None:
    bench, plant = walled
    bench.send(Cmd.MOVE, 1000)
    bench.watched(3.0)
    start = plant.odometry[0]
    bench.controller.receive(set_pose(-5.0, 0.0, 0.0))
    bench.watched(8.0)
    assert plant.odometry[0] - start == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("gap", "degrees"), [(0.03, 20), (0.05, 60), (0.07, 100)])
def test_turning_off_a_wall_it_does_not_lurch(profile: P2osRobot, gap: float, degrees: int) -> None:
    """It pushes itself off with a corner, and its loops wind up as long as the wall holds it."""
    aside = profile.body.width_m / 2 + gap
    robot = Pioneer(profile, Stage(IDEAL, Site([(-3.0, aside, 3.0, aside)]), seeded(1)))
    for packet in (SYNC0, SYNC1, SYNC2, command(Cmd.OPEN), command(Cmd.ENABLE, 1)):
        robot.controller.receive(packet)
    robot.controller.receive(command(Cmd.RVEL, degrees))
    fastest = 0.0
    for step in range(1, 1200):
        robot.controller.receive(command(Cmd.PULSE))
        robot.controller.advance(step * robot.plant.step_s)
        rims = robot.plant.left_m_s, robot.plant.right_m_s
        fastest = max(fastest, *map(abs, rims))
    assert fastest < 2.0 * math.radians(degrees) * profile.body.half_track_m + 0.02
