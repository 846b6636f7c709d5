"""Let programs and language models look and ask, by the Model Context Protocol (stdio)."""

from __future__ import annotations

import argparse
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from armadico.cli import options

if TYPE_CHECKING:
    from armadico.core.messages import AssistantReply
    from armadico.observe.mcp.answers import Society
    from armadico.observe.mcp.lines import Call, Lines
    from armadico.observe.watching import Watcher
    from armadico.runtime.client import Client

WAITING: Final = 64
"""Lines that wait to be answered; who writes more waits."""

TURN_S: Final = 0.05
"""How often it is looked for a line while nothing is heard of the society."""

ASK_S: Final = 1.0
"""Agents are asked for their bids so often,"""

WATCHED_S: Final = 60.0
"""for so long after a program has asked for something."""

FIND_S: Final = 2.0
"""How long the assistant agent is looked for before one is started,"""

START_S: Final = 15.0
"""and how long that may take."""

ANSWER_S: Final = 40.0
"""What an answer may take that others have to give, too: a way is planned for 25 s at most."""

STOP_S: Final = 5.0
"""What braking may take."""

EXAMPLES: Final = """\
  armadico mcp --world house
  claude mcp add robot -- armadico mcp --world house
  {"mcpServers": {"robot": {"command": "armadico", "args": ["mcp", "--world", "house"]}}}
"""


def main(argv: Sequence[str]) -> int:
    """Serve until standard input ends."""
    args = parser().parse_args(argv)
    world = options.world(args)
    mesh = options.join(args)
    from armadico.config.missions import load_mission  # noqa: PLC0415 - not for --help
    from armadico.config.shipped import names  # noqa: PLC0415
    from armadico.observe.mcp.answers import Society  # noqa: PLC0415
    from armadico.observe.mcp.lines import Lines  # noqa: PLC0415
    from armadico.observe.watching import Watcher  # noqa: PLC0415
    from armadico.runtime.client import Client  # noqa: PLC0415

    missions = {name: load_mission(name).title for name in names("missions")}
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:  # the helper leaves in order
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ExitStack() as stack:
        stack.enter_context(mesh)
        watcher = Watcher([mesh])
        watcher.watch_alive()
        watcher.hear()
        words = [*options.joining(args), "--namespace", args.namespace]
        server = Server(
            Client(mesh),
            watcher,
            Society(world, missions),
            Lines(options.version()),
            stack.enter_context(Helper(words)).start,
            sys.stdout.buffer,
        )
        server.serve(reading(sys.stdin.fileno()))
    return 0


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    made = options.parser(
        "armadico mcp",
        "Serve a society to one program on standard input and output: where, map, who, why,"
        " history, missions, goto, stop. What is asked for goes through the assistant agent, which"
        " is started if there is none: it takes everything down for people to see, drives nobody"
        " off, and releases no stop.",
        EXAMPLES,
    )
    made.add_argument("--world", metavar="MAP", help="the world that the robot is in")
    options.add_mesh_options(made)
    return made


def reading(descriptor: int) -> queue.Queue[bytes]:
    """What a descriptor says, line by line, read by a thread of its own; empty bytes are its end.

    By the descriptor, since whoever waits in one of Python's files has its lock, and a process that
    leaves meanwhile, by Ctrl-C say, is aborted for that.
    """
    from armadico.observe.mcp.lines import LONGEST  # noqa: PLC0415 - not for --help

    lines: queue.Queue[bytes] = queue.Queue(WAITING)

    def read() -> None:
        begun = b""  # of a line that is too long so much that it is refused as that
        while data := os.read(descriptor, LONGEST):
            *whole, last = data.split(b"\n")
            for part in whole:
                found, begun = begun + part[: LONGEST + 1 - len(begun)], b""
                if found.strip():
                    lines.put(found)
            begun += last[: LONGEST + 1 - len(begun)]
        if begun.strip():
            lines.put(begun)
        lines.put(b"")

    threading.Thread(target=read, name="stdin", daemon=True).start()
    return lines


class Helper:
    """The assistant agent that is started here, and leaves with this process."""

    def __init__(self, words: Sequence[str]) -> None:
        """Nothing is started; `words` say which mesh it joins."""
        self._words = words
        self._folder = TemporaryDirectory(prefix="armadico-mcp-")
        self._popen: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Helper:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self._folder.cleanup()

    def end(self) -> None:
        """End it, if there is one."""
        from armadico.launch.processes import end  # noqa: PLC0415 - not for --help

        if self._popen is not None:
            end(self._popen)
            self._popen = None

    def start(self) -> None:
        """Start it; the one before it has not answered, and would only keep this one out."""
        from armadico.config.scenarios import society  # noqa: PLC0415 - not for --help
        from armadico.launch.processes import Process  # noqa: PLC0415 - not for --help

        self.end()
        name = society().assistant
        log = Path(self._folder.name) / f"{name}.log"
        self._popen = Process(name, ["agent", name, *self._words], log, tied=True).popen


class Server:
    """Answers one program's calls, one after another, and listens to the society meanwhile."""

    def __init__(
        self,
        client: Client,
        watcher: Watcher,
        society: Society,
        lines: Lines,
        start: Callable[[], None],
        out: BinaryIO,
    ) -> None:
        self._client = client
        self._watcher = watcher
        self._society = society
        self._lines = lines
        self._start = start
        self._out = out
        self._called_at = self._asked_at = float("-inf")

    def serve(self, lines: queue.Queue[bytes]) -> None:
        """Until the lines end."""
        while True:
            self._hear(TURN_S)
            try:
                line = lines.get_nowait()
            except queue.Empty:
                continue
            if not line:
                return
            self._write(line)

    def _write(self, line: bytes) -> None:
        """Do what a line asks for, and answer it."""
        from armadico.observe.mcp.lines import Call, answer  # noqa: PLC0415 - not for --help

        found = self._lines.take(line)
        if isinstance(found, Call):
            told, failed = self._called(found)
            found = answer(found, told, failed=failed)
        if found is not None:
            self._out.write(found)
            self._out.flush()

    def _hear(self, for_s: float) -> None:
        """Take what comes of the society within so long, s; at once what has come already."""
        from armadico.observe.watching import show  # noqa: PLC0415 - not for --help

        now = time.monotonic()
        if now - self._called_at < WATCHED_S and now - self._asked_at >= ASK_S:
            self._asked_at = now
            self._watcher.ask_for_cards()
            self._watcher.ask_for_bids()
        item = self._watcher.take(for_s)
        while item is not None:
            show(self._society, item)
            item = self._watcher.take(0.0)

    def _hear_until(self, enough: Callable[[], bool], for_s: float) -> bool:
        """Listen until something is so, s at most; whether it is."""
        end = time.monotonic() + for_s
        while not (done := enough()) and time.monotonic() < end:
            self._hear(TURN_S)
        return done

    # Calls ---------------------------------------------------------------------------------------

    def _called(self, call: Call) -> tuple[dict[str, Any], bool]:
        """What comes of a call, and whether it has failed."""
        from armadico.core.messages import MessageError  # noqa: PLC0415 - not for --help
        from armadico.core.tools import TOOLS  # noqa: PLC0415

        idle = time.monotonic() - self._called_at > WATCHED_S
        self._called_at = time.monotonic()
        try:
            reply = self._asked(call)
        except MessageError:
            return {"refused": "too long: 2,000 characters at most, and printable ones"}, True
        if reply is None:
            return {"refused": "no assistant agent answers: is the society up?"}, True
        if reply.refusal:
            return {"refused": reply.refusal}, True
        if TOOLS[call.tool].does:
            return self._done(call.tool, reply)
        if idle:
            self._hear_until(lambda: False, ASK_S)  # for who is there, and what they would do
        return self._look(call), False

    def _asked(self, call: Call) -> AssistantReply | None:
        """The assistant agent's word on it. Raises MessageError."""
        from armadico.core.messages import AssistantReply, AssistantRequest, checked  # noqa: PLC0415

        by = self._lines.client or "a program"
        request = checked(AssistantRequest(call.tool, call.text, by))
        reply = self._client.ask(request, ANSWER_S, patience=FIND_S)
        if reply is None:
            self._start()
            reply = self._client.ask(request, ANSWER_S, patience=START_S)
        return reply if isinstance(reply, AssistantReply) else None

    def _done(self, tool: str, reply: AssistantReply) -> tuple[dict[str, Any], bool]:
        told: dict[str, Any] = {"said": reply.said}
        if reply.mission:
            told["mission"] = str(reply.mission)
        if tool == "stop":
            told["stopped"] = self._hear_until(self._rests, STOP_S)
            return told, not told["stopped"]
        return told, False

    def _rests(self) -> bool:
        """Whether the robot itself says that it is stopped, and its wheels are at rest."""
        from armadico.runtime.latch import REST_M_S, REST_RAD_S  # noqa: PLC0415 - not for --help

        state = self._society.view.state
        return (
            state is not None
            and state.stop.stopped
            and abs(state.v) <= REST_M_S
            and abs(state.w) <= REST_RAD_S
        )

    def _look(self, call: Call) -> dict[str, Any]:
        """What a tool answers that only looks; the agent has found nothing wrong with its call."""
        import msgspec  # noqa: PLC0415 - not for --help

        from armadico.core.tools import Asking, Last, Why  # noqa: PLC0415
        from armadico.observe.why import LATER_S  # noqa: PLC0415

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
