"""The robot agent in memory, against a scripted controller."""

from __future__ import annotations

import random
from itertools import pairwise
from math import degrees, inf, nan

import pytest
from msgspec.structs import replace

from armadico.bridge.p2os.commands import SYNC0, SYNC1, Cmd, command
from armadico.bridge.p2os.packets import encode
from armadico.bridge.p2os.status import Status, encode_status
from armadico.bridge.reflex import HELD_S
from armadico.bridge.robot import PATIENCE_S, PULSE_S, Parameters, Robot
from armadico.config.profile import load_profile
from armadico.core.agent import ERROR, INFO, WARNING, Identity
from armadico.core.cycles import LISTEN
from armadico.core.hands import Hand
from armadico.core.messages import (
    JUMP,
    Ack,
    Ballot,
    Command,
    Cycle,
    Description,
    Line,
    Log,
    LogEvent,
    MessageError,
    RobotState,
    Stop,
    checked,
)
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Origin, Sonar
from tests.robot.bridge.kit import PROFILE
from tests.robot.bridge.robot_bench import BALLOT, NAMES, TICK, Bench, names_of

CLOSE = command(Cmd.CLOSE)
AT_REST = Status(
    x_m=0,
    y_m=0,
    theta_rad=0,
    left_m_s=0,
    right_m_s=0,
    battery_v=12,
    motors_enabled=True,
)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def ready() -> Bench:
    """Connected, and past the cycles in which it only listens."""
    return Bench().connect().cycles(LISTEN + 2)


def test_a_name_of_control_characters_is_not_published(bench: Bench) -> None:
    bench.plug()
    bench.answer(SYNC0, encode(b"\x02Rob\x1b[2J\n\0Pioneer\x07\0\xff\0"))
    assert bench.logs()[-1].isprintable()
    bench.unplug()
    bench.plug()
    bench.answer(encode(b"\x02\0Pioneer\0p2dx\0"))
    assert any("a controller without a name" in text for text in bench.logs())


# Which controller it is ---------------------------------------------------------------------------

CONTROLLERS = [
    # class, subclass, profile, whether it is driven, the profiles that are named
    ("Pioneer", "p2dx", "pioneer-2dx", True, ()),
    ("Pioneer", "P2DX", "pioneer-2dx", True, ()),
    ("Pioneer", "p2dx", "pioneer-16", True, ()),
    ("Pioneer", "p2de", "pioneer-2dx", False, ()),
    ("Pioneer", "p3dx", "pioneer-2dx", False, ("pioneer-3dx",)),
    ("Pioneer", "p3at-sh", "pioneer-2dx", False, ("pioneer-3at",)),
    ("Pioneer", "p3dx-sh", "pioneer-3dx", True, ()),
    ("Pioneer", "p3dx-sh-lms1xx", "pioneer-3dx", True, ()),
    ("Pioneer", "p2dx", "pioneer-3dx", False, ("pioneer-2dx", "pioneer-16")),
    ("Pioneer", "p3at-sh", "pioneer-3at", True, ()),
    ("Pioneer", "powerbot-sh", "pioneer-3dx", False, ()),
    ("Toaster", "p2dx", "pioneer-2dx", False, ()),
    ("", "", "pioneer-2dx", False, ()),
]
MOVING = {Cmd.ENABLE, Cmd.VEL, Cmd.RVEL, Cmd.VEL2, Cmd.MOVE, Cmd.HEAD}
"""What may set wheels in motion."""


@pytest.mark.parametrize(("class_name", "subclass", "profile", "driven", "named"), CONTROLLERS)
def test_only_a_controller_of_the_profiles_type_is_opened(
    class_name: str, subclass: str, profile: str, driven: bool, named: tuple[str, ...]
) -> None:
    bench = Bench(profile=profile)
    bench.plug()
    bench.answer(SYNC0, SYNC1, names_of(subclass, class_name))
    refused = [
        m.text for _, m in bench.published if isinstance(m, Log) and m.event == LogEvent.UNFIT
    ]
    assert bool(bench.sent(Cmd.ENABLE)) is driven
    assert bool(refused) is not driven
    assert bool(bench.robot.kernel.card().fault) is not driven
    assert all(name in refused[0] for name in named)
    bench.report()
    assert bool(bench.sent(Cmd.SONAR)) is driven
    assert any(isinstance(m, RobotState) for _, m in bench.published) is driven
    if not driven:
        bench.unplug()
        assert not any("is gone" in text for text in bench.logs()), "it was told to hang up"
        bench.plug()
        bench.let_pass(20.0)
        assert not [n for _, n, value in bench.written if n in MOVING and value]


def test_a_controller_of_another_type_after_a_broken_line_is_not_moved(ready: Bench) -> None:
    ready.command(0.3)
    ready.unplug()
    ready.let_pass(0.5)
    ready.plug()
    began = ready.now
    ready.answer(SYNC0, SYNC1, names_of("p3dx-sh"))
    ready.status()
    ready.command(0.3)
    ready.let_pass(3.0)
    assert {n for at, n, _ in ready.written if at >= began} & MOVING == set()
    assert "pioneer-3dx" in ready.robot.kernel.card().fault
    ready.plug()  # and the right one again
    ready.answer(SYNC0, SYNC1, NAMES)
    assert ready.sent(Cmd.ENABLE, began)
    assert not ready.robot.kernel.card().fault


@pytest.mark.parametrize(
    ("subclass", "name", "latched"),
    [
        ("p3dx-sh", "Rob", False),
        ("P3DX-SH", "Rob", False),
        ("p3dx-sh", "Other", False),
        ("p3dx", "Rob", True),
        ("p3dx-sh-lms1xx", "Rob", True),
    ],
)
def test_a_controller_of_another_type_that_fits_takes_a_release_to_be_driven(
    subclass: str, name: str, latched: bool
) -> None:
    bench = Bench(profile="pioneer-3dx")
    bench.plug()
    bench.answer(SYNC0, SYNC1, names_of("p3dx-sh"))
    bench.cycles(LISTEN + 2)
    bench.unplug()
    bench.plug()
    bench.answer(SYNC0, SYNC1, names_of(subclass, name=name))
    stop = bench.status().stop
    assert (stop.by == Hand.EXCHANGED) is latched
    assert any("the same robot" in text for text in bench.logs()) is (latched or name != "Rob")
    began = bench.now + TICK
    bench.let_pass(0.1)
    bench.command(0.3)
    assert any(bench.speeds(began)) is not latched


def test_of_a_subclass_with_factors_of_its_own_those_count() -> None:
    """A P3-DX of before ARCOS counts 0.485 mm, one of after it whole ones."""
    ways = {}
    for subclass in ("p3dx", "p3dx-sh"):
        bench = Bench(profile="pioneer-3dx")
        bench.plug()
        bench.answer(SYNC0, SYNC1, names_of(subclass))
        packet = encode_status(AT_REST, load_profile("pioneer-3dx").p2os)
        before = packet[:1] + (1000).to_bytes(2, "little") + packet[3:]
        bench.answer(encode(before))
        ways[subclass] = bench.state().x
    assert ways == pytest.approx({"p3dx": 0.485, "p3dx-sh": 1.0})


# A controller that answers, and sends nothing -----------------------------------------------------


@pytest.mark.parametrize("hangs_up", [True, False])
def test_without_status_packets_it_retries_and_logs_ever_more_rarely(
    bench: Bench, hangs_up: bool
) -> None:
    bench.plug()
    for _ in range(1200):
        before = len(bench.written)
        bench.let_pass(0.1)
        if any(number == Cmd.PULSE for _, number, _ in bench.written[before:]) or bench.now < 0.2:
            bench.answer(SYNC0, SYNC1, NAMES)
            if hangs_up:
                bench.unplug()
                bench.let_pass(0.1)
                bench.plug()
    lines = len(bench.logs())
    assert lines <= 40, "in two minutes"
    assert 15 <= len(bench.sent(Cmd.OPEN)) <= 60, "SYNC1 has its number"


def test_after_a_status_packet_a_lost_link_is_tried_again_at_once(ready: Bench) -> None:
    ready.let_pass(1.3)
    began = ready.now
    assert ready.sent(Cmd.PULSE, began - 0.3), "SYNC0 has its number"


# Motors that a person switched off ---------------------------------------------------------------


@pytest.mark.parametrize("how", ["line", "port", "agent"])
def test_motors_that_a_person_switched_off_stay_off_when_it_is_opened_again(
    ready: Bench, how: str
) -> None:
    stop = ready.status(motors_enabled=False).stop
    assert stop.by == Hand.MOTORS
    began = ready.now + TICK
    if how == "line":
        ready.let_pass(1.5)
        ready.answer(SYNC0, SYNC1, NAMES)
    elif how == "port":
        ready.unplug()
        ready.let_pass(1.0)
        ready.plug()
        ready.answer(SYNC0, SYNC1, NAMES)
    else:
        ready = Bench()
        began = 0.0
        ready.robot.kernel.remember(stop, 0.0)
        ready.connect()
    for _ in range(20):
        ready.let_pass(0.1)
        stop = ready.status(motors_enabled=False).stop
    assert not ready.sent(Cmd.ENABLE, began)
    ready.hand(Stop(stop.counter + 1, False, "a person", stop.press))
    stop = ready.status(motors_enabled=False).stop
    assert stop.by == Hand.MOTORS, "a release does not hold while they are off"
    ready.let_pass(0.1)
    ready.status()  # the MOTORS button
    ready.hand(Stop(stop.counter + 1, False, "a person", stop.press))
    ready.cycles(LISTEN)
    ready.command(0.3)
    assert ready.speeds()[-1] == 300


def test_once_they_are_on_again_a_new_link_switches_them_on(ready: Bench) -> None:
    ready.status(motors_enabled=False)
    ready.let_pass(0.1)
    ready.status()
    ready.unplug()
    ready.plug()
    began = ready.now
    ready.answer(SYNC0, SYNC1, NAMES)
    assert ready.sent(Cmd.ENABLE, began)


def test_each_status_packet_is_a_cycle_with_its_sonars_and_one_ack(
    bench: Bench,
) -> None:
    bench.connect().cycles(5)
    states = [m for _, m in bench.published if isinstance(m, RobotState)]
    sonars = [m for _, m in bench.published if isinstance(m, Sonar)]
    assert [s.cycle.number for s in states] == [1, 2, 3, 4, 5]
    assert len({s.cycle.epoch for s in states}) == 1
    assert [s.cycle for s in sonars] == [s.cycle for s in states]
    assert [m.cycle for _, m in bench.published if isinstance(m, Ack)] == [s.cycle for s in states]


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
    sonar = next(m for _, m in reversed(ready.published) if isinstance(m, Sonar))
    left, ahead = sonar.echoes  # the fortieth sonar is not in the profile
    assert (left.x, left.y, left.range) == pytest.approx((0.069, 0.136, 1.2), abs=1e-3)
    assert ahead.range is None  # nothing within reach


def test_a_cycle_without_a_ping_has_no_echoes_and_is_reported_once(ready: Bench) -> None:
    before = sum(isinstance(m, Sonar) for _, m in ready.published)
    cycles = sum(isinstance(m, RobotState) for _, m in ready.published)
    for _ in range(9):
        ready.status(echoes=())
    assert sum(isinstance(m, RobotState) for _, m in ready.published) == cycles + 9
    assert sum(isinstance(m, Sonar) for _, m in ready.published) == before
    assert sum("no sonar has fired" in text for text in ready.logs()) == 1
    ready.status()
    assert sum(isinstance(m, Sonar) for _, m in ready.published) == before + 1


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


def test_a_stop_before_the_port_is_open_is_kept(bench: Bench) -> None:
    bench.hand(Stop(1, True, "somebody", 1))
    bench.connect().cycles(LISTEN + 2)
    bench.command(0.3)
    assert not any(bench.speeds())
    assert bench.state().stop.stopped


# The hand at the button, and what it touches ------------------------------------------------------


HANDS = [
    ({"motors_enabled": False}, "the motors being off at the robot"),
    ({"stop_button": True}, "the STOP button at the robot"),
    ({"stop_button": True, "motors_enabled": False}, "the STOP button at the robot"),
]


@pytest.mark.parametrize(("hand", "by"), HANDS, ids=["motors", "STOP", "both"])
def test_switching_the_motors_off_at_the_robot_latches_the_stop(
    ready: Bench, hand: dict[str, object], by: str
) -> None:
    ready.command(0.3)
    assert ready.status().stop == Stop()
    stop = ready.status(**hand).stop
    assert (stop.stopped, stop.by, ready.speeds()[-1]) == (True, by, 0)
    published = [replace(m, epoch=0) for _, m in ready.published if isinstance(m, Stop)]
    assert published == [stop], "published to all agents"
    assert any(f"stopped by {by}" in text for text in ready.logs())
    began = ready.now + TICK
    for _ in range(20):  # they are on again, and the robot does not drive off
        ready.let_pass(0.1)
        assert ready.status().stop == stop
        ready.command(0.3)
    assert not any(ready.speeds(began))
    ready.hand(Stop(stop.counter + 1, False, "somebody", stop.press))
    ready.command(0.3)
    assert ready.speeds()[-1] == 300


@pytest.mark.parametrize(("hand", "by"), HANDS, ids=["motors", "STOP", "both"])
def test_a_release_while_the_hand_is_at_the_button_does_not_hold(
    ready: Bench, hand: dict[str, object], by: str
) -> None:
    first = ready.status(**hand).stop
    ready.hand(Stop(first.counter + 1, False, "somebody", first.press))
    again = ready.status(**hand).stop
    assert (again.stopped, again.by, again.counter) == (True, by, first.counter + 2)
    assert again.press != first.press
    ready.command(0.3)
    assert not any(ready.speeds())


@pytest.mark.parametrize("kind", [0xFE, 0xFF])
def test_a_controller_that_was_reset_at_the_robot_takes_a_release_to_drive_on(
    ready: Bench, kind: int
) -> None:
    """Opening it again switches the motors on, and the person at the button stands there."""
    ready.command(0.3)
    ready.answer(encode(bytes([kind])))
    ready.let_pass(2.0)
    ready.answer(SYNC0, SYNC1, NAMES)
    began = ready.now
    stop = ready.status().stop
    assert (stop.stopped, stop.by) == (True, "the controller having been reset at the robot")
    ready.command(0.3)
    assert not any(ready.speeds(began))
    ready.hand(Stop(stop.counter + 1, False, "somebody", stop.press))
    ready.command(0.3)
    assert ready.speeds()[-1] == 300


def test_a_line_that_was_silent_takes_none(ready: Bench) -> None:
    ready.command(0.3)
    ready.let_pass(3.0)
    ready.answer(SYNC0, SYNC1, NAMES)
    assert not ready.status().stop.stopped


def test_motors_that_are_held_off_from_the_first_latch_it_too(bench: Bench) -> None:
    bench.connect()
    for _ in range(12):
        stops = bench.status(motors_enabled=False).stop
        bench.let_pass(0.1)
    assert stops.stopped
    assert bench.sent(Cmd.ENABLE), "they were requested first"


def test_motors_cut_by_a_stall_do_not_latch_the_stop(ready: Bench) -> None:
    for _ in range(3):
        assert not ready.status(motors_enabled=False, left_stall=True).stop.stopped
    assert not ready.status().stop.stopped


def test_nor_those_that_are_off_for_a_while_after_it(ready: Bench) -> None:
    """What is cut stalls no more. If they stay off, a person switched them off."""
    ready.status(left_stall=True)
    ready.let_pass(0.1)
    assert not ready.status(motors_enabled=False).stop.stopped
    ready.let_pass(HELD_S)
    assert ready.status(motors_enabled=False).stop.stopped


def pushes(bench: Bench, v: float, w: float = 0.0, *, for_s: float = 2.0, **fields: object) -> None:
    """It is commanded, and the wheels do not turn."""
    for _ in range(round(for_s / 0.1)):
        bench.command(v, w)
        bench.let_pass(0.1)
        bench.status(**fields)


def moves(bench: Bench) -> None:
    """It obeys commands, and stops."""
    rim = PROFILE.body.half_track_m
    pushes(bench, 0.0, 1.0, for_s=1.0, left_m_s=-rim, right_m_s=rim)
    pushes(bench, 0.0, for_s=1.0)


def test_wheels_that_have_never_turned_as_ordered_touch_nothing_and_the_robot_is_deaf(
    ready: Bench,
) -> None:
    pushes(ready, 0.3, for_s=1.5)
    assert not ready.state().fault
    pushes(ready, 0.3, for_s=1.5)
    state = ready.state()
    assert "deaf base: it does not move; 0.30 m/s, 0.00 rad/s are ordered" in state.fault
    assert not state.stalled
    assert state.fault in ready.robot.kernel.card().fault
    assert sum("deaf base" in text for text in ready.logs()) == 1
    pushes(ready, 0.0, for_s=3.0)
    assert not ready.state().fault, "it may be tried again"
    assert "deaf base" in ready.robot.kernel.card().doubts
    moves(ready)
    assert not ready.robot.kernel.card().doubts


@pytest.mark.parametrize(
    ("v", "x"), [(0.3, PROFILE.body.front_m), (-0.3, -PROFILE.body.rear_m), (0.0, None)]
)
def test_wheels_that_do_not_turn_as_ordered_touch_something(
    ready: Bench, v: float, x: float | None
) -> None:
    moves(ready)
    pushes(ready, v, 0.0 if v else 1.0)
    touched = [m for _, m in ready.published if isinstance(m, RobotState) and m.stalled]
    assert touched
    assert (touched[0].touch and touched[0].touch.x) == x
    assert any("touched an obstacle" in text for text in ready.logs())
    assert 0 in ready.speeds(ready.now - 1.5)


@pytest.mark.parametrize("bits", [{"left_stall": True}, {"front_bumpers": 4}])
def test_against_what_it_touches_it_is_not_driven_and_away_from_it_it_is(
    ready: Bench, bits: dict[str, object]
) -> None:
    pushes(ready, 0.3, for_s=0.1)
    pushes(ready, 0.3, for_s=0.3, **bits)
    began = ready.now + TICK
    pushes(ready, 0.3, for_s=0.3, **bits)
    assert set(ready.speeds(began)) == {0}
    ready.command(-0.2)
    assert ready.speeds()[-1] == -200
    state = ready.status(**bits)
    assert state.touch is not None
    assert state.touch.x > 0, "backing off, it still touches what it drove into"
    assert ready.status().stalled, "a controller cuts what stalls, and then nothing stalls"
    ready.let_pass(HELD_S)
    assert not ready.status().stalled
    ready.command(0.3)
    assert ready.speeds()[-1] == 300


@pytest.mark.parametrize(("cycles", "ahead"), [(1, True), (8, False)])
def test_a_robot_that_stalls_while_backing_touches_what_it_drove_into(
    ready: Bench, cycles: int, ahead: bool
) -> None:
    """Or it would take what is ahead for something behind, and back off no more."""
    pushes(ready, 0.3, for_s=0.5, left_m_s=0.3, right_m_s=0.3)
    pushes(ready, 0.0, for_s=1.0)
    pushes(ready, -0.08, for_s=0.1 * cycles)
    state = ready.status(left_stall=True)
    assert state.touch is not None
    assert (state.touch.x > 0.0) is ahead


def test_a_rear_bumper_counts_and_a_stuck_one_does_not(bench: Bench) -> None:
    bench.connect()
    for _ in range(LISTEN + 2):
        assert not bench.status(rear_bumpers=2).stalled
        bench.let_pass(0.1)
    state = bench.status(rear_bumpers=3)
    assert state.touch is not None
    assert state.touch.x == -PROFILE.body.rear_m


def test_between_two_things_it_is_driven_against_neither(ready: Bench) -> None:
    """Both bumpers at once, and what is behind when it has backed off what is ahead."""
    assert ready.status(front_bumpers=1, rear_bumpers=1).stalled
    for v in (0.2, -0.2):
        ready.command(v)
        assert ready.speeds()[-1] == 0
    ready.let_pass(2 * HELD_S, statuses=True)
    ready.status(front_bumpers=1)
    ready.command(-0.2)
    assert ready.speeds()[-1] == -200
    state = ready.status(rear_bumpers=1)
    assert state.touch is not None
    assert state.touch.x < 0
    ready.command(-0.2)
    assert ready.speeds()[-1] == 0
    ready.command(0.2)
    assert ready.speeds()[-1] == 200


@pytest.mark.parametrize("share", [0.6, 1.0])
@pytest.mark.parametrize("wanted", [(0.8, 0.0), (-0.3, 0.0), (0.0, 1.5), (0.6, -0.8)])
def test_a_robot_that_runs_up_turns_round_and_brakes_touches_nothing(
    ready: Bench, wanted: tuple[float, float], share: float
) -> None:
    """With ramps weaker than the profile's, too."""
    limits, half, now = PROFILE.limits, PROFILE.body.half_track_m, (0.0, 0.0)
    for turn in range(120):
        sign = 1 if turn < 40 else -1 if turn < 80 else 0
        ready.command(sign * wanted[0], sign * wanted[1])
        ready.let_pass(0.1)
        steps = (0.1 * share * limits.v_accel, 0.1 * share * limits.w_accel)
        v, w = now = tuple(
            at + min(max(sign * to - at, -step), step)
            for at, to, step in zip(now, wanted, steps, strict=True)
        )
        assert not ready.status(left_m_s=v - w * half, right_m_s=v + w * half).stalled


def test_invalid_data_is_counted_published_and_logged_at_a_limited_rate(ready: Bench) -> None:
    assert ready.state().line == Line()
    good = encode(encode_status(AT_REST, PROFILE.p2os))
    for _ in range(150):
        ready.answer(b"noise", good[:-1] + b"\x77", encode(b"\x32\x00"))
        ready.status(left_m_s=30.0)
        ready.let_pass(0.1)
        ready.x_m += 5.0
        ready.status()
    line = ready.state().line
    assert line.dropped >= 150 * (5 + len(good))
    assert min(line.mangled, line.malformed, line.absurd, line.resets) >= 149
    logged = [text for text in ready.logs() if "bad checksums" in text]
    assert len(logged) == 2
    assert "odometry resets" in logged[-1]
    assert ready.state().v == 0.0, "absurd reports are discarded"


def test_of_a_flood_of_status_packets_only_the_newest_are_decoded(ready: Bench) -> None:
    """Each causes messages to all agents, and a stop has to wait for them."""
    before = sum(isinstance(m, RobotState) for _, m in ready.published)
    ready.command(0.3)
    began = ready.now
    for tens in range(100):
        ready.now = round(ready.now + TICK, 6)
        flood = [replace(AT_REST, x_m=0.0084 * (50 * tens + n) / 50) for n in range(50)]
        ready.answer(b"".join(encode(encode_status(s, PROFILE.p2os)) for s in flood))
        ready.let_pass(0.0)
        if ready.robot.kernel.wakeup is not None and ready.now >= ready.robot.kernel.wakeup:
            ready.robot.kernel.wake(ready.now)
            ready.take()
    decoded = sum(isinstance(m, RobotState) for _, m in ready.published) - before
    assert decoded <= 50 + 30 + 1
    assert ready.state().line.surplus > 4500
    assert ready.state().x > 0.79
    stopped = [at for at, n, value in ready.written if n == Cmd.VEL and value == 0 and at > began]
    assert stopped[0] - began == pytest.approx(0.3, abs=2 * TICK)


# The watchdog, the port ----------------------------------------------------------------------


def test_without_commands_it_feeds_the_watchdog(ready: Bench) -> None:
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


def test_a_missing_port_is_waited_for_and_reported_only_later() -> None:
    bench = Bench()
    bench.unplug()
    bench.let_pass(PATIENCE_S - 1.0)
    logs = [message for _, message in bench.published if isinstance(message, Log)]
    assert [(log.level, log.text) for log in logs] == [
        (INFO, "waiting for the port memory:: pulled out")
    ]
    bench.let_pass(2.0)
    _, late = (message for _, message in bench.published if isinstance(message, Log))
    assert (late.level, late.text) == (WARNING, f"still {logs[0].text}")
    bench.connect()
    bench.unplug()
    assert any(
        isinstance(message, Log) and message.level == ERROR and "is gone" in message.text
        for _, message in bench.published
    )


def test_a_port_that_comes_back_is_closed_first_and_keeps_the_pose(ready: Bench) -> None:
    before = driven(ready)
    ready.command(0.3)
    ready.unplug()
    ready.raw = b""
    ready.now += 0.5
    ready.x_m = 0.0  # the controller's odometry begins anew
    ready.connect()
    assert ready.raw.startswith(CLOSE)
    ready.cycles(1)
    after = ready.state()
    assert after.x == pytest.approx(before.x, abs=0.01)
    assert after.cycle.epoch == before.cycle.epoch
    missed = round((ready.now - (0.1 * (LISTEN + 2 + 30))) / 0.1)
    assert after.cycle.number == before.cycle.number + missed, "the number is a clock"


def test_what_the_robot_rolled_while_the_port_was_gone_is_part_of_the_way(ready: Bench) -> None:
    """The controller has counted on, and counts as far as the speeds of before explain it."""
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
def test_any_remembered_odometry_can_be_published(far: float) -> None:
    bench = Bench()
    try:
        bench.hand(checked(Origin(7, 1, 99, 0.0, 0.0, 0.0, far, -far, 0.0)))
    except MessageError:
        return  # not logged
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


def test_leaving_it_rests_switches_off_and_closes(ready: Bench) -> None:
    ready.command(0.3)
    began = ready.now
    ready.robot.kernel.leave(ready.now)
    ready.take()
    numbers = [n for at, n, _ in ready.written if at >= began]
    assert numbers[-4:] == [Cmd.VEL, Cmd.RVEL, Cmd.ENABLE, Cmd.CLOSE]
    assert ready.speeds()[-1] == 0


# Its body, and gaps -------------------------------------------------------------------------------


def test_it_describes_itself_at_once_and_each_second(bench: Bench) -> None:
    bench.connect().cycles(31)
    said = [(at, m) for at, m in bench.published if isinstance(m, Description)]
    assert [round(at, 2) for at, _ in said] == [0.1, 1.1, 2.1, 3.1]
    (description,) = {m for _, m in said}
    assert description == bench.robot.description()
    assert description.v_max == PROFILE.limits.v_max
    assert description.silence_s == pytest.approx(0.3)


@pytest.mark.parametrize("forwards", [1.0, -1.0])
def test_below_a_scenarios_limit_it_drives_the_same_arc_slower_and_publishes_the_limit(
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


def test_a_command_for_another_resource_or_of_another_shape_moves_nothing(ready: Bench) -> None:
    cycle = ready.state().cycle
    for action in ((0.3,), (0.3, 0.0, 0.0), b"\x82\x00\x00"):
        ready.hand(Command("wheels", cycle, BALLOT, action))
    ready.hand(Command("gripper", cycle, BALLOT, (0.3, 0.0)))
    assert not any(ready.speeds())
    ready.cycles(30)
    ready.hand(Command("wheels", ready.state().cycle, BALLOT, (0.3,)))
    ready.cycles(1)
    logged = [text for text in ready.logs() if "commands refused" in text]
    assert any(BALLOT.instance in text and "wheels takes 2 numbers" in text for text in logged)
