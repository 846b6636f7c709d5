"""The MCP server: answers one program's calls from the state of a society; stops come first."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import BinaryIO, Final

import msgspec

from armadico.core.messages import MessageError, RobotState, checked
from armadico.launch.client import Client
from armadico.launch.latch import rests
from armadico.observe.jsons import Json, JsonObject
from armadico.observe.watching import QUERY_S, Watcher, show
from armadico.runtime.errors import SocietyError
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.tools import TOOLS, Last, Subject, Why
from armadico.watch.mcp.answers import Society
from armadico.watch.mcp.lines import LONGEST, Call, Lines, answer
from armadico.watch.why import LATER_S

WAITING: Final = 64  # calls in the queue; further calls are refused at once

TURN_S: Final = 0.05  # how often the queue is read while no message arrives from the society

# Agents are queried for bids and cards for this time after a call.
WATCHED_S: Final = 60.0

FIND_S: Final = 2.0  # how long to wait for an assistant agent before one is started

HURRY_S: Final = 0.3  # the same before a stop is published without it

START_S: Final = 15.0  # how long an assistant agent may take to start

# The timeout for an answer that other agents contribute to; planning takes at most 25 s.
ANSWER_S: Final = 40.0

STOP_S: Final = 5.0  # the timeout for braking

STOP: Final = "stop"  # the tool


class Server:
    """Answers one program's calls in sequence, and receives the society's messages meanwhile.

    A stop does not wait for earlier calls: it has its own thread and client. A third thread reads
    the lines and waits for neither.
    """

    def __init__(
        self,
        guests: tuple[Client, Client],
        watcher: Watcher,
        society: Society,
        lines: Lines,
        start: Callable[[], object],
        out: BinaryIO,
    ) -> None:
        """Set up the server.

        Args:
            guests: Clients on the mesh: the first for stops, the second for all other calls.
            watcher: Receives the society's messages.
            society: The state that they are added to.
            lines: The conversation with the program.
            start: Starts an assistant agent.
            out: Where answers are written.
        """
        self._stopper, self._client = guests
        self._watcher = watcher
        self._society = society
        self._lines = lines
        self._start = start
        self._out = out
        self._writing = threading.Lock()
        self._calls: queue.Queue[Call | None] = queue.Queue(WAITING)
        self._stops: queue.SimpleQueue[Call | None] = queue.SimpleQueue()
        self._called_at = self._polled_at = float("-inf")

    def serve(self, file: BinaryIO) -> None:
        """Answer calls until the file ends, including those still in the queue."""
        threading.Thread(target=self._read, args=(file,), name="stdin", daemon=True).start()
        stopping = threading.Thread(target=self._serve_stops, name="stop", daemon=True)
        stopping.start()
        while True:
            self._receive(TURN_S)
            try:
                call = self._calls.get_nowait()
            except queue.Empty:
                continue
            if call is None:
                break
            self._answer(call, *self._called(call))
        stopping.join()

    def _read(self, file: BinaryIO) -> None:
        """Queue each call; answer at once what does not need the society."""
        for line in lines_of(file):
            found = self._lines.receive(line) if line.strip() else None
            if not isinstance(found, Call):
                self._write(found)
            elif found.tool == STOP:
                self._stops.put(found)
            else:
                try:
                    self._calls.put_nowait(found)
                except queue.Full:
                    refused = {"refused": f"{WAITING} calls wait to be answered: ask again later"}
                    self._answer(found, refused, True)
        self._stops.put(None)
        self._calls.put(None)

    def _serve_stops(self) -> None:
        while (call := self._stops.get()) is not None:
            self._answer(call, *self._stopped(call))

    def _stopped(self, call: Call) -> tuple[Mapping[str, Json], bool]:
        """Stop the robot: by the assistant agent, or directly if that does not reply at once."""
        request = self._request(call)
        reply = None if request is None else self._stopper.query(request, FIND_S, patience=HURRY_S)
        if isinstance(reply, AssistantReply):
            if reply.refusal:
                return {"refused": reply.refusal}, True
            stopped = bool(self._stopper.wait_for(self._rests, STOP_S))
            return {"reply": reply.text, "stopped": stopped}, not stopped
        try:
            self._stopper.stop(STOP_S, by=f"armadico mcp: {self._by}")
        except SocietyError as error:
            return {"refused": str(error), "stopped": False}, True
        text = "it is stopped; no assistant agent answered, so this is not recorded"
        return {"reply": text, "stopped": True}, False

    def _answer(self, call: Call, found: Mapping[str, Json], failed: bool) -> None:
        self._write(answer(call, found, failed=failed))

    def _write(self, line: bytes | None) -> None:
        """Write a line. If the reader is gone, standard input ends, too, and ends the server."""
        if line is not None:
            with self._writing, suppress(BrokenPipeError):
                self._out.write(line)
                self._out.flush()

    def _receive(self, for_s: float) -> None:
        """Wait up to `for_s` seconds for a message; process it and those already received."""
        now = time.monotonic()
        if now - self._called_at < WATCHED_S and now - self._polled_at >= QUERY_S:
            self._polled_at = now
            self._society.view.ask(self._watcher.clock() / 1e9)
            self._watcher.query_cards()
            self._watcher.query_bids()
        item = self._watcher.get(for_s)
        while item is not None:
            show(self._society, item)
            item = self._watcher.get(0.0)

    def _receive_until(self, enough: Callable[[], bool], for_s: float) -> None:
        end = time.monotonic() + for_s
        while not enough() and time.monotonic() < end:
            self._receive(TURN_S)

    # Calls ---------------------------------------------------------------------------------------

    def _called(self, call: Call) -> tuple[Mapping[str, Json], bool]:
        """Return the answer to a call, and whether it failed."""
        idle = time.monotonic() - self._called_at > WATCHED_S
        self._called_at = time.monotonic()
        reply, refused = self._request_reply(call)
        if reply is None:
            return refused, True
        if TOOLS[call.tool].does:
            mission = {"mission": str(reply.mission)} if reply.mission else {}
            return {"reply": reply.text} | mission, False
        if idle:
            self._receive_until(lambda: False, QUERY_S)  # for agents' cards and bids
        return self._read_only(call), False

    @property
    def _by(self) -> str:
        return self._lines.client or "a program"

    def _request(self, call: Call) -> AssistantRequest | None:
        """Return the request to the assistant agent, or None if it is no valid message."""
        try:
            return checked(AssistantRequest(call.tool, call.text, self._by))
        except MessageError:
            return None

    def _request_reply(self, call: Call) -> tuple[AssistantReply | None, dict[str, str]]:
        """Return the assistant agent's reply, or None and the refusal."""
        request = self._request(call)
        if request is None:
            return None, {"refused": "too long: 2,000 characters at most, and printable ones"}
        reply = self._client.query(request, ANSWER_S, patience=FIND_S)
        if reply is None:
            self._start()
            reply = self._client.query(request, ANSWER_S, patience=START_S)
        if not isinstance(reply, AssistantReply):
            return None, {"refused": "no assistant agent answers: is the society up?"}
        return (None, {"refused": reply.refusal}) if reply.refusal else (reply, {})

    def _rests(self) -> bool:
        """Return whether the robot reports the stop, and its wheels are at rest."""
        state = self._stopper.latest(RobotState)
        return state is not None and state.stop.stopped and rests(state.v, state.w)

    def _read_only(self, call: Call) -> JsonObject:
        """Return the answer of a tool that only reads. The agent has already checked the call."""
        society, now = self._society, self._watcher.clock() / 1e9
        match call.tool:
            case "where":
                return society.where(now)
            case "map":
                return society.map()
            case "who":
                return society.who()
            case "missions":
                return society.missions()
            case "history":
                return society.history(now, msgspec.json.decode(call.text, type=Last).lines)
        if msgspec.json.decode(call.text, type=Why).what is Subject.STANDING:
            return society.why(now)
        count = len(society.moments)
        society.mark(now)
        self._receive_until(lambda: len(society.moments) > count, 2 * LATER_S)
        return society.moment()


def lines_of(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file as they arrive; a too long line is cut to `LONGEST` + 1 bytes.

    It reads by the descriptor: a thread that waits in a Python file holds its lock, and a process
    that exits meanwhile, such as by Ctrl-C, is aborted.
    """
    begun = b""
    while data := os.read(file.fileno(), LONGEST):
        *whole, last = data.split(b"\n")
        for part in whole:
            yield begun + part[: LONGEST + 1 - len(begun)]
            begun = b""
        begun += last[: LONGEST + 1 - len(begun)]
    if begun:
        yield begun
