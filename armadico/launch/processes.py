"""Processes of this machine: started, listened to, and ended in order."""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from math import degrees
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Final

import msgspec

from armadico.config.discovery import owners
from armadico.core.resources import WHEELS

if TYPE_CHECKING:
    import psutil

    from armadico.config.scenarios import Scenario
    from armadico.launch.society import Member
    from armadico.mobile.geometry import Pose2

START_S: Final = 20.0
"""What the processes may take to start."""

LEAVE_S: Final = 3.0
"""What a process may take to leave before it is killed."""

SIMULATOR: Final = "simulator"

LAUNCHER: Final = "ARMADICO_LAUNCHER"
"""In the environment of a process: the id of the one that started it, to be ended with it."""

TIED: Final = "armadico.child"
"""The program of a process that is to leave when its launcher is gone."""

_ANNOUNCED = re.compile(r" at (tcp://[^;,\s]+)")
"""Where the simulator's first line on standard output says that it listens."""


class StartError(RuntimeError):
    """A process did not start; the message says why."""


class Process:
    """One process of the society, and where its last words are kept."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        *,
        listen: bool = False,
        tied: bool = False,
    ) -> None:
        """Start `armadico COMMAND...`.

        Args:
            name: What it is called.
            command: The words after `armadico`.
            log: Where what it says is appended.
            listen: Keep its standard output for `announced`, instead of in the log.
            tied: It is to leave when this process is gone, however that ends.
        """
        self.name = name
        self.log = log
        with _appended(log) as errors:
            self._begun_at = errors.tell()
            self.popen: subprocess.Popen[bytes] = subprocess.Popen(
                command_line(command, tied=tied),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if listen else errors,
                stderr=errors,
                env={**os.environ, LAUNCHER: str(os.getpid())},
                start_new_session=True,  # Ctrl-C is the launcher's; it tells them in order
            )

    @property
    def has_robot(self) -> bool:
        """Whether the robot agent is one of this process's."""
        return owns_wheels(self.name)

    def ended(self) -> bool:
        return self.popen.poll() is not None

    def last_words(self, lines: int = 5) -> str:
        """The end of what it wrote."""
        try:
            with self.log.open("rb") as file:
                file.seek(min(self._begun_at, self.log.stat().st_size))
                text = file.read().decode(errors="replace").strip().splitlines()
        except OSError as error:
            return f"    its log cannot be read: {error.strerror}"
        return "\n".join(f"    {line}" for line in text[-lines:]) or "    nothing"

    def announced(self) -> list[str]:
        """The addresses of its robots, which the simulator says first. Raises StartError."""
        assert self.popen.stdout is not None, "it was asked for"
        found: list[str] = _ANNOUNCED.findall(_line(self.popen.stdout, START_S))
        if not found:
            raise StartError(f"the {self.name} did not start:\n{self.last_words()}")
        return found


def _appended(log: Path) -> BinaryIO:
    """A log, to be written on; nowhere if it cannot be: who drives needs none.

    Its folder may have been cleaned up meanwhile, or the disk be full.
    """
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        return log.open("ab")
    except OSError:
        return Path(os.devnull).open("ab")


def command_line(words: Sequence[str], *, tied: bool = False) -> list[str]:
    """`armadico WORDS...` by this Python; `tied`: it leaves when this process is gone."""
    if tied:
        return bound(["armadico", *words], signal.SIGTERM)
    return [sys.executable, "-P", "-m", "armadico", *words]


def bound(program: Sequence[str], number: signal.Signals) -> list[str]:
    """A program that is sent a signal when the thread that starts it is gone."""
    child = [sys.executable, "-P", "-m", TIED]
    return [*child, str(os.getpid()), str(number.value), *program]


def ending(code: int) -> str:
    """How a process ended, for people: `status 1`, or the signal's name."""
    if code >= 0:
        return f"status {code}"
    with suppress(ValueError):
        return f"signal {signal.Signals(-code).name}"
    return f"signal {-code}"


def simulator_words(
    scenario: Scenario, seed: int, namespace: str, port: int = 0, also: Sequence[str] = ()
) -> list[str]:
    """The command that simulates a scenario's robot; `port` 0: one that is free.

    `also` are the namespaces of the scenario's other robots, those that take part.
    """
    others = [
        word
        for name, pose in zip(also, scenario.others, strict=False)
        for word in ("--also", name, *_pose_words(pose))
    ]
    battery = (("charge", scenario.battery.charge), ("capacity", scenario.battery.capacity_ah))
    return [
        "sim",
        scenario.world,
        f"--port={port}",
        f"--seed={seed}",
        f"--sensors={scenario.sensors}",
        f"--robot={scenario.robot}",
        f"--namespace={namespace}",
        *("--start", *_pose_words(scenario.start)),
        *others,
        *(f"--{name}={value}" for name, value in battery if value is not None),
        *(["--moving", msgspec.json.encode(scenario.moving).decode()] if scenario.moving else []),
    ]


def _pose_words(pose: Pose2) -> list[str]:
    """A pose, m, m, rad, as commands take it: with the heading in degrees."""
    x, y, theta = pose
    return [str(x), str(y), str(round(degrees(theta), 9))]


def agent_words(members: Sequence[Member], namespace: str, *, journal: bool = False) -> list[str]:
    """The command that runs the agents of one process; `journal`: they keep one."""
    whose = [f"{member.name}." if len(members) > 1 else "" for member in members]
    settings = [
        word
        for of, member in zip(whose, members, strict=True)
        for value in member.sets
        for word in ("--set", f"{of}{value}")
    ]
    kept = ["--journal"] if journal else []
    return ["agent", *(m.name for m in members), "--namespace", namespace, *kept, *settings]


def owns_wheels(label: str) -> bool:
    """Whether one of a process's agents owns the wheels."""
    return any(owners(label.split("+"), WHEELS))


def orphans(namespace: str) -> list[tuple[str, psutil.Process]]:
    """Processes of this user that a launcher started in a namespace, and that have survived it.

    Each has its launcher's id in its environment, and by now another parent. What was started by
    hand has none. Of those that were tied to it one may be left that hangs. Each with its label.
    """
    import psutil  # noqa: PLC0415 - only `armadico down` looks

    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            words = process.cmdline()
            at = words.index("-m") + 1 if "-m" in words else 0
            if words[at : at + 1] not in (["armadico"], [TIED]):
                continue
            launcher = process.environ().get(LAUNCHER)
            ours = process.uids().real == os.getuid()
            if not ours or launcher is None or int(launcher) == process.ppid():
                continue
            rest = words[at + 4 if words[at] == TIED else at + 1 :]
            if rest[:1] == ["sim"] and f"--namespace={namespace}" in rest:
                found.append((SIMULATOR, process))
            elif rest[:1] == ["agent"] and "--namespace" in rest:
                at = rest.index("--namespace")
                if rest[at + 1] == namespace:
                    found.append(("+".join(rest[1:at]), process))
    return found


def end_in_order(processes: Sequence[Process]) -> None:
    """The behaviours let go, the robot stops, the simulator ends last.

    A second Ctrl-C does not interrupt it: it is bounded, and nothing may be left behind.
    """
    simulators = [p for p in processes if p.name == SIMULATOR]
    robots = [p for p in processes if p.has_robot]
    others = [p for p in processes if p not in simulators and p not in robots]
    with undisturbed():
        for group in (others, robots, simulators):
            end(*(process.popen for process in group))


@contextmanager
def undisturbed() -> Iterator[None]:
    """Without the signals that end a process; only the main thread could be disturbed by them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ignored = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, signal.SIG_IGN) for number in ignored}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def end(*popens: subprocess.Popen[Any]) -> None:
    """Ask processes to leave, kill whoever does not, and close their pipes."""
    for popen in popens:
        with suppress(ProcessLookupError):
            popen.terminate()
    deadline = time.monotonic() + LEAVE_S
    for popen in popens:
        try:
            popen.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            popen.kill()
    _finish(popens)


def kill_trees(*popens: subprocess.Popen[Any]) -> None:
    """SIGKILL processes and all that they started, as if the plug was pulled."""
    import psutil  # noqa: PLC0415 - only where something is killed

    for popen in popens:
        with suppress(psutil.NoSuchProcess):
            if popen.poll() is None:
                popen.send_signal(signal.SIGSTOP)  # or it might start somebody meanwhile
                for child in psutil.Process(popen.pid).children(recursive=True):
                    with suppress(psutil.NoSuchProcess):
                        child.kill()
                popen.kill()
    _finish(popens)


def _finish(popens: Sequence[subprocess.Popen[Any]]) -> None:
    for popen in popens:
        popen.wait()
        for pipe in (popen.stdin, popen.stdout, popen.stderr):
            if pipe is not None:
                pipe.close()


def _line(pipe: IO[bytes], timeout: float) -> str:
    """The first line of a pipe, or what there is of it in time."""
    data = b""
    deadline = time.monotonic() + timeout
    with selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        while b"\n" not in data and (left := deadline - time.monotonic()) > 0:
            if not selector.select(left):
                break
            chunk = os.read(pipe.fileno(), 4096)
            if not chunk:
                break
            data += chunk
    return data.decode(errors="replace").partition("\n")[0]
