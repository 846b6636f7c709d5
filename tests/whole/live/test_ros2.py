"""The society drives a robot that it reaches by ROS 2 alone, over either wire."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from itertools import pairwise
from math import cos, hypot, sin, tau
from pathlib import Path

import pytest

from armadico.bridge.ros2 import cdr, types
from armadico.config import grid_map
from armadico.config.shipped import find
from armadico.mesh.ports import free_port
from tests import real_ros
from tests.programs import Start, call, starter
from tests.whole.live.conftest import NAMESPACE

pytestmark = [pytest.mark.live, pytest.mark.timeout(240)]

DRIVER = Path(__file__).parents[2] / "ros2" / "rclpy_driver.py"
ROBOT = DRIVER.with_name("rclpy_robot.py")  # a robot of real ROS 2, with its own physics
DOMAIN = real_ros.own_domain()


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A domain of the test's own: the last one's robot may still be listed in its domain."""
    monkeypatch.setattr(f"{__name__}.DOMAIN", real_ros.own_domain())


@pytest.fixture
def start(apart: None) -> Iterator[Start]:
    with starter() as start:
        yield start


def address(wire: str) -> str:
    if wire == "ros2":
        pytest.importorskip("cyclonedds", reason="armadico[ros2] is not installed")
        return f"ros2://tb1?domain={DOMAIN}&interface=lo"
    return f"ros2+zenoh://127.0.0.1:{free_port()}/tb1?domain={DOMAIN}"


@pytest.mark.long
@pytest.mark.parametrize("wire", ["ros2", "ros2+zenoh"])
def test_it_is_driven_to_its_goal_and_the_truth_counts(
    start: Start, wire: str, tmp_path: Path
) -> None:
    """By sonars and a laser, which its own description places otherwise than our profile."""
    where, profile = address(wire), tmp_path / "otherwise.toml"
    text = find("robots", "jackal-sonars").read_text()
    profile.write_text(text.replace("x_m = 0.12 ", "x_m = 0.02 "))
    robot = start("sim", "jackal-sonars", "sc1", "--ros2", where, "--namespace", NAMESPACE)
    assert robot.stdout is not None
    assert where in robot.stdout.readline()
    done = call(
        *("run", "sc1", "--goal", "1.2", "0", "0", "--sensors", "ideal", "--json", "--no-plot"),
        *("--profile", str(profile), "--robot", where, "--namespace", NAMESPACE),
        within=180,
    )
    assert done.returncode == 0, done.stderr
    assert "x = 0.120 m" in done.stderr
    result = json.loads(done.stdout)
    assert result["reached"]
    assert result["collisions"] == 0  # None: of a robot whose truth nobody tells


@pytest.mark.long
@pytest.mark.timeout(480)
def test_it_maps_an_unknown_place_by_its_laser_and_comes_back(start: Start, tmp_path: Path) -> None:
    """Nothing but the address and the profile is known, and its sensors have errors."""
    where, map_file = address("ros2+zenoh"), tmp_path / "rooms.yaml"
    robot = start(
        *("sim", "turtlebot3-burger", "rooms-b", "--sensors", "real"),
        *("--ros2", where, "--namespace", NAMESPACE),
    )
    assert robot.stdout is not None
    assert where in robot.stdout.readline()
    done = call(
        *("explore", "--profile", "turtlebot3-burger", "--robot", where, "--namespace", NAMESPACE),
        *("--map", str(map_file), "--json", "--no-plot"),
        within=450,
    )
    assert done.returncode == 0, done.stderr
    assert "exploration done" in done.stderr
    result = json.loads(done.stdout)
    assert result["reached"], "it is back in truth, too"
    assert result["collisions"] == 0
    assert grid_map.read(map_file).area(grid_map.FREE) == pytest.approx(38.7, abs=1.0)


@pytest.mark.long
def test_somebody_elses_program_drives_a_simulated_robot(start: Start) -> None:
    python, where = real_ros.interpreter(), address("ros2")
    robot = start("sim", "turtlebot3-burger", "sc1", "--ros2", where, "--namespace", NAMESPACE)
    assert robot.stdout is not None
    assert where in robot.stdout.readline()
    done = subprocess.run(
        [python, DRIVER, "/tb1"],
        env=real_ros.environment(str(DOMAIN)),
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    report = json.loads(done.stdout)
    assert any(name.startswith("/tb1/sim_turtlebot3_burger_") for name in report["nodes"])
    assert 0.2 <= report["x"] < 1.0
    assert report["rays"] == 360
    assert report["volts"] > 10.0
    assert report["hash"] == cdr.type_hash(types.Odometry)


@pytest.mark.long
def test_a_robot_that_speaks_p2os_is_none_of_ros_2s() -> None:
    done = call("sim", "sc1", "--ros2")
    assert done.returncode == 2
    assert "--ros2: pioneer-2dx" in done.stderr


@pytest.mark.parametrize(
    ("address", "why"),
    [("ros2://?domain=999", "domain '999'"), ("tcp://localhost:1", "begins with none of ros2")],
)
def test_an_address_that_is_none(address: str, why: str) -> None:
    done = call("sim", "jackal", "--ros2", address)
    assert done.returncode == 2
    assert why in done.stderr


# A robot that shares no code with the project -----------------------------------------------------


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """The map of the robot's room: 4 x 3 m, and a pillar."""
    corners = [(0, 0), (4000, 0), (4000, 3000), (0, 3000), (0, 0)]
    sides = [k * tau / 8 for k in range(9)]
    pillar = [(round(2000 + 200 * cos(at)), round(2400 + 200 * sin(at))) for at in sides]
    pairs = [*pairwise(corners), *pairwise(pillar)]
    lines = [f"{x} {y} {to_x} {to_y}" for (x, y), (to_x, to_y) in pairs]
    head = ["2D-Map", "LineMinPos: 0 0", "LineMaxPos: 4000 3000", f"NumLines: {len(lines)}"]
    path = tmp_path / "room.map"
    path.write_text("\n".join([*head, "LINES", *lines, "DATA", ""]))
    return path


@pytest.fixture
def rclpy_robot(apart: None) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts the robot with some oddities; it prints its true pose."""
    pytest.importorskip("cyclonedds", reason="armadico[ros2] is not installed")
    with starter([real_ros.interpreter(), str(ROBOT)], real_ros.environment(str(DOMAIN))) as begin:
        yield begin


def drive(room: Path, *more: str, within: float = 90.0) -> tuple[int, dict[str, object], str]:
    """`armadico run` to a place 0.5 m away: its exit code, its result, and its log."""
    done = call(
        *("run", str(room), "--start", "1", "1", "0", "--goal", "1.5", "1", "0", "--no-plot"),
        *("--profile", "turtlebot3-burger", "--robot", f"ros2://?domain={DOMAIN}&interface=lo"),
        *("--namespace", NAMESPACE, "--json", "--for", "60", *more),
        within=within,
    )
    return done.returncode, json.loads(done.stdout), done.stderr


def last_place(robot: subprocess.Popen[str]) -> tuple[float, float]:
    """The robot's true place when it ended, m."""
    robot.terminate()
    truth, _ = robot.communicate(timeout=30.0)
    at = json.loads(truth.splitlines()[-1])
    return at["x"], at["y"]


@pytest.mark.long
def test_a_robot_of_real_ros_2_is_driven_to_its_goal(
    room: Path, rclpy_robot: Callable[..., subprocess.Popen[str]]
) -> None:
    """It is discovered late, its scans are late, sweep, and vary, and it reports no speeds."""
    robot = rclpy_robot("--no-speeds", "--clockwise", "--rays", "vary")
    code, result, log = drive(room)
    assert "odometry without speeds: its twist" in log
    assert "touched" not in log
    x, y = last_place(robot)
    assert hypot(x - 1.5, y - 1.0) < 0.15, (code, result, log)


@pytest.mark.long
@pytest.mark.parametrize(
    ("oddity", "text", "arrives"),
    [
        (("--share", "0.4"), "slow base: it", True),
        (("--share", "0"), "deaf base: it does not move", False),
        (("--twist",), "reads /cmd_vel as geometry_msgs/msg/Twist; here it is published", False),
    ],
    ids=["slow", "deaf", "twist"],
)
def test_a_base_that_does_otherwise_is_named_and_has_touched_nothing(
    room: Path,
    rclpy_robot: Callable[..., subprocess.Popen[str]],
    oddity: tuple[str, ...],
    text: str,
    arrives: bool,
) -> None:
    robot = rclpy_robot(*oddity)
    for _ in range(10):
        code, result, log = drive(room)
        if "deaf base" not in log or "deaf base" in text:
            break  # else it counted as deaf before DDS had announced its subscription
    assert text in log
    assert "touched" not in log
    x, y = last_place(robot)
    assert (hypot(x - 1.5, y - 1.0) < 0.15) is arrives, (code, result, log)
    assert arrives or (code != 0 and text in str(result["why"]))
