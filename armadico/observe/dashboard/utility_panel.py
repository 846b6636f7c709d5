"""Who would like a resource and who has it: utilities as curves, the holder as a lane under them.

A resource's owner says each cycle whom it obeys, and a holder its utility. The others are silent
and are asked for their recent bids (`agent/*/*/bids`); each bid is drawn at the cycle that it
answered, so curves of agents that were asked late still lie side by side.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import nan
from typing import Final

import rerun as rr

from armadico.core.messages import BidHistory, Claim, Cycle
from armadico.observe.dashboard import palette
from armadico.observe.dashboard.canvas import Canvas
from armadico.observe.dashboard.palette import NOBODY, name_of
from armadico.observe.view import View, agent_of

CYCLES: Final = 200
"""Cycles whose time is remembered: 20 s, and agents remember 50 bids."""

Seat = tuple[str, str]
"""An instance, and a resource that it competes for."""


class Contest:
    """Draws the competition for every resource of one robot."""

    def __init__(self, canvas: Canvas) -> None:
        self.holders: dict[str, str] = {}  # by resource, as drawn; NOBODY if nobody drives
        self._canvas = canvas
        self._times: dict[Cycle, float] = {}
        self._drawn: dict[Seat, dict[Cycle, None]] = {}
        self._gap: dict[tuple[str, str], bool] = {}
        self._known: dict[str, list[str]] = {}  # agents with a curve, by resource

    def update(self, view: View, t: float) -> list[tuple[str, str, str]]:
        """The lanes, where another drives by now; returns who took what from whom.

        Those are (resource, from, to). The owner's word stands; of a resource whose owner is not
        heard the holder is shown by its claims.
        """
        changes = []
        for resource in view.claimed:
            claim, owned = view.claim(resource, t), resource in view.acks
            holder = claim.ballot.instance if claim is not None else None
            drives = view.driver(resource, t) if owned else holder
            changes.append(self._held(resource, name_of(drives), t))
        return [change for change in changes if change is not None]

    def take_cycle(self, cycle: Cycle, t: float) -> None:
        """Remember when a cycle was first heard of."""
        self._times.setdefault(cycle, t)
        while len(self._times) > CYCLES:
            del self._times[next(iter(self._times))]

    def take_claim(self, claim: Claim, t: float) -> None:
        at = self._times.get(claim.cycle, t)
        self._point(claim.resource, claim.ballot.instance, claim.cycle, claim.utility, at)

    def take_history(self, history: BidHistory) -> None:
        """The recent bids of an agent that was queried."""
        for record in history.bids:
            at = self._times.get(record.cycle)
            if at is not None:
                self._point(record.resource, history.instance, record.cycle, record.utility, at)

    def forget(self, instance: str) -> None:
        """An instance has gone: its curve ends."""
        for seat in [seat for seat in self._drawn if seat[0] == instance]:
            del self._drawn[seat]

    # Inside --------------------------------------------------------------------------------------

    def _point(
        self, resource: str, instance: str, cycle: Cycle, utility: float | None, at: float
    ) -> None:
        """One bid, drawn once, whether it was claimed or asked for; no bid is a gap."""
        drawn = self._drawn.setdefault((instance, resource), {})
        if cycle in drawn:
            return
        drawn[cycle] = None
        if len(drawn) > CYCLES:
            del drawn[next(iter(drawn))]
        name = agent_of(instance)
        if utility is None and self._gap.get((resource, name), True):
            return
        self._gap[resource, name] = utility is None
        self._introduce(resource, [name])
        path = f"utility/{resource}/{name}"
        self._canvas.number(path, at, nan if utility is None else utility)

    def _held(self, resource: str, holder: str, t: float) -> tuple[str, str, str] | None:
        before = self.holders.get(resource)
        if before == holder:
            return None
        self.holders[resource] = holder
        self._introduce(resource, [NOBODY, holder])
        self._canvas.draw(f"holders/{resource}", t, rr.StateChange(state=holder))
        return None if before is None else (resource, before, holder)

    def _introduce(self, resource: str, names: Iterable[str]) -> None:
        """Say how an agent's curve and its part of the lane look, when it is first seen."""
        known = self._known.setdefault(resource, [])
        fresh = [name for name in dict.fromkeys(names) if name not in known]
        if not fresh:
            return
        known += fresh
        for name in fresh:
            if name != NOBODY:
                self._canvas.curve(f"utility/{resource}/{name}", name, palette.agent(name), 2.5)
        colours = [palette.agent(name) for name in known]
        look = rr.StateConfiguration(values=known, labels=known, colors=colours)
        self._canvas.fix(f"holders/{resource}", look)
