"""The cost of processes: to start, and while driving; beside bare ones.

A benchmark that is killed leaves no processes: agents are tied to it, a floor ends with its input.
"""

from __future__ import annotations

import queue
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import psutil

from armadico.config.scenarios import load_scenario, with_sensors
from armadico.core.services import TOKEN
from armadico.launch.local import Launcher
from armadico.launch.processes import SIMULATOR, command_line
from armadico.launch.programs import end
from armadico.launch.society import Options
from armadico.mesh import sockets
from armadico_tools.bench.figures import Figure, figure
from armadico_tools.testbed import Place

FLOOR: Final = Path(__file__).with_name("floor.py")


@contextmanager
def started(command: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A process that ends with the `with` block."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches this process only, which ends them
    )
    try:
        yield process
    finally:
        end(process)


@contextmanager
def floor_socket() -> Iterator[str]:
    """A Unix socket for a floor's router and its clients, as an endpoint."""
    with TemporaryDirectory(prefix="armadico-floor-") as folder:
        yield sockets.endpoint(Path(folder) / "floor.sock")


def floor(*arguments: str) -> list[str]:
    """The command line of a floor's process."""
    return [sys.executable, "-P", str(FLOOR), *arguments]


@contextmanager
def ready_floor(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A floor's process that has printed `ready`. Raises RuntimeError if it does not."""
    with started(floor(*arguments)) as process:
        assert process.stdout is not None, "it is a pipe"
        if process.stdout.readline().strip() != b"ready":
            raise RuntimeError(f"the floor did not start: {process.args!r}")
        yield process


# Start --------------------------------------------------------------------------------------------

SEEN_S: Final = 20.0
"""Time limit for an agent's token."""


def start(quick: bool) -> list[Figure]:
    """From starting the process to its token, the agent and the floor in turns."""
    whole, bare = [], []
    with Place("bench") as place, closing(place.mesh(router=True)) as mesh:
        changes: queue.SimpleQueue[tuple[tuple[str, bool], float]] = queue.SimpleQueue()
        mesh.watch_alive(
            lambda name, _, there: changes.put(((name, there), time.monotonic()))  # on its thread
        )
        key = f"{place.namespace}/{TOKEN.format(name='floor', instance='floor-1')}"
        agent = command_line(["agent", "goto", "--namespace", place.namespace], tied=True)
        bare_python = floor("token", "-", sockets.endpoint(sockets.socket_of(place.namespace)), key)

        def wait_for(wanted: tuple[str, bool]) -> float:
            """When the change was received."""
            while True:
                try:
                    change, at = changes.get(timeout=SEEN_S)
                except queue.Empty:
                    raise TimeoutError(f"{wanted[0]} was not seen within {SEEN_S:.0f} s") from None
                if change == wanted:
                    return at

        def once(name: str, command: Sequence[str]) -> float:
            began = time.monotonic()
            with started(command):
                seen = wait_for((name, True))
            wait_for((name, False))
            return seen - began

        for _ in range(4 if quick else 12):
            whole.append(once("goto", agent))
            bare.append(once("floor", bare_python))
    return [figure("start", "s", whole, bare)]


# Drive --------------------------------------------------------------------------------------------

SCENARIO: Final = "sc1"
FROM_S: Final = 2.0
"""When measuring begins, after the mission; sc1 takes 18 s."""

FLOORS: Final = 3
"""Number of bare processes for the baseline of memory."""

MEGA: Final = 1e6


class Use(NamedTuple):
    """The use of one process: CPU time over wall time, and memory in MB."""

    name: str
    share: float
    rss: float
    uss: float


def memory(quick: bool) -> list[Figure]:
    """Memory of each agent process; p99 is nearly the largest."""
    agents = [use for use in drive(quick) if use.name != SIMULATOR]
    bare = _bare_memory()
    return [
        figure("memory-rss", "MB", [a.rss for a in agents], [rss for rss, _ in bare]),
        figure("memory-uss", "MB", [a.uss for a in agents], [uss for _, uss in bare]),
    ]


def cpu(quick: bool) -> list[Figure]:
    """CPU time of all agents, the largest of them, and the simulator, which is not included."""
    shares = {use.name: 100.0 * use.share for use in drive(quick)}
    simulator = shares.pop(SIMULATOR)
    return [
        figure("cpu", "%", [sum(shares.values())]),
        figure("cpu-largest", "%", [max(shares.values())]),
        figure("cpu-simulator", "%", [simulator]),
    ]


@cache  # one drive serves all figures
def drive(quick: bool) -> tuple[Use, ...]:
    """The use of each process while driving."""
    scenario = with_sensors(load_scenario(SCENARIO), "real")  # the whole society
    with (
        Place("bench") as place,
        closing(place.mesh()) as mesh,
        Launcher(scenario, Options(), mesh, place.namespace, tied=True) as launcher,
    ):
        launcher.start()
        launcher.begin()
        launcher.client.wait_for(lambda: False, FROM_S)
        here = {p.name: psutil.Process(p.popen.pid) for p in launcher.processes}
        before = {name: process.cpu_times() for name, process in here.items()}
        since = time.monotonic()
        launcher.client.wait_for(lambda: False, 5.0 if quick else 12.0)
        wall = time.monotonic() - since
        return tuple(_use(name, here[name], before[name], wall) for name in here)


def _use(name: str, process: psutil.Process, before: Any, wall: float) -> Use:
    now, size = process.cpu_times(), process.memory_full_info()
    spent = now.user + now.system - before.user - before.system
    return Use(name, spent / wall, size.rss / MEGA, size.uss / MEGA)


def _bare_memory() -> list[tuple[float, float]]:
    """Python with Zenoh open and nothing else, clients of a router: rss and uss, MB."""
    sizes = []
    with ExitStack() as stack:
        socket = stack.enter_context(floor_socket())
        stack.enter_context(ready_floor("token", socket, "-", "-"))
        for _ in range(FLOORS):
            process = stack.enter_context(ready_floor("token", "-", socket, "-"))
            size = psutil.Process(process.pid).memory_full_info()
            sizes.append((size.rss / MEGA, size.uss / MEGA))
    return sizes
