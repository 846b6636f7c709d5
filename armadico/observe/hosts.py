"""The state of each host from a view (sans-IO): its live and its missing agents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

from armadico.core.messages import Card
from armadico.observe.view import View

SKEW_S: Final = 2.0  # larger clock offsets are reported; it includes the delay of a reply


@dataclass(frozen=True)
class HostState:
    name: str
    agents: tuple[str, ...]  # live agents
    lacks: tuple[str, ...] = ()  # configured agents that are not alive
    clock_s: float | None = None  # its clock minus this machine's; None: not known

    @property
    def state(self) -> str:
        if self.lacks and not self.agents:
            return "no agent is alive"
        if self.lacks:
            return f"missing: {', '.join(self.lacks)}"
        return "up" if self.agents else "no agent is configured"

    @property
    def skew(self) -> str:
        """The clock offset as text; empty if it is small or not known."""
        if self.clock_s is None or abs(self.clock_s) <= SKEW_S:
            return ""
        word = "ahead of" if self.clock_s > 0 else "behind"
        return f"clock {abs(self.clock_s):.0f} s {word} this machine's"


def census(
    view: View, wanted: Mapping[str, Sequence[str]], ahead: Mapping[str, float]
) -> list[HostState]:
    """The state of every known host, those of `wanted` first.

    Args:
        view: Of the society; agents without a card are ignored.
        wanted: The configured agents of each host.
        ahead: The clock on a card minus this machine's, by instance, s.
    """
    cards = [agent.card for agent in view.agents if agent.card is not None]
    names = dict.fromkeys((*wanted, *sorted({card.host for card in cards})))
    return [
        _state(name, [card for card in cards if card.host == name], wanted.get(name, ()), ahead)
        for name in names
    ]


def _state(
    name: str, cards: Sequence[Card], wanted: Sequence[str], ahead: Mapping[str, float]
) -> HostState:
    agents = tuple(sorted(card.name for card in cards))
    lacks = [agent for agent in dict.fromkeys(wanted) if wanted.count(agent) > agents.count(agent)]
    offsets = [ahead[card.instance] for card in cards if card.instance in ahead]
    return HostState(name, agents, tuple(lacks), median(offsets) if offsets else None)
