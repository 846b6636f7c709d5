"""Profiles of ROS 2 robots: what they need, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from armadico.bridge.ros2.profile import Ros2Robot
from armadico.config.loading import find, names
from armadico.config.profile import NEVER_S, load_profile
from armadico.core.config_errors import ConfigError, ConfigNameError, ConfigValueError
from tests.robot.config.test_profile import foreign, without, written  # noqa: F401 - a fixture


def test_a_robot_of_two_kinds_is_refused(tmp_path: Path) -> None:
    text = find("robots", "pioneer-2dx").read_text() + "[ros2]\ncycle_s = 0.1\n"
    line = len(text.splitlines()) - 1
    with pytest.raises(ConfigError, match=rf":{line}: .*\[p2os\].*\[ros2\]"):
        load_profile(written(tmp_path, text))


def test_a_base_is_told_no_more_than_it_can_do() -> None:
    for name in names("robots"):
        profile = load_profile(name)
        if isinstance(profile, Ros2Robot):
            limits, drive = profile.limits, profile.drive
            assert max(limits.v_accel, limits.v_decel) <= drive.v_accel
            assert max(limits.w_accel, limits.w_decel) <= drive.w_accel


def test_a_robot_without_a_watchdog_says_the_longest_there_is() -> None:
    assert load_profile("turtlebot3-burger").watchdog_s == NEVER_S
    assert load_profile("jackal").watchdog_s == 0.5


def test_a_kind_that_is_not_installed_is_named_with_those_that_are(tmp_path: Path) -> None:
    text = find("robots", "jackal").read_text().replace("[ros2", "[ros")
    line = next(n for n, row in enumerate(text.splitlines(), 1) if row.startswith("[ros]"))
    with pytest.raises(ConfigNameError) as caught:
        load_profile(written(tmp_path, text))
    error = caught.value
    assert (error.line, error.kind, error.near) == (line, "kind of robot", "ros2")


def test_a_value_of_a_section_is_told_with_its_line(tmp_path: Path) -> None:
    text = find("robots", "jackal").read_text().replace("odom_hz = 50.0", "odom_hz = 5e3")
    assert "odom_hz = 5e3" in text
    line = next(n for n, row in enumerate(text.splitlines(), 1) if "odom_hz = 5e3" in row)
    with pytest.raises(ConfigValueError) as caught:
        load_profile(written(tmp_path, text))
    error = caught.value
    assert (error.line, error.key, error.value) == (line, "ros2.odom_hz", 5000.0)


@pytest.mark.parametrize(
    ("table", "message"), [("drive", "drive"), ("laser", "sonar.*laser"), ("ros2.odom", "odom")]
)
def test_a_table_that_is_missing_is_named(tmp_path: Path, table: str, message: str) -> None:
    path = written(tmp_path, without(find("robots", "jackal").read_text(), table))
    with pytest.raises(ConfigError, match=message):
        load_profile(path)


def test_a_laser_needs_a_topic(tmp_path: Path) -> None:
    path = written(tmp_path, without(find("robots", "jackal").read_text(), "ros2.scan"))
    with pytest.raises(ConfigError, match=r"\[ros2.scan\]"):
        load_profile(path)


@pytest.mark.parametrize("name", ["", "1odom", "odom/", "a b", "~odom", "/", "odom//x", "@seen"])
def test_what_is_no_topic_is_refused(tmp_path: Path, name: str) -> None:
    text = find("robots", "jackal").read_text().replace('name = "tf"', f'name = "{name}"')
    with pytest.raises(ConfigError, match=r"ros2\.tf\.name"):
        load_profile(written(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rate_hz = 40.0", "rate_hz = 1e-9", "rate_hz"),  # scans would be believed for ever
        ('name = "tf"', 'name = "/cmd_vel"', "ros2"),
        ("low_v = 23.4", "low_v = 40.0", "empty_v.*low_v"),
        ('name = "jackal"', 'name = "a\\u001b[2J"', "name"),
        ('name = "jackal"', 'name = ""', "name"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = find("robots", "jackal").read_text()
    assert old in text
    with pytest.raises(ConfigError, match=message):
        load_profile(written(tmp_path, text.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (', frame = "sonar_5"', "", "frame"),
        ('"sonar_5"', '"sonar_4"', "frame"),
        ("[[ros2.sonar]]", '[[ros2.sonar]]\nname = "a"\n[[ros2.sonar]]', "8 .*2 "),
        ('[[ros2.sonar]]\nname = "sonar"', '[ros2.camera]\nname = "sonar"', "camera"),
        ("[2, 1, 4, 0, 6, 3, 7, 5]", "[2, 1, 4, 0, 6, 3, 7, 8]", "firing_order.* 8"),
        ("[2, 1, 4, 0, 6, 3, 7, 5]", "[2, 1, 4, 0, 6, 3, 7]", "firing_order.* 5"),
        ("max_m = 5.0", "max_m = 0.05", "min_m.*max_m"),
    ],
)
def test_sonars_that_cannot_be_told_apart_or_heard_are_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = find("robots", "jackal-sonars").read_text()
    text = re.sub(r"\[\[ros2.sonar\]\].*", "[[ros2.sonar]]", text)
    assert old in text
    with pytest.raises(ConfigError, match=message):
        load_profile(written(tmp_path, text.replace(old, new)))


def test_a_topic_of_sonars_that_there_are_not_is_refused(tmp_path: Path) -> None:
    text = find("robots", "jackal").read_text() + '[[ros2.sonar]]\nname = "sonar"\n'
    with pytest.raises(ConfigError, match=r"0 .*1 "):
        load_profile(written(tmp_path, text))
