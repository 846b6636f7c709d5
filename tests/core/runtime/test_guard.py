"""The guard of a line, as a real process between a test's agent and a test's controller."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from armadico.runtime import guard
from armadico.runtime.guarded import GuardedPort
from tests.core.runtime.unix_line import LOADER

pytestmark = pytest.mark.live

SOON = 10.0  # s; a deadline, not an expectation
BRAKES = (b"slow.", b"rest.")


class Bench:
    """A controller, and the guards of its line."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/tmp")))
        self.url, self.place = f"unix://{self.folder}/line", self.folder / "robot.guard"
        self._listener = stack.enter_context(socket.socket(socket.AF_UNIX))
        self._listener.bind(f"{self.folder}/line")
        self._listener.listen()
        self._listener.settimeout(SOON)
        self.controller: socket.socket | None = None
        self.notices: list[bytes] = []

    def accept(self) -> None:
        self.controller = self._stack.enter_context(self._listener.accept()[0])
        self.controller.settimeout(SOON)

    def open(self) -> GuardedPort:
        port = GuardedPort(LOADER, self.url, self.place)
        self._stack.callback(port.close)
        port.told = self.notices.append
        self.accept()
        return port

    def received(self, until: bytes) -> bytes:
        """What the controller receives up to some bytes."""
        assert self.controller is not None
        found = b""
        while not found.endswith(until):
            data = self.controller.recv(1)
            assert data, f"the line ended after {found!r}"
            found += data
        return found

    def stop(self) -> None:
        assert self.answer(b"stop").startswith("holds ")

    def answer(self, datagram: bytes) -> str:
        """What the guard answers to a datagram at its socket."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.settimeout(SOON)
            sender.bind("")
            sender.sendto(datagram, str(self.place))
            return sender.recv(64).decode()


@pytest.fixture
def bench() -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(stack)


def read(port: GuardedPort, until: Callable[[bytes], bool]) -> bytes:
    """Read a port until its bytes or the notices are as wanted. Raises OSError."""
    data = b""
    while not until(data):
        data += port.read(0.1)
    return data


def beats(port: GuardedPort, count: int) -> None:
    """Let the guard live on: it beats each 0.1 s."""
    for _ in range(count):
        assert port.read(SOON) == b""


def ended(pid: int) -> None:
    try:
        process = psutil.Process(pid)
        process.wait(SOON)
    except psutil.NoSuchProcess:
        pass


def test_bytes_pass_unchanged_both_ways(bench: Bench) -> None:
    port, every = bench.open(), bytes(range(256)) * 1000
    assert bench.controller is not None
    port.write(every[:1000])
    assert bench.received(every[:1000]) == every[:1000]
    sender = threading.Thread(target=bench.controller.sendall, args=(every,))
    sender.start()
    assert read(port, lambda data: len(data) >= len(every)) == every
    sender.join()


def test_a_command_that_is_not_renewed_is_braked_step_by_step_and_rest_is_repeated(
    bench: Bench,
) -> None:
    port = bench.open()
    port.command(b"go.", BRAKES, moves=True)
    assert bench.received(b"rest.rest.rest.") == b"go.slow.rest.rest.rest."
    read(port, lambda _: bench.notices == [guard.BRAKED] * 2)
    port.command(b"go.", BRAKES, moves=True)
    assert bench.received(b"go.").endswith(b"go."), "an agent that comes back drives on"


def test_a_robot_at_rest_is_left_alone(bench: Bench) -> None:
    port = bench.open()
    port.command(b"go.", BRAKES, moves=True)
    port.command(b"stand.", (), moves=False)
    beats(port, 6)
    port.write(b"end.")
    assert bench.received(b"end.") == b"go.stand.end."
    assert not bench.notices


def test_once_the_agent_has_let_go_it_brakes_and_ends_without_its_socket(bench: Bench) -> None:
    port = bench.open()
    port.command(b"go.", BRAKES, moves=True)
    assert stat.S_IMODE(bench.place.stat().st_mode) == 0o600
    port.close()
    assert bench.received(b"rest.") == b"go.slow.rest."
    ended(port.pid)
    assert not bench.place.exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=str)
def test_signals_that_end_the_agent_leave_it_to_the_agent(
    bench: Bench, number: signal.Signals
) -> None:
    port = bench.open()
    os.kill(port.pid, number)
    beats(port, 2)
    port.write(b"the agent's last word.")
    assert bench.received(b"word.") == b"the agent's last word."


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=str)
def test_no_guard_is_left_without_its_agent_which_is_killed_or_hangs_first(
    bench: Bench, number: signal.Signals
) -> None:
    words = ["-m", "tests.core.runtime.unix_line", bench.url, str(bench.place)]
    with subprocess.Popen(
        [sys.executable, *words], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    ) as agent:
        try:
            bench.accept()
            assert agent.stdout is not None
            pid = int(agent.stdout.readline())
            agent.send_signal(number)
            assert bench.received(b"rest.rest.") == b"go.slow.rest.rest."
        finally:
            agent.kill()
    ended(pid)
    assert not psutil.pid_exists(pid)


def test_enter_at_the_agents_terminal_is_a_stop(bench: Bench) -> None:
    ours, theirs = os.openpty()
    words = ["-m", "tests.core.runtime.unix_line", bench.url, str(bench.place)]
    with subprocess.Popen(
        [sys.executable, *words],
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 - no threads yet
    ) as agent:
        try:
            bench.accept()
            assert agent.stdout is not None
            agent.stdout.readline()
            bench.received(b"rest.")
            os.write(ours, b"\n")
            assert bench.received(b"latched.").endswith(b"latched.")
        finally:
            agent.kill()
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize("way", ["socket", "signal"])
def test_a_stop_rests_the_robot_and_holds_until_the_agent_has_latched_it(
    bench: Bench, way: str
) -> None:
    port = bench.open()
    port.command(b"go.", BRAKES, moves=True)
    bench.received(b"go.")
    if way == "socket":
        bench.stop()
    else:
        os.kill(port.pid, signal.SIGUSR1)
    assert bench.received(b"rest.") == b"slow.rest."
    read(port, lambda _: guard.STOP in bench.notices)
    port.command(b"go.", BRAKES, moves=True)
    port.command(b"hello.", BRAKES, moves=False)
    assert b"go." not in bench.received(b"hello.")
    port.latched()
    port.command(b"go.", BRAKES, moves=True)
    bench.received(b"go.")


def test_a_guard_that_is_asked_answers_what_it_does_and_stops_nothing(bench: Bench) -> None:
    port = bench.open()
    ours = f"{port.pid} {os.getpid()}"
    assert bench.answer(b"?") == f"passes {ours}"
    port.command(b"go.", BRAKES, moves=True)
    bench.received(b"rest.rest.")
    assert bench.answer(b"?") == f"braked {ours}"
    port.command(b"go.", BRAKES, moves=True)
    bench.received(b"go.")
    assert bench.answer(b"stop") == bench.answer(b"?") == f"holds {ours}"
    port.latched()
    port.command(b"hello.", (), moves=False)
    bench.received(b"hello.")
    assert bench.answer(b"?") == f"passes {ours}"


def test_the_guard_of_a_restarted_agent_knows_the_stop_that_was_not_latched(bench: Bench) -> None:
    first = bench.open()
    bench.stop()
    read(first, lambda _: guard.STOP in bench.notices)
    first.close()
    bench.notices.clear()
    second = bench.open()
    read(second, lambda _: guard.STOP in bench.notices)
    second.command(b"go.", BRAKES, moves=True)
    second.latched()
    second.close()
    third = bench.open()
    third.command(b"go.", (), moves=True)
    assert bench.received(b"go.") == b"go."


def test_a_guard_that_is_killed_or_hangs_is_a_broken_line(bench: Bench) -> None:
    port = bench.open()
    os.kill(port.pid, signal.SIGKILL)
    with pytest.raises(OSError, match="has ended"):
        read(port, lambda _: False)
    port.close()
    port = bench.open()
    os.kill(port.pid, signal.SIGSTOP)
    with pytest.raises(OSError, match="hangs"):
        read(port, lambda _: False)
    port.close()
    assert not psutil.pid_exists(port.pid)


def test_a_line_that_cannot_be_opened_or_breaks_is_an_error_with_its_reason(bench: Bench) -> None:
    with pytest.raises(OSError, match="No such file"):
        GuardedPort(LOADER, f"{bench.url}-of-nobody", bench.place)
    with pytest.raises(OSError, match="no_such_module"):
        GuardedPort("no_such_module:open", bench.url, bench.place)
    assert not bench.place.exists(), "a guard without a line takes no stops"
    port = bench.open()
    assert bench.controller is not None
    bench.controller.shutdown(socket.SHUT_RDWR)
    with pytest.raises(OSError, match="the controller hung up"):
        read(port, lambda _: False)


def test_a_hanging_agent_does_not_hold_up_its_guard(bench: Bench) -> None:
    """What the agent does not read fills its pipe, and the line."""
    port = bench.open()
    port.command(b"go.", BRAKES, moves=True)
    assert bench.controller is not None
    while select.select([], [bench.controller], [], 0.0)[1]:
        bench.controller.send(b"x" * 10_000, socket.MSG_DONTWAIT)
    assert bench.received(b"rest.rest.") == b"go.slow.rest.rest."
