"""Processes on this machine: starting, logs, and ending in order."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import quote, unquote

import msgspec

from armadico.core.discovery import owners
from armadico.core.resources import WHEELS
from armadico.launch.programs import LAUNCHER, Program, end, finish
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.runtime.errors import RunFailedError

if TYPE_CHECKING:
    import psutil

    from armadico.config.scenarios import Scenario
    from armadico.launch.society import Member
    from armadico.mobile.geometry import Pose2

START_S: Final = 20.0
"""Time for the processes to start."""

SIMULATOR: Final = "simulator"

TIED: Final = "armadico.child"
"""The program of a process that ends with its launcher."""

_ANNOUNCED = re.compile(r" at (tcp://[^;,\s]+)")
"""An address in the simulator's first line of output."""


class Process(Program):
    """One process of the society: `armadico COMMAND...`."""

    log: Path

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        *,
        listen: bool = False,
        tied: bool = False,
    ) -> None:
        """Start it; a `tied` process ends with this one, even if this one is killed."""
        super().__init__(name, command_line(command, tied=tied), log, listen=listen)

    @property
    def has_robot(self) -> bool:
        """Whether the robot agent runs in this process."""
        return owns_wheels(self.name)

    def announced(self) -> list[str]:
        """The addresses of its robots, from a simulator's first line. Raises RunFailedError."""
        found: list[str] = _ANNOUNCED.findall(self.line(START_S))
        if not found:
            raise RunFailedError(f"the {self.name} did not start:\n{self.last_lines()}")
        return found


def logs_folder(namespace: str) -> Path:
    """Create a folder for the logs of a run or a host; `logs_folders` finds it again."""
    return Path(tempfile.mkdtemp(prefix=f"armadico-{quote(namespace, safe='')}-"))


def logs_folders() -> list[tuple[str, Path]]:
    """The folders with logs on this machine, the newest last, with their namespaces."""
    there = [path for path in Path(tempfile.gettempdir()).glob("armadico-*-*") if path.is_dir()]
    found = sorted(
        (path for path in there if any(path.glob("*.log"))), key=lambda path: path.stat().st_mtime
    )
    # The random end of the name has no dash.
    return [(unquote(path.name.partition("-")[2].rpartition("-")[0]), path) for path in found]


@dataclass
class ProcessTable:
    """The processes that one program has started for a society, and the folder of their logs."""

    namespace: str  # the robot's subtree of keys
    logs: Path  # the folder
    # Options by which the processes find the mesh, if it is not the default one.
    joining: Sequence[str] = ()
    tied: bool = False  # they end with this process, instead of driving on
    journal: bool = False  # the agents publish their inputs and outputs
    prefix: str = ""  # the prefix of the log names, if several societies share the folder
    # In the order of their start; ended ones stay until `take_ended`.
    processes: list[Process] = field(default_factory=list)
    # The id of its simulator, by which the robot's truth is known; a restarted one has the same.
    # Empty: none was started.
    simulator: str = ""

    def start(self, name: str, words: Sequence[str], *, listen: bool = False) -> Process:
        """Start `armadico WORDS...` on the mesh of the society."""
        log = self.logs / f"{self.prefix}{name}.log"
        process = Process(name, [*words, *self.joining], log, listen=listen, tied=self.tied)
        self.processes.append(process)
        return process

    def start_agents(self, name: str, members: Sequence[Member]) -> Process:
        """Start the agents of one process."""
        return self.start(name, agent_words(members, self.namespace, journal=self.journal))

    def start_simulator(
        self, scenario: Scenario, seed: int, port: int = 0, also: Sequence[str] = ()
    ) -> Process:
        """Start a simulator on a TCP port (0: a free one); `announced` has its addresses."""
        self.simulator = self.simulator or f"sim-{secrets.token_hex(4)}"
        words = simulator_words(scenario, seed, self.namespace, port, also, self.simulator)
        return self.start(SIMULATOR, words, listen=True)

    def named(self, name: str) -> Process | None:
        """The newest process of a name."""
        return next((p for p in reversed(self.processes) if p.name == name), None)

    def take_ended(self) -> list[Process]:
        """Remove and return the processes that have ended."""
        ended = [process for process in self.processes if process.ended()]
        for process in ended:
            self.processes.remove(process)
            finish([process.popen])
        return ended

    def end(self) -> None:
        """End all of them in order."""
        end_in_order(self.processes)
        self.processes.clear()

    def remove_logs(self) -> None:
        shutil.rmtree(self.logs, ignore_errors=True)


def command_line(words: Sequence[str], *, tied: bool = False) -> list[str]:
    """`armadico WORDS...` with this Python; `tied`: it ends with this process."""
    if tied:
        return bound(["armadico", *words], signal.SIGTERM)
    return [sys.executable, "-P", "-m", "armadico", *words]


def bound(program: Sequence[str], number: signal.Signals) -> list[str]:
    """A program that receives a signal when the thread that started it ends."""
    child = [sys.executable, "-P", "-m", TIED]
    return [*child, str(os.getpid()), str(number.value), *program]


def ending(code: int) -> str:
    """An exit code as text: `status 1`, or the signal's name."""
    if code >= 0:
        return f"status {code}"
    with suppress(ValueError):
        return f"signal {signal.Signals(-code).name}"
    return f"signal {-code}"


def simulator_words(
    scenario: Scenario,
    seed: int,
    namespace: str,
    port: int = 0,
    also: Sequence[str] = (),
    simulator: str = "",
) -> list[str]:
    """The command that simulates a scenario's robot; `port` 0: a free one.

    `also` has the namespaces of the scenario's other robots that take part, and `simulator` is the
    id in the truth; "": the simulator makes one.
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
        *([f"--id={simulator}"] if simulator else []),
        *("--start", *_pose_words(scenario.start)),
        *others,
        *(f"--{name}={value}" for name, value in battery if value is not None),
        *(["--moving", msgspec.json.encode(scenario.moving).decode()] if scenario.moving else []),
    ]


def _pose_words(pose: Pose2) -> list[str]:
    """A pose, m, m, rad, as words of a command, with the heading in degrees."""
    x, y, theta = pose
    return [str(x), str(y), str(round(degrees(theta), 9))]


def agent_words(members: Sequence[Member], namespace: str, *, journal: bool = False) -> list[str]:
    """The command that runs the agents of one process."""
    prefixes = [f"{member.name}." if len(members) > 1 else "" for member in members]
    settings = [
        word
        for prefix, member in zip(prefixes, members, strict=True)
        for value in member.sets
        for word in ("--set", f"{prefix}{value}")
    ]
    flags = ["--journal"] if journal else []
    return ["agent", *(m.name for m in members), "--namespace", namespace, *flags, *settings]


def owns_wheels(label: str) -> bool:
    """Whether one of a process's agents owns the wheels."""
    return any(owners(label.split("+"), WHEELS))


def orphans(namespace: str) -> list[tuple[str, psutil.Process]]:
    """(label, process) of this user's processes in a namespace that have outlived their launcher.

    Such a process has its launcher's id in its environment, and another parent. Processes started
    by hand have no such id. A tied process can be among them if it hangs. One with another folder
    of sockets is of another society, also in a namespace of the same name.
    """
    import psutil

    found, here = [], _sockets(os.environ)
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            words = process.cmdline()
            at = words.index("-m") + 1 if "-m" in words else 0
            if words[at : at + 1] not in (["armadico"], [TIED]):
                continue
            environ = process.environ()
            launcher = environ.get(LAUNCHER)
            ours = process.uids().real == os.getuid() and _sockets(environ) == here
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


def _sockets(environ: Mapping[str, str]) -> str:
    """The folder of sockets that an environment names, as `armadico.mesh.sockets.folder` reads it.

    It need not exist any more: that of a login is removed with it.
    """
    return environ.get(RUNTIME_VARIABLE) or environ.get("TMPDIR", "")


def end_in_order(processes: Sequence[Process]) -> None:
    """End the behaviours first, then the robot agent, then the simulator.

    A second Ctrl-C does not interrupt this, so that no process is left; the time is bounded.
    """
    simulators = [p for p in processes if p.name == SIMULATOR]
    robots = [p for p in processes if p.has_robot]
    others = [p for p in processes if p not in simulators and p not in robots]
    with undisturbed():
        for group in (others, robots, simulators):
            end(*(process.popen for process in group))


@contextmanager
def undisturbed() -> Iterator[None]:
    """Ignore the signals that end a process; only the main thread receives them."""
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


def kill_trees(*popens: subprocess.Popen[str] | subprocess.Popen[bytes]) -> None:
    """SIGKILL processes and all their children, as by a power failure."""
    import psutil

    for popen in popens:
        with suppress(psutil.NoSuchProcess):
            if popen.poll() is None:
                popen.send_signal(signal.SIGSTOP)  # otherwise it might start another child
                for child in psutil.Process(popen.pid).children(recursive=True):
                    with suppress(psutil.NoSuchProcess):
                        child.kill()
                popen.kill()
    finish(popens)
