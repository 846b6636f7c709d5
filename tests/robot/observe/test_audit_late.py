"""The auditor judges by the messages' own stamps: late messages and bursts accuse nobody."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
from msgspec.structs import replace

from armadico.core.judgement import Answer
from armadico.core.messages import Ack, Cycle, Message, Point, RobotState
from armadico.mobile.messages import Correction, Pose, Sonar, Truth
from armadico.mobile.obstacles import Obstacles
from armadico.observe.audit.auditor import Auditor
from armadico.observe.audit.promises import Promise
from armadico.observe.audit.sensing import Changes, Renewed
from tests.robot.observe.test_audit import (
    DOUBTS,
    GOTO,
    ROUGH,
    Drive,
    echo,
    is_blind_on_one_side,
)

Said = list[tuple[float, Message]]

OF_THE_ROBOT = RobotState, Ack, Sonar


def accused(said: Said, like: Auditor) -> set[Promise]:
    """The promises that are found to be broken as messages come at these times, s."""
    auditor = like.anew()
    for at, message in said:
        auditor.update(at, "", message)
    return {each.promise for each in auditor.findings if each.answer is Answer.NO}


def later(
    said: Said, delay: Callable[[float], float], *kinds: type[Message], apart_s: float = 1e-4
) -> Said:
    """The same messages, of which those of some kinds (none: all) come later."""
    late = [
        (
            at + (delay(at) if not kinds or isinstance(each, kinds) else 0.0) + apart_s * n / 100,
            each,
        )
        for n, (at, each) in enumerate(said)
    ]
    return sorted(late, key=lambda each: each[0])


def bursts(of_s: float) -> Callable[[float], float]:
    """The delay of messages that come together after each such time, s."""
    return lambda at: of_s - at % of_s


@pytest.mark.parametrize("skips", [0, 2])
def test_a_base_whose_time_passes_slowly_follows_its_ramps(skips: int) -> None:
    """A simulator on a busy computer falls behind the clock of the robot agent, and the auditor's.

    The robot agent numbers a state as the next one, or skips cycles that passed by its clock.
    """
    drive = Drive()

    def go(cycles: int, ordered: float, v: Callable[[int], float]) -> None:
        for cycle in range(1, cycles + 1):
            drive.number += skips
            drive.go(0.1, ordered=ordered, v=v(cycle))

    go(4, 0.0, lambda _: 0.0)
    go(25, 0.75, lambda cycle: 0.03 * cycle)
    go(80, 0.75, lambda _: 0.75)
    go(9, 0.0, lambda cycle: 0.75 - 0.06 * cycle)
    slowly = [(2.9 * at, message) for at, message in drive.said]
    assert accused(slowly, drive.auditor) == set()


def hangs(drive: Drive, cycles: int, **then: object) -> None:
    """The robot agent hangs; then it reads so many states at once, with its orders of then."""
    drive.number += cycles - 1
    drive.now += 0.1 * (cycles - 1)
    drive.go(0.1, **then)
    for _ in range(cycles - 1):
        drive.now -= 0.099
        drive.go(0.1)


def test_states_of_before_the_order_do_not_show_that_it_does_not_brake() -> None:
    drive = Drive().go(2)
    hangs(drive, 8, ordered=0.0)
    for cycle in range(13):
        drive.go(0.1, v=max(0.75 - 0.06 * cycle, 0.0))
    assert Promise.BRAKES not in accused(drive.said, drive.auditor)
    assert Promise.BRAKES in {promise for promise, _ in drive.go(3, v=0.75).found}, "it goes on"


def test_a_rest_after_a_hang_of_the_robot_agent_is_not_ordered_by_the_holder() -> None:
    drive = Drive().go(2)
    hangs(drive, 10, ordered=0.0)
    drive.go(1, ordered=0.75)
    assert Promise.SPEED not in accused(drive.said, drive.auditor)


def test_acks_that_were_overtaken_decrease_no_ballot() -> None:
    drive = Drive().go(1).go(1, term=2)
    swapped = [*drive.said]
    acks = [n for n, (_, each) in enumerate(swapped) if isinstance(each, Ack)]
    for one, other in zip(acks[::2], acks[1::2], strict=True):
        swapped[one], swapped[other] = swapped[other], swapped[one]
    first, second = acks[9:11]
    swapped[first], swapped[second] = drive.said[second], drive.said[first]
    assert not accused(swapped, drive.auditor) & {Promise.ONE_DRIVER, Promise.FRESH}


def test_an_odometry_that_comes_in_bursts_or_later_and_later_has_the_same_scale() -> None:
    drive = Drive().go(20)
    for delay in (bursts(0.4), lambda at: 0.2 * min(at, 20.0 - at)):
        for kinds in ((), OF_THE_ROBOT):
            late = later(drive.said, delay, *kinds)
            assert Promise.ODOMETRY not in accused(late, drive.auditor)


@pytest.mark.parametrize(
    ("period", "from_s", "answer"),
    [
        (1.0, 0.0, Answer.YES),
        (1.07, 0.0, Answer.UNKNOWN),
        (1.07, 20.0, Answer.UNKNOWN),  # the windows before it do not speak for those after it
        (1.07, 36.5, Answer.YES),  # one of ten
    ],
)
def test_the_scale_of_a_base_of_another_period_than_described_is_not_checked(
    period: float, from_s: float, answer: Answer
) -> None:
    def passed(at: float) -> float:
        return at + (period - 1.0) * max(at - from_s, 0.0)

    auditor = Drive().auditor.anew()
    for at, message in Drive().go(40).said:
        same = replace(message, t=passed(message.t)) if isinstance(message, Truth) else message
        auditor.update(passed(at), "", same)
    report = auditor.report()
    answers = [each for each in report if each.promise is Promise.ODOMETRY]
    found = next((each for each in answers if each.answer is not Answer.YES), answers[0])
    assert (found.answer, found.occasion) == (answer, True)
    assert ("s of the robot's cycles are" in found.what) is (answer is Answer.UNKNOWN)


def test_an_odometry_whose_cycles_are_shorter_than_described_goes_as_fast_as_is_measured() -> None:
    drive = Drive()
    for _ in range(100):
        drive.x -= 0.03 * drive.v
        drive.go(0.1)
    quickly = [(0.7 * at, message) for at, message in drive.said]
    assert Promise.ODOMETRY not in accused(quickly, drive.auditor)


def test_turns_of_before_the_order_are_not_faster_than_it() -> None:
    drive = Drive(w=0.8, turns=0.8, v=0.2, ordered=0.2).go(1)
    for _ in range(20):
        hangs(drive, 8, turns=0.3)
        drive.go(0.3, turns=0.8)
    assert Promise.ORDERED not in accused(drive.said, drive.auditor)


def test_who_slows_down_for_obstacles_that_are_received_late_is_not_slow() -> None:
    drive = Drive().go(3)
    drive.go(2, v=0.2, ordered=0.2, ahead=(Point(1.0, 0.0),))
    for kind in (Obstacles, Pose):
        late = later(drive.said, lambda at: max(4.5 - at, 0.0) if at > 2.9 else 0.0, kind)
        assert Promise.SPEED not in accused(late, drive.auditor)


def test_states_of_which_some_are_missing_are_farther_apart_than_they_come() -> None:
    drive = Drive().go(1)
    state = drive.auditor.scene.state
    assert state is not None
    cycle = Cycle(1, drive.number + 10)
    turned = replace(state, cycle=cycle, x=state.x + 0.3, theta=state.theta + 1.2)
    assert accused([*drive.said, (1.1, turned)], drive.auditor) == set()


def test_acks_of_a_long_time_that_come_together_are_no_hunt_for_the_wheels() -> None:
    drive = Drive()
    for _ in range(12):
        for holder in (GOTO, "avoid-0123456789ab"):
            drive.go(0.9, holder=holder, term=drive.term + 1)
    together = later(drive.said, lambda at: 22.0 - 0.98 * at)
    assert Promise.STEADY not in accused(together, drive.auditor)


def test_an_owner_that_hung_shows_no_holder_that_stopped_commanding() -> None:
    drive = Drive()
    for _ in range(4):
        drive.go(1, term=drive.term + 1)
        ack = drive.auditor.scene.ack
        assert ack is not None
        drive.number += 10
        drive.say(replace(ack, cycle=Cycle(1, drive.number)))
    assert drive.found == []


def test_who_commanded_before_readings_came_is_no_liar_and_no_speed_was_let_through() -> None:
    """States are late, so that newer readings and obstacles are received before them."""

    def says(d: Drive) -> Iterable[Message]:
        cycle, steps_in = Cycle(1, d.number), d.number >= 30
        yield Sonar(cycle, 5.0, (echo(0.15 if steps_in else None),))
        yield Obstacles(cycle, None, None, None, None, (Point(0.3, 0.0),) if steps_in else ())

    drive = Drive().go(2.9, says=lambda d: tuple(says(d)))
    drive.go(1, ordered=0.0, v=0.0)
    late = later(drive.said, lambda at: 3.55 - at if 2.0 < at < 3.55 else 0.0, RobotState, Ack)
    assert accused(late, drive.auditor) == set()


def test_readings_of_a_rest_are_not_frozen_as_they_come_while_it_turns() -> None:
    def says(d: Drive) -> tuple[Message, ...]:
        cycle, turned = Cycle(1, d.number), 0.0 if d.w == 0.0 else 0.001 * d.number
        points = (Point(1.0, 1.5 + turned),)
        echoes = [echo(1.0 + turned, 0.3 * n) for n in range(16)]
        return Sonar(cycle, 5.0, tuple(echoes)), Obstacles(cycle, *4 * (None,), points)

    drive = Drive().go(1, says=says, v=0.0, w=0.0, ordered=0.0)
    drive.go(2, w=0.9, turns=0.9, v=0.2, ordered=0.2)
    late = later(drive.said, lambda at: 1.0, Sonar, Obstacles)
    assert Promise.SENSORS not in accused(late, drive.auditor)


def test_readings_of_another_place_that_come_late_are_not_off_the_map() -> None:
    def says(d: Drive) -> tuple[Message, ...]:
        return (Sonar(Cycle(1, d.number), 5.0, (echo(9.8 - d.x),) * 8),)

    drive = Drive()
    drive.auditor.chart([(10.0, -5.0, 10.0, 5.0)])
    drive.go(12.5, says=says)
    assert drive.found == []
    late = later(drive.said, lambda at: 0.6, Sonar)
    assert Promise.SENSORS not in accused(late, drive.auditor)
    blind = Drive()
    is_blind_on_one_side(blind)
    assert Promise.SENSORS in {promise for promise, _ in blind.found}


def test_a_pose_of_before_a_correction_does_not_doubt_it() -> None:
    drive = Drive(covariance=ROUGH).go(0.1)
    for number in range(100, 200):
        xx, _, _, yy, _, aa = DOUBTS
        known = 1e-4 * xx, 0.0, 0.0, 1e-4 * yy, 0.0, aa
        drive.now += 0.1
        drive.say(Correction(Cycle(1, number), 0.0, 0.0, 0.0, known, 1.0))
        drive.say(Pose(Cycle(1, number - 1), 0.0, 0.0, 0.0, ROUGH))
    assert Promise.FOUND not in {promise for promise, _ in drive.found}


def test_a_truth_that_was_overtaken_counts_no_contact_twice() -> None:
    drive = Drive().go(1)
    for t, contacts in ((2.0, 0), (2.2, 1), (2.1, 0), (2.3, 1)):
        drive.say(Truth(t, drive.x, 0, 0, 0, 0, contacts, 1.0, "sim"))
    assert [promise for promise, _ in drive.found] == [Promise.COLLISION]


def test_a_base_that_goes_on_is_found_also_after_a_long_gap() -> None:
    drive = Drive().go(2)
    drive.number += 600
    drive.now += 60.0
    assert (Promise.BRAKES, "robot") in drive.go(10, ordered=0.0).found


def test_one_message_again_and_again_is_a_gap() -> None:
    drive = Drive(Auditor([Renewed]), ahead=(Point(3.0, 0.5),)).go(5)
    once = next(each for _, each in reversed(drive.said) if isinstance(each, Obstacles))
    drive.go(10)
    stuck = drive.auditor.anew()
    for at, each in drive.said:
        stuck.update(at, "", once if at > 5.0 and isinstance(each, Obstacles) else each)
    assert [each.answer for each in drive.auditor.report()] == [Answer.YES]
    (found,) = stuck.report()
    assert found.answer is Answer.UNKNOWN
    assert "no Obstacles received after 5.0 s" in str(found)


def test_readings_of_before_a_restart_are_not_of_another_place() -> None:
    """The odometry of a new robot agent begins anew, and nothing has moved."""
    auditor = Auditor([Changes])
    echoes = tuple(echo(2.0, 0.1 * n) for n in range(11))
    for epoch, x in ((1, 5.0), (2, 0.0)):
        for number in range(1, 4):
            cycle = Cycle(epoch, number)
            state = RobotState(cycle, x, 0.0, 0.0, 0.0, 0.0, 12, True, False)
            for message in (state, Sonar(cycle, 5.0, echoes)):
                auditor.update(epoch + 0.1 * number, "", message)
    assert auditor.findings == []


@pytest.mark.parametrize("pushed", [False, True])
def test_a_push_turns_the_wheels_of_a_base_that_brakes(pushed: bool) -> None:
    drive = Drive().go(2)
    for step in range(4):
        drive.go(0.1, ordered=0.0, v=0.69 - 0.06 * step)
    drive.contacts += pushed
    drive.go(0.5, v=0.4)
    assert (Promise.BRAKES in {promise for promise, _ in drive.found}) is not pushed
