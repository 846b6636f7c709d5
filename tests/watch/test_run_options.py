"""Pictures and recordings of a run, by its options."""

from __future__ import annotations

import errno
import os
import resource
import signal
from pathlib import Path

import pytest

from armadico import cli
from armadico.cli import options
from tests.programs import Done, call

FULL = Path("/dev/full")
ROOM = 100_000
"""Bytes that a file may have on the disk that is full soon."""

VIRTUAL = ("run", "sc1", "--virtual", "--sensors", "ideal")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()


def on_a_small_disk(*words: str, cwd: Path) -> Done:
    """What is written beyond some size is refused, as by a disk that is full."""

    def small() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))

    return call(*words, preexec_fn=small, cwd=cwd)


@pytest.mark.parametrize("path", ["/proc/no/picture.png", ".", "file/picture.png"])
def test_a_picture_that_cannot_be_written_is_said_before_the_robot_moves(
    capsys: pytest.CaptureFixture[str], path: str
) -> None:
    assert cli.main([*VIRTUAL, "--json", "--plot", path]) == options.FAILED
    said = capsys.readouterr()
    assert not said.out, "there was no run"
    assert f"cannot write the picture {path}" in said.err


@pytest.mark.long
def test_a_picture_goes_to_a_folder_and_nothing_is_left_of_a_run_that_failed() -> None:
    Path("new").mkdir()
    refused = cli.main([*VIRTUAL, "--without", "encoder", "--plot", "new/refused.png"])
    assert refused == options.FAILED
    assert list(Path("new").iterdir()) == []
    assert cli.main([*VIRTUAL, "--plot", "new/picture.png"]) == 0
    assert Path("new/picture.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_a_picture_that_was_asked_for_and_cannot_be_written_is_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.png").symlink_to(FULL)
    words = ["run", "sc1", "--virtual", "--plot", str(tmp_path / "x.png")]
    assert cli.main(words) == options.FAILED
    said = capsys.readouterr()
    assert "no picture: cannot write" in said.err
    assert "reached" in said.out, "the measures are there"


@pytest.mark.long(but=("--record-run.mcap",))
@pytest.mark.parametrize(("option", "file"), [("--record", "run.mcap"), ("--rrd", "run.rrd")])
def test_a_recording_that_does_not_fit_costs_no_measures(
    tmp_path: Path, option: str, file: str
) -> None:
    words = ["run", "sc1", "--virtual", "--sensors=ideal", "--json", option, file]
    done = on_a_small_disk(*words, cwd=tmp_path)
    assert done.returncode == options.FAILED
    assert f"armadico: {file}: is incomplete" in done.stderr
    assert "Traceback" not in done.stderr
    assert '"reached": true' in done.stdout


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_nor_does_one_begin_that_cannot(tmp_path: Path) -> None:
    (tmp_path / "full.rrd").symlink_to(FULL)
    done = call("run", "sc1", "--virtual", "--rrd", "full.rrd", cwd=tmp_path)
    assert done.returncode == options.FAILED
    assert "armadico: full.rrd: " in done.stderr
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_recording_without_a_head_is_not_in_the_way_of_the_next_one(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    words = (*VIRTUAL, "--record", "run.mcap")

    def full() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    done = call(*words, preexec_fn=full, cwd=tmp_path)
    assert done.returncode == options.FAILED
    assert "run.mcap" in done.stderr, "it failed for this"
    assert not (tmp_path / "run.mcap").exists()


def test_tables_on_a_full_disk_are_named_and_not_what_they_are_made_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mcap")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("armadico.watch.recordings.rows", full)
    recording = tmp_path / "run.mcap"
    recording.touch()
    assert cli.main(["export", str(recording), "--to", "csv"]) == options.FAILED
    assert f"{tmp_path}/run-csv: No space left on device" in capsys.readouterr().err
