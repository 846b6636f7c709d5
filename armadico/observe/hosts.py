"""Alive agents by host, and what each host lacks (sans-IO): a view in, a state a host out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

from armadico.core.messages import Card
from armadico.observe.view import View

SKEW_S: Final = 2.0
"""A clock that is farther off than this is worth saying; an answer may take a while."""


@dataclass(frozen=True)
class HostState:
    """One host as it is seen from here."""

    name: str
    agents: tuple[str, ...]  # that are there
    lacks: tuple[str, ...] = ()  # that should be there, and are not
    clock_s: float | None = None  # how far its clock is ahead of this machine's; None: not known

    @property
    def state(self) -> str:
        """For people: `up`, what it lacks, or that no agent is alive."""
        if self.lacks and not self.agents:
            return "no agent is alive"
        if self.lacks:
            return f"lacks: {', '.join(self.lacks)}"
        return "up" if self.agents else "nothing is to run there"

    @property
    def skew(self) -> str:
        """For people: how far its clock is off; empty if it is right, or not known."""
        if self.clock_s is None or abs(self.clock_s) <= SKEW_S:
            return ""
        word = "ahead of" if self.clock_s > 0 else "behind"
        return f"clock {abs(self.clock_s):.0f} s {word} this machine's"


def census(
    view: View, wanted: Mapping[str, Sequence[str]], ahead: Mapping[str, float]
) -> list[HostState]:
    """Every host that was heard of, those of `wanted` first.

    Args:
        view: Of the society; who shows no card is on no host.
        wanted: The agents that each host should have.
        ahead: How far the clock on a card was ahead of this machine's, by instance, s.
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
