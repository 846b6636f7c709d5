"""What the society costs while it drives: memory and processor time of real processes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from typing import Any, Final, NamedTuple

import psutil

from armadico.config.scenarios import load_scenario, with_sensors
from armadico.launch.local import Launcher
from armadico.launch.processes import SIMULATOR
from armadico.launch.society import Options
from armadico_tools.bench.figures import Figure, Tell, figure
from armadico_tools.bench.processes import floor_socket, ready_floor
from armadico_tools.testbed import Place

SCENARIO: Final = "sc1"
FROM_S: Final = 2.0
"""When counting begins, after the mission; sc1 takes 18 s."""

FLOORS: Final = 3
"""Bare processes whose memory is the floor."""

MEGA: Final = 1e6

_driven: dict[bool, tuple[Use, ...]] = {}
"""One drive does for all figures."""


class Use(NamedTuple):
    """What one process used: CPU time over wall time, and memory in MB."""

    name: str
    share: float
    rss: float
    uss: float


def memory(quick: bool, tell: Tell) -> list[Figure]:
    """Of each agent process; p99 is the largest of them, nearly."""
    agents = _agents(drive(quick, tell))
    bare = _bare_memory()
    return [
        figure("memory-rss", "MB", [a.rss for a in agents], [rss for rss, _ in bare]),
        figure("memory-uss", "MB", [a.uss for a in agents], [uss for _, uss in bare]),
    ]


def cpu(quick: bool, tell: Tell) -> list[Figure]:
    """The agents together, the largest of them, and the simulator, which is no part of them."""
    uses = drive(quick, tell)
    agents = [100.0 * use.share for use in _agents(uses)]
    simulators = [100.0 * use.share for use in uses if use.name == SIMULATOR]
    return [
        figure("cpu", "%", [sum(agents)]),
        figure("cpu-largest", "%", [max(agents)]),
        figure("cpu-simulator", "%", simulators),
    ]


def _agents(uses: Sequence[Use]) -> list[Use]:
    return [use for use in uses if use.name != SIMULATOR]


def drive(quick: bool, tell: Tell) -> tuple[Use, ...]:
    """What each process used while it drove."""
    if quick not in _driven:
        _driven[quick] = _drive(quick, tell)
    return _driven[quick]


def _drive(quick: bool, tell: Tell) -> tuple[Use, ...]:
    seconds = 5.0 if quick else 12.0
    scenario = with_sensors(load_scenario(SCENARIO), "real")  # the whole society
    with (
        Place("bench") as place,
        closing(place.mesh()) as mesh,
        Launcher(scenario, Options(), mesh, place.namespace, tied=True) as launcher,
    ):
        launcher.start()
        launcher.begin()
        started = time.monotonic()

        def until(end_s: float) -> None:
            while (gone := time.monotonic() - started) < end_s:
                tell(gone / (FROM_S + seconds))
                launcher.client.wait_for(lambda: False, 0.2)

        until(FROM_S)
        here = {p.name: psutil.Process(p.popen.pid) for p in launcher.processes}
        before = {name: process.cpu_times() for name, process in here.items()}
        since = time.monotonic()
        until(FROM_S + seconds)
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
