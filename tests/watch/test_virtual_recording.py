"""Recordings of virtual runs: reproducible, and correct poses and walls as ROS 2 samples."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")


from armadico import cli
from armadico.config.scenarios import load_scenario
from armadico.core import messages as m
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.watch.recordings import rows
from armadico.watch.virtual_recording import Recorded


def run(path: Path | None, profile: str = "pioneer-2dx", limit: float = 6.0) -> Rehearsal:
    options = Options(seed=11, limit=limit, sensors="ideal")
    made = Rehearsal(prepared(load_scenario("sc4"), options, profile=profile), options)
    if path is None:
        made.run()
    else:
        with Recorded(made.mesh, path, made.namespace):
            made.run()
    return made


@pytest.mark.long
def test_a_recording_is_reproducible_and_does_not_change_the_run(tmp_path: Path) -> None:
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    ends = {run(first).mesh.now, run(second).mesh.now, run(None).mesh.now}
    assert len(ends) == 1
    assert first.read_bytes() == second.read_bytes()


def test_run_writes_one_file_per_run_and_overwrites_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    words = ["run", "sc1", "--virtual", "--for", "1", "--record", str(path)]
    cli.main(words)
    assert {type(row.message) for row in rows(path, pytest.fail)} >= {m.RobotState}
    assert cli.main(words) == 1
    assert str(path) in capsys.readouterr().err
    cli.main([*words, "--runs", "2"])
    assert {p.name for p in tmp_path.iterdir()} == {"run.mcap", "run-0.mcap", "run-1.mcap"}
