"""A society's ROS 2 samples: stamps, frames, values; and valid and invalid goals."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest
from msgspec.structs import replace
from pycdr2 import IdlStruct

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.gateway.society import Society
from armadico.config.grid_map import Cells, message_of
from armadico.config.map_graphs import message_of as graph_message
from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.mobile.geometry import compose
from armadico.mobile.messages import (
    BatteryLevel,
    Cell,
    Echo,
    LocalMap,
    MissionState,
    MissionStatus,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import message_of as message_of_scan

SECOND = 1_000_000_000
NOW = 1_700_000_000 * SECOND + 5
EPOCH = 7
BALLOT = m.Ballot(3, 0.6, False, "goto-00ff")


def cycle(number: int = 1) -> m.Cycle:
    return m.Cycle(EPOCH, number)


def state(
    number: int = 1, *, x: float = 1.0, y: float = 2.0, theta: float = 0.5, **more
) -> m.RobotState:
    return m.RobotState(cycle(number), x, y, theta, 0.4, -0.2, 12.5, True, False, **more)


def samples_of(society: Society, *messages: m.Message, at: int = NOW) -> dict[str, list[IdlStruct]]:
    """The decoded samples of messages, by topic."""
    kinds = cdr.known()
    found: dict[str, list[IdlStruct]] = {}
    for message in messages:
        key = type(message).__name__.lower()
        for channel, data in society.translate(key, message, at):
            found.setdefault(channel.topic, []).append(cdr.decode(kinds[channel.schema], data))
    return found


def yaw(q: types.Quaternion) -> float:
    return 2.0 * math.atan2(q.z, q.w)


def where(sample: types.TransformStamped) -> tuple[float, float, float]:
    moved = sample.transform
    return moved.translation.x, moved.translation.y, yaw(moved.rotation)


def transforms(samples: Iterable[IdlStruct]) -> dict[str, types.TransformStamped]:
    return {t.child_frame_id: t for s in samples for t in s.transforms}


def test_odometry_and_its_transform_have_the_stamp_of_the_status_packet() -> None:
    found = samples_of(Society(), state())
    (odom,) = found["/odom"]
    assert (odom.header.stamp.sec, odom.header.stamp.nanosec) == (1_700_000_000, 5)
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert (odom.pose.pose.position.x, odom.pose.pose.position.y) == (1.0, 2.0)
    assert yaw(odom.pose.pose.orientation) == pytest.approx(0.5)
    assert (odom.twist.twist.linear.x, odom.twist.twist.angular.z) == (0.4, -0.2)
    moved = transforms(found["/tf"])["base_link"]
    assert moved.header == odom.header
    assert where(moved) == pytest.approx((1.0, 2.0, 0.5))


def test_map_to_base_link_is_the_pose() -> None:
    pose = Pose(cycle(), 4.0, -3.0, 2.0)
    found = samples_of(Society(), state(), pose)
    moved = transforms(found["/tf"])
    assert moved["odom"].header.frame_id == "map"
    assert moved["odom"].header.stamp == moved["base_link"].header.stamp
    assert compose(where(moved["odom"]), where(moved["base_link"])) == pytest.approx(
        (4.0, -3.0, 2.0)
    )


def test_a_pose_may_arrive_before_or_after_its_state() -> None:
    early, late = Society(), Society()
    pose = Pose(cycle(9), 4.0, -3.0, 2.0)
    samples_of(early, pose, at=NOW - 1000)
    moved = transforms(samples_of(early, state(9))["/tf"])
    assert moved == transforms(samples_of(late, state(9), state(10), pose)["/tf"]) | {
        "base_link": moved["base_link"]
    }
    assert moved["odom"].header.stamp == moved["base_link"].header.stamp
    assert "odom" not in transforms(samples_of(early, state(10))["/tf"])


def test_samples_of_a_cycle_have_the_same_stamp() -> None:
    society = Society()
    samples_of(society, state())
    later = NOW + SECOND // 50
    found = samples_of(
        society, Pose(cycle(), 0, 0, 0), Obstacles(cycle(), None, None, None, None), at=later
    )
    assert {s.header.stamp.nanosec for s in (*found["/pose"], *found["/obstacles"])} == {5}


def test_the_covariance_is_that_of_x_y_and_yaw() -> None:
    (pose,) = samples_of(Society(), Pose(cycle(), 0, 0, 0, (1, 2, 3, 4, 5, 6)))["/pose"]
    whole = np.array(pose.pose.covariance).reshape(6, 6)
    assert (whole == whole.T).all()
    assert whole[np.ix_((0, 1, 5), (0, 1, 5))].tolist() == [[1, 2, 3], [2, 4, 5], [3, 5, 6]]
    assert np.count_nonzero(whole) == 9
    (unknown,) = samples_of(Society(), Pose(cycle(), 0, 0, 0))["/pose"]
    assert not any(unknown.pose.covariance)


def test_sonars_are_ranges_in_frames_of_their_own() -> None:
    front, rear = Echo(0.07, 0.136, math.pi / 2, 1.5), Echo(-0.2, 0.1, math.pi / 2, None)
    society = Society()
    found = samples_of(society, state(), Sonar(cycle(), 5.0, (front, rear)))
    near, far = found["/sonar"]
    assert (near.header.frame_id, near.range) == ("sonar_90", 1.5)
    assert (far.header.frame_id, far.range) == ("sonar_rear_90", math.inf)
    assert (near.radiation_type, near.max_range) == (0, 5.0)
    static = transforms(found["/tf_static"])
    assert static["sonar_90"].header.frame_id == "base_link"
    assert where(static["sonar_90"]) == pytest.approx((0.07, 0.136, math.pi / 2))
    assert "/tf_static" not in samples_of(society, Sonar(cycle(2), 5.0, (front,)))


def test_a_sonars_cone_and_minimum_range_are_those_of_the_description() -> None:
    limits = (0.1, 0.1, 0.1, 1.0, 1.0, 0.3, 0.3, 1.7, 1.7, 0.3, 2.0)
    echo, society = Echo(0.1, 0.0, 0.0, 1.5), Society()
    (before,) = samples_of(society, Sonar(cycle(), 5.0, (echo,)))["/sonar"]
    assert (before.field_of_view, before.min_range) == (0.0, 0.0)
    samples_of(society, m.Description("slim", 0.1, *limits, cone=0.25, nearest=0.125))
    (after,) = samples_of(society, Sonar(cycle(2), 5.0, (echo,)))["/sonar"]
    assert (after.field_of_view, after.min_range) == (0.25, 0.125)


def test_all_sonars_are_in_the_newest_static_transforms() -> None:
    society = Society()
    ring = [Echo(0.1, 0.0, math.radians(deg), 1.0) for deg in (-50, 10, 10, 30)]
    ring[2] = Echo(0.1, 0.05, ring[1].bearing, 1.0)
    for echo in ring:
        found = samples_of(society, Sonar(cycle(), 5.0, (echo,)))
    assert len(transforms(found["/tf_static"])) == 4
    assert found["/sonar"][0].header.frame_id == "sonar_30"


def test_a_scan_is_a_laser_scan_at_the_lasers_place() -> None:
    ranges = [1.0, math.inf, math.nan, 2.5]
    scan = message_of_scan(cycle(), ranges, (-0.3, 0.2), (0.1, 5.0), (0.12, 0.05, 0.0), number=4)
    society = Society()
    found = samples_of(society, state(), scan)
    (laser,) = found["/scan"]
    assert laser.header.frame_id == "base_scan"
    assert laser.angle_min == pytest.approx(-0.3)
    assert laser.angle_max == pytest.approx(0.3)
    assert laser.angle_increment == pytest.approx(0.2)
    assert laser.range_max == pytest.approx(5.0)
    assert laser.ranges[0] == pytest.approx(1.0)
    assert laser.ranges[1] == math.inf
    assert math.isnan(laser.ranges[2])
    moved = transforms(found["/tf"])["base_scan"]
    assert (moved.header.frame_id, moved.header.stamp) == ("base_link", laser.header.stamp)
    assert where(moved) == pytest.approx((0.12, 0.05, 0.0))
    assert "/scan" not in samples_of(society, scan), "the laser is slower than the cycles"


def test_a_scan_in_the_other_direction_keeps_its_angles() -> None:
    scan = message_of_scan(cycle(), [1.0, 2.0], (0.3, -0.2), (0.1, 5.0), (0.0, 0.0, 0.0))
    (laser,) = samples_of(Society(), scan)["/scan"]
    assert (laser.angle_min, laser.angle_max) == (pytest.approx(0.3), pytest.approx(0.1))
    assert laser.angle_increment == pytest.approx(-0.2)


@pytest.mark.parametrize(
    "absurd",
    [
        Scan(cycle(), 0, 0, 0, 0.1, 5.0, b"odd"),
        Scan(cycle(), 10, -10, 1e6, -1.0, 100, bytes(4096)),
        Pose(cycle(), 1e6, -1e6, -1e6, (1e6,) * 6),
        Obstacles(cycle(), None, None, None, None, (m.Point(1e6, -1e6),) * 2048),
        Trajectory(0, 0, (Waypoint(1e6, -1e6, 1e6),) * 1024, m.Point(-1e6, 1e6)),
        MissionStatus(0, MissionState.FAILED, 1e6, 2**52, "\u2764" * 100),
    ],
    ids=lambda message: type(message).__name__,
)
def test_extreme_messages_have_no_effect_on_others(absurd: m.Message) -> None:
    society = ready()
    samples_of(society, absurd)
    assert "/odom" in samples_of(society, state(2))


def test_obstacles_are_points_in_the_body_frame() -> None:
    points = (m.Point(0.5, 0.25), m.Point(-1.0, 2.0))
    (cloud,) = samples_of(Society(), Obstacles(cycle(), None, None, None, None, points))[
        "/obstacles"
    ]
    assert cloud.header.frame_id == "base_link"
    assert [f.name for f in cloud.fields] == ["x", "y", "z"]
    assert (cloud.width, cloud.row_step) == (2, 24)
    found = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3)
    assert found.tolist() == [[0.5, 0.25, 0.0], [-1.0, 2.0, 0.0]]


def test_obstacles_of_several_sensors_are_one_cloud() -> None:
    society = Society()
    near = Obstacles(cycle(5), None, None, None, None, (m.Point(1, 0),))
    list(society.translate("laser/obstacles", near, NOW))

    def width(number: int) -> int:
        other = Obstacles(cycle(number), None, None, None, None, (m.Point(2, 0),))
        found = [
            s
            for s in society.translate("sonar/obstacles", other, NOW)
            if s.channel.topic == "/obstacles"
        ]
        return cdr.decode(types.PointCloud2, found[0].data).width

    assert width(6) == 2
    assert width(20) == 1  # the laser's obstacles are stale


def test_the_local_map_is_a_square_around_the_robot() -> None:
    cells = (Cell(0, 1, 0.9, 1.01, 0.02), Cell(0, 1, 0.3, 1.02, 0.03))
    (grid,) = samples_of(Society(), LocalMap(cycle(), 18, 10, 2.0, cells))["/local_map"]
    assert grid.header.frame_id == "base_link"
    assert (grid.info.width, grid.info.height, len(grid.data)) == (40, 40, 1600)
    assert (grid.info.origin.position.x, grid.info.resolution) == (-2.0, pytest.approx(0.1))
    known = np.array(grid.data).reshape(40, 40)
    assert known[20, 30] == 90
    assert np.count_nonzero(known == -1) == 1599


def test_the_map_is_published_if_it_has_changed() -> None:
    states = np.array([[0, 1, 2], [2, 2, 1]], dtype=np.uint8)
    grid = message_of(Cells(-1.0, 0.5, 0.05, states))
    society = Society()
    (sample,) = samples_of(society, grid)["/map"]
    assert (sample.info.width, sample.info.height) == (3, 2)
    assert list(sample.data) == [-1, 0, 100, 100, 100, 0]
    assert (sample.info.origin.position.x, sample.info.origin.position.y) == (-1.0, 0.5)
    assert "/map" not in samples_of(society, grid)


def test_a_map_of_another_revision_waits_for_a_pose_on_it() -> None:
    grid = message_of(Cells(-1.0, 0.5, 0.05, np.ones((2, 3), dtype=np.uint8)), revision=2)
    society = Society()
    said = samples_of(society, state(7), grid, Pose(cycle(7), 4.0, 3.0, 0.0))
    assert "/map" not in said
    said = samples_of(society, state(8), Pose(cycle(8), 5.0, 3.0, 0.0, revision=2))
    assert len(said["/map"]) == 1
    assert "/map" not in samples_of(society, grid, state(9))


def test_a_graph_is_markers_and_a_doubtful_map_a_warning() -> None:
    poses = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
    graph = graph_message(3, poses, [(0, 2), (1, 2)], [False, True], "so it is")
    found = samples_of(Society(), replace(graph, packed=b"no"), graph, state())
    (sample,) = found["/graph"]
    lines = {each.ns: [(p.x, p.y) for p in each.points] for each in sample.markers}
    assert lines == {
        "key_scans": [(0, 0), (1, 0), (1, 1)],
        "loops": [(0, 0), (1, 1)],
        "loops_off": [(1, 0), (1, 1)],
    }
    assert len({(c.color.r, c.color.g, c.color.b) for c in sample.markers}) == 3
    (status,) = (s for s in found["/diagnostics"][-1].status if s.name == "map")
    assert (status.level, status.message) == (1, "the map may be wrong: so it is")


def test_the_walls_of_the_world_are_the_first_map() -> None:
    world = World("w", ((0.0, 0.0, 2.0, 0.0), (2.0, 0.0, 2.0, 1.0)), (0.0, 0.0, 2.0, 1.0))
    society = Society(world=world)
    (grid,) = samples_of(society, state())["/map"]
    known = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    assert (known[0, :40] == 100).all()
    assert (known[:20, 40] == 100).all()
    assert (known[1:20, 1:39] == 0).all()
    assert "/map" not in samples_of(society, state(2))


def test_a_path_begins_at_the_missions_start_and_is_published_once() -> None:
    mission = Trajectory(1, 5, (Waypoint(1, 1, 0), Waypoint(2, 1, 1.5)), m.Point(0, 0))
    society = Society()
    (path,) = samples_of(society, mission)["/path"]
    assert [(p.pose.position.x, p.pose.position.y) for p in path.poses] == [(0, 0), (1, 1), (2, 1)]
    assert yaw(path.poses[0].pose.orientation) == pytest.approx(math.pi / 4)
    assert {p.header.frame_id for p in path.poses} == {"map"}
    assert "/path" not in samples_of(society, mission)
    (ended,) = samples_of(society, Trajectory(2, 5, ()))["/path"]
    assert not ended.poses


def test_the_battery_is_published_once_per_second() -> None:
    society = Society()
    (battery,) = samples_of(society, state(charging=True))["/battery_state"]
    assert (battery.voltage, battery.power_supply_status, battery.present) == (12.5, 1, True)
    assert math.isnan(battery.percentage)
    assert "/battery_state" not in samples_of(society, state(2), at=NOW + SECOND // 10)
    level = BatteryLevel(cycle(), 12.4, 0.5, 1000.0)
    (battery,) = samples_of(society, level, state(3), at=NOW + SECOND)["/battery_state"]
    assert (battery.percentage, battery.power_supply_status) == (0.5, 2)


def statuses(found: dict[str, list[IdlStruct]]) -> dict[str, types.DiagnosticStatus]:
    return {s.name: s for array in found.get("/diagnostics", ()) for s in array.status}


def test_a_change_of_the_driving_agent_is_published_immediately() -> None:
    society = Society()
    held = m.Ack("wheels", cycle(), BALLOT, BALLOT, cycle(), 0.6, measured=(0.1, 0.0))
    released = m.Ack("wheels", cycle(20), BALLOT)
    free = statuses(samples_of(society, m.Ack("wheels", cycle())))["wheels holder"]
    assert not {v.key: v.value for v in free.values}["holder"]
    found = statuses(samples_of(society, held, at=NOW + 1))["wheels holder"]
    assert found.message == "goto"
    values = {v.key: v.value for v in found.values}
    assert values == {
        "holder": "goto-00ff",
        "utility": "0.600",
        "critical": "false",
        "term": "3",
        "cycle": "1",
    }
    assert not statuses(samples_of(society, held, at=NOW + 2))
    found = statuses(samples_of(society, released, at=NOW + 3))["wheels holder"]
    assert found.message == free.message != "goto"


def test_a_stop_is_a_warning_and_a_lost_robot_an_error() -> None:
    assert statuses(samples_of(Society(), state()))["robot"].level == 0
    stop = m.Stop(1, True, "armadico stop", 9)
    found = statuses(samples_of(Society(), state(stop=stop)))["robot"]
    assert found.level == 1
    assert stop.by in found.message
    lost = Pose(cycle(), 0, 0, 0, (9.0, 0, 0, 9.0, 0, 1.0))
    society = Society()
    samples_of(society, state())
    assert statuses(samples_of(society, lost, state(2), at=NOW + 2 * SECOND))["robot"].level == 2


# Several robots -----------------------------------------------------------------------------------


def test_several_robots_share_the_map_and_nothing_else() -> None:
    society = Society("lab/robot-1")
    found = samples_of(
        society, state(), Pose(cycle(), 0, 0, 0), Sonar(cycle(), 5.0, (Echo(0, 0, 0, 1),))
    )
    assert {t for t in found if t not in {"/tf", "/tf_static", "/diagnostics"}} == {
        *("/lab/robot_1/odom", "/lab/robot_1/pose", "/lab/robot_1/sonar"),
        "/lab/robot_1/battery_state",
    }
    frames = {
        (t.header.frame_id, t.child_frame_id)
        for s in (*found["/tf"], *found["/tf_static"])
        for t in s.transforms
    }
    assert frames == {
        ("lab/robot_1/odom", "lab/robot_1/base_link"),
        ("map", "lab/robot_1/odom"),
        ("lab/robot_1/base_link", "lab/robot_1/sonar_0"),
    }
    assert society.goals.topic == "/lab/robot_1/goal_pose"


# Channels -----------------------------------------------------------------------------------------


# Goals --------------------------------------------------------------------------------------------


def goal(x=1.0, y=2.0, theta=0.5, frame="map", stamp=0, **turned) -> bytes:
    turned = turned or {"z": math.sin(theta / 2), "w": math.cos(theta / 2)}
    pose = types.Pose(types.Point(x, y), types.Quaternion(**turned))
    return cdr.encode(types.PoseStamped(types.Header(types.Time(stamp), frame), pose))


def ready() -> Society:
    society = Society()
    samples_of(society, state(), Pose(cycle(), 4.0, -3.0, math.pi / 2))
    return society


def test_a_goal_is_a_mission() -> None:
    request = ready().goal(goal())
    assert (request.goal.x, request.goal.y) == (1.0, 2.0)
    assert request.goal.theta == pytest.approx(0.5)
    assert request.planned


def test_a_heading_does_not_depend_on_the_quaternions_norm() -> None:
    request = ready().goal(goal(z=1.05 * math.sin(0.6), w=1.05 * math.cos(0.6)))
    assert request.goal.theta == pytest.approx(1.2)


def test_a_goal_in_another_frame_is_transformed() -> None:
    ahead = ready().goal(goal(1.0, 0.0, 0.0, "base_link")).goal
    assert (ahead.x, ahead.y, ahead.theta) == pytest.approx((4.0, -2.0, math.pi / 2))
    origin = ready().goal(goal(1.0, 2.0, 0.5, "/odom")).goal
    assert (origin.x, origin.y) == pytest.approx((4.0, -3.0))


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (goal(frame=""), "''"),
        (goal(x=math.nan), "finite"),
        (goal(z=0.0, w=0.0), "norm 0"),
        (goal(x=2e6), r"2e\+06 m"),
        (b"\0\1\0\0\1", "PoseStamped"),
    ],
)
def test_an_invalid_goal_is_refused_with_the_reason(data: bytes, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        ready().goal(data)


NOW_S = 1_700_000_000


@pytest.mark.parametrize("stamp", [0, NOW_S - 9, NOW_S, NOW_S + 3600])
def test_a_goal_without_a_stamp_or_with_a_fresh_one_is_accepted(stamp: int) -> None:
    assert ready().goal(goal(stamp=stamp), at=NOW_S * 10**9).goal.x == 1.0


def test_a_goal_with_an_old_stamp_is_refused() -> None:
    """Such as from a bag that is played back, or delayed by the network."""
    with pytest.raises(ValueError, match=r"11 s old.*10 s"):
        ready().goal(goal(stamp=NOW_S - 11), at=NOW_S * 10**9)


def test_a_goal_in_a_frame_without_a_known_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="odom"):
        Society().goal(goal(frame="odom"))
