"""The messages of the assistant: requests of programs and language models."""

from __future__ import annotations

from armadico.core.messages import Bits64, Counter, Label, Message, Name, Text
from armadico.core.services import event, query


class AssistantRequest(Message, frozen=True):
    """A program asks the assistant agent for something; `text` has its arguments, as JSON."""

    tool: Name
    text: Text = "{}"
    by: Label = ""  # as the program names itself


class AssistantReply(Message, frozen=True):
    """What is done about it, or why nothing is."""

    said: Text = ""
    refusal: Text = ""
    mission: Bits64 = 0  # that it has led to; 0: to none


class AssistantRecord(Message, frozen=True):
    """A request to the assistant agent and what came of it, for whoever looks or records.

    Requests beyond the rate are refused and counted: `left_out` is how many came since the last
    record and have none.
    """

    number: Counter
    request: AssistantRequest
    reply: AssistantReply
    left_out: Counter = 0


query(AssistantRequest, "assistant/request", AssistantReply, "a program asks for something")
event(AssistantRecord, "assistant/record", "what a program asked for")
