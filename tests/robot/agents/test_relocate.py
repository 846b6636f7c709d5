"""A robot that is lost: no mission is driven, and relocate drives it to where it can be found."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, radians, tau
from pathlib import Path

import pytest

from armadico.agents.driving.avoid import Avoid
from armadico.agents.driving.gothrough import Gothrough
from armadico.agents.driving.goto import Goto
from armadico.agents.localization.relocate import Parameters, Phase, Relocate
from armadico.core.agent import Agent, Identity
from armadico.core.exchange import Bid
from armadico.core.messages import Log, Point
from armadico.mobile.behaviour import LOST_M, REFUSED_CYCLES, SLOWEST, SURE_M_S, UNSURE_M
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Echo, Particles, Pose, Sonar
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.particles import message_of
from armadico.observe.measures import speeds
from armadico.testing.alone import Alone, claims, commands, drive_to, obstacles, wall
from tests.robot.agents.test_active_localization import NICHE
from tests.robot.robots import body
from tests.robot.scans import map_of

AWAY = drive_to((4.0, 0.0, 0.0))
PIONEER = body()


class Backwards(Goto):
    """Drives backwards, as fast as it may."""

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        return Bid(1.0, self.limited(-PIONEER.v_max, 0.0, obstacles))


def stage(agent: Agent, off_m: float) -> Alone:
    made = Alone(agent)
    made.off_m = off_m
    made.state()
    made.give(AWAY)
    return made


def lost(**parameters: float) -> Alone:
    return stage(Relocate(Identity("relocate-1"), Parameters(**parameters)), 2.0 * LOST_M)


@pytest.mark.parametrize("kind", [Goto, Avoid, Gothrough])
def test_no_mission_is_driven_while_the_robot_is_lost(kind: type[Agent]) -> None:
    made = stage(kind(Identity("x-1")), 1.01 * LOST_M)
    for _ in range(10):
        assert claims(made.cycle(points=wall(0.8, -0.4, 0.4))) == []
    assert "lost" in made.bid.reason


def settled(agent: Agent, off_m: float, points: Sequence[Point] = (), leaving: int = 0) -> float:
    """The speed that a holder drives at after 5 s, by wheels that do at once what is commanded.

    `leaving`: so many cycles more, without the points.
    """
    made = stage(agent, off_m)
    made.holding(points=points)
    for cycle in range(50 + leaving):
        made.speed = made.bid.wanted
        made.cycle(points=points if cycle < 50 else ())
    return float(made.bid.wanted[0])


def cap_at(off_m: float) -> float:
    return SURE_M_S * max((LOST_M - off_m) / (LOST_M - UNSURE_M), SLOWEST)


@pytest.mark.parametrize("off_m", [0.35, 0.42, 0.99 * LOST_M])
def test_an_uncertain_pose_caps_the_speed_and_the_cap_is_driven(off_m: float) -> None:
    """A factor would apply again in each cycle: goto ramps up from what it commanded last."""
    sure = settled(Goto(Identity("goto-1")), UNSURE_M)
    assert cap_at(off_m) < sure
    assert settled(Goto(Identity("goto-1")), off_m) == pytest.approx(cap_at(off_m))


def test_a_pose_that_is_unsure_along_the_way_alone_is_no_reason_to_drive_slowly() -> None:
    """As in a long corridor: what is beside is where the pose says."""
    made = stage(Goto(Identity("goto-1")), 0.0)
    bids = []
    for along, across in ((0.4, 0.03), (0.03, 0.4)):
        unsure = (along**2, 0.0, 0.0, across**2, 0.0, 0.0)
        for _ in range(60):
            made.state()
            made.give(obstacles(made.at), Pose(made.at, *made.pose, unsure))
            made.speed = made.bid.wanted
        bids.append(made.bid.wanted[0])
    assert bids[0] > SURE_M_S * 0.5 > bids[1]


@pytest.mark.parametrize("off_m", [UNSURE_M, 0.7 * LOST_M])
def test_what_is_slower_than_the_cap_is_as_fast_as_ever(off_m: float) -> None:
    near = wall(0.6, -0.1, 0.5)
    made = [settled(Avoid(Identity("avoid-1")), off, near) for off in (0.0, off_m)]
    assert 0.0 < made[0] < cap_at(off_m)
    assert made[0] == made[1]


def test_a_speed_that_is_offered_to_others_is_not_scaled_in_each_cycle() -> None:
    sides = [Point(0.1, 0.5), Point(0.1, -0.5)]
    made = settled(Gothrough(Identity("gothrough-1")), 0.99 * LOST_M, sides, leaving=2)
    assert made == pytest.approx(cap_at(0.99 * LOST_M))


def test_backwards_too() -> None:
    back = settled(Backwards(Identity("goto-1")), 0.99 * LOST_M)
    assert back == pytest.approx(-cap_at(0.99 * LOST_M))


def test_the_holder_releases_when_the_robot_is_lost() -> None:
    made = stage(Goto(Identity("goto-1")), 0.0)
    made.holding()
    made.off_m = 2.0 * LOST_M
    messages = [made.cycle() for _ in range(6)]
    assert [c.action for c in commands(m for cycle in messages for m in cycle)][-1] is None


def test_relocate_drives_only_a_robot_that_is_lost() -> None:
    made = stage(Relocate(Identity("relocate-1")), 0.1)
    assert claims(made.cycle()) == []
    assert made.bid.reason == "the pose is known"


def test_without_a_mission_no_agent_drives_a_lost_robot() -> None:
    made = Alone(Relocate(Identity("relocate-1")))
    made.off_m = 2.0
    made.state()
    assert claims(made.cycle()) == []


def test_the_more_uncertain_the_pose_the_more_it_bids() -> None:
    bids = []
    for off_m in (0.51, 1.0, 3.0):
        made = stage(Relocate(Identity("relocate-1")), off_m)
        made.cycle()
        bids.append(made.bid.utility)
    assert bids == sorted(bids)
    assert bids[-1] == 1.0


def test_it_turns_once_and_then_drives_on() -> None:
    made = lost()
    made.holding()
    assert speeds(commands(made.published)[-1]) == (0.0, Parameters().w)
    made.speed = (0.0, Parameters().w)
    for _ in range(round(10 * tau / Parameters().w) + 5):
        made.cycle()
    v, w = speeds(commands(made.published)[-1])
    assert (v > 0.1, w) == (True, 0.0)


def test_lost_again_it_begins_anew() -> None:
    made = lost(give_up_s=5.0)
    made.holding()
    for _ in range(60):
        made.cycle()
    assert "5 s" in made.bid.reason
    made.off_m = 0.1
    for _ in range(15):
        made.cycle()
    made.off_m = 2.0 * LOST_M
    made.cycle()
    assert made.bid.reason == "lost: look around"


def test_where_it_cannot_drive_on_it_turns_to_the_freer_side() -> None:
    made = lost()
    made.holding()
    made.speed = (0.0, 0.5)
    for _ in range(140):
        made.cycle()
    right = [*wall(0.5, -0.6, 0.6), *wall(0.3, -0.9, -0.6)]
    for _ in range(3):
        made.cycle(points=right)
    v, w = speeds(commands(made.published)[-1])
    assert v == 0.0
    assert w > 0.0


def test_not_found_in_time_it_stands_and_logs_it() -> None:
    made = lost(give_up_s=5.0)
    made.holding()
    for _ in range(60):
        last = made.cycle()
    assert claims(last) == []
    assert "5 s" in made.bid.reason
    logs = [
        message for message in made.published if isinstance(message, Log) and "lost" in message.text
    ]
    assert len(logs) == 1


def test_where_it_can_neither_turn_nor_go_on_it_backs_out() -> None:
    """A dead end as wide as the robot: it would stand there until it gave up."""
    made = lost()
    made.holding()
    narrow = [Point(0.03 * i, side) for i in range(-3, 9) for side in (-0.2, 0.2)]
    for _ in range(30):
        made.cycle(points=[*narrow, *wall(0.3, -0.2, 0.2)])
    v, w = speeds(commands(made.published)[-1])
    assert v < 0.0
    assert w == 0.0


def looked_around(*, answers: bool | None) -> Alone:
    """It has turned once; the sonars ahead received an echo meanwhile, or none."""
    made = lost()
    made.holding()
    made.speed = (0.0, Parameters().w)
    for _ in range(round(10 * tau / Parameters().w) + 5):
        ping(made, answers)
        made.cycle()
    return made


def ping(made: Alone, answers: bool | None, heard_m: float = 4.0) -> None:
    if answers is not None:
        echo = (Echo(0.17, 0.03, radians(10), heard_m if answers else None),)
        made.give(Sonar(made.at, 5.0, (*echo, Echo(0.07, 0.14, radians(90), 1.0))))


def test_it_drives_to_where_something_answers_and_turns_on_where_nothing_does() -> None:
    """There may be a wall without an echo."""
    assert speeds(commands(looked_around(answers=True).published)[-1])[0] > 0.1
    made = looked_around(answers=False)
    v, w = speeds(commands(made.published)[-1])
    assert (v, abs(w)) == (0.0, Parameters().w)
    for _ in range(3):
        ping(made, answers=True)
        made.cycle()
    assert speeds(commands(made.published)[-1])[0] > 0.1


def test_without_an_echo_ahead_any_more_it_turns() -> None:
    made = looked_around(answers=True)
    made.speed = (0.25, 0.0)
    for _ in range(round(10 * Parameters().silent_s) + 3):
        ping(made, answers=False)
        made.cycle()
    assert speeds(commands(made.published)[-1])[0] == 0.0


def test_where_nothing_answers_all_around_it_drives_on_all_the_same() -> None:
    made = looked_around(answers=False)
    for _ in range(round(10 * tau / Parameters().w) + 5):
        ping(made, answers=False)
        made.cycle()
    assert speeds(commands(made.published)[-1])[0] > 0.0


@pytest.mark.parametrize("heard_m", [0.2, 0.25, 4.0])
def test_it_drives_no_faster_than_it_can_stop_before_what_answered(heard_m: float) -> None:
    """Also without an obstacle there, as of a wall whose echo came once."""
    made = looked_around(answers=True)
    made.speed = (0.0, 0.0)
    ping(made, answers=True, heard_m=heard_m)
    made.cycle()
    v = speeds(commands(made.published)[-1])[0]
    left = 0.17 + heard_m - PIONEER.outline.front - Parameters().safety.margin_m
    assert PIONEER.stopping_distance(v) <= left + 1e-9
    assert (v == Parameters().v) == (heard_m > 1.0)


def test_on_a_leg_that_tells_places_apart_it_creeps_without_an_echo(world: str) -> None:
    made = stage(Relocate(Identity("relocate-1"), Parameters(world=world)), 2.0 * LOST_M)
    distinguish(made, (5.0, 1.0, 0.0), (7.0, 1.0, pi))
    made.speed = (0.25, 0.0)
    made.agent._recovery.phase = Phase.LEG
    driven = set()
    for answers in (True, False):
        for _ in range(round(10 * Parameters().silent_s) + 2):
            ping(made, answers)
            made.cycle()
        assert made.bid.reason == "lost: to where places differ"
        driven.add(speeds(commands(made.published)[-1])[0])
    assert driven == {Parameters().v, Parameters().v_back}


def test_where_it_neither_turns_to_what_is_open_nor_gets_on_it_goes_where_there_is_room() -> None:
    """Something always stands ahead, as the corner does that it cannot turn past."""
    made = lost()
    made.holding()
    made.speed = (0.0, 0.3)
    for _ in range(round(10 * (tau / Parameters().w + Parameters().patience_s)) + 20):
        made.cycle(points=wall(0.35, -0.6, 0.6))
    assert speeds(commands(made.published)[-1])[0] < 0.0


@pytest.fixture
def world(tmp_path: Path) -> str:
    return map_of(tmp_path / "niche.map", NICHE, (12.0, 3.0))


def distinguish(made: Alone, *places: Pose2) -> None:
    """Turns once, then sends the places where the robot may be."""
    made.holding()
    made.speed = (0.0, Parameters().w)
    for _ in range(round(10 * tau / Parameters().w) + 5):
        made.cycle()
    made.give(message_of(made.at, [place for place in places for _ in range(50)]))
    for _ in range(round(10 * Parameters().wait_s) + 2):
        made.cycle()


def test_it_drives_by_the_places_where_the_robot_may_be(world: str) -> None:
    """A niche is 3.5 m ahead, or 1.5 m behind."""
    made = stage(Relocate(Identity("relocate-1"), Parameters(world=world)), 2.0 * LOST_M)
    distinguish(made, (5.0, 1.0, 0.0), (7.0, 1.0, pi))
    assert made.bid.reason == "lost: to where places differ"
    v, w = speeds(commands(made.published)[-1])
    assert (v, abs(w)) == (0.0, Parameters().w)


def test_with_one_place_or_no_map_it_drives_on_as_without(world: str) -> None:
    made = stage(Relocate(Identity("relocate-1"), Parameters(world=world)), 2.0 * LOST_M)
    distinguish(made, (5.0, 1.0, 0.0))
    assert made.bid.reason == "lost: drive on"
    made = lost()
    distinguish(made, (5.0, 1.0, 0.0), (7.0, 1.0, pi))
    assert made.bid.reason == "lost: drive on"


def test_particles_that_are_none_change_nothing(world: str) -> None:
    made = stage(Relocate(Identity("relocate-1"), Parameters(world=world)), 2.0 * LOST_M)
    distinguish(made, (5.0, 1.0, 0.0))
    made.give(Particles(made.at, 0.0, 0.0, 0.1, b"12345"))
    made.cycle()
    assert made.bid.reason == "lost: drive on"


@pytest.mark.parametrize("before", [(), wall(0.5, -0.4, 0.4)], ids=["free", "a wall"])
def test_a_motion_that_the_robot_agent_refuses_is_not_insisted_on(before: list[Point]) -> None:
    """It tries every other one: the obstacles do not show what holds the robot."""
    made = lost()
    made.holding()
    made.capped = "an obstacle is in the way"
    tried = []
    for _ in range(5 * (REFUSED_CYCLES + 2)):
        made.cycle(points=before)
        tried.append(tuple((rate > 0.0) - (rate < 0.0) for rate in made.commanded))
    left, right, on, back = (0, 1), (0, -1), (1, 0), (-1, 0)
    assert {left, right, on, back} <= set(tried)
    for each in (left, right, on, back):
        first = tried.index(each)
        assert each not in tried[first + REFUSED_CYCLES + 2 : first + 4 * REFUSED_CYCLES]
