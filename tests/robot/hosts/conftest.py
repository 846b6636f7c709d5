"""Hosts that are all this machine: a table on loopback, and a folder of sockets for each host."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil
import pytest

from armadico.config.hosts import load_hosts
from armadico.mesh.ports import free_port
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.topology import HOSTS_VARIABLE, NAMESPACE_VARIABLE, topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import MissionRequest, Waypoint
from tests import programs
from tests.programs import Done, Start, starter
from tests.robot.society import SOON, Observer
from tests.runtime_folder import fresh_folder

NAMESPACE = "hosts-test"

ROBOT = "robot"
"""The robot agent's host, and the default host of a program."""

AGENTS: Mapping[str, Sequence[str]] = {
    ROBOT: ["robot"],
    "lab1": ["encoder", "sonar"],
    "lab2": ["goto", "avoid", "gothrough", "relocate"],
    "lab3": ["localization", "path-planning", "interface"],
}

TOYS = Path(__file__).with_name("toys.py")


def write_table(file: Path, agents: Mapping[str, Sequence[str]]) -> None:
    """A host table with these agents, each host at an address of its own."""
    entries = []
    for number, (host, names) in enumerate(agents.items(), start=21):
        address = f"127.0.0.{number}"
        router = f'router = "tcp/{address}:{free_port(address)}"'
        where = router if host == ROBOT else f'address = "{address}"'
        entries.append(f"[{host}]\n{where}\n")
        entries.append(f"agents = {json.dumps(list(names))}\n")
    file.write_text("".join(entries))


@pytest.fixture(autouse=True)
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The host table, inherited by every process that the test starts."""
    file = tmp_path / "lab.toml"
    write_table(file, AGENTS)
    monkeypatch.setenv(HOSTS_VARIABLE, str(file))
    monkeypatch.setenv(NAMESPACE_VARIABLE, NAMESPACE)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv(RUNTIME_VARIABLE, str(Path(fresh_folder()) / ROBOT))
    Path(os.environ[RUNTIME_VARIABLE]).mkdir()
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    return file


def environment_of(host: str) -> dict[str, str]:
    """The environment of a program on a host: sockets are a machine's own."""
    folder = Path(os.environ[RUNTIME_VARIABLE]).with_name(host)
    folder.mkdir(exist_ok=True)
    return os.environ | {RUNTIME_VARIABLE: str(folder)}


def call(*words: str, on: str = "", **options: Any) -> Done:
    """Run `armadico` with these words to its end, on a host: the one of --host, or the robot's."""
    return programs.call(*words, env=environment_of(on or _host_of(words)), **options)


def _host_of(words: Sequence[str]) -> str:
    return words[words.index("--host") + 1] if "--host" in words else ROBOT


@pytest.fixture
def start() -> Iterator[Start]:
    """Start `armadico` with these words, on a host: the one of --host, or the robot's.

    It is killed with all its children if it is left.
    """
    with ExitStack() as stack:

        def begin(*words: str, on: str = "", program: str = "armadico") -> subprocess.Popen[str]:
            env = environment_of(on or _host_of(words))
            return stack.enter_context(starter(env=env))(*words, program=program)

        yield begin


@pytest.fixture
def toy() -> Iterator[Start]:
    """Start one of toys.py on a host; killed if it is left."""
    with ExitStack() as stack:

        def begin(kind: str, host: str) -> subprocess.Popen[str]:
            command = [sys.executable, str(TOYS)]
            one = starter(command, environment_of(host), stdout=None, stderr=None)
            return stack.enter_context(one)(kind, host)

        yield begin


@pytest.fixture
def up(start: Start) -> Start:
    """Start a host's share, and wait until it is up."""

    def make(host: str, *words: str) -> subprocess.Popen[str]:
        process = start("up", *words, "--host", host)
        wait_for_line(process, f"{host} is up")
        return process

    return make


@pytest.fixture
def router(table: Path) -> Iterator[None]:
    """The robot's router without a robot agent, for a society of other agents."""
    where = topology(router=True, robot=load_hosts(table).robots_router)
    with ZenohMesh(NAMESPACE, where):
        yield


@pytest.fixture
def observer(table: Path) -> Iterator[Observer]:
    """An observer, which receives everything; it may be there before the robot."""
    robots = load_hosts(table).robots_router
    assert robots is not None
    with ZenohMesh(NAMESPACE, topology(connect=robots), starts=True) as mesh:
        yield Observer(mesh)


def wait_for_line(process: subprocess.Popen[str], what: str) -> str:
    """The first line on its standard output, which is what is expected."""
    assert process.stdout is not None
    line = process.stdout.readline()
    if what not in line:
        _, errors = process.communicate(timeout=SOON)
        raise AssertionError(f"{what!r} expected, not {line!r}: {errors}")
    return line


def sent_off(observer: Observer) -> None:
    """Send the robot a long way off as soon as there is a pose, and wait until it drives."""
    request = MissionRequest(Waypoint(60.0, 0.0, 0.0), planned=False)
    observer.client.request_mission(request, find=SOON, again=SOON)
    observer.until(observer.driving, "the robot is on its way")


def children(process: subprocess.Popen[str]) -> dict[str, psutil.Process]:
    """What `up` keeps up, by the agent's name."""
    found = {}
    for child in psutil.Process(process.pid).children():
        words = child.cmdline()
        name = words[words.index("agent") + 1] if "agent" in words else "simulator"
        found[name] = child
    return found


def all_gone(processes: list[psutil.Process]) -> bool:
    """Whether they end soon."""
    return not psutil.wait_procs(processes, SOON)[1]
