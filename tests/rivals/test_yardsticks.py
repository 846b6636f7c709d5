"""Each yardstick drives alone, and has the feature that its authors rely on."""

from __future__ import annotations

from math import cos, hypot, sin
from random import Random
from typing import TypeVar

import pytest
from msgspec.structs import replace

from armadico.agents.rivals.yardsticks import (
    Dwa,
    DwaParameters,
    PurePursuit,
    Yardstick,
    best,
    curvature,
)
from armadico.config.moving import Moving
from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.core.agent import Identity
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle, Description, Point, RobotState
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Pose, Waypoint
from armadico.mobile.motion import Body
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.route import Route
from armadico.mobile.safety import Scene
from armadico.observe.measures import Result

ROBOT = Description(
    "robot",
    0.1,
    front=0.2,
    rear=0.2,
    half_width=0.2,
    v_max=1.0,
    w_max=1.5,
    v_accel=0.3,
    v_decel=0.6,
    w_accel=1.7,
    w_decel=1.7,
    silence_s=0.3,
    watchdog_s=0.5,
)
BODY = Body.of(ROBOT)
NOW = Cycle(1, 1)
MOST = (0.75, 1.0)
MARGIN = DwaParameters().safety.margin_m


A = TypeVar("A", bound=Yardstick)


def standing(agent: A, v: float = 0.0, goal: tuple[float, float] = (5.0, 0.0)) -> A:
    """At the origin, heading along x."""
    agent.on_description(ROBOT)
    state = RobotState(NOW, 0.0, 0.0, 0.0, v, 0.0, 12.0, True, False)
    agent.kernel.newest[RobotState] = state
    agent.route = Route((Waypoint(*goal, 0.0),))
    return agent


def speeds(agent: Yardstick, *points: Point) -> tuple[float, float]:
    obstacles = Obstacles(NOW, points[0] if points else None, None, None, None, points)
    return agent.drive(Pose(NOW, 0.0, 0.0, 0.0), obstacles, agent.most[0])


# DWA ----------------------------------------------------------------------------------------------


def scattered(rng: Random) -> Scene:
    """A robot that drives, among points that are farther away than the margin."""
    points = [Point(rng.uniform(-1.0, 2.0), rng.uniform(-1.5, 1.5)) for _ in range(6)]
    outside = [p for p in points if BODY.outline.clearance(p.x, p.y) > MARGIN]
    return Scene(BODY, (rng.uniform(0.0, 0.6), rng.uniform(-0.5, 0.5)), outside)


def least_clearance(scene: Scene, v: float, w: float) -> float:
    """The least distance to a point, m, while it drives on and then brakes on the same arc."""
    way, least, steps = BODY.stopping_distance(v), 1e9, 200
    for step in range(steps + 1):
        along = way * step / steps
        turn = along * w / v
        x, y = (along, 0.0) if w == 0.0 else (v / w * sin(turn), v / w * (1.0 - cos(turn)))
        for p in scene.points:
            dx, dy = p.x - x, p.y - y
            seen = cos(turn) * dx + sin(turn) * dy, cos(turn) * dy - sin(turn) * dx
            least = min(least, BODY.outline.clearance(*seen))
    return least


def test_dwa_never_chooses_speeds_from_which_it_cannot_stop_before_an_obstacle() -> None:
    rng, drives, fastest_would_touch = Random("scenes"), 0, 0
    for _ in range(300):
        scene = scattered(rng)
        chosen = best(scene, Point(2.0, rng.uniform(-1.0, 1.0)), MOST, DwaParameters())
        v, w = chosen or (0.0, 0.0)
        if v > 0.0:
            drives += 1
            assert least_clearance(scene, v, w) >= MARGIN - 1e-3
        fast = min(scene.measured[0] + 0.25 * BODY.v_accel, MOST[0])
        fastest_would_touch += least_clearance(scene, fast, scene.measured[1]) < MARGIN
    assert drives > 100
    assert fastest_would_touch > 30, "there was something to stop for"


def test_dwa_chooses_among_speeds_that_its_ramps_reach() -> None:
    rng, window = Random("window"), DwaParameters().window_s
    for _ in range(100):
        scene = scattered(rng)
        chosen = best(scene, Point(2.0, 0.0), MOST, DwaParameters())
        if chosen is None:
            continue
        v, w = chosen
        least, most = -BODY.v_decel * window - 1e-9, BODY.v_accel * window + 1e-9
        assert least <= v - scene.measured[0] <= most
        assert abs(w - scene.measured[1]) <= BODY.w_accel * window + 1e-9


def test_dwa_rotates_away_from_a_wall_before_which_it_can_drive_on_no_arc_until_it_can() -> None:
    agent = standing(Dwa(Identity("dwa-1")))
    wall = [Point(0.28, 0.05 * n) for n in range(-20, 16)]
    assert best(Scene(BODY, (0.0, 0.0), wall), Point(2.0, 0.0), MOST, DwaParameters()) is None
    v, w = speeds(agent, *wall)
    assert (v, abs(w)) == (0.0, agent.p.away_w)
    agent.kernel.now += 2.0
    assert speeds(agent, *wall) == (0.0, -w), "it did not turn: to the other side"
    assert speeds(agent, Point(0.55, 0.0)) == (0.0, -w), "a little way does not end it"
    assert speeds(agent)[0] > 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_dwas_objective_weighs_heading_clearance_and_velocity(side: float) -> None:
    def chosen(to: Point, *points: Point, **weights: float) -> tuple[float, float]:
        only = replace(DwaParameters(heading=0.0, clearance=0.0, velocity=0.0), **weights)
        found = best(Scene(BODY, (0.3, 0.0), points), to, MOST, only)
        assert found is not None
        return found

    assert chosen(Point(1.0, side), heading=1.0)[1] * side > 0.0
    beside = [Point(0.9 + 0.1 * n, side * 0.15) for n in range(3)]
    assert chosen(Point(2.0, 0.0), *beside, heading=0.5, clearance=1.0)[1] * side < 0.0
    assert chosen(Point(2.0, 0.0), velocity=1.0)[0] > 0.3


# Pure pursuit -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("x", "y"), [(1.0, 0.5), (0.4, -0.3), (0.9, 0.0), (0.2, 0.8)])
def test_pure_pursuits_arc_is_tangent_to_the_heading_and_passes_the_point_ahead(
    x: float, y: float
) -> None:
    bend = curvature(Point(x, y))
    assert bend == pytest.approx(2.0 * y / (x * x + y * y))
    if y:
        assert hypot(x, y - 1.0 / bend) == pytest.approx(1.0 / abs(bend)), "on the arc's circle"


def pursuing(goal: tuple[float, float] = (5.0, 0.0)) -> PurePursuit:
    return standing(PurePursuit(Identity("pure-pursuit-1")), 0.5, goal)


def test_pure_pursuit_slows_down_on_a_tight_arc_and_near_an_obstacle_and_stops_for_one_on_it() -> (
    None
):
    v, w = speeds(pursuing())
    assert (v, w) == (pytest.approx(0.75), 0.0)
    v, w = speeds(pursuing(goal=(4.0, 2.5)))
    assert 0.25 <= v < 0.75
    assert w > 0.0
    assert 0.25 <= speeds(pursuing(), Point(0.3, 0.5))[0] < 0.75, "beside its arc"
    assert speeds(pursuing(), Point(0.26, 0.0)) == (0.0, 0.0)
    stops = BODY.stopping_distance(speeds(pursuing(), Point(0.8, 0.0))[0])
    assert stops == pytest.approx(0.8 - 0.2 - MARGIN)


def test_pure_pursuit_turns_on_the_spot_to_a_trajectory_that_is_far_aside() -> None:
    v, w = speeds(pursuing(goal=(-2.0, -2.0)))
    assert v == 0.0
    assert w < 0.0


# Both ---------------------------------------------------------------------------------------------

NAMES = (PurePursuit.name, Dwa.name)


def driven(scenario: Scenario, name: str, *sets: str) -> Result:
    options = Options(
        seed=1, without=("goto", "avoid", "gothrough"), besides=(name,), sets=tuple(sets)
    )
    return Rehearsal(prepared(ideal(scenario), options), options).run()


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_yardstick_drives_alone_to_the_goals_pose_and_touches_nothing(name: str) -> None:
    result = driven(load_scenario("sc4"), name)
    assert result.reached
    assert result.collisions == 0
    assert result.shares == {name: 100.0}


@pytest.mark.parametrize("name", NAMES)
def test_a_yardstick_comes_to_a_box_on_its_way_and_does_not_touch_it(name: str) -> None:
    box = Moving(kind="box", at=(2.5, 0.5))
    result = driven(replace(load_scenario("sc1"), moving=(box,)), name)
    assert result.min_clearance_m is not None
    assert result.min_clearance_m < 0.6, "the box was in its way"
    assert result.collisions == 0
    assert result.reached == (name == Dwa.name), "pure pursuit stands before it"


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ("dwa.window_s=0", "window_s.*> 0"),
        ("dwa.turns=1", "turns.*>= 2"),
        ("dwa.look=1", "look"),
        ("pure-pursuit.turn_first=4", "turn_first.*<= 3"),
    ],
)
def test_wrong_parameters_are_refused(wrong: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        driven(load_scenario("sc4"), wrong.partition(".")[0], wrong)
