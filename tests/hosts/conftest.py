"""Machines that are all this one: a host table on loopback, with ports of the test's own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from armadico.cli.options import HOSTS_VARIABLE, NAMESPACE_VARIABLE
from armadico.config.hosts import load_hosts
from armadico.launch.pidfile import RUNTIME_VARIABLE
from armadico.mesh.ports import private_endpoints
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from tests.live.society import SOON, Observer

BIN = Path(sys.executable).parent
NAMESPACE = "hosts-test"

AGENTS = {
    "robot": ["robot"],
    "lab1": ["encoder", "sonar"],
    "lab2": ["goto", "avoid", "gothrough"],
    "lab3": ["path-planning", "interface"],
}
ADDRESSES = {
    "robot": "127.0.0.11",
    "lab1": "127.0.0.12",
    "lab2": "127.0.0.13",
    "lab3": "127.0.0.14",
}

Start = Callable[..., subprocess.Popen[str]]
Call = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(autouse=True)
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The host table, inherited by every process that the test starts."""
    entries = []
    for host, address in ADDRESSES.items():
        endpoints = private_endpoints(2, address).split(",")
        entries.append(f"[{host}]\nendpoints = {json.dumps(endpoints)}\n")
        entries.append(f"agents = {json.dumps(AGENTS[host])}\n")
    file = tmp_path / "lab.toml"
    file.write_text("".join(entries))
    monkeypatch.setenv(HOSTS_VARIABLE, str(file))
    monkeypatch.setenv(NAMESPACE_VARIABLE, NAMESPACE)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv(RUNTIME_VARIABLE, str(tmp_path))
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    return file


@pytest.fixture
def start() -> Iterator[Start]:
    """Start `armadico` with these words; killed with all its children if it is left."""
    with ExitStack() as stack:

        def make(*words: str, program: str = "armadico") -> subprocess.Popen[str]:
            process = subprocess.Popen(
                [str(BIN / program), *words],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(process)
            stack.callback(kill_tree, process)
            return process

        yield make


@pytest.fixture
def call() -> Call:
    """Run `armadico` with these words to its end."""

    def run(*words: str, program: str = "armadico") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(BIN / program), *words], capture_output=True, text=True, timeout=SOON, check=False
        )

    return run


@pytest.fixture
def up(start: Start) -> Start:
    """Have a host's share up: returns once it says so."""

    def make(host: str, *words: str) -> subprocess.Popen[str]:
        process = start("up", *words, "--host", host)
        says(process, f"{host} is up")
        return process

    return make


@pytest.fixture
def mesh(table: Path) -> Iterator[ZenohMesh]:
    """A session as a tool on lab3 has it."""
    hosts = load_hosts(table)
    where = topology(
        host_endpoints=hosts.host("lab3").endpoints, all_endpoints=hosts.endpoints(), passing=True
    )
    with ZenohMesh(NAMESPACE, where) as joined:
        yield joined


@pytest.fixture
def observer(mesh: ZenohMesh) -> Observer:
    """Somebody who hears everything."""
    return Observer(mesh)


def says(process: subprocess.Popen[str], what: str) -> str:
    """The first line on its standard output, which is what is expected."""
    assert process.stdout is not None
    line = process.stdout.readline()
    if what not in line:
        _, errors = process.communicate(timeout=SOON)
        raise AssertionError(f"{what!r} expected, not {line!r}: {errors}")
    return line


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


def kill_tree(process: subprocess.Popen[str]) -> None:
    """Kill a process of the test's own, and those that it started."""
    if process.poll() is None:
        everybody = [*psutil.Process(process.pid).children(recursive=True), process]
        for one in everybody:
            one.kill()
