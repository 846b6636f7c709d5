"""A transcript: its lines, how they are written while a virtual mesh runs, and how they are read.

A line is a JSON object. Times are s from the beginning of the scene, to the microsecond.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from math import ceil
from typing import Any, Final

import msgspec

from armadico.core import messages as m
from armadico.core.agent import Agent, AskFor, Publish, Subscription
from armadico.core.driver import Announce, Driver, Output, Reply
from armadico.core.messages import Log, Message, checked, encode, plain
from armadico.core.services import TOKEN, matches, message_types
from armadico.mesh.virtual import VirtualMesh
from armadico_tools.transcripts.agents import Judge, Part

Line = dict[str, Any]

KINDS: Final = {kind.__name__: kind for kind in message_types()}
"""Every message, by its name."""


class Transcript(msgspec.Struct, frozen=True):
    """A file: what it is about, and what happened."""

    scene: str
    about: str
    seed: int
    ends: float  # s; nothing is compared after it
    agents: tuple[Part, ...]
    lines: tuple[Line, ...] = ()

    def part(self, label: str) -> Part:
        """One of its processes. Raises KeyError if there is none of that label."""
        return {part.label: part for part in self.agents}[label]

    def text(self) -> str:
        """The file."""
        head = msgspec.to_builtins(self)
        del head["lines"]
        first = {**head, "protocol": m.PROTOCOL}
        return "".join(json.dumps(line) + "\n" for line in (first, *self.lines))


def read(text: str) -> Transcript:
    """A file's content. Raises msgspec.ValidationError if it is none."""
    head, *lines = map(json.loads, text.splitlines())
    return msgspec.convert({**head, "lines": lines}, Transcript)


def described(message: Message) -> Line:
    """The message of a line: its type, its fields, and its bytes on the wire."""
    message = checked(message)
    return {
        "type": type(message).__name__,
        "fields": fields_of(message),
        "cbor": encode(message).hex(),
    }


def fields_of(message: Message) -> Any:
    """A message's fields by their names, as JSON has them."""
    return json.loads(json.dumps(plain(message)))


def uttered(item: Output, label: str, t: float) -> Line | None:
    """The line of something that an agent sends; None for a log, whose text is free."""
    line: Line = {"t": round(t, 6), "from": label}
    if isinstance(item, Publish):
        if isinstance(item.message, Log):
            return None
        return {**line, "what": "publishes", "key": item.key, **described(item.message)}
    if isinstance(item, AskFor):
        return {**line, "what": "asks", "key": item.key, **described(item.request)}
    if isinstance(item, Reply):
        return {**line, "what": "replies", "key": item.key, **described(item.message)}
    return {**line, "what": "appears"} if isinstance(item, Announce) else None


ROUTER: Final = {True: "finds the router", False: "loses the router"}
"""What befalls an agent's link to the robot's router."""


class Tape:
    """Takes down a scene on a virtual mesh."""

    def __init__(self, mesh: VirtualMesh, loses: Callable[[Message], bool]) -> None:
        """`loses`: whether a message is lost."""
        self.lines: list[Line] = []
        self.closed = False
        self.queries: list[Line] = []
        self.numbers: dict[tuple[str, int], int] = {}  # of a process's own questions, in the file
        self.replies: dict[int, Line] = {}  # by the query
        self.loses = loses
        self._mesh = mesh
        self._sent: deque[Line | None] = deque()
        self._published: dict[int, tuple[Message, Line | None]] = {}
        self._tokens: dict[tuple[str, bool], Line] = {}
        mesh.watch(self._watch, *(kind for kind in message_types() if kind is not Log))

    def add(self, line: Line) -> Line:
        """Write a line."""
        if not self.closed:
            self.lines.append(line)
        return line

    def happens(self, label: str, what: str, **about: Any) -> Line:
        """Write what befalls a process."""
        return self.add({"t": round(self._mesh.now, 6), "from": label, "what": what, **about})

    def client(self, message: Message, key: str) -> None:
        """Publish something from outside the society."""
        self.sends("client", [Publish(key, message)], self._mesh.now)
        self._mesh.publish(message, key=key)

    def sends(self, label: str, out: list[Output], t: float) -> None:
        """Write what a process is about to send, and who may receive it."""
        for item in out:
            line = uttered(item, label, t)
            if line is None:
                continue
            line["to"] = {}
            if isinstance(item, Publish):
                line["to"] = dict.fromkeys(self._listeners(item.key, label))
                self._sent.append(self.add(line))
                continue
            if isinstance(item, AskFor):
                self.queries.append(line)
                line["query"] = self.numbers[label, item.id] = len(self.queries)
            elif isinstance(item, Reply):
                line["query"] = item.call
                self.replies[item.call] = line
            elif isinstance(item, Announce):
                self.token(label, alive=True, line=line)
            self.add(line)

    def token(self, label: str, *, alive: bool, line: Line) -> None:
        """Note whose token it is that a line is about."""
        agent = next(r.agent for r in self.recorders() if r.label == label)
        line["key"] = TOKEN.format(name=agent.name, instance=agent.instance)
        self._tokens[agent.instance, alive] = line

    def recorders(self) -> Iterator[Recorder]:
        """The drivers of all processes that were started."""
        for node in self._mesh.nodes:
            if isinstance(node.driver, Recorder):
                yield node.driver

    def line_of(self, message: Message) -> Line | None:
        """The line of a message that arrives."""
        return self._published.get(id(message), (message, None))[1]

    def token_line(self, instance: str, alive: bool) -> Line | None:
        """The line of a token's coming or going."""
        return self._tokens.get((instance, alive))

    def _watch(self, key: str, message: Message, _: float) -> None:
        line = self._sent.popleft()
        assert line is not None, "it was written"
        assert line["key"] == key, "in this order they are sent"
        self._published[id(message)] = (message, line)

    def _listeners(self, key: str, speaker: str) -> list[str]:
        found = []
        for node in self._mesh.nodes:
            driver = node.driver
            if node.alive and isinstance(driver, Recorder) and driver.label != speaker:
                pairs = driver.agent.subscriptions()
                if any(matches(to.pattern, key) for to in pairs):
                    found.append(driver.label)
        return found


class Recorder(Driver):
    """The real driver; what it receives, and what it sends, is written down.

    It takes each event at a microsecond of its own, so the file's times give the order.
    """

    def __init__(self, agent: Agent, now: float, label: str, tape: Tape) -> None:
        super().__init__(agent, now)
        self.label = label
        self.time = now
        self._tape = tape
        self._begun = False
        self._ticks = ceil(now * 1e6)

    def _tick(self, now: float) -> float:
        self._ticks = max(ceil(now * 1e6), self._ticks + 1)
        self.time = self._ticks / 1e6
        return self.time

    def begin(self, now: float) -> None:
        """Begin; what befell its link before, an agent does not see."""
        self._begun = True
        super().begin(now)

    def wake(self, now: float) -> None:
        """Note the time, and wake the driver."""
        self.time = max(now, self.time)
        self._ticks = max(self._ticks, ceil(self.time * 1e6))
        super().wake(self.time)

    def leave(self, now: float) -> None:
        """End in order."""
        super().leave(self._tick(now))

    def take(self) -> list[Output]:
        """What is to be sent."""
        out = super().take()
        if out:
            self._tape.sends(self.label, out, self.time)
        return out

    def deliver(self, to: Subscription, key: str, payload: bytes | Message, now: float) -> None:
        """Take a message."""
        assert isinstance(payload, Message), "the virtual mesh carries messages"
        if self._tape.loses(payload):
            return
        t, line = self._tick(now), self._tape.line_of(payload)
        if line is not None:
            line["to"][self.label] = t
        judge = self.agent if isinstance(self.agent, Judge) else None
        if judge is not None:
            judge.verdict = None
        super().deliver(to, key, payload, t)
        if line is not None and judge is not None and judge.verdict is not None:
            line["verdict"] = str(judge.verdict)

    def token(self, name: str, instance: str, alive: bool, now: float) -> None:
        """Take the news of a token."""
        t, line = self._tick(now), self._tape.token_line(instance, alive)
        if line is not None:
            line["to"][self.label] = t
        super().token(name, instance, alive, t)

    def router(self, there: bool, now: float) -> None:
        """Take the news of the robot's router."""
        if self._begun:
            now = self._tick(now)
            line = {"t": now, "from": "", "what": ROUTER[there], "to": {self.label: now}}
            self._tape.add(line)
        super().router(there, now)

    def asked(self, key: str, payload: bytes | Message, call: Any, now: float) -> None:
        """Take a query."""
        t = self._tick(now)
        self._tape.queries[call - 1]["to"][self.label] = t
        super().asked(key, payload, call, t)

    def replied(self, question: int, reply: Message | None, now: float) -> None:
        """Take a reply, or that there is none."""
        t = self._tick(now)
        number = self._tape.numbers[self.label, question]
        if reply is None:
            line = {"t": t, "from": "", "what": "no reply", "query": number, "to": {self.label: t}}
            self._tape.add(line)
        else:
            self._tape.replies[number]["to"][self.label] = t
        super().replied(question, reply, t)
