"""The robot agent in memory, against a controller that does what the test says."""

from __future__ import annotations

import random
from itertools import pairwise
from math import degrees, inf, nan

import pytest

from armadico.bridge.p2os.commands import SYNC0, Cmd
from armadico.bridge.p2os.session import ZERO
from armadico.bridge.robot import PATIENCE_S, PULSE_S, Parameters, Robot
from armadico.core.agent import ERROR, INFO, REPORT_S, WARNING, Identity
from armadico.core.cycles import LISTEN
from armadico.core.messages import (
    JUMP,
    Ack,
    Ballot,
    Claim,
    Command,
    Cycle,
    Description,
    Log,
    MessageError,
    Origin,
    RobotState,
    Sonar,
    Stop,
    checked,
)
from armadico.core.resources import WHEELS
from tests.bridge.robot_bench import BALLOT, PROFILE, TICK, Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def ready() -> Bench:
    """Connected, and past the cycles in which it only listens."""
    return Bench().connect().cycles(LISTEN + 2)


def test_the_first_bytes_of_all_are_zero_speeds(bench: Bench) -> None:
    bench.plug()
    assert bench.raw.startswith(ZERO)


def test_each_status_packet_is_a_cycle_and_its_sonars_are_of_it(bench: Bench) -> None:
    bench.connect().cycles(5)
    states = [m for _, m in bench.said if isinstance(m, RobotState)]
    sonars = [m for _, m in bench.said if isinstance(m, Sonar)]
    assert [s.cycle.number for s in states] == [1, 2, 3, 4, 5]
    assert len({s.cycle.epoch for s in states}) == 1
    assert [s.cycle for s in sonars] == [s.cycle for s in states]


def test_each_start_has_an_epoch_of_its_own() -> None:
    epochs = {
        Robot(Identity("r", rng=random.Random(n)), Parameters(port="memory:"))._counter.epoch
        for n in range(5)
    }
    assert len(epochs) == 5


def test_a_status_packet_becomes_state_and_echoes_in_si_units(ready: Bench) -> None:
    state = ready.status(
        left_m_s=0.3,
        right_m_s=0.5,
        motors_enabled=True,
        left_stall=True,
        battery_v=11.9,
        echoes=((0, 1.2), (3, 5.0), (40, 1.0)),
    )
    assert state.v == pytest.approx(0.4)
    assert state.w == pytest.approx(0.2 / (2 * 0.1689), rel=1e-3)
    assert state.motors
    assert state.stalled
    assert state.battery_v == pytest.approx(11.9)
    sonar = next(m for _, m in reversed(ready.said) if isinstance(m, Sonar))
    left, ahead = sonar.echoes  # the fortieth sonar is not in the profile
    assert (left.x, left.y, left.range) == pytest.approx((0.069, 0.136, 1.2), abs=1e-3)
    assert ahead.range is None  # nothing within reach


def test_a_cycle_in_which_no_sonar_fired_brings_none_and_it_says_so_once(ready: Bench) -> None:
    before = sum(isinstance(m, Sonar) for _, m in ready.said)
    cycles = sum(isinstance(m, RobotState) for _, m in ready.said)
    for _ in range(9):
        ready.status(echoes=())
    assert sum(isinstance(m, RobotState) for _, m in ready.said) == cycles + 9
    assert sum(isinstance(m, Sonar) for _, m in ready.said) == before
    assert sum("no sonar has fired" in text for text in ready.logs()) == 1
    ready.status()
    assert sum(isinstance(m, Sonar) for _, m in ready.said) == before + 1


def test_it_does_not_move_before_it_has_listened_for_three_cycles(bench: Bench) -> None:
    bench.connect()
    for _ in range(LISTEN):
        bench.cycles(1)
        bench.command(0.3)
    assert not any(bench.speeds())
    assert bench.ack().obeyed is None
    bench.cycles(1)
    bench.command(0.3)
    assert bench.speeds()[-1] == 300


def test_what_it_obeys_it_acknowledges(ready: Bench) -> None:
    answered = ready.state().cycle
    ready.command(0.3)
    ready.cycles(1)
    ack = ready.ack()
    assert (ack.resource, ack.cycle) == ("wheels", ready.state().cycle)
    assert (ack.largest, ack.obeyed, ack.obeyed_cycle) == (BALLOT, BALLOT, answered)
    assert (ack.utility, ack.critical) == (BALLOT.utility, BALLOT.critical)


def test_what_it_hears_it_refuses_by(ready: Bench) -> None:
    larger = Ballot(6, 0.9, False, "avoid-1")
    ready.hand(Claim("wheels", larger, ready.state().cycle, 0.9))
    ready.command(0.3)
    ready.cycles(1)
    assert not any(ready.speeds())
    assert (ready.ack().largest, ready.ack().obeyed) == (larger, None)


REFUSED = [
    ("nan", {"v": nan}),
    ("infinite", {"v": 0.1, "w": inf}),
    ("too fast", {"v": PROFILE.limits.v_max + 0.01}),
    ("too fast backwards", {"v": -PROFILE.limits.v_max - 0.01}),
    ("turning too fast", {"v": 0.1, "w": PROFILE.limits.w_max + 0.01}),
    ("a beaten ballot", {"v": 0.3, "ballot": Ballot(4, 1.0, True, "goto-1")}),
    ("an absurd term", {"v": 0.3, "ballot": Ballot(JUMP + 6, 1.0, True, "goto-1")}),
    ("another epoch", {"v": 0.3, "cycle": Cycle(77, 5)}),
]


@pytest.mark.parametrize(("what", "command"), REFUSED, ids=[what for what, _ in REFUSED])
def test_what_is_not_sound_or_beaten_is_refused(
    ready: Bench, what: str, command: dict[str, object]
) -> None:
    ready.command(0.2)
    ready.cycles(1)
    written = len(ready.written)
    ready.command(**command)  # type: ignore[arg-type]
    assert len(ready.written) == written
    assert ready.ack().obeyed == BALLOT


@pytest.mark.parametrize("behind", [4, -4])
def test_a_command_for_an_old_cycle_or_one_that_is_not_there_yet_is_refused(
    ready: Bench, behind: int
) -> None:
    ready.cycles(6)
    now = ready.state().cycle
    ready.command(0.3, cycle=Cycle(now.epoch, now.number - behind))
    assert not any(ready.speeds())
    ready.command(0.3, cycle=Cycle(now.epoch, now.number - (3 if behind > 0 else -3)))
    assert ready.speeds()[-1] == 300


def test_an_older_command_of_the_same_tenure_does_not_undo_a_newer_one(ready: Bench) -> None:
    before = ready.state().cycle
    ready.cycles(1)
    ready.command(0.3)
    ready.command(0.1, cycle=before)
    assert ready.speeds()[-1] == 300


def test_300_ms_without_a_valid_command_and_it_orders_a_stop(ready: Bench) -> None:
    ready.command(0.3)
    began = ready.now
    ready.let_pass(1.0, statuses=True)
    stopped = [at for at, n, value in ready.written if n == Cmd.VEL and value == 0 and at > began]
    assert stopped[0] - began == pytest.approx(0.3, abs=2 * TICK)
    assert any("no valid command" in text for text in ready.logs())


def test_a_stop_that_the_line_lost_is_ordered_again_until_the_wheels_rest(ready: Bench) -> None:
    ready.command(0.3)
    ready.let_pass(0.5)
    assert ready.speeds()[-1] == 0
    for _ in range(3):
        before = ready.now
        ready.let_pass(0.1)
        ready.status(left_m_s=0.3, right_m_s=0.3)
        assert ready.speeds(before + TICK) == [0]
    before = ready.now
    ready.let_pass(0.1)
    ready.status(left_m_s=0.01, right_m_s=0.0)
    assert ready.speeds(before + TICK) == []


def test_refused_commands_do_not_put_the_stop_off(ready: Bench) -> None:
    ready.command(0.3)
    began = ready.now
    for _ in range(5):
        ready.cycles(1)
        ready.command(9.0)
        ready.command(0.3, ballot=Ballot(1, 1.0, False, "ghost-1"))
    assert 0 in ready.speeds(began + 0.01)


def test_commands_each_cycle_keep_it_moving(ready: Bench) -> None:
    began = ready.now
    for _ in range(20):
        ready.command(0.3)
        ready.cycles(1)
    assert set(ready.speeds(began)) == {300}


def test_refusals_are_reported_with_their_reason_and_not_too_often(ready: Bench) -> None:
    for _ in range(100):
        ready.cycles(1)
        ready.command(9.0)
    times = [at for at, m in ready.said if isinstance(m, Log) and "commands refused" in m.text]
    assert 4 <= len(times) <= 6
    assert all(b - a >= REPORT_S - TICK for a, b in pairwise(times))
    assert any("is beyond" in text for text in ready.logs())


def test_after_a_hang_what_waited_is_not_obeyed(ready: Bench) -> None:
    ready.command(0.3)
    waited = Command("wheels", ready.state().cycle, BALLOT, (0.3, 0.0))
    hung = ready.now
    ready.now += 3.0
    ready.hand(waited)
    ready.cycles(5)
    assert ready.sent(Cmd.VEL, hung + 0.01)
    assert not any(ready.speeds(hung + 0.01))


def test_while_the_controller_is_silent_nothing_is_obeyed(ready: Bench) -> None:
    ready.let_pass(0.5)
    began = ready.now
    ready.command(0.3)
    assert not any(ready.speeds(began))
    assert ready.robot.owner(WHEELS).obeyed is None


# The stop ----------------------------------------------------------------------------------------


def test_a_stop_is_ordered_at_once_acknowledged_and_nothing_obeyed_until_it_is_released(
    ready: Bench,
) -> None:
    ready.command(0.3)
    ready.hand(Stop(1, True, "somebody", 1))
    assert ready.speeds()[-1] == 0
    ready.cycles(1)
    assert ready.state().stop == Stop(1, True, "somebody", 1)
    ready.command(0.3)
    assert ready.speeds()[-1] == 0
    ready.hand(Stop(2, False, "somebody", 1))
    ready.command(0.3)
    assert ready.speeds()[-1] == 300


@pytest.mark.parametrize(
    ("first", "then", "stands"),
    [
        (Stop(3, True, "a", 1), Stop(2, False, "b", 1), Stop(3, True, "a", 1)),
        (Stop(3, True, "a", 1), Stop(3, False, "b", 1), Stop(3, True, "a", 1)),
        (Stop(3, False, "a", 1), Stop(3, True, "b", 2), Stop(3, True, "b", 2)),
        (Stop(3, False, "a", 1), Stop(2, True, "b", 2), Stop(4, True, "b", 2)),
        (Stop(3, False, "a", 1), Stop(2, True, "a", 1), Stop(3, False, "a", 1)),
        (Stop(3, True, "a", 1), Stop(4, False, "b", 1), Stop(4, False, "b", 1)),
    ],
)
def test_a_stop_always_latches_and_only_a_release_needs_a_larger_counter(
    ready: Bench, first: Stop, then: Stop, stands: Stop
) -> None:
    """Of a smaller counter too, unless it is the very stop that was released."""
    ready.hand(first)
    ready.hand(then)
    ready.cycles(1)
    assert ready.state().stop == stands


def test_a_stop_before_the_port_is_open_is_kept(bench: Bench) -> None:
    bench.hand(Stop(1, True, "somebody", 1))
    bench.connect().cycles(LISTEN + 2)
    bench.command(0.3)
    assert not any(bench.speeds())
    assert bench.state().stop.stopped


# The watchdog, the port ----------------------------------------------------------------------


def test_with_nothing_to_say_it_feeds_the_watchdog(ready: Bench) -> None:
    ready.let_pass(1.0, statuses=True)  # CONFIG and ENABLE are repeated as long
    began = ready.now
    ready.let_pass(3.0, statuses=True)
    pulses = ready.sent(Cmd.PULSE, began)
    assert len(pulses) >= 5
    assert max(b - a for a, b in pairwise(pulses)) <= PULSE_S + 2 * TICK


def test_while_the_controller_is_silent_it_does_not(ready: Bench) -> None:
    ready.let_pass(0.55)
    began = ready.now
    ready.let_pass(0.4)
    assert ready.sent(Cmd.PULSE, began) == []


def test_after_a_gap_it_feeds_the_watchdog_again(ready: Bench) -> None:
    ready.let_pass(1.2, statuses=True)
    ready.let_pass(0.86)
    began = ready.now
    ready.let_pass(1.5, statuses=True)
    assert ready.sent(Cmd.PULSE, began)
    assert not any("the controller is silent" in text for text in ready.logs())


def driven(ready: Bench) -> RobotState:
    """1.5 m, with 0.5 m/s."""
    for _ in range(30):
        ready.x_m += 0.05
        ready.let_pass(0.1)
        before = ready.status(left_m_s=0.5, right_m_s=0.5)
    assert before.x == pytest.approx(1.5, abs=0.01)
    return before


def test_a_port_that_is_not_there_yet_is_waited_for_and_only_said_to_be_gone_later() -> None:
    bench = Bench()
    bench.unplug()
    bench.let_pass(PATIENCE_S - 1.0)
    logs = [message for _, message in bench.said if isinstance(message, Log)]
    assert [(log.level, log.text) for log in logs] == [
        (INFO, "waiting for the port memory:: pulled out")
    ]
    bench.let_pass(2.0)
    _, late = (message for _, message in bench.said if isinstance(message, Log))
    assert (late.level, late.text) == (WARNING, f"still {logs[0].text}")
    bench.connect()
    bench.unplug()
    assert any(
        isinstance(message, Log) and message.level == ERROR and "is gone" in message.text
        for _, message in bench.said
    )


def test_a_port_that_comes_back_begins_with_zero_speeds_and_keeps_the_pose(ready: Bench) -> None:
    before = driven(ready)
    ready.command(0.3)
    ready.unplug()
    ready.raw = b""
    ready.now += 0.5
    ready.x_m = 0.0  # the controller's odometry begins anew
    ready.connect()
    assert ready.raw.startswith(ZERO)
    ready.cycles(1)
    after = ready.state()
    assert after.x == pytest.approx(before.x, abs=0.01)
    assert after.cycle.epoch == before.cycle.epoch
    missed = round((ready.now - (0.1 * (LISTEN + 2 + 30))) / 0.1)
    assert after.cycle.number == before.cycle.number + missed, "the number is a clock"


def test_what_the_robot_rolled_while_the_port_was_gone_is_part_of_the_way(ready: Bench) -> None:
    """The controller has counted on, and is believed as far as the speeds of before explain it."""
    before = driven(ready)
    ready.unplug()
    ready.now += 0.5
    ready.x_m += 0.2
    ready.connect()
    ready.cycles(1)
    assert ready.state().x - before.x == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("x", [0.0, 3.0, -12.0])
def test_a_robot_agent_that_starts_begins_where_the_controller_is(bench: Bench, x: float) -> None:
    bench.x_m = x
    bench.connect().cycles(1)
    assert bench.state().x == pytest.approx(x, abs=0.01)


def test_odometry_that_has_wrapped_is_unwrapped_by_what_others_remember(bench: Bench) -> None:
    origin = Origin(7, 1, 99, 0.0, 0.0, 0.0, 29.0, 1.0, 0.0)
    bench.hand(origin)
    bench.x_m = 29.5 - 32768 * PROFILE.p2os.distance_mm * 1e-3  # as the controller has it
    bench.connect().cycles(1)
    assert bench.state().x == pytest.approx(29.5, abs=0.02)


@pytest.mark.parametrize("far", [1e6, 2e5, 1e5])
def test_wherever_others_remember_it_to_be_it_can_say_its_odometry(far: float) -> None:
    bench = Bench()
    try:
        bench.hand(checked(Origin(7, 1, 99, 0.0, 0.0, 0.0, far, -far, 0.0)))
    except MessageError:
        return  # nobody was told so
    for x in (-13.0, 0.0, 13.0):
        bench.x_m = x
        bench.connect().cycles(1)
        checked(bench.state())


def test_speeds_of_before_do_not_come_back_with_the_port(ready: Bench) -> None:
    ready.command(0.3)
    ready.unplug()
    began = ready.now + TICK
    ready.now = began
    ready.connect()
    ready.cycles(5)
    assert not any(ready.speeds(began))


def test_a_silent_controller_is_given_up_and_opened_again(ready: Bench) -> None:
    ready.let_pass(1.1)
    assert any("the controller is silent" in text for text in ready.logs())
    ready.let_pass(0.3)
    assert ready.raw.endswith(ZERO + SYNC0)


def test_leaving_it_rests_switches_off_and_closes(ready: Bench) -> None:
    ready.command(0.3)
    began = ready.now
    ready.robot.stop(ready.now)
    ready.take()
    numbers = [n for at, n, _ in ready.written if at >= began]
    assert numbers[-4:] == [Cmd.VEL, Cmd.RVEL, Cmd.ENABLE, Cmd.CLOSE]
    assert ready.speeds()[-1] == 0


# Its body, and gaps -------------------------------------------------------------------------------


def test_it_describes_itself_at_once_and_each_second(bench: Bench) -> None:
    bench.connect().cycles(31)
    said = [(at, m) for at, m in bench.said if isinstance(m, Description)]
    assert [round(at, 2) for at, _ in said] == [0.1, 1.1, 2.1, 3.1]
    (description,) = {m for _, m in said}
    assert description == bench.robot.description()
    assert description.v_max == PROFILE.limits.v_max
    assert description.silence_s == pytest.approx(0.3)


@pytest.mark.parametrize("forwards", [1.0, -1.0])
def test_below_a_scenarios_limit_it_drives_the_same_arc_slower_and_says_the_limit(
    forwards: float,
) -> None:
    limited = Bench(v_max=0.4).connect().cycles(10)
    limited.command(0.8 * forwards, 0.5)
    assert limited.speeds()[-1] == 400 * forwards
    turned = [value for _, number, value in limited.written if number == Cmd.RVEL]
    assert turned[-1] == round(degrees(0.25))
    assert limited.robot.description().v_max == 0.4
    limited.command(0.3 * forwards, 0.5)
    assert limited.speeds()[-1] == 300 * forwards


def test_a_limit_above_the_profiles_is_none() -> None:
    assert Bench(v_max=9.0).robot.description().v_max == PROFILE.limits.v_max


def test_each_cycle_is_acknowledged_once(bench: Bench) -> None:
    bench.connect().cycles(10)
    states = [m.cycle for _, m in bench.said if isinstance(m, RobotState)]
    acks = [m.cycle for _, m in bench.said if isinstance(m, Ack)]
    assert acks == states


def test_after_a_gap_of_the_controller_a_command_of_before_is_not_obeyed(ready: Bench) -> None:
    waited = ready.state().cycle
    ready.unplug()
    ready.now = round(ready.now + 5.0, 6)
    began = ready.now
    ready.connect().cycles(1)
    assert ready.state().cycle.number - waited.number == pytest.approx(51, abs=1)
    ready.command(0.5, cycle=waited)
    assert not any(ready.speeds(began))
    ready.command(0.5)
    assert ready.speeds()[-1] == 500


def test_after_lost_packets_the_number_is_a_clock_too(ready: Bench) -> None:
    before = ready.state().cycle
    ready.let_pass(0.4)
    ready.status()
    assert ready.state().cycle.number == before.number + 4


def test_a_command_for_another_resource_or_of_another_shape_moves_nothing(ready: Bench) -> None:
    cycle = ready.state().cycle
    for action in ((0.3,), (0.3, 0.0, 0.0), b"\x82\x00\x00"):
        ready.hand(Command("wheels", cycle, BALLOT, action))
    ready.hand(Command("gripper", cycle, BALLOT, (0.3, 0.0)))
    assert not any(ready.speeds())
    ready.cycles(30)
    ready.hand(Command("wheels", ready.state().cycle, BALLOT, (0.3,)))
    ready.cycles(1)
    told = [text for text in ready.logs() if "commands refused" in text]
    assert any(BALLOT.instance in text and "wheels takes 2 numbers" in text for text in told)
