"""What every agent bid in every cycle of a run, from the agents' own bid histories.

Losers are silent on the mesh but remember their bids: the histories are asked for once a second.
The holder's claims have what it wanted and what it commanded, so blending is visible.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from armadico.core.cycles import PERIOD
from armadico.core.messages import Claim, Message
from armadico.core.resources import WHEELS
from armadico.observe.view import agent_of
from armadico_tools.experiments.driving import Cell, Drive

SAME: Final = 1e-9


class Turn(Struct, frozen=True):
    """One agent's turn in one cycle: t in s since the mission began."""

    t: float
    agent: str
    utility: float | None  # None: no bid
    critical: bool
    holds: bool  # its claim is the one that stands
    blends: bool  # and what it commands is not yet what it wants
    reason: str


class History:
    """One run, driven to its end, and all agents' bids for the wheels."""

    def __init__(self, cell: Cell, seed: int) -> None:
        self.drive = Drive(cell, seed)
        self._bids: dict[tuple[str, int], tuple[float | None, bool, str]] = {}
        self._claims: dict[tuple[str, int], bool] = {}
        self.drive.rehearsal.mesh.watch(lambda _key, message, _t: self._receive(message), Claim)
        self.drive.go(self._ask)
        self._ask()

    def _receive(self, message: Message) -> None:
        assert isinstance(message, Claim), "it watches nothing else"
        if message.resource != WHEELS.name or message.utility is None:
            return
        agent = agent_of(message.ballot.instance)
        pairs = zip(message.wanted, message.commanded, strict=False)
        blends = any(abs(wanted - sent) > SAME for wanted, sent in pairs)
        self._claims[agent, message.cycle.number] = blends

    def _ask(self) -> None:
        for node in self.drive.rehearsal.mesh.nodes:
            for bid in node.agent.bids:
                if bid.resource == WHEELS.name:
                    at = (node.name, bid.cycle.number)
                    self._bids[at] = (bid.utility, bid.critical, bid.reason)

    def turns(self) -> list[Turn]:
        """Everything since the mission began, by time and agent."""
        ticks, state = self.drive.trace.ticks, self.drive.watch.view.state
        assert ticks and state is not None, "it drove"  # noqa: PT018
        took = ticks[-1].t - ticks[0].t
        found = []
        for (agent, number), (utility, critical, reason) in self._bids.items():
            t = round(took - PERIOD * (state.cycle.number - number), 3)
            if 0.0 <= t <= took:
                claim = self._claims.get((agent, number))
                holds = claim is not None
                found.append(Turn(t, agent, utility, critical, holds, bool(claim), reason))
        return sorted(found, key=lambda turn: (turn.t, turn.agent))
