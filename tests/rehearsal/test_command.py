"""`armadico rehearse` as it is called."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from contextlib import suppress
from math import pi
from pathlib import Path

import pytest
from psutil import STATUS_ZOMBIE, NoSuchProcess, Process

from armadico.cli import main as armadico
from armadico.cli import options
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import REHEARSALS, find
from armadico.core.judgement import Answer, unknown
from armadico.rehearsal import rehearse
from armadico.rehearsal.answer import Rehearsed, without_samples
from armadico.rehearsal.commands import rehearse as rehearse_command
from armadico.rehearsal.present import Present
from tests.programs import heavy, imports_nothing, starter

THERE = ("--world", "sc4", "--from", "3.4", "0.6", "90")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["goto", "3"], "expected goto X Y [DEG]"),
        (["fly", "3", "1"], "expected goto X Y [DEG]"),
        (["goto", "3", "1", "--at", "5"], "give both"),
        (["goto", "3", "1", "--profile", "jackal"], "--from X Y DEG"),
        (["goto", "3", "1", "--picture", "a.png"], ".svg"),
        (["goto", "3", "1", "--picture", "nowhere/a.svg", *THERE], "no folder nowhere"),
        (["goto", "the", "kitchen", *THERE], "no place 'the kitchen' in 'sc4'"),
        (["goto", "3", "1", *THERE, "--without", "avoit"], "avoid"),
    ],
)
def test_bad_words_are_named(
    capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    try:
        code = armadico(["rehearse", *words])
    except SystemExit as end:
        code = int(str(end.code))
    assert code == 2
    assert said in capsys.readouterr().err


def test_a_goal_is_named_as_for_goto() -> None:
    there = rehearse_command.Options(
        what=("goto", "E"), world="house", mesh=options.Recorded(namespace="alone")
    )
    assert rehearse_command.errand_of(there).goal == pytest.approx((12.6, 1.2, -pi / 2))


def test_without_a_society_it_drives_the_default_one(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    picture = tmp_path / "paths.svg"
    words = ("goto", "3.2", "1.6", *THERE, "--samples", "2", "--within", "400", "--json")
    assert armadico(["rehearse", *words, "--picture", str(picture)]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["answer"], said["arrives"], said["of"]) == ("yes", 2, 2)
    assert picture.read_text().count("<polyline") == 2


def test_time_begins_once_the_recording_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """How long that takes depends on its size."""
    recording, read_at, began_at = tmp_path / "run.mcap", [], []
    recording.touch()

    def read(*_: object) -> tuple[Present, None]:
        read_at.append(time.monotonic())
        return Present(), None

    def drive(*_: object, began: float, **__: object) -> Rehearsed:
        began_at.append(began)
        return without_samples(unknown("nothing was driven"))

    monkeypatch.setattr("armadico.rehearsal.commands.rehearse._recorded", read)
    monkeypatch.setattr("armadico.rehearsal.rehearse.drive", drive)
    assert armadico(["rehearse", "goto", "3", "1", "--recording", str(recording), "--at", "1"]) == 3
    assert began_at[0] >= read_at[0]


class Silence:
    """A watcher that receives nothing."""

    def __init__(self, *_: object) -> None:
        self.looks: list[float] = []

    def __call__(self, *_: object) -> Silence:
        return self

    def clock(self) -> int:
        return 0

    def watch_alive(self, *_: object) -> None: ...

    watch_router = subscribe = query_cards = query = watch_alive

    def until(self, deadline: float) -> tuple[()]:
        self.looks.append(deadline)
        return ()


def test_society_is_observed_no_longer_than_there_is_time(monkeypatch: pytest.MonkeyPatch) -> None:
    watcher = Silence()
    monkeypatch.setattr(rehearse, "Watcher", watcher)
    until = time.monotonic() + 0.05
    assert rehearse.observe(None, until).ready.answer is Answer.UNKNOWN  # type: ignore[arg-type]
    assert all(each <= until for each in watcher.looks)


def test_help_imports_nothing_heavy() -> None:
    module = "armadico.rehearsal.commands.rehearse"
    assert imports_nothing(heavy(module, ["--help"], ["numpy", "zenoh", "msgspec"]))


@pytest.mark.parametrize("errand", [{"gaol": [1.0, 2.0, None]}, {"goal": ["a", 2.0, None]}])
def test_offer_names_what_is_wrong_with_an_errand(errand: dict[str, object]) -> None:
    """Other packages find it by its entry point, and never reach the mesh with a wrong one."""
    offer = find(REHEARSALS, "virtual").load()
    with pytest.raises(ConfigError, match=r"gaol|goal"):
        offer(None, errand)


def _drives(process: Process) -> bool:
    """Whether a worker drives: a child has children."""
    with suppress(NoSuchProcess):  # a child may end while it is asked
        return any(each.children() for each in process.children())
    return False


def test_ctrl_c_leaves_nothing() -> None:
    with starter(stderr=subprocess.PIPE) as start:
        process = start("rehearse", "goto", "3.2", "1.6", *THERE, "--samples", "50")
        began = Process(process.pid)
        while not _drives(began):
            assert process.poll() is None, process.communicate()
            time.sleep(0.1)
        below = began.children(recursive=True)
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 130
        assert not [each for each in below if each.is_running() and each.status() != STATUS_ZOMBIE]
