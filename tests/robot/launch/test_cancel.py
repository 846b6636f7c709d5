"""A goal is taken back by whoever has ordered it, and nothing is latched."""

from __future__ import annotations

import pytest

from armadico.config.scenarios import Scenario
from armadico.core.messages import RobotState
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.runtime.errors import MissionRefusedError

LINE = Scenario(
    name="line",
    world="sc1",
    sensors="ideal",
    start=(-1.5, 0.0, 0.0),
    plan="direct",
    agents=("encoder", "sonar", "goto", "interface"),
)


def test_a_cancelled_goal_leaves_the_robot_at_rest_and_free_for_the_next_one() -> None:
    run = Rehearsal(LINE, Options())
    run.start()
    guest = run.client
    mission = guest.goto(4.5, 0.0, 0.0, direct=True)
    assert not mission.wait(2.0)
    mission.cancel("ann")
    assert not mission.wait(2.0)
    assert mission.failed == "cancelled by ann"
    guest.wait_for(lambda: (s := guest.latest(RobotState)) and abs(s.v) < 0.01, 5.0)
    state = guest.latest(RobotState)
    assert state is not None
    assert abs(state.v) < 0.01
    assert not state.stop.stopped
    with pytest.raises(MissionRefusedError, match="ended already"):
        mission.cancel()
    assert guest.goto(0.0, 0.0, 0.0, direct=True).wait(30.0)
