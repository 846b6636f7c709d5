"""The sensor readings of a cycle as messages: the sonars' echoes, the laser's scan.

A silent sensor publishes nothing: stale obstacles do not show free space. Each silence is reported
once.
"""

from __future__ import annotations

from math import isfinite, isnan

from msgspec.structs import replace

from armadico.bridge.session import Reported, Swept
from armadico.config.profile import RobotProfile, SonarRing
from armadico.core.messages import Cycle, Message
from armadico.mobile.messages import Echo, Scan, Sonar
from armadico.mobile.scans import message_of

SILENT = 4
"""Cycles without a reading after which a sensor counts as silent."""

SONAR, LASER = "sonar", "laser"


def sound(report: Reported) -> tuple[Reported | None, str]:
    """The report without what is no number, and which field that was; "" if none.

    Without a pose or speeds there is no report. The battery and each echo are left out alone: an
    echo that is no number is no free space.
    """
    pose = report.pose
    numbers = {"pose.x": pose.x, "pose.y": pose.y, "pose.theta": pose.theta}
    for name, value in {**numbers, "v": report.v, "w": report.w}.items():
        if not isfinite(value):
            return None, f"{name} = {value}"
    fault = ""
    if not isfinite(report.battery_v):
        fault, report = f"battery_v = {report.battery_v}", replace(report, battery_v=0.0)
    if any(isnan(distance) for _, distance in report.echoes):
        echoes = tuple(each for each in report.echoes if not isnan(each[1]))
        fault, report = "an echo that is no number", replace(report, echoes=echoes)
    return report, fault


class Readings:
    """A robot's sensors.

    Attributes:
        sensors: Their names, as in `Description`.
        provides: The messages that they publish.
        sonar: This cycle's echoes; None: no sonar fired, or it has none.
        scan: This cycle's newest scan; None: there is no fresh one.
        complaints: Faults since the last cycle.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self._ring, self._has_laser = profile.sonar, profile.laser is not None
        topic = profile.scans_from
        self._awaited = f"no scan on {topic}" if topic else "no scan"
        provided: dict[str, type[Message]] = {}
        if profile.sonar is not None:
            provided[SONAR] = Sonar
        if self._has_laser:
            provided[LASER] = Scan
        self.sensors, self.provides = tuple(provided), tuple(provided.values())
        self.sonar: Sonar | None = None
        self.scan: Scan | None = None
        self.complaints: tuple[str, ...] = ()
        self._no_echo = self._no_scan = 0  # cycles since a sonar fired, and since a scan arrived

    def update(self, cycle: Cycle, report: Reported) -> None:
        self.complaints = ()
        if self._ring is not None:
            echoes = _echoes(self._ring, report)
            self.sonar = Sonar(cycle, self._ring.max_m, echoes) if echoes else None
            self._no_echo = 0 if echoes else self._no_echo + 1
            if self._no_echo == SILENT:
                self._complain(f"no sonar has fired for {SILENT} cycles")
        if self._has_laser:
            wrong = f"{self._awaited} for {SILENT} cycles"
            try:
                self.scan = _scan(cycle, report.scan)
            except ValueError as error:
                self.scan, wrong = None, str(error)
            self._no_scan = 0 if self.scan is not None else self._no_scan + 1
            if self._no_scan == SILENT:
                self._complain(f"no reading of the laser, {wrong}")

    def _complain(self, what: str) -> None:
        self.complaints += (f"{what}: no agent drives blind",)


def _scan(cycle: Cycle, swept: Swept | None) -> Scan | None:
    """The scan as a message. Raises ValueError if it is invalid."""
    if swept is None:
        return None
    return message_of(
        cycle,
        swept.ranges,
        (swept.first, swept.step),
        (swept.least, swept.most),
        swept.mount,
        upside_down=swept.upside_down,
        since=swept.since,
        number=swept.number,
    )


def _echoes(ring: SonarRing, report: Reported) -> tuple[Echo, ...]:
    places = report.sonars or tuple(sonar.place for sonar in ring.sonars)
    echoes = []
    for index, distance in report.echoes:
        if index < len(places):
            echoed = 0.0 < distance < ring.max_m * 0.999
            echoes.append(Echo(*places[index], distance if echoed else None))
    return tuple(echoes)
