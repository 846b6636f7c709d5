"""Serve one program: its lines on one side, a society on the other, a stop before all else."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, BinaryIO, Final

import msgspec

from armadico.agents.assistant.mcp_answers import Society
from armadico.agents.assistant.mcp_lines import LONGEST, Call, Lines, answer
from armadico.agents.assistant.messages import AssistantReply, AssistantRequest
from armadico.agents.assistant.tools import TOOLS, Asking, Last, Why
from armadico.core.messages import MessageError, RobotState, checked
from armadico.observe.watching import ASK_S, Watcher, show
from armadico.observe.why import LATER_S
from armadico.runtime.client import Client
from armadico.runtime.errors import SocietyError
from armadico.runtime.latch import rests

WAITING: Final = 64
"""Calls that wait to be answered, one after another; what is more is refused at once."""

TURN_S: Final = 0.05
"""How often it is looked for a call while nothing is heard of the society."""

WATCHED_S: Final = 60.0
"""Agents are asked for their bids and cards for so long after a program has asked for something."""

FIND_S: Final = 2.0
"""How long the assistant agent is looked for before one is started;"""

HURRY_S: Final = 0.3
"""and how long it is where the robot is to be stopped;"""

START_S: Final = 15.0
"""how long that may take."""

ANSWER_S: Final = 40.0
"""What an answer may take that others have to give, too: a way is planned for 25 s at most."""

STOP_S: Final = 5.0
"""What braking may take."""

STOP: Final = "stop"
"""The tool."""


class Server:
    """Answers one program's calls, one after another, and listens to the society meanwhile.

    A stop waits for nothing that was asked before it: it has a thread and a guest of its own, and
    lines are read by a third, which never waits for either.
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
        """Prepare.

        Args:
            guests: On the mesh: one for stops, one for all else.
            watcher: Hears the society.
            society: What is known of it.
            lines: The program's conversation.
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
        self._called_at = self._asked_at = float("-inf")

    def serve(self, file: BinaryIO) -> None:
        """Until the file ends; what was asked for before is answered."""
        threading.Thread(target=self._read, args=(file,), name="stdin", daemon=True).start()
        stopping = threading.Thread(target=self._serve_stops, name="stop", daemon=True)
        stopping.start()
        while True:
            self._listen(TURN_S)
            try:
                call = self._calls.get_nowait()
            except queue.Empty:
                continue
            if call is None:
                break
            self._answer(call, *self._called(call))
        stopping.join()

    def _read(self, file: BinaryIO) -> None:
        """Take lines as they come: what needs no society is answered at once."""
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

    def _stopped(self, call: Call) -> tuple[dict[str, Any], bool]:
        """Stop the robot; with no assistant agent that answers at once, as any guest may."""
        request = self._request(call)
        reply = None if request is None else self._stopper.ask(request, FIND_S, patience=HURRY_S)
        if isinstance(reply, AssistantReply):
            if reply.refusal:
                return {"refused": reply.refusal}, True
            stopped = bool(self._stopper.wait_for(self._rests, STOP_S))
            return {"said": reply.said, "stopped": stopped}, not stopped
        try:
            self._stopper.stop(STOP_S, by=f"armadico mcp: {self._by}")
        except SocietyError as error:
            return {"refused": str(error), "stopped": False}, True
        said = "it is stopped, and no assistant agent has taken that down"
        return {"said": said, "stopped": True}, False

    def _answer(self, call: Call, told: dict[str, Any], failed: bool) -> None:
        self._write(answer(call, told, failed=failed))

    def _write(self, line: bytes | None) -> None:
        """Write a line; if nobody reads any more, the end of what is read will tell."""
        if line is not None:
            with self._writing, suppress(BrokenPipeError):
                self._out.write(line)
                self._out.flush()

    def _listen(self, for_s: float) -> None:
        """Take what comes of the society within so long, s; at once what has come already."""
        now = time.monotonic()
        if now - self._called_at < WATCHED_S and now - self._asked_at >= ASK_S:
            self._asked_at = now
            self._watcher.ask_for_cards()
            self._watcher.ask_for_bids()
        item = self._watcher.get(for_s)
        while item is not None:
            show(self._society, item)
            item = self._watcher.get(0.0)

    def _hear_until(self, enough: Callable[[], bool], for_s: float) -> None:
        """Listen until something is so, s at most."""
        end = time.monotonic() + for_s
        while not enough() and time.monotonic() < end:
            self._listen(TURN_S)

    # Calls ---------------------------------------------------------------------------------------

    def _called(self, call: Call) -> tuple[dict[str, Any], bool]:
        """What comes of a call, and whether it has failed."""
        idle = time.monotonic() - self._called_at > WATCHED_S
        self._called_at = time.monotonic()
        reply, refused = self._asked(call)
        if reply is None:
            return refused, True
        if TOOLS[call.tool].does:
            mission = {"mission": str(reply.mission)} if reply.mission else {}
            return {"said": reply.said} | mission, False
        if idle:
            self._hear_until(lambda: False, ASK_S)  # for who is there, and what they would do
        return self._look(call), False

    @property
    def _by(self) -> str:
        return self._lines.client or "a program"

    def _request(self, call: Call) -> AssistantRequest | None:
        """What is asked of the assistant agent; None: it is no message."""
        try:
            return checked(AssistantRequest(call.tool, call.text, self._by))
        except MessageError:
            return None

    def _asked(self, call: Call) -> tuple[AssistantReply | None, dict[str, Any]]:
        """The assistant agent's word on it, or why there is none, or it is no."""
        request = self._request(call)
        if request is None:
            return None, {"refused": "too long: 2,000 characters at most, and printable ones"}
        reply = self._client.ask(request, ANSWER_S, patience=FIND_S)
        if reply is None:
            self._start()
            reply = self._client.ask(request, ANSWER_S, patience=START_S)
        if not isinstance(reply, AssistantReply):
            return None, {"refused": "no assistant agent answers: is the society up?"}
        return (None, {"refused": reply.refusal}) if reply.refusal else (reply, {})

    def _rests(self) -> bool:
        """Whether the robot itself says that it is stopped, and its wheels are at rest."""
        state = self._stopper.latest(RobotState)
        return state is not None and state.stop.stopped and rests(state.v, state.w)

    def _look(self, call: Call) -> dict[str, Any]:
        """What a tool answers that only looks; the agent has found nothing wrong with its call."""
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
        if msgspec.json.decode(call.text, type=Why).what is Asking.STANDING:
            return society.why(now)
        count = len(society.moments)
        society.mark(now)
        self._hear_until(lambda: len(society.moments) > count, 2 * LATER_S)
        return society.moment()


def lines_of(file: BinaryIO) -> Iterator[bytes]:
    """The lines of a file as they come; of one that is too long, as much as shows that.

    By its descriptor: whoever waits in one of Python's files has its lock, and a process that is
    left meanwhile, by Ctrl-C say, is aborted for that.
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
