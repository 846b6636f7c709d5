"""Alarms: those of a scenario's building (thesis 4.3), and those known to mission planning."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from armadico.agents.missions.messages import Alarm, Board
from armadico.agents.missions.wanted import Patience
from armadico.config.scenarios import AlarmAt, Scenario
from armadico.mobile.errand import Progress

MOST: Final = 32  # alarms that are stored


class Alarms:
    """The active alarms, those not yet checked by a robot, and those that cannot be reached."""

    def __init__(self, rooms: Iterable[str]) -> None:
        """`rooms`: those that a robot can reach."""
        self._rooms = frozenset(rooms)
        self.on: tuple[str, ...] = ()
        self.unchecked: tuple[str, ...] = ()
        self.no_way: dict[str, Patience] = {}

    def learn(self, board: Board) -> None:
        """Take over the alarms of an earlier mission planning agent's board."""
        self.on = self._known((*board.alarms, *self.on))
        self.unchecked = self._known((*board.unchecked, *self.unchecked))

    def _known(self, rooms: Iterable[str]) -> tuple[str, ...]:
        return tuple(room for room in dict.fromkeys(rooms) if room in self._rooms)[:MOST]

    def update(self, alarm: Alarm) -> bool:
        """Process the begin or end of an alarm; return whether anything has changed."""
        room = alarm.room
        if alarm.on == (room in self.on) or (alarm.on and len(self.on) >= MOST):
            return False
        if alarm.on:
            self.on, self.unchecked = (*self.on, room), (*self.unchecked, room)
        else:
            self.on = tuple(other for other in self.on if other != room)
            self.checked(room)
        return True

    def checked(self, room: str) -> None:
        """Mark a room's alarm as checked."""
        self.unchecked = tuple(other for other in self.unchecked if other != room)
        self.no_way.pop(room, None)

    def due(self, now: float) -> str | None:
        """Return the first unchecked alarm that is to be handled now, or None."""
        known = Patience()
        due = (r for r in self.unchecked if now >= self.no_way.get(r, known).again_at)
        return next(due, None)


class Building:
    """The alarms of a scenario's building; publishes them as a guest of the society."""

    def __init__(self, scenario: Scenario) -> None:
        self._to_come = list(scenario.alarms)
        self._to_end: list[tuple[float, str]] = []

    def due(self, elapsed: float, mission: Progress | None) -> Iterator[Alarm]:
        """Yield alarms that begin or end by `elapsed`, s since the run began, each once."""
        for alarm in [alarm for alarm in self._to_come if _begins(alarm, elapsed, mission)]:
            self._to_come.remove(alarm)
            if alarm.lasts_s is not None:
                self._to_end.append((elapsed + alarm.lasts_s, alarm.room))
            yield Alarm(alarm.room)
        for end in [end for end in self._to_end if end[0] <= elapsed]:
            self._to_end.remove(end)
            yield Alarm(end[1], on=False)


def _begins(alarm: AlarmAt, elapsed: float, mission: Progress | None) -> bool:
    if alarm.at_s is not None:
        return elapsed >= alarm.at_s
    if mission is None or mission.doing.partition("(")[0] != alarm.during:
        return False
    return alarm.within in (None, mission.room)
