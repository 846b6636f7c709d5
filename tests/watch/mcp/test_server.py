"""Lines are read while calls wait; a stop does not wait for earlier calls."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from armadico.core.messages import Cycle, RobotState, Stop
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.mcp.answers import Society
from armadico.watch.mcp.lines import LONGEST, Lines
from armadico.watch.mcp.server import WAITING, Server, lines_of

SOON = 30.0
RESTS = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, Stop(1, True, "model", 5))


class Guest:
    """Stands in for the client of a society; answers once `busy` is set."""

    def __init__(self, busy: threading.Event | None = None, *, absent: bool = False) -> None:
        self.busy, self.absent = busy, absent
        self.requests: list[str] = []
        self.stopped = ""

    def query(self, request: AssistantRequest, *_: object, **__: object) -> AssistantReply | None:
        self.requests.append(request.tool)
        if self.busy is not None:
            assert self.busy.wait(SOON)
        return None if self.absent else AssistantReply("done")

    def latest(self, _: object) -> RobotState:
        return RESTS

    def wait_for(self, condition: Callable[[], Any], _: float) -> Any:
        return condition()

    def stop(self, _: float, *, by: str) -> None:
        self.stopped = by


class SilentWatcher:
    """A watcher that receives nothing."""

    def get(self, _: float) -> None:
        return None

    def query_cards(self) -> None: ...

    def query_bids(self) -> None: ...

    def clock(self) -> int:
        return 0


class Served:
    """A server between two pipes."""

    def __init__(self, stopper: Guest, guest: Guest) -> None:
        reading, writing = os.pipe()
        answering, writer = os.pipe()
        self.input = os.fdopen(writing, "wb", buffering=0)
        self.answers = os.fdopen(answering, "rb")
        self.started = 0
        guests: Any = (stopper, guest)
        watcher: Any = SilentWatcher()
        self._in, self._out = os.fdopen(reading, "rb"), os.fdopen(writer, "wb")
        society = Society(None, {})
        start = partial(self._start, guest)
        server = Server(guests, watcher, society, Lines("0"), start, self._out)
        self.thread = threading.Thread(target=server.serve, args=(self._in,), daemon=True)
        self.thread.start()

    def _start(self, guest: Guest) -> None:
        self.started += 1
        guest.absent = False

    def call(self, number: int, tool: str) -> None:
        params = {"name": tool, "arguments": {}}
        line = {"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": params}
        self.input.write(json.dumps(line).encode() + b"\n")

    def end(self) -> None:
        """Close the input; the server ends by itself."""
        self.input.close()
        self.thread.join(SOON)
        assert not self.thread.is_alive()
        for file in (self.answers, self._in, self._out):
            file.close()

    def answer(self) -> tuple[int, dict[str, Any]]:
        found = json.loads(self.answers.readline())
        return found["id"], found["result"]["structuredContent"]


@pytest.fixture
def busy() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


def test_a_stop_does_not_wait_and_calls_beyond_the_queue_are_refused_at_once(
    busy: threading.Event,
) -> None:
    served = Served(Guest(), Guest(busy))
    for number in range(WAITING + 10):
        served.call(number, "goto")
    served.call(999, "stop")
    numbers = []
    while not numbers or numbers[-1] != 999:
        number, found = served.answer()
        numbers.append(number)
    assert found == {"reply": "done", "stopped": True}
    assert len(numbers) <= 11, "the others wait, or were refused"
    busy.set()
    while len(numbers) < WAITING + 11:
        numbers.append(served.answer()[0])
    assert sorted(numbers) == [*range(WAITING + 10), 999]
    served.end()


def test_with_no_assistant_agent_one_is_started_and_the_stop_does_not_wait_for_it() -> None:
    stopper, guest = Guest(absent=True), Guest(absent=True)
    served = Served(stopper, guest)
    served.call(1, "stop")
    number, found = served.answer()
    assert (number, found["stopped"]) == (1, True)
    assert stopper.stopped == "armadico mcp: a program"
    assert served.started == 0
    served.call(2, "where")
    assert served.answer()[0] == 2
    assert served.started == 1
    served.end()


def _lines(*pieces: bytes) -> list[bytes]:
    """Return the lines read from what is written piece by piece."""
    there, here = os.pipe()
    with os.fdopen(there, "rb") as read, os.fdopen(here, "wb", buffering=0) as written:

        def write() -> None:
            for piece in pieces:
                written.write(piece)
            written.close()

        writing = threading.Thread(target=write)
        writing.start()
        found = [*lines_of(read)]
        writing.join()
    return found


def test_a_line_may_come_in_pieces_and_the_last_one_without_an_end() -> None:
    assert _lines(b"on", b"e\ntwo\n", b"\n  \n", b"three") == [b"one", b"two", b"", b"  ", b"three"]


@pytest.mark.parametrize("end", [b"\nnext\n", b""])
def test_a_too_long_line_is_cut(end: bytes) -> None:
    found = _lines(b"a\n", *[b"x" * 40_000] * 5, end)
    assert found[0] == b"a"
    assert len(found[1]) == LONGEST + 1
    assert found[2:] == ([b"next"] if end else [])


def test_a_process_that_exits_while_a_thread_reads_is_not_aborted() -> None:
    program = """if True:
        import queue, sys, threading
        from armadico.watch.mcp.server import lines_of
        found = queue.SimpleQueue()
        read = lambda: [*map(found.put, lines_of(sys.stdin.buffer))]
        threading.Thread(target=read, daemon=True).start()
        print(found.get())
    """
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as popen:
        assert popen.stdin is not None
        popen.stdin.write(b"hello\n")
        popen.stdin.flush()
        assert popen.wait(SOON) == 0
        assert popen.stdout is not None
        assert popen.stdout.read() == b"b'hello'\n"
        assert popen.stderr is not None
        assert popen.stderr.read() == b""
