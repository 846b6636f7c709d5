"""Giveway, handed messages by hand: who meets whom, who backs off, and where to."""

from __future__ import annotations

from math import cos, pi, sin

import pytest

from armadico.agents.giveway import GiveWay, Parameters
from armadico.core.agent import Identity
from armadico.core.messages import FleetMeeting, FleetPose, Message, Point, Trajectory
from armadico.observe.measures import speeds
from tests.framework.stage import Stage, claims, commands, drive_to

WALLS = [Point(x / 10, y) for x in range(14, 20) for y in (-0.5, 0.5)]  # a door's, in the world
HERE = 1.0  # m: where it stands before that, having come from the origin


class Meeting(Stage):
    """A robot that has come to a door along the x axis, and another one beyond that."""

    def __init__(self, *, way: float = HERE, to: float = 6.0, x: float = 3.0) -> None:
        super().__init__(GiveWay(Identity("giveway-1"), Parameters(namespace="lab/b")))
        self.other = FleetPose("a", x, 0.0, pi, (), 0.0, 0.0, 0.2, 0.2, 0.2)
        self.word: FleetMeeting | None = None
        self.walls = WALLS
        self.state()
        self.hand(drive_to((to, 0.0, 0.0)))
        self.speed = (0.3, 0.0)
        for tenth in range(round(10 * way) + 1):
            self.pose = (HERE - way + tenth / 10, 0.0, 0.0)
            self.cycle()
        self.speed = (0.0, 0.0)

    def says(self, utility: float, *, yields: bool = False, aside: bool = False) -> None:
        """The other one's word, in each cycle from now on."""
        self.word = FleetMeeting("a", "b", utility, yields, aside)

    def meet(self, cycles: int = 1) -> list[Message]:
        """So many cycles; it goes as it is commanded, at once."""
        said: list[Message] = []
        for _ in range(cycles):
            x, y, theta = self.pose
            self.hand(self.other, *([] if self.word is None else [self.word]))
            c, s = cos(theta), sin(theta)
            near = [
                Point(c * (p.x - x) + s * (p.y - y), c * (p.y - y) - s * (p.x - x))
                for p in self.walls
            ]
            said = self.cycle(points=near)
            self.speed = speeds(commands(said)[-1]) if commands(said) else (0.0, 0.0)
            v, w = self.speed
            self.pose = (x + 0.1 * v * c, y + 0.1 * v * s, theta + 0.1 * w)
        return said

    @property
    def words(self) -> list[FleetMeeting]:
        """What it said of meetings."""
        return [message for message in self.said if isinstance(message, FleetMeeting)]


def test_two_that_are_head_on_where_it_is_narrow_say_what_driving_on_is_worth() -> None:
    meeting = Meeting()
    meeting.meet()
    (word,) = meeting.words
    assert (word.robot, word.other, word.yields) == ("b", "a", False)
    assert 0.3 < word.utility < 0.35, "5 m to go"
    assert meeting.bid().reason == "a says nothing"
    farther = Meeting(to=20.0)
    farther.meet()
    assert farther.words[-1].utility > word.utility


@pytest.mark.parametrize(
    ("x", "theta", "walls"),
    [(3.0, 0.0, WALLS), (0.0, pi, WALLS), (3.7, pi, WALLS), (3.0, pi, []), (3.0, pi, WALLS[::2])],
    ids=["ahead of it", "behind it", "far off", "in the open", "along a wall"],
)
def test_else_they_have_not_met(x: float, theta: float, walls: list[Point]) -> None:
    meeting = Meeting()
    meeting.other = FleetPose("a", x, 0.0, theta, (), 0.0, 0.0, 0.2, 0.2, 0.2)
    meeting.walls = walls
    meeting.meet(25)
    assert meeting.words == []
    assert meeting.bid().reason == "no other robot stands before this one"


def test_two_that_stand_for_a_while_face_to_face_have_met_anywhere() -> None:
    meeting = Meeting(x=2.0)
    meeting.walls = []
    meeting.meet(15)
    assert meeting.words == []
    meeting.meet(10)
    assert meeting.words


def test_who_says_less_backs_off_to_where_there_is_room_and_stands_until_they_have_passed() -> None:
    meeting = Meeting(way=4.0)
    meeting.says(0.9)
    meeting.meet(4)
    assert meeting.words[-1].yields
    meeting.meet(150)
    x, y, _ = meeting.pose
    assert HERE - 1.6 < x < HERE - 1.1
    assert abs(y) < 0.02
    assert meeting.words[-1].aside
    assert meeting.speed == (0.0, 0.0)
    assert claims(meeting.meet())[-1].utility == 0.95
    beside = FleetPose("a", x - 1.0, 0.6, pi, (), 0.3, 0.0, 0.2, 0.2, 0.2)
    meeting.other, meeting.word = beside, None
    meeting.meet(2)
    assert meeting.bid().utility is None, "it has passed"


def test_where_there_is_no_room_it_backs_on() -> None:
    meeting = Meeting(way=4.0, x=2.5)
    meeting.walls = [Point(x / 10, y) for x in range(-2, 20) for y in (-0.5, 0.5)]
    meeting.says(0.9)
    meeting.meet(150)
    assert -0.75 < meeting.pose[0] < -0.5
    assert meeting.words[-1].aside


def test_who_says_more_stands_until_the_other_is_aside() -> None:
    meeting = Meeting()
    meeting.says(0.1, yields=True)
    meeting.meet(5)
    assert claims(meeting.meet())[-1].commanded == (0.0, 0.0)
    meeting.says(0.1, yields=True, aside=True)
    meeting.meet(2)
    assert meeting.bid().reason == "a stands aside"
    assert not any(word.yields for word in meeting.words)


def test_of_two_that_say_the_same_one_backs_off() -> None:
    meeting = Meeting()
    meeting.meet()
    meeting.says(meeting.words[-1].utility)
    meeting.meet(3)
    assert meeting.words[-1].yields, "a comes before b"


def test_of_two_that_back_off_at_once_the_better_one_stays() -> None:
    meeting = Meeting()
    meeting.says(0.9)
    meeting.meet(3)
    assert meeting.words[-1].yields
    meeting.says(0.1, yields=True)
    meeting.meet(2)
    assert not meeting.words[-1].yields


def test_who_has_come_from_nowhere_cannot_back_off_and_says_all_there_is() -> None:
    meeting = Meeting(way=0.0)
    meeting.says(0.9)
    meeting.meet(3)
    assert meeting.words[-1].utility == 1.0
    assert not meeting.words[-1].yields


def test_who_gets_no_farther_back_lets_the_other_one() -> None:
    meeting = Meeting(way=4.0)
    meeting.walls = [*WALLS, *(Point(HERE - 0.35, y / 10) for y in range(-3, 4))]
    meeting.says(0.9)
    meeting.meet(3)
    assert meeting.words[-1].yields
    meeting.meet(75)
    assert meeting.words[-1].utility == 1.0
    assert not meeting.words[-1].yields


def test_a_robot_that_says_to_be_here_or_falls_silent_ends_nothing() -> None:
    meeting = Meeting()
    meeting.other = FleetPose("a", HERE, 0.0, pi, (), 0.0, 0.0, 0.2, 0.2, 0.2)
    meeting.meet(30)
    meeting.other = FleetPose("a", 3.0, 0.0, pi, (), 0.0, 0.0, 0.2, 0.2, 0.2)
    meeting.says(0.9)
    meeting.meet(5)
    assert meeting.words[-1].yields
    for _ in range(30):
        meeting.cycle()
    assert meeting.bid().utility is None


def test_nobody_gives_way_without_a_goal() -> None:
    meeting = Meeting()
    meeting.hand(Trajectory(2, 2, ()))
    meeting.says(0.9)
    meeting.meet(3)
    assert meeting.words == []
    assert meeting.bid().reason == "no goal"
