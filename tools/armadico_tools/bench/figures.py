"""The benchmarks of `armadico bench`, and their figures.

Machines are shared and noisy. So a figure is stated beside a baseline measured in the same run, in
turns with it; compare the ratio of both between machines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from statistics import median, quantiles
from typing import Final


@dataclass(frozen=True)
class Figure:
    """One row. p99 is the bad end: for a rate, where more is better, 99 of 100 values exceed it.

    A single measurement has no p99; a figure without comparison has no baseline.
    """

    name: str
    unit: str
    p50: float
    p99: float | None = None
    floor_p50: float | None = None
    floor_p99: float | None = None
    ratio: float | None = None  # p50 over the baseline's


@dataclass(frozen=True)
class Benchmark:
    """One benchmark: `function` ("module:name") receives whether to be quick."""

    name: str
    summary: str
    floor: str
    aim: str
    function: str

    def measure(self, quick: bool) -> list[Figure]:
        """Run it; its module is imported only now."""
        module, _, name = self.function.partition(":")
        measure: Callable[[bool], list[Figure]] = getattr(import_module(module), name)
        return measure(quick)


BENCHMARKS: Final = (
    Benchmark(
        "sip-to-command",
        "from a status packet's last byte to the motor command that it caused, through robot,"
        " encoder and goto as processes",
        "bare zenoh-python: as many hops between as many processes, TCP at both ends",
        "at most 1.5 times the floor at p50, 2 times at p99",
        "armadico_tools.bench.latency:sip_to_command",
    ),
    Benchmark(
        "sip-to-command-together",
        "the same, with all agents but the robot agent in one process",
        "the same floors: every agent in its own process",
        "at most 1.5 times the floor at p50, 2 times at p99",
        "armadico_tools.bench.latency:sip_to_command_together",
    ),
    Benchmark(
        "doors",
        "sip-to-command by the Unix socket, TCP and TLS, with keys and rights and without, in four"
        " societies at the same time",
        "the same without keys: the socket, or TCP",
        "TLS with rights at most 1.2 times TCP at p50",
        "armadico_tools.bench.doors:sip_to_command",
    ),
    Benchmark(
        "start-12",
        "from `armadico up` with keys until the tokens of twelve agents are seen",
        "the same without keys",
        "",
        "armadico_tools.bench.doors:start",
    ),
    Benchmark(
        "speed",
        "simulated seconds per second of the whole virtual society, by wall clock and by CPU time",
        "the simulated robot alone, with constant commands",
        "1.6 times commit c949985, run in turns; 200, at least 100",
        "armadico_tools.bench.computing:speed",
    ),
    Benchmark(
        "start",
        "from starting `armadico-agent goto` until another process sees its token",
        "bare Python that opens a Zenoh session and declares a token",
        "",
        "armadico_tools.bench.processes:start",
    ),
    Benchmark(
        "memory",
        "of one driving agent process: resident (rss) and private (uss)",
        "bare Python with Zenoh open",
        "",
        "armadico_tools.bench.processes:memory",
    ),
    Benchmark(
        "cpu",
        "of the society's processes at 10 Hz, driving sc1, in per cent of a core",
        "",
        "",
        "armadico_tools.bench.processes:cpu",
    ),
)
"""All benchmarks, in the order in which they run."""


def figure(
    name: str,
    unit: str,
    values: Sequence[float],
    floor: Sequence[float] = (),
    *,
    more_is_better: bool = False,
) -> Figure:
    """A figure, with its baseline if there is one. Raises ValueError without values."""
    if not values:
        raise ValueError(f"{name}: nothing was measured")

    def bad_end(of: Sequence[float]) -> float | None:
        if len(of) < 2:
            return None
        return quantiles(of, n=100, method="inclusive")[0 if more_is_better else 98]

    p50, floor_p50 = median(values), median(floor) if floor else None
    ratio = p50 / floor_p50 if floor_p50 else None
    return Figure(name, unit, p50, bad_end(values), floor_p50, bad_end(floor), ratio)


def show_trials(trials: Sequence[object], names: Sequence[str]) -> None:
    """Print trials, and the median and the largest of these of their fields."""
    for trial in trials:
        print(trial)
    for name in names:
        values = sorted(getattr(trial, name) for trial in trials)
        print(f"{name}: p50 {values[len(values) // 2]:.3f}, worst {values[-1]:.3f}")
