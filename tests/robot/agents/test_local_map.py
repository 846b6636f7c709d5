"""The local map keeps what was hit where it was hit, moves it with the robot, and lets it go."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.agents.methods.geometry import ORIGIN, Placed
from armadico.agents.methods.near import Obstacle
from armadico.agents.methods.settings import MapSettings
from armadico.agents.perception.local_map import (
    _MOST_SONARS,
    CELLS,
    NEAR_RINGS,
    POINTS,
    RINGS,
    SECTORS,
    LocalMap,
    cell_at,
)
from armadico.agents.perception.sonar import Parameters, SonarAgent
from armadico.config.loading import load_parameters
from armadico.config.parameters import load_set
from armadico.mobile.geometry import compose, relative
from armadico.mobile.swept_path import Outline
from tests.core.agents.pings import Ping

RING = [
    Ping(x, y, math.radians(bearing), None)
    for x, y, bearing in (
        (0.069, 0.136, 90.0),
        (0.114, 0.119, 50.0),
        (0.148, 0.078, 30.0),
        (0.166, 0.027, 10.0),
        (0.166, -0.027, -10.0),
        (0.148, -0.078, -30.0),
        (0.114, -0.119, -50.0),
        (0.069, -0.136, -90.0),
    )
]
ORDER = (2, 1, 4, 0, 6, 3, 7, 5)
HALF, STILL = Placed(0.0, 0.0, math.pi), ORIGIN
LASTING = MapSettings(memory=1.0, memory_m=math.inf)
BODY = Outline(0.21, 0.23, 0.165)
motions = st.lists(
    st.builds(Placed, st.floats(-0.05, 0.15), st.floats(-0.02, 0.02), st.floats(-0.3, 0.3)),
    max_size=10,
)


def hit(x: float, y: float) -> Ping:
    """An echo from a point, received at the middle of the axle."""
    return Ping(0.0, 0.0, math.atan2(y, x), math.hypot(x, y))


def mapped(*points: tuple[float, float], settings: MapSettings | None = None) -> LocalMap:
    """A map that holds these points, each seen twice."""
    local = LocalMap(settings, BODY)
    for _ in range(2):
        local.update([hit(x, y) for x, y in points])
    return local


@pytest.mark.parametrize("sonar", RING)
def test_a_sonar_hits_the_point_itself_and_not_the_middle_of_its_cell(sonar: Ping) -> None:
    local = LocalMap()
    local.update([sonar._replace(range=1.1)])
    (point,) = local.points()
    assert point.x == sonar.x + 1.1 * math.cos(sonar.bearing)
    assert point.y == sonar.y + 1.1 * math.sin(sonar.bearing)
    assert point.distance == math.hypot(point.x, point.y)


@pytest.mark.parametrize("sonar", RING)
def test_each_sonar_of_the_ring_faces_one_sector_from_half_a_metre_on(sonar: Ping) -> None:
    cos, sin = math.cos(sonar.bearing), math.sin(sonar.bearing)
    sectors = {
        cell_at(sonar.x + along / 50 * cos, sonar.y + along / 50 * sin, 0.25) // RINGS
        for along in range(25, 115)
    }
    assert sectors == {math.floor(math.degrees(sonar.bearing) / 20.0) % SECTORS}


def test_echoes_from_beyond_the_map_fill_nothing() -> None:
    local = LocalMap()
    local.update([Ping(0.0, 0.0, 0.2, 2.5), Ping(0.0, 0.0, 0.2, None)])
    assert local.points() == ()


def test_silence_is_weak_evidence_a_slanted_wall_does_not_answer_either() -> None:
    local = LocalMap()
    local.update([Ping(0.0, 0.0, 0.2, 0.8)])
    for _ in range(2):
        assert len(local.points()) == 1
        local.update([Ping(0.0, 0.0, 0.2, None)])
    for _ in range(2):
        local.update([Ping(0.0, 0.0, 0.2, None)])
    assert local.points() == ()


def test_a_corner_with_three_echoes_and_one_miss_is_still_there() -> None:
    """Once wiped so, it was touched: the ring goes round in 3 to 4 cycles."""
    local = LocalMap(outline=BODY)
    for measured in (1.1, 1.1, 1.1, None):
        for _ in range(4):
            local.move(STILL)
        local.update([RING[2]._replace(range=measured)])
    assert len(local.points()) == 1


def test_a_point_off_the_axis_need_not_answer() -> None:
    local = mapped((1.0, 0.0))
    for bearing in (-12.0, 12.0):
        for _ in range(9):
            local.update([Ping(0.0, 0.0, math.radians(bearing), 2.0)])
    assert any(point[:2] == (1.0, 0.0) for point in local.points())


@pytest.mark.parametrize(("slant", "measured", "left"), [(30, None, 1), (30, 2.0, 0), (50, 2.0, 1)])
def test_a_smooth_wall_at_a_glancing_angle_need_not_answer(
    slant: float, measured: float | None, left: int
) -> None:
    """Silence is nothing beyond 20 degrees, an echo by way of a mirror nothing beyond 45."""
    local = mapped((1.0, 0.0))
    off = math.radians(slant)
    aside = Ping(1.0 - 0.5 * math.cos(off), -0.5 * math.sin(off), off, measured)
    for _ in range(9):
        local.update([aside])
    assert sum(point[:2] == (1.0, 0.0) for point in local.points()) == left


def by_the_thesis(*points: tuple[float, float]) -> LocalMap:
    """The map of the set `thesis`, with these points seen twice."""
    parameters = load_parameters(SonarAgent.parameters, None, list(load_set("thesis")["sonar"]))
    assert isinstance(parameters, Parameters)
    return mapped(*points, settings=parameters.map)


def test_by_the_thesis_a_ping_clears_the_cells_that_it_passes_through() -> None:
    """Figure 3.8: 20 degrees wide, also close by, where 10 degrees off an axis are centimetres."""
    beside, left = (0.3, 0.09), RING[3]  # 17 degrees off the heading, in the sector of that sonar
    for echo in (2.0, None):
        mine, default = by_the_thesis(beside), mapped(beside)
        for _ in range(3):
            mine.update([left._replace(range=echo)])
            default.update([left._replace(range=echo)])
        assert all(math.dist(p[:2], beside) > 0.01 for p in mine.points())
        assert any(math.dist(p[:2], beside) < 0.01 for p in default.points())


def test_by_the_thesis_a_ping_clears_neither_behind_its_echo_nor_in_another_sector() -> None:
    behind, aside = (1.5, 0.25), (0.8, 0.4)
    local = by_the_thesis(behind, aside)
    for _ in range(3):
        local.update([RING[3]._replace(range=0.9)])
    for point in (behind, aside):
        assert any(math.dist(p[:2], point) < 0.01 for p in local.points())


def test_by_the_thesis_a_ping_clears_from_any_side() -> None:
    local = by_the_thesis((1.0, 0.0))
    for _ in range(9):
        local.update([Ping(1.0, -0.5, math.pi / 2, None)])
    assert local.points() == ()


def test_by_the_thesis_cells_that_a_sonar_faces_fade_sooner() -> None:
    ahead, behind = by_the_thesis((1.0, 0.2)), by_the_thesis((1.0, 0.2))
    behind.move(HALF)
    for local in (ahead, behind):
        for _ in range(10):
            local.move(STILL)
    assert (len(ahead.points()), len(behind.points())) == (0, 1)


def test_by_the_thesis_a_cell_holds_one_point() -> None:
    wall, end = (-0.04, 0.35), (0.07, 0.42)
    assert cell_at(*wall, 0.25) == cell_at(*end, 0.25)
    assert len(by_the_thesis(wall, end).points()) == 1
    assert len(mapped(wall, end).points()) == 2


def test_the_direction_of_a_hit_turns_with_the_robot() -> None:
    local = mapped((1.0, 0.0))
    local.move(Placed(0.0, 0.0, math.pi / 2))
    for _ in range(9):
        local.update([Ping(0.0, 0.0, -math.pi / 2, None)])
    assert local.points() == ()


def test_expected_points_count_as_sensed_ones_until_they_are_not_expected() -> None:
    local = mapped((1.0, 0.0))
    local.expect([Obstacle(0.5, 0.2, math.hypot(0.5, 0.2)), Obstacle(0.1, 0.1, 0.2)])
    assert [point[:2] for point in local.points()] == [(0.5, 0.2), (1.0, 0.0)]  # none in the body
    assert local.front() == local.closest() == Obstacle(0.5, 0.2, math.hypot(0.5, 0.2))
    local.expect([])
    assert [point[:2] for point in local.points()] == [(1.0, 0.0)]


def test_from_nearer_a_ping_may_miss_what_a_wider_cone_hit() -> None:
    """From 1 m it is 26 cm to either side; from 0.3 m the cone is 8 cm to either side."""
    near, far = mapped((1.0, 0.0)), mapped((1.0, 0.0))
    near.move(Placed(0.7, 0.0))
    for _ in range(3):
        near.update([Ping(0.0, 0.0, 0.0, 2.0)])
        far.update([Ping(0.0, 0.0, 0.0, 2.0)])
    assert [p.x for p in near.points()] == [pytest.approx(0.3), 2.0]
    assert [p.x for p in far.points()] == [2.0]


def test_an_echo_does_not_clear_what_lies_behind_or_beside_it() -> None:
    local = mapped((1.9, 0.3), (0.3, 1.9))
    local.update([Ping(0.0, 0.0, math.atan2(0.3, 1.9), 0.9)])
    assert len(local.points()) == 3


def test_a_cell_keeps_the_nearer_of_two_hits_unless_the_echo_went_through_it() -> None:
    for first, second, kept in ((1.20, 1.10, 1.10), (1.10, 1.18, 1.10), (1.05, 1.20, 1.20)):
        local = LocalMap()
        for distance in (first, second):
            local.update([Ping(0.0, 0.0, 0.2, distance)])
        assert [p.distance for p in local.points()] == [pytest.approx(kept)]


def test_certainty_takes_several_misses_to_clear() -> None:
    often, once = mapped((1.0, 0.2)), LocalMap()
    once.update([hit(1.0, 0.2)])
    for local in (often, once):
        local.update([Ping(0.0, 0.0, math.atan2(0.2, 1.0), 2.0)])
    assert len(often.points()) == 2
    assert len(once.points()) == 1


@given(st.floats(0.3, 1.6), st.floats(-math.pi, math.pi), motions)
def test_a_point_stays_where_it_is_in_the_world(
    away: float, bearing: float, steps: list[Placed]
) -> None:
    x, y = away * math.cos(bearing), away * math.sin(bearing)
    local = mapped((x, y), settings=LASTING)
    robot, met = ORIGIN, False
    for step in steps:
        robot = Placed(*compose(robot, step))
        local.move(step)
        seen = Placed(*relative(robot, (x, y, 0.0)))
        met |= (-0.23 < seen.x < 0.21 and abs(seen.y) < 0.165) or math.hypot(*seen[:2]) >= 2.5
    expected = Placed(*relative(robot, (x, y, 0.0)))
    found = local.points()
    assert len(found) == (not met)
    for point in found:
        assert (point.x, point.y) == pytest.approx((expected.x, expected.y))


@given(st.lists(st.tuples(st.sampled_from(RING), st.floats(0.05, 5.0)), max_size=60), motions)
def test_every_point_is_on_the_map_outside_the_robot_and_apart_from_the_others_of_its_cell(
    echoes: list[tuple[Ping, float]], steps: list[Placed]
) -> None:
    local = LocalMap(LASTING, BODY)
    local.update([sonar._replace(range=distance) for sonar, distance in echoes])
    for step in [STILL, *steps]:
        local.move(step)
    points = local.points()
    together: dict[int, list[Obstacle]] = {}
    for p in points:
        together.setdefault(cell_at(p.x, p.y, 0.25), []).append(p)
    for cell, those in together.items():
        assert len(those) <= (POINTS if cell % RINGS < NEAR_RINGS else 1)
    assert [p.distance for p in points] == sorted(p.distance for p in points)
    for p in points:
        assert p.distance < 2.5
        assert not (-0.23 < p.x < 0.21 and abs(p.y) < 0.165)


def test_behind_it_is_remembered_for_seconds_but_not_for_ever() -> None:
    local = mapped((1.0, 0.2))
    local.move(HALF)
    for _ in range(100):
        local.move(STILL)
    assert local.closest() == pytest.approx((-1.0, -0.2, math.hypot(1.0, 0.2)))
    for _ in range(200):
        local.move(STILL)
    assert local.closest() is None


def test_memory_fades_with_the_way_and_not_only_with_time() -> None:
    """There and back: the point ends where it was, with a lower probability."""
    local = mapped((1.0, 0.2))
    local.move(HALF)
    for step in (0.1, -0.1) * 15:
        local.move(Placed(step, 0.0))
    assert local.closest() is None
    local = mapped((1.0, 0.2))
    local.move(HALF)
    for _ in range(30):
        local.move(STILL)
    assert local.closest() is not None


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.7])
def test_a_wall_driven_along_is_still_known_beside_the_tail(speed: float) -> None:
    """The ring cannot see it there, and the tail swings into it when the robot turns away."""
    local, fired = LocalMap(), 0
    for cycle in range(60):
        local.move(Placed(speed * 0.1, 0.0))
        firing = [RING[ORDER[(fired + i) % 8]] for i in range(2 + cycle % 2)]
        fired += len(firing)
        local.update(
            Ping(s.x, s.y, s.bearing, (0.4 - s.y) / math.sin(s.bearing)) if s.bearing > 0.0 else s
            for s in firing
        )
    tail = [p for p in local.points() if -0.6 < p.x < -0.1]
    assert tail
    assert all(p.y == pytest.approx(0.4) for p in tail)


def test_a_single_echo_abeam_is_still_known_when_the_tail_comes_by() -> None:
    left = RING[0]
    local = LocalMap()
    local.update([left._replace(range=0.25)])
    for _ in range(7):
        local.move(Placed(0.05, 0.0))
    assert local.closest() == pytest.approx((-0.281, 0.386, math.hypot(0.281, 0.386)))


def test_of_two_points_that_meet_in_a_cell_the_surer_stays() -> None:
    local = LocalMap(LASTING)
    sure, doubtful = (1.20, 0.2), (1.28, 0.2)
    for point in (sure, sure, doubtful):
        local.update([hit(*point)])
    local.move(Placed(0.1, 0.0))
    assert [(p.x, p.y) for p in local.points()] == [pytest.approx((1.10, 0.2))]


def test_the_end_of_a_wall_is_at_its_last_echo_not_at_its_first() -> None:
    """Abeam the wall answers, then its end 11 cm farther on: a corner turns into what lacks.

    Seed 2051: one point alone was known, and the body came to 1 cm from the end.
    """
    local = LocalMap(outline=BODY)
    wall, end = (-0.04, 0.35), (0.07, 0.42)
    for point in (wall, end):
        local.update([hit(*point)])
    assert cell_at(*wall, 0.25) == cell_at(*end, 0.25)
    assert [p[:2] for p in local.points()] == [pytest.approx(wall), pytest.approx(end)]


def test_two_points_that_meet_in_a_near_cell_both_stay_if_they_are_apart() -> None:
    local = LocalMap(LASTING, BODY)
    near, end = (0.17, 0.36), (0.26, 0.42)
    local.update([hit(*near), hit(*end)])
    local.move(Placed(0.2, 0.0))
    moved = [(x - 0.2, y) for x, y in (near, end)]
    assert cell_at(*near, 0.25) != cell_at(*end, 0.25)
    assert cell_at(*moved[0], 0.25) == cell_at(*moved[1], 0.25)
    assert [p[:2] for p in local.points()] == [pytest.approx(point) for point in moved]


def test_a_near_cell_holds_so_many_points_and_the_least_sure_makes_room() -> None:
    ys = [0.26 + 0.03 * k for k in range(8)]
    apart = [(-0.02 + 0.05 * (k % 2), y) for k, y in enumerate(ys)]
    local = LocalMap(MapSettings(apart_m=0.04))
    sure = apart[1 : POINTS + 1]
    for point in (*sure, *sure[1:]):
        local.update([hit(*point)])
    local.update([hit(*apart[POINTS + 1])])
    kept = {(round(p.x, 6), round(p.y, 6)) for p in local.points()}
    assert kept == {(round(x, 6), round(y, 6)) for x, y in (*sure[1:], apart[POINTS + 1])}
    assert {key % CELLS for key in local.cells()} == {cell_at(*sure[0], 0.25)}


@given(st.floats(-math.pi, math.pi))
def test_a_point_is_in_front_or_left_or_right_or_behind(bearing: float) -> None:
    local = mapped((math.cos(bearing), math.sin(bearing)))
    found = [q is not None for q in (local.front(), local.left(), local.right())]
    assert sum(found) == (abs(bearing) <= math.radians(120))


def test_no_more_sonars_are_remembered_than_a_robot_has() -> None:
    """Each is looked through for each point: one that makes new ones up slows nobody for ever."""
    seen = LocalMap()
    for shift in range(1000):
        seen.update([*RING, Ping(0.001 * shift, 0.0, 0.0, None)])
    assert len(seen._sonars) <= _MOST_SONARS
    assert {(ping.x, ping.y, ping.bearing) for ping in RING} <= seen._sonars.keys()
