"""Messages about approvals by people, and about the log of what programs have requested."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from armadico.core.messages import Counter, Label, Latched, Message, Name, Real, Text
from armadico.core.services import latch, query, state
from armadico.watch.assistant.messages import AssistantRequest


class Choice(StrEnum):
    """A person's answer."""

    YES = "yes"
    NO = "no"
    ALWAYS = "always"  # also for later requests for this place
    FORGET = "forget"  # no more approvals for always of a client


class Approval(Message, frozen=True):
    """A request of a program that waits for a person."""

    code: Name  # of this request alone
    request: AssistantRequest
    place: Text  # the goal, for people; empty: it has none
    why: Text  # which rule asks for the approval
    left_s: Real  # until it is refused
    goal: Annotated[tuple[Real, ...], Meta(max_length=2)] = ()  # x, y, m


class Approvals(Message, frozen=True):
    """All requests that wait for a person."""

    waiting: Annotated[tuple[Approval, ...], Meta(max_length=16)] = ()
    policy: Text = ""  # which policy it is, or why nothing is allowed; empty: there is none


class ApprovalAnswer(Message, frozen=True):
    """A person answers one of them."""

    code: Name  # with `forget`: the client
    choice: Choice
    by: Label = ""  # the person, as they call themselves; with keys their identity counts


class Answered(Message, frozen=True):
    """What became of the answer."""

    text: Text = ""
    refusal: Text = ""


class Ledger(Latched, frozen=True):
    """The length of the log of requests and its last hash, which every agent remembers.

    A log that was cut or written anew differs from it, also after a restart of its writer.
    """

    counter: Counter  # entries
    head: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]

    @property
    def order(self) -> tuple[int, int]:
        return self.counter, int(self.head[:15], 16)


state(Approvals, "assistant/approvals", 1, None, "programs' requests that wait for a person")
query(
    ApprovalAnswer,
    "assistant/approve",
    Answered,
    "a person answers a program's request",
    named=True,
)
latch(Ledger, "assistant/ledger", "length and last hash of the log of programs' requests")
