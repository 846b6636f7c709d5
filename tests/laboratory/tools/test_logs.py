"""The yardstick filter, and the experiment over a folder of logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from armadico import cli
from armadico.agents.slam.logs import localizing, logs
from armadico.config.profile import load_profile
from armadico_tools.experiments import logs as experiment
from armadico_tools.experiments.likelihood_filter import LikelihoodFilter, filtered, points
from armadico_tools.experiments.runner import Context
from tests.slam import made_logs


@pytest.mark.long
def test_the_plain_filter_follows_the_reference(tmp_path: Path) -> None:
    log = logs.with_errors(logs.read(made_logs.npz(tmp_path / "a.npz")), 0.05, 1)
    cells = localizing.mapped(log, "all", load_profile("jackal"))
    readings = list(range(len(log)))
    track = filtered(log, cells, readings, 1, float)
    found = localizing.summary(track)
    assert found.compared == len(log)
    assert found.error_95_m is not None
    assert found.error_95_m < 0.15
    assert found.lost_share == 0.0
    assert track.moments == filtered(log, cells, readings, 1, float).moments
    plain = LikelihoodFilter(cells, np.random.default_rng(0))
    here = log.where(0)
    assert here is not None
    assert plain.explained(points(log, 0), here) > 0.9
    assert plain.explained(points(log, 0), (here[0] + 0.7, here[1] + 0.6, here[2])) < 0.5


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer runs."""
    monkeypatch.setattr(experiment, "PLACES", 2)
    monkeypatch.setattr(experiment, "NOISES", (0.05,))
    monkeypatch.setattr(experiment, "FOUND_S", 10.0)


@pytest.mark.long
@pytest.mark.usefixtures("small")
def test_a_folder_of_logs_makes_a_table_and_nothing_is_gone_through_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    made_logs.npz(folder / "room.npz", made_logs.driven()[:50])
    (folder / "broken.npz").write_bytes(b"PK\x03\x04")
    (folder / "README.md").write_text("no log", encoding="utf-8")
    out = tmp_path / "out"
    out.mkdir()
    context = Context(out=out, runs=1, first_seed=1, source="here", logs=folder)
    context.run(experiment.LOGS, "Logs")
    text = (out / "table.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| room")]
    assert len(rows) == 2 * 3 + 1  # two filters, three maps; and the starts that are not known
    assert sum("plain filter" in row for row in rows) == 3
    assert len((out / "logs.csv").read_text(encoding="utf-8").splitlines()) == 1 + 6 + 2
    assert len(context.summary) == 8

    def never(_: object) -> None:
        raise AssertionError("gone through again")

    monkeypatch.setattr(localizing.Run, "go", never)
    again = Context(out=out, runs=1, first_seed=1, source="here", logs=folder)
    again.run(experiment.LOGS, "Logs")
    assert (out / "table.md").read_text(encoding="utf-8") == text


def test_a_dense_log_has_the_half_maps_of_its_twin(tmp_path: Path) -> None:
    every = [made_logs.npz(tmp_path / name, made_logs.driven()[:6]) for name in ("a.npz", "b.npz")]
    every.append(made_logs.npz(tmp_path / "a-dense.npz", made_logs.driven()[:6]))
    tasks = list(experiment.tasks_of(every[2], every, [1], tmp_path))
    assert {(Path(task.map_of).name, task.part) for task in tasks} == {
        *(("a-dense.npz", "all"), ("a.npz", "first"), ("a.npz", "second")),
    }


@pytest.mark.parametrize(
    "words",
    [["logs"], ["logs", "{folder}"], ["logs", "{folder}/nowhere"], ["narrow", "{folder}"]],
)
def test_what_makes_no_sense_is_refused(
    tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    given = [word.format(folder=tmp_path) for word in words]
    assert cli.main(["experiment", *given, "--out", str(tmp_path / "results")]) == 2
    assert capsys.readouterr().err
