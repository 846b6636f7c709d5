"""Plans keep clear of walls, pass doors in order and squarely, and errors state the reason."""

import math
import tomllib
from importlib.resources import files
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.methods import planning
from armadico.agents.methods.energy import Pace, energy, motor_power
from armadico.agents.methods.geometry import Placed, direction, distance
from armadico.agents.methods.grid import Grid, Margins
from armadico.agents.methods.path_smoothing import ROUND_M, rounded
from armadico.agents.methods.planning import Plan, PlanError
from armadico.agents.methods.room_graph import axis, route
from armadico.bridge.p2os.profile import P2osRobot
from armadico.config.profile import load_profile
from armadico.config.worlds import Door, Room, Segment, World
from armadico.mobile.geometry import wrap

BODY = load_profile("pioneer-2dx").body


def plan(
    world: World,
    start: Placed,
    goal: Placed,
    margins: Margins | None = None,
    *,
    round_corners: bool = False,
) -> Plan:
    return planning.plan(world, start, goal, BODY, margins, round_corners=round_corners)


def box(x1: float, y1: float, x2: float, y2: float) -> list[Segment]:
    return [(x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)]


# Two rooms side by side below a hall, each with a door of one metre to it.
ROOMS = World(
    name="rooms",
    walls=(
        *box(0, 0, 9, 4.5),
        *((0.0, 3.0, 1.0, 3.0), (2.0, 3.0, 5.8, 3.0), (6.8, 3.0, 9.0, 3.0)),
        (4.6, 0.0, 4.6, 3.0),
    ),
    bounds=(0.0, 0.0, 9.0, 4.5),
    rooms=(Room("A", 0, 0, 4.6, 3), Room("B", 4.6, 0, 9, 3), Room("hall", 0, 3, 9, 4.5)),
    doors=(Door("a", "A", "hall", 1.5, 3.0), Door("b", "hall", "B", 6.3, 3.0)),
)
# A second way from A to B, through the wall between them.
SHORT_CUT = msgspec.structs.replace(
    ROOMS,
    walls=(*ROOMS.walls[:-1], (4.6, 0.0, 4.6, 1.0), (4.6, 2.0, 4.6, 3.0)),
    doors=(*ROOMS.doors, Door("c", "A", "B", 4.6, 1.5)),
)
OPEN = msgspec.structs.replace(ROOMS, rooms=(), doors=())
START, GOAL = Placed(3.4, 0.6, math.pi / 2), Placed(7.4, 0.7, -math.pi / 2)


def inside(margin: float) -> st.SearchStrategy[Placed]:
    """Poses in any room, at least so far from its walls."""
    return st.sampled_from(ROOMS.rooms).flatmap(
        lambda room: st.builds(
            Placed,
            st.floats(room.x1 + margin, room.x2 - margin),
            st.floats(room.y1 + margin, room.y2 - margin),
            st.floats(-3.0, 3.0),
        )
    )


WORLDS = st.sampled_from([ROOMS, SHORT_CUT, OPEN])
columns = st.tuples(st.floats(0.5, 8.0), st.floats(0.4, 3.8))


def way(found: Plan, start: Placed) -> list[Placed]:
    return [start, *found.waypoints]


def with_columns(world: World, corners: list[tuple[float, float]]) -> World:
    extra = [wall for x, y in corners for wall in box(x, y, x + 0.3, y + 0.3)]
    return msgspec.structs.replace(world, walls=(*world.walls, *extra))


@settings(max_examples=30)
@given(
    inside(0.17),
    inside(0.17),
    st.lists(columns, max_size=3),
    WORLDS,
    st.booleans(),
)
def test_every_stretch_keeps_the_radius_clear(
    start: Placed,
    goal: Placed,
    corners: list[tuple[float, float]],
    world: World,
    round_corners: bool,
) -> None:
    world = with_columns(world, corners)
    grid, radius = Grid(world.walls, world.bounds), Margins(BODY.circle_m).radius_m
    ends = grid.clearance_at(start), grid.clearance_at(goal)
    try:
        found = plan(world, start, goal, Margins(BODY.circle_m), round_corners=round_corners)
    except PlanError:
        return
    stretches = list(pairwise(way(found, start)))
    least = [grid.clearance_between(a, b) for a, b in stretches]
    assert least[0] >= min(radius, *ends) - 1e-9
    assert least[-1] >= min(radius, *ends) - 1e-9
    assert all(clearance >= radius - 1e-9 for clearance in least[1:-1])
    assert found.clearance_m == min(least)
    assert found.length_m == pytest.approx(sum(distance(a, b) for a, b in stretches))
    assert found.waypoints[-1] == goal


def sharpest(found: Plan, start: Placed) -> float:
    """The sharpest turn, rad."""
    headings = [direction(a, b) for a, b in pairwise(way(found, start))]
    return max(abs(wrap(b - a)) for a, b in pairwise(headings))


def test_corners_are_cut_off_where_there_is_room_and_the_way_gets_shorter() -> None:
    sharp, round_ = (plan(ROOMS, START, GOAL, round_corners=cut) for cut in (False, True))
    assert sharpest(round_, START) < 0.6 * sharpest(sharp, START)
    assert round_.length_m < sharp.length_m
    assert round_.clearance_m >= min(sharp.clearance_m, ROUND_M) - 1e-9
    assert round_.doors == sharp.doors


def test_wiggles_of_a_few_centimetres_go() -> None:
    grid, margins = Grid(ROOMS.walls, ROOMS.bounds), Margins(BODY.circle_m)
    y = GOAL.y
    wiggly = [Placed(GOAL.x + 0.1 * n, y + 0.03 * (n % 2)) for n in range(5)]
    assert rounded(grid, margins, wiggly) == [wiggly[0], wiggly[-1]]
    assert rounded(grid, margins, [GOAL, GOAL]) == [GOAL, GOAL]


@settings(max_examples=40)
@given(inside(0.35), inside(0.35))
def test_between_clear_places_there_is_a_way_and_it_is_not_long(
    start: Placed, goal: Placed
) -> None:
    over_doors, direct = plan(ROOMS, start, goal), plan(OPEN, start, goal)
    assert direct.length_m >= distance(start, goal) - 1e-9
    assert over_doors.length_m <= 1.15 * direct.length_m + 1.5


def test_no_way_leads_over_what_is_forbidden() -> None:
    """Stairs in the short cut: the way is the long one, by rooms and by cells."""
    stairs = tuple(box(4.3, 1.0, 4.9, 2.0))
    for world in (SHORT_CUT, msgspec.structs.replace(SHORT_CUT, rooms=(), doors=())):
        short = plan(world, START, GOAL)
        long = plan(msgspec.structs.replace(world, forbidden=stairs), START, GOAL)
        assert max(w.y for w in short.waypoints) < 2.5
        assert max(w.y for w in long.waypoints) > 3.0
        assert long.clearance_m > 0.2


def test_what_is_forbidden_is_called_so_where_it_leaves_no_way() -> None:
    world = msgspec.structs.replace(OPEN, forbidden=tuple(box(5.0, -9.0, 5.3, 20.0)))
    with pytest.raises(PlanError, match="clear of walls and of what is forbidden"):
        plan(world, START, GOAL)
    with pytest.raises(PlanError, match=r"0\.10 m from what is forbidden"):
        plan(world, START, Placed(5.4, 2.0))
    with pytest.raises(PlanError, match=r"clear of walls$"):
        plan(msgspec.structs.replace(OPEN, walls=world.forbidden), START, GOAL)


def test_doors_are_passed_in_order_and_squarely() -> None:
    found = plan(ROOMS, START, GOAL)
    assert found.doors == ("a", "b")
    places = way(found, START)
    for name in found.doors:
        door = next(door for door in ROOMS.doors if door.name == name)
        (crossing,) = [
            (a, b) for a, b in pairwise(places) if (a.y - 3.0) * (b.y - 3.0) < 0 and a.x == door.x
        ]
        for mark in crossing:
            assert mark.x == pytest.approx(door.x)
            assert abs(mark.y - 3.0) == pytest.approx(0.6)
            assert mark.theta == pytest.approx(direction(*crossing))


def test_a_plan_is_few_waypoints_with_headings_along_the_way() -> None:
    found = plan(ROOMS, START, GOAL)
    assert len(found.waypoints) == 5
    for before, here, after in zip(
        way(found, START), found.waypoints, found.waypoints[1:], strict=False
    ):
        turn = abs(wrap(direction(here, after) - direction(before, here)))
        for leg in (direction(before, here), direction(here, after)):
            assert abs(wrap(here.theta - leg)) <= turn + 1e-9
    assert found.waypoints[-1] == GOAL


def test_where_there_is_room_it_is_used() -> None:
    world = World("open", tuple(box(0, 0, 6, 4)) + tuple(box(2, 1.5, 4, 2.5)), (0, 0, 6, 4))
    found = plan(world, Placed(1.0, 1.9), Placed(5.0, 1.9))
    assert found.clearance_m >= 0.40


def test_a_narrow_passage_is_taken_in_its_middle() -> None:
    walls = (*box(0, 0, 6, 4), (3.0, 0.0, 3.0, 1.6), (3.0, 2.4, 3.0, 4.0))
    found = plan(World("gap", walls, (0, 0, 6, 4)), Placed(1.0, 3.0), Placed(5.0, 1.0))
    assert found.clearance_m >= 0.34


def test_across_a_floor_of_forty_metres_the_doors_are_two_and_the_turns_few() -> None:
    walls, rooms, doors = box(0, 0, 15, 40), [Room("hall", 6, 0, 9, 40)], []
    for y in range(0, 40, 4):
        walls += [(0, y, 6, y), (9, y, 15, y)]
        for side, x, edge in (("left", 6.0, 0.0), ("right", 9.0, 9.0)):
            walls += [
                (x, y, x, y + 1.5),
                (x, y + 2.5, x, y + 4),
                *box(edge + 2, y, edge + 3, y + 1),
            ]
            rooms.append(Room(f"{side} {y}", edge, y, edge + 6, y + 4))
            doors.append(Door(f"{side} {y}", f"{side} {y}", "hall", x, y + 2.0))
    world = World("floor", tuple(walls), (0, 0, 15, 40), rooms=tuple(rooms), doors=tuple(doors))
    found = plan(world, Placed(1.0, 1.0), Placed(14.0, 37.0))
    assert found.doors == ("left 0", "right 36")
    assert found.clearance_m >= 0.40
    assert len(found.waypoints) <= 8
    assert found.length_m == pytest.approx(46.0, abs=2.0)


def test_the_mark_of_a_door_need_not_be_in_the_middle_of_its_opening() -> None:
    doors = (msgspec.structs.replace(ROOMS.doors[0], x=1.3), ROOMS.doors[1])
    moved = msgspec.structs.replace(ROOMS, doors=doors)
    assert plan(moved, START, GOAL).waypoints[0].x == pytest.approx(1.5, abs=0.03)


def test_a_door_too_narrow_is_gone_round() -> None:
    narrow = msgspec.structs.replace(SHORT_CUT, walls=(*SHORT_CUT.walls, (4.6, 1.4, 4.6, 2.0)))
    assert plan(narrow, START, GOAL).doors == ("a", "b")


def test_a_leg_blocked_inside_a_room_is_gone_round() -> None:
    blocked = msgspec.structs.replace(SHORT_CUT, walls=(*SHORT_CUT.walls, (4.0, 0.0, 4.0, 3.0)))
    assert plan(blocked, START, GOAL).doors == ("a", "b")


def test_a_room_cut_in_two_is_left_and_entered_again() -> None:
    doors = (*ROOMS.doors, Door("d", "A", "hall", 4.0, 3.0))
    walls = tuple(w for w in ROOMS.walls if w != (2.0, 3.0, 5.8, 3.0))
    cut = ((2.0, 3.0, 3.5, 3.0), (4.5, 3.0, 5.8, 3.0), (2.7, 0.0, 2.7, 3.0))
    world = msgspec.structs.replace(ROOMS, doors=doors, walls=(*walls, *cut))
    assert plan(world, Placed(1.0, 1.0), Placed(4.0, 1.0)).doors == ("a", "d")


def test_from_a_place_in_the_doorway_it_does_not_go_back_first() -> None:
    found = plan(ROOMS, Placed(1.5, 2.8, math.pi / 2), Placed(3.0, 3.7))
    assert all(waypoint.y > 2.8 for waypoint in found.waypoints)
    assert found.doors == ("a",)


def test_from_beside_a_wall_it_leads_away_first() -> None:
    start = Placed(0.2, 1.0, 0.0)
    found = plan(ROOMS, start, Placed(0.4, 2.0))
    grid = Grid(ROOMS.walls, ROOMS.bounds)
    assert grid.clearance_at(found.waypoints[0]) >= Margins(BODY.circle_m).radius_m
    assert found.clearance_m == pytest.approx(0.2)


def test_a_pose_outside_every_room_is_planned_without_them() -> None:
    partly = msgspec.structs.replace(ROOMS, rooms=ROOMS.rooms[:1], doors=())
    found = plan(partly, START, GOAL)
    assert found.doors == ()
    assert found.waypoints == plan(OPEN, START, GOAL).waypoints


def test_to_where_it_is_already_the_plan_is_the_goal() -> None:
    found = plan(ROOMS, START, START)
    assert (found.waypoints, found.length_m) == ((START,), 0.0)


@pytest.mark.parametrize("world", [ROOMS, OPEN])
@pytest.mark.parametrize(
    ("start", "goal", "text"),
    [
        (Placed(-1.0, 1.0), GOAL, r"the start \(-1, 1\) is off the world, which is \(0, 0\)"),
        (START, Placed(3.0, 9.0), r"the goal \(3, 9\) is off the world"),
        (START, Placed(4.6, 1.0), r"the goal \(4\.6, 1\) is inside a wall, or 0\.00 m from one"),
        (START, Placed(0.3, 1.0), r"0\.30 m from one; it needs 0\.34 m: 0\.30 m to turn"),
        (Placed(0.1, 1.0), GOAL, r"the start .* inside a wall, or 0\.10 m from one"),
    ],
)
def test_a_pose_where_the_robot_cannot_be_is_named(
    world: World, start: Placed, goal: Placed, text: str
) -> None:
    with pytest.raises(PlanError, match=text):
        plan(world, start, goal)


@pytest.mark.parametrize(
    ("walls", "doors", "text"),
    [
        (
            ((5.8, 3.0, 6.8, 3.0),),
            ROOMS.doors[:1],
            "no way from room A to room B: no chain of doors connects them",
        ),
        (((1.4, 3.0, 2.0, 3.0),), ROOMS.doors, "door a leaves 0.20 m on either side, 0.24 m are"),
        (((5.0, 3.0, 5.0, 4.5),), ROOMS.doors, "blocked in room hall from door a to door b"),
        (tuple(box(6.9, 0.2, 7.9, 1.2)), ROOMS.doors, "blocked in room B from door b to the goal"),
    ],
)
def test_the_reason_for_no_path_is_returned(
    walls: tuple[Segment, ...], doors: tuple[Door, ...], text: str
) -> None:
    world = msgspec.structs.replace(ROOMS, walls=ROOMS.walls + walls, doors=doors)
    with pytest.raises(PlanError, match=text):
        plan(world, START, GOAL)


def test_where_there_is_no_wider_way_a_tighter_one_will_do() -> None:
    tight = msgspec.structs.replace(ROOMS, walls=(*ROOMS.walls, (1.5, 3.0, 2.0, 3.0)))
    with pytest.raises(PlanError, match=r"0\.3 m are needed"):
        plan(tight, START, GOAL, Margins(BODY.circle_m))
    assert 0.24 <= plan(tight, START, GOAL).clearance_m < 0.3
    assert plan(ROOMS, START, GOAL).clearance_m >= 0.3


@pytest.mark.parametrize("far", [5.4, 5.7, 6.0, 6.3])
def test_beyond_a_door_the_way_does_not_turn_back(far: float) -> None:
    # The goal lies beside the wall that the door is in: going on to a mark means coming back.
    start, goal = Placed(1.5, 1.0), Placed(far, 3.35)
    places = way(plan(ROOMS, start, goal), start)
    for a, b, c in zip(places, places[1:], places[2:], strict=False):
        turn = abs(wrap(direction(b, c) - direction(a, b)))
        assert turn <= math.radians(91)


def test_an_undeclared_door_is_found_by_the_grid() -> None:
    world = msgspec.structs.replace(ROOMS, doors=ROOMS.doors[:1])
    assert plan(world, START, GOAL).clearance_m >= 0.3


def test_without_rooms_too_it_raises_an_error_without_a_path() -> None:
    closed = msgspec.structs.replace(OPEN, walls=(*OPEN.walls, (5.0, 3.0, 5.0, 4.5)))
    with pytest.raises(PlanError, match=r"no way from \(3\.4, 0\.6\) to \(7\.4, 0\.7\)"):
        plan(closed, START, GOAL)


@given(st.integers(2, 6), st.data())
def test_the_route_is_the_shortest_of_all(count: int, data: st.DataObject) -> None:
    """Rooms in a row, joined by random doors: every chain without repetition is tried."""
    rooms = tuple(Room(str(i), i * 4.0, 0.0, i * 4.0 + 4.0, 9.0) for i in range(count))
    heights = st.lists(st.floats(0.5, 8.5), min_size=1, max_size=3)
    doors = tuple(
        Door(f"{i}{j}", str(i), str(i + 1), i * 4.0 + 4.0, y)
        for i in range(count - 1)
        for j, y in enumerate(data.draw(heights))
    )
    world = World("row", (), (0.0, 0.0, 4.0 * count, 9.0), rooms=rooms, doors=doors)
    start, goal = Placed(1.0, 4.0), Placed(4.0 * count - 1.0, 5.0)
    chains = [[start]]
    for i in range(count - 1):
        exits = [Placed(door.x, door.y) for door in doors if door.room_a == str(i)]
        chains = [[*chain, place] for chain in chains for place in exits]
    best = min(sum(distance(a, b) for a, b in pairwise([*chain, goal])) for chain in chains)
    legs = route(world, start, goal)
    assert legs is not None
    named = {door.name: Placed(door.x, door.y) for door in doors}
    driven = [start, *(named[leg.leave] for leg in legs if leg.leave), goal]
    assert sum(distance(a, b) for a, b in pairwise(driven)) == pytest.approx(best)


def test_the_axis_of_a_door_is_square_to_its_wall() -> None:
    door, between = ROOMS.doors[0], SHORT_CUT.doors[2]
    assert axis(ROOMS, door, "hall") == (0.0, 1.0)
    assert axis(ROOMS, door, "A") == (0.0, -1.0)
    assert axis(SHORT_CUT, between, "B") == (1.0, 0.0)


@pytest.fixture(scope="module")
def pioneer() -> P2osRobot:
    text = (files("armadico.configs") / "robots" / "pioneer-2dx.toml").read_text()
    return msgspec.convert(tomllib.loads(text), P2osRobot)


def test_at_top_speed_both_motors_take_their_whole_supply(pioneer: P2osRobot) -> None:
    """12 V gives 1.676 m/s, where a motor draws (12 - t_r K_E v / R) / R_a."""
    speed = 1.676
    back_emf = 19.7 * 0.023 * speed / 0.0825
    assert motor_power(pioneer, speed) == pytest.approx(2 * 12 * (12 - back_emf) / 0.71, rel=0.01)


PACE = Pace(v_m_s=0.5, turn_s=0.0, ends_s=0.0)


def straight(length: float) -> list[Placed]:
    return [Placed(0.0, 0.0, 0.0), Placed(length, 0.0, 0.0)]


def test_energy_grows_with_the_way(
    pioneer: P2osRobot,
) -> None:
    one, two = (energy(straight(length), pioneer, PACE) for length in (6.0, 12.0))
    start = 0.5 * pioneer.body.mass_kg * 0.5**2
    assert two.joules - start == pytest.approx(2 * (one.joules - start))
    assert two.seconds == pytest.approx(24.0)
    watts = motor_power(pioneer, 0.5) + pioneer.battery.idle_a * 11.45
    assert one.joules == pytest.approx(12.0 * watts + start)


def test_creeping_takes_more_than_cruising_because_of_the_electronics(
    pioneer: P2osRobot,
) -> None:
    way = straight(12.0)
    assert energy(way, pioneer, PACE, 0.1).joules > energy(way, pioneer, PACE, 0.4).joules
    full, low = (energy(way, pioneer, PACE, volts=volts).joules for volts in (12.9, 10.0))
    assert full - low == pytest.approx(24.0 * pioneer.battery.idle_a * 2.9)


def test_turning_costs_its_time_and_the_motors_on_the_spot(pioneer: P2osRobot) -> None:
    pace = Pace(v_m_s=0.5, turn_s=2.0, ends_s=5.0, turn_rad_s=0.5)
    corner = [*straight(6.0), Placed(6.0, 6.0, 0.0)]  # there to the left, and back at the end
    bent, even = energy(corner, pioneer, pace), energy(straight(12.0), pioneer, pace)
    assert even.seconds == pytest.approx(24.0 + 5.0)
    assert bent.seconds == pytest.approx(24.0 + 5.0 + 2.0 * math.pi)
    on_the_spot = motor_power(pioneer, 0.0, 0.5)
    assert 0.0 < on_the_spot < motor_power(pioneer, 0.2)
    idle = 2.0 * math.pi * pioneer.battery.idle_a * 11.45
    assert bent.joules - even.joules == pytest.approx(idle + math.pi / 0.5 * on_the_spot)


def test_standing_costs_the_motors_nothing_and_a_way_has_an_end(pioneer: P2osRobot) -> None:
    assert motor_power(pioneer, 0.0) == 0.0
    with pytest.raises(ValueError, match="at least 2"):
        energy(straight(1.0)[:1], pioneer, PACE)
