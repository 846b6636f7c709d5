"""Drives to goals, from messages, and how they differed from what was told before."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from armadico.core.messages import Cycle, Message, Point, RobotState
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Trajectory, Waypoint
from armadico.observe.journeys import Journey, Journeys, compared
from armadico.observe.slowness import Spot
from armadico.observe.view import View

GOAL = (5.0, 0.5, 0.0)
TOLD = {
    "answer": "yes",
    "arrives": 4,
    "samples": 4,
    "time_s": [20.0, 21.0, 23.0],
    "way_m": 5.0,
    "slow": [{"x": 3.5, "y": 0.5, "seconds": 2.0, "why": "goto drives"}],
}


def drive(mission: int, end: MissionState, stands_s: float = 0.0) -> Iterator[Message]:
    """A mission: 2 m ahead at 0.5 m/s, then standing there, then its end."""
    way = Trajectory(mission, mission, (Waypoint(*GOAL),), Point(1.4, 0.6))
    yield way
    yield MissionStatus(mission, MissionState.DRIVING, 5.0)
    for k in range(40 + round(10 * stands_s)):
        cycle, moves = Cycle(1, 1000 * mission + k), k < 40
        yield Pose(cycle, 1.5 + 0.05 * min(k, 40), 0.5, 0.0)
        yield RobotState(cycle, 0, 0, 0, 0.5 if moves else 0.0, 0, 12, True, False)
    yield MissionStatus(mission, end, 3.0, note="no path" if end is MissionState.FAILED else "")


def journeys(*messages: Message) -> list[Journey]:
    """What is found; a robot's state is each 0.1 s."""
    found, view, t = Journeys(), View(), 100.0
    for message in messages:
        t += 0.1 if isinstance(message, RobotState) else 0.0
        view.update("robot1/x", message, t)
        view.learn(message, t)
        found.update(message, view, t)
    return found.done


def test_each_mission_is_a_drive_with_where_it_was_slow() -> None:
    one, other = journeys(
        *drive(1, MissionState.REACHED, 12.0),
        *drive(2, MissionState.FAILED),
        *drive(3, MissionState.DRIVING),
    )
    assert (one.goal, one.reached, one.seconds) == (GOAL, True, pytest.approx(16.0))
    assert one.way_m == pytest.approx(2.0)
    assert one.start == (1.5, 0.5)
    (spot,) = one.slow
    assert (spot.x, spot.y, spot.why) == (3.5, 0.5, "no agent drives")
    assert spot.seconds == pytest.approx(12.0, abs=0.5)
    assert (other.reached, other.note) == (False, "no path")


def test_drive_that_was_under_way_when_the_recording_began_is_none() -> None:
    """A recorder that joins receives the last path and status first."""
    way, status, *rest = drive(1, MissionState.REACHED)
    again = Trajectory(1, 1, (Waypoint(*GOAL),), Point(3.0, 0.5))  # replanned
    late = (way, status, *rest[40:60], again, *rest[60:])
    (only,) = journeys(*late, *drive(2, MissionState.REACHED))
    assert (only.seconds, only.way_m) == (pytest.approx(4.0), pytest.approx(2.0))
    assert journeys(way, status, rest[-1]) == [], "nobody knows where it began"


def test_mission_that_replaces_another_ends_its_drive() -> None:
    (first,) = journeys(
        *[*drive(1, MissionState.REACHED)][:-1], *[*drive(2, MissionState.REACHED)][:-1]
    )
    assert not first.reached
    assert "another mission" in first.note


def driven(seconds: float, *slow: Spot, way_m: float = 5.0, reached: bool = True) -> Journey:
    why = "" if reached else "no path"
    return Journey(GOAL, 0.0, seconds, reached, way_m, why, slow, (1.5, 0.5), "house")


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (driven(22.0), "as told"),
        (driven(23.0), "as told"),
        (driven(24.0), "3 s longer"),  # the interval that was told has its own margin
        (driven(10.0), "faster"),
        (
            driven(35.0, Spot(3.5, 0.5, 9.0, "goto drives")),
            "since it was slow for 7 s near (3.5, 0.5)",
        ),
        (driven(35.0, way_m=9.0), "since the way was 4.0 m longer"),
        (driven(60.0, reached=False), "not reached after 60 s: no path"),
    ],
)
def test_difference_is_told_with_its_reason(one: Journey, words: str) -> None:
    said = compared(one, TOLD)
    assert "rehearsed: yes, 4 of 4 arrive in 21 s (20 to 23)" in said
    assert words in said


def test_rehearsal_in_which_none_arrived_has_no_time_to_compare() -> None:
    said = compared(driven(35.0), {**TOLD, "answer": "no", "arrives": 0, "time_s": []})
    assert "0 of 4 arrive; driven: reached in 35 s" in said
