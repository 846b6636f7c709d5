"""What a user can cause is answered in words: file and line, full disks, Ctrl-C, odd names."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from armadico import cli
from armadico.cli import goto, options, up
from armadico.core.messages import Cycle, RobotState, Stop
from tests.programs import BIN, SOON, Done, call

SCENARIO = 'world = "sc1"\nstart = [0, 0, 0]\ngoal = [1, 0, 0]\n'
FULL = Path("/dev/full")
ROOM = 100_000
"""Bytes that a file may have on the disk that is full soon."""


def files(text: str, tmp_path: Path, name: str = "mine.toml") -> str:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def on_a_small_disk(*words: str, cwd: Path) -> Done:
    """What is written beyond some size is refused, as by a disk that is full."""

    def small() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))

    return call(*words, preexec_fn=small, cwd=cwd)


def test_a_name_in_brackets_is_a_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = files(f'name = "[/nope][red]x"\n{SCENARIO}', tmp_path)
    assert cli.main(["run", scenario, "--virtual"]) == 0
    assert "[/nope][red]x: reached" in capsys.readouterr().out


def test_help_of_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(["help", "run"])
    assert end.value.code == 0
    assert "usage: armadico run" in capsys.readouterr().out


# Pictures and recordings --------------------------------------------------------------------------


def test_a_folder_that_a_picture_is_to_go_to_is_not_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "sc1", "--virtual", "--plot", str(tmp_path / "nope" / "x.png")]
    assert cli.main(words) == options.FAILED
    assert "cannot write the picture" in capsys.readouterr().err
    assert not (tmp_path / "nope").exists()


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


def test_so_is_one_that_nothing_can_draw(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("armadico.cli.run.find_spec", lambda _: None)
    assert cli.main(["run", "sc1", "--virtual", "--plot", "x.png"]) == options.FAILED
    assert "matplotlib is missing" in capsys.readouterr().err


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


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    "words", [("--help",), ("run", "sc1", "--virtual", "--sensors", "ideal", "--json")]
)
def test_output_that_goes_to_a_full_disk_is_told_of(words: tuple[str, ...]) -> None:
    with FULL.open("w") as full:
        done = subprocess.run(
            [BIN / "armadico", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=SOON,
            check=False,
        )
    assert done.returncode == options.FAILED
    assert done.stderr == "armadico: No space left on device\n"


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_a_run_goes_on_when_what_it_reports_cannot_be_written() -> None:
    with FULL.open("w") as full:
        done = subprocess.run(
            [BIN / "armadico", "run", "sc1", "--virtual", "--sensors=ideal", "--runs=1", "--json"],
            stdout=subprocess.PIPE,
            stderr=full,
            text=True,
            timeout=SOON,
            check=False,
        )
    assert done.returncode == 0
    assert '"reached": true' in done.stdout


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_a_society_stays_up_when_that_it_is_up_cannot_be_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with FULL.open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        up._ready("lab1", "robot, goto")(1.0)


@pytest.mark.long(but=(">&- 2>&- <&-",))
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_who_closes_its_streams_hears_nothing_and_it_is_done_all_the_same(
    tmp_path: Path, closed: str
) -> None:
    words = f"run sc1 --virtual --sensors ideal --json {closed}"
    done = subprocess.run(
        ["sh", "-c", f'"{BIN}/armadico" {words}'],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=SOON,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert bool(done.stdout) == (">&-" not in closed.split())


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


# Limits, Ctrl-C, characters -----------------------------------------------------------------------


def test_too_few_file_descriptors_are_told_of() -> None:
    def few() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (5, 5))

    done = call("run", "sc1", "--virtual", preexec_fn=few)
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, options.FAILED)


INTERRUPTED = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from armadico.__main__ import main
sys.argv[1:] = ["run", "sc1", "--virtual"]
sys.exit(main())
"""


@pytest.mark.parametrize("module", ["armadico.cli", "armadico.cli.options", "armadico.cli.run"])
def test_ctrl_c_while_it_still_imports_is_as_quiet_as_later(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED.format(module=module)],
        capture_output=True,
        text=True,
        timeout=SOON,
        check=False,
    )
    assert done.stderr == ""
    assert done.returncode in (-signal.SIGINT, options.INTERRUPTED)


def test_bytes_that_are_no_text_are_shown_all_the_same(tmp_path: Path) -> None:
    done = call(
        "down", "--host", os.fsdecode(b"h\xff"), env={**os.environ, "TMPDIR": str(tmp_path)}
    )
    assert "Traceback" not in done.stderr
    assert "h\\udcff" in done.stdout


def test_what_an_error_quotes_does_not_control_the_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["run", "--world", "a\x1b[31m.map", "--goal", "1", "1", "0"]) == options.USAGE
    assert "\x1b" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("stop", "stopped"),
    [(Stop(1, True, "anna", 1), True), (Stop(2, False, "anna", 1), False), (None, False)],
)
def test_ctrl_c_in_goto_reports_what_the_robot_does(stop: Stop | None, stopped: bool) -> None:
    state = None
    if stop is not None:
        state = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, stop)
    client: Any = SimpleNamespace(latest=lambda _: state)
    text = goto._left_behind(client)
    assert ("anna" in text) == stopped
    assert ("armadico stop" in text) != stopped
