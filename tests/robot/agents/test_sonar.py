"""The sonar agent: a cycle's echoes become a cycle's obstacles, near ones in front as arcs."""

from __future__ import annotations

from math import cos, hypot, pi, radians, sin
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.agents.perception.approaching import AHEAD_S
from armadico.agents.perception.sonar import START_S, Parameters, SonarAgent
from armadico.config.scenarios import load_scenario
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Point, RobotState
from armadico.launch.society import Options, members
from armadico.mobile.messages import Correction, Echo, Pose, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.testing.alone import Alone, covariance
from tests.robot.robots import described

MAPPED = Parameters(world="sc2")
"""Its wall lies across the way at x = 5 m, from y = -1.28 m to 1.28 m."""

AHEAD = radians(10.0)  # where a sonar looks; those of a Pioneer look at 10, 30, 50 and 90 degrees


class Ring(Alone):
    """A robot with given sonar readings."""

    def __init__(self, parameters: Parameters | None = None, robot: str = "pioneer-2dx") -> None:
        agent = SonarAgent(Identity("sonar-1"), parameters)
        super().__init__(agent, robot=described(robot))
        agent._cycles = 99

    def ping(
        self,
        *echoes: tuple[float, float | None],
        odometry: tuple[float, float, float] = (0.0, 0.0, 0.0),
        touch: float | None = None,
        pose: tuple[float, float, float] | None = None,
        deviation: float = 0.02,
    ) -> Obstacles:
        """One cycle: bearings (rad) and ranges (m) from the middle of the robot."""
        self.odometry, self.touch = odometry, None if touch is None else Point(touch, 0.0)
        self.state()
        if pose is not None:
            self.give(Pose(self.at, *pose, covariance(deviation)))
        said = self.give(heard(self.at, *echoes))
        (found,) = (message for message in said if isinstance(message, Obstacles))
        assert found.cycle == self.at
        return found

    def twice(self, *echoes: tuple[float, float | None]) -> Obstacles:
        """Two echoes make an obstacle."""
        self.ping(*echoes)
        return self.ping(*echoes)


@pytest.fixture
def ring() -> Ring:
    return Ring()


def polar(distance: float, bearing: float) -> Point:
    return Point(distance * cos(bearing), distance * sin(bearing))


def heard(cycle: Cycle, *echoes: tuple[float, float | None]) -> Sonar:
    """Echoes of a cycle: bearings (rad) and ranges (m) from the middle of the robot."""
    return Sonar(cycle, 5.0, tuple(Echo(0.0, 0.0, *echo) for echo in echoes))


def published_in(cycle_s: float, cycles: int, described_in: int) -> list[int]:
    """The cycles in which an agent publishes that starts, and is told of the robot in one."""
    alone = Alone(SonarAgent(Identity("sonar-2")), robot=None)
    for number in range(1, cycles + 1):
        alone.now = cycle_s * number
        if number == described_in:
            alone.give(replace(described(), cycle_s=cycle_s))
        at = Cycle(1, number)
        alone.give(RobotState(at, 0, 0, 0, 0, 0, 12, True, False), heard(at, (AHEAD, 1.0)))
    return [message.cycle.number for message in alone.all(Obstacles)]


@pytest.mark.parametrize("cycle_s", [0.05, 0.1])
def test_after_a_start_it_publishes_nothing_for_one_turn_of_the_ring(cycle_s: float) -> None:
    cycles = round(START_S / cycle_s)
    assert published_in(cycle_s, cycles + 1, 1) == [cycles, cycles + 1]


def test_before_the_robot_is_described_it_publishes_nothing() -> None:
    assert published_in(0.1, 12, 11) == [11, 12]


def test_a_cycles_echoes_are_in_that_cycles_obstacles(ring: Ring) -> None:
    found = ring.ping((AHEAD, 1.0))
    assert found.front == found.closest
    assert found.front is not None
    assert (found.front.x, found.front.y) == pytest.approx((cos(AHEAD), sin(AHEAD)))


def test_the_closest_points_of_all_of_front_and_of_each_side(ring: Ring) -> None:
    found = ring.twice((AHEAD, 1.5), (radians(90), 0.8), (radians(-90), 1.2), (radians(50), 2.0))
    for point, distance, bearing in (
        (found.closest, 0.8, 90),
        (found.front, 1.5, 10),
        (found.left, 0.8, 90),
        (found.right, 1.2, -90),
    ):
        assert point is not None
        expected = polar(distance, radians(bearing))
        assert (point.x, point.y) == pytest.approx((expected.x, expected.y))


def test_what_is_near_and_in_front_is_an_arc_of_three(ring: Ring) -> None:
    found = ring.twice((AHEAD, 1.0))
    arc = Parameters().arc_rad
    expected = [polar(1.0, AHEAD + off) for off in (0.0, arc, -arc)]
    got = sorted((p.x, p.y) for p in found.points)
    assert got == [pytest.approx(e) for e in sorted((p.x, p.y) for p in expected)]


@pytest.mark.parametrize(
    ("bearing", "distance"), [(AHEAD, 0.24), (AHEAD, 1.7), (radians(50), 1.0), (radians(90), 1.0)]
)
def test_far_off_beside_or_at_hand_it_is_a_point(
    ring: Ring, bearing: float, distance: float
) -> None:
    assert len(ring.twice((bearing, distance)).points) == 1


def test_the_map_moves_with_the_robot(ring: Ring) -> None:
    ring.ping((AHEAD, 1.0))
    found = ring.ping(odometry=(0.3, 0.0, 0.0))
    assert found.closest is not None
    assert (found.closest.x, found.closest.y) == pytest.approx((cos(AHEAD) - 0.3, sin(AHEAD)))
    turned = ring.ping(odometry=(0.3, 0.0, pi / 2))
    assert turned.closest is not None
    assert (turned.closest.x, turned.closest.y) == pytest.approx((sin(AHEAD), 0.3 - cos(AHEAD)))


def test_odometry_that_begins_anew_does_not_move_the_map(ring: Ring) -> None:
    before = ring.ping((AHEAD, 1.0), odometry=(7.0, 2.0, 1.0))
    ring.epoch, ring.number = 2, 0
    ring.now += 0.4  # another epoch counts once this one has been silent
    after = ring.ping(odometry=(0.0, 0.0, 0.0))
    assert before.closest is not None
    assert after.closest is not None
    assert hypot(after.closest.x - before.closest.x, after.closest.y - before.closest.y) < 1e-9


def test_an_echo_of_another_cycle_is_not_taken(ring: Ring) -> None:
    ring.ping((AHEAD, None))
    assert ring.give(heard(Cycle(1, 99), (0.0, 1.0))) == []
    assert ring.ping((AHEAD, None)).points == ()


def test_what_was_there_and_is_seen_through_is_forgotten(ring: Ring) -> None:
    ring.twice((AHEAD, 1.0))
    for _ in range(5):
        found = ring.ping((AHEAD, 3.0))
    assert found.closest is None


def test_what_is_inside_a_large_robot_is_outside_a_small_one() -> None:
    for robot, found in (("pioneer-2dx", 0), ("amigobot", 1)):
        ring = Ring(robot=robot)
        ring.ping((0.0, 0.19))
        assert len(ring.ping((0.0, None)).points) == found


def test_what_is_touched_behind_is_behind(ring: Ring) -> None:
    ring.ping((AHEAD, None), touch=0.21)
    found = ring.ping((AHEAD, None), touch=-0.23)
    assert sum(p.x > 0.21 for p in found.points) == sum(p.x < -0.23 for p in found.points) == 3


def test_a_collision_is_an_obstacle_though_no_sonar_detects_it(ring: Ring) -> None:
    found = ring.ping((AHEAD, None), touch=0.21)
    assert found.points
    assert all(p.x > 0.21 and abs(p.y) < 0.165 for p in found.points)
    assert len(ring.ping((AHEAD, None), touch=0.21).points) == len(found.points)
    behind = ring.ping((AHEAD, None), odometry=(-0.5, 0.0, 0.0))
    assert all(p.x > 0.7 for p in behind.points)
    assert behind.points


def test_a_wall_of_the_map_is_expected_before_an_echo_if_the_pose_is_known() -> None:
    for pose, deviation, known in (
        ((4.2, 0.0, 0.0), 0.02, True),
        ((4.2, 0.0, 0.0), 0.6, False),  # lost
        ((4.2, 0.0, 0.0), 0.0, False),  # unknown covariance
        (None, 0.0, False),
    ):
        ring = Ring(MAPPED)
        found = ring.ping((AHEAD, None), pose=pose, deviation=deviation)
        assert (found.front is not None) == known
        if found.front is not None:
            assert found.front.x == pytest.approx(0.8, abs=0.03)
            assert found.closest == found.front
            assert found.front in found.points
    assert Ring().ping((AHEAD, None), pose=(4.2, 0.0, 0.0)).points == ()


def test_the_walls_are_where_the_robot_is_now_and_not_where_its_last_pose_was() -> None:
    ring = Ring(MAPPED)
    ring.ping((AHEAD, None), odometry=(1.0, 0.0, 0.0), pose=(4.2, 0.0, 0.0))
    found = ring.ping((AHEAD, None), odometry=(1.1, 0.0, 0.0))
    assert found.front is not None
    assert 0.6 < found.front.x < 0.75  # by the pose's error nearer, since no echo shows it


@pytest.mark.parametrize("lost", [None, 1.0])
def test_a_lost_robot_is_for_a_while_where_its_odometry_has_it(lost: float | None) -> None:
    ring = Ring(MAPPED)
    ring.ping((AHEAD, None), pose=(4.2, 0.0, 0.0))
    at_pose = None if lost is None else (-7.0, 3.0, 1.0)
    front = []
    for way in (0.0, 0.1, 0.2):
        found = ring.ping(
            (AHEAD, None), odometry=(way, 0.0, 0.0), pose=at_pose, deviation=lost or 0.0
        )
        assert found.front is not None
        front.append(found.front.x + way)
    assert front[0] == pytest.approx(0.8, abs=0.03)
    assert front == sorted(front, reverse=True)  # the longer it is so, the nearer it may be
    ring.now += Parameters().walls.kept_s
    assert ring.ping((AHEAD, None), odometry=(0.2, 0.0, 0.0)).points == ()


@pytest.mark.parametrize("elsewhere", [False, True])
def test_one_that_was_lifted_expects_what_is_forbidden_and_no_wall_of_where_it_was(
    tmp_path: Path, elsewhere: bool
) -> None:
    lines = "LINES\n800 -1000 800 1000\n"
    stairs = 'Cairn: ForbiddenLine 0 0 0 "" ICON "Stairs" -800 -1000 -800 1000\n'
    file = tmp_path / "stairs.map"
    file.write_text(f"2D-Map\n{stairs}{lines}")
    ring = Ring(Parameters(world=str(file)))
    found = ring.ping((AHEAD, None), pose=(0.0, 0.0, 0.0))
    assert {point.x > 0.0 for point in found.points} == {False, True}
    wide = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
    ring.give(Correction(ring.at, 0, 0, 0, wide, 0.0, elsewhere))
    found = ring.ping((AHEAD, None), pose=(0.0, 0.0, 0.0), deviation=1.4)
    assert {point.x > 0.0 for point in found.points} == ({False} if elsewhere else {False, True})
    found = ring.ping((AHEAD, None), pose=(0.0, 0.0, 0.0))
    assert {point.x > 0.0 for point in found.points} == {False, True}, "found where it was"


def test_that_lasts_no_longer_than_odometry_can_be_trusted() -> None:
    ring = Ring(MAPPED)
    ring.ping((AHEAD, None), pose=(4.2, 0.0, 0.0))
    for number in range(50):  # to and fro
        found = ring.ping((AHEAD, None), odometry=(0.2 * (number % 2), 0.0, 0.0))
    assert found.points == ()


def test_a_pose_correction_moves_the_maps_walls_and_not_sensed_points() -> None:
    ring = Ring(MAPPED)
    for _ in range(2):
        ring.ping((radians(90), 0.5), pose=(4.2, 0.0, 0.0))
    found = ring.ping((AHEAD, None), pose=(4.3, 0.0, 0.0))
    assert found.left is not None
    assert (found.left.x, found.left.y) == pytest.approx((0.0, 0.5), abs=1e-9)
    ahead = [p.x for p in found.points if abs(p.y) < 0.1]
    assert ahead
    assert all(x == pytest.approx(0.7, abs=0.03) for x in ahead)


def test_a_wall_that_echoes_pass_is_open() -> None:
    ring = Ring(MAPPED)
    for _ in range(4):
        found = ring.ping((0.0, 2.4), pose=(4.2, 0.0, 0.0))
    assert not [p for p in found.points if abs(p.y) < 0.1 and p.x < 1.0]


def test_one_that_restarts_beside_a_wall_that_does_not_answer_knows_of_it_at_once() -> None:
    ring = Ring(MAPPED)
    ring.agent._cycles = round(START_S / 0.1) - 1
    assert ring.ping((AHEAD, None), pose=(4.5, 0.0, 1.57)).right is not None


def test_the_end_of_a_wall_does_not_stand_in_the_way_beside_it() -> None:
    here, post = (4.4, 1.6, 0.0), hypot(0.6, 0.32)  # the wall ends to the right of the way
    echoes = ((-AHEAD, post), (radians(-30.0), post))
    mapped, without = Ring(MAPPED), Ring()
    for _ in range(3):
        found, bare = mapped.ping(*echoes, pose=here), without.ping(*echoes, pose=here)
    assert any(abs(p.y) < 0.2 and p.x > 0.0 for p in bare.points)
    assert not any(abs(p.y) < 0.2 and p.x > 0.0 for p in found.points)
    assert any(hypot(p.x - 0.6, p.y + 0.32) < 0.05 for p in found.points)


@pytest.mark.parametrize(("away", "put"), [(0.28, True), (1.0, False)])
def test_a_near_echo_is_put_where_it_was_measured_whatever_wall_explains_it(
    away: float, put: bool
) -> None:
    ring = Ring(MAPPED)
    for _ in range(3):
        ring.ping((0.0, away), pose=(5.0 - away, 0.0, 0.0))
    assert bool([o for o in ring.agent._map.sensed() if abs(o.x - away) < 0.02]) is put


def test_what_no_map_has_is_forgotten_sooner() -> None:
    def lasts(ring: Ring, pose: tuple[float, float, float] | None) -> int:
        for _ in range(3):
            ring.ping((radians(90.0), 0.5), pose=pose)
        return next(k for k in range(1000) if not ring.ping((AHEAD, None), pose=pose).points)

    nowhere = (1.0, 0.0, 0.0)
    assert 50 < lasts(Ring(MAPPED), nowhere) < 100 < lasts(Ring(), nowhere)


def test_what_was_touched_and_is_on_no_map_goes_on() -> None:
    for known, x, deviation, stays in (
        (MAPPED, 1.0, 0.02, False),
        (MAPPED, 5.0 - 0.21, 0.02, True),
        (MAPPED, 1.0, 0.6, True),  # it may be anywhere
        (Parameters(world="sc1"), 1.0, 0.6, False),  # a map without walls has none anywhere
        (None, 1.0, 0.02, True),
    ):
        ring = Ring(known)
        pose = x, 0.0, 0.0
        ring.ping((AHEAD, None), touch=0.21, pose=pose, deviation=deviation)
        ring.now += 11.0
        points = ring.ping((AHEAD, None), pose=pose, deviation=deviation).points
        assert any(p.x == pytest.approx(0.25) and p.y == 0.0 for p in points) == stays


def test_an_approaching_object_is_also_put_where_it_will_be() -> None:
    for speed, comes in ((0.6, True), (0.0, False)):
        ring = Ring(MAPPED)
        ring.agent._pings = ring.agent._cycles  # one a cycle, as here
        for k in range(6):
            far = 1.5 - 0.1 * k * speed
            found = ring.ping((AHEAD, far), pose=(1.0, 0.0, 0.0))
        nearest = min(hypot(p.x, p.y) for p in found.points)
        assert nearest == pytest.approx(far - (AHEAD_S * speed if comes else 0.0), abs=0.02)


def test_it_is_told_of_the_world_unless_that_is_to_be_explored() -> None:
    for plan, at_pose in (("rooms", True), ("frontiers", False)):
        scenario = replace(load_scenario("sc4"), plan=plan)
        (sets,) = (m.sets for m in members(scenario, Options(), "") if m.name == "sonar")
        assert any(one.startswith("world=") for one in sets) == at_pose
