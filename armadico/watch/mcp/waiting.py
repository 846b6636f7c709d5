"""Waits for the end of a goal: how it ended, in a sentence and a few values (sans-IO)."""

from __future__ import annotations

from dataclasses import dataclass

from armadico.core.messages import line
from armadico.launch.client import SILENCE_S
from armadico.mobile.messages import CANCELLED, MissionState
from armadico.observe.jsons import JsonObject
from armadico.watch.mcp.answers import Society


@dataclass
class Wait:
    """A wait for the end of one goal; times in s by the society's clock."""

    mission: int  # the goal's number
    to: str  # what it is called, for people
    began: float  # when the wait began
    until: float  # when it ends in any case
    seen: bool = False  # whether the interface agent has reported this goal yet

    def end(self, society: Society, now: float) -> JsonObject | None:
        """Return the answer once the goal or the wait has ended, else None."""
        view, status = society.view, society.view.mission
        own = status is not None and status.mission == self.mission
        self.seen = self.seen or own
        silent = now - max(society.status_at, self.began) > SILENCE_S
        if silent:
            return self._answer(
                "unknown", f"Nobody reports on the goal {self.to}: it is not known how it goes on"
            )
        if own and status is not None:
            match status.state:
                case MissionState.REACHED if status.doubt:
                    return self._answer("unsure", f"At {self.to} perhaps", status.doubt)
                case MissionState.REACHED:
                    return self._answer("reached", f"The robot has reached {self.to}")
                case MissionState.FAILED if status.note.startswith(CANCELLED):
                    return self._answer("cancelled", f"The way to {self.to} was {status.note}")
                case MissionState.FAILED:
                    return self._answer("failed", f"It did not reach {self.to}", status.note)
            stop = view.stop
            if stop.stopped:
                what = f"The robot is stopped by {stop.requester} on its way to {self.to}"
                return self._answer("stopped", what, "a person has to release it; then it goes on")
        elif status is not None and status.mission and (self.seen or self._late(now)):
            by = society.orderer(status.mission) or "people or another agent"
            return self._answer("superseded", f"Another goal, by {by}, replaced {self.to}")
        if now < self.until:
            return None
        return self._answer("driving", f"Still on its way to {self.to}, {self.news(society)}")

    def news(self, society: Society) -> str:
        """Return how far it is, for people."""
        status = society.view.mission
        if status is None or status.mission != self.mission:
            return "not reported yet"
        note = status.note or status.late
        return line(f"{status.to_go:.1f} m to go{f', {note}' if note else ''}")

    def _late(self, now: float) -> bool:
        """Return whether a goal that was never reported is no goal any more."""
        return now - self.began > SILENCE_S

    def _answer(self, end: str, what: str, why: str = "") -> JsonObject:
        text = line(f"{what}{f': {why}' if why else ''}.")
        found: JsonObject = {"text": text, "end": end, "mission": str(self.mission)}
        return found | ({"why": why} if why else {})
