"""Teleop, handed messages by hand: whose hand it is, when it lets go, and how it drives."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.driving.goto import Goto
from armadico.core.agent import Agent, Identity
from armadico.core.exchange import Bid
from armadico.core.messages import Cycle, Message, MessageError, Point, Stop, decode, encode
from armadico.mobile.behaviour import BY_HAND
from armadico.observe.measures import speeds
from armadico.testing.alone import Alone, claims, commands, drive_to, obstacles, wall
from armadico.watch.teleop.messages import Stick, TeleopStatus
from armadico.watch.teleop.teleop import RELEASED, Parameters, Teleop
from tests.robot.robots import body


class Cab(Alone):
    """A robot that does at once what it is told, and hands on a stick."""

    def __init__(self, agent: Agent | None = None, **parameters: Any) -> None:
        super().__init__(agent or Teleop(Identity("teleop-1"), Parameters(**parameters)))
        self.count = 0
        for _ in range(3):
            self.cycle()

    def stick(self, hand: str = "ann", v: float = 1.0, w: float = 0.0, **about: Any) -> None:
        """What a hand says in this cycle."""
        self.count += 1
        said = {"cycle": self.at, "number": self.count, "held": True} | about
        self.give(Stick(hand=hand, v=v, w=w, **said))

    def drive(
        self, cycles: int, *hands: tuple[str, float, float], points: tuple[Point, ...] = ()
    ) -> list[Message]:
        """Cycles in which these hands say so; what it says in the last."""
        said: list[Message] = []
        for _ in range(cycles):
            for name, v, w in hands:
                self.stick(name, v, w)
            said = self.cycle(points=points)
            if commands(said):
                self.speed = speeds(commands(said)[-1])
        return said

    def status(self) -> TeleopStatus:
        return next(m for m in reversed(self.published) if isinstance(m, TeleopStatus))


def test_without_a_hand_it_says_nothing_but_that() -> None:
    cab = Cab()
    assert not claims(cab.drive(20))
    assert cab.bid.reason == "no hand is on the stick"
    told = [message for message in cab.published if isinstance(message, TeleopStatus)]
    assert 2 <= len(told) <= 3  # once a second
    assert (cab.status().hand, cab.status().holds) == ("", False)
    assert (cab.status().v_max, cab.status().w_max) == (0.5, 0.8)


def test_a_hand_drives_as_fast_as_the_ramps_let_it() -> None:
    cab = Cab()
    robot = body()
    seen = []
    for _ in range(30):
        cab.drive(1, ("ann", 1.0, 0.5))
        seen.append(cab.speed)
    assert seen[-1] == pytest.approx((0.5, 0.4))
    for (v, w), (v_next, w_next) in pairwise(seen):
        assert 0.0 <= v_next - v <= robot.v_accel * robot.cycle_s + 1e-9
        assert 0.0 <= w_next - w <= robot.w_accel * robot.cycle_s + 1e-9
    assert cab.bid.utility == 1.0
    assert (cab.status().hand, cab.status().holds, cab.status().note) == ("ann", True, "")
    assert cab.status().v == pytest.approx(0.5)


def test_backwards_it_drives_slowly() -> None:
    cab = Cab()
    cab.drive(20, ("ann", -1.0, 0.0))
    assert cab.speed == pytest.approx((-0.15, 0.0))


def test_a_hand_that_lets_go_has_it_brake_by_the_ramps_and_then_release() -> None:
    cab = Cab()
    cab.drive(25, ("ann", 1.0, 0.0))
    cab.stick("ann", 1.0, held=False)
    seen = [cab.speed[0]]
    for _ in range(20):
        said = cab.drive(1)
        if claims(said)[-1].utility is None:
            break
        assert claims(said)[-1].utility == RELEASED
        seen.append(cab.speed[0])
    assert commands(said)[-1].action is None
    assert seen[-1] == 0.0
    assert all(0.0 <= a - b <= body().v_decel * 0.1 + 1e-9 for a, b in pairwise(seen))
    assert len(seen) == 10  # 0.5 m/s at 0.6 m/s^2
    assert cab.status().hand == ""


def test_a_hand_that_falls_silent_has_it_for_half_a_second_more() -> None:
    cab = Cab()
    cab.drive(25, ("ann", 1.0, 0.0))
    heard = cab.now - 0.1
    while cab.status().hand:
        cab.drive(1)
    assert 0.5 <= cab.now - heard < 0.65  # and not later than the cycle after
    assert cab.bid.utility == RELEASED
    assert any("ann is silent" in getattr(message, "text", "") for message in cab.published)


def test_of_two_hands_the_first_has_it_and_the_second_is_told() -> None:
    cab = Cab()
    cab.drive(20, ("ann", 1.0, 0.0), ("bob", 0.0, 1.0))
    assert cab.speed == pytest.approx((0.5, 0.0))
    assert (cab.status().hand, cab.status().waits) == ("ann", ("bob",))
    lines = [m for m in cab.published if "wants the stick" in getattr(m, "text", "")]
    assert len(lines) == 1
    cab.stick("ann", held=False)
    cab.drive(1, ("bob", 0.0, 1.0))
    assert (cab.status().hand, cab.status().waits) == ("bob", ())
    cab.drive(20, ("bob", 0.0, 1.0))
    assert cab.speed == pytest.approx((0.0, 0.8))


@pytest.mark.parametrize("ahead", [0, 1, 3])
def test_a_hand_that_hears_the_robot_sooner_takes_nothing_from_one_that_hears_it_later(
    ahead: int,
) -> None:
    cab = Cab()
    cab.drive(5, ("ann", 1.0, 0.0))
    for _ in range(20):
        late = Cycle(cab.at.epoch, cab.at.number - 1)
        cab.stick("bob", 0.0, 1.0, cycle=Cycle(cab.at.epoch, cab.at.number + ahead))
        cab.stick("ann", 1.0, 0.0, cycle=late)
        cab.drive(1)
        assert (cab.status().hand, cab.status().waits) == ("ann", ("bob",))
    cab.stick("bob", 0.0, 1.0, cycle=Cycle(cab.at.epoch, cab.at.number + ahead))
    cab.stick("ann", held=False, cycle=Cycle(cab.at.epoch, cab.at.number - 1))
    cab.drive(1)
    assert cab.status().hand == ""  # and when it lets go it has let go


def test_who_waits_and_gives_up_waits_no_more() -> None:
    cab = Cab()
    cab.drive(3, ("ann", 1.0, 0.0), ("bob", 0.0, 1.0))
    cab.stick("bob", held=False)
    cab.drive(1, ("ann", 1.0, 0.0))
    assert cab.status().waits == ()
    cab.drive(3, ("ann", 1.0, 0.0), ("eve", 0.0, 1.0))
    cab.drive(6, ("ann", 1.0, 0.0))  # eve was killed
    assert cab.status().waits == ()


def test_a_crowd_of_hands_fills_nothing() -> None:
    cab = Cab()
    cab.drive(1, ("ann", 1.0, 0.0))
    for number in range(1000):
        cab.stick(f"eve-{number}")
    cab.drive(1, ("ann", 1.0, 0.0))
    assert cab.status().hand == "ann"
    assert len(cab.status().waits) == 8
    lines = [m for m in cab.published if "wants the stick" in getattr(m, "text", "")]
    assert len(lines) == 8


def test_a_stick_that_comes_late_is_no_hand() -> None:
    cab = Cab()
    cab.drive(5)
    cab.stick(cycle=replace(cab.at, number=cab.at.number - 4))
    cab.stick(cycle=replace(cab.at, epoch=99))
    cab.drive(1)
    assert cab.status().hand == ""


def test_a_stick_out_of_order_does_not_take_it_back() -> None:
    """Two ways through the network: what was said before comes after `let go`."""
    cab = Cab()
    cab.drive(3, ("ann", 1.0, 0.0))
    cab.stick("ann", held=False, number=100)
    cab.stick("ann", number=99)
    cab.drive(1)
    assert cab.status().hand == ""
    cab.drive(11)
    cab.stick("ann", number=1)  # the same name, started again
    cab.drive(1)
    assert cab.status().hand == "ann"


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1.01, -1.01])
def test_what_is_no_deflection_is_refused_before_it_is_one(bad: float) -> None:
    cab = Cab()
    with pytest.raises(MessageError):
        encode(Stick(cab.at, "ann", 1, bad, 0.0))
    good = encode(Stick(cab.at, "ann", 1, 1.0, 0.0))
    assert decode(good, Stick).held


def test_it_stops_before_what_is_in_the_way_and_says_so() -> None:
    cab = Cab()
    at = 0.0
    for _ in range(100):
        near = tuple(Point(p.x - at, p.y) for p in wall(2.0, -1.0, 1.0))
        cab.drive(1, ("ann", 1.0, 0.0), points=near)
        at += 0.1 * cab.speed[0]
    front = at + body().outline.front
    assert 1.9 < front < 2.0
    assert cab.speed[0] < 0.01
    assert "something is in the way" in cab.status().note
    cab.drive(20, ("ann", -1.0, 0.0), points=near)
    assert cab.speed[0] == pytest.approx(-0.15)


def test_nobody_drives_blind() -> None:
    cab = Cab()
    cab.drive(10, ("ann", 1.0, 0.0))
    for _ in range(5):
        cab.stick("ann")
        assert not claims(cab.state())  # no obstacles come, so no turn begins
    cab.stick("ann")
    cab.give(obstacles(replace(cab.at, number=cab.at.number - 4)))  # nor with old ones
    assert not claims(cab.state())
    assert claims(cab.drive(12, ("ann", 1.0, 0.0)))  # they are back, and it has stood back


def test_the_stop_wins_and_the_hand_is_told_by_whom() -> None:
    cab = Cab()
    cab.drive(20, ("ann", 1.0, 0.0))
    stop = Stop(1, True, "bob", 5)
    cab.stick("ann")
    said = cab.cycle(stop)
    assert [command.action for command in commands(said)] == [None]
    cab.stick("ann")
    assert not commands(cab.cycle(stop))
    assert cab.status().note == "stopped by bob"
    assert cab.bid.reason == "stopped by bob"


# How others meet it -------------------------------------------------------------------------------


def goto() -> Cab:
    cab = Cab(Goto(Identity("goto-1")))
    cab.give(drive_to((0.3, 0.0, 0.0)))
    cab.pose = (0.29, 0.0, 0.0)  # where it bids all there is
    return cab


def told(cab: Cab, hand: str) -> float | None:
    cab.state()
    cab.give(TeleopStatus(cab.at, hand))
    cab.cycle()
    return cab.bid.utility


def test_a_behaviour_offers_less_while_a_hand_is_on_the_stick() -> None:
    cab = goto()
    assert told(cab, "") == 1.0
    assert told(cab, "ann") == BY_HAND
    for _ in range(4):
        cab.cycle()
    assert cab.bid.utility == 1.0  # the teleop agent is gone


def test_but_not_if_something_is_about_to_be_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Goto, "propose", lambda *_: Bid(1.0, (0.0, 0.0), critical=True))
    assert told(goto(), "ann") == 1.0
