"""Machines that are all this one: a host table on loopback, with ports of the test's own."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
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
from tests.programs import Start, starter

NAMESPACE = "hosts-test"

AGENTS = {
    "robot": ["robot"],
    "lab1": ["encoder", "sonar"],
    "lab2": ["goto", "avoid", "gothrough", "relocate"],
    "lab3": ["localization", "path-planning", "interface"],
}
ADDRESSES = {
    "robot": "127.0.0.11",
    "lab1": "127.0.0.12",
    "lab2": "127.0.0.13",
    "lab3": "127.0.0.14",
}


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
    with starter() as begin:
        yield begin


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
