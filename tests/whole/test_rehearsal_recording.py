"""A rehearsal begins at a moment of a recording."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from armadico.cli import main as armadico
from armadico.config.named import DATA_VARIABLE
from armadico.core.judgement import Answer, yes
from armadico.launch.options import Options
from armadico.launch.virtual import Rehearsal
from armadico.observe.watching import Presence
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.fork import Errand, Fork, fork
from armadico.rehearsal.present import kinds, present_at
from armadico.rehearsal.store import note
from armadico.watch.recordings import messages_of
from armadico.watch.virtual_recording import BEGUN, Recorded
from tests.watch.observed import LINE


def test_a_moment_of_a_recording_is_a_present(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    words = ("run", "sc4", "--virtual", "--for", "6", "--set", "goto.v_max=0.3")
    armadico([*words, "--record", str(file), "--no-plot"])
    messages, _ = messages_of(file, (*kinds(), Presence), None, print)
    messages.sort(key=lambda row: row[0])
    began = messages[0][0]
    early, late = (present_at(messages, began + at) for at in (2.0, 6.0))
    assert early.ready.answer is late.ready.answer is Answer.YES
    assert late.goal is not None, "the mission is under way"
    assert early.pose != late.pose
    of = fork(late, Errand())
    assert isinstance(of, Fork)
    assert "goto.v_max=0.3" in of.options.sets
    assert not of.lacks


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a drive to its goal, 6 m ahead."""
    path = tmp_path_factory.mktemp("driven") / "run.mcap"
    run = Rehearsal(LINE, Options(seed=4))
    with Recorded(run.mesh, path, run.namespace):
        assert run.run().passed
    return path


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ((1.0, 2.0, 3.0), "s longer"),
        ((10.0, 20.0, 40.0), "as told"),
        ((80.0, 90.0, 99.0), "s faster"),
    ],
)
def test_why_of_a_drive_tells_how_it_differed_from_its_rehearsal(
    driven: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    times: tuple[float, ...],
    words: str,
) -> None:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    found = Rehearsed(
        judgement=yes(),
        arrives=4,
        samples=4,
        time_s=times,
        way_m=6.0,
        start=LINE.start[:2],
        goal=LINE.goal,
        world=LINE.world,
    )
    armadico(["why", str(driven)])
    assert "rehearsed" not in capsys.readouterr().out, "nothing was"
    note("robot1", Errand(goal=LINE.goal), found, BEGUN - 60.0)
    armadico(["why", str(driven)])
    said = capsys.readouterr().out
    assert "rehearsed: yes, 4 of 4 arrive" in said
    assert "driven: reached in" in said
    assert words in said


def test_drive_of_a_recording_is_rehearsed_from_its_beginning_and_compared(
    driven: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("rehearse", "--recording", str(driven), "--drive", "1", "--samples", "1")
    armadico([*words, "--within", "300", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert (said["arrives"], said["of"]) == (1, 1), said
    assert "1 of 1 arrive" in said["driven"]
    assert "driven: reached in" in said["driven"]
    assert armadico([*words[:4], "2"]) == 2
    assert "has 1 that have ended" in capsys.readouterr().err
