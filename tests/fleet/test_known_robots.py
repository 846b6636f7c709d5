"""Other robots by their own word: where they are, how wide, and for how long."""

from __future__ import annotations

from math import pi

import pytest

from armadico.agents.methods.known_robots import (
    BRAKES_M_S2,
    REACH_M,
    REACTS_S,
    STALE_S,
    WIDEST_M,
    KnownRobots,
    moved,
)
from armadico.agents.perception.sonar import Parameters
from armadico.mobile.messages import FleetPose
from tests.robot.agents.test_sonar import Ring

SURE = (1e-8, 0.0, 0.0, 1e-8, 0.0, 0.0)
HERE = (0.0, 0.0, 0.0)


def report(
    x: float, y: float = 0.0, theta: float = 0.0, v: float = 0.0, w: float = 0.0, off: float = 0.0
) -> FleetPose:
    covariance = (off * off, 0.0, 0.0, 0.0, 0.0, 0.0)
    return FleetPose("r2", x, y, theta, covariance, v, w, 0.21, 0.23, 0.165)


def known(one: FleetPose) -> KnownRobots:
    robots = KnownRobots("r1")
    robots.update(one, 0.0)
    return robots


def test_a_robot_is_expected_where_it_reports() -> None:
    points = known(report(1.0)).points(HERE, SURE, 0.0)
    assert min(p.x for p in points) == pytest.approx(1.0 - 0.23, abs=1e-3)
    assert max(p.x for p in points) == pytest.approx(1.0 + 0.21, abs=1e-3)
    assert max(p.y for p in points) == pytest.approx(0.165, abs=1e-3)


def test_it_is_seen_from_where_this_robot_stands() -> None:
    points = known(report(1.0)).points((1.0, 2.0, -pi / 2), SURE, 0.0)
    assert min(p.x for p in points) == pytest.approx(2.0 - 0.165, abs=1e-3)


def test_it_is_moved_on_by_its_speeds() -> None:
    points = known(report(1.0, v=0.5)).points(HERE, SURE, 1.0)
    assert min(p.x for p in points) == pytest.approx(1.5 - 0.23, abs=1e-3)
    back = known(report(2.0, v=-0.5)).points(HERE, SURE, 1.0)
    assert max(p.x for p in back) == pytest.approx(1.5 + 0.21, abs=1e-3)
    assert moved(report(0.0, v=0.5, w=pi / 2), 2.0)[2] == pytest.approx(pi)


@pytest.mark.parametrize("theta", [0.0, pi])
@pytest.mark.parametrize("v", [0.5, -0.5])
def test_the_way_that_it_needs_to_stop_is_kept_free_for_it(theta: float, v: float) -> None:
    """Or two that drive towards each other each stop too late, by what the other one needs."""
    points = known(report(2.0, theta=theta, v=v)).points(HERE, SURE, 0.0)
    standing = known(report(2.0, theta=theta)).points(HERE, SURE, 0.0)
    stops = 0.5 * REACTS_S + 0.5**2 / (2 * BRAKES_M_S2)
    comes = (theta == pi) == (v > 0.0)
    nearer = min(p.x for p in standing) - min(p.x for p in points)
    farther = max(p.x for p in points) - max(p.x for p in standing)
    assert (nearer, farther) == pytest.approx((stops, 0.0) if comes else (0.0, stops), abs=1e-6)


def test_it_is_wider_by_what_both_poses_may_be_off() -> None:
    theirs = known(report(1.0, off=0.1)).points(HERE, (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0)
    assert max(p.y for p in theirs) == pytest.approx(0.165 + 0.2, abs=1e-3)
    lost = known(report(1.0, off=5.0)).points(HERE, SURE, 0.0)
    assert max(p.y for p in lost) == pytest.approx(0.165 + WIDEST_M, abs=1e-3)


def test_a_far_robot_or_a_stale_report_is_not_expected() -> None:
    assert not known(report(REACH_M + 1.0)).points(HERE, SURE, 0.0)
    robots = known(report(1.0))
    assert robots.points(HERE, SURE, STALE_S - 0.1)
    assert not robots.points(HERE, SURE, STALE_S + 0.1)
    assert not known(report(1.0)).points(None, SURE, 0.0)


def test_one_is_not_in_ones_own_way() -> None:
    robots = KnownRobots("r2")
    robots.update(report(0.1), 0.0)
    assert not robots.points(HERE, SURE, 0.0)


@pytest.mark.parametrize("deviation", [0.02, 0.0])
def test_behaviours_receive_another_robot_that_no_sonar_has_detected(deviation: float) -> None:
    """Also where the pose has no covariance, as that of ideal sensors."""
    ring = Ring(Parameters(namespace="lab/r1"))
    ring.ping(pose=HERE, deviation=deviation)
    ring.agent.kernel.receive(report(1.0), ring.now)
    found = ring.ping(pose=HERE, deviation=deviation)
    assert found.closest is not None
    assert found.closest.x == pytest.approx(1.0 - 0.23, abs=0.03)
    own = Ring(Parameters(namespace="lab/r2"))
    own.ping(pose=HERE)
    own.agent.kernel.receive(report(1.0), own.now)
    assert own.ping(pose=HERE).closest is None
