"""The messages of the assistant agent: requests of programs and language models."""

from __future__ import annotations

from enum import StrEnum
from typing import ClassVar

from armadico.core.messages import Bits64, Counter, Label, Message, Name, Text
from armadico.core.services import event, query


def known_as(identity: str, called: str) -> str:
    """Return an identity for people, with what it calls itself; without one that alone."""
    if not identity or called in ("", identity):
        return identity or called
    return f"{identity} (calls itself {called})"


class AssistantRequest(Message, frozen=True):
    """A program requests something of the assistant agent; `text` has the arguments as JSON."""

    tool: Name
    text: Text = "{}"
    by: Label = ""  # the program's name for itself; in records its identity, if it has one
    called: Label = ""  # in records of a program with an identity: its name for itself

    appended: ClassVar[int] = 1

    @property
    def asker(self) -> str:
        """The program, for people."""
        return known_as(self.by, self.called) or "a program"


class Against(StrEnum):
    """What would become of what is rehearsed, if it were requested; the text says why."""

    NOTHING = "nothing"
    ASKS = "asks"  # a person would be asked first
    REFUSED = "refused"  # it would be refused


class AssistantReply(Message, frozen=True):
    """The result of the request, or the reason of its refusal."""

    text: Text = ""
    refusal: Text = ""
    mission: Bits64 = 0  # that it led to; 0: none
    approval: Bits64 = 0  # it waits for a person, and is asked for by this number; 0: it does not
    against: Against = Against.NOTHING  # of a rehearsal

    appended: ClassVar[int] = 2


class AssistantRecord(Message, frozen=True):
    """A request to the assistant agent and its result, for displays and recordings.

    Requests beyond the rate limit are refused without a record. `left_out` counts those since the
    last record.
    """

    number: Counter
    request: AssistantRequest
    reply: AssistantReply
    left_out: Counter = 0


query(
    AssistantRequest,
    "assistant/request",
    AssistantReply,
    "a program requests something",
    named=True,
)
event(AssistantRecord, "assistant/record", "a program's request and its result")
