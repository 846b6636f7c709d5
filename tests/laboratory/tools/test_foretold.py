"""Foretold drives: what is drawn, and what is made of their rows."""

from __future__ import annotations

from math import hypot
from pathlib import Path

import msgspec
import pytest

from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core.judgement import Answer
from armadico_tools.experiments import foretold
from armadico_tools.experiments.foretold import (
    FAR_M,
    NEAR_M,
    UNDER_WAY_S,
    Foreteller,
    Task,
    scenario_of,
    tasks,
)
from armadico_tools.experiments.foretold_report import (
    FOUND,
    Foretold,
    bins,
    brier,
    kept,
    summed,
    wilson,
)
from armadico_tools.experiments.runner import Context
from armadico_tools.results import Result, Rows


def row(seed: int, chance: float | None, *, arrived: bool, answer: str = "yes") -> Foretold:
    return Foretold(
        place="house",
        robot="jackal",
        seed=seed,
        met="furniture",
        foreign=False,
        under_way=False,
        answer=answer,
        chance=chance,
        arrives=2,
        samples=2,
        despite=(1, 2),
        hidden_m=3.0,
        stands=0.1,
        lacks=(),
        least_s=10.0,
        most_s=12.0,
        plain_s=(10.0, 12.0),
        put_s=(20.0,),
        clearance_m=0.3,
        says="it arrives",
        arrived=arrived,
        time_s=11.0,
        went_clear_m=0.2,
        why="" if arrived else "lost for 60 s",
    )


ROWS = [
    row(1, 1.0, arrived=True),
    row(2, 0.9, arrived=False),
    row(3, 0.0, arrived=False, answer="no"),
    row(4, None, arrived=True, answer="unknown"),
]


def test_rows_of_several_runs_are_merged_each_once(tmp_path: Path) -> None:
    parts = (ROWS[:2], ROWS[1:])
    for k, part in enumerate(parts):
        rows = Rows(tmp_path / str(k) / FOUND, Result)
        for one in part:
            rows.add(Result(f"key{one.seed}", "a task", msgspec.json.encode([one]).decode()))
    assert kept([tmp_path / "0", tmp_path / "1"]) == ROWS


def test_scores_are_of_what_was_told() -> None:
    assert brier(ROWS) == pytest.approx((0.0 + 0.81 + 0.0) / 3)
    assert brier([ROWS[3]]) is None
    assert [len(each) for each in bins(ROWS)] == [1, 0, 0, 1, 0, 1]
    least, most = wilson(9, 10)
    assert (least, most) == pytest.approx((0.596, 0.982), abs=0.001)
    said = summed(ROWS)
    assert "| **all** | 4 | 2/1/1 |" in said
    assert "1 of 2" in said, "one yes of two was wrong"
    assert "lost for 60 s" in said
    assert "| 2 of 2 | 18% |" in said, "11 s are within 10 to 12 s"


def test_drives_are_drawn_by_the_seed_and_short(tmp_path: Path) -> None:
    made = [scenario_of(Task("house", "jackal", seed)) for seed in (1, 1, 2)]
    assert made[0] == made[1] != made[2]
    found = [each for each in made if each is not None]
    room, chart = load_profile("jackal").body.goal_room_m, load_world("house")
    for _, scenario in found:
        assert scenario.goal is not None
        away = hypot(scenario.goal[0] - scenario.start[0], scenario.goal[1] - scenario.start[1])
        assert NEAR_M <= away <= FAR_M
        assert chart.clearance(*scenario.goal[:2]) >= room
    assert {name for name, _ in found} <= {"as mapped", "furniture", "people", "glass"}


def test_rehearsal_under_way_is_of_what_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foretold, "driven", lambda *_: [])
    made = scenario_of(Task("house", "jackal", 1))
    assert made is not None
    run = Foreteller(made[1], 1, under_way=True)
    run.start()
    assert run.clear_m == [None], "what came before counts nowhere"
    run.mesh.run(run.mesh.now + 1.0)
    assert run.clear_m[0] is not None
    run.goes_on(UNDER_WAY_S)
    assert run.clear_m[1] is None
    assert run.told[1][1].judgement.answer is Answer.UNKNOWN, "no mission is under way"


def test_worlds_of_a_folder_are_places_too(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(
        'title = "own"\nworld = "house"\nstart = [1.0, 1.0, 0.0]\ngoal = [3.0, 1.0, 0.0]\n'
    )
    context = Context(out=tmp_path / "out", runs=2, logs=tmp_path)
    found = tasks(context)
    assert [each.seed for each in found] == sorted(each.seed for each in found)
    own = [each for each in found if each.own]
    assert {each.name for each in own} == {"own"}
    assert len(own) == 2 * len({each.robot for each in found})
