"""The robot agent with a guard on its line: what it hands over, and what a failure costs."""

from __future__ import annotations

from math import inf

import pytest

from armadico.bridge.p2os.session import ZERO
from armadico.bridge.ramps import RAMP_S, REST, Ramps
from armadico.bridge.robot import LATE_S
from armadico.config.profile import Limits
from armadico.core.outgoing import EXPIRY_S
from tests.robot.bridge.kit import PROFILE
from tests.robot.bridge.robot_bench import Bench


def guarded(acts_s: float = EXPIRY_S, **set_: object) -> Bench:
    bench = Bench(**set_).connect()
    bench.robot.kernel.on_guard(acts_s, 0.8, bench.now)
    return bench.cycles(10)


def rolls(bench: Bench, v: float) -> None:
    """Report a speed in each cycle, and command it."""
    for _ in range(3):
        bench.let_pass(0.1)
        bench.status(left_m_s=v, right_m_s=v)
        bench.command(v)


def test_a_command_comes_with_what_brakes_it_and_is_renewed_while_it_holds() -> None:
    bench = guarded()
    rolls(bench, 0.3)
    last = bench.writes[-1]
    assert (last.brakes, last.moves) == ((ZERO,), True)
    written = len(bench.writes)
    bench.let_pass(2 * EXPIRY_S / 3)
    renewed = bench.writes[written:]
    assert renewed, "a guard that hears nothing brakes"
    assert all(write.brakes == (ZERO,) for write in renewed)


def test_no_write_holds_longer_than_the_obeyed_command() -> None:
    """A busy agent processes its timers late, and status packets before them."""
    bench = guarded()
    rolls(bench, 0.3)
    obeyed_at, written = bench.now, len(bench.writes)
    for _ in range(3):
        bench.let_pass(0.09)
        bench.status(left_m_s=0.3, right_m_s=0.3)
        held = [bench.now + write.holds_s for write in bench.writes[written:] if write.brakes]
        written = len(bench.writes)
        assert all(until <= obeyed_at + 0.3 + LATE_S + 0.09 for until in held)
    assert 0.0 <= bench.writes[-1].holds_s < EXPIRY_S


def test_at_rest_nothing_expires() -> None:
    bench = guarded()
    rolls(bench, 0.3)
    bench.cycles(10)
    assert bench.state().v == 0.0
    written = len(bench.writes)
    bench.cycles(20)
    assert not any(write.brakes or write.moves for write in bench.writes[written:])


def test_without_a_guard_a_write_is_its_bytes_alone() -> None:
    bench = Bench().connect().cycles(10)
    rolls(bench, 0.3)
    assert not any(write.brakes for write in bench.writes)


def test_a_controller_that_stops_answering_while_it_rolls_is_told_to_rest_again_and_again() -> None:
    bench = guarded()
    rolls(bench, 0.3)
    bench.let_pass(0.4)  # no valid command: rest is ordered once
    rested = len([speed for speed in bench.speeds() if speed == 0])
    bench.let_pass(0.5)
    assert len([speed for speed in bench.speeds() if speed == 0]) >= rested + 3
    assert sum("stopped answering at 0.30 m/s" in text for text in bench.logs()) == 1


@pytest.mark.parametrize(
    ("acts_s", "within_m", "watchdog_s", "v_max"),
    [
        (0.25, 0.5, 2.0, 0.75),  # in time: as fast as its profile says
        (0.5, 0.2, 2.0, 0.4),  # without priority it may be late
        (inf, 0.5, 2.0, 0.25),  # without a guard: the watchdog
        (0.25, 0.4, None, 0.5),  # without a watchdog: until another guard brakes, 0.8 s
        (inf, 0.5, None, 0.5 / 60.0),  # without either it hardly drives
    ],
)
def test_the_speed_is_limited_by_how_far_it_would_roll(
    acts_s: float, within_m: float, watchdog_s: float | None, v_max: float
) -> None:
    from msgspec.structs import replace

    bench = Bench().connect()
    p2os = replace(PROFILE.p2os, watchdog_s=watchdog_s)
    bench.robot.profile = replace(PROFILE, stop_within_m=within_m, p2os=p2os)
    bench.robot.kernel.on_guard(acts_s, 0.8, bench.now)
    bench.cycles(10)
    bench.command(0.75)
    assert bench.speeds()[-1] == round(1000 * v_max)
    said = [text for text in bench.logs() if "drives at most" in text]
    assert bool(said) is (v_max < 0.75)


def test_ramps_go_on_from_where_the_guard_has_braked_to() -> None:
    ramps = Ramps(Limits(v_max=1.0, w_max=1.0, v_accel=1.0, v_decel=2.0, w_accel=1.0, w_decel=1.0))
    now = 0.0
    ramps.request((0.2, 0.1), now)
    while ramps.due is not None:
        now = ramps.due
        ramps.step(now)
    steps = ramps.braking()
    assert steps[-1] == REST
    assert [v for v, _ in steps[:3]] == pytest.approx([0.12, 0.04, 0.0])
    ramps.braked()
    ramps.braked()
    assert ramps.sent == steps[1]
    assert ramps.due is not None, "what is requested is more than that"
    v, _ = ramps.step(now + RAMP_S) or REST
    assert steps[1][0] < v <= steps[1][0] + RAMP_S * 1.0 + 1e-9
