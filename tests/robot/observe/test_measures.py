"""The measures of thesis 5.1, from made-up messages."""

from __future__ import annotations

from math import pi, radians

import msgspec
import pytest

from armadico.cli.progress import remark
from armadico.core.judgement import Answer
from armadico.core.messages import (
    Ack,
    Ballot,
    Cycle,
    Description,
    Message,
    RobotState,
    Stop,
)
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import (
    MissionState,
    MissionStatus,
    Pose,
    Truth,
)
from armadico.observe.measures import Result, RunWatch

GOAL: Pose2 = (2.0, 0.0, 0.0)
MISSION = 77


def described(controller: str) -> Description:
    return Description(
        "slim", 0.1, 0.3, 0.1, 0.08, 1.2, 5.2, 0.3, 0.3, 1.7, 1.7, 0.3, 2.0, controller
    )


class Run:
    """A synthetic run, cycle by cycle."""

    def __init__(self, *, truth: bool = True, goal: Pose2 | None = GOAL) -> None:
        self.watch = RunWatch("made-up", goal, 5)
        self.truth = truth
        self.number = 0
        self.now = 50.0
        if truth:
            self.show(described("sim"))

    def show(self, *messages: Message) -> None:
        for message in messages:
            self.watch.update(message, self.now)

    def begin(self) -> Run:
        self.watch.begin(MISSION)
        return self

    def cycle(
        self,
        x: float,
        y: float = 0.0,
        theta: float = 0.0,
        *,
        holder: str | None = None,
        behind: int = 0,
        collisions: int = 0,
        bumped: int = 0,
        clearance: float | None = None,
    ) -> None:
        """Advance by one cycle: the robot is at a pose, and the holder's command was obeyed."""
        self.number += 1
        self.now += 0.1
        cycle = Cycle(1, self.number)
        ballot = None if holder is None else Ballot(1, 0.5, False, f"{holder}-0123456789abcdef")
        obeyed = None if ballot is None else Cycle(1, self.number - behind)
        state = RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False)
        ack = Ack("wheels", cycle, ballot, ballot, obeyed)
        if self.truth:
            t = 0.1 * self.number
            self.show(Truth(t, x, y, theta, 0, 0, collisions, clearance, "sim", bumped))
        self.show(state, ack, Pose(cycle, x, y, theta))

    def end(self, state: MissionState = MissionState.REACHED, mission: int = MISSION) -> Result:
        self.show(MissionStatus(mission, state, 0.0))
        return self.watch.result()


def test_td_tt_fo_and_p_of_a_run_around_a_corner() -> None:
    run = Run().begin()
    for x, y, theta in ((0, 0, 0), (0, 1, pi / 2), (1, 1, 0), (1, 0, 0), (1.9, 0, radians(3))):
        run.cycle(x, y, theta)
    result = run.end()
    assert result.td_m == pytest.approx(3.9)
    assert result.tt_s == pytest.approx(0.4)  # four periods from the first cycle to the last
    assert result.fo_deg == pytest.approx(3.0)
    assert result.p_percent == pytest.approx(95.0)  # 0.1 m of 2 m is missing
    assert result.reached
    assert (result.scenario, result.seed) == ("made-up", 5)


def test_the_clock_starts_with_the_first_cycle_of_the_mission() -> None:
    run = Run()
    run.cycle(-3.0)
    run.cycle(-1.0)
    run.begin()
    run.cycle(0.0)
    run.cycle(1.0)
    result = run.watch.result()
    assert result.td_m == pytest.approx(1.0)
    assert result.tt_s == pytest.approx(0.1)
    assert result.p_percent == pytest.approx(50.0)


def test_nothing_counts_after_the_end() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.cycle(2.0)
    before = run.end()
    run.cycle(5.0, holder="goto", collisions=3)
    assert run.watch.result() == before


@pytest.mark.parametrize(
    ("x", "y", "theta", "reached"),
    [
        (1.86, 0.0, 0.0, True),
        (1.84, 0.0, 0.0, False),
        (2.0, 0.0, radians(4.9), True),
        (2.0, 0.0, radians(-5.1), False),
        (2.11, 0.11, 0.0, False),
    ],
)
def test_reached_is_decided_by_the_true_pose(
    x: float, y: float, theta: float, reached: bool
) -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.cycle(x, y, theta)
    run.show(Pose(Cycle(1, 9), 2.0, 0.0, 0.0))  # the estimated pose does not matter
    assert run.end().reached is reached


def test_a_goal_reached_by_the_pose_alone_is_astray_by_the_poses_error() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.cycle(1.7, 0.4)
    run.show(Pose(Cycle(1, 9), 2.0, 0.0, 0.0))
    assert run.watch.astray is None, "it drives on"
    result = run.end()
    assert run.watch.astray == pytest.approx((0.5, 0.0))
    assert result.why == run.watch.mistaken != ""
    assert result.why in result.judgement.reason


def test_an_unplaced_robot_is_measured_from_where_it_began_in_truth() -> None:
    run = Run()
    run.watch.unplaced = True
    run.show(Pose(Cycle(1, 1), 0.0, 0.0, 0.0))
    run.begin()
    for y in (7.0, 8.0, 9.0):  # it begins at (5, 7), facing along y
        run.number += 1
        run.show(Truth(0.1 * run.number, 5.0, y, pi / 2, 0, 0, 0, None, "sim"))
    result = run.end()
    assert result.reached, "2 m ahead of where it began"
    assert result.td_m == pytest.approx(2.0)
    assert run.watch.start == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize("truth", [True, False])
def test_a_goal_that_is_reached_is_not_astray(truth: bool) -> None:
    run = Run(truth=truth).begin()
    run.cycle(0.0)
    run.cycle(2.0)
    assert run.end().reached is (True if truth else None)
    assert run.watch.astray is None


def test_a_goal_is_not_reached_while_the_interface_agent_reports_driving() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.cycle(2.0)
    assert not run.end(MissionState.DRIVING).reached


def test_a_goal_that_no_agent_reports_any_more_is_unknown_wherever_the_robot_is() -> None:
    run = Run().begin()
    run.end(MissionState.DRIVING)
    for number in range(60):
        run.cycle(number / 30)
    run.watch.end(60.0)
    result = run.watch.result()
    assert (result.reached, result.judgement.answer) == (None, Answer.UNKNOWN)
    assert "no agent reported the goal for 6 s" in result.judgement.reason
    assert result.outcome == result.judgement.reason
    assert remark(run.watch).startswith("6 s ago: 0.00 m to go")
    run.show(MissionStatus(MISSION, MissionState.DRIVING, 1.0))
    assert run.watch.judge().answer is Answer.NO, "its agent answers again"
    assert remark(run.watch).startswith("1.00 m to go")


def test_the_end_of_another_mission_is_ignored() -> None:
    run = Run().begin()
    run.cycle(0.0)
    assert not run.end(mission=MISSION + 1).reached
    assert not run.watch.done


def test_shares_are_of_the_cycles_in_which_an_agent_was_obeyed() -> None:
    run = Run().begin()
    run.cycle(0.0)
    for holder in ("goto", "goto", "avoid", "goto"):
        run.cycle(0.1, holder=holder)
    result = run.watch.result()
    assert result.shares == {"avoid": 25.0, "goto": 75.0}
    assert result.exchanges == 2


def test_a_tenure_interrupted_without_another_holder_is_no_exchange() -> None:
    run = Run().begin()
    run.cycle(0.0, holder="goto")
    run.cycle(0.0, holder="goto", behind=4)
    assert run.watch.holder is None
    run.cycle(0.0, holder="goto")
    assert run.watch.result().exchanges == 0
    assert run.watch.holder == "goto"


def test_cycles_before_the_mission_are_not_counted() -> None:
    run = Run()
    run.cycle(0.0, holder="avoid")
    run.begin()
    run.cycle(0.0, holder="goto")
    result = run.watch.result()
    assert (result.shares, result.exchanges) == ({"goto": 100.0}, 0)


def test_people_who_walk_into_the_robot_are_no_collisions_of_its_own() -> None:
    run = Run()
    run.cycle(0.0, collisions=2, bumped=1)
    run.begin()
    run.cycle(0.0, collisions=2, bumped=1)
    run.cycle(1.0, collisions=5, bumped=3)
    assert run.watch.result().collisions == 1


def test_collisions_and_clearance_are_those_of_the_run() -> None:
    run = Run()
    run.cycle(0.0, collisions=2, clearance=0.01)
    run.begin()
    run.cycle(0.0, collisions=2, clearance=0.5)
    run.cycle(1.0, collisions=3, clearance=0.2)
    run.cycle(2.0, collisions=3, clearance=0.3)
    result = run.end()
    assert result.collisions == 1
    assert result.min_clearance_m == pytest.approx(0.2)
    assert result.reached
    assert not result.passed


def test_without_truth_the_pose_is_used_and_the_run_is_unknown() -> None:
    run = Run(truth=False).begin()
    for x in (0.0, 1.0, 1.9):
        run.cycle(x, holder="goto")
    result = run.end()
    assert result.td_m == pytest.approx(1.9)
    assert result.tt_s == pytest.approx(0.2)
    assert (result.reached, result.arrived) == (None, True)
    assert result.judgement.answer is Answer.UNKNOWN
    assert "as far as the pose is known" in result.outcome
    assert "no truth of this robot was received" in result.judgement.reason
    assert "--simulator ID" in result.judgement.cure
    assert result.collisions is None
    assert result.min_clearance_m is None


def test_an_arrival_without_truth_has_the_poses_deviation() -> None:
    run = Run(truth=False).begin()
    run.cycle(0.0)
    run.show(Pose(Cycle(1, 9), 2.0, 0.0, 0.0, (0.09, 0.0, 0.0, 0.0, 0.0, 0.01)))
    result = run.end()
    assert result.deviation_m == 0.3
    assert "+-0.30 m" in result.outcome
    assert result.outcome in result.judgement.reason


def truth_at(t: float, x: float = 0.0, collisions: int = 0) -> Truth:
    return Truth(t, x, 0, 0, 0, 0, collisions, 0.5, "sim")


@pytest.mark.parametrize("collisions", [0, 2])
def test_a_truth_that_stops_leaves_what_was_counted_and_nothing_more(collisions: int) -> None:
    run = Run(truth=False)
    run.show(described("sim"), truth_at(0.0))
    run.begin()
    run.show(truth_at(0.1, collisions=collisions))
    for number in range(40):
        run.cycle(0.05 * (number + 1))
    result = run.end()
    assert (result.reached, result.arrived, result.collisions) == (None, True, collisions)
    assert result.judgement.answer is (Answer.NO if collisions else Answer.UNKNOWN)
    assert collisions or "stopped" in result.judgement.reason


def test_a_truth_that_goes_on_has_counted_during_its_gap() -> None:
    run = Run(truth=False)
    run.show(described("sim"), truth_at(0.0))
    run.begin()
    for number in range(40):
        run.cycle(0.05 * (number + 1))
    run.show(truth_at(4.1, 2.0))
    assert run.end().passed


@pytest.mark.parametrize("second", [truth_at(3.0), truth_at(5.1, 4.0)])
def test_two_simulators_with_one_id_make_the_rest_unknown(second: Truth) -> None:
    run = Run(truth=False)
    run.show(described("sim"), truth_at(5.0))
    run.begin()
    run.show(truth_at(5.1), second, truth_at(5.2, 2.0))
    run.cycle(2.0)
    result = run.end()
    assert result.judgement.answer is Answer.UNKNOWN
    assert "two simulators" in result.judgement.reason
    assert (result.reached, result.collisions) == (None, 0)


def test_a_run_that_lost_its_simulator_is_unknown_and_not_failed() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.cycle(0.5)
    run.watch.lose("the simulator has ended (signal SIGKILL)")
    result = run.watch.result()
    assert (result.reached, result.judgement.answer) == (None, Answer.UNKNOWN)
    assert "SIGKILL" in result.judgement.reason


def test_the_truth_of_a_simulator_that_the_run_started_needs_no_name_of_a_driver() -> None:
    run = Run(truth=False)
    run.watch.view.simulator = "sim"
    run.show(described("a Create without a name"), truth_at(0.0))
    run.begin()
    run.show(truth_at(0.1, 2.0))
    run.cycle(2.0)
    assert run.end().passed


def test_what_keeps_a_robot_from_driving_is_the_reason() -> None:
    run = Run().begin()
    run.cycle(0.0)
    cycle = Cycle(1, 2)
    run.show(RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False, Stop(1, True, "a person")))
    run.watch.end(60.0)
    result = run.watch.result()
    assert "stopped by a person" in result.why
    assert result.why in result.judgement.reason
    run.show(RobotState(cycle, 0, 0, 0, 0, 0, 12, False, False))
    assert "motors are off" in run.watch.result().why


def test_the_path_before_the_first_truth_has_another_clock_and_does_not_count() -> None:
    run = Run(truth=False).begin()
    run.show(described("sim"))
    run.cycle(0.0)
    for number in range(11):
        run.show(Truth(3.0 + 0.1 * number, 0.1 * number, 0, 0, 0, 0, 0, 1, "sim"))
        run.cycle(0.1 * number)
    result = run.end()
    assert (result.td_m, result.tt_s) == pytest.approx((1.0, 1.0))


def test_before_the_first_message_there_is_a_row_too() -> None:
    result = RunWatch("made-up", GOAL).result()
    assert not result.reached
    assert (result.td_m, result.tt_s, result.exchanges) == (0.0, 0.0, 0)


def test_the_time_limit_is_in_the_row_if_it_ended_the_run() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.watch.end(66.4)
    assert run.watch.result().limit_s == 66.4
    assert "66 s" in run.watch.result().verdict
    run.end()
    run.watch.end(66.4)
    assert run.watch.result().limit_s is None


def test_without_a_goal_the_rest_is_measured() -> None:
    run = Run(goal=None)
    run.watch.begin()
    run.cycle(0.0)
    run.show(MissionStatus(0, MissionState.NONE, 0.0))
    run.show(MissionStatus(5, MissionState.DRIVING, 2.0))
    run.cycle(1.5)
    assert not run.watch.done, "a person may send it"
    result = run.watch.result()
    assert (result.reached, result.fo_deg, result.p_percent) == (None, None, None)
    assert result.td_m == 1.5
    assert result.passed
    run.cycle(1.5, collisions=1)
    assert not run.watch.result().passed


def test_only_the_robots_own_simulator_counts_and_another_is_a_stranger() -> None:
    run = Run(truth=False)
    ours, other = (Truth(0.0, x, 0, 0, 0, 0, 0, c, s) for x, c, s in ((0, 1, "a"), (50, 0, "b")))
    run.show(described("a"), ours, other)
    run.begin()
    for number in range(1, 11):
        run.show(
            msgspec.structs.replace(ours, t=0.1 * number, x=0.2 * number),
            msgspec.structs.replace(other, t=7.0 * number, collisions=3),
        )
        run.cycle(0.2 * number)
    result = run.end()
    assert result.reached
    assert (result.td_m, result.tt_s) == pytest.approx((1.8, 0.9))
    assert (result.collisions, result.min_clearance_m) == (0, 1)
    assert run.watch.view.strangers(run.now) == ["b"]
    assert not run.watch.mixed


def test_another_controller_during_a_run_is_named() -> None:
    run = Run(truth=False)
    run.show(described("a"))
    run.begin()
    run.cycle(0.0)
    run.show(described(""))  # a new robot agent does not know its controller yet
    assert not run.watch.mixed
    run.show(described("b"))
    assert run.watch.mixed == "b"


def test_a_controller_whose_name_comes_late_is_no_other_one() -> None:
    """That of a ROS 2 node is discovered after its odometry."""
    run = Run(truth=False)
    run.show(described(""))
    run.begin()
    run.cycle(0.0)
    run.show(described("a"))
    assert not run.watch.mixed
    run.show(described(""), described("a"))
    assert not run.watch.mixed, "it has restarted"
    run.show(described("b"))
    assert run.watch.mixed == "b"
    assert run.watch.controller == "a"


def test_a_failed_mission_ends_the_run_and_the_row_has_the_reason() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.show(MissionStatus(MISSION, MissionState.DRIVING, 3.0, 0, "waits: door D is shut"))
    assert not run.watch.done
    assert run.watch.result().why == "waits: door D is shut"
    run.show(MissionStatus(MISSION, MissionState.FAILED, 3.0, 0, "no nearer: door D is shut"))
    result = run.watch.result()
    assert run.watch.done
    assert (result.reached, result.passed, result.why) == (
        False,
        False,
        "no nearer: door D is shut",
    )
    assert result.why in result.outcome
    assert run.watch.astray is None
