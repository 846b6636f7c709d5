"""The pose is continuous over wraps and resets of the controller's."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.bridge.p2os.odometry import Odometry
from armadico.bridge.p2os.status import Status, decode_status, encode_status
from tests.robot.bridge.units import UNITS


def on_wire(x: float, y: float, theta: float, speed: float = 0.0, spin: float = 0.0) -> Status:
    """What a client reads of a controller at that pose, m/s and rad/s."""
    side = spin / (UNITS.diff_conv * 1e3)
    status = Status(
        x_m=x,
        y_m=y,
        theta_rad=theta,
        left_m_s=speed - side,
        right_m_s=speed + side,
        battery_v=12,
    )
    return decode_status(encode_status(status, UNITS), UNITS)


def test_it_begins_where_the_controllers_is() -> None:
    """One that was open before us has counted on: that is the robot's way."""
    odometry = Odometry(UNITS)
    pose = odometry.update(on_wire(3, 4, 1), 0.0)
    assert (pose.x, pose.y, pose.theta) == pytest.approx((3, 4, 1), abs=0.002)


@given(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-13, 13), st.floats(-13, 13))
def test_it_begins_nearest_to_where_it_was_last_known(
    x: float, y: float, dx: float, dy: float
) -> None:
    pose = Odometry(UNITS, (x + dx, y + dy)).update(on_wire(x, y, 0), 0.0)
    assert (pose.x, pose.y) == pytest.approx((x, y), abs=0.002)


@given(
    st.floats(-math.pi, math.pi),
    st.floats(-30, 30),
    st.floats(-30, 30),
    st.floats(-1.6, 1.6),
    st.floats(-5, 5),
)
def test_driving_on_over_any_wrap_is_continuous(
    heading: float, x0: float, y0: float, speed: float, spin: float
) -> None:
    odometry = Odometry(UNITS, (x0, y0))
    dx, dy = speed * 0.1 * math.cos(heading), speed * 0.1 * math.sin(heading)
    first = odometry.update(on_wire(x0, y0, 0, speed, spin), 0.0)
    for n in range(1, 250):
        at = on_wire(x0 + n * dx, y0 + n * dy, n * spin * 0.1, speed, spin)
        pose = odometry.update(at, n * 0.1)
    assert odometry.resets == 0
    assert pose.x - first.x == pytest.approx(249 * dx, abs=0.001)
    assert pose.y - first.y == pytest.approx(249 * dy, abs=0.001)
    assert pose.theta - first.theta == pytest.approx(249 * spin * 0.1, abs=0.0016)


def test_packets_lost_in_between_cost_nothing() -> None:
    odometry = Odometry(UNITS)
    first = odometry.update(on_wire(27.0, 0, 0, 1.0), 0.0)
    after = odometry.update(on_wire(27.9, 0, 0, 1.0), 0.9)
    assert after.x - first.x == pytest.approx(0.9, abs=0.001)


@pytest.mark.parametrize(("x", "theta"), [(0.5, 0.0), (12.0, 2.0), (0.0, 0.5)])
def test_a_reset_by_another_client_moves_no_robot(x: float, theta: float) -> None:
    odometry = Odometry(UNITS)
    odometry.update(on_wire(0, 0, 0), 0.0)
    odometry.convert(UNITS)
    odometry.update(on_wire(x, 0, theta), 0.1)
    before = odometry.update(on_wire(x, 0, theta), 0.2)
    after = odometry.update(on_wire(0, 0, 0), 0.3)
    assert after == before
    assert odometry.resets == 1
    on = odometry.update(on_wire(0.03, 0, 0, 0.3), 0.4)
    assert on.x - before.x == pytest.approx(0.03, abs=0.001)


@pytest.mark.parametrize(("before", "after"), [(0.0, -2.0), (1.0, 0.0), (3.0, math.pi)])
def test_the_pose_moves_where_it_heads_whatever_the_controllers_heading(
    before: float, after: float
) -> None:
    """After SETO the base is new; the pose continues from where it was, as it was turned."""
    odometry = Odometry(UNITS)
    odometry.update(on_wire(0, 0, before), 0.0)
    odometry.convert(UNITS)
    odometry.update(on_wire(0, 0, after), 1.0)
    ahead = on_wire(0.1 * math.cos(after), 0.1 * math.sin(after), after, 1.0)
    pose = odometry.update(ahead, 1.1)
    want = (0.1 * math.cos(before), 0.1 * math.sin(before))
    assert (pose.x, pose.y) == pytest.approx(want, abs=0.002)


def test_after_an_unexpected_reset_it_moves_where_it_heads() -> None:
    odometry = Odometry(UNITS)
    odometry.update(on_wire(0, 0, 0), 0.0)
    odometry.update(on_wire(0, 0, 0.5, spin=5.0), 0.1)
    odometry.update(on_wire(0, 0, -3.0), 0.2)  # another client set it
    assert odometry.resets == 1
    ahead = on_wire(0.1 * math.cos(-3.0), 0.1 * math.sin(-3.0), -3.0, 1.0)
    pose = odometry.update(ahead, 0.3)
    want = (0.1 * math.cos(0.5), 0.1 * math.sin(0.5))
    assert (pose.x, pose.y) == pytest.approx(want, abs=0.002)
