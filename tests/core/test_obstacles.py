"""Obstacles of several sensors: all count, and the age is that of the oldest."""

from __future__ import annotations

from armadico.core.messages import Cycle, Description, Point
from armadico.mobile.obstacles import Obstacles, Surroundings, together


def of(*sensors: str) -> Description:
    limits = (0.2, 0.2, 0.2, 1.0, 5.0, 0.3, 0.3, 1.7, 1.7, 0.3, 2.0)
    return Description("robot", 0.1, *limits, sensors=sensors)


def near(sensor: str, number: int, *points: Point) -> Obstacles:
    first = points[0] if points else None
    return Obstacles(Cycle(1, number), first, None, first, None, points, sensor)


def test_of_one_sensor_it_is_its_own() -> None:
    around = Surroundings()
    around.describe(of(*("sonar",)))
    message = near("sonar", 3, Point(1, 0))
    assert around.update(message) is message
    assert not around.counts(near("laser", 3))


def test_before_the_description_any_sensor_is_accepted() -> None:
    around = Surroundings()
    laser, sonar = near("laser", 3), near("sonar", 3)
    assert around.counts(near("laser", 3))
    assert around.update(laser) is laser
    assert around.update(sonar) is sonar


def test_all_are_taken_together_as_old_as_the_oldest() -> None:
    around = Surroundings()
    around.describe(of(*("sonar", "laser")))
    assert around.update(near("laser", 4, Point(0.5, 0))) is None, "there are none by the sonars"
    assert around.missing(lambda cycle: cycle.number >= 3) == "sonar"
    both = around.update(near("sonar", 3, Point(1, 0), Point(2, 0)))
    assert both is not None
    assert both.cycle == Cycle(1, 3)
    assert both.closest == both.left == Point(0.5, 0)
    assert both.front is both.right is None
    assert set(both.points) == {Point(0.5, 0), Point(1, 0), Point(2, 0)}
    assert around.missing(lambda cycle: cycle.number >= 3) == ""
    assert around.missing(lambda cycle: cycle.number >= 4) == "sonar"


def test_a_sensor_that_the_robot_no_longer_has_counts_no_more() -> None:
    around = Surroundings()
    around.describe(of(*("sonar", "laser")))
    around.update(near("sonar", 3, Point(1, 0)))
    around.describe(of(*("laser",)))
    message = near("laser", 4)
    assert around.update(message) is message


def test_nothing_near_by_any_is_nothing_near() -> None:
    assert together(near("sonar", 1), near("laser", 1)).closest is None
