"""The executive commits to one path at a time."""

from __future__ import annotations

from armadico.agents.rivals.arbiter import Wish
from armadico.agents.rivals.executive import Executive
from armadico.core.agent import Identity
from armadico.core.messages import Cycle
from armadico.mobile.messages import Point, Way, Waypoint

MISSION = Way(1, (Waypoint(5.0, 0.0, 0.0), Waypoint(9.0, 0.0, 0.0)), Point(0.0, 0.0))
DOCK = Way(2, (Waypoint(0.0, 5.0, 0.0),), Point(0.0, 0.0))


class Run:
    def __init__(self) -> None:
        self.executive = Executive(Identity("executive-1"))
        self.number = 0

    def leads(self, after_s: float = 0.5, **wishes: tuple[float, Way, bool]) -> tuple[str, Way]:
        """Return whose path is driven, and the path."""
        self.number += 1
        self.executive.kernel.now += after_s
        given = {name: Wish(f"{name}-1", *wish) for name, wish in wishes.items()}
        decision = self.executive.decide(given, Cycle(1, self.number))
        (name,) = decision.shares
        return name, decision.action


def mission(utility: float = 0.5, way: Way = MISSION) -> tuple[float, Way, bool]:
    return utility, way, False


def dock(utility: float, critical: bool = False, way: Way = DOCK) -> tuple[float, Way, bool]:
    return utility, way, critical


def test_a_better_bid_does_not_interrupt_and_an_end_or_a_critical_bid_does() -> None:
    run = Run()
    assert run.leads(mission=mission(), dock=dock(0.4))[0] == "mission"
    assert run.leads(mission=mission(), dock=dock(0.9))[0] == "mission", "ballots would change"
    assert run.leads(dock=dock(0.9))[0] == "dock", "the mission has succeeded"
    assert run.leads(mission=mission(0.99), dock=dock(0.2))[0] == "dock"
    run = Run()
    run.leads(mission=mission())
    assert run.leads(mission=mission(), dock=dock(0.3, critical=True))[0] == "dock"


def test_a_method_without_progress_has_failed_and_is_left_for_another() -> None:
    run, fails_s = Run(), Executive.parameters().fails_s  # type: ignore[attr-defined]
    run.leads(mission=mission(), dock=dock(0.1))
    run.leads(mission=mission(), dock=dock(0.1))
    onward = Way(1, MISSION.waypoints, MISSION.start, leg=1)
    assert run.leads(fails_s - 1.0, mission=mission(), dock=dock(0.1))[0] == "mission"
    assert run.leads(mission=mission(way=onward), dock=dock(0.1))[0] == "mission"
    assert run.leads(fails_s - 1.0, mission=mission(way=onward), dock=dock(0.1))[0] == "mission"
    assert run.leads(2.0, mission=mission(way=onward), dock=dock(0.1))[0] == "dock"
    assert run.leads(mission=mission(0.9, onward))[0] == "mission", "there is no other"


def test_a_robot_that_is_to_stand_has_not_failed() -> None:
    run = Run()
    stands = Way(3, (Waypoint(0.0, 5.0, 0.0),), Point(0.0, 5.0))
    run.leads(dock=dock(0.9, way=stands))
    for _ in range(5):
        assert run.leads(50.0, dock=dock(0.9, way=stands), mission=mission())[0] == "dock"


def test_the_next_path_is_joined_to_the_driven_one() -> None:
    run = Run()
    run.leads(mission=mission())
    joins = Way(4, (Waypoint(5.0, 5.0, 0.0),), Point(5.0, 0.0))
    _, way = run.leads(dock=dock(0.9, way=joins))
    assert [(w.x, w.y) for w in way.waypoints] == [(5.0, 0.0), (5.0, 5.0)]
