"""What the auditor recomputes: the reflex, speeds by the odometry, and readings by the map."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, inf, pi, sin

import pytest
from msgspec import structs

from armadico.bridge.reflex import Reflex
from armadico.config.profile import load_profile
from armadico.config.worlds import World
from armadico.core.judgement import Answer
from armadico.core.messages import Cycle, Description, Message, Point, RobotState, Twist
from armadico.mobile.geometry import Pose2, compose
from armadico.mobile.messages import Echo, Pose, Sonar, Trajectory, Waypoint
from armadico.observe.audit.auditor import Auditor
from armadico.observe.audit.chart import Chart
from armadico.observe.audit.paths import Clears
from armadico.observe.audit.poses import Rated
from armadico.observe.audit.promises import Promise
from armadico.observe.audit.reflexes import Reflexes
from armadico.observe.audit.rules import Rule
from armadico.observe.audit.walls import Compared

ROBOT = "pioneer-2dx"
SURE = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
ROOM = [
    *((-2.0, -1.5, 2.0, -1.5), (2.0, -1.5, 2.0, 1.5)),
    *((2.0, 1.5, -2.0, 1.5), (-2.0, 1.5, -2.0, -1.5)),
]
RING = (0.0, 0.6, -0.6, pi)
NOT_DRIVEN = Twist(0.0, 0.0)


def described(robot: str = ROBOT) -> Description:
    body = load_profile(ROBOT).body
    size = body.front_m, body.rear_m, body.width_m / 2
    return Description(robot, 0.1, *size, 0.6, 1.0, 0.3, 0.6, 1.0, 1.0, 0.3, 2.0, cone=0.5)


def auditor_of(rule: type[Rule], robot: str = ROBOT) -> Auditor:
    auditor = Auditor([rule], v_max=inf)
    auditor.update(0.0, "", described(robot))
    return auditor


def state(
    number: int,
    place: Pose2 = (0.0, 0.0, 0.0),
    speeds: tuple[float, float] = (0.0, 0.0),
    ordered: Twist = NOT_DRIVEN,
    admitted: Twist = NOT_DRIVEN,
) -> RobotState:
    cycle = Cycle(1, number)
    return RobotState(cycle, *place, *speeds, 12, True, False, ordered=ordered, admitted=admitted)


# The reflex ---------------------------------------------------------------------------------------

Cap = Callable[[Reflex, float], float]


def before_a_wall(cap: Cap, robot: str = ROBOT, received: float = inf) -> Auditor:
    """A robot that stands 0.5 m before a wall, and is then ordered to drive on.

    From cycle `received` on its readings are not received.
    """
    auditor, reflex = auditor_of(Reflexes, robot), Reflex(load_profile(ROBOT))
    echoes = tuple(
        Echo(*each.place, 0.5 if abs(each.place[2]) < 0.3 else None)
        for each in load_profile(ROBOT).sonar.sonars  # type: ignore[union-attr]
    )
    ordered = admitted = NOT_DRIVEN
    for number in range(260):
        now = 0.1 * number
        auditor.update(now, "", described(robot))
        auditor.update(now, "", state(number, ordered=ordered, admitted=admitted))
        if number < received:
            auditor.update(now, "", Sonar(Cycle(1, number), 5.0, echoes))
        reflex.update(echoes, (0.0, 0.0, 0.0), (0.0, 0.0), now, None, (admitted.v, 0.0))
        if number > 220:
            ordered, admitted = Twist(0.6, 0.0), Twist(cap(reflex, 0.6), 0.0)
    return auditor


@pytest.mark.parametrize(
    ("cap", "found"),
    [
        (lambda reflex, v: reflex.cap(v, 0.0)[0], []),
        (lambda _, v: v, [Promise.EARNED]),
        (lambda _reflex, _v: 0.0, [Promise.SPEED]),
    ],
)
def test_what_the_reflex_forbids_is_not_let_through_nor_held_back_what_it_admits(
    cap: Cap, found: list[Promise]
) -> None:
    assert [each.promise for each in before_a_wall(cap).findings] == found


@pytest.mark.parametrize("received", [0, 200])
def test_readings_that_are_not_received_accuse_no_reflex(received: int) -> None:
    auditor = before_a_wall(lambda reflex, v: reflex.cap(v, 0.0)[0], received=received)
    assert auditor.findings == []
    (found,) = auditor.report()
    assert found.answer is Answer.UNKNOWN
    assert "Sonar" in found.what


def after_an_echo(
    reflex_caps: bool,
    since: int = 0,
    silent: range = range(0),
    drives: range = range(0),
    lost: range = range(0),
    unknown: range = range(0),
) -> Auditor:
    """The auditor of a robot that is ordered ahead 20 s after it sensed something there.

    Its sonars ahead have read nothing since. Without its reflex it stands. The auditor receives
    messages from cycle `since` on, but no readings of `lost` and no states of `unknown`. No sonar
    fires in the cycles `silent`. In `drives` the robot goes ahead by 0.05 m each, with all sonars,
    and its reflex is not asked.
    """
    ring = load_profile(ROBOT).sonar.sonars  # type: ignore[union-attr]
    about = structs.replace(described(), sensors=("sonar",))
    auditor, reflex = Auditor([Reflexes], v_max=inf), Reflex(load_profile(ROBOT))
    ordered, admitted, x = NOT_DRIVEN, NOT_DRIVEN, 0.0
    for number in range(1, 300):
        now, moved = 0.1 * number, number in drives
        x += 0.05 * moved
        first = number < 5
        echoes = tuple(
            Echo(*each.place, 0.12 if first and abs(each.place[2]) < 0.3 else None)
            for each in ring
            if first or moved or abs(each.place[2]) > 1.0
        )
        echoes = () if number in silent else echoes
        now_is = state(number, (x, 0.0, 0.0), (0.0, 0.0), ordered, admitted)
        said: list[Message] = [about, *([now_is] if number not in unknown else [])]
        said += [Sonar(Cycle(1, number), 5.0, echoes)] if echoes and number not in lost else []
        for message in said if number >= since else ():
            auditor.update(now, "", message)
        reflex.update(echoes, (x, 0.0, 0.0), (0.0, 0.0), now, None, (admitted.v, 0.0))
        if number > 220:
            ordered = Twist(0.3, 0.0)
            admitted = Twist(*reflex.cap(0.3, 0.0)) if reflex_caps else NOT_DRIVEN
    return auditor


@pytest.mark.parametrize("since", [1, 60])
@pytest.mark.parametrize("silent", [range(0), range(70, 76)])
def test_what_the_reflex_remembers_beside_the_robot_holds_it_back_with_reason(
    since: int, silent: range
) -> None:
    assert after_an_echo(reflex_caps=True, since=since, silent=silent).findings == []


def test_a_robot_that_sensed_something_where_readings_were_lost_is_held_back_with_reason() -> None:
    assert after_an_echo(reflex_caps=True, lost=range(1, 5)).findings == []


@pytest.mark.parametrize(
    ("since", "silent"), [(1, range(0)), (1, range(70, 76)), (60, range(0)), (60, range(70, 76))]
)
def test_a_robot_that_has_left_what_it_remembers_is_held_back_without_reason(
    since: int, silent: range
) -> None:
    auditor = after_an_echo(False, since, silent, range(160, 210))
    assert [each.promise for each in auditor.findings] == [Promise.SPEED]


@pytest.mark.parametrize(
    ("since", "lost", "unknown"),
    [
        (60, range(0), range(0)),
        (1, range(60, 61), range(0)),
        (1, range(100, 104), range(0)),
        (1, range(0), range(60, 61)),
    ],
)
def test_where_it_may_remember_what_was_not_received_low_speeds_are_not_checked(
    since: int, lost: range, unknown: range
) -> None:
    """A sound robot was accused of SPEED when readings had been lost on the way to the auditor."""
    near = range(200, 215)
    complete = after_an_echo(False, drives=near)
    assert [each.promise for each in complete.findings] == [Promise.SPEED]
    assert complete.report()[0].answer is Answer.YES
    auditor = after_an_echo(False, since, drives=near, lost=lost, unknown=unknown)
    assert auditor.findings == []
    (found,) = auditor.report()
    assert found.answer is Answer.UNKNOWN
    assert "lower than its reflex admits" in found.what


def test_the_reflex_of_a_robot_without_a_profile_at_hand_is_unknown() -> None:
    auditor = before_a_wall(lambda _, v: v, robot="of-another-maker")
    assert auditor.findings == []
    assert "of-another-maker" in auditor.report()[0].what


# Speeds -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("v", "w", "found"),
    [(1.0, 1.0, []), (1.0, 0.5, [Promise.ODOMETRY]), (0.6, 1.0, [Promise.ODOMETRY])],
)
def test_the_odometry_turns_and_goes_on_as_fast_as_is_measured(
    v: float, w: float, found: list[Promise]
) -> None:
    auditor, place = auditor_of(Rated), (0.0, 0.0, 0.0)
    for number in range(150):
        auditor.update(0.1 * number, "", state(number, place, (0.4 * v, 0.5 * w)))
        place = compose(place, (0.04, 0.0, 0.05))
    assert [each.promise for each in auditor.findings] == found


# Readings -----------------------------------------------------------------------------------------


def read(
    place: Callable[[float], Pose2],
    late_s: float = 0.0,
    off_m: float = 0.0,
    deaf: tuple[float, ...] = (),
    gone_s: float = inf,
) -> list[str]:
    """What is found in readings of a room, of a robot whose place in it depends on the time.

    From `gone_s` on the room's walls are gone, which the map does not know.
    """
    auditor, chart = auditor_of(Compared), Chart(ROOM)
    auditor.chart(ROOM)

    def echo(bearing: float, now: float) -> Echo:
        sight = chart.ahead(*compose(place(now - late_s), (0.0, 0.0, bearing)))
        heard = sight is not None and sight.square > 0.9 and bearing not in deaf and now < gone_s
        return Echo(0.0, 0.0, bearing, sight.far if heard and sight is not None else None)

    for number in range(600):
        now, cycle = 0.1 * number, Cycle(1, number)
        x, y, theta = place(now)
        said: list[Message] = [
            state(number, (x, y, theta), (0.3, 0.0)),
            Pose(cycle, x + off_m, y, theta, SURE),
            Sonar(cycle, 5.0, tuple(echo(bearing, now) for bearing in RING)),
        ]
        for message in said:
            auditor.update(now, "", message)
    return [each.what for each in auditor.findings]


def to_and_fro(now: float) -> Pose2:
    return 0.8 * sin(0.5 * now), 0.0, 0.0


def around(now: float) -> Pose2:
    return 0.2 * cos(now), 0.2 * sin(now), 0.5 * now


def test_readings_that_fit_the_map_of_before_are_late() -> None:
    assert "0.4 s before" in " ".join(read(to_and_fro, late_s=0.4))
    assert read(to_and_fro, late_s=0.1) == []


def test_a_pose_that_is_off_makes_no_reading_late() -> None:
    assert read(lambda now: (-1.0 + 0.15 * (now % 10.0), 0.0, 0.0), off_m=-0.1) == []


def test_a_sonar_that_misses_walls_which_others_read_is_deaf() -> None:
    assert "at 0 degrees" in " ".join(read(around, deaf=(0.0,)))
    assert read(around) == []
    assert read(around, deaf=RING) == [], "no other one reads these walls: they may be of foam"
    assert read(around, gone_s=30.0) == [], "walls that are gone convict no sensor"


# Paths --------------------------------------------------------------------------------------------


def found_on(walls: list[tuple[float, float, float, float]], y: float) -> list[Promise]:
    """What is found in a path along a corridor of 3 m at so far to the left of its middle."""
    sides = [(0.0, -1.5, 10.0, -1.5), (0.0, 1.5, 10.0, 1.5), *walls]
    world = World("corridor", tuple(sides), (0.0, -1.5, 10.0, 1.5))
    auditor = auditor_of(Clears)
    auditor.chart(world.outlines, world)
    auditor.update(0.0, "", Pose(Cycle(1, 1), 1.0, 0.0, 0.0, SURE))
    auditor.update(0.0, "", Sonar(Cycle(1, 1), 5.0, ()))
    way = tuple(Waypoint(*at, 0.0) for at in ((3.0, y), (7.0, y), (9.0, 0.0)))
    auditor.update(0.1, "", Trajectory(1, 1, way, Point(1.0, 0.0), planned=True))
    return [each.promise for each in auditor.findings]


def test_a_path_along_a_wall_is_found_if_the_map_has_a_wider_one() -> None:
    narrow = [(4.0, -1.5, 4.0, 1.05), (6.0, -1.5, 6.0, 1.05)]
    assert found_on([], y=1.3) == [Promise.PATH]
    assert found_on([], y=0.5) == []
    assert found_on(narrow, y=1.3) == [], "there is no wider one"
