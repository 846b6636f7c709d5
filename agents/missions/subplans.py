"""The coordinator: asks the planner agents for sub-plans, and chooses the cheapest (figure 3.19).

A planner agent is an agent of its own (`armadico.agents.missions.planner`). Those are asked that
are alive, called `planner-...`, and declare on their card that they plan for such a surprise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from armadico.agents.missions.messages import Subplan, SubplanRequest
from armadico.core.messages import Card

PLANNERS: Final = "planner-"
"""What a planner agent's name begins with."""

ANSWER_S: Final = 5.0
"""What the planners may take, together; who has not answered by then is not waited for."""


@dataclass
class Enquiry:
    """One request to the planner agents, and what they have answered."""

    request: SubplanRequest
    asked: frozenset[str]  # the planners that were alive
    until: float  # s
    chosen: Callable[[Subplan | None], None]
    answers: dict[str, Subplan] = field(default_factory=dict)


class Coordinator:
    """Asks all planner agents that are alive, and chooses the cheapest sub-plan."""

    def __init__(self) -> None:
        self.planners: dict[str, frozenset[str]] = {}  # alive: what each plans for, by instance
        self._enquiry: Enquiry | None = None

    @property
    def busy(self) -> bool:
        """Whether answers are waited for."""
        return self._enquiry is not None

    def able(self, surprise: str) -> frozenset[str]:
        """The planners that are alive and plan for such a surprise."""
        return frozenset(of for of, plans in self.planners.items() if surprise in plans)

    def ask(
        self, request: SubplanRequest, now: float, chosen: Callable[[Subplan | None], None]
    ) -> None:
        """Ask; `chosen` is told the cheapest answer in time, or None if there is none."""
        self._enquiry = Enquiry(request, self.able(request.surprise), now + ANSWER_S, chosen)

    def met(self, card: Card) -> None:
        """A planner agent has given its card."""
        self.planners[card.instance] = frozenset(card.plans)

    def gone(self, instance: str, now: float) -> None:
        """An agent is gone: it is not waited for any more."""
        self.planners.pop(instance, None)
        self.choose(now)

    def add(self, subplan: Subplan, now: float) -> None:
        enquiry = self._enquiry
        if enquiry is not None and subplan.id == enquiry.request.id:
            enquiry.answers[subplan.planner] = subplan
            self.choose(now)

    def drop(self) -> None:
        """Nobody needs the answers any more."""
        self._enquiry = None

    def choose(self, now: float) -> None:
        """Choose, once all have answered that are alive, or the time is over."""
        enquiry = self._enquiry
        if enquiry is None:
            return
        waited_for = (enquiry.asked & self.planners.keys()) - enquiry.answers.keys()
        if waited_for and now < enquiry.until:
            return
        self._enquiry = None
        plans = [plan for plan in enquiry.answers.values() if not plan.refusal]
        enquiry.chosen(min(plans, key=lambda p: (p.energy, p.length, p.planner), default=None))

    @property
    def answers(self) -> dict[str, Subplan]:
        """What has been answered so far."""
        return {} if self._enquiry is None else dict(self._enquiry.answers)
