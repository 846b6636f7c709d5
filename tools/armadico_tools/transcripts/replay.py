"""One agent's side of a transcript: what it receives, and whether it publishes the same.

An implementer feeds `inputs` to an agent, and compares what it published by `difference_of`.

A line of a file is a JSON object. Times are s from the beginning of the scene, to the microsecond.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final

import msgspec

from armadico.core.messages import (
    Latched,
    Log,
    Message,
    MessageError,
    decode,
    plain,
)
from armadico.core.services import service_at
from armadico_tools.docs_fields import ours

Line = dict[str, Any]

KINDS: Final = {kind.__name__: kind for kind in ours()[1]}
"""Every message type by its name."""

DRAWN: Final = 0.011
"""Tolerance of times, s: an agent that takes over waits a random time of up to 0.1 cycles."""

LIFE: Final = ("starts", "hangs", "returns", "is killed", "leaves")
SENT: Final = ("publishes", "asks", "replies", "appears")


class Part(msgspec.Struct, frozen=True):
    """One process of a scene, in the first line of a file; its bids are for implementers."""

    name: str
    starts: float  # s
    instance: str = ""
    start: int = 0  # index among the processes of that name
    competes_for: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Its name in the file."""
        return self.name if not self.start else f"{self.name}{self.start + 1}"


class Transcript(msgspec.Struct, frozen=True):
    """A file: its description, and the events."""

    scene: str
    about: str
    seed: int
    ends: float  # s; nothing is compared after it
    agents: tuple[Part, ...]
    lines: tuple[Line, ...] = ()

    def part(self, label: str) -> Part:
        """One of its processes. Raises KeyError for an unknown label."""
        return {part.label: part for part in self.agents}[label]


def read(text: str) -> Transcript:
    """Parse a file. Raises msgspec.ValidationError."""
    head, *lines = map(json.loads, text.splitlines())
    return msgspec.convert({**head, "lines": lines}, Transcript)


def fields_of(message: Message) -> Any:
    """A message's fields by name, as JSON values."""
    return json.loads(json.dumps(plain(message)))


def inputs(transcript: Transcript, label: str) -> list[Line]:
    """All that a process receives, and its own starts, hangs and ends, in order of time."""
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


def difference_of(transcript: Transcript, label: str, sent: Sequence[Line]) -> str:
    """The first difference between what an agent published and the file; "" without one.

    Fields are compared exactly, times within `DRAWN`. Latched states are omitted: the agent that
    restores one is drawn at random.
    """
    expected = [x for x in outputs(transcript, label) if x["what"] == "publishes"]
    kinds = {x["key"]: KINDS[x["type"]] for x in transcript.lines if "type" in x}
    compared = [x for x in expected if not issubclass(KINDS[x["type"]], Latched)]
    found: list[Line] = []
    for x in sent:
        service = service_at(x["key"])
        if service is not None and issubclass(service.message, Latched | Log):
            continue
        kind = kinds.get(x["key"])
        if kind is None:
            return f"{x['t']:.6f} s: no agent publishes on {x['key']}"
        try:
            fields = fields_of(decode(bytes.fromhex(x["cbor"]), kind))
        except MessageError as error:
            return f"{x['t']:.6f} s, {x['key']}: {error}"
        found.append({"t": x["t"], "key": x["key"], "fields": fields})
    for number, line in enumerate(compared):
        if number == len(found):
            return f"{_words(line)}: it is not published"
        if why := _otherwise(line, found[number]):
            return f"{_words(line)}: {why}\n  instead: {_words(found[number])}"
    if len(found) > len(compared):
        return f"{_words(found[len(compared)])}: it is published, and should not be"
    return ""


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
