"""Reports of a session for the log: each text once, or at a limited rate."""

from __future__ import annotations

from math import inf

from armadico.bridge.session import Event, Noted

COMPLAINT, COMPLAIN_S = 20, 10.0
"""Number of characters by which complaints of a sensor are distinguished, and least time between
two complaints: an intermittent sensor is not reported each time."""

TEXTS = 100
"""Number of texts that are remembered."""


class Notices:
    """Adds `Noted` to a session's events."""

    def __init__(self, events: list[Event]) -> None:
        self._events = events
        self._noted: dict[str, float] = {}  # time of the last report by text
        self._complaints: dict[str, tuple[str, float]] = {}  # by sensor, until it works again

    def note(self, text: str, now: float, again_s: float = inf) -> None:
        """Report a text, once or at most each `again_s`."""
        if now - self._noted.get(text, -inf) >= again_s or text not in self._noted:
            if len(self._noted) >= TEXTS:
                self._noted.clear()
            self._noted[text] = now
            self._events.append(Noted(text))

    def report_fault(self, sensor: str, wrong: str, now: float) -> None:
        """Report a sensor's fault; an empty text means that it works."""
        before, at = self._complaints.get(sensor, ("", -inf))
        if not wrong:
            self._complaints[sensor] = "", at
        elif wrong[:COMPLAINT] != before[:COMPLAINT] and now - at >= COMPLAIN_S:
            self._complaints[sensor] = wrong, now
            self._events.append(Noted(f"{sensor} ignored: {wrong}"))
