"""Pauses of messages that come periodically (sans-IO)."""

from __future__ import annotations

from typing import Final

PAUSE_S: Final = 2.0
"""A pause of messages that is longer, s, is a gap: what happened in it was not received. As in the
measures of a run. Agents that are ended together do not end at the same moment."""


class Pauses:
    """When messages of one kind arrived; times are s of one clock."""

    def __init__(self, since: float, deadline_s: float | None) -> None:
        """Start: they are expected from `since`, and within twice the deadline of their service."""
        self._last = since
        self._within = max(PAUSE_S, 2.0 * (deadline_s or 0.0))
        self._first: tuple[float, float] | None = None

    def add(self, t: float) -> None:
        if self._first is None and t - self._last > self._within:
            self._first = self._last, t
        self._last = max(self._last, t)

    def gap(self, now: float, begun: float = 0.0) -> str:
        """The first gap in words, in times from `begun`; "" if there is none."""
        if self._first is not None:
            since, until = self._first
            return f"from {since - begun:.1f} to {until - begun:.1f} s"
        return f"after {self._last - begun:.1f} s" if now - self._last > self._within else ""
