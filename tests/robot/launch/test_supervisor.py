"""Which log lines `up` passes on, the truncation of long logs, and how `up` ends."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from armadico.launch.supervisor import Plan, Tail, Upkeep
from armadico.runtime.process import AgentHost
from tests.core.mesh.fakes import FakeMesh

STAMP = "12:00:00.123 goto"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "goto.log"
    file.touch()
    return file


def write(log: Path, *lines: str, end: str = "\n") -> None:
    with log.open("a") as file:
        file.write("\n".join(lines) + end)


def test_only_warnings_and_errors_are_passed_on_with_the_agents_name(log: Path) -> None:
    tail = Tail("goto-2", log)
    assert tail.loud() == []
    write(log, f"{STAMP} INFO began", f"{STAMP} WARNING slow", f"{STAMP} ERROR no way")
    assert tail.loud() == ["goto-2: WARNING slow", "goto-2: ERROR no way"]
    assert tail.loud() == []


def test_continuation_lines_follow_their_line(log: Path) -> None:
    tail = Tail("goto", log)
    write(log, f"{STAMP} ERROR it failed", "Traceback (most recent call last):", "  here")
    write(log, f"{STAMP} INFO a list:", "  of things", end="\n")
    assert tail.loud() == [
        "goto: ERROR it failed",
        "goto: Traceback (most recent call last):",
        "goto:   here",
    ]


def test_half_a_line_waits_for_the_rest(log: Path) -> None:
    tail = Tail("goto", log)
    write(log, f"{STAMP} WARN", end="")
    assert tail.loud() == []
    write(log, "ING slow")
    assert tail.loud() == ["goto: WARNING slow"]


def test_a_long_log_is_begun_anew_while_it_is_written_to(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.launch.supervisor.LOG_BYTES", 100)
    tail = Tail("goto", log)
    with log.open("ab", buffering=0) as agent:  # as a process has it
        agent.write(f"{STAMP} INFO {'long ' * 30}\n".encode())
        tail.loud()
        tail.turn()
        assert log.stat().st_size == 0
        assert log.with_suffix(".log.1").read_text().startswith(STAMP)
        agent.write(f"{STAMP} ERROR short\n".encode())
        assert tail.loud() == ["goto: ERROR short"]
        tail.turn()
    assert log.stat().st_size == len(f"{STAMP} ERROR short\n")


def test_a_deleted_log_is_no_error(log: Path) -> None:
    tail = Tail("goto", log)
    write(log, f"{STAMP} ERROR first")
    assert tail.loud() == ["goto: ERROR first"]
    log.unlink()
    assert tail.loud() == []
    tail.turn()
    write(log, f"{STAMP} ERROR two")
    assert tail.loud() == ["goto: ERROR two"]


def test_a_second_signal_does_not_cut_the_end_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the processes end all at once, and `up` has ended before them."""
    left = threading.Event()

    def request_stop(_: AgentHost) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        left.set()

    monkeypatch.setattr(AgentHost, "live", lambda _: left.wait())
    monkeypatch.setattr(AgentHost, "leave", lambda _: None)
    monkeypatch.setattr(AgentHost, "request_stop", request_stop)
    upkeep = Upkeep(Plan("lab1", "robot1", ()), FakeMesh(), lambda _: None)
    upkeep.start()
    process = upkeep.table.start("sonar", ["sim", "sc1", "--port", "0"])
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with suppress(KeyboardInterrupt):
            upkeep.__exit__(KeyboardInterrupt)
    finally:
        signal.signal(signal.SIGTERM, before)
        process.popen.kill()
    assert process.popen.returncode is not None
    assert not upkeep.table.logs.exists()
