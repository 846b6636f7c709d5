"""`armadico localize`: options, what is printed, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from armadico import cli
from armadico.agents.slam.commands import localize
from tests.robot.robots import with_laser
from tests.slam import made_logs


@pytest.fixture(autouse=True)
def a_robot_of_this_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default one speaks ROS 2, whose package may be absent."""
    monkeypatch.setattr(localize, "PROFILE", with_laser())


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A short log."""
    return made_logs.npz(tmp_path / "room.npz", made_logs.driven()[:40])


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert cli.main(["localize", *map(str, words)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_it_prints_a_table_and_says_what_it_assumed(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["localize", str(log)]) == 0
    said = capsys.readouterr()
    assert "reported lost" in said.out
    assert "wrong and sure" in said.out
    assert "--drift" in said.err


def test_json_is_one_object_and_the_same_again(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "kept.yaml"
    words = ["localize", str(log), "--json", "--noise", "0.1", "--seed", "3"]
    assert cli.main([*words, "--map-from", "even", "--save-map", str(kept)]) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["scans"] == 40
    assert first["noise"] == 0.1
    assert first["error_median_m"] < 0.1
    assert cli.main([*words, "--world", str(kept)]) == 0
    again = json.loads(capsys.readouterr().out)
    times = {"scan_median_ms", "scan_95_ms", "most_ms", "map"}
    assert {k: v for k, v in first.items() if k not in times} == {
        k: v for k, v in again.items() if k not in times
    }


def test_a_picture_is_drawn(log: Path, tmp_path: Path) -> None:
    pytest.importorskip("armadico.watch")
    pytest.importorskip("matplotlib")
    picture = tmp_path / "path.png"
    assert cli.main(["localize", str(log), "--picture", str(picture), "--anywhere"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_part_and_a_time_are_chosen(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["localize", str(log), "--json", "--over", "odd", "--from", "3"]) == 0
    assert json.loads(capsys.readouterr().out)["scans"] == 16


def test_a_parameter_is_set(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["localize", str(log), "--json", "--set", "start_m=0.3"]) == 0
    assert json.loads(capsys.readouterr().out)["sets"] == ["start_m=0.3"]
    assert "unknown key" in refused(capsys, log, "--noise", 0, "--set", "nothing=1")


def test_a_log_without_a_reference_needs_a_map_and_a_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = made_logs.npz(tmp_path / "blind.npz", made_logs.driven()[:40], reference=None)
    assert "name a map" in refused(capsys, blind, "--noise", 0)
    other = made_logs.npz(tmp_path / "other.npz", made_logs.driven()[:40])
    kept = tmp_path / "kept.yaml"
    assert cli.main(["localize", str(other), "--save-map", str(kept), "--json"]) == 0
    capsys.readouterr()
    assert "name the start" in refused(capsys, blind, "--noise", 0, "--world", kept)
    x, y, theta = made_logs.driven()[0]
    start = ["--start", str(x), str(y), str(np.degrees(theta))]
    assert cli.main(["localize", str(blind), "--world", str(kept), *start, "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["error_median_m"] is None
    assert found["lost_share"] == 0.0
