"""No restart is worse than a loss: whole societies whose agents die, return, or come twice."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

import pytest
from msgspec.structs import replace

from armadico.bridge.kind import simulated
from armadico.bridge.p2os.commands import Cmd, command
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario
from armadico.core.messages import (
    LARGEST_COUNT,
    Ack,
    Ballot,
    Claim,
    Command,
    Cycle,
    Log,
    RobotState,
    Stop,
)
from armadico.core.outgoing import EXPIRY_S
from armadico.core.services import service_of
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node
from armadico.mobile.messages import MissionStatus, Origin, Pose, Trajectory, Truth
from armadico.mobile.obstacles import Obstacles
from tests.driven import Driven

LINE = Scenario(
    name="line",
    world="sc1",
    sensors="ideal",
    start=(-1.5, 0.0, 0.0),
    goal=(4.5, 0.0, 0.0),
    plan="direct",
    agents=("encoder", "sonar", "goto", "path-planning", "interface"),
)


class Drive(Driven):
    """The scenario, begun, and what is published in it."""

    def __init__(self, seed: int = 1, seconds: float = 4.0) -> None:
        kinds = (Truth, Pose, Command, Claim, RobotState, Obstacles, Stop, Log, MissionStatus)
        super().__init__(Rehearsal(LINE, Options(seed=seed)), *kinds, Trajectory, Ack, Origin)
        self.begin().let_pass(seconds)
        assert abs(self.truth().v) > 0.1, "it drives"

    def truth(self) -> Truth:
        return self.last(Truth)

    def off(self) -> float:
        """How far the pose is from the truth, m."""
        pose = self.last(Pose)
        return hypot(pose.x - self.truth().x, pose.y - self.truth().y)

    def arrives(self) -> bool:
        """Whether it reaches the goal, by the truth, within its time."""
        end = self.mesh.now + 60.0
        while not self.run.watch.done and self.mesh.now < end:
            self.mesh.run(min(self.mesh.now + 1.0, end), lambda: self.run.watch.done)
        return bool(self.run.watch.result().reached)

    def restart(self, name: str, away: float = 1.0) -> Node:
        self.mesh.node(name).kill()
        self.let_pass(away)
        return self.run.enter(name)

    def logs(self) -> list[str]:
        return [log.text for log in self.of(Log)]


# The guard of the line ----------------------------------------------------------------------------


@pytest.mark.parametrize("fails", ["kill", "hang"])
def test_without_its_robot_agent_the_robot_brakes_along_its_ramp(fails: str) -> None:
    """Long before the controller's watchdog, of 2 s; and one that hung drives on afterwards."""
    drive = Drive()
    ramp = load_profile(LINE.robot).limits.v_decel
    robot, v = drive.mesh.node("robot"), drive.truth().v
    getattr(robot, fails)()
    took = drive.until(lambda: abs(drive.truth().v) < 0.02)
    assert v / ramp <= took <= EXPIRY_S + v / ramp + 0.5
    if fails == "kill":
        drive.restart("robot")
    else:
        drive.let_pass(2.0)
        robot.resume()
    assert drive.arrives()


# Epochs -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cycle", [Cycle(12345, 1), Cycle(2**63 - 1, LARGEST_COUNT)])
def test_a_stray_state_of_another_epoch_changes_nothing(cycle: Cycle) -> None:
    drive = Drive()
    for _ in range(3):
        drive.mesh.publish(RobotState(cycle, 9, 9, 0, 0, 0, 12, True, False))
        stray = drive.mesh.now
        drive.let_pass(1.0)
        assert len(drive.of(Claim, stray)) >= 9, "not one cycle without a holder"
        assert {claim.cycle.epoch for claim in drive.of(Claim, stray)} != {cycle.epoch}
    assert drive.arrives()


@pytest.mark.parametrize("ahead", [300, LARGEST_COUNT])
def test_a_number_that_is_believed_while_the_robot_agent_hangs_is_left_again(ahead: int) -> None:
    """What was asked for in that cycle, published and bid, does not count for ever either."""
    drive = Drive()
    robot, last = drive.mesh.node("robot"), drive.of(RobotState)[-1]
    robot.hang()
    drive.let_pass(0.5)
    number = min(last.cycle.number + ahead, LARGEST_COUNT)
    drive.mesh.publish(replace(last, cycle=Cycle(last.cycle.epoch, number)))
    drive.let_pass(0.1)
    robot.resume()
    again = drive.mesh.now
    drive.let_pass(2.5)
    assert abs(drive.truth().v) > 0.1, "it drives on"
    assert any("a number that did not continue" in line for line in drive.logs())
    assert max(c.cycle.number for c in drive.of(Claim, again + 1.0)) < number
    drive.restart("goto")
    assert drive.arrives()


def second_robot(drive: Drive, *, admit: bool) -> Node:
    """Another robot agent, with a controller of its own."""
    controller = simulated(LINE, drive.mesh.stream)
    kind = type(drive.mesh.node("robot").agent)
    first = drive.mesh.node("robot").agent
    agent = kind(drive.mesh.identity("robot", 7), first.p)
    return drive.mesh.add(agent, controller, admit=admit)


def test_a_second_robot_agent_that_was_there_for_two_seconds_changes_nothing() -> None:
    """As after a cut that has healed: it leaves in order."""
    drive = Drive()
    second = second_robot(drive, admit=False)
    drive.let_pass(2.0)
    assert {state.cycle.epoch for state in drive.of(RobotState, drive.mesh.now - 0.5)} != {
        drive.of(RobotState)[0].cycle.epoch
    }, "both speak"
    second.leave()
    left = drive.mesh.now
    drive.let_pass(3.0)
    first_epoch = drive.of(RobotState)[0].cycle.epoch
    late = drive.of(Claim, left + 1.5)
    assert late
    assert {claim.cycle.epoch for claim in late} == {first_epoch}
    assert drive.arrives()


@pytest.mark.long(but=("sonar",))
@pytest.mark.parametrize("name", ["robot", "sonar"])
def test_a_second_one_of_those_that_must_be_alone_is_refused_and_nothing_happens(
    name: str,
) -> None:
    drive = Drive()
    first = drive.mesh.node(name)
    second = second_robot(drive, admit=True) if name == "robot" else drive.run.enter(name)
    begun = drive.mesh.now
    drive.let_pass(4.0)
    assert not second.alive
    assert first.alive
    assert f"another {name} agent is alive already: {first.agent.instance}" in (
        second.driver.refusal
    )
    assert not [m for m in drive.of(Log, begun) if second.agent.instance in m.text]
    claims = [at for at, m in drive.said if isinstance(m, Claim) and at > begun]
    assert max(b - a for a, b in pairwise(claims)) < 0.15
    assert drive.arrives()


# The mission --------------------------------------------------------------------------------------


def test_an_interface_agent_that_restarts_goes_on_with_the_mission() -> None:
    drive = Drive()
    mission = drive.of(Trajectory)[-1].mission
    drive.restart("interface")
    again = drive.mesh.now
    drive.let_pass(2.0)
    assert all(t.waypoints for t in drive.of(Trajectory, again)), "nobody ends it"
    assert {t.mission for t in drive.of(Trajectory, again)} == {mission}
    assert drive.of(MissionStatus)[-1].mission == mission
    assert drive.arrives()
    assert drive.of(Trajectory)[-1].waypoints == ()


# The pose -----------------------------------------------------------------------------------------


@pytest.mark.long(but=("order0",))
@pytest.mark.parametrize("order", [("robot", "encoder"), ("encoder", "robot")])
def test_robot_and_encoder_agent_may_restart_one_after_the_other(order: tuple[str, str]) -> None:
    drive = Drive()
    for name in order:
        drive.restart(name)
        drive.let_pass(4.0)
    assert drive.off() < 0.2
    assert drive.arrives()


@pytest.mark.long(but=("False",))
@pytest.mark.parametrize("encoder_too", [False, True])
def test_a_controller_that_zeroes_its_odometry_does_not_move_the_pose(encoder_too: bool) -> None:
    drive = Drive()
    stop = Stop(1, True, "tester", 1)
    drive.mesh.publish(stop)
    drive.let_pass(3.0)
    assert abs(drive.truth().v) < 0.01
    before = drive.off()
    drive.mesh.node("robot").kill()
    drive.run.robot.receive(command(Cmd.SETO), drive.mesh.now)
    drive.let_pass(1.0)
    drive.run.enter("robot")
    drive.let_pass(2.0)
    assert hypot(drive.of(RobotState)[-1].x, drive.of(RobotState)[-1].y) < 0.05, "it was zeroed"
    if encoder_too:
        drive.restart("encoder")
        drive.let_pass(1.0)
    assert drive.off() < before + 0.05
    assert drive.of(RobotState)[-1].stop.stopped, "the stop outlives the robot agent"
    drive.mesh.publish(Stop(2, False, "tester", 1))
    assert drive.arrives()


# Gaps ---------------------------------------------------------------------------------------------


@pytest.mark.long(but=("0.6",))
@pytest.mark.parametrize("seconds", [0.6, 5.0])
def test_after_a_gap_of_the_controller_nothing_old_is_fresh(seconds: float) -> None:
    drive = Drive()
    before = drive.of(RobotState)[-1].cycle
    drive.mesh.link("device", "robot").up = False
    drive.let_pass(seconds)
    assert abs(drive.of(Ack)[-1].cycle.number - before.number) <= 1
    back = drive.mesh.now
    drive.mesh.link("device", "robot").up = True
    drive.let_pass(4.0)
    first = drive.of(RobotState, back)[0].cycle
    assert first.number - before.number == pytest.approx(seconds / 0.1, abs=25)
    assert first.number - before.number > 4
    heard = next(at for at, m in drive.said if isinstance(m, Obstacles) and at > back)
    commands = [at for at, m in drive.said if isinstance(m, Command) and at > back and m.action]
    assert commands
    assert commands[0] > heard, "nobody drives by what was seen before"
    assert drive.arrives()


# The stop -----------------------------------------------------------------------------------------


def rests(drive: Drive) -> bool:
    return abs(drive.truth().v) < 0.01 and drive.of(RobotState)[-1].stop.stopped


def test_a_stop_reaches_the_robot_over_somebody_else_when_its_own_way_is_cut() -> None:
    drive = Drive()
    drive.mesh.link("client", "robot").up = False
    drive.mesh.publish(Stop(1, True, "tester", 1))
    drive.let_pass(3.0)
    assert rests(drive), "its state told the others that it had not heard"


def test_a_stop_and_a_claim_flood_while_it_hangs() -> None:
    drive = Drive()
    robot = drive.mesh.node("robot")
    robot.hang()
    drive.mesh.publish(Stop(1, True, "tester", 1))
    cycle = drive.of(RobotState)[-1].cycle
    for number in range(2000):
        ballot = Ballot(1, 0.5, False, f"noise-{number % 5}")
        drive.mesh.publish(Claim("wheels", ballot, cycle, 0.5), key="resource/wheels/utility")
        drive.mesh.publish(Log(20, "noise"))
    drive.let_pass(0.8)
    robot.resume()
    drive.let_pass(0.3)
    assert drive.of(RobotState)[-1].stop.stopped
    said = [log.text for log in drive.of(Log) if "too busy: dropped on" in log.text]
    assert any("resource/wheels/utility" in text for text in said), "it was a flood, and it says so"
    assert not any(service_of(Stop).key_in(2) in text for text in said)


@pytest.mark.parametrize("name", ["goto", "robot"])
def test_a_members_many_tokens_cost_no_cycle(name: str) -> None:
    """Tokens of a member's own name, without agents, that stay and that come and go."""
    undisturbed, drive = Drive(seed=3), Drive(seed=3)
    since = drive.mesh.now
    forged = [(name, f"{name}-{number:016x}") for number in range(200)]
    places = [place for place in drive.mesh.places if place.alive]
    for there in (True, False, True):
        for token in forged:
            for place in places:
                place.update_token(*token, there)
        drive.let_pass(1.0)
    undisturbed.let_pass(3.0)
    obeyed, usual = (
        [(ack.cycle.number, ack.obeyed_cycle) for ack in day.of(Ack, since)]
        for day in (drive, undisturbed)
    )
    assert [number for number, _ in obeyed] == [number for number, _ in usual]
    assert all(cycle is not None and number - cycle.number <= 1 for number, cycle in obeyed)
    assert {place.name for place in places if place.alive} == {place.name for place in places}
    assert drive.arrives()
