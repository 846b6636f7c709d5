"""Run a function over many items in processes on all cores, with a progress bar.

The processes are this computer's (`Local`), or whatever else is a `Pool`. On Ctrl-C, finished items
have been handed over and running ones are discarded. If this process is killed, its workers end.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager
from multiprocessing import active_children, get_context
from typing import Final, Protocol, TypeVar

from armadico.child import collect_seldom, tie

T = TypeVar("T")
R = TypeVar("R")

LINE_S: Final = 5.0
"""Period of progress lines without a terminal, s."""

SAFE_PATH: Final = "PYTHONSAFEPATH"

Results = Generator[tuple[int, R], None, None]
"""Results with the indices of their items, as they become known."""


class Pool(Protocol):
    """Processes that apply functions to items."""

    def results(self, function: Callable[[T], R], items: Sequence[T]) -> Results[R]:
        """Yield the index of each item with its result, as soon as it is known.

        `function` must be importable from a module. A closed iterator ends its work. Raises
        BrokenExecutor if processes are lost, and what the function raises.
        """


def over(
    function: Callable[[T], R],
    items: Sequence[T],
    where: int | Pool,
    label: str,
    done: Callable[[T, R], None] | None = None,
) -> list[R]:
    """The results in the order of the items; `done` is called with each finished item.

    `where` is a pool, or a number of processes on this computer.
    """
    results: list[R | None] = [None] * len(items)
    with closing(each(function, items, where, label)) as found:
        for index, result in found:
            results[index] = result
            if done is not None:
                done(items[index], result)
    return results  # type: ignore[return-value]


def each(
    function: Callable[[T], R], items: Sequence[T], where: int | Pool, label: str
) -> Results[R]:
    """As `Pool.results`, with a progress bar."""
    if not items:
        return
    pool = Local(where) if isinstance(where, int) else where
    with progress(label, len(items)) as step, closing(pool.results(function, items)) as found:
        for index, result in found:
            yield index, result
            step()


class Local:
    """Processes of this computer; a single one is this process."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def results(self, function: Callable[[T], R], items: Sequence[T]) -> Results[R]:
        """See `Pool`."""
        jobs = min(self.jobs, len(items))
        if jobs <= 1:
            yield from ((index, function(item)) for index, item in enumerate(items))
            return
        with _safe_path():
            yield from self._in_processes(function, items, jobs)

    @staticmethod
    def _in_processes(function: Callable[[T], R], items: Sequence[T], jobs: int) -> Results[R]:
        others = active_children()
        pool = ProcessPoolExecutor(jobs, get_context("spawn"), _begin, (os.getpid(),))
        waiting = iter(enumerate(items))
        running: dict[Future[R], int] = {}
        try:
            while True:
                # No more than there are workers: submitted items cannot be cancelled on Ctrl-C.
                while len(running) < jobs and (item := next(waiting, None)) is not None:
                    running[pool.submit(function, item[1])] = item[0]
                if not running:
                    break
                finished, _ = wait(running, return_when=FIRST_COMPLETED)
                yield from ((running.pop(future), future.result()) for future in finished)
        finally:
            if running:  # Ctrl-C, or an item failed: another may take an hour, or never end
                for worker in {*active_children()} - {*others}:
                    worker.terminate()
            pool.shutdown(cancel_futures=True)


def _begin(parent: int) -> None:
    """Ignore Ctrl-C, which a terminal sends to all processes: the parent ends the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not tie(parent, signal.SIGTERM):
        os._exit(1)
    collect_seldom()


@contextmanager
def progress(label: str, total: int) -> Iterator[Callable[[], None]]:
    """A function to call for each finished item: a bar on a terminal, lines elsewhere."""
    if not sys.stderr.isatty():
        yield _Lines(label, total).step
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=total)
        yield lambda: bar.advance(task)


class _Lines:
    def __init__(self, label: str, total: int) -> None:
        self._label, self._total, self._done = label, total, 0
        self._began = self._printed_at = time.monotonic()

    def step(self) -> None:
        self._done += 1
        now = time.monotonic()
        if now - self._printed_at < LINE_S and self._done < self._total:
            return
        self._printed_at = now
        left = (now - self._began) / self._done * (self._total - self._done)
        text = f"{self._label}: {self._done} of {self._total}, {left:.0f} s left"
        print(text, file=sys.stderr, flush=True)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep workers from importing from the current folder, also before they receive `sys.path`."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before
