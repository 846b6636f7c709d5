"""What a robot can be sent off to do, whichever agent does it: a goal, a mission, an exploration.

An agent that takes errands answers a query that derives from `Order` with a `MissionReply`, and
publishes how they stand in a message that derives from `Errands`. Runs, commands and programs
hand over, watch and report errands by these two alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Self

from armadico.core.messages import Message


class StepDone(NamedTuple):
    """What came of one step of an errand."""

    step: str
    end: str  # how it ended: "done", "failed", "passed over"
    note: str
    at: float  # s that the errand was at work by then

    def __str__(self) -> str:
        return f"{self.step} {self.end}" + (f": {self.note}" if self.note else "")


@dataclass(frozen=True, slots=True)
class Progress:
    """How far an errand has come.

    Attributes:
        number: Which errand, as its order was answered.
        over: Whether it has ended.
        failed: Why it has ended otherwise than asked; empty: it has not.
        note: Why it does not go on now, or what else there is to say.
        summary: All of it in a line, for people.
        name: What it is called; empty: it has no name.
        state: Where it stands, in a word.
        priority: From 0 to 1; None: it has none.
        by: Who ordered it; empty: that is not known.
        active: Whether it is done now.
        doing: The step that is done now; empty: none is.
        room: Where that is; empty: in no room.
        ahead: The steps to come, the first ones.
        steps: What came of each step so far; None: it has no steps.
    """

    number: int
    over: bool
    failed: str = ""
    note: str = ""
    summary: str = ""
    name: str = ""
    state: str = ""
    priority: float | None = None
    by: str = ""
    active: bool = True
    doing: str = ""
    room: str = ""
    ahead: tuple[str, ...] = ()
    steps: tuple[StepDone, ...] | None = None

    @property
    def done(self) -> int:
        """How many of its steps are done."""
        return sum(step.end == "done" for step in self.steps or ())


class Errands(Message, frozen=True):
    """Base of a message that tells how errands stand."""

    @property
    def errands(self) -> tuple[Progress, ...]:
        """All that it tells of."""
        raise NotImplementedError


class Order(Message, frozen=True):
    """Base of a query that sends the robot off; it is answered by a `MissionReply`."""

    @property
    def asks_for(self) -> str:
        """What its kind is called: "missions", "explorations"."""
        return "missions"

    def numbered(self, number: int) -> Self:  # noqa: ARG002
        """The order with a number of its own, if whoever orders chooses one."""
        return self

    def withdrawal(self) -> Message | None:
        """What to send if it was not answered: an agent that hangs would take it on later."""
        return None
