"""The price of closed doors: sensor to motor by socket, TCP and TLS, and the start of a society.

Societies with and without keys run at the same time, so other load affects all alike. Their agents
join by the Unix socket, or by the port as if they ran on another computer.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import Final, NamedTuple

from armadico.bridge.simulator.server import TcpLine
from armadico.config.endpoints import Endpoints
from armadico.core.cycles import PERIOD
from armadico.launch.client import Client
from armadico.launch.processes import agent_words, command_line
from armadico.launch.society import Options, members
from armadico.mesh.door import person
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico_tools.bench.figures import Figure, figure
from armadico_tools.bench.latency import (
    AGENTS,
    DRIVE,
    GOAL,
    Stopwatch,
    await_all,
    pioneer,
    simulated,
)
from armadico_tools.bench.processes import started
from armadico_tools.testbed import Place

TWELVE: Final = (
    *("robot", "encoder", "sonar", "localization", "goto", "avoid", "gothrough"),
    *("path-planning", "interface", "monitor", "teleop", "mission-planning"),
)
SOON_S: Final = 60.0


class Way(NamedTuple):
    """How the agents of one society join."""

    name: str
    protocol: str  # of the robot's port
    by_port: bool


SOCKET, SOCKET_KEYS = Way("socket", "tcp", False), Way("socket-keys", "tls", False)
TCP, TLS = Way("tcp", "tcp", True), Way("tls-keys", "tls", True)


def sip_to_command(quick: bool) -> list[Figure]:
    """The four ways at the same time; each with keys beside the same without."""
    wanted = 20 + (80 if quick else 400)
    ways = (SOCKET, SOCKET_KEYS, TCP, TLS)
    with ExitStack() as stack:
        place = stack.enter_context(Place("doors"))
        watches = [
            stack.enter_context(_driving(place, way, index / len(ways)))
            for index, way in enumerate(ways)
        ]
        for watch in watches:  # the first ones while the others started
            watch.latencies.clear()
        socket, socket_keys, tcp, tls = await_all([w.latencies for w in watches], wanted)
    return [
        figure("sip-to-command-socket-keys", "ms", socket_keys, socket),
        figure("sip-to-command-tcp", "ms", tcp, socket),
        figure("sip-to-command-tls-keys", "ms", tls, tcp),
    ]


def start(quick: bool) -> list[Figure]:
    """From `armadico up` until the tokens of twelve agents are seen, with keys and without."""
    times: dict[Way, list[float]] = {SOCKET: [], SOCKET_KEYS: []}
    with Place("doors") as place:
        tables = {way: place.table(way.name, way.protocol, TWELVE) for way in times}
        for _ in range(2 if quick else 5):
            for way, taken in times.items():
                taken.append(_started(place, tables[way]))
    return [figure("start-12-keys", "s", times[SOCKET_KEYS], times[SOCKET])]


def _started(place: Place, where: Endpoints) -> float:
    besides = [word for name in ("teleop", "mission-planning") for word in ("--with", name)]
    words = ["up", "sc4", *besides, "--namespace", where.namespace, *where.words]
    with closing(where.mesh(starts=True)) as mesh:
        mesh.open()
        client = Client(mesh)
        began = time.monotonic()
        with started(command_line(words, tied=True)):
            place.until(client, lambda: {n for n, _ in client.alive} >= {*TWELVE}, "the society")
            return time.monotonic() - began


@contextmanager
def _driving(place: Place, way: Way, phase: float) -> Iterator[Stopwatch]:
    """A society of its own whose robot drives down a corridor.

    Its cycles begin at this share of the others' period, so that they do not wait for one another.
    """
    with ExitStack() as stack:
        where = place.table(way.name, way.protocol, ("robot", *AGENTS))
        (router,) = where.known
        line = TcpLine("127.0.0.1", 0)
        stack.callback(line.close)
        watch = Stopwatch(line)
        time.sleep((phase * PERIOD - time.monotonic()) % PERIOD)
        stack.enter_context(simulated(pioneer(), watch))
        for member in members(DRIVE, Options(), f"tcp://127.0.0.1:{line.port}"):
            words = [*agent_words([member], where.namespace), *where.words]
            if way.by_port and member.name != "robot":
                words += ["--connect", router]
            stack.enter_context(started(command_line(words, tied=True)))
        mesh = stack.enter_context(closing(where.mesh(person(), starts=True)))
        mesh.open()
        client = Client(mesh)
        names = {"robot", *AGENTS}
        place.until(client, lambda: {n for n, _ in client.alive} >= names, f"society {way.name}")
        request = MissionRequest(Waypoint(*GOAL), planned=False)
        client.request_mission(request, again=SOON_S)
        mesh.close()  # so that no guest receives
        yield watch
