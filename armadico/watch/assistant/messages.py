"""The messages of the assistant agent: requests of programs and language models."""

from __future__ import annotations

from armadico.core.messages import Bits64, Counter, Label, Message, Name, Text
from armadico.core.services import event, query


class AssistantRequest(Message, frozen=True):
    """A program requests something of the assistant agent; `text` has the arguments as JSON."""

    tool: Name
    text: Text = "{}"
    by: Label = ""  # the program's name for itself


class AssistantReply(Message, frozen=True):
    """The result of the request, or the reason of its refusal."""

    text: Text = ""
    refusal: Text = ""
    mission: Bits64 = 0  # that it led to; 0: none


class AssistantRecord(Message, frozen=True):
    """A request to the assistant agent and its result, for displays and recordings.

    Requests beyond the rate limit are refused without a record. `left_out` counts those since the
    last record.
    """

    number: Counter
    request: AssistantRequest
    reply: AssistantReply
    left_out: Counter = 0


query(AssistantRequest, "assistant/request", AssistantReply, "a program requests something")
event(AssistantRecord, "assistant/record", "a program's request and its result")
