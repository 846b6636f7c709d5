"""The utilities of all contenders for a resource as curves.

The holder publishes its utility each cycle. The other contenders' recent bids are queried
(`agent/*/*/bids`). Each bid is drawn at the time of its cycle.
"""

from __future__ import annotations

from math import nan
from typing import Final

import rerun as rr

from armadico.core.membership import agent_of
from armadico.core.messages import BidHistory, Claim, Cycle
from armadico.watch.dashboard import palette
from armadico.watch.dashboard.canvas import Canvas

CYCLES: Final = 200  # cycles whose times are kept: 20 s; agents keep 50 bids


class Utilities:
    """Draws the contenders for every resource of one robot."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._times: dict[Cycle, float] = {}
        self._drawn: dict[tuple[str, str], dict[Cycle, None]] = {}  # by resource and agent
        self._gap: dict[tuple[str, str], bool] = {}  # whether a curve's last point is a gap
        self._introduced: set[tuple[str, str]] = set()

    def on_cycle(self, cycle: Cycle, t: float) -> None:
        self._times.setdefault(cycle, t)
        while len(self._times) > CYCLES:
            del self._times[next(iter(self._times))]

    def on_claim(self, claim: Claim, t: float) -> None:
        at = self._times.get(claim.cycle, t)
        self._point(claim.resource, claim.ballot.instance, claim.cycle, claim.utility, at)

    def on_history(self, history: BidHistory) -> None:
        for record in history.bids:
            at = self._times.get(record.cycle)
            if at is not None:
                self._point(record.resource, history.instance, record.cycle, record.utility, at)

    def _point(
        self, resource: str, instance: str, cycle: Cycle, utility: float | None, at: float
    ) -> None:
        """Draw one bid once, whether claimed or queried; no bid is a gap."""
        name = agent_of(instance)
        curve = resource, name
        drawn = self._drawn.setdefault(curve, {})
        if cycle in drawn:
            return
        drawn[cycle] = None
        if len(drawn) > CYCLES:
            del drawn[next(iter(drawn))]
        if utility is None and self._gap.get(curve, True):
            return
        self._gap[curve] = utility is None
        self._introduce(resource, name)
        value = rr.Scalars(nan if utility is None else utility)
        self._canvas.draw(f"utility/{resource}/{name}", at, value)

    def _introduce(self, resource: str, name: str) -> None:
        """Set the colour of an agent's curve, once."""
        if (resource, name) not in self._introduced:
            self._introduced.add((resource, name))
            line = rr.SeriesLines(colors=[palette.agent(name)], names=[name], widths=[2.5])
            self._canvas.fix(f"utility/{resource}/{name}", line)
