"""A guest in a society of real processes: it sends the robot somewhere, stops it, is told."""

from __future__ import annotations

import signal

import pytest

import armadico
from armadico import Pose, RobotState
from armadico.config.scenarios import Scenario
from tests.robot.society import SOON
from tests.whole.live.conftest import NAMESPACE, Start

pytestmark = pytest.mark.live

NAMES = {"robot", "encoder", "sonar", "goto", "interface"}
FEW = Scenario(
    name="few",
    world="sc1",
    sensors="ideal",
    start=(-1.5, 0.0, 0.0),
    goal=(6.5, 0.0, 0.0),
    agents=("encoder", "sonar", "goto", "interface"),
)


def test_a_guest_sends_the_robot_stops_it_and_lets_it_go_on(start: Start) -> None:
    start(FEW)
    with armadico.connect() as guest:
        assert guest.mesh.namespace == NAMESPACE
        assert {name for name, _ in guest.agents()} == NAMES
        guest.stop(by="a test")
        state = guest.latest(RobotState)
        assert state is not None
        assert (state.stop.stopped, state.stop.by) == (True, "a test")
        assert abs(state.v) < 0.05
        guest.resume()
        here = guest.latest(Pose, timeout=SOON)
        assert here is not None
        mission = guest.goto(here.x + 0.4, here.y, 0.0, direct=True)
        assert mission.length == pytest.approx(0.4, abs=0.2)
        to_go: list[float | None] = []
        assert mission.wait(SOON, lambda m: to_go.append(m.to_go))
        assert mission.reached
        assert to_go
        arrived = guest.latest(Pose)
        assert arrived is not None
        assert arrived.x == pytest.approx(here.x + 0.4, abs=0.15)
        assert mission.wait(), "once reached it stays so"


@pytest.mark.long
def test_a_mission_that_is_not_there_in_time_goes_on_and_one_that_is_replaced_is_told(
    start: Start,
) -> None:
    start(FEW)
    with armadico.connect() as guest, armadico.connect() as other:
        mission = guest.goto(6.0, 0.0, direct=True)
        assert not mission.wait(timeout=0.5)
        assert mission.to_go
        other.goto(5.0, 0.0, direct=True)
        with pytest.raises(armadico.MissionReplacedError):
            mission.wait(SOON)


@pytest.mark.long
def test_whoever_took_the_mission_and_is_gone_is_absent(start: Start) -> None:
    society = start(FEW)
    with armadico.connect() as guest:
        mission = guest.goto(6.0, 0.0, direct=True)
        society.send("interface", signal.SIGKILL)
        with pytest.raises(armadico.AbsentError, match="no status of the mission"):
            mission.wait(SOON)
