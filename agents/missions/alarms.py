"""The alarms of a scenario's building, which begin and end at their times (thesis 4.3)."""

from __future__ import annotations

from collections.abc import Iterator

from armadico.agents.missions.messages import Alarm
from armadico.config.scenarios import AlarmAt, Scenario
from armadico.mobile.errand import Progress


class Building:
    """The alarms of a scenario's building: a guest of the society, that rings when it is time."""

    def __init__(self, scenario: Scenario) -> None:
        self._to_come = list(scenario.alarms)
        self._to_end: list[tuple[float, str]] = []

    def due(self, elapsed: float, mission: Progress | None) -> Iterator[Alarm]:
        """Those that begin or end by now, s since the run began, each once."""
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
