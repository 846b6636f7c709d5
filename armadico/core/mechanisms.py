"""The seam for coordination mechanisms: what decides which bid a resource follows.

The default is `Contender`: ballots, with nobody in charge. Another mechanism is an object named by
an entry point in the group `armadico.coordinations`. Both are protocols, not base classes.
"""

from __future__ import annotations

from typing import Final, Protocol, cast

from armadico.core import messages as m
from armadico.core.coordination import COMPARISONS, Contender
from armadico.core.cycles import CycleClock
from armadico.core.errors import UnknownNameError
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.individual import Individual
from armadico.core.installed import entries
from armadico.core.messages import Message
from armadico.core.resources import Resource

GROUP: Final = "armadico.coordinations"


class Mechanism(Protocol):
    """The contender's side of one resource, as the kernel of an agent calls it (sans-IO).

    Each call returns the messages to publish, of kinds whose keys name the resource.
    """

    @property
    def receives(self) -> tuple[type[Message], ...]:
        """The kinds of messages that it needs besides claims and acks; each names its resource."""

    @property
    def ack(self) -> m.Ack | None:
        """The owner's newest ack."""

    @property
    def owned(self) -> bool:
        """Whether the resource has an owner: its ack is fresh."""

    @property
    def holding(self) -> bool:
        """Whether the agent itself holds the resource."""

    @property
    def share(self) -> float:
        """How much of the resource's command is this agent's, 0 to 1."""

    @property
    def speaker(self) -> str:
        """The instance whose commands carry the agent's bids: its own, or an arbiter's, or ""."""

    @property
    def wakeup(self) -> float | None:
        """When `tick` is due, s; None: not at all."""

    def bid(
        self, cycle: m.Cycle, bid: Bid | None, now: float, inputs: m.Cycle | None = None
    ) -> list[Message]:
        """Process this cycle's bid, or None; `inputs` is the cycle of its oldest input."""

    def on_claim(self, claim: m.Claim, now: float) -> list[Message]:
        """Process another contender's claim or release."""

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Process a message of one of `receives`, of this resource."""

    def acked(self, ack: m.Ack, now: float) -> list[Message]:
        """Process the owner's ack."""

    def gone(self, instance: str, now: float) -> list[Message]:
        """Process the end of an instance's liveliness token."""

    def returned(self, now: float) -> None:
        """Discard what belongs to cycles that the clock no longer counts."""

    def tick(self, now: float) -> list[Message]:
        """Process a wake-up."""


class Coordination(Protocol):
    """A mechanism as an entry point names it."""

    @property
    def arbiter(self) -> str:
        """The name of its installed agent that decides; empty if it has none."""

    def contender(
        self, resource: Resource, agent: Individual, clock: CycleClock
    ) -> Mechanism | None:
        """Return the contender's side for an agent; None: ballots, as for the arbiter itself."""


def coordination(name: str) -> Coordination:
    """Return an installed coordination. Raises UnknownNameError or ImportError."""
    points = {point.name: point for point in entries(GROUP)}
    if name not in points:
        raise UnknownNameError("coordination", name, points)
    try:
        found = points[name].load()
    except Exception as error:  # a module may raise anything
        raise ImportError(f"coordination {name} cannot be loaded: {error}") from error
    if not (isinstance(getattr(found, "arbiter", None), str) and hasattr(found, "contender")):
        raise ImportError(f"coordination {name} ({points[name].value}): see core.mechanisms")
    return cast("Coordination", found)


def contender(resource: Resource, agent: Individual, clock: CycleClock) -> Mechanism:
    """Return the contender's side of a resource for an agent, by its parameters."""
    social = agent.p.social
    if social.coordination is not None:
        found = coordination(social.coordination).contender(resource, agent, clock)
        if found is not None:
            return found
    return Contender(
        resource,
        agent.instance,
        clock,
        EXCHANGES[social.exchange or resource.exchange],
        agent.rng,
        social.margin,
        COMPARISONS[social.comparison],
    )
