"""Beside a part that is gone or hangs, each command says so, soon, and does not succeed."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from armadico.mesh.sockets import folder, guard_now
from tests.programs import SOON, Start, call, starter

from .conftest import NAMESPACE

pytestmark = [pytest.mark.live, pytest.mark.long]

COMMANDS = {
    "doctor": "doctor",
    "top": "top --once --for 2",
    "why": "why --live --for 2",
    "standing": "why --live --standing --for 2",
    "ps": "ps",
    "goto": "goto 8 1 --timeout 6",
    "audit": "audit --live --for 3",
    "record": "record run.mcap --duration 3 --quiet",
    "stop": "stop --timeout 3",
}
HANGS = "does not answer"
NO_AGENT = "no robot agent at"
NO_DATA = "The device of robot sends no data"
NO_SONAR = "No agent that provides sonar/obstacles is alive"
NO_STATE = "no state of the robot confirms it"

CASES = {
    "robot-agent-hangs": (
        [],
        "agent robot",
        signal.SIGSTOP,
        dict.fromkeys(COMMANDS, HANGS) | {"stop": "has stopped the robot; the robot agent"},
    ),
    "robot-agent-killed": (
        [],
        "agent robot",
        signal.SIGKILL,
        dict.fromkeys(COMMANDS, NO_AGENT),
    ),
    "controller-hangs": (
        [],
        "armadico sim",
        signal.SIGSTOP,
        dict.fromkeys(("doctor", "why", "standing", "ps"), NO_DATA)
        | {"top": NO_DATA, "goto": "armadico: ", "stop": NO_STATE}
        | {"audit": "no RobotState"},
    ),
    "without-sensors": (
        ["--without", "sonar"],
        "",
        signal.SIGCONT,
        dict.fromkeys(("doctor", "top", "why", "standing", "ps", "goto"), NO_SONAR)
        | {"audit": "no Obstacles received"},
    ),
}
"""Options of `armadico up`, the process that gets the signal, and what each command says."""


@pytest.fixture
def society(apart: None) -> Iterator[Start]:
    """Start the agents of scenario 4; they go on after the launcher hangs, and end with it."""
    with starter() as start:
        yield start


@pytest.mark.parametrize(("more", "part", "number", "says"), CASES.values(), ids=CASES)
def test_what_a_command_does_not_see_is_said_and_is_no_success(
    society: Start,
    more: Sequence[str],
    part: str,
    number: signal.Signals,
    says: dict[str, str],
    tmp_path: Path,
) -> None:
    up = society("up", "sc4", *more)
    assert up.stdout is not None
    assert "is up" in up.stdout.readline()
    children = psutil.Process(up.pid).children(recursive=True)
    if part:
        deadline = time.monotonic() + SOON
        while guard_now(NAMESPACE) is None:  # a starved one is being replaced
            assert time.monotonic() < deadline, "the line has no guard"
        up.send_signal(signal.SIGSTOP)  # it restarts nothing
        for process in children:
            with suppress(psutil.NoSuchProcess):  # a worker of the start has ended since
                if part in " ".join(process.cmdline()):
                    process.send_signal(number)
    try:
        found = {}
        with starter(cwd=tmp_path) as start:
            started = {name: start(*COMMANDS[name].split()) for name in says if name != "stop"}
            for name, process in started.items():
                out, errors = process.communicate(timeout=SOON)
                found[name] = process.returncode, " ".join((out + errors).split())
        if "stop" in says:
            done = call("stop", "--timeout", "3")
            found["stop"] = done.returncode, done.stderr
        for name, (code, text) in found.items():
            assert code in (1, 3), f"{name}: {text}"
            assert says[name] in text, f"{name}: {text}"
    finally:
        for process in (psutil.Process(up.pid), *children):
            with suppress(psutil.Error):
                process.send_signal(signal.SIGCONT)
        assert call("down").returncode == 0
    assert not list(folder().iterdir()), "down leaves nothing"
