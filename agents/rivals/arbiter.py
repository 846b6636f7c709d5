"""The base class of arbiters: an agent that receives all proposals and alone bids for the wheels.

An arbiter is a process of its own. It competes by the ordinary contender, so the stop, ballots, a
second arbiter on standby, restart and recording work as for any agent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Final, cast

from armadico.core.agent import Agent, Identity, Parameters
from armadico.core.exchange import Bid
from armadico.core.messages import Award, Cycle, Message, Proposal
from armadico.core.resources import WHEELS, Resource

Speeds = tuple[float, float]

WAIT_S: Final = 0.02  # longest wait for the proposals of a cycle, s

# An agent whose newest proposal is older than this, in cycles, is not waited for. A proposal of the
# cycle before still counts, because one message may be late.
FORGET: Final = 3
COUNTS: Final = 1


@dataclass(frozen=True, slots=True)
class Wish:
    """What one agent proposes; of two instances of an agent only one counts."""

    instance: str
    utility: float
    action: Speeds
    critical: bool = False
    within: float | None = None  # longest transition to it, s


@dataclass(frozen=True, slots=True)
class Decision:
    """The action to command, m/s and rad/s, and by agent name how much each contributes."""

    action: Speeds
    shares: Mapping[str, float]


class Arbiter(Agent, hooks=("decide",)):
    """Decides once per cycle, when all proposals are in or after 20 ms. See `decide`."""

    reacts_to = Proposal
    provides: ClassVar[tuple[type[Message], ...]] = (Award,)
    competes_for = (WHEELS,)
    critical_for = (WHEELS,)
    key_names: Mapping[str, str] = MappingProxyType({"resource": WHEELS.name})

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._proposals: dict[str, Proposal] = {}  # by instance, the newest
        self._latest: Proposal | None = None  # of the newest cycle

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:
        """Return the decision for a cycle; `wishes` has at least one, with utilities above 0."""
        raise NotImplementedError("decide(self, wishes, cycle) returns the decision")

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        self._proposals.pop(instance, None)

    def begins(self, resource: Resource, message: Proposal) -> bool:  # noqa: ARG002
        """Whether the last expected proposal of a cycle has come; else the wait begins."""
        if message.resource != WHEELS.name or not self.cycles.fresh(message.cycle):
            return False
        latest = self._latest
        self._proposals[message.instance] = message
        if (
            latest is None
            or latest.cycle.epoch != message.cycle.epoch
            or message.cycle > latest.cycle
        ):
            self._latest = message
            self.wake_at(self.now + WAIT_S)
        newest = self._latest
        assert newest is not None, "a proposal has come"
        expected = [p for p in self._proposals.values() if self._age(p, newest) <= FORGET]
        return len(expected) > 1 and all(p.cycle == newest.cycle for p in expected)

    def on_wakeup(self) -> None:
        if self._latest is not None:
            self.take_turn(WHEELS, self._latest)

    def bid(self, message: Proposal) -> Bid | None:
        """The decision as a bid; no bid if no agent proposes anything."""
        found: dict[str, Wish] = {}
        for instance in sorted(self._proposals):
            p = self._proposals[instance]
            if self._age(p, message) > COUNTS or p.utility is None or WHEELS.fault(p.action):
                continue
            v, w = cast("Speeds", WHEELS.unpack(p.action))
            name = instance.rpartition("-")[0] or instance
            found.setdefault(name, Wish(instance, p.utility, (v, w), p.critical, p.within))
        if not found:
            self.why = "no agent proposes anything"
            return None
        wishes = {name: wish for name, wish in found.items() if wish.utility > 0.0}
        if not wishes:
            return Bid(0.0, (0.0, 0.0), reason="no agent wants the wheels")
        decision = self.decide(wishes, message.cycle)
        shares = {n: s for n, s in decision.shares.items() if s > 0.0 and n in found}
        # A standby arbiter decides, too, and publishes nothing.
        if self.holds(WHEELS):
            instances = tuple(found[name].instance for name in shares)
            award = Award(
                WHEELS.name, message.cycle, self.instance, instances, tuple(shares.values())
            )
            self.publish(award)
        critical = any(found[name].critical for name in shares)
        lead = max(shares, key=lambda name: shares[name], default="none")
        return Bid(1.0, decision.action, critical, reason=f"follows {lead}")

    @staticmethod
    def _age(proposal: Proposal, newest: Proposal) -> float:
        if proposal.cycle.epoch != newest.cycle.epoch:
            return float("inf")
        return newest.cycle.number - proposal.cycle.number
