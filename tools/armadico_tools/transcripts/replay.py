"""One agent's side of a transcript: given all that it received, what does it publish?

Ours is replayed by the real driver. An implementer of another agent gives it `inputs`, and has what
it published compared by `difference_of`.

A line of a file is a JSON object. Times are s from the beginning of the scene, to the microsecond.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from math import ceil
from typing import Any, Final

import msgspec

from armadico.core.agent import AskFor, Publish
from armadico.core.driver import Announce, Driver, Output, Reply
from armadico.core.messages import (
    Latched,
    Log,
    Message,
    MessageError,
    checked,
    decode,
    encode,
    plain,
)
from armadico.core.services import matches
from armadico_tools.docs_fields import ours
from armadico_tools.transcripts.agents import Part, agent_of

Line = dict[str, Any]

KINDS: Final = {kind.__name__: kind for kind in ours()[1]}
"""Every message, by its name."""

ROUTER: Final = {True: "finds the router", False: "loses the router"}
"""Changes of an agent's link to the robot's router."""

EXACT: Final = 2e-6
"""Tolerance for the times of our own agent's messages, s: rounding."""

DRAWN: Final = 0.011
"""Tolerance for another agent's, s: who takes over waits for up to 0.1 cycles, drawn at random."""

BURST: Final = 0.001
"""A process that hung receives what waited for it within this of its return, s."""

LIFE: Final = ("starts", "hangs", "returns", "is killed", "leaves")
SENT: Final = ("publishes", "asks", "replies", "appears")


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


def read(text: str) -> Transcript:
    """A file's content. Raises msgspec.ValidationError if it is none."""
    head, *lines = map(json.loads, text.splitlines())
    return msgspec.convert({**head, "lines": lines}, Transcript)


def fields_of(message: Message) -> Any:
    """A message's fields by their names, as JSON has them."""
    return json.loads(json.dumps(plain(message)))


def uttered(item: Output, label: str, t: float) -> Line | None:
    """The line of something that an agent sends; None for a log, whose text is free."""
    line: Line = {"t": round(t, 6), "from": label}
    if isinstance(item, Publish):
        if isinstance(item.message, Log):
            return None
        return {**line, "what": "publishes", "key": item.key, **_described(item.message)}
    if isinstance(item, AskFor):
        return {**line, "what": "asks", "key": item.key, **_described(item.request)}
    if isinstance(item, Reply):
        return {**line, "what": "replies", "key": item.key, **_described(item.message)}
    return {**line, "what": "appears"} if isinstance(item, Announce) else None


def _described(message: Message) -> Line:
    message = checked(message)
    return {
        "type": type(message).__name__,
        "fields": fields_of(message),
        "cbor": encode(message).hex(),
    }


def inputs(transcript: Transcript, label: str) -> list[Line]:
    """All that a process receives, at its own times, and what befalls it, in order."""
    transcript.part(label)
    found = []
    for line in transcript.lines:
        if line["from"] == label and line["what"] in LIFE:
            found.append({key: value for key, value in line.items() if key != "to"})
        at = line.get("to", {}).get(label)
        if at is not None and at <= transcript.ends:
            what = "disappears" if line["what"] in {"is killed", "leaves"} else line["what"]
            found.append({**line, "t": at, "what": what, "to": label})
    return sorted(found, key=lambda line: (line["t"], line["what"] not in LIFE))


def outputs(transcript: Transcript, label: str) -> list[Line]:
    return [x for x in transcript.lines if x["from"] == label and x["what"] in SENT]


def replayed(transcript: Transcript, label: str) -> list[Line]:
    """What our own agent sends in its place."""
    return list(_Replay(transcript, label).lines())


class _Replay:
    """Runs the driver by the file's times instead of a clock."""

    def __init__(self, transcript: Transcript, label: str) -> None:
        self._transcript = transcript
        self._label = label
        self._agent = agent_of(transcript.part(label), transcript.seed)
        self._driver: Driver | None = None
        self._time = 0.0
        self._asleep_until: float | None = None  # it hangs, or reads what waited meanwhile
        mine = outputs(transcript, label)
        self._queries: Iterator[int] = (x["query"] for x in mine if x["what"] == "asks")
        self._questions: dict[int, int] = {}  # by the query's number in the file, the driver's own

    def lines(self) -> Iterator[Line]:
        """What the agent sends, as it lives through the file."""
        for line in inputs(self._transcript, self._label):
            yield from self._wake(line["t"])
            if line["what"] == "is killed":
                return
            self._take(line)
            yield from self._sent()
            if line["what"] == "leaves":
                return
        yield from self._wake(self._transcript.ends)

    def _wake(self, until: float) -> Iterator[Line]:
        driver = self._driver
        if driver is None or (self._asleep_until is not None and until < self._asleep_until):
            return
        self._asleep_until = None
        while (due := driver.wakeup) is not None and max(due, self._time) < until:
            self._time = max(due, self._time)
            driver.wake(self._time)
            yield from self._sent()

    def _sent(self) -> Iterator[Line]:
        assert self._driver is not None, "it has started"
        for item in self._driver.take():
            if isinstance(item, AskFor):
                self._questions[next(self._queries, -1)] = item.id
            line = uttered(item, self._label, self._time)
            if line is not None:
                yield line

    def _take(self, line: Line) -> None:
        what, t = line["what"], line["t"]
        if what == "starts":
            self._driver = Driver(self._agent, t)
            self._driver.begin(t)
        driver = self._driver
        assert driver is not None, "it has started"
        if what == "leaves":
            self._time = max(ceil(t * 1e6), ceil(self._time * 1e6) + 1) / 1e6
            driver.leave(self._time)
            return
        self._time = max(t, self._time)
        if what == "hangs":
            self._asleep_until = float("inf")
        elif what == "returns":
            self._asleep_until = t + BURST
        elif what != "starts":
            self._receive(driver, line, t)

    def _receive(self, driver: Driver, line: Line, t: float) -> None:
        what, key = line["what"], line.get("key", "")
        if what == "publishes":
            for to in self._agent.subscriptions():
                if matches(to.pattern, key):
                    driver.deliver(to, key, bytes.fromhex(line["cbor"]), t)
        elif what == "asks":
            driver.asked(key, bytes.fromhex(line["cbor"]), line["query"], t)
        elif what in {"replies", "no reply"}:
            question = self._questions[line["query"]]
            driver.replied(question, message_of(line) if what == "replies" else None, t)
        elif what in ROUTER.values():
            driver.router(what == ROUTER[True], t)
        else:
            _, name, instance = key.split("/")
            driver.token(name, instance, what == "appears", t)


def message_of(line: Line) -> Message:
    """The message of a line. Raises MessageError if its bytes are none of its type."""
    return decode(bytes.fromhex(line["cbor"]), KINDS[line["type"]])


def first_difference(transcript: Transcript, label: str) -> str:
    """Where our own agent differs from the file; "" if nowhere."""
    return _first(outputs(transcript, label), replayed(transcript, label), _unlike)


def difference_of(transcript: Transcript, label: str, sent: Sequence[Line]) -> str:
    """Where another agent differs from the file; "" if nowhere.

    What it publishes is compared by its fields, and by its time within the draw. Latched states
    are left out: who gives one back is drawn, too.
    """
    expected = [x for x in outputs(transcript, label) if x["what"] == "publishes"]
    kinds = {x["key"]: KINDS[x["type"]] for x in transcript.lines if "type" in x}
    compared = [x for x in expected if not issubclass(KINDS[x["type"]], Latched)]
    latched = {key for key, kind in kinds.items() if issubclass(kind, Latched)}
    found: list[Line] = []
    for x in sent:
        if x["key"] in latched or x["key"].startswith("log/"):
            continue
        kind = kinds.get(x["key"])
        if kind is None:
            return f"{x['t']:.6f} s: no agent publishes on {x['key']}"
        try:
            fields = fields_of(decode(bytes.fromhex(x["cbor"]), kind))
        except MessageError as error:
            return f"{x['t']:.6f} s, {x['key']}: {error}"
        found.append({"t": x["t"], "key": x["key"], "fields": fields})
    return _first(compared, found, _otherwise)


def _first(expected: Sequence[Line], found: Sequence[Line], unlike: object) -> str:
    assert callable(unlike), "it compares two lines"
    for number, line in enumerate(expected):
        if number == len(found):
            return f"{_words(line)}: it is not published"
        why = unlike(line, found[number])
        if why:
            return f"{_words(line)}: {why}\n  instead: {_words(found[number])}"
    if len(found) > len(expected):
        return f"{_words(found[len(expected)])}: it is published, and should not be"
    return ""


def _unlike(line: Line, other: Line) -> str:
    for what in ("what", "key", "type", "fields", "cbor"):
        if line.get(what) != other.get(what) and (what != "key" or line["what"] != "appears"):
            return f"another {what}"
    return "" if abs(line["t"] - other["t"]) <= EXACT else "at another time"


def _otherwise(line: Line, other: Line) -> str:
    if line["key"] != other["key"]:
        return "another key"
    if line["fields"] != other["fields"]:
        names = [n for n, value in line["fields"].items() if value != other["fields"].get(n)]
        return f"another {', '.join(names)}"
    return "" if abs(line["t"] - other["t"]) <= DRAWN else "at another time"


def _words(line: Line) -> str:
    about = " ".join(str(line[what]) for what in ("key", "fields") if what in line)
    return f"{line['t']:.6f} s: {line.get('what', 'publishes')} {about}"
