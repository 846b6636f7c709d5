"""Where nobody has seen the map: round it, through it by sight, or not at all."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from armadico.agents.driving.goto import Goto, Parameters
from armadico.agents.driving.path_planning import Parameters as PlannersParameters
from armadico.agents.driving.path_planning import PathPlanning
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.planning import Plan, PlanError, plan
from armadico.config.profile import load_profile
from armadico.config.worlds import distance, load_world
from armadico.core.agent import Identity, Question
from armadico.core.messages import Point
from armadico.core.outgoing import Answer
from armadico.mobile.messages import Plan as PlanReply
from armadico.mobile.messages import PlanRequest, Rule, Stretch, Waypoint
from armadico.mobile.motion import Body
from armadico.testing.alone import Alone, drive_to, obstacles
from tests.robot.config.test_unseen import saved
from tests.robot.robots import described

BODY = load_profile("pioneer-2dx").body
ROWS, COLUMNS = 120, 160  # 6 m x 8 m in cells of 5 cm


def room(folder: Path, *parts: tuple[float, float, float, float], grey: int = 205) -> Path:
    """A room of 8 m x 6 m with parts that nobody has seen: x1, y1, x2, y2 in m."""
    pixels = np.full((ROWS, COLUMNS), 254)
    for x1, y1, x2, y2 in parts:
        low, high, left, right = (round(at / 0.05) for at in (y1, y2, x1, x2))
        pixels[ROWS - high : ROWS - low, left:right] = grey
    pixels[:2] = pixels[-2:] = 0
    pixels[:, :2] = pixels[:, -2:] = 0
    return saved(folder, pixels)


def across(file: Path, start: Any = (1.5, 1.5), goal: Any = (6.5, 1.5), **how: Any) -> Plan:
    return plan(load_world(file), Placed(*start), Placed(*goal), BODY, **how)


BLOCK = (3.5, 0.0, 4.5, 4.0)
BAND = (3.5, 0.0, 4.5, 6.0)


@pytest.mark.parametrize("round_corners", [False, True])
@pytest.mark.parametrize("grey", [205, 120])
def test_a_path_leads_round_it(tmp_path: Path, grey: int, round_corners: bool) -> None:
    found = across(room(tmp_path, BLOCK, grey=grey), round_corners=round_corners)
    assert 7.5 < found.length_m < 9.5
    assert found.unseen == ()
    places = [(1.5, 1.5), *((at.x, at.y) for at in found.waypoints)]
    for corner in ((3.5, 4.0), (4.5, 4.0)):  # with as much room for its body as beside a wall
        away = min(distance(*corner, (*a, *b)) for a, b in pairwise(places))
        assert away > BODY.width_m / 2


def test_thin_things_between_the_thresholds_are_gone_round_too(tmp_path: Path) -> None:
    found = across(room(tmp_path, (4.0, 0.0, 4.05, 4.0), grey=120))
    assert found.length_m > 7.0
    assert found.unseen == ()


def test_where_nothing_else_leads_on_the_plan_names_the_part(tmp_path: Path) -> None:
    found = across(room(tmp_path, BAND))
    assert found.length_m == pytest.approx(5.0, abs=0.05)
    assert found.unseen_m == pytest.approx(1.0, abs=0.06)
    ((x1, y1, x2, y2),) = found.unseen
    assert (x1, y1, x2, y2) == pytest.approx((3.5, 1.5, 4.5, 1.5), abs=0.05)


def test_of_two_ways_through_it_the_one_with_less_of_it_is_taken(tmp_path: Path) -> None:
    found = across(room(tmp_path, (3.0, 0.0, 5.0, 4.5), (3.9, 4.5, 4.2, 6.0)))
    assert found.unseen_m == pytest.approx(0.3, abs=0.15)


def test_a_way_as_narrow_as_a_ray_is_no_way_for_the_body(tmp_path: Path) -> None:
    below, above = (3.5, 0.0, 4.5, 1.4), (3.5, 1.6, 4.5, 6.0)
    found = across(room(tmp_path, below, above))
    assert found.unseen_m == pytest.approx(1.0, abs=0.06)


def test_a_goal_that_nobody_has_seen_is_said(tmp_path: Path) -> None:
    found = across(room(tmp_path, (5.5, 0.0, 8.0, 6.0)))
    assert found.unseen_m == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (BAND, r"every path from \(1.5, 1.5\) to \(6.5, 1.5\) leads .* 1.0 m at least"),
        ((5.5, 0.0, 8.0, 6.0), r"the goal \(6.5, 1.5\) is where nobody has seen the map"),
        ((0.0, 0.0, 3.0, 6.0), r"every path from"),  # it stands in the midst of it
    ],
)
def test_what_is_refused_says_why(tmp_path: Path, part: Any, why: str) -> None:
    file = room(tmp_path, part)
    with pytest.raises(PlanError, match=why + r'.*refused \(unseen = "refuse"\)'):
        across(file, refuse=True)
    assert across(file).unseen_m > 0.0


def test_a_robot_may_leave_the_unseen_place_where_it_stands(tmp_path: Path) -> None:
    """A map seldom has the place where the robot stood when it was begun."""
    file = room(tmp_path, (1.2, 1.2, 1.8, 1.8))
    assert across(file, refuse=True).unseen_m == pytest.approx(0.3, abs=0.15)


def test_without_anything_unseen_nothing_is_refused(tmp_path: Path) -> None:
    file = room(tmp_path)
    assert across(file, refuse=True) == across(file)


# The agents --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("of_map", "of_scenario", "of_request", "refused"),
    [
        (None, None, None, False),
        ("refuse", None, None, True),
        ("refuse", "drive", None, False),
        (None, "refuse", None, True),
        (None, "refuse", "drive", False),
        (None, "drive", "refuse", True),
    ],
)
def test_the_nearest_rule_holds(
    tmp_path: Path,
    of_map: Rule | None,
    of_scenario: Rule | None,
    of_request: Rule | None,
    refused: bool,
) -> None:
    file = room(tmp_path, BAND)
    if of_map is not None:
        file.write_text(file.read_text() + f"\nunseen: {of_map}\n")
    parameters = PlannersParameters(world=str(file), unseen=of_scenario)
    planner = PathPlanning(Identity("path-planning-1"), parameters)
    request = PlanRequest(Waypoint(1.5, 1.5, 0.0), Waypoint(6.5, 1.5, 0.0), rule=of_request)
    planner.kernel.on_query(request, Question(1), 1.0)
    (answer,) = (item.message for item in planner.kernel.outbox if isinstance(item, Answer))
    assert isinstance(answer, PlanReply)
    assert bool(answer.refusal) is refused
    assert bool(answer.unseen) is not refused


CORNER = ((5.0, 0.0, 0.0), (5.0, 6.0, 1.57))
HIDES = [Point(0.2, 0.35 + 0.05 * k) for k in range(30)]  # a wall on the left, up to the corner


def limited(x: float, unseen: tuple[Stretch, ...], sensors: tuple[str, ...]) -> float:
    """The speed of a fast robot before a corner, at `x` on its way there, m/s."""
    made = Alone(Goto(Identity("goto-1"), Parameters()), robot=None)
    made.give(replace(described(), v_max=2.0, sensors=sensors))
    made.state()
    made.give(replace(drive_to(*CORNER), unseen=unseen))
    made.pose = (x, 0.0, 0.0)
    made.cycle()
    v, _ = made.agent.limited(2.0, 0.0, obstacles(made.at, *HIDES))
    return v


@pytest.mark.parametrize("sensors", [("laser",), ("sonar",), ("sonar", "laser")])
def test_there_it_can_stop_within_its_sight(sensors: tuple[str, ...]) -> None:
    part = (Stretch(5.0, 1.0, 5.0, 3.0),)
    as_before = limited(4.5, (), sensors)
    found = limited(4.5, part, sensors)
    assert 0.0 < found < 0.8 * as_before
    body = Body.of(replace(described(), v_max=2.0))
    corner = 0.5 + 0.9  # along the path: up to the corner, and what is seen beyond it
    assert body.stopping_distance(found) < corner


def test_far_from_it_the_speed_is_as_ever() -> None:
    far = (Stretch(5.0, 4.5, 5.0, 6.0),)
    assert limited(0.0, far, ("laser",)) == limited(0.0, (), ("laser",))


def test_by_sonar_each_point_may_be_a_wall_across_the_way() -> None:
    part = (Stretch(5.0, 1.0, 5.0, 3.0),)
    assert limited(4.5, part, ("sonar",)) < limited(4.5, part, ("sonar", "laser"))
