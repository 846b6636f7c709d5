"""Yesterday's recording is published again on today's mesh: nothing moves, nothing stops."""

from __future__ import annotations

from functools import cache
from math import hypot
from typing import NamedTuple

import pytest

from armadico.core.messages import (
    Ack,
    AgentSetting,
    Log,
    RobotState,
    Setting,
    Stop,
    Tuning,
    encode,
)
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.mobile.messages import InitialPose, MissionStatus, Origin, Pose, Trajectory, Truth
from tests.driven import Driven
from tests.robot.launch.test_restarts import LINE

YESTERDAY, TODAY = 11, 12  # seeds


class Said(NamedTuple):
    t: float
    key: str
    data: bytes


class Day(Driven):
    def __init__(self, seed: int) -> None:
        run = Rehearsal(LINE, Options(seed=seed))
        super().__init__(
            run, Truth, RobotState, Stop, Ack, Trajectory, Origin, Log, MissionStatus, Pose
        )

    def epoch(self) -> int:
        return self.last(RobotState).cycle.epoch

    def again(self, recording: list[Said], speed: float) -> float:
        """Publish a recording from now on; return when it ends, s."""
        begin, first = self.mesh.now, recording[0].t
        for said in recording:
            at = begin + (said.t - first) / speed
            self.mesh.call_at(at, lambda s, _: self.mesh.publish_bytes(s.data, s.key), said)
        return begin + (recording[-1].t - first) / speed


@cache
def recorded() -> list[Said]:
    """A day on which the robot drove, was stopped, released, stopped again, and driven on."""
    day = Day(YESTERDAY)
    found: list[Said] = []
    recorder = VirtualSession(day.mesh, name="recorder")
    recorder.subscribe("**", lambda key, data: found.append(Said(day.mesh.now, key, data)))
    day.begin().let_pass(3.0)
    for press in (7, 8):
        day.mesh.publish(Stop(2 * press, True, "anna", press, day.epoch()))
        day.let_pass(1.0)
        assert day.last(RobotState).stop.stopped
        day.mesh.publish(Stop(2 * press + 1, False, "anna", press))
        day.let_pass(2.0)
        assert not day.last(RobotState).stop.stopped
    day.mesh.publish(Stop(20, True, "the last of the day", 9, day.epoch()))
    day.let_pass(1.0)
    moved_to = encode(InitialPose(3.0, 1.0, 2.0))
    interface = day.mesh.node("interface").agent.instance
    found.insert(
        len(found) // 2, Said(found[len(found) // 2].t, f"encoder/initial/{interface}", moved_to)
    )
    keys = {said.key.rpartition("/")[0] for said in found}
    assert {"robot/stop", "robot/release", "trajectory", "robot/cmd", "encoder/initial"} <= keys
    return found


def moved(day: Day, since: float) -> float:
    places = day.of(Truth, since)
    return max(hypot(t.x - places[0].x, t.y - places[0].y) for t in places)


@pytest.mark.parametrize(("speed", "restarts"), [(1.0, False), (100.0, True)])
def test_a_robot_that_rests_stays_and_can_be_sent_on(speed: float, restarts: bool) -> None:
    day = Day(TODAY)
    day.run.start()
    day.let_pass(2.0)
    pose = day.last(Pose)
    since = day.mesh.now
    ends = day.again(recorded(), speed)
    if restarts:
        day.mesh.node("robot").kill()
        day.let_pass(1.0)
        day.run.enter("robot")
    day.let_pass(max(ends - day.mesh.now, 0.0) + 2.0)
    assert moved(day, since) < 0.01
    assert hypot(day.last(Pose).x - pose.x, day.last(Pose).y - pose.y) < 0.05
    assert not any(state.stop.stopped for state in day.of(RobotState, since))
    assert not any(node.agent.stopped for node in day.mesh.nodes if node.alive)
    day.run.begin()
    day.let_pass(5.0)
    assert moved(day, day.mesh.now - 3.0) > 0.2


@pytest.mark.parametrize(("speed", "restarts"), [(1.0, False), (100.0, True)])
def test_a_robot_that_drives_arrives(speed: float, restarts: bool) -> None:
    day = Day(TODAY)
    day.begin().let_pass(3.0)
    since = day.mesh.now
    goal = day.last(Trajectory).waypoints
    day.again(recorded(), speed)
    if restarts:
        day.mesh.node("robot").kill()
        day.let_pass(1.0)
        day.run.enter("robot")
    end = day.mesh.now + 60.0
    while not day.run.watch.done and day.mesh.now < end:
        day.let_pass(1.0)
    assert day.run.watch.result().reached
    assert not any(state.stop.stopped for state in day.of(RobotState, since))
    assert {way.waypoints for way in day.of(Trajectory, since)} <= {goal, ()}


@pytest.mark.parametrize("speed", [1.0, 100.0])
def test_a_stop_of_today_outlives_yesterdays_release(speed: float) -> None:
    day = Day(TODAY)
    day.begin().let_pass(3.0)
    day.mesh.publish(Stop(3, True, "bert", 5, day.epoch()))
    day.let_pass(1.0)
    since = day.mesh.now
    ends = day.again(recorded(), speed)
    day.mesh.node("robot").kill()
    day.let_pass(1.0)
    day.run.enter("robot")
    day.let_pass(max(ends - day.mesh.now, 0.0) + 2.0)
    assert day.last(RobotState).stop == Stop(3, True, "bert", 5)
    assert moved(day, since + 1.0) < 0.01
    assert day.last(RobotState).stop.by == "bert"


@pytest.mark.parametrize("publisher", ["goto-00000000000000aa", "of a live agent"])
def test_what_was_set_yesterday_or_by_another_agent_is_not_set(publisher: str) -> None:
    day = Day(TODAY)
    day.begin().let_pass(2.0)
    goto = day.mesh.node("goto").agent
    before = goto.p
    if publisher == "of a live agent":
        publisher = day.mesh.node("sonar").agent.instance
    slower = Tuning(5, 1, (AgentSetting("goto", Setting("v_max", "0.1")),))
    day.mesh.publish_bytes(encode(slower), f"tuning/{publisher}")
    day.let_pass(0.5)
    assert goto.p is before
