"""The monitor's auditor: what breaks a promise is reported, and named by the diagnosis."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from armadico.agents.supervision import monitor
from armadico.agents.supervision.monitor import Monitor
from armadico.core.agent import Identity
from armadico.core.messages import (
    Ack,
    Ballot,
    Log,
    Message,
    MonitorReport,
    Point,
    RobotState,
    Twist,
)
from armadico.core.resources import WHEELS
from armadico.observe.diagnosis import diagnose
from armadico.observe.findings import Sort
from armadico.observe.view import View
from armadico.testing.alone import Alone, obstacles

LIAR = "liar-0123456789ab"


def watched(alone: Alone, seconds: float, ordered: float, *, free_m: float) -> list[Message]:
    """The liar holds the wheels and orders a speed; the robot agent lets nothing through."""
    found: list[Message] = []
    for _ in range(round(10 * seconds)):
        alone.number, alone.now = alone.number + 1, alone.now + 0.1
        by = Ballot(1, 0.99, False, LIAR)
        state = RobotState(
            *(alone.at, 0.0, 0.0, 0.0, 0.0, 0.0, 12.0, True, False),
            ordered=Twist(ordered, 0.0),
            capped="an obstacle is in the way" if ordered else "",
        )
        ahead = obstacles(alone.at, Point(free_m, 0.0))
        found += alone.give(ahead, Ack(WHEELS.name, alone.at, by, by, alone.at), state)
        found += alone.wake()
    return found


def begun() -> Alone:
    alone = Alone(Monitor(Identity("monitor-1")))
    alone.agent.kernel.start(0.0)
    return alone


def test_an_agent_that_commands_what_the_readings_forbid_is_named_within_two_seconds() -> None:
    alone = begun()
    watched(alone, 3.0, 0.0, free_m=0.5)
    assert not alone.last(MonitorReport).broken
    watched(alone, 2.0, 0.25, free_m=0.5)
    report = alone.last(MonitorReport)
    assert [text.split(": ")[:2] for text in report.broken] == [["HONEST", "liar"]]
    assert len([log for log in alone.all(Log) if "HONEST" in log.text]) == 1, "once, not each cycle"

    view = View()
    view.begin(0.0)
    view.token("monitor-1", there=True, t=0.0)
    view.token("robot-1", there=True, t=0.0)
    view.update("monitor/monitor-1", replace(report, acts=True), 5.0)
    (found,) = (each for each in diagnose(view, now=5.0) if each.sort is Sort.PROMISE)
    assert "liar" in found.what


def test_what_was_broken_is_reported_for_a_minute() -> None:
    alone = begun()
    watched(alone, 2.0, 0.25, free_m=0.5)
    assert alone.last(MonitorReport).broken
    watched(alone, 63.0, 0.0, free_m=0.5)
    assert not alone.last(MonitorReport).broken


def test_an_auditor_that_fails_is_no_end_of_the_monitor(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(monitor.AUDITOR, "update", fails)
    alone = begun()
    watched(alone, 3.0, 0.25, free_m=0.5)
    (said,) = (log.text for log in alone.all(Log) if "auditor" in log.text)
    assert "not judged" in said
    assert alone.last(MonitorReport).broken == (), "nothing is found, and it said why"
