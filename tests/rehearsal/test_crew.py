"""The workers of a rehearsal."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from armadico.rehearsal.crew import NICE, Crew


def _squared(number: int) -> tuple[int, int]:
    return number * number, os.nice(0)


def _fails(number: int) -> int:
    raise ValueError(f"not {number}")


def _never_ends(folder: str) -> None:
    Path(folder, str(os.getpid())).touch()
    while True:
        time.sleep(60.0)


def _ended(pid: str) -> bool:
    """Whether a process has ended; it may still wait for init to notice."""
    try:
        return Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_all_items_are_worked_at_low_priority() -> None:
    with Crew(2) as crew:
        found = dict(crew.results(_squared, range(5)))
    mine = os.nice(0)
    assert found == {k: (k * k, min(19, mine + NICE)) for k in range(5)}


def test_error_of_a_worker_comes_here() -> None:
    with Crew(1) as crew, pytest.raises(ValueError, match="not 7"):
        list(crew.results(_fails, [7]))


def test_what_has_not_ended_in_time_has_no_result_and_is_killed(tmp_path: Path) -> None:
    with Crew(2) as crew:
        list(crew.results(_squared, [1]))  # it has started
        crew.until = time.monotonic() + 1.0
        assert list(crew.results(_never_ends, [str(tmp_path)] * 2)) == []
        began = [each.name for each in tmp_path.iterdir()]
        while not all(map(_ended, [*began, str(crew.leader)])):  # until the test's timeout
            time.sleep(0.05)


def test_helper_that_reads_nothing_is_not_awaited() -> None:
    """More than a pipe holds, as of a society that sees much, on a machine that is busy."""
    with Crew(1) as crew:
        os.kill(crew.leader, signal.SIGSTOP)
        crew.until = time.monotonic() + 0.1
        much = "x" * 2**20
        crew.prepare(len, much)
        assert list(crew.results(len, [much])) == []


def test_crew_that_ended_in_time_is_not_killed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its group's number may be another's by then."""
    with Crew(1) as crew:
        crew.end()
        monkeypatch.setattr(os, "killpg", lambda *_: pytest.fail("killed again"))
