"""Check this machine and the mesh, and say how to repair what is wrong."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from ctypes.util import find_library
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group
from armadico.core.judgement import Answer
from armadico.mesh.topology import MeshError, TopologyError
from armadico.observe.findings import (
    UP,
    Demand,
    Finding,
    Sort,
    fine,
    judgement,
    open_question,
    summary,
)

CONTROLLER_PORT: Final = 8101
"""TCP port of `armadico sim` and MobileSim."""

LONGEST: Final = 60
"""Characters of a command line that are shown; the program is at its beginning."""

REACH_S: Final = 0.5
"""Timeout for the router of a host."""

JOIN_S: Final = 1.0
"""Timeout for joining the mesh."""

FULL: Final = 0.05
"""Below this free share of memory or of a disk, processes begin to fail."""

OVERLOADED: Final = 20.0
"""Runnable processes per core beyond which agents miss their cycles."""

EXAMPLES: Final = """\
  armadico doctor
  armadico doctor --host lab1 --hosts hosts.toml      every machine of the host table, too
  armadico doctor --json | jq '.[] | select(.answer == "no")'
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    json: bool = flag("print a JSON array")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    """Print all findings; the exit code is that of their judgement."""
    findings = []
    for finding in examine(args.mesh):
        findings.append(finding)
        if not args.json:
            print(*lines(finding), sep="\n", flush=True)
    if args.json:
        import msgspec

        print(json.dumps(msgspec.to_builtins(findings), indent=2))
    else:
        print(f"\n{summary(findings)}")
    return judgement(findings).exit_code


def examine(chosen: options.Mesh) -> Iterator[Finding]:
    yield from versions()
    yield from machine()
    yield from port()
    yield from router(chosen.namespace)
    yield from serial_ports()
    yield from graphics()
    yield from society(chosen)


def lines(finding: Finding) -> Iterator[str]:
    """A finding for people: its verdict and sentence, and below it the cure."""
    verdict = _WORDS[finding.answer, bool(finding.todo)]
    who = "" if finding.who in finding.what else f" {finding.who}"
    yield options.shown(f"{verdict:<8} {finding.sort}{who}: {finding.what}")
    if finding.todo:
        yield options.shown(f"{'':<8} -> {finding.todo}")


_WORDS: Final = {
    (Answer.YES, False): "ok",
    (Answer.YES, True): "note",
    **{(Answer.NO, cured): "wrong" for cured in (False, True)},
    **{(Answer.UNKNOWN, cured): "unknown" for cured in (False, True)},
}


# This machine -------------------------------------------------------------------------------------


def _fine(who: str, what: str, todo: str = "") -> Finding:
    return fine(Sort.MACHINE, who, f"{who}: {what}", todo)


def _wrong(who: str, what: str, todo: str = "") -> Finding:
    return Finding(Sort.MACHINE, who, f"{who}: {what}", todo)


def versions() -> Iterator[Finding]:
    """Python and the required packages."""
    python = ".".join(map(str, sys.version_info[:3]))
    yield _fine("python", f"{python}, {sys.executable}")
    try:
        required = requires("armadico") or []
    except PackageNotFoundError:
        yield _wrong("armadico", "is not installed", "pip install armadico")
        return
    yield _fine("armadico", options.version())
    yield from _packages(required)


_EXTRAS: Final = (
    ("mcap", "record"),
    ("rerun-sdk", "dashboard"),
    ("matplotlib", "plot"),
    ("cyclonedds", "ros2"),
)


def _packages(required: Iterable[str]) -> Iterator[Finding]:
    missing, found = [], []
    for line in required:
        requirement, _, extra = line.partition(";")
        name = requirement.partition("=")[0].rstrip("<>!~ ").partition("[")[0]
        try:
            found.append((name, version(name), requirement.replace(" ", "")))
        except PackageNotFoundError:
            if not extra:
                missing.append(name)
    wrong = [f"{has} instead of {needed}" for _, has, needed in found if _is_off(needed, has)]
    if missing or wrong:
        what = "; ".join([*(f"{name} is missing" for name in missing), *wrong])
        yield _wrong("packages", what, "pip install --upgrade armadico")
    else:
        zenoh = next((has for name, has, _ in found if name == "eclipse-zenoh"), "unknown")
        what = f"all installed; eclipse-zenoh {zenoh} (must be the same on every host)"
        yield _fine("packages", what)
    for name, extra in _EXTRAS:
        if name not in {there for there, _, _ in found}:
            todo = f"pip install 'armadico[{extra}]' if you need it"
            yield _fine(name, f"is not installed ({extra})", todo)


def _is_off(requirement: str, has: str) -> bool:
    """Whether a requirement pins another version."""
    _, exact, pinned = requirement.partition("==")
    return bool(exact) and "*" not in pinned and pinned != has


def machine() -> Iterator[Finding]:
    """Whether memory, the disk of logs and sockets, and the processor have something left."""
    import psutil

    memory, disk = psutil.virtual_memory(), psutil.disk_usage(tempfile.gettempdir())
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    yield from resources(memory.available / memory.total, 1.0 - disk.percent / 100.0, load)


def resources(memory: float, disk: float, load: float) -> Iterator[Finding]:
    """The findings on the free shares of memory and disk, and runnable processes per core."""
    if memory < FULL:
        todo = "end other programs: processes are killed when memory is used up"
        yield _wrong("memory", f"{100.0 * memory:.0f} % is free", todo)
    else:
        yield _fine("memory", f"{100.0 * memory:.0f} % is free")
    if disk < FULL:
        todo = "delete files: logs and recordings cannot be written"
        yield _wrong("disk", f"{100.0 * disk:.0f} % of {tempfile.gettempdir()} is free", todo)
    else:
        yield _fine("disk", f"{100.0 * disk:.0f} % of {tempfile.gettempdir()} is free")
    if load > OVERLOADED:
        todo = "end other programs, or start fewer agents here"
        yield _wrong("processor", f"{load:.1f} processes per core wait for it", todo)
    else:
        yield _fine("processor", f"{load:.1f} runnable processes per core")


def router(namespace: str) -> Iterator[Finding]:
    """Whether sockets can be created, and which process is the router of the namespace."""
    import psutil

    from armadico.mesh.sockets import holder, socket_of

    try:
        path = socket_of(namespace)
    except TopologyError as error:
        yield _wrong("socket", str(error))
        return
    there = holder(path)
    if there is None:
        yield _fine("socket", f"{path}: no router of {namespace!r} on this machine")
        return
    try:
        words = called(psutil.Process(there).cmdline())
    except psutil.Error:
        words = "a process"
    yield _fine("socket", f"{path} is {words}'s (pid {there})")


def port() -> Iterator[Finding]:
    """Whether the simulated controller's port is free."""
    owner = listener(CONTROLLER_PORT)
    what = "is free" if owner is None else f"is taken by {owner}"
    todo = "" if owner is None else "a second simulator needs `armadico sim --port 0`"
    yield _fine(f"port {CONTROLLER_PORT}", what, todo)


def listener(port: int) -> str | None:
    """The process that listens on a TCP port of this machine or serves a client there, or None."""
    import psutil

    # Nothing connects to the port: a simulator serves one client, and would take the probe for it.
    # While it serves a client it does not listen.
    taking = (psutil.CONN_LISTEN, psutil.CONN_ESTABLISHED)
    try:
        for found in psutil.net_connections("tcp"):
            if found.status not in taking or not found.laddr or found.laddr.port != port:
                continue
            if found.pid is None:
                return "a process of another user"
            return f"{called(psutil.Process(found.pid).cmdline())} (pid {found.pid})"
    except psutil.Error:
        return "an unknown process: connections cannot be listed here"
    return None


def called(words: Sequence[str]) -> str:
    """A command line as it is typed: without the Python interpreter of an `armadico` command."""
    names = [Path(word).name for word in words]
    at = next((at for at, name in enumerate(names) if name.startswith("armadico")), 0)
    text = " ".join([*names[at : at + 1], *words[at + 1 :]])
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def serial_ports(folder: Path = Path("/dev")) -> Iterator[Finding]:
    """Serial ports, and whether this user may open them."""
    found = sorted(port for name in ("ttyUSB*", "ttyACM*", "ttyS*") for port in folder.glob(name))
    usable = [port for port in found if os.access(port, os.R_OK | os.W_OK)]
    adapters = [port for port in found if not port.name.startswith("ttyS")]
    locked = [port for port in adapters if port not in usable]
    if locked:
        todo = "sudo usermod -aG dialout $USER, and log in again"
        yield _wrong("serial", f"{', '.join(map(str, locked))}: permission denied", todo)
    if not found:
        yield _fine("serial", "no serial port", "for a real robot, plug in its adapter")
    elif usable:
        yield _fine("serial", ", ".join(map(str, usable[:8])))
    elif not locked:
        todo = "sudo usermod -aG dialout $USER, if a robot is on one of them"
        yield _fine("serial", f"{len(found)} ports, permission denied", todo)


def graphics() -> Iterator[Finding]:
    """What the dashboard's own window needs; a browser needs none of it."""
    lacks = []
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        lacks.append("no display (DISPLAY, WAYLAND_DISPLAY)")
    if find_library("vulkan") is None:
        lacks.append("no Vulkan loader (libvulkan1, and mesa-vulkan-drivers or the maker's driver)")
    if not list(Path("/dev/dri").glob("renderD*")):
        lacks.append("no graphics device in /dev/dri, so the CPU draws")
    if lacks:
        yield _fine("graphics", "; ".join(lacks), "armadico dashboard --web needs no window")
    else:
        yield _fine("graphics", "display, Vulkan and a graphics device are available")


# The mesh -----------------------------------------------------------------------------------------


def society(chosen: options.Mesh) -> Iterator[Finding]:
    """The diagnosis of the society, if the mesh can be joined."""
    from armadico.observe.diagnosis import of_keys
    from armadico.observe.watching import Observer

    joined, demand = chosen.join(starts=True), chosen.demand()
    try:
        with joined:
            linked = joined.wait_joined(JOIN_S)
            if linked:
                yield from Observer(joined, demand).settle()
                return
            hung, missing = joined.hung, joined.missing
    except (MeshError, TopologyError) as error:
        yield Finding(Sort.UNREACHABLE, "mesh", str(error), "see the other findings")
        return
    what, _, todo = missing.rpartition(". " if hung else "; ")
    if hung or demand.hosts:
        yield Finding(Sort.UNREACHABLE, "mesh", what, todo or _starts(demand))
    else:
        yield open_question(Sort.UNREACHABLE, "mesh", what, todo or UP)
    yield from of_keys(demand)
    yield from routers(chosen)


def _starts(demand: Demand) -> str:
    hosts = " and ".join(f"`armadico up --host {host}`" for host in demand.hosts)
    return f"{hosts} starts it" if hosts else UP


def routers(chosen: options.Mesh) -> Iterator[Finding]:
    """Whether the robot's router answers, if the mesh was not joined."""
    from armadico.mesh.sockets import answers

    table = chosen.endpoints().table
    for name, host in {} if table is None else table.hosts.items():
        if host.router is not None and not answers(host.router, REACH_S):
            todo = f"is it running (armadico up --host {name})? does a firewall block the port?"
            yield Finding(Sort.HOST, name, f"{name}: no answer on {host.router}", todo)


main: Final = Command(
    "armadico doctor",
    Options,
    run,
    "Check this machine and the society, and print what to do. The exit code is 0 if each check was"
    " made and passed, 1 if something is wrong, and 3 if nothing is wrong and something is not"
    " known. A note does not count.",
    EXAMPLES,
)
