"""The three use cases of thesis 3.2, by name, in the building of 3.6.1."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import pytest

from armadico.agents.missions.messages import Board, ChargeState, ChargeStatus, MissionEnd
from armadico.config.scenarios import Battery
from armadico.mobile.messages import Planned, Truth
from tests.missions.building import Building, text

THERE_AND_BACK: Final = text('do = "move", to = "R1"', 'do = "move", to = "hall"')
SMALL_AH: Final = 0.1
"""A battery that is charged in a minute."""

Demands = Iterator[tuple[str, bool]]
"""Requirements, and whether each was met."""


def accepting(building: Building) -> Demands:
    """Use case 1, accepting a new robot mission: the more urgent one is done first."""
    first = building.taken(THERE_AND_BACK, 0.5, "first")
    building.until(lambda: building.mission(first).course.elapsed > 4.0)
    waits = building.taken(text('do = "take-photo"'), 0.2, "waits")
    yield "a less urgent mission waits", building.mission(waits).state is MissionEnd.QUEUED
    urgent = building.taken(text('do = "move", to = "R2"', 'do = "take-photo"'), 0.9, "urgent")
    building.run(1.0)
    begun = building.mission(first).course
    suspended = building.mission(first).state is MissionEnd.SUSPENDED
    active = building.mission(urgent).state is MissionEnd.ACTIVE
    yield "a more urgent one suspends the active mission", suspended and active
    building.until(lambda: building.ended(urgent), 300.0)
    stood = building.mission(first).course.elapsed - begun.elapsed < 1.0
    yield "no time counts for a suspended mission", stood
    building.until(lambda: building.ended(first), 300.0)
    yield "it goes on, and does all its steps", building.steps(first) == ["move(R1)", "move(hall)"]
    building.until(lambda: building.ended(waits), 60.0)
    ends = {m.state for m in building.board.missions} if building.board else set()
    yield "all are done", ends == {MissionEnd.DONE}
    order = [m.name for board in building.heard(Board) for m in board.missions if m.doing]
    turns = [*dict.fromkeys(order)], "first" in order[order.index("urgent") :]
    yield "in the order of their urgency", turns == (["first", "urgent", "waits"], True)


def planning(building: Building) -> Demands:
    """Use case 2, planning a robot movement: the charger warns, and the robot charges first."""
    number = building.taken(THERE_AND_BACK, 1.0)
    building.until(lambda: any("the energy will not do" in line for line in building.logs), 20.0)
    warning = next(line for line in building.logs if "the energy will not do" in line)
    stated = "kJ are left" in warning and "kJ are needed" in warning
    yield "the charger states the remaining and the needed energy", stated
    ways = {planned.plan.energy for planned in building.heard(Planned)}
    yield "it has planned the way, and on to a dock", len(ways) >= 2
    building.until(lambda: building.doing(number).startswith("dock"), 5.0)
    ahead = building.mission(number).ahead == ("move(R1)", "move(hall)")
    yield "the mission charges first, and keeps its steps", ahead
    building.until(lambda: building.ended(number), 900.0)
    steps = building.steps(number)
    yield "then it does them", steps == ["dock", "move(R1)", "move(hall)"]
    states = {status.state for status in building.heard(ChargeStatus)}
    yield "it was charged in between", ChargeState.CHARGING in states


def moving(building: Building) -> Demands:
    """Use case 3, moving the robot: the charger takes the trajectory on the way, and returns it."""
    rows = 'do = "move", to = "R11"', 'do = "move", to = "R2"'
    number = building.taken(text(*rows, above='energy = "risk"'), 0.2)
    building.until(lambda: building.ended(number), 1800.0)
    yield "the mission is done", building.mission(number).state is MissionEnd.DONE
    yield "all its steps are", building.steps(number) == ["move(R11)", "move(R2)"]
    back = ["mission-planning", "battery-charger", "mission-planning"]
    held = building.who_had("trajectory")[:3] == back
    yield "the charger takes the trajectory, and returns it", held
    wheels = {"goto", "gothrough"} <= {*building.who_had("wheels")}
    yield "goto and gothrough share the wheels", wheels


Case = Callable[[Building], Demands]
CASES: Final[dict[str, tuple[Case, Battery]]] = {
    "1, accepting a new robot mission": (accepting, Battery()),
    "2, planning a robot movement": (planning, Battery(0.3, SMALL_AH)),
    "3, moving the robot": (moving, Battery(0.8, SMALL_AH)),
}
"""By name: the requirements, and the battery at the start."""


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_use_case(name: str) -> None:
    case, battery = CASES[name]
    building = Building(battery=battery)
    touched: list[int] = []
    building.mesh.watch(lambda _k, m, _t: touched.append(m.collisions), Truth)  # type: ignore[attr-defined]
    demands = list(case(building))
    assert [what for what, so in demands if not so] == []
    assert len(demands) > 3
    assert touched
    assert not any(touched)


@pytest.mark.long
def test_use_case_2_the_mission_may_change_its_task_or_run_the_risk() -> None:
    rows = ('do = "move", to = "R1", else = [{ do = "wait", seconds = 1 }]',)
    for energy, done in (("fail", "wait(1.0)"), ("risk", "move(R1)")):
        building = Building(battery=Battery(charge=0.45, capacity_ah=0.1))
        number = building.taken(text(*rows, above=f'energy = "{energy}"'), 1.0)
        building.until(lambda b=building, n=number: b.ended(n), 900.0)  # type: ignore[misc]
        assert any("the energy will not do" in line for line in building.logs)
        assert building.steps(number) == [done]
