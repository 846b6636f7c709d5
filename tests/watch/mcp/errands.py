"""A program at an MCP server on a virtual society: each call's answer, by lines of the protocol."""

from __future__ import annotations

import json
from typing import Any, cast

from armadico.config.named import Gazetteer
from armadico.config.scenarios import Scenario
from armadico.core.messages import Ask, Message
from armadico.core.services import services
from armadico.launch.client import Client
from armadico.launch.society import Options, coordinated
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.mcp.answers import Society
from armadico.watch.mcp.lines import Call, Lines, is_notification
from armadico.watch.mcp.server import Server
from armadico.watch.mcp.short import LARGEST
from tests.driven import Driven


class VirtualWatcher:
    """Lets the time of a virtual mesh pass while the server waits for messages."""

    def __init__(self, driven: Driven) -> None:
        self._driven = driven

    def get(self, for_s: float) -> None:
        if for_s > 0.0:
            self._driven.let_pass(for_s)

    def query_cards(self) -> None: ...

    def query_bids(self) -> None: ...

    def clock(self) -> int:
        return int(self._driven.mesh.now * 1e9)


class Program(Driven):
    """A society in a scenario with an assistant agent, and a program that may drive it."""

    def __init__(self, scenario: Scenario, gazetteer: Gazetteer | None, seed: int = 1) -> None:
        options = Options(seed=seed)
        super().__init__(Rehearsal(coordinated(scenario, options), options))
        self.society = Society(gazetteer, {})
        kinds = dict.fromkeys(each.message for each in services() if each.message is not Ask)
        self.mesh.watch(self._received, *kinds)
        self.run.start()
        self.run.add(Assistant)
        self.person = Client(VirtualSession(self.mesh, name="person"))
        guests = (
            Client(VirtualSession(self.mesh, name="stopper")),
            Client(VirtualSession(self.mesh, name="program")),
        )
        watcher = cast("Any", VirtualWatcher(self))
        self.server = Server(guests, watcher, self.society, lambda: None)
        self.lines = Lines("0", "model")
        self.answers: dict[int, dict[str, Any]] = {}
        self.progress: list[str] = []
        self._number = 0
        self._wordy: set[int] = set()  # calls that want all there is
        self.let_pass(2.0)

    def _received(self, key: str, message: Message, now: float) -> None:
        self.society.update(key, message, now)

    def begin_call(self, tool: str, **arguments: object) -> int:
        """Send a call; return its number."""
        self._number += 1
        self._wordy |= {self._number} if arguments.get("more") else set()
        params = {"name": tool, "arguments": arguments, "_meta": {"progressToken": self._number}}
        line = {"jsonrpc": "2.0", "id": self._number, "method": "tools/call", "params": params}
        found = self.lines.receive(json.dumps(line).encode())
        if isinstance(found, Call) and tool == "stop":  # which has a thread of its own
            self.answers[self._number] = dict(self.server.stopped(found)[0])
        else:
            self.server.receive(found, self._on_line)
        return self._number

    def _on_line(self, data: bytes) -> None:
        found = json.loads(data)
        if is_notification(data):
            self.progress.append(found["params"]["message"])
        else:
            size = len(found["result"]["content"][0]["text"])
            assert size <= LARGEST or found["id"] in self._wordy, "answers are small"
            self.answers[found["id"]] = found["result"]["structuredContent"]

    def answer(self, number: int) -> dict[str, Any]:
        """Let time pass until a call is answered."""
        end = self.mesh.now + 700.0
        while number not in self.answers and self.mesh.now < end:
            self.server.turn()
        return self.answers[number]

    def call(self, tool: str, **arguments: object) -> dict[str, Any]:
        self.let_pass(0.5)  # models are not faster; the assistant agent refuses bursts
        return self.answer(self.begin_call(tool, **arguments))
