"""Workers that drive samples: processes forked from one that has everything loaded.

A rehearsal is short, so the start of a fresh Python for each worker would take longer than what it
drives. One helper process is started early; it imports what agents need while the society is still
being observed, and is forked for each sample. It has no threads and no mesh, and runs at a low
priority. All end with the process that started them.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from types import TracebackType
from typing import IO, Final, Self, TypeVar, cast

from armadico.child import collect_seldom, tie

T = TypeVar("T")
R = TypeVar("R")

NICE: Final = 10
"""How much lower the workers' priority is: a live society beside them comes first."""

GRACE_S: Final = 1.0
"""A sample that has not ended so long after the deadline is killed."""

_LENGTH: Final = struct.Struct("<Q")


class Crew:
    """Processes that apply a function to items (a `cli.pool.Pool`), as a context manager."""

    def __init__(self, jobs: int | None = None) -> None:
        """Start the helper process; `jobs`: how many run at once, by default one per core."""
        self.jobs = jobs or len(os.sched_getaffinity(0))
        # By `time.monotonic`: then all ends, and items without a result have none.
        self.until = float("inf")
        # One thread for each worker: they are as many as the cores.
        env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        env["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))  # it finds the same modules
        words = [sys.executable, "-P", "-m", __name__, str(os.getpid())]
        self._helper = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env, start_new_session=True
        )
        self.leader = self._helper.pid  # the process group of all its processes

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.end()

    def end(self) -> None:
        """End the helper process and all workers; nothing if they have been ended."""
        if self._helper.returncode is not None:  # reaped: its group's number may be another's now
            return
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.leader, signal.SIGKILL)
        self._helper.wait()
        for stream in (self._helper.stdin, self._helper.stdout):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def prepare(self, function: Callable[[T], object], item: T) -> None:
        """Call a function in the helper process before it is forked: what it caches, all have."""
        with suppress(TimeoutError):
            self._give((0, function, [item]))

    def results(
        self, function: Callable[[T], R], items: Sequence[T]
    ) -> Generator[tuple[int, R], None, None]:
        """See `Pool`; items that have not ended by `until` have no result."""
        try:
            self._give((self.jobs, function, list(items)))
            for _ in items:
                found = self._take()
                if found is None:
                    raise ChildProcessError("the process that rehearses has ended")
                index, result = found
                if isinstance(result, BaseException):
                    raise result
                yield index, cast("R", result)
        except TimeoutError:
            self.end()

    # A pipe holds only so much, and the helper process may be late on a busy machine: it neither
    # reads before it has loaded, nor writes a long result at once.

    def _give(self, value: object) -> None:
        """Send a value to the helper process. Raises TimeoutError at `until`."""
        assert self._helper.stdin is not None
        to = self._helper.stdin.fileno()
        os.set_blocking(to, False)
        data = pickle.dumps(value)
        data = _LENGTH.pack(len(data)) + data
        while data:
            if not select.select([], [to], [], self._left_s)[1]:
                raise TimeoutError
            data = data[os.write(to, data) :]

    def _take(self) -> tuple[int, object] | None:
        """The next value; None at the end. Raises TimeoutError at `until`."""
        head = self._exactly(_LENGTH.size)
        if head is None:
            return None
        data = self._exactly(*_LENGTH.unpack(head))
        found: tuple[int, object] | None = None if data is None else pickle.loads(data)
        return found

    def _exactly(self, size: int) -> bytes | None:
        """So many bytes and no more, which `select` would miss; None if the stream ends before."""
        assert self._helper.stdout is not None
        back, data = self._helper.stdout.fileno(), b""
        while len(data) < size:
            if not select.select([back], [], [], self._left_s)[0]:
                raise TimeoutError
            more = os.read(back, size - len(data))
            if not more:
                return None
            data += more
        return data

    @property
    def _left_s(self) -> float | None:
        """The time until `until`; None: for ever."""
        left = self.until - time.monotonic()
        return None if left == float("inf") else max(0.0, left)


# The helper process -------------------------------------------------------------------------------


def main() -> int:
    """Import what samples need, then fork a worker for each item that comes; until input ends."""
    if not tie(int(sys.argv[1]), signal.SIGKILL):
        return 0
    os.nice(NICE)
    _load()
    given, back = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what an agent prints is no result
    while True:
        head = given.read(_LENGTH.size)
        if len(head) < _LENGTH.size:
            return 0
        jobs, function, items = pickle.loads(given.read(_LENGTH.unpack(head)[0]))
        if jobs:
            collect_seldom()
            _work(jobs, function, items, back)
            continue
        with suppress(Exception):  # a worker will raise it again
            function(*items)


def _work(jobs: int, function: Callable[[T], object], items: Sequence[T], back: IO[bytes]) -> None:
    waiting, running = list(enumerate(items))[::-1], dict[int, int]()
    while waiting or running:
        while waiting and len(running) < jobs:
            index, item = waiting.pop()
            running[_forked(function, index, item)] = index
        for pipe in select.select(list(running), [], [])[0]:
            with os.fdopen(pipe, "rb") as stream:
                data = stream.read()
            index = running.pop(pipe)
            os.wait()
            if not data:
                data = pickle.dumps((index, ChildProcessError("a worker was killed")))
            back.write(_LENGTH.pack(len(data)) + data)
            back.flush()


def _forked(function: Callable[[T], object], index: int, item: T) -> int:
    """Fork a worker for an item; returns the end of the pipe with its result."""
    ours, theirs = os.pipe()
    parent = os.getpid()
    if os.fork():
        os.close(theirs)
        return ours
    try:
        tie(parent, signal.SIGKILL)
        os.close(ours)
        try:
            found: object = function(item)
        except Exception as error:
            found = error
        try:
            data = pickle.dumps((index, found))
        except Exception as error:  # such as an exception that cannot be pickled
            data = pickle.dumps((index, RuntimeError(f"{found!r}: {error}")))
        with os.fdopen(theirs, "wb") as stream:
            stream.write(data)
    finally:
        os._exit(0)


def _load() -> None:
    """Import what the default society and the simulator are made of."""
    import armadico.rehearsal.sample
    from armadico.config.scenarios import society
    from armadico.core.discovery import AGENTS, agent_class, installed

    here = installed(AGENTS)
    for name in (society().robot, *society().agents):
        if name in here:
            agent_class(name)
    del armadico


if __name__ == "__main__":
    sys.exit(main())
