"""The coordinator: requests sub-plans of planner agents, and chooses the cheapest (figure 3.19).

It queries the planner agents (`armadico.agents.missions.planner`) that are alive, are named
`planner-...`, and declare on their card that they plan for the surprise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from armadico.agents.missions.messages import Subplan, SubplanRequest
from armadico.core.messages import Card

PLANNERS: Final = "planner-"  # the prefix of a planner agent's name

ANSWER_S: Final = 5.0  # the timeout for all answers together


@dataclass
class Enquiry:
    """One request to the planner agents, and their answers."""

    request: SubplanRequest
    planners: frozenset[str]  # those alive at its time
    until: float  # s
    chosen: Callable[[Subplan | None], None]
    answers: dict[str, Subplan] = field(default_factory=dict)


class Coordinator:
    """Requests sub-plans of all planner agents that are alive, and chooses the cheapest."""

    def __init__(self) -> None:
        self.planners: dict[str, frozenset[str]] = {}  # alive: what each plans for, by instance
        self._enquiry: Enquiry | None = None

    @property
    def busy(self) -> bool:
        """Whether answers are pending."""
        return self._enquiry is not None

    def able(self, surprise: str) -> frozenset[str]:
        """Return the planners that are alive and plan for a surprise."""
        return frozenset(of for of, plans in self.planners.items() if surprise in plans)

    def request(
        self, request: SubplanRequest, now: float, chosen: Callable[[Subplan | None], None]
    ) -> None:
        """Begin a request; `chosen` is called with the cheapest answer in time, or None."""
        self._enquiry = Enquiry(request, self.able(request.surprise), now + ANSWER_S, chosen)

    def add_planner(self, card: Card) -> None:
        self.planners[card.instance] = frozenset(card.plans)

    def remove_planner(self, instance: str, now: float) -> None:
        """Stop waiting for an agent that is gone."""
        self.planners.pop(instance, None)
        self.choose(now)

    def add(self, subplan: Subplan, now: float) -> None:
        enquiry = self._enquiry
        if enquiry is not None and subplan.id == enquiry.request.id:
            enquiry.answers[subplan.planner] = subplan
            self.choose(now)

    def drop(self) -> None:
        self._enquiry = None

    def choose(self, now: float) -> None:
        """Choose once all planners that are alive have answered, or the timeout is over."""
        enquiry = self._enquiry
        if enquiry is None:
            return
        pending = (enquiry.planners & self.planners.keys()) - enquiry.answers.keys()
        if pending and now < enquiry.until:
            return
        self._enquiry = None
        plans = [plan for plan in enquiry.answers.values() if not plan.refusal]
        enquiry.chosen(min(plans, key=lambda p: (p.energy, p.length, p.planner), default=None))
