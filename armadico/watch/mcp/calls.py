"""The calls that a server answers: what is open, and where each answer goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
from msgspec.structs import replace

from armadico.config.shipped import names
from armadico.core.messages import MessageError, checked
from armadico.observe.jsons import JsonObject
from armadico.watch.assistant.messages import Against, AssistantReply, AssistantRequest
from armadico.watch.assistant.tools import Goal, Numbered, Trial
from armadico.watch.mcp.lines import Call, answer, in_ascii, progress
from armadico.watch.mcp.short import fitted
from armadico.watch.mcp.waiting import Wait

Send = Callable[[bytes], None]
"""Writes a line to a client; called on any thread."""


@dataclass(eq=False)
class Asked:
    """A call, and where its answer goes."""

    call: Call
    send: Send
    began: float = 0.0  # s; when the agent was asked
    told_at: float = float("-inf")  # s; when its client was last told how far it is
    taken_back: bool = False  # of a `cancel`: there was a call that had not begun
    gone: bool = False  # it is not waited for any more

    @property
    def own(self) -> tuple[Send, int | str]:
        """The client and its number of the call, by which it is dropped."""
        return self.send, self.call.id


@dataclass(eq=False)
class Open:
    """A call that is being answered."""

    asked: Asked


@dataclass(eq=False)
class Asking(Open):
    """The assistant agent is asked for it."""

    call: Call  # as it is passed on
    unknown: str  # why its place is not known
    idle: bool  # whether agents were not queried for bids and cards before
    until: float  # s; without an answer it is asked for again until then
    again_at: float  # s
    under_way: bool = False
    started: bool = False  # an agent was started for it
    once: bool = False  # it is not sent again: it was cancelled, or its client is gone
    reply: AssistantReply | None = None


@dataclass(eq=False)
class AwaitingEnd(Open):
    """It is answered when a goal has ended."""

    wait: Wait


@dataclass(eq=False)
class Approving(Open):
    """It waits for a person, and is asked for by a number."""

    call: Call  # as it was passed on
    number: int
    until: float
    text: str
    heard_at: float  # s; when the agent answered last
    polled_at: float
    reply: AssistantReply | None = None  # the outcome


@dataclass(eq=False)
class Rehearsing(Open):
    """It is answered by a rehearsal, on a thread of its own."""

    against: AssistantReply  # what the policy has against what is rehearsed; no text if nothing
    done: int = 0  # samples that have ended
    # What the rehearsal told; a text: why it is refused.
    answer: Mapping[str, Any] | str | None = None

    @property
    def told(self) -> JsonObject:
        """The rehearsal's answer in short. It is no yes if the policy has something against it."""
        assert isinstance(self.answer, Mapping), "it has ended"
        small, says = dict(self.answer["small"]), self.answer["says"]
        small.pop("says", None)
        if not self.against.text:
            return {"text": says, **small}
        refused = self.against.against is Against.REFUSED
        if refused or small["answer"] == "yes":
            small["answer"] = "no" if refused else "unknown"
            small.pop("cure", None)
            small["why"] = self.against.text
        return {"text": f"{self.against.text}. The rehearsal: {says}", **small}


def ill_posed(trial: Trial) -> str:
    """Return why it is not clear what is to be rehearsed, or which mission; "" if it is.

    Otherwise half a goal would be answered as if the present mission had been asked for.
    """
    if (trial.x is None) != (trial.y is None):
        return "give both x and y, or a place"
    if trial.x is None and trial.heading is not None:
        return "a heading needs x and y, or a place"
    if trial.x is not None and trial.mission:
        return "give a goal (a place, or x and y) or a mission, not both"
    if trial.mission and trial.mission not in (known := names("missions")):  # and never a file
        return f"no mission {trial.mission!r}; there are: {', '.join(known)}"
    return ""


def unheard(_: bytes) -> None:
    """Write nothing: the client does not wait any more."""


def refuse(asked: Asked, why: str) -> None:
    """Answer a call with why it is refused."""
    asked.send(answer(asked.call, fitted({"refused": why}), failed=True))


def tell(asked: Asked, now: float, until: float, message: str) -> None:
    """Tell a client how long its call has lasted, and at most lasts, if it wants to know."""
    if asked.call.progress is not None:
        since, total = now - asked.began, until - asked.began
        asked.send(progress(asked.call, round(since, 2), round(total, 2), message))


def client_of(call: Call) -> str:
    """The name of the client that calls, as it announces it."""
    return call.by or "a program"


def is_bare(cancel: Call) -> bool:
    """Return whether a `cancel` names no number: it is for all that its client wants."""
    try:
        return not msgspec.json.decode(cancel.text, type=Numbered).number
    except msgspec.DecodeError:
        return False


def request_of(call: Call) -> AssistantRequest | None:
    """Return the request to the assistant agent, or None if it is no valid message."""
    try:
        return checked(AssistantRequest(call.tool, call.text, client_of(call)))
    except MessageError:
        return None


def with_arguments(call: Call, arguments: Goal | Trial) -> Call:
    """Return a call with other arguments; those that have no value are left out."""
    plain = msgspec.to_builtins(arguments)
    given = {name: value for name, value in plain.items() if value is not None}
    return replace(call, text=in_ascii(msgspec.json.encode(given)))
