"""The store of results, and places that processes run at: nothing is lost, and nothing is left."""

from __future__ import annotations

import fcntl
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from msgspec import Struct

from armadico.core.config_errors import ConfigError
from armadico_tools.results import Kept, Rows

SOON = 20.0

MAKER = """\
import signal, subprocess, sys, time
from armadico_tools.testbed import Place
with Place("test") as place:
    program = "import time; print(1, flush=True); time.sleep(600)"
    made = place.popen("localhost", [sys.executable, "-c", program], stdout=subprocess.PIPE)
    made.stdout.readline()
    made.send_signal(signal.SIGSTOP)
    print(made.pid, flush=True)
    time.sleep(600)
"""


class Row(Struct, frozen=True):
    """One of each kind of value."""

    name: str
    number: int
    well: bool = False
    share: float | None = None


ROWS = [Row('a, "b"', 1, True, 0.5), Row("c", 2)]


def test_rows_are_read_as_they_were_added(tmp_path: Path) -> None:
    rows = Rows(tmp_path / "made" / "rows.csv", Row)
    assert rows.read() == []
    for row in ROWS:
        rows.add(row)
    assert rows.read() == Rows(rows.path, Row).read() == ROWS


@pytest.mark.parametrize("rest", ["d,", '"d', "d,4,1,"])
def test_a_row_that_was_cut_off_does_not_count_and_takes_no_other_with_it(
    tmp_path: Path, rest: str
) -> None:
    rows = Rows(tmp_path / "rows.csv", Row)
    rows.add(*ROWS)
    with rows.path.open("a") as file:
        file.write(rest)
    again = Rows(rows.path, Row)
    again.add(Row("e", 5))
    assert again.read() == [*ROWS, Row("e", 5)]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("d,four,0,", "number"),
        ("d,4", "expected 4 values, not 2"),
        ('"d,4,0,', "unexpected end"),
        ("", "expected 4 values, not 0"),
        ("\0\0\0", "expected 4 values"),
        ("\udcff,4,0,", "utf-8"),
    ],
)
def test_a_damaged_row_is_named_by_its_file_and_line(tmp_path: Path, line: str, why: str) -> None:
    rows = Rows(tmp_path / "rows.csv", Row)
    rows.add(ROWS[0])
    with rows.path.open("a", errors="surrogateescape") as file:
        file.write(f"{line}\n")
    rows.add(ROWS[1])
    with pytest.raises(ConfigError, match=rf"rows\.csv:3: not a result: .*{why}"):
        Rows(rows.path, Row).read()


@pytest.mark.parametrize("text", ["name,number\nc,2\n", "not a table at all"])
def test_another_file_in_the_place_of_a_store_is_refused_and_left_as_it_is(
    tmp_path: Path, text: str
) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"rows\.csv:1: .*name, ?number, ?well, ?share"):
        Rows(path, Row).read()
    assert path.read_text() == text


def test_a_head_that_was_cut_off_is_written_again(tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("name,num")
    rows = Rows(tmp_path / "rows.csv", Row)
    rows.add(ROWS[0])
    assert rows.read() == ROWS[:1]


def square(of: int) -> int:
    return of**2


def test_a_stored_result_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "found.csv"
    kept = Kept(path, square, "here")
    kept.add("3", 9)
    path.write_text(path.read_text().replace(",9\n", ",{\n"))
    with pytest.raises(ConfigError, match=r"found\.csv:2: not a result"):
        Kept(path, square, "here").read(["3"])


def test_a_row_that_another_process_is_writing_is_not_taken_for_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, lock = Rows(tmp_path / "rows.csv", Row), fcntl.flock
    rows.add(ROWS[0])
    with rows._alone(), rows.path.open("a") as file:
        file.write("c,")
        file.flush()
        monkeypatch.setattr(fcntl, "flock", lambda fd, how: lock(fd, how | fcntl.LOCK_NB))
        with pytest.raises(BlockingIOError):
            Rows(rows.path, Row)
        with pytest.raises(BlockingIOError):
            rows.add(ROWS[0])
        file.write("2,0,\n")
    assert rows.read() == ROWS


def test_a_killed_process_leaves_none_behind_not_even_a_hung_one(tmp_path: Path) -> None:
    script = tmp_path / "maker.py"
    script.write_text(MAKER)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as maker:
        assert maker.stdout is not None
        process = psutil.Process(int(maker.stdout.readline()))
        maker.kill()
    assert not psutil.wait_procs([process], SOON)[1]
