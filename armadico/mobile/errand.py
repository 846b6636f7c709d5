"""Errands: goals, missions and explorations, by whichever agent.

An agent that accepts errands answers a query derived from `Order` with a `MissionReply`, and
publishes their progress in a message derived from `Errands`. Runs, commands and programs request
and report errands by these two bases alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

from armadico.core.messages import Message


class StepDone(NamedTuple):
    """The end of one step of an errand."""

    step: str
    end: str  # "done", "unsure", "failed", "passed over"
    note: str
    at: float  # the errand's working time by then, s

    def __str__(self) -> str:
        return f"{self.step} {self.end}" + (f": {self.note}" if self.note else "")


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of an errand."""

    number: int  # its number, as in the reply to its order
    over: bool  # whether it has ended
    failed: str = ""  # why it failed; empty: it has not
    # Why it is unknown whether all of it was done; empty: nothing speaks against it.
    doubt: str = ""
    note: str = ""  # why it does not proceed now, or other information
    summary: str = ""  # all of it in a line, for people
    name: str = ""  # its name; empty: none
    state: str = ""  # its state, in a word
    priority: float | None = None  # from 0 to 1; None: it has none
    by: str = ""  # the person or program that ordered it; empty: unknown
    active: bool = True  # whether it is being done now
    doing: str = ""  # the step that is being done now; empty: none
    room: str = ""  # the room of that step; empty: none
    ahead: tuple[str, ...] = ()  # the next steps, the first ones
    steps: tuple[StepDone, ...] | None = None  # the steps that have ended; None: it has no steps

    @property
    def succeeded(self) -> bool | None:
        """Whether it has ended as requested; None: that is unknown."""
        return None if self.over and self.doubt else self.over and not self.failed

    @property
    def done(self) -> int:
        """How many of its steps are done."""
        return sum(step.end == "done" for step in self.steps or ())


class Errands(Message, frozen=True):
    """Base of a message with the progress of errands."""

    @property
    def errands(self) -> tuple[Progress, ...]:
        raise NotImplementedError


class Order(Message, frozen=True):
    """Base of a query that orders an errand; the reply is a `MissionReply`."""

    @property
    def kind_name(self) -> str:
        """The name of its kind, for people: "missions", "explorations"."""
        return "missions"

    def numbered(self, number: int) -> Self:  # noqa: ARG002
        """Return the order with a number, if its kind has one that the client chooses."""
        return self

    def withdrawal(self) -> Message | None:
        """Return the query that cancels an unanswered order, which a hanging agent may accept."""
        return None
