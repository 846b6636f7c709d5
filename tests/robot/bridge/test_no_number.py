"""A driver that reports what is no number: it is named and left out, and all else works."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace

from armadico.bridge.readings import sound
from armadico.bridge.session import Pose, Reported
from tests.robot.bridge.robot_bench import Bench

REPORT = Reported(pose=Pose(1.0, 0.0, 0.0), v=0.1, w=0.0, battery_v=12.0, echoes=((0, 1.0),))


def test_a_sound_report_is_passed_on() -> None:
    assert sound(REPORT) == (REPORT, "")


@pytest.mark.parametrize(
    ("report", "fault"),
    [
        (replace(REPORT, v=nan), "v = nan"),
        (replace(REPORT, w=inf), "w = inf"),
        (replace(REPORT, pose=Pose(nan, 0.0, 0.0)), "pose.x = nan"),
    ],
)
def test_without_a_pose_or_speeds_there_is_no_report(report: Reported, fault: str) -> None:
    assert sound(report) == (None, fault)


def test_the_battery_and_each_echo_are_left_out_alone() -> None:
    assert sound(replace(REPORT, battery_v=nan))[0] == replace(REPORT, battery_v=0.0)
    kept, fault = sound(replace(REPORT, echoes=((0, nan), (1, 2.0))))
    assert kept is not None
    assert kept.echoes == ((1, 2.0),), "and it is no free space"
    assert "echo" in fault


def test_the_robot_agent_names_it_and_makes_no_cycle_of_it() -> None:
    bench = Bench().connect().cycles(2)
    before = bench.state().cycle
    bench.robot._on_events([replace(REPORT, v=nan)])
    bench.take()
    assert bench.state().cycle == before
    assert "the driver of pioneer-2dx reports v = nan: it is left out" in bench.logs()[-1]
    bench.cycles(1)
    assert bench.state().cycle != before
