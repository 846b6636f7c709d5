"""On the page a goal is rehearsed before the robot goes there."""

from __future__ import annotations

import threading

import pytest

from armadico.core.config_errors import ConfigError
from armadico.core.judgement import no
from armadico.mesh.base import Mesh
from armadico.rehearsal import rehearse
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.fork import Errand
from armadico.rehearsal.sample import ARRIVED, FAILED, Sample
from tests.watch.page.stage import Stage

FOUND = Rehearsed(
    judgement=no("it stands before a door"),
    arrives=1,
    samples=2,
    runs=(
        Sample(seed=0, end=ARRIVED, path=((0.0, 1.0, 1.0), (0.1, 1.01, 1.0), (1.0, 1.5, 1.0))),
        Sample(seed=1, end=FAILED, path=((0.0, 1.0, 1.0),), put=(1.2, 1.1)),
    ),
)


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.ready()
    return made


def test_the_answer_has_the_paths_and_the_robot_stays(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    goals: list[Errand] = []

    def found(_: Mesh, errand: Errand) -> Rehearsed:
        goals.append(errand)
        return FOUND

    monkeypatch.setattr(rehearse, "rehearsed", found)
    before = stage.parts["motion"]["x"]
    answer = stage.answer(stage.request("page 1", "rehearse", x=1.5, y=0.5, theta=0.1), 9000.0)
    assert goals == [Errand(goal=(1.5, 0.5, 0.1))]
    assert answer["ok"]
    assert answer["text"] == f"no: {FOUND.says}"
    assert answer["more"] == {
        "answer": "no",
        "paths": [
            {"end": ARRIVED, "points": [[1.0, 1.0], [1.5, 1.0]], "put": None},
            {"end": FAILED, "points": [[1.0, 1.0]], "put": [1.2, 1.1]},
        ],
    }
    assert stage.parts["mission"].get("state") in (None, "none")
    assert stage.parts["motion"]["x"] == pytest.approx(before, abs=0.02)


def test_one_at_a_time_and_a_fault_is_said(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    going_on = threading.Event()

    def breaks(_: Mesh, __: Errand) -> Rehearsed:
        assert going_on.wait(60.0)
        raise ConfigError("there is no such map")

    monkeypatch.setattr(rehearse, "rehearsed", breaks)
    first = stage.request("page 1", "rehearse", x=1.5, y=0.5)
    second = stage.answer(stage.request("page 1", "rehearse", x=1.5, y=0.5))
    assert not second["ok"]
    assert "under way" in second["text"]
    going_on.set()
    answer = stage.answer(first, 9000.0)
    assert (answer["ok"], answer["text"], answer["more"]) == (False, "there is no such map", None)
