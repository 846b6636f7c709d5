"""The map's walls are expected near a localized robot, until echoes pass through them."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, radians, sin, sqrt

import pytest

from armadico.agents.methods.near import Obstacle
from armadico.agents.methods.settings import WallSettings
from armadico.agents.perception.known_walls import (
    CLOSE_M,
    MEASURED_CYCLES,
    RECENT_CYCLES,
    STEP_M,
    KnownWalls,
    Segment,
)
from armadico.mobile.geometry import Pose2, to_world
from armadico.mobile.swept_path import Outline
from tests.core.agents.pings import Ping

WALL = (1.0, -2.0, 1.0, 2.0)  # square across the way, a metre ahead
HERE: Pose2 = (0.0, 0.0, 0.0)


def sure(deviation: float) -> tuple[float, ...]:
    """The covariance of a position as uncertain as that, m, the same in both directions."""
    each = deviation * deviation / 2.0
    return (each, 0.0, 0.0, each, 0.0, 1e-4)


def at(
    pose: Pose2 | None, covariance: tuple[float, ...] = sure(0.0), wall: Segment = WALL
) -> KnownWalls:
    known = KnownWalls([wall])
    known.on_pose(pose, covariance)
    return known


def nearest(known: KnownWalls) -> float:
    return min(o.distance for o in known.points())


def explains(known: KnownWalls, ping: Ping) -> bool:
    return known.on_echoes([ping]) == [True]


@pytest.mark.parametrize("pose", [HERE, (0.3, 0.8, 2.0), (1.7, -0.4, -1.0)])
def test_a_wall_is_where_it_is_on_the_map_as_far_as_it_reaches(pose: Pose2) -> None:
    known = at(pose)
    for o in known.points():
        x, y = to_world(pose, o.x, o.y)
        assert x == pytest.approx(1.0)
        assert abs(y) <= 2.0
        assert o.distance == pytest.approx(hypot(o.x, o.y))
        assert o.distance <= WallSettings().reach_m
    assert nearest(known) == pytest.approx(abs(pose[0] - 1.0), abs=STEP_M * STEP_M)


def test_a_wall_that_is_met_edge_on_ends_where_it_ends() -> None:
    known = at(HERE, wall=(0.7, 0.0, 3.0, 0.0))
    assert nearest(known) == pytest.approx(0.7)


def test_a_forbidden_area_is_expected_whatever_answers_behind_it() -> None:
    """Stairs: they return no echo, and what is beyond them does."""
    known = KnownWalls([], forbidden=[WALL])
    for _ in range(20):
        known.on_pose(HERE, sure(0.0))
        known.on_echoes([Ping(0.2, 0.0, 0.0, 3.0), Ping(0.2, 0.1, 0.2, 3.0)])
    assert nearest(known) == pytest.approx(1.0, abs=STEP_M)
    assert not explains(known, Ping(0.0, 0.0, 0.0, 1.0))
    assert not known.near(1.0, 0.0, 0.2)
    known.on_pose(None)
    assert not known.points()


def test_what_is_forbidden_is_expected_by_a_robot_that_is_lost_too() -> None:
    """It is mostly where its odometry has it; sensors detect a wall in time, and stairs not."""
    known = KnownWalls([(-1.0, -2.0, -1.0, 2.0)], forbidden=[WALL])
    for covariance, old in ((sure(2.0), False), (sure(0.01), True)):
        known.on_pose(HERE, covariance, old=old)
        assert {round(o.x) for o in known.points()} == {1}
        assert nearest(known) == pytest.approx(1.0, abs=STEP_M)


def test_what_a_nearer_wall_hides_is_left_out() -> None:
    known = KnownWalls([WALL, (1.1, -2.0, 1.1, 2.0)])
    known.on_pose((0.6, 0.0, 0.0), sure(0.0))
    near = [o for o in known.points() if abs(o.y) < 0.6]
    assert near
    assert all(o.x == pytest.approx(0.4) for o in near)


def test_far_off_fewer_places_will_do_but_no_wall_is_shorter() -> None:
    near, far = at((0.5, 0.0, 0.0)), at((-0.3, 0.0, 0.0))
    assert len(far.points()) < len(near.points())
    post = at(HERE, wall=(1.2, 0.3, 1.2, 0.31))
    assert sorted(round(o.y, 2) for o in post.points())[0] == 0.3


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_uncertain_pose_puts_an_unheard_wall_nearer_on_the_way_and_farther_aside(
    side: float,
) -> None:
    # 0.1 m along x, nothing along y: only the distance from the wall ahead is uncertain.
    known = at((1.0 - 0.5 * side, 0.0, 0.0), (0.01, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert nearest(known) == pytest.approx(0.4, abs=0.01)
    aside = at((1.0 - 0.5 * side, 0.0, radians(90.0)), (0.01, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert nearest(aside) == pytest.approx(0.6, abs=0.01)
    beside = at((0.0, 0.5, 0.0), (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), wall=(-2.0, 1.0, 2.0, 1.0))
    assert nearest(beside) == pytest.approx(0.5, abs=0.01)


def test_the_less_certain_the_pose_the_less_doubt_removes_a_wall() -> None:
    once = WallSettings().miss
    through = [Ping(0.0, 0.0, 0.0, 3.0)]

    def straight_ahead(deviation: float, pings: int) -> bool:
        known = at(HERE, sure(deviation))
        for _ in range(pings):
            known.on_echoes(through)
        return any(abs(o.y) < 0.1 for o in known.points())

    assert 1.0 - once > WallSettings().least
    assert straight_ahead(0.05, 0)
    assert straight_ahead(0.05, 1)
    assert not straight_ahead(0.05, 2)
    assert straight_ahead(0.3, 0)
    assert not straight_ahead(0.3, 1)
    assert not straight_ahead(0.5, 0)


def test_an_echo_through_a_wall_opens_it_there_and_only_there() -> None:
    known = at(HERE)
    for _ in range(2):
        known.on_echoes([Ping(0.0, 0.0, 0.0, 2.5)])
    left = known.points()
    assert not any(abs(o.y) < 0.15 for o in left)
    assert any(0.2 < o.y < 0.5 for o in left)


def test_a_wall_that_does_not_answer_is_still_there() -> None:
    known = at(HERE)
    before = known.points()
    for _ in range(100):
        known.on_echoes([Ping(0.0, 0.0, 0.0, None)])
    assert known.points() == before


def test_a_smooth_wall_at_a_slant_throws_the_sound_elsewhere_and_is_still_there() -> None:
    slant = radians(40)
    pose = (0.0, 0.0, slant)
    known = at(pose)
    before = known.points()
    for _ in range(100):
        known.on_echoes([Ping(0.0, 0.0, 0.0, 4.0)])
    assert known.points() == before


def test_an_echo_from_near_the_wall_raises_no_doubt_and_ends_one() -> None:
    known = at(HERE)
    before = known.points()
    for _ in range(2):
        known.on_echoes([Ping(0.0, 0.0, 0.0, 1.1)])
    assert known.points() == before
    for _ in range(2):
        known.on_echoes([Ping(0.0, 0.0, 0.0, 2.5)])
    known.on_echoes([Ping(0.0, 0.0, 0.0, 1.02)])
    assert known.points() == before


def test_a_doubt_stays_with_its_wall_while_the_robot_moves_and_decays() -> None:
    known = at(HERE)
    for _ in range(2):
        known.on_echoes([Ping(0.0, 0.0, 0.0, 2.5)])
    pose = (0.2, 0.1, radians(20))
    known.on_pose(pose, sure(0.0))
    seen = [to_world(pose, o.x, o.y) for o in known.points()]
    assert not any(abs(y) < 0.1 for _, y in seen)
    for _ in range(1000):
        known.on_echoes([])
    known.on_pose(pose, sure(0.0))
    assert any(abs(y) < 0.1 for _, y in (to_world(pose, o.x, o.y) for o in known.points()))


def test_places_are_found_again_after_a_long_way() -> None:
    known = KnownWalls([(0.0, 1.0, 50.0, 1.0)])
    for metre in range(50):
        known.on_pose((float(metre), 0.0, pi / 2), sure(0.0))
        assert nearest(known) == pytest.approx(1.0, abs=0.01)
    known.on_pose((60.0, 0.0, 0.0), sure(0.0))
    assert not known.points()


def test_the_covariance_counts_as_the_wall_stands_to_it() -> None:
    slant = radians(30)
    c, s = cos(slant), sin(slant)
    wall = (c - 2.0 * s, s + 2.0 * c, c + 2.0 * s, s - 2.0 * c)  # a metre off, at 30 degrees
    across = (0.04 * s * s, -0.04 * s * c, 0.0, 0.04 * c * c, 0.0, 0.0)  # 0.2 m along the wall
    assert nearest(at(HERE, across, wall)) == pytest.approx(1.0, abs=0.01)
    toward = (0.04 * c * c, 0.04 * s * c, 0.0, 0.04 * s * s, 0.0, 0.0)
    assert nearest(at(HERE, toward, wall)) == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize(
    ("bearing", "measured", "explained"),
    [
        (0.0, 1.0, True),
        (radians(30.0), 1.0, True),  # by the wall's foot, outside of the cone
        (radians(65.0), 1.0, False),
        (0.0, 0.7, False),  # a person in front of it
        (0.0, 1.3, False),
        (pi, 1.0, False),
        (0.0, None, False),
    ],
)
def test_an_echo_is_a_walls_that_is_as_far_in_the_sonars_cone(
    bearing: float, measured: float | None, explained: bool
) -> None:
    assert explains(at(HERE), Ping(0.0, 0.0, bearing, measured)) == explained


def test_where_the_pose_is_unsure_an_echo_may_be_a_walls_that_is_farther_off() -> None:
    ping = Ping(0.0, 0.0, 0.0, 0.88)
    assert not explains(at(HERE), ping)
    assert explains(at(HERE, sure(0.1)), ping)


def test_a_wall_beyond_what_is_expected_explains_an_echo_too() -> None:
    far = at((-1.2, 0.0, 0.0))
    assert not far.points()
    assert explains(far, Ping(0.0, 0.0, 0.0, 2.2))


def test_a_doubted_wall_explains_no_echo() -> None:
    known = at(HERE)
    for _ in range(3):
        known.on_echoes([Ping(0.0, 0.0, radians(bearing), 1.6) for bearing in range(-18, 19, 6)])
    assert not explains(known, Ping(0.0, 0.0, radians(30.0), 1.0))


def test_a_wall_is_no_farther_than_measured_for_a_while() -> None:
    known = at(HERE, sure(0.1))

    def ahead() -> float:
        known.on_pose(HERE, sure(0.1))
        return min(o.x for o in known.points() if abs(o.y) < 0.05)

    far = ahead()
    for measured in (0.9, 0.95):
        assert explains(known, Ping(0.0, 0.0, 0.0, measured))
        assert ahead() == pytest.approx(measured, abs=0.02)
    assert far < 1.0, "no echo was expected of it yet"
    for _ in range(MEASURED_CYCLES + 1):
        known.on_echoes([])
    assert ahead() == pytest.approx(far)


def test_an_echo_from_farther_away_moves_no_wall_away_along_the_way() -> None:
    """It may be of something else."""
    known = at(HERE, sure(0.1))
    assert explains(known, Ping(0.0, 0.0, 0.0, 1.08))
    known.on_pose(HERE, sure(0.1))
    assert min(o.x for o in known.points() if abs(o.y) < 0.05) == pytest.approx(1.0, abs=0.01)


BODY = Outline(front=0.25, rear=0.25, half_width=0.2)


CORNER = hypot(0.25, 0.2)
MAY = 0.06  # m that the pose may be off


def beyond_corner(wall: float, *measured: float) -> float:
    """Distance of a wall to the right beyond the footprint's circle, m, measured or not."""
    known = KnownWalls([(-2.0, -wall, 2.0, -wall)])
    known.on_pose(HERE, sure(sqrt(2.0) * MAY))
    for away in measured:
        assert explains(known, Ping(0.0, 0.0, -pi / 2, away))
        known.on_pose(HERE, sure(sqrt(2.0) * MAY))
    return min(-o.y for o in known.points(BODY) if abs(o.x) < 0.05) - CORNER


@pytest.mark.parametrize("away", [-0.1, 0.02, 0.06, 0.1, 0.3])
def test_a_wall_beside_the_circle_of_the_body_is_where_the_map_has_it(away: float) -> None:
    """Farther off by what the pose may be off, a corner would be turned into it."""
    expected = away + min(MAY, max(0.0, away - CLOSE_M))
    assert beyond_corner(CORNER + away) == pytest.approx(expected, abs=0.004)


def test_a_wall_measured_farther_away_counts_only_outside_that_circle() -> None:
    """An absorbing wall returns no echo: it was from its edge."""
    assert beyond_corner(CORNER + 0.02, CORNER + 0.06) == pytest.approx(0.02, abs=0.004)
    assert beyond_corner(CORNER + 0.2, CORNER + 0.24) == pytest.approx(0.24, abs=0.004)


@pytest.mark.parametrize("off", [0.05, -0.05])
def test_a_measured_door_post_stays_where_it_was_measured_however_near(off: float) -> None:
    """Off to one side of a door by the pose, it fits through all the same."""
    post = 0.23  # to the right, by the map
    known = KnownWalls([(0.3, -post, 0.3, -1.0)])
    for _ in range(3):
        known.on_pose(HERE, sure(0.1))
        away = hypot(0.3, post + off)
        assert explains(known, Ping(0.0, 0.0, atan2(-post, 0.3), away))
    known.on_pose(HERE, sure(0.1))
    measured = min(hypot(o.x, o.y) for o in known.points(BODY))
    mapped = hypot(0.3, post)
    assert measured > mapped + 0.02 if off > 0.0 else measured < mapped - 0.02


OFF = 0.08  # m that the pose may be off


def along(known: KnownWalls, turned: float = 0.0) -> None:
    """By its pose it drives along a wall 0.4 m to its left, and in truth approaches it."""
    for step in range(5):
        x = 0.1 * step
        known.on_pose((x, 0.0, 0.0), sure(OFF))
        assert explains(known, Ping(0.0, 0.0, pi / 2, 0.36 - turned * x))


def to_the_left(known: KnownWalls, least: float, most: float) -> list[Obstacle]:
    """What is expected beside where it has come to, between so far ahead."""
    known.on_pose((0.4, 0.0, 0.0), sure(OFF))
    found = sorted(o for o in known.points() if least < o.x < most)
    assert found
    return found


FARTHEST = 0.4 + OFF / sqrt(2.0)


@pytest.mark.parametrize(("turned", "within"), [(0.0, 0.002), (0.1, 0.03), (-0.1, 0.03)])
def test_a_wall_continues_as_measured_not_as_a_turned_pose_has_it(
    turned: float, within: float
) -> None:
    known = KnownWalls([(-2.0, 0.4, 2.0, 0.4)])
    along(known, turned)
    for o in to_the_left(known, 0.2, 0.4):
        assert o.y == pytest.approx(min(0.36 - turned * (0.4 + o.x), FARTHEST), abs=within)
    for _ in range(RECENT_CYCLES + 1):
        known.on_echoes([])
    assert to_the_left(known, 0.4, 0.7)[-1].y == pytest.approx(FARTHEST)


def test_another_wall_does_not_go_on_as_this_one() -> None:
    known = KnownWalls([(-2.0, 0.4, 0.45, 0.4), (0.7, 0.4, 2.0, 0.4)])
    along(known)
    assert to_the_left(known, 0.3, 0.6)[0].y == pytest.approx(FARTHEST)


def test_the_end_of_a_wall_is_not_extrapolated() -> None:
    """Measured at a slant, it may be longer than on the map, or nearer."""
    known = KnownWalls([(0.8, 0.4, 2.0, 0.4)])
    known.on_pose((0.4, 0.0, 0.0), sure(OFF))
    assert explains(known, Ping(0.0, 0.0, pi / 4, 0.5))
    assert to_the_left(known, 0.7, 1.2)[0].y == pytest.approx(FARTHEST)


def beside(y: float = 0.74) -> KnownWalls:
    """A robot that drives along a smooth wall to its right, sure of where it is."""
    known = KnownWalls([(-20.0, -y, 20.0, -y)])
    known.on_pose(HERE, sure(0.06))
    return known


@pytest.mark.parametrize("bearing", [-10.0, 10.0])
@pytest.mark.parametrize("away", [0.6, 0.85, 1.0, 1.2, 1.4])
def test_a_person_walking_along_a_wall_is_not_that_wall(bearing: float, away: float) -> None:
    """Within 34 degrees of the axis the wall has a place at each of these distances."""
    assert not explains(beside(), Ping(0.17, -0.03, radians(bearing), away))


def test_a_wall_at_a_slant_answers_at_its_foot_or_where_nearest_in_the_beam() -> None:
    foot = Ping(0.0, 0.0, radians(-60.0), 0.74)
    rough = Ping(0.0, 0.0, radians(-50.0), 0.74 / sin(radians(65.0)))
    between = Ping(0.0, 0.0, radians(-50.0), 0.74 / sin(radians(35.0)))
    assert explains(beside(), foot)
    assert explains(beside(), rough)
    assert not explains(beside(), between)


def test_the_end_of_a_wall_answers_at_any_slant() -> None:
    known = KnownWalls([(1.0, -0.4, 9.0, -0.4)])
    known.on_pose(HERE, sure(0.06))
    assert explains(known, Ping(0.0, 0.0, radians(-10.0), hypot(1.0, 0.4)))
    assert not explains(known, Ping(0.0, 0.0, radians(-10.0), hypot(1.7, 0.4)))


def test_a_person_coming_through_a_door_does_not_move_its_posts() -> None:
    """Each echo is near where a post would be, had the one before brought that post nearer."""
    known = KnownWalls([(1.2, -2.0, 1.2, -0.45), (1.2, 0.45, 1.2, 2.0)])
    explained = []
    for away in (1.2, 1.1, 1.0, 0.9, 0.8):
        known.on_pose(HERE, sure(0.05))
        explained.append(explains(known, Ping(0.0, 0.0, radians(-10.0), away)))
    assert explained[0]
    assert not any(explained[-3:])
    known.on_pose(HERE, sure(0.05))
    assert nearest(known) > 1.0
