"""The laser agent: a scan becomes obstacles; what passes out of sight is remembered for a while."""

from __future__ import annotations

from math import cos, hypot, inf, nan, pi, radians, sin, tau

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.agents.methods.near import RayResult
from armadico.agents.perception.laser import LaserAgent, Parameters
from armadico.agents.perception.scan_map import ScanMap
from armadico.bridge.simulator.laser import LaserScanner
from armadico.bridge.simulator.plant import seeded
from armadico.bridge.simulator.walls import DEAD, Wall, Walls
from armadico.config.loading import load_entry
from armadico.config.profile import Laser, SensorProfile
from armadico.config.shipped import find
from armadico.core.agent import ERROR, Identity
from armadico.core.messages import Cycle, Log, Point
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Pose, Scan
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import message_of
from armadico.testing.alone import Alone, covariance
from tests.robot.robots import described

IDEAL = load_entry(find("robots", "sensors"), SensorProfile, "ideal")
LASER = Laser(0.1, 0.0, 0.0, 0.1, 10.0, -135.0, 135.0, 541, 10.0, 0.0)
HERE: Pose2 = (0.0, 0.0, 0.0)
BOX = [(1.0, -0.2, 1.0, 0.2), (1.0, 0.2, 1.4, 0.2), (1.4, 0.2, 1.4, -0.2), (1.4, -0.2, 1.0, -0.2)]
ROOM = [
    (-3.0, -3.0, 3.0, -3.0),
    (3.0, -3.0, 3.0, 3.0),
    (3.0, 3.0, -3.0, 3.0),
    (-3.0, 3.0, -3.0, -3.0),
]


class Robot(Alone):
    """A robot with a laser, whose odometry is right."""

    def __init__(
        self, walls: list[Wall], laser: Laser = LASER, parameters: Parameters | None = None
    ) -> None:
        super().__init__(LaserAgent(Identity("laser-1"), parameters), robot=described())
        self.laser = laser
        self.build(walls)

    def build(self, walls: list[Wall], sensors: SensorProfile = IDEAL) -> None:
        """Another world from now on."""
        world = Walls()
        world.add(walls, [DEAD] * len(walls))
        self.sees = LaserScanner(self.laser, sensors, world, seeded(1))

    def scan(self, ranges: np.ndarray | None = None) -> Scan:
        laser = self.laser
        seen = self.sees.scan(self.pose) if ranges is None else ranges
        return message_of(
            self.at,
            seen,
            (radians(laser.angle_min_deg), radians(laser.step_deg)),
            (laser.min_m, laser.max_m),
            (laser.x_m, laser.y_m, radians(laser.bearing_deg)),
            upside_down=laser.upside_down,
        )

    def cycle(
        self,
        pose: Pose2 | None = None,
        ranges: np.ndarray | None = None,
        touch: float | None = None,
        known: float | None = None,
    ) -> Obstacles | None:
        """Go to a pose, and one cycle there; `known`: the pose is, with such a deviation, m."""
        self.pose = self.odometry = pose or self.pose
        self.touch = None if touch is None else Point(touch, 0.0)
        self.state()
        if known is not None:
            self.give(Pose(self.at, *self.pose, covariance(known)))
        found = [said for said in self.give(self.scan(ranges)) if isinstance(said, Obstacles)]
        return found[0] if found else None


def off(obstacles: Obstacles | None, walls: list[Wall], pose: Pose2 = HERE) -> list[float]:
    """How far each point is from the nearest of some walls, m."""
    assert obstacles is not None
    found = []
    for p in obstacles.points:
        x = pose[0] + p.x * cos(pose[2]) - p.y * sin(pose[2])
        y = pose[1] + p.x * sin(pose[2]) + p.y * cos(pose[2])
        away = []
        for x1, y1, x2, y2 in walls:
            length = hypot(x2 - x1, y2 - y1)
            along = ((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / length**2
            along = min(max(along, 0.0), 1.0)
            away.append(hypot(x - x1 - along * (x2 - x1), y - y1 - along * (y2 - y1)))
        found.append(min(away))
    return found


def test_what_is_seen_is_represented_by_few_points() -> None:
    found = Robot([*BOX, *ROOM]).cycle()
    assert found is not None
    assert found.sensor == "laser"
    assert max(off(found, [*BOX, *ROOM])) < 1e-2
    assert found.front is not None
    assert found.closest == found.front
    assert hypot(found.front.x, found.front.y) == pytest.approx(1.0, abs=1e-3)
    assert found.left is not None
    assert found.left.y > 0
    assert 40 < len(found.points) < 160, "of 541 rays"


def test_both_edges_of_a_door_are_kept_however_the_sectors_lie() -> None:
    posts = [(2.0, -3.0, 2.0, -0.437), (2.0, 0.411, 2.0, 3.0)]
    found = Robot(posts).cycle()
    assert found is not None
    lefts = [p.y for p in found.points if p.y > 0]
    rights = [p.y for p in found.points if p.y < 0]
    assert min(lefts) == pytest.approx(0.411, abs=0.02)
    assert max(rights) == pytest.approx(-0.437, abs=0.02)


def test_what_is_passed_is_remembered_behind_until_it_fades_with_the_way() -> None:
    robot = Robot([(0.4, 0.5, 0.8, 0.5)])
    for step in range(12):
        robot.cycle((0.1 * step, 0.0, 0.0))
    behind = robot.cycle((1.3, 0.0, 0.0))
    assert behind is not None
    assert behind.points
    assert max(off(behind, [(0.4, 0.5, 0.8, 0.5)], robot.pose)) < 0.02
    for step in range(13, 60):
        behind = robot.cycle((0.1 * step, 0.0, 0.0))
    assert behind is not None
    assert not behind.points


def test_an_obstacle_that_a_later_scan_does_not_see_is_dropped() -> None:
    robot = Robot([*BOX, *ROOM])
    near = robot.cycle()
    assert near is not None
    turned = robot.cycle((0.0, 0.0, pi))
    assert turned is not None
    assert turned.closest is not None
    assert turned.closest.x == pytest.approx(-1.0, abs=0.02), "remembered behind"
    robot.build(ROOM)
    assert robot.cycle((0.0, 0.0, pi)).closest.x == pytest.approx(-1.0, abs=0.02)  # type: ignore[union-attr]
    back = robot.cycle(HERE)
    assert back is not None
    assert back.closest is not None
    assert hypot(back.closest.x, back.closest.y) > 2.5


def test_hidden_points_are_remembered_and_points_seen_through_are_not() -> None:
    person = [(0.8, -0.2, 0.8, 0.2)]
    robot = Robot(ROOM)
    robot.cycle()
    robot.build([*ROOM, *person])
    hidden = robot.cycle()
    assert hidden is not None
    ahead = [p for p in hidden.points if abs(p.y) < 0.15 and p.x > 0]
    assert {round(p.x, 1) for p in ahead} == {0.8, 3.0}
    robot.build(ROOM)
    free = robot.cycle()
    assert free is not None
    assert min(p.x for p in free.points if abs(p.y) < 0.15 and p.x > 0) == pytest.approx(
        3, abs=0.01
    )


@pytest.mark.parametrize("behind", [[], ROOM])
def test_the_end_of_a_wall_seen_along_it_is_remembered_and_goes_with_the_wall(
    behind: list[Wall],
) -> None:
    wall = [(0.6, 0.0, 2.0, 0.0)]
    robot = Robot([*wall, *behind])

    def at_its_end(pose: Pose2) -> bool:
        obstacles = robot.cycle(pose)
        assert obstacles is not None
        return any(hypot(p.x + pose[0] - 0.6, p.y + pose[1]) < 0.1 for p in obstacles.points)

    beside, before = (0.0, -0.4, 0.0), HERE
    assert at_its_end(beside)
    robot.build(behind or [(-3.0, 3.0, -3.0, -3.0)])  # as its rays go by on both sides of it
    assert all(at_its_end(before) for _ in range(8)), "no ray would show it"
    assert not all(at_its_end(beside) for _ in range(8)), "it is gone"


def test_rays_without_a_return_clear_slowly_and_invalid_ones_not_at_all() -> None:
    robot = Robot(BOX)
    robot.cycle()
    rays = LASER.rays
    for _ in range(30):
        kept = robot.cycle(ranges=np.r_[np.full(rays - 40, nan), np.full(40, inf)])
    assert kept is not None
    assert kept.closest is not None
    assert kept.closest.x == pytest.approx(1.0, abs=0.02)
    nothing = np.full(rays, inf)
    once = robot.cycle(ranges=nothing)
    assert once is not None
    assert once.points
    for _ in range(12):
        once = robot.cycle(ranges=nothing)
    assert once is not None
    assert not once.points


@pytest.mark.parametrize("bad", [nan, 0.0, -1.0, 0.1])
def test_a_blind_laser_publishes_nothing_and_is_reported_once(bad: float) -> None:
    robot = Robot(ROOM)
    assert robot.cycle() is not None
    for _ in range(5):
        assert robot.cycle(ranges=np.full(LASER.rays, bad)) is None
    logs = robot.all(Log)
    assert [log.level for log in logs] == [ERROR]
    assert "0 of 541 rays" in logs[0].text
    assert robot.cycle() is not None


def test_where_it_sees_its_own_robot_it_is_blind_and_nowhere_else() -> None:
    robot = Robot(BOX)
    robot.cycle()
    ranges = robot.sees.scan(HERE)
    ranges[200:341] = 0.1  # a post of its own hides what is ahead
    found = robot.cycle(ranges=ranges)
    assert found is not None
    assert found.closest is not None
    assert found.closest.x == pytest.approx(1.0, abs=0.02), "as it was remembered"


def test_bytes_that_are_no_scan_are_a_blind_laser() -> None:
    robot = Robot(ROOM)
    robot.cycle()
    robot.state()
    said = robot.give(replace(robot.scan(), packed=b"abc"))
    assert not [message for message in said if isinstance(message, Obstacles)]


@pytest.mark.parametrize(
    "laser",
    [
        replace(LASER, upside_down=True),
        replace(LASER, bearing_deg=180.0, x_m=-0.1),
        Laser(0.0, 0.0, 90.0, 0.1, 10.0, 0.0, 359.0, 360, 5.0, 0.0),
    ],
)
def test_however_it_is_mounted_it_sees_the_same_world(laser: Laser) -> None:
    corner = [(1.0, -2.0, 1.0, 0.7), (1.0, 0.7, 2.0, 0.7), (-1.5, -2.0, -1.5, 2.0)]
    assert max(off(Robot(corner, laser).cycle(), corner)) < 1e-2


def test_walls_of_the_map_are_expected_where_the_laser_sees_nothing() -> None:
    parameters = Parameters(world="sc2")
    laser = replace(LASER, angle_min_deg=-60.0, angle_max_deg=60.0)
    wall = [(5.0, -1.28, 5.0, 1.28)]
    ahead: Pose2 = (4.0, 0.0, 0.0)
    seen = Robot(wall, laser, parameters)
    found = seen.cycle(ahead, known=0.05)
    assert max(off(found, wall, ahead)) < 0.01, "seen where it is, not where the pose has it"
    away = Robot([], laser, parameters).cycle((4.0, 0.0, pi), known=0.02)
    assert away is not None
    assert any(p.x == pytest.approx(-1.0, abs=0.05) for p in away.points), "behind its back"
    gone = Robot([(7.0, -9.0, 7.0, 9.0)], laser, parameters)
    for _ in range(5):
        open_ = gone.cycle(ahead, known=0.02)
    assert open_ is not None
    assert not any(abs(p.y) < 0.5 and p.x < 2.0 for p in open_.points), "seen through"
    turned = gone.cycle((4.0, 0.0, pi), known=0.02)
    assert turned is not None
    assert not any(abs(p.y) < 0.5 and -2.0 < p.x < 0 for p in turned.points), "and that is kept"
    dark = Robot([], laser, parameters)
    for _ in range(5):
        glass = dark.cycle(ahead, known=0.02)
    assert glass is not None
    assert any(p.x == pytest.approx(1.0, abs=0.05) for p in glass.points), "dark, or glass"


def test_both_rays_beside_a_place_give_the_result() -> None:
    near = ScanMap()
    ranges = [2.0, 2.0, 1.0, inf, inf, nan, 2.0]
    near.update(message_of(Cycle(1, 1), ranges, (-0.3, 0.1), (0.1, 5.0), HERE))
    angles = {
        -0.25: RayResult.THROUGH,
        -0.15: RayResult.NONE,
        0.05: RayResult.NOTHING,
        0.15: RayResult.NONE,
    }
    for bearing, expected in angles.items():
        assert near.probe([(1.5 * cos(bearing), 1.5 * sin(bearing))]) == [expected], bearing
    assert near.probe([(2.0 * cos(-0.25), 2.0 * sin(-0.25))]) == [RayResult.SEEN]
    assert near.probe([(-1.0, 0.0)]) == [RayResult.NONE]
    assert near.probe([]) == []


def test_all_round_the_last_ray_is_the_first_ones_neighbour() -> None:
    near = ScanMap()
    near.update(message_of(Cycle(1, 1), [2.0] * 360, (0.0, tau / 360), (0.1, 5.0), HERE))
    assert near.probe([(cos(-0.005), sin(-0.005))]) == [RayResult.THROUGH]


@pytest.mark.parametrize("step", [1e-4, -1e-3, 1.0, -1.0])
@pytest.mark.parametrize("rays", [0, 1, 2, 2048])
def test_whatever_scan_may_be_sent_is_taken(step: float, rays: int) -> None:
    near = ScanMap()
    for _ in range(2):
        near.update(Scan(Cycle(1, 1), 0, 0, 1e6, step, 30.0, bytes([232, 3]) * rays))
        near.probe([(0.5, 0.0)])
    assert len(near.sensed()) <= rays
