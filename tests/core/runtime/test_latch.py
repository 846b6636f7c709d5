"""The latch of tools, against a robot agent of given states."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.core.hands import Hand
from armadico.core.latched import Memory
from armadico.core.messages import JUMP, LARGEST_COUNT, Cycle, RobotState, Stop, checked
from armadico.launch.latch import BLIND, HELD_S, LOST, SILENT_S, Latching

BY = "armadico stop"
PRESS = 77


class Robot:
    """A robot agent's latch, and a client that publishes ten times a second."""

    def __init__(
        self, stop: Stop | None = None, *, stopped: bool = True, code: str | None = None
    ) -> None:
        self.memory = Memory(random.Random(1))
        if stop is not None:
            self.memory.note(stop)
        self.press = Latching(stopped=stopped, by=BY, press=PRESS, code=code)
        self.now = 0.0
        self.number = 0
        self.published: list[Stop] = []
        self.speeds = (0.0, 0.0)
        self.motors = True

    @property
    def stop(self) -> Stop:
        return self.memory.newest(Stop) or Stop()

    def state(self, stop: Stop | None = None) -> None:
        """A cycle later its state comes."""
        self.now += 0.1
        self.number += 1
        at, latch = Cycle(1, self.number), stop or self.stop
        state = RobotState(at, 0, 0, 0, *self.speeds, 12, self.motors, False, latch)
        self.press.on_robot_state(state, self.now)

    def turn(self) -> None:
        """Deliver the client's message to the robot agent, and its state to the client."""
        message = self.press.message()
        if message is not None:
            self.published.append(checked(message))  # it can be sent
            if message.stopped:
                self.memory.update(message, self.now)
            else:
                self.memory.release(message)
        self.state()

    def turns(self, count: int, until: Callable[[], bool] = lambda: False) -> None:
        for _ in range(count):
            self.turn()
            if self.press.done or self.press.refusal or until():
                return


def latches() -> st.SearchStrategy[Stop]:
    counters = st.sampled_from((0, 1, 7, JUMP, JUMP + 2, LARGEST_COUNT - 1, LARGEST_COUNT))
    return st.builds(Stop, counters, st.booleans(), st.just("a guest"), st.integers(0, 2**63 - 1))


@given(latches())
def test_a_stop_stops_whatever_is_known(before: Stop) -> None:
    robot = Robot(before)
    robot.turns(30)
    assert robot.stop.stopped
    assert robot.press.done


def test_a_stop_is_published_soon_without_a_state_and_until_it_is_done() -> None:
    robot = Robot()
    for _ in range(BLIND):
        assert robot.press.message() is None, "a state may come, whose epoch it then has"
    assert robot.press.message() == Stop(1, True, BY, PRESS)
    robot.turns(30)
    assert len(robot.published) == robot.number
    assert {stop.epoch for stop in robot.published[1:]} == {1}
    assert {stop.press for stop in robot.published} == {PRESS}
    assert replace(robot.published[-1], epoch=0) == robot.stop, (
        "once latched it is the same stop, and no new one"
    )


def test_a_stop_counts_for_a_restarted_robot_agent_that_has_no_states_yet() -> None:
    robot = Robot()
    robot.state()
    epochs = [message.epoch for _ in range(LOST + 2) if (message := robot.press.message())]
    assert epochs == [1] * LOST + [0, 0]
    robot.state()
    message = robot.press.message()
    assert message is not None
    assert message.epoch == 1


def test_stopped_is_what_the_robot_agent_goes_on_saying_for_a_second() -> None:
    robot = Robot()
    robot.turns(60)
    assert robot.press.done
    assert robot.now == pytest.approx(HELD_S + 0.1, abs=0.11)


def test_one_old_state_repeated_is_no_acknowledgement() -> None:
    robot = Robot()
    state = RobotState(Cycle(1, 5), 0, 0, 0, 0, 0, 12, True, False, Stop(9, True, "old", 3))
    for tenth in range(40):
        robot.press.on_robot_state(state, tenth / 10)
    assert not robot.press.done


def test_after_a_gap_the_acknowledgement_begins_again() -> None:
    robot = Robot()
    robot.turns(5)
    robot.now += 2 * SILENT_S
    robot.turns(3)
    assert not robot.press.done
    robot.turns(20)
    assert robot.press.done


def test_a_stop_that_is_released_meanwhile_is_latched_again() -> None:
    robot = Robot()
    robot.turns(5)
    assert robot.memory.release(Stop(robot.stop.counter + 1, False, "a guest", PRESS))
    robot.state()
    assert not robot.stop.stopped
    since = robot.now
    robot.turns(30)
    assert robot.stop.stopped
    assert robot.press.done
    assert robot.now - since >= HELD_S


def test_a_robot_that_does_not_obey_is_never_reported_as_stopped() -> None:
    robot = Robot()
    for _ in range(100):
        robot.state(Stop())
        assert robot.press.message() is not None
    assert not robot.press.done
    assert robot.press.known == Stop()


@pytest.mark.parametrize("speeds", [(0.17, 0.0), (-0.17, 0.0), (0.0, 0.5), (0.0, -0.5)], ids=str)
def test_it_is_not_stopped_while_its_wheels_turn(speeds: tuple[float, float]) -> None:
    """The latch holds at once; a robot at 0.75 m/s goes on for more than a second."""
    robot = Robot()
    robot.speeds = speeds
    robot.turns(50)
    assert robot.press.latched
    assert not robot.press.done
    assert f"{speeds[0]:.2f} m/s and {speeds[1]:.2f} rad/s" in robot.press.rolling
    robot.speeds = (0.0, 0.0)
    robot.turn()
    assert robot.press.done
    assert robot.press.rolling == ""


def test_a_latched_stop_that_is_released_is_not_latched() -> None:
    robot = Robot()
    robot.speeds = (0.5, 0.0)
    robot.turns(30)
    assert robot.press.latched
    robot.state(Stop())
    assert not robot.press.latched
    assert not robot.press.done


# The release --------------------------------------------------------------------------------------


def test_a_release_is_one_more_than_the_stop_and_has_its_press() -> None:
    robot = Robot(Stop(7, True, "a guest", 5), stopped=False)
    assert robot.press.message() is None, "nothing is known yet"
    robot.state()
    assert robot.press.message() == Stop(8, False, BY, 5)
    robot.turns(10)
    assert robot.press.done
    assert not robot.stop.stopped


@given(latches())
def test_a_release_releases_or_has_a_refusal(before: Stop) -> None:
    robot = Robot(before, stopped=False)
    robot.turns(30)
    assert robot.press.done == (not robot.stop.stopped)
    assert robot.press.done != bool(robot.press.refusal)


@pytest.mark.parametrize("ahead", [1, 2, 10])
def test_a_stop_that_was_pressed_meanwhile_is_not_released(ahead: int) -> None:
    robot = Robot(Stop(7, True, "a guest", 5), stopped=False)
    robot.state()
    robot.memory.update(Stop(7 + ahead, True, "another", 6), robot.now)
    robot.turns(30)
    assert robot.stop.stopped
    assert not robot.press.done
    assert "by another" in robot.press.refusal


@pytest.mark.parametrize("hand", [Hand.MOTORS, Hand.LIFTED])
def test_a_release_that_the_robot_agent_reverts_has_the_remedy(
    hand: Hand,
) -> None:
    robot = Robot(Stop(7, True, hand, 5), stopped=False)
    robot.motors = hand is not Hand.MOTORS
    robot.state()
    robot.memory.update(Stop(9, True, hand, 6), robot.now)  # it latches again at once
    robot.turns(30)
    assert not robot.press.done
    assert hand.remedy in robot.press.refusal
    assert "armadico resume" in robot.press.refusal


def test_the_same_stop_counted_on_by_others_is_released() -> None:
    robot = Robot(Stop(7, True, "a guest", 5), stopped=False)
    robot.state()
    robot.memory.update(Stop(9, True, "a guest", 5), robot.now)
    robot.turns(30)
    assert robot.press.done
    assert robot.stop == Stop(10, False, BY, 5)


def test_a_release_by_code_is_of_that_stop_and_of_no_other() -> None:
    own, other = Stop(3, True, "ann", 1234), Stop(3, True, "bob", 98765)
    robot = Robot(own, stopped=False, code=own.code)
    robot.turns(3)
    assert robot.press.done
    robot = Robot(other, stopped=False, code=own.code)
    robot.turns(3)
    assert not robot.published
    assert not robot.press.done
    assert f"stopped by bob with the code {other.code}" in robot.press.refusal
