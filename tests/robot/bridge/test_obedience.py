"""A robot that moves otherwise than ordered is found out; one that follows its ramps is not."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.bridge.obedience import MARGIN_M_S, PATIENCE_S, RAMPS, Obedience
from armadico.bridge.p2os.commands import Cmd
from armadico.bridge.session import Pose, Reported
from armadico.core.agent import ERROR
from armadico.core.cycles import LISTEN
from armadico.core.hands import Hand
from armadico.core.messages import Log, Stop
from tests.robot.bridge.kit import PROFILE
from tests.robot.bridge.robot_bench import Bench

HALF = PROFILE.body.half_track_m
CYCLE = PROFILE.cycle_s


def drives(
    v_set: float,
    w_set: float,
    v: float,
    w: float,
    *,
    for_s: float = 2.0,
    after: tuple[float, float] | None = None,
    **fields: object,
) -> Obedience | None:
    """Ordered so, and measured so; None once it is found not to obey."""
    obedience = Obedience(PROFILE)
    if after is not None:
        obedience.update(report(*after), after, 0.0)
    for cycle in range(1, round(for_s / CYCLE) + 1):
        if obedience.update(report(v, w, **fields), (v_set, w_set), cycle * CYCLE):
            return None
    return obedience


def report(v: float, w: float, **fields: object) -> Reported:
    return Reported(pose=Pose(), v=v, w=w, **fields)  # type: ignore[arg-type]


def wheels(left: float, right: float) -> tuple[float, float]:
    return 0.5 * (left + right), 0.5 * (right - left) / HALF


def test_reports_that_were_read_late_accuse_nobody() -> None:
    """The agent lacked processor: it ordered rest, and reads what was reported before that."""
    obedience, now = Obedience(PROFILE), 0.0
    obedience.update(report(0.3, 0.0), (0.3, 0.0), now)
    for passed in [2.2 * CYCLE] * 7 + [0.01 * CYCLE] * 12:
        now += passed
        assert not obedience.update(report(0.3, 0.0), (0.0, 0.0), now)
    assert now > PATIENCE_S
    assert not obedience.update(report(0.0, 0.0), (0.0, 0.0), now + CYCLE)


DISOBEYS = [
    ("half as fast again", (0.3, 0.0), (0.45, 0.0)),
    ("against a stop", (0.0, 0.0), (0.15, 0.0)),
    ("backwards against a stop", (0.0, 0.0), (-0.15, 0.0)),
    ("the other way", (0.3, 0.0), (-0.1, 0.0)),
    ("the right wheel or its encoder is dead", (0.3, 0.0), wheels(0.3, 0.0)),
    ("the left one, on an arc", (0.3, -0.5), wheels(0.0, 0.3 - 0.5 * HALF)),
    ("one wheel on turning", (0.0, 1.0), wheels(0.0, HALF)),
    ("turns against a stop", (0.0, 0.0), (0.0, 0.5)),
    ("turns the other way", (0.0, 1.0), (0.0, -0.5)),
]


@pytest.mark.parametrize(("what", "ordered", "measured"), DISOBEYS, ids=[d[0] for d in DISOBEYS])
def test_a_robot_that_moves_otherwise_is_found_out(
    what: str, ordered: tuple[float, float], measured: tuple[float, float]
) -> None:
    assert drives(*ordered, *measured) is None, what
    assert drives(*ordered, *measured, for_s=PATIENCE_S) is not None, "not before its time"
    assert drives(*ordered, *measured, motors=False) is not None, "it is pushed"


OBEYS = [
    ("at rest", (0.0, 0.0), (0.0, 0.0)),
    ("as ordered", (0.3, 0.5), (0.3, 0.5)),
    ("a slope, or slip", (0.3, 0.0), (0.34, 0.05)),
    ("held by something", (0.3, 0.0), (0.0, 0.0)),
    ("slow", (0.5, 1.0), (0.1, 0.2)),
]


@pytest.mark.parametrize(("what", "ordered", "measured"), OBEYS, ids=[o[0] for o in OBEYS])
def test_one_that_is_slower_or_off_by_little_obeys(
    what: str, ordered: tuple[float, float], measured: tuple[float, float]
) -> None:
    assert drives(*ordered, *measured, for_s=10.0) is not None, what


@given(
    st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0)), min_size=1, max_size=40),
    st.floats(RAMPS, 3.0),
)
def test_a_robot_that_follows_the_ramps_obeys_any_command(
    orders: list[tuple[float, float]], hard: float
) -> None:
    """Ramps as steep as the profile's, within what a slope or a payload makes of them."""
    limits, obedience = PROFILE.limits, Obedience(PROFILE)
    v = w = 0.0
    for cycle in range(10 * len(orders)):
        v_set, w_set = orders[cycle // 10]
        v = ramped(v, v_set, (limits.v_accel * hard * CYCLE, limits.v_decel * hard * CYCLE))
        w = ramped(w, w_set, (limits.w_accel * hard * CYCLE, limits.w_decel * hard * CYCLE))
        assert not obedience.update(report(v, w), (v_set, w_set), cycle * CYCLE)


def ramped(speed: float, target: float, steps: tuple[float, float]) -> float:
    up = abs(target) > abs(speed) and target * speed >= 0.0
    step = steps[0] if up else steps[1]
    return speed + min(max(target - speed, -step), step)


def test_a_robot_that_does_not_brake_is_given_the_time_of_its_ramps() -> None:
    fast, slow = PROFILE.limits.v_max, (1.0 + 0.2) * MARGIN_M_S
    ramp = (fast - slow) / (RAMPS * PROFILE.limits.v_decel)
    assert drives(0.0, 0.0, fast, 0.0, for_s=PATIENCE_S, after=(fast, 0.0)) is not None
    assert drives(0.0, 0.0, fast, 0.0, for_s=ramp + 2 * PATIENCE_S, after=(fast, 0.0)) is None


# The robot agent ---------------------------------------------------------------------------------


@pytest.fixture
def ready() -> Bench:
    return Bench().connect().cycles(LISTEN + 2)


def goes(
    bench: Bench, left: float, right: float, v: float | None, *, for_s: float, **fields: object
) -> Stop:
    for _ in range(round(for_s / CYCLE)):
        if v is not None:
            bench.command(v)
        bench.let_pass(CYCLE)
        bench.status(left_m_s=left, right_m_s=right, **fields)
    return bench.state().stop


@pytest.mark.parametrize(
    ("left", "right", "v"), [(0.5, 0.5, 0.3), (0.3, 0.0, 0.3), (0.15, 0.15, None)]
)
def test_it_is_stopped_by_the_controllers_emergency_stop_and_logged(
    ready: Bench, left: float, right: float, v: float | None
) -> None:
    assert not goes(ready, left, right, v, for_s=PATIENCE_S).stopped
    assert not ready.sent(Cmd.E_STOP)
    stop = goes(ready, left, right, v, for_s=0.5)
    assert stop.by == Hand.DISOBEYS
    assert ready.sent(Cmd.E_STOP)
    assert ready.speeds()[-1] == 0
    assert any(isinstance(m, Log) and m.level == ERROR for _, m in ready.published)


def test_one_that_goes_on_under_a_stop_is_stopped_again_and_stays_stopped(ready: Bench) -> None:
    ready.hand(Stop(1, stopped=True, by="a person", press=1))
    stop = goes(ready, 0.2, 0.2, None, for_s=5.0)
    assert stop.by == "a person", "whose it was"
    assert len(ready.sent(Cmd.E_STOP)) >= 3


def test_pushed_by_hand_with_its_motors_off_it_is_left_in_peace(ready: Bench) -> None:
    goes(ready, 0.4, 0.4, None, for_s=5.0, motors_enabled=False)
    assert not ready.sent(Cmd.E_STOP)


def test_held_by_an_obstacle_at_one_wheel_it_is_left_to_the_touch(ready: Bench) -> None:
    goes(ready, 0.3, 0.0, 0.3, for_s=5.0, left_stall=True)
    assert not ready.sent(Cmd.E_STOP)
