"""How a goal ended is told once, and not before it is known."""

from __future__ import annotations

import pytest

from armadico.core.messages import Cycle, RobotState, Stop
from armadico.launch.client import SILENCE_S
from armadico.mobile.messages import MissionState, MissionStatus
from armadico.observe.jsons import JsonObject
from armadico.watch.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.watch.mcp.answers import Society
from armadico.watch.mcp.waiting import Wait

OWN, OTHER = 7, 8
DRIVING = MissionStatus(OWN, MissionState.DRIVING, 2.5)


def society(*statuses: MissionStatus, at: float = 1.0) -> Society:
    made = Society(None, {})
    for status in statuses:
        made.update("mission/status", status, at)
    return made


def wait() -> Wait:
    return Wait(OWN, "kitchen", began=1.0, until=60.0)


def ended(waits: Wait, society: Society, now: float) -> JsonObject:
    found = waits.end(society, now)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("status", "end", "why"),
    [
        (MissionStatus(OWN, MissionState.REACHED, 0.0), "reached", None),
        (MissionStatus(OWN, MissionState.REACHED, 0.0, note="+-0.4 m"), "unsure", "+-0.4 m"),
        (MissionStatus(OWN, MissionState.FAILED, 1.0, note="no way"), "failed", "no way"),
        (MissionStatus(OWN, MissionState.FAILED, 1.0, note="cancelled by ann"), "cancelled", None),
    ],
)
def test_an_end_is_told_with_the_reason(status: MissionStatus, end: str, why: str | None) -> None:
    found = ended(wait(), society(DRIVING, status), 2.0)
    assert (found["end"], found.get("why"), found["mission"]) == (end, why, str(OWN))
    assert "kitchen" in str(found["text"])


def test_under_way_it_waits_until_its_time_is_over_and_says_how_far_it_is() -> None:
    waits, under_way = wait(), society(DRIVING, at=58.0)
    assert waits.end(under_way, 59.0) is None
    assert waits.news(under_way) == "2.5 m to go"
    found = ended(waits, under_way, 60.0)
    assert found["end"] == "driving"
    assert "2.5 m to go" in str(found["text"])


def test_the_report_on_an_older_goal_is_not_the_end_of_this_one() -> None:
    older = MissionStatus(OTHER, MissionState.REACHED, 0.0)
    waits = wait()
    assert waits.end(society(older), 2.0) is None
    found = ended(waits, society(older, at=1.0 + SILENCE_S), 1.1 + SILENCE_S)
    assert found["end"] == "superseded", "it never came"


def test_a_goal_that_another_one_replaced_names_who_ordered_that() -> None:
    waits, replaced = wait(), society(DRIVING)
    assert waits.end(replaced, 1.5) is None
    request = AssistantRequest("goto", "{}", "another model")
    replaced.update("assistant/record", AssistantRecord(1, request, AssistantReply(mission=8)), 2.0)
    replaced.update("mission/status", MissionStatus(OTHER, MissionState.DRIVING, 4.0), 2.0)
    found = ended(waits, replaced, 2.0)
    assert found["end"] == "superseded"
    assert "another model" in str(found["text"])


def test_a_stop_ends_the_wait_since_only_a_person_ends_the_stop() -> None:
    stopped = society(DRIVING)
    state = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, True, False, Stop(1, True, "ann", 5))
    stopped.update("robot/state", state, 1.5)
    found = ended(wait(), stopped, 2.0)
    assert found["end"] == "stopped"
    assert "ann" in str(found["text"])


def test_without_reports_it_is_not_known_how_it_ends() -> None:
    found = ended(wait(), society(DRIVING, at=2.0), 2.1 + SILENCE_S)
    assert found["end"] == "unknown"
