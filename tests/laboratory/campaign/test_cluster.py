"""A cluster gives what this computer gives, and refuses what would not be the same."""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import closing, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from msgspec.structs import replace

from armadico.cli import pool
from armadico.cli.options import UsageError
from armadico_tools.campaign import cluster
from armadico_tools.campaign.cluster import OtherCodeError, differences, identity, run_checked
from armadico_tools.commands import experiment, faults
from armadico_tools.series import over
from tests.programs import SOON, starter

ROOT = Path(__file__).parents[3]
TWO = """\
title = "Two controllers"
[[rows]]
scenario = "sc1"
[[arms]]
name = "fast"
controller = "fast"
[[arms]]
name = "all"
"""


def free_port() -> int:
    with closing(socket.socket()) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler with two workers of their own processes."""
    port, env = free_port(), os.environ | {"PYTHONPATH": str(ROOT)}
    usual = {"cwd": tmp_path, "stdout": None, "stderr": None}
    with starter([sys.executable, "-m", "distributed.cli.dask_scheduler"], env, **usual) as start:
        start("--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        first = [sys.executable, "-m", "distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}"]
        with starter(first, env, **usual) as worker:
            for _ in range(2):
                worker("--nthreads", "1", "--no-nanny", "--no-dashboard")
            from distributed import Client

            with Client(f"tcp://127.0.0.1:{port}", timeout=SOON) as client:
                client.wait_for_workers(2, timeout=SOON)
            yield f"127.0.0.1:{port}"


def squared(item: tuple[Path, int]) -> int:
    """A run; the first process that gets to the fourth one is killed in it."""
    folder, number = item
    if number == 3 and folder.is_dir():
        try:
            (folder / "killed").touch(exist_ok=False)
        except FileExistsError:
            return 9
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def test_a_killed_worker_loses_nothing_and_the_results_are_the_local_ones(
    address: str, tmp_path: Path
) -> None:
    here = pool.over(squared, [(Path("nowhere"), n) for n in range(40)], 1, "squares")
    kept: list[int] = []
    with cluster.dask(address, None) as where:
        items = [(tmp_path, n) for n in range(40)]
        there = pool.over(squared, items, where, "squares", lambda _, found: kept.append(found))
    assert (tmp_path / "killed").exists()
    assert there == here
    assert sorted(kept) == here


@pytest.mark.long
def test_ctrl_c_cancels_what_is_handed_out(address: str, tmp_path: Path) -> None:
    def interrupt(_item: object, _result: object) -> None:
        raise KeyboardInterrupt

    from distributed import Client

    with cluster.dask(address, None) as where, pytest.raises(KeyboardInterrupt):
        pool.over(squared, [(tmp_path, n) for n in range(100, 1000)], where, "squares", interrupt)
    with Client(f"tcp://{address}", timeout=SOON) as client:
        assert not client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks))


@pytest.mark.long
def test_a_series_ends_with_its_scheduler_and_keeps_what_is_known(
    address: str, tmp_path: Path
) -> None:
    ended: list[int] = []

    def end(item: tuple[Path, int], _result: object) -> None:
        if not ended:
            (there,) = (
                one
                for one in psutil.Process().children(recursive=True)
                if "distributed.cli.dask_scheduler" in one.cmdline()
            )
            there.kill()
        ended.append(item[1])

    items = [(tmp_path, n) for n in range(100, 1000)]
    with cluster.dask(address, None) as where:
        assert not over(squared, items, where, "squares", end)
    assert 0 < len(ended) < len(items)


@pytest.mark.long
def test_an_experiment_on_a_cluster_has_the_bytes_of_one_here(address: str, tmp_path: Path) -> None:
    file = tmp_path / "two.toml"
    file.write_text(TWO, encoding="utf-8")
    for out, where in (("here", ["--jobs", "1"]), ("there", ["--on", f"dask://{address}"])):
        words = [str(file), "--runs", "2", *where, "--out", str(tmp_path / out)]
        assert experiment.main(words) == 3, "of two runs nothing can be concluded"
    for name in ("runs.csv", "table.md"):
        here, there = (tmp_path / out / "two" / name for out in ("here", "there"))
        assert here.read_bytes() == there.read_bytes()


# What is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--on", "dusk://127.0.0.1:8786"], "'dusk'.*did you mean dask|dusk.*known: dask, slurm"),
        (["--on", "dask://127.0.0.1"], "HOST:PORT"),
        (["--on", "dask://127.0.0.1:8786", "--jobs", "3"], "--jobs"),
        (["--on", "slurm://here"], "without an address"),
    ],
)
def test_a_wrong_cluster_is_refused_before_anything_is_written(
    words: list[str], expected: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=expected):
        experiment.main(["table-5.1", *words, "--out", str(tmp_path / "results")])
    assert not (tmp_path / "results").exists()


def test_a_scheduler_that_is_not_there_is_named(tmp_path: Path) -> None:
    given = f"dask://127.0.0.1:{free_port()}"
    with pytest.raises(UsageError, match=f"{given}: no scheduler answers"):
        faults.main(["--seeds", "1", "--on", given, "--out", str(tmp_path)])


@pytest.mark.long
def test_what_answers_nothing_is_not_waited_for_for_ever() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(UsageError, match="no scheduler"), cluster.dask(address, None):
            pass


def versions(scheduler: str = "1", worker: str = "1") -> dict[str, Any]:
    def of(number: str) -> dict[str, Any]:
        return {"packages": {"distributed": number, "dask": "1"}}

    return {"client": of("1"), "scheduler": of(scheduler), "workers": {"tcp://w:1": of(worker)}}


def client(**changes: Any) -> Any:
    """A client whose scheduler answers this."""
    said = {"versions": versions(), "workers": {"tcp://w:1": {"nthreads": 1}}} | changes
    theirs = said.get("theirs", identity())
    return SimpleNamespace(
        get_versions=lambda: said["versions"],
        scheduler_info=lambda n_workers: {"workers": said["workers"]},
        run=lambda function, on_error: {"tcp://w:1": theirs},
    )


OTHER = replace(identity(), commit="0123456789ab", packages=identity().packages | {"numpy": "1.0"})


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ({"versions": versions(scheduler="2")}, "scheduler has distributed 2; here it is 1"),
        ({"versions": versions(worker="2")}, "tcp://w:1 has distributed 2"),
        ({"workers": {}}, "no workers"),
        ({"workers": {"tcp://w:1": {"nthreads": 8}}}, "tcp://w:1 has 8 threads"),
        ({"theirs": OTHER}, f"commit 0123456789ab there, {identity().commit}"),
        ({"theirs": OTHER}, "numpy 1.0 there"),
        ({"theirs": ModuleNotFoundError("No module named 'armadico_tools'")}, "armadico_tools"),
    ],
)
def test_workers_of_other_versions_are_refused_with_both(
    answers: dict[str, Any], expected: str
) -> None:
    cluster.check(client(), "--on x")
    with pytest.raises(UsageError, match=expected.replace("+", r"\+")):
        cluster.check(client(**answers), "--on x")


def test_a_worker_that_starts_together_with_its_scheduler_is_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    workers: dict[str, Any] = {}
    found = client(workers=workers)
    found.wait_for_workers = lambda n, timeout: workers.update({"tcp://w:1": {"nthreads": 1}})

    async def there(_address: str) -> None:
        return None

    monkeypatch.setattr(cluster, "_scheduler_at", there)
    monkeypatch.setattr(cluster, "_connected", lambda _to, _given: nullcontext(found))
    with cluster.dask("127.0.0.1:1", None) as made:
        assert made is not None


def test_an_installed_package_without_a_commit_is_compared_by_its_files() -> None:
    installed = replace(identity(), commit="none")
    assert not differences(identity(), installed)
    assert "source" in differences(identity(), replace(installed, source="0"))


def test_a_worker_that_joins_later_with_other_code_runs_nothing() -> None:
    assert run_checked(identity(), abs, -1) == 1
    with pytest.raises(OtherCodeError, match="0123456789ab"):
        run_checked(OTHER, abs, -1)


# Slurm: a worker a job ---------------------------------------------------------------------------

SBATCH = """\
#!/bin/sh
# What Slurm does with a script, on this computer: keep a copy and run it, in a session of its own.
job=$(mktemp "$(dirname "$0")/job.XXXXXX")
cat "$1" > "$job"
setsid sh "$job" > "$job.log" 2>&1 &
echo "Submitted batch job $!"
"""
SCANCEL = """\
#!/bin/sh
for job in "$@"; do kill -- "-$job"; done
"""


@pytest.fixture
def batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in front of PATH with Slurm's two commands; the jobs' scripts are put there."""
    folder = tmp_path / "slurm"
    folder.mkdir()
    for name, script in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (folder / name).write_text(script, encoding="utf-8")
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(tmp_path)  # the workers' own files
    return folder


def test_slurms_jobs_are_workers_that_give_what_this_computer_gives_and_end_with_it(
    batch: Path,
) -> None:
    import dask.config
    import dask_jobqueue  # noqa: F401  # which adds its defaults to the configuration for good

    here = pool.over(squared, [(Path("nowhere"), n) for n in range(40)], 1, "squares")
    configured = {"jobqueue.slurm.memory": "1GB", "jobqueue.slurm.queue": "long"}
    with dask.config.set(configured), cluster.slurm("", 2) as where:
        there = pool.over(squared, [(Path("nowhere"), n) for n in range(40)], where, "squares")
        jobs = [path for path in batch.glob("job.*") if path.suffix != ".log"]
        workers = [
            one
            for one in psutil.process_iter(["cmdline"])
            if str(batch) in " ".join(one.info["cmdline"] or [])
        ]
    assert there == here
    assert jobs
    for job in jobs:
        script = job.read_text(encoding="utf-8")
        assert "#SBATCH -p long" in script
        assert "--nthreads 1" in script
        assert sys.executable in script
    assert workers
    psutil.wait_procs(workers, timeout=SOON)
    assert not any(one.is_running() for one in workers)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (None, "no command sbatch here"),
        ("echo 'invalid partition specified: long' >&2; exit 1", "invalid partition specified"),
    ],
)
def test_jobs_that_slurm_refuses_are_an_error_and_not_waited_for(
    batch: Path, command: str | None, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (batch / "sbatch").unlink()
    if command is not None:
        (batch / "sbatch").write_text(f"#!/bin/sh\n{command}\n", encoding="utf-8")
        (batch / "sbatch").chmod(0o755)
    with pytest.raises(UsageError, match=said), cluster.slurm("", 2):
        pass
    assert "Traceback" not in capfd.readouterr().err
