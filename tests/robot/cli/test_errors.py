"""What a user can cause is answered in words: file and line, full disks, Ctrl-C, odd names."""

from __future__ import annotations

import os
import re
import resource
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from armadico import cli
from armadico.cli import goto, options
from armadico.core.discovery import COMMANDS, installed
from armadico.core.messages import Cycle, RobotState, Stop
from tests.programs import BIN, call

SCENARIO = 'world = "sc1"\nstart = [0, 0, 0]\ngoal = [1, 0, 0]\n'
FULL = Path("/dev/full")


def files(text: str, tmp_path: Path, name: str = "mine.toml") -> str:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_name_in_brackets_is_a_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = files(f'name = "[/nope][red]x"\n{SCENARIO}', tmp_path)
    assert cli.main(["run", scenario, "--virtual"]) == 0
    assert "[/nope][red]x: reached" in capsys.readouterr().out


def test_a_command_of_another_tool_names_the_own_one(capsys: pytest.CaptureFixture[str]) -> None:
    """The most similar name would mislead: `faults` for `status`."""
    assert cli.main(["status"]) == options.USAGE
    assert "no command 'status'; `armadico ps` lists the agents" in capsys.readouterr().err
    for advice in cli.ELSEWHERE.values():
        for command in re.findall(r"`armadico (\S+?)[` ]", advice):
            # Those of another package may not be installed.
            if command not in {"top", "graph", "echo", "record", "replay"}:
                assert command in installed(COMMANDS)


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    "words", [("--help",), ("run", "sc1", "--virtual", "--sensors", "ideal", "--json")]
)
def test_output_that_goes_to_a_full_disk_is_told_of(words: tuple[str, ...]) -> None:
    with FULL.open("w") as full:
        done = call(*words, stdout=full)
    assert done.returncode == options.FAILED
    assert done.stderr == "armadico: No space left on device\n"


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full")
def test_a_run_goes_on_when_what_it_reports_cannot_be_written() -> None:
    with FULL.open("w") as full:
        words = ("run", "sc1", "--virtual", "--sensors=ideal", "--runs=1", "--json")
        done = call(*words, stderr=full)
    assert done.returncode == 0
    assert '"reached": true' in done.stdout


@pytest.mark.long(but=(">&- 2>&- <&-",))
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_who_closes_its_streams_hears_nothing_and_it_is_done_all_the_same(
    tmp_path: Path, closed: str
) -> None:
    words = f"run sc1 --virtual --sensors ideal --json {closed}"
    done = call("-c", f'"{BIN}/armadico" {words}', program="/bin/sh", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert bool(done.stdout) == (">&-" not in closed.split())


# Limits, Ctrl-C, characters -----------------------------------------------------------------------


def test_too_few_file_descriptors_are_told_of() -> None:
    def few() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (11, 11))  # a shell needs number 10

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
    done = call("-c", INTERRUPTED.format(module=module), program=sys.executable)
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
    ("stop", "fresh", "says"),
    [
        (Stop(1, True, "anna", 1), True, "the robot is stopped by anna"),
        (Stop(1, True, "anna", 1), False, "the robot was last seen stopped by anna"),
        (Stop(2, False, "anna", 1), True, "the robot drives on; `armadico stop` stops it"),
        (Stop(2, False, "anna", 1), False, "it is not known whether the robot drives"),
        (None, False, "it is not known whether the robot drives"),
    ],
)
def test_what_goto_leaves_behind_is_what_is_known_of_the_robot(
    stop: Stop | None, fresh: bool, says: str
) -> None:
    state = stop and RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, stop)
    last, now = (lambda _: state), (lambda _: state if fresh else None)
    client: Any = SimpleNamespace(latest=last, fresh=now)
    assert goto._left_behind(client).startswith(says)
