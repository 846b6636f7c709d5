"""`armadico why --live` tells how a drive differed from its rehearsal."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.config.named import DATA_VARIABLE
from armadico.core.judgement import yes
from armadico.core.messages import Cycle, Message, Point, RobotState
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Trajectory, Waypoint
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.fork import Errand
from armadico.rehearsal.store import note
from armadico.watch.commands.why import with_drives
from armadico.watch.why import Chronicle

GOAL = (5.0, 0.5, 0.0)
BEGAN = 1000.0


def drive(seconds: float) -> list[tuple[float, Message]]:
    """It begins 3 s after the observation."""
    at, mission = BEGAN + 3.0, MissionStatus(1, MissionState.DRIVING, 5.0)
    way = Trajectory(1, 1, (Waypoint(*GOAL),), Point(1.5, 0.5))
    found: list[tuple[float, Message]] = [(at, way), (at, mission)]
    for k in range(round(10 * seconds)):
        at += 0.1
        cycle = Cycle(1, k)
        found.append((at, Pose(cycle, 1.5 + 3.5 * k / (10 * seconds), 0.5, 0.0)))
        found.append((at, RobotState(cycle, 0, 0, 0, 0.2, 0, 12, True, False)))
    return [*found, (at, replace(mission, state=MissionState.REACHED))]


def test_drive_meanwhile_is_compared_with_its_rehearsal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    told = Rehearsed(
        judgement=yes(), arrives=4, samples=4, time_s=(9, 10, 11), start=(1.5, 0.5), goal=GOAL
    )
    note("robot", Errand(goal=GOAL), told, BEGAN - 60.0)
    chronicle = Chronicle()
    chronicle.begin(BEGAN)
    for at, message in drive(20.0):
        chronicle.update("robot/x", message, at)
    chronicle.mark(chronicle.now)
    chronicle.finish()
    said = with_drives(chronicle, "robot", BEGAN).sentences[-1]
    assert "rehearsed: yes, 4 of 4 arrive in 10 s (9 to 11); driven: reached in 20 s" in said
    assert "10 s longer" in said
    assert not any("rehearsed" in each for each in with_drives(chronicle, "other", BEGAN).sentences)
