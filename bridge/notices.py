"""What a session with a robot reports to people: each text once, or at most so often."""

from __future__ import annotations

from math import inf

from armadico.bridge.session import Event, Noted

COMPLAINT, COMPLAIN_S = 20, 10.0
"""Letters by which one complaint of a sensor is told from another. A complaint is made at most so
often: a sensor that works every other time has nothing new to report."""

TEXTS = 100
"""So many texts are remembered."""


class Notices:
    """Adds `Noted` to a session's events."""

    def __init__(self, events: list[Event]) -> None:
        self._events = events
        self._noted: dict[str, float] = {}  # each text, and when it was last reported
        self._complaints: dict[str, tuple[str, float]] = {}  # by sensor, until it is well again

    def note(self, text: str, now: float, again_s: float = inf) -> None:
        """Report something, once or at most each `again_s`."""
        if now - self._noted.get(text, -inf) >= again_s or text not in self._noted:
            if len(self._noted) >= TEXTS:
                self._noted.clear()
            self._noted[text] = now
            self._events.append(Noted(text))

    def complain(self, sensor: str, wrong: str, now: float) -> None:
        """Report what is wrong with a sensor; an empty text: it is well."""
        before, at = self._complaints.get(sensor, ("", -inf))
        if not wrong:
            self._complaints[sensor] = "", at
        elif wrong[:COMPLAINT] != before[:COMPLAINT] and now - at >= COMPLAIN_S:
            self._complaints[sensor] = wrong, now
            self._events.append(Noted(f"{sensor} not heeded: {wrong}"))
