"""Dask's distributed scheduler as the pool of a series: `--on dask://HOST:PORT` and `--on slurm`.

The scheduler hands the runs of a lost worker to another one, and this module streams results back.
Workers must have the same code and versions as this process: a worker that joins in the middle is
checked too, before it runs anything. Dask's workers execute what a client sends, so scheduler and
workers belong on a network of people who may do that.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Final, TypeVar

from msgspec import Struct, to_builtins
from msgspec.structs import replace

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.pool import Results
from armadico.observe.conditions import packages, software

if TYPE_CHECKING:
    from distributed import Client, Future
    from distributed.deploy import Cluster as DaskCluster

T = TypeVar("T")
R = TypeVar("R")

CONNECT_S: Final = 5.0
"""Longest time to reach a scheduler."""

AHEAD: Final = 2
"""Runs that are handed out for each thread: the next one is there when one ends."""

FIRST_S: Final = 30.0
"""Longest time to wait for a first worker."""

CHECK_S: Final = 2.0
"""How often the scheduler is asked whether it still has workers."""

ALONE_S: Final = 30.0
"""After so long without a worker a message says so, and the series waits on."""

SLURM_JOBS: Final = 8


# Sameness -----------------------------------------------------------------------------------------


class Identity(Struct, frozen=True):
    """What must be the same in all processes, or results may differ in the last digit."""

    version: str
    commit: str
    source: str
    tools: str  # a hash of this distribution's modules
    python: str
    platform: str
    packages: dict[str, str]


@cache
def identity() -> Identity:
    """That of this process."""
    here, found = software(), sha256()
    root = Path(__file__).parent.parent
    for path in sorted(root.rglob("*.py")):
        found.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return Identity(
        version=here.version,
        commit=here.commit,
        source=here.source,
        tools=found.hexdigest()[:16],
        python=here.python,
        platform=here.platform,
        packages=here.packages | packages(("cmaes", "scipy")),
    )


class OtherCodeError(FailedError):
    """A worker has other code than who hands out the runs."""


def differences(ours: Identity, theirs: Identity) -> str:
    """In what two processes differ, with both values; "" if in nothing.

    An installed package knows no commit; then the hashes of its files decide.
    """
    if "none" in (ours.commit, theirs.commit):
        ours, theirs = (replace(each, commit="none") for each in (ours, theirs))
    one, other = _flat(ours), _flat(theirs)
    names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    return "; ".join(
        f"{name} {other.get(name, 'none')} there, {one.get(name, 'none')} here" for name in names
    )


def _flat(of: Identity) -> dict[str, str]:
    found: dict[str, Any] = to_builtins(of)
    packages: dict[str, str] = found.pop("packages")
    return found | packages


def run_checked(ours: Identity, function: Callable[[T], R], item: T) -> R:
    """Apply a function on a worker with the same code. Raises OtherCodeError."""
    if fault := differences(ours, identity()):
        raise OtherCodeError(f"a worker that joined has other code: {fault}")
    return function(item)


# The pool -----------------------------------------------------------------------------------------


class Cluster:
    """The workers of a scheduler, as a `Pool`."""

    def __init__(self, client: Client, where: str) -> None:
        """`where` names the scheduler in messages."""
        self._client, self._where = client, where
        self._alone_since: float | None = None

    def results(self, function: Callable[[T], R], items: Sequence[T]) -> Results[R]:
        """See `Pool`. Raises BrokenExecutor if the scheduler is gone."""
        from distributed import KilledWorker

        ours, waiting = identity(), iter(enumerate(items))
        running: dict[Future[R], int] = {}
        try:
            while True:
                room = max(AHEAD * self._threads(), 1) - len(running)
                for index, item in islice(waiting, max(room, 0)):
                    future = self._client.submit(run_checked, ours, function, item, pure=False)
                    running[future] = index
                if not running:
                    return
                for future in self._finished(running):
                    index = running.pop(future)
                    yield index, future.result()
        except KilledWorker as error:
            raise FailedError(
                f"{self._where}: several workers were killed by one run ({error}); is their memory"
                " large enough?"
            ) from None
        except (CancelledError, OSError) as error:
            if self._client.status == "running" and isinstance(error, OSError):
                raise  # the run's own
            raise BrokenExecutor(f"the scheduler {self._where} is gone") from None
        finally:
            with suppress(Exception):
                self._client.cancel(list(running), force=True)

    def _finished(self, running: Mapping[Future[R], int]) -> list[Future[R]]:
        """The futures that are done; waits for one."""
        from distributed import wait

        while True:
            with suppress(TimeoutError):
                done = wait(list(running), timeout=CHECK_S, return_when="FIRST_COMPLETED").done
                self._alone_since = None
                return [future for future in running if future in done]
            self._watch()

    def _watch(self) -> None:
        """Say it once if there are no workers. Raises BrokenExecutor without a scheduler."""
        if self._client.status != "running":
            raise BrokenExecutor(f"the scheduler {self._where} is gone")
        now = time.monotonic()
        if self._threads():
            self._alone_since = None
        elif self._alone_since is None:
            self._alone_since = now
        elif now - self._alone_since > ALONE_S:
            self._alone_since = float("inf")
            options.report(f"{self._where} has no workers: waiting for one; Ctrl-C ends this")

    def _threads(self) -> int:
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        return sum(worker["nthreads"] for worker in workers.values())


@contextmanager
def dask(address: str, jobs: int | None) -> Iterator[Cluster]:
    """The workers of a running scheduler, HOST:PORT. Raises UsageError."""
    options.need("distributed", "cluster", of="armadico-tools")
    given = f"--on dask://{address}"
    host, colon, port = address.rpartition(":")
    if not (host and colon and port.isdecimal()):
        raise UsageError(f"{given}: expected dask://HOST:PORT, such as dask://10.0.0.5:8786")
    if jobs is not None:
        raise UsageError(f"--jobs is not used with {given}: the scheduler's workers run the series")
    try:
        asyncio.run(_scheduler_at(f"tcp://{address}"))
    except (OSError, TimeoutError, ValueError) as error:
        why = f" ({error})" if str(error) else ""
        raise UsageError(
            f"{given}: no scheduler answers within {CONNECT_S:.0f} s{why}; start one:"
            " dask scheduler"
        ) from None
    with _connected(f"tcp://{address}", given) as client:
        await_worker(client)
        check(client, given)
        yield Cluster(client, f"dask://{address}")


async def _scheduler_at(address: str) -> None:
    """Raises OSError or TimeoutError. A `Client` waits for ever for what answers otherwise."""
    from distributed import rpc

    async with asyncio.timeout(CONNECT_S):
        async with rpc(address, timeout=CONNECT_S - 1.0) as scheduler:
            await scheduler.identity()


@contextmanager
def slurm(address: str, jobs: int | None) -> Iterator[Cluster]:
    """Jobs of Slurm, a worker each, as dask-jobqueue's own configuration has it."""
    options.need("dask_jobqueue", "cluster", of="armadico-tools")
    if address:
        raise UsageError(f"--on slurm://{address}: expected --on slurm, without an address")
    answers, jobs = SimpleQueue[str](), jobs or SLURM_JOBS
    with _slurm_cluster(answers) as cluster:
        cluster.scale(jobs=jobs)
        options.report(f"--on slurm: {jobs} jobs are submitted")
        for _ in range(jobs):
            if refused := answers.get():
                raise UsageError(f"--on slurm: {refused}")
        with _connected(cluster, "--on slurm") as client:
            options.report(f"--on slurm: {jobs} jobs are queued")
            yield Cluster(client, "of slurm")


def _slurm_cluster(answers: SimpleQueue[str]) -> DaskCluster:
    """The cluster object: one worker of one thread a job. Raises UsageError.

    Queue, account, memory and walltime are those of `jobqueue.slurm` in Dask's configuration.

    Args:
        answers: Gets why each job was not queued; "" if it was.
    """
    import dask.config
    from dask_jobqueue import SLURMCluster
    from dask_jobqueue.slurm import SLURMJob
    from distributed.core import Status

    class Told(SLURMJob):  # type: ignore[misc]  # dask-jobqueue has no types
        """A job that tells why it was refused, where Dask's waits for ever."""

        async def start(self) -> None:
            try:
                await super().start()
            except FileNotFoundError as error:
                why = f"no command {error.filename} here: start this on a computer that has Slurm"
            except Exception as error:  # whatever it is: somebody waits for the answer
                said = str(error).rpartition("stderr:")[2].strip()
                why = said or f"{self.submit_command} failed without a word"
            else:
                answers.put("")
                return
            self.status = Status.running  # or a traceback is printed, too
            answers.put(why)

    memory = dask.config.get("jobqueue.slurm.memory", None) or "2GB"
    try:
        return SLURMCluster(cores=1, processes=1, memory=memory, job_cls=Told)
    except (ValueError, RuntimeError, OSError) as error:
        raise UsageError(f"--on slurm: {error}") from None


@contextmanager
def _connected(to: str | DaskCluster, given: str) -> Iterator[Client]:
    from distributed import Client

    try:
        client = Client(to, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise UsageError(f"{given}: no scheduler answers: {error}") from None
    try:
        yield client
    finally:
        client.close(timeout=CONNECT_S)


def await_worker(client: Client) -> None:
    """Wait for the first worker, which may have been started together with the scheduler."""
    with suppress(TimeoutError):
        client.wait_for_workers(1, timeout=FIRST_S)


def check(client: Client, given: str) -> None:
    """Check scheduler and workers before the first run. Raises UsageError."""
    if fault := other_versions(client.get_versions()):
        raise UsageError(f"{given}: {fault}")
    workers = client.scheduler_info(n_workers=-1)["workers"]
    if not workers:
        todo = "dask worker tcp://HOST:PORT --nthreads 1 --nworkers auto"
        raise UsageError(
            f"{given}: the scheduler has no workers within {FIRST_S:.0f} s; start some: {todo}"
        )
    for address, worker in workers.items():
        if worker["nthreads"] != 1:
            raise UsageError(
                f"{given}: worker {address} has {worker['nthreads']} threads; expected 1 (dask"
                " worker --nthreads 1): a run takes a whole core"
            )
    ours, found = identity(), client.run(identity, on_error="return")
    for address, theirs in found.items():
        if isinstance(theirs, BaseException):
            raise UsageError(f"{given}: worker {address} has no armadico-tools: {theirs}")
        if fault := differences(ours, theirs):
            raise UsageError(f"{given}: worker {address} has other code: {fault}")


def other_versions(found: Mapping[str, Any]) -> str:
    """What `Client.get_versions` shows to differ in versions of Dask; "" if nothing does."""
    ours = found["client"]["packages"]
    others = {"the scheduler": found["scheduler"]} | {
        f"worker {address}": about for address, about in found["workers"].items()
    }
    for who, about in others.items():
        if about is None:
            continue  # it is leaving
        for package in ("distributed", "dask"):
            there, here = about["packages"].get(package), ours.get(package)
            if there != here:
                return f"{who} has {package} {there}; here it is {here}"
    return ""
