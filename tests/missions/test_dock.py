"""The dock behaviour: straight in and out, and nobody else drives meanwhile (3.6.4)."""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, radians, sin

import pytest

from armadico.agents.driving.avoid import Avoid
from armadico.agents.driving.gothrough import Gothrough
from armadico.agents.driving.goto import Goto
from armadico.agents.missions.dock import Dock
from armadico.agents.missions.messages import ChargeState, ChargeStatus
from armadico.core.agent import Agent, Identity
from armadico.core.messages import Message, Point, Stop
from armadico.mobile.messages import Waypoint
from armadico.observe.measures import speeds
from armadico.testing.alone import NO_STOP, Alone, claims, commands, drive_to, wall

DOCK = Waypoint(0.5, 0.0, 0.0)
AHEAD = 0.5 + 0.33  # the wall, from where the lane begins


class Lane(Alone):
    """A robot in a dock's lane, and the charger's word in each cycle."""

    def __init__(self, agent: Agent, charge: ChargeState | None = ChargeState.DOCKING) -> None:
        super().__init__(agent)
        self.charge = charge
        self.state()

    def state(self, stop: Stop = NO_STOP, *, cycles: int = 1) -> list[Message]:
        said = super().state(stop, cycles=cycles)
        if self.charge is not None:
            said += self.give(ChargeStatus(self.at, self.charge, DOCK, "dock"))
        return said

    def drive(self, cycles: int, points: Iterable[Point] = ()) -> None:
        """Go as it is commanded, at once; points are in the world."""
        points = tuple(points)
        for _ in range(cycles):
            x, y, theta = self.pose
            c, s = cos(theta), sin(theta)
            seen = [
                Point(c * (p.x - x) + s * (p.y - y), c * (p.y - y) - s * (p.x - x)) for p in points
            ]
            self.cycle(points=seen)
            self.speed = (
                speeds(commands(self.published)[-1]) if commands(self.published) else (0.0, 0.0)
            )
            v, w = self.speed
            self.pose = (x + 0.1 * v * c, y + 0.1 * v * s, theta + 0.1 * w)


def dock() -> Dock:
    return Dock(Identity("dock-1"))


@pytest.mark.parametrize(("aside", "turned"), [(0.0, 0.0), (0.06, -3.0), (-0.08, 4.0)])
def test_it_drives_up_to_the_wall_and_stands_on_the_dock_s_line(
    aside: float, turned: float
) -> None:
    lane = Lane(dock())
    lane.pose = (0.0, aside, radians(turned))
    lane.drive(150, wall(AHEAD, -1.0, 1.0))
    x, y, theta = lane.pose
    assert x == pytest.approx(0.5, abs=0.01)
    assert abs(y) < 0.015
    assert abs(theta) < radians(4)
    assert lane.speed == (0.0, 0.0)


def test_it_backs_out_to_where_the_lane_begins_and_farther_while_it_is_told() -> None:
    lane = Lane(dock(), ChargeState.LEAVING)
    lane.pose = (0.5, 0.0, 0.0)
    lane.drive(60, wall(AHEAD, -1.0, 1.0))
    assert lane.pose[0] < 0.05
    assert abs(lane.pose[1]) < 0.02


@pytest.mark.parametrize("charge", [None, ChargeState.NONE, ChargeState.TO_DOCK])
def test_else_it_does_not_bid(charge: ChargeState | None) -> None:
    lane = Lane(dock(), charge)
    assert claims(lane.cycle()) == []
    assert lane.bid.reason == "no order to dock"


def test_a_charger_that_is_silent_has_nobody_driven_in() -> None:
    lane = Lane(dock())
    lane.holding()
    lane.charge = None
    for _ in range(5):
        lane.cycle()
    assert lane.bid.utility is None


def test_what_steps_between_it_and_the_dock_is_not_driven_into() -> None:
    lane = Lane(dock())
    leg = wall(0.21 + 0.25, -0.1, 0.1)
    lane.drive(100, leg)
    assert lane.speed[0] == 0.0
    assert 0.0 < lane.pose[0] < 0.25 - 0.015


def test_beside_the_lane_it_does_not_drive() -> None:
    lane = Lane(dock())
    lane.pose = (0.0, 0.3, 0.0)
    assert claims(lane.cycle()) == []
    assert "not before the dock: 0.30 m aside" in lane.bid.reason


@pytest.mark.parametrize("kind", [Goto, Avoid, Gothrough])
@pytest.mark.parametrize("charge", [ChargeState.DOCKING, ChargeState.LEAVING])
def test_nobody_else_drives_into_a_dock_or_out_of_it(
    kind: type[Agent], charge: ChargeState
) -> None:
    lane = Lane(kind(Identity("x-1")), charge)
    lane.give(drive_to((4.0, 0.0, 0.0)))
    for _ in range(4):
        assert claims(lane.cycle(points=wall(0.6, -0.4, 0.4))) == []
    assert "into a dock" in lane.bid.reason
    lane.charge = ChargeState.CHARGING
    for _ in range(6):
        lane.cycle(points=wall(0.6, -0.4, 0.4))
    assert "into a dock" not in lane.bid.reason
