"""The three use cases of thesis 3.2, by name: what `armadico experiment use-cases` asks for."""

from __future__ import annotations

import pytest

from armadico.config.scenarios import Battery
from armadico_tools.building import Building, text
from armadico_tools.experiments import use_cases
from armadico_tools.experiments.use_cases import CASES, Came, as_table, come, is_met


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_use_case(name: str) -> None:
    came = come((name, "ideal", 1))
    assert not came.fault
    assert [what for what, so in came.demands if not so] == []
    assert len(came.demands) > 3


@pytest.mark.long
def test_use_case_2_the_mission_may_change_its_task_or_run_the_risk() -> None:
    rows = ('do = "move", to = "R1", else = [{ do = "wait", seconds = 1 }]',)
    for energy, done in (("fail", "wait(1.0)"), ("risk", "move(R1)")):
        building = Building(battery=Battery(charge=0.45, capacity_ah=0.1))
        number = building.taken(text(*rows, above=f'energy = "{energy}"'), 1.0)
        building.until(lambda b=building, n=number: b.ended(n), 900.0)  # type: ignore[misc]
        assert any("the energy will not do" in line for line in building.logs)
        assert building.steps(number) == [done]


def test_what_is_waited_for_in_vain_is_a_fault_and_what_came_before_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def case(building: Building) -> use_cases.Demands:
        yield "something", True
        building.until(lambda: False, 1.0)
        yield "never", True

    monkeypatch.setitem(CASES, "1, of nothing", (case, Battery()))
    came = come(("1, of nothing", "ideal", 1))
    assert came.fault
    assert not is_met(came)
    assert came.demands == (("something", True), ("nothing is touched", True))


def test_the_table_counts_each_demand_and_the_whole() -> None:
    name = next(iter(CASES))
    found = [
        Came(name, "ideal", 1, 60.0, (("a", True), ("b", True))),
        Came(name, "ideal", 2, 70.0, (("a", True), ("b", False))),
        Came(name, "real", 1, 80.0, (("a", True),), "b was waited for"),
    ]
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in as_table(found).split("\n")
    ]
    assert [name, "a", "2 of 2", "1 of 1"] in rows
    assert [name, "b", "1 of 2", "0 of 1"] in rows
    assert [name, "**all of it**", "**1 of 2**, 60 s", "**0 of 1**"] in rows
