"""Check this machine and the mesh, and say how to repair what is wrong."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from ctypes.util import find_library
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group
from armadico.config.discovery import providers
from armadico.mesh.topology import HOSTS_VARIABLE, MeshError, TopologyError

if TYPE_CHECKING:
    from armadico.config.hosts import Host
    from armadico.core.messages import Card, MonitorReport, RobotState
    from armadico.mobile.messages import BatteryLevel, Pose
    from armadico.observe.standing import Standing

OK, NOTE, WRONG = "ok", "note", "wrong"

CONTROLLER_PORT: Final = 8101
"""TCP port of `armadico sim` and MobileSim."""

LONGEST: Final = 60
"""Characters of a command line that are shown; the program is at its beginning."""

LISTEN_S: Final = 1.2
"""Within this time every description, truth, mission status and card has been received."""

LOW_SHARE: Final = 0.2
"""Below this share of the battery the finding says to charge it."""

REACH_S: Final = 0.5
"""Timeout for the router of a host."""

BEGIN: Final = "`armadico up` starts a society; --namespace, --hosts and --connect select another"

EXAMPLES: Final = """\
  armadico doctor
  armadico doctor --host lab1 --hosts hosts.toml      every machine of the host table, too
  armadico doctor --json | jq '.[] | select(.verdict == "wrong")'
"""


@dataclass(frozen=True)
class Finding:
    """The result of one check; `todo` says what to do about it."""

    subject: str
    verdict: str
    what: str
    todo: str = ""


@dataclass(frozen=True, kw_only=True)
class Options:
    json: bool = flag("print a JSON array")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    """Print all findings; returns 1 if something is wrong."""
    findings = []
    for finding in examine(args.mesh):
        findings.append(finding)
        if not args.json:
            _show(finding)
    wrong = [finding for finding in findings if finding.verdict == WRONG]
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        print(f"\n{len(wrong)} of {len(findings)} are wrong" if wrong else "\nnothing is wrong")
    return options.FAILED if wrong else 0


def examine(chosen: options.Mesh) -> Iterator[Finding]:
    yield from versions()
    yield from port()
    yield from router(chosen.namespace)
    received = yield from mesh(chosen)
    named = yield from hosts(chosen)
    yield clocks({**dict.fromkeys(named), **received})
    yield from serial_ports()
    yield from graphics()


def _show(finding: Finding) -> None:
    print(options.shown(f"{finding.verdict:<6} {finding.subject}: {finding.what}"))
    if finding.todo:
        print(options.shown(f"{'':<6} -> {finding.todo}"))


# This machine -------------------------------------------------------------------------------------


def versions() -> Iterator[Finding]:
    """Python and the required packages."""
    python = ".".join(map(str, sys.version_info[:3]))
    yield Finding("python", OK, f"{python}, {sys.executable}")
    try:
        required = requires("armadico") or []
    except PackageNotFoundError:
        yield Finding("armadico", WRONG, "is not installed", "pip install armadico")
        return
    yield Finding("armadico", OK, options.version())
    yield from _packages(required)


_EXTRAS: Final = (
    ("mcap", "record"),
    ("rerun-sdk", "dashboard"),
    ("matplotlib", "plot"),
    ("cyclonedds", "ros2"),
    ("foxglove-sdk", "foxglove"),
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
        yield Finding("packages", WRONG, what, "pip install --upgrade armadico")
    else:
        zenoh = next((has for name, has, _ in found if name == "eclipse-zenoh"), "unknown")
        what = f"all installed; eclipse-zenoh {zenoh} (must be the same on every host)"
        yield Finding("packages", OK, what)
    for name, extra in _EXTRAS:
        if name not in {there for there, _, _ in found}:
            todo = f"pip install 'armadico[{extra}]' if you need it"
            yield Finding(name, NOTE, f"is not installed ({extra})", todo)


def _is_off(requirement: str, has: str) -> bool:
    """Whether a requirement pins another version."""
    _, exact, pinned = requirement.partition("==")
    return bool(exact) and "*" not in pinned and pinned != has


def router(namespace: str) -> Iterator[Finding]:
    """Whether sockets can be created, and which process is the router of the namespace."""
    import psutil

    from armadico.mesh.sockets import holder, socket_of

    try:
        path = socket_of(namespace)
    except TopologyError as error:
        yield Finding("socket", WRONG, str(error))
        return
    there = holder(path)
    if there is None:
        yield Finding("socket", OK, f"{path}: no router of {namespace!r} on this machine")
        return
    try:
        words = called(psutil.Process(there.pid).cmdline())
    except psutil.Error:
        words = "a process"
    yield Finding("socket", OK, f"{path} is {words}'s (pid {there.pid})")


def port() -> Iterator[Finding]:
    """Whether the simulated controller's port is free."""
    owner = listener(CONTROLLER_PORT)
    what = "is free" if owner is None else f"is taken by {owner}"
    todo = "" if owner is None else "a second simulator needs `armadico sim --port 0`"
    yield Finding(f"port {CONTROLLER_PORT}", OK if owner is None else NOTE, what, todo)


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
        yield Finding("serial", WRONG, f"{', '.join(map(str, locked))}: permission denied", todo)
    if not found:
        yield Finding("serial", NOTE, "no serial port", "for a real robot, plug in its adapter")
    elif usable:
        yield Finding("serial", OK, ", ".join(map(str, usable[:8])))
    elif not locked:
        todo = "sudo usermod -aG dialout $USER, if a robot is on one of them"
        yield Finding("serial", NOTE, f"{len(found)} ports, permission denied", todo)


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
        yield Finding(
            "graphics", NOTE, "; ".join(lacks), "armadico dashboard --web needs no window"
        )
    else:
        yield Finding("graphics", OK, "display, Vulkan and a graphics device are available")


# The mesh -----------------------------------------------------------------------------------------


def mesh(chosen: options.Mesh) -> Generator[Finding, None, dict[str, float | None]]:
    """Whether the mesh can be joined, which agents are alive, and whether their protocol matches.

    Returns how far the clock of each agent's machine is ahead of this one's, s.
    """
    joined = chosen.join(starts=True)
    from armadico.core.resources import WHEELS
    from armadico.observe.hosts import census
    from armadico.observe.standing import standing
    from armadico.observe.view import View
    from armadico.observe.watching import Watcher, listen
    from armadico.runtime.client import Client

    try:
        with joined:
            client, watcher, view = Client(joined), Watcher([joined]), View()
            watcher.watch_alive()
            watcher.watch_router(view)
            watcher.subscribe()
            cards = client.cards()
            listen(watcher, view, LISTEN_S)
            now = watcher.clock() / 1e9
            strangers = view.strangers(now)
            linked, hung, missing = joined.wait_joined(0.0), joined.hung, joined.missing
    except (MeshError, TopologyError) as error:
        yield Finding("mesh", WRONG, str(error))
        return {}
    if not linked:
        what, _, todo = missing.partition("; ")
        yield Finding("mesh", WRONG if hung else NOTE, what, todo if hung else BEGIN)
        return {}
    if strangers:
        what = f"{', '.join(strangers)}: a second simulator in this namespace"
        yield Finding("sim/truth", WRONG, what, "end it, or give it its own --namespace")
    if not cards:
        yield Finding("mesh", NOTE, f"no agent is alive in namespace {chosen.namespace!r}", BEGIN)
        return {}
    yield Finding("mesh", OK, f"{len(cards)} agents")
    has_robot = any(card and WHEELS.name in card.owns for card in cards.values())
    if has_robot or view.cut_since is not None:
        yield stands(standing(view, now, providers, chosen.agents_by_host()))
    yield from () if view.state is None else robot(view.state, view.level)
    yield from () if view.pose is None else (pose(view.pose),)
    yield from monitors(view.reports.values())
    yield from _unanswered(cards)
    answered = [card for card in cards.values() if card is not None]
    yield from _faults(answered)
    robots = [card.instance for card in answered if WHEELS.name in card.owns]
    if len(robots) > 1:
        what = f"{len(robots)} robot agents in namespace {chosen.namespace!r}"
        yield Finding(WHEELS.name, WRONG, what, "give each robot its own --namespace")
    for key, publishers in View.of(cards).doubled.items():
        what = f"is published by {' and '.join(publishers)}: subscribers receive both"
        yield Finding(key, WRONG, what, "end one, or give it its own --namespace")
    return {host.name: host.clock_s for host in census(View.of(cards), {}, client.ahead)}


def _unanswered(cards: Mapping[tuple[str, str], Card | None]) -> Iterator[Finding]:
    """Agents that are alive but do not answer, or that use another protocol."""
    from armadico.core.messages import PROTOCOL

    for (name, instance), card in cards.items():
        if card is None:
            todo = "it hangs or cannot be reached from here: check the network, restart it"
            yield Finding(name, WRONG, f"{instance} is alive and does not answer", todo)
        elif card.protocol != PROTOCOL:
            what = f"uses protocol {card.protocol}; this machine uses {PROTOCOL}"
            yield Finding(name, WRONG, what, f"install the same armadico on {card.host}")


def _faults(cards: Iterable[Card]) -> Iterator[Finding]:
    """What agents report about themselves."""
    for card in cards:
        if card.fault:
            yield Finding(card.name, WRONG, card.fault, "repair that, and restart the society")
        if card.doubts:
            yield Finding(card.name, NOTE, card.doubts, "is it the right profile?")
        if card.learnt:
            yield Finding(card.name, OK, card.learnt)


def stands(found: Standing) -> Finding:
    """Whether the robot stands, and why, down to the missing agent."""
    from armadico.observe.standing import AT_FAULT, NO_FAULT

    cause, what = found.cause, " ".join(found.sentences)
    if cause is None or cause.sort in NO_FAULT:
        return Finding("standing", OK, what)
    return Finding("standing", WRONG if cause.sort in AT_FAULT else NOTE, what, cause.todo)


def robot(state: RobotState, level: BatteryLevel | None = None) -> Iterator[Finding]:
    """The battery, and errors on the controller's line."""
    from armadico.observe.view import battery

    if level is not None and level.share < LOW_SHARE and not state.charging:
        todo = "drive it into a dock, or plug a charger in"
        yield Finding("battery", NOTE, f"nearly empty: {battery(state, level)}", todo)
    else:
        yield Finding("battery", OK, battery(state, level))
    if state.line.summary:
        todo = "check cable, plugs, baud rate and batteries"
        yield Finding("line", NOTE, f"from the controller: {state.line.summary}", todo)
    else:
        yield Finding("line", OK, "no errors in the data from the controller")


def monitors(reports: Iterable[MonitorReport]) -> Iterator[Finding]:
    """What the active monitor reports as missing, and its last action; nothing without a monitor.

    The other monitors stand by.
    """
    received = list(reports)
    acting = [report for report in received if report.acts]
    standby = len(received) - len(acting)
    if received and not acting:
        what = f"{len(received)} stand by, and none is active: no agent is restarted"
        yield Finding("monitor", NOTE, what, "wait a second; then read their logs")
    for report in acting:
        note = f" ({report.note})" if report.note else ""
        if report.missing:
            todo = f"`armadico logs {report.missing[0]}` shows its log"
            what = f"missing: {', '.join(report.missing)}{note}"
            yield Finding("monitor", WRONG, what, todo)
        else:
            others = f", {standby} stand by" if standby else ""
            yield Finding("monitor", OK, f"{report.instance}: no agent is missing{note}{others}")


def pose(known: Pose) -> Finding:
    """The standard deviation of the robot's pose."""
    from armadico.mobile.behaviour import LOST_M

    if not known.covariance:
        todo = "run an agent that localizes on a map"
        return Finding("pose", NOTE, "its error is unknown: from odometry alone", todo)
    off = f"+-{known.deviation:.2f} m"
    if known.deviation > LOST_M:
        todo = "send a mission: the robot localizes first, then drives; is it on the map?"
        return Finding("pose", NOTE, f"the robot is lost: {off}", todo)
    return Finding("pose", OK, off)


def hosts(chosen: options.Mesh) -> Generator[Finding, None, set[str]]:
    """Whether the router of each host of the table answers; returns the hosts' names."""
    named = chosen.hosts or os.environ.get(HOSTS_VARIABLE)
    if chosen.host is None and named is None:
        yield Finding("hosts", OK, "no host table given: this machine only")
        return set()
    from armadico.config.hosts import load_hosts

    table = load_hosts(named).hosts
    for name, host in table.items():
        yield _host(name, host)
    return set(table)


def clocks(offsets: Mapping[str, float | None]) -> Finding:
    """Clock skew between machines.

    `offsets` is how far each machine's clock is ahead of this one's, s; None: no answer.
    """
    from armadico.observe.hosts import SKEW_S

    known = {name: offset for name, offset in offsets.items() if offset is not None}
    off = {name: offset for name, offset in known.items() if abs(offset) > SKEW_S}
    silent = ", ".join(sorted(set(offsets) - set(known)))
    todo = "run `timedatectl` or `chronyc tracking` on each machine"
    if off:
        skews = ", ".join(f"{name} {offset:+.0f} s" for name, offset in sorted(off.items()))
        return Finding(
            "clocks",
            NOTE,
            f"skew to this machine: {skews}. Driving does not depend on it, since clocks are never"
            " compared; the order of log lines of several machines does",
            todo,
        )
    if silent and len(offsets) > 1:
        return Finding("clocks", NOTE, f"unknown for {silent}: no agent answers there", todo)
    return Finding("clocks", OK, f"within {SKEW_S:g} s of this machine's, where known")


def _host(name: str, host: Host) -> Finding:
    if host.router is None:
        return Finding(f"host {name}", OK, "connects to the robot's router")
    from armadico.mesh.sockets import answers

    if answers(host.router, REACH_S):
        return Finding(f"host {name}", OK, f"answers on {host.router}")
    return Finding(
        f"host {name}",
        WRONG,
        f"no answer on {host.router}",
        f"is it running (armadico up --host {name})? does a firewall block the port?",
    )


main: Final = Command(
    "armadico doctor",
    Options,
    run,
    "Check this machine and the mesh, and print what to do. The exit code is 1 if something is"
    " wrong; a note does not count.",
    EXAMPLES,
)
