"""A mission that was recorded: what it did can be told from the file alone."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import pytest

pytest.importorskip("mcap")

from armadico.core.messages import (
    Alarm,
    Board,
    Claim,
    Message,
    MissionEnd,
    Photo,
    Pose,
    RobotState,
    Subplan,
    Truth,
    encode,
)
from armadico.observe.recorder import Recording
from armadico.observe.recordings import rows
from armadico.observe.watching import Heard
from armadico_tools.faults.real_recording import check
from tests.missions.test_surveillance import FINAL, ORIGINAL, surveillance
from tests.once import Once

M = TypeVar("M", bound=Message)

SECOND = 1_000_000_000


def test_a_mission_is_read_back_as_it_was(tmp_path: Path, once: Once) -> None:
    path = tmp_path / "mission.mcap"
    said = surveillance(once).said
    recording = Recording(path)
    for now, key, message in said:
        recording.take(Heard("robot1", key, encode(message), round(now * SECOND)))
    recording.close()
    assert not recording.refused
    read = [(row.key, row.message) for row in rows(path, pytest.fail)]
    assert len(read) == len(said)
    assert all(one == other[1:] for one, other in zip(read, said, strict=True))

    def heard(kind: type[M]) -> list[M]:
        return [message for _, message in read if isinstance(message, kind)]

    (mission,) = heard(Board)[-1].missions
    assert mission.state is MissionEnd.DONE
    steps = [result.step for result in mission.course.results]
    assert steps == [*ORIGINAL[:3], *FINAL]
    assert [alarm.room for alarm in heard(Alarm) if alarm.on] == ["R21"]
    assert [photo.room for photo in heard(Photo)] == ["R1", "R11"]
    assert len(heard(Subplan)) == 2
    assert heard(Truth)[-1].collisions == 0
    cycles = {state.cycle.number for state in heard(RobotState)}
    assert len({pose.cycle.number for pose in heard(Pose)} & cycles) > 1000
    who = {claim.ballot.instance.rpartition("-")[0] for claim in heard(Claim)}
    assert {"goto", "gothrough", "mission-planning"} <= who
    assert not check(path, None, pytest.fail).violations
