"""`armadico ros2` is called wrongly, or cannot be done: it says why."""

from __future__ import annotations

import sys

import pytest

from armadico.bridge.ros2 import command
from armadico.bridge.ros2.addresses import read_address
from armadico.cli.options import FailedError, UsageError


@pytest.mark.parametrize(
    ("args", "why"),
    [
        (["ros2://?domain=233"], "domain '233' is no number from 0 to 232"),
        (["--namespace", "a-b", "--namespace", "a.b"], r"a\.b.*'a_b'.*'a-b'"),
    ],
)
def test_what_cannot_be_meant_is_said(args: list[str], why: str) -> None:
    with pytest.raises(UsageError, match=why):
        command.main(args)


def test_without_cyclone_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "armadico.bridge.ros2.dds", None)
    with pytest.raises(FailedError, match=r"pip install 'armadico\[ros2\]'"):
        command.main(["--namespace", "nobody"])


def test_several_robots_are_told_apart_below_the_address() -> None:
    args = command.main.parse(["ros2://site"])
    made = command._societies(args, ["robot1", "robot-2"], read_address(args.address).namespace)
    assert [each.goals.topic for each in made.values()] == [
        "/site/robot1/goal_pose",
        "/site/robot_2/goal_pose",
    ]
    (only,) = command._societies(args, ["robot1"], "").values()
    assert only.goals.topic == "/goal_pose"
