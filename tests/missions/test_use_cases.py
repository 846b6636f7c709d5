"""The three use cases of thesis 3.2, by name."""

from __future__ import annotations

from armadico.config.scenarios import Battery
from armadico.core.messages import (
    Board,
    ChargeState,
    ChargeStatus,
    MissionEnd,
    Planned,
)
from tests.missions.building import Building, text

THERE_AND_BACK = text('do = "move", to = "R1"', 'do = "move", to = "hall"')
LOW = Battery(charge=0.3, capacity_ah=0.1)
"""Small, so that charging takes a minute."""


def test_use_case_1_accepting_a_new_robot_mission() -> None:
    """The interface agent proposes it; the more urgent one is done first, and both are told of."""
    building = Building()
    first = building.taken(THERE_AND_BACK, 0.5, "first")
    building.until(lambda: building.mission(first).course.elapsed > 4.0)
    assert building.mission(first).state is MissionEnd.ACTIVE

    waits = building.taken(text('do = "take-photo"'), 0.2, "waits")
    assert building.mission(waits).state is MissionEnd.QUEUED

    urgent = building.taken(text('do = "move", to = "R2"', 'do = "take-photo"'), 0.9, "urgent")
    building.run(1.0)
    assert building.mission(first).state is MissionEnd.SUSPENDED
    assert building.mission(urgent).state is MissionEnd.ACTIVE
    begun = building.mission(first).course

    building.until(lambda: building.ended(urgent), 120.0)
    assert building.mission(urgent).state is MissionEnd.DONE
    assert building.mission(first).course.elapsed - begun.elapsed < 1.0
    building.until(lambda: building.ended(first), 200.0)
    assert building.steps(first) == ["move(R1)", "move(hall)"]
    building.until(lambda: building.ended(waits), 30.0)
    ends = {m.name: m.state for m in building.board.missions} if building.board else {}
    assert set(ends.values()) == {MissionEnd.DONE}
    order = [m.name for board in building.heard(Board) for m in board.missions if m.doing]
    assert [*dict.fromkeys(order)] == ["first", "urgent", "waits"]
    assert order[order.index("urgent") :].index("first") > 0


def test_use_case_2_planning_a_robot_movement() -> None:
    """The charger is told the way's energy, looks at the way on to a dock, and warns."""
    building = Building(battery=LOW)
    number = building.taken(THERE_AND_BACK, 1.0)
    building.until(lambda: any("the energy will not do" in line for line in building.logs), 20.0)
    (warning,) = (line for line in building.logs if "the energy will not do" in line)
    assert "kJ are left" in warning
    assert "kJ are needed" in warning
    ways = [planned.plan for planned in building.heard(Planned)]
    assert len({plan.energy for plan in ways}) >= 2  # to the goal, and from there to the dock
    building.until(lambda: building.doing(number).startswith("dock"), 1.0)
    assert building.mission(number).ahead == ("move(R1)", "move(hall)")
    building.until(lambda: building.ended(number), 900.0)
    assert building.steps(number) == ["dock", "move(R1)", "move(hall)"]
    assert ChargeState.CHARGING in {status.state for status in building.heard(ChargeStatus)}


def test_use_case_2_the_mission_may_change_its_task_or_run_the_risk() -> None:
    rows = ('do = "move", to = "R1", else = [{ do = "wait", seconds = 1 }]',)
    for energy, done in (("fail", "wait(1.0)"), ("risk", "move(R1)")):
        building = Building(battery=Battery(charge=0.45, capacity_ah=0.1))
        number = building.taken(text(*rows, above=f'energy = "{energy}"'), 1.0)
        building.until(lambda b=building, n=number: b.ended(n), 900.0)  # type: ignore[misc]
        assert any("the energy will not do" in line for line in building.logs)
        assert building.steps(number) == [done]


def test_use_case_3_moving_the_robot() -> None:
    """Goto, gothrough and avoid share the wheels; the charger takes the trajectory on the way."""
    building = Building(battery=Battery(charge=0.8, capacity_ah=0.1))
    number = building.taken(
        text('do = "move", to = "R11"', 'do = "move", to = "R2"', above='energy = "risk"'), 0.2
    )
    building.until(lambda: building.ended(number), 1800.0)
    assert building.mission(number).state is MissionEnd.DONE
    assert building.steps(number) == ["move(R11)", "move(R2)"]
    held = building.who_had("trajectory")
    assert held[:3] == ["mission-planning", "battery-charger", "mission-planning"]
    assert {"goto", "gothrough"} <= {*building.who_had("wheels")}
