"""`armadico bench`: what it offers and the shape of what it says; never how long anything took."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable

import psutil
import pytest

from armadico.cli.options import FailedError
from armadico_tools.bench import figures
from armadico_tools.bench.figures import BENCHMARKS, Benchmark, Figure, figure
from armadico_tools.commands.bench import main
from tests.programs import BIN, Done, call

KEYS = ["name", "unit", "p50", "p99", "floor_p50", "floor_p99", "ratio"]
NAMES = [benchmark.name for benchmark in BENCHMARKS]


def bench(*words: str) -> Done:
    return call("bench", *words)


WITH = {"cpu": ["memory", "cpu"]}
"""One drive does for memory and cpu; together the agents are measured by the same code."""

LEFT_OUT = {"memory", "sip-to-command-together"}

WITHIN = 110.0
"""s; a deadline, not an expectation."""


@pytest.mark.long
@pytest.mark.live
@pytest.mark.parametrize("name", [name for name in NAMES if name not in LEFT_OUT])
def test_each_benchmark_gives_figures(name: str) -> None:
    done = call("bench", *WITH.get(name, [name]), "--quick", "--json", within=WITHIN)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert rows or "is left out" in done.stderr
    assert all(list(row) == KEYS for row in rows)
    assert all(row["p50"] > 0.0 for row in rows)


def measured(quick: bool) -> list[Figure]:
    return [figure("measured", "s", [2.0])]


def unmeasured(quick: bool) -> list[Figure]:
    raise TimeoutError("was not seen within 20 s")


def interrupted(quick: bool) -> list[Figure]:
    raise KeyboardInterrupt


def benchmarks(*functions: Callable[[bool], list[Figure]]) -> tuple[Benchmark, ...]:
    return tuple(
        Benchmark(each.__name__, "", "", "", f"{each.__module__}:{each.__name__}")
        for each in functions
    )


def test_a_benchmark_that_fails_costs_no_other_figure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(figures, "BENCHMARKS", benchmarks(unmeasured, measured, unmeasured))
    with pytest.raises(FailedError) as failed:
        main(["--json"])
    assert str(failed.value).splitlines() == ["unmeasured: was not seen within 20 s"] * 2
    rows = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in rows] == ["measured"]
    assert [list(row) for row in rows] == [KEYS]


def test_an_interrupted_run_shows_the_figures_that_it_has(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(figures, "BENCHMARKS", benchmarks(measured, interrupted))
    with pytest.raises(KeyboardInterrupt):
        main([])
    assert "measured" in capsys.readouterr().out


def words(process: psutil.Process) -> list[str]:
    """Its command line; none if it is gone by now."""
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


@pytest.mark.long
@pytest.mark.live
@pytest.mark.parametrize("name", ["start", "sip-to-command"])
def test_a_benchmark_that_is_killed_leaves_nobody_running(name: str) -> None:
    with subprocess.Popen(
        [str(BIN / "armadico"), "bench", name, "--quick"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as killed:
        started: list[psutil.Process] = []
        while not any("goto" in words(process) for process in started):
            assert killed.poll() is None
            started = psutil.Process(killed.pid).children(recursive=True)
        killed.kill()
    _, left = psutil.wait_procs(started, timeout=20)
    for process in left:
        process.kill()
    assert not left


def test_what_was_measured_once_has_no_p99_and_without_a_floor_there_is_no_ratio() -> None:
    alone = figure("a", "s", [2.0])
    assert (alone.p99, alone.floor_p50, alone.ratio) == (None, None, None)
    assert figure("a", "s", [2.0], [4.0]).ratio == 0.5
    with pytest.raises(ValueError, match="nothing was measured"):
        figure("a", "s", [])
