"""A mission that was recorded: what it did can be told from the file alone."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import pytest

pytest.importorskip("mcap")

from armadico.config.scenarios import load_scenario
from armadico.core.messages import (
    Alarm,
    Board,
    Card,
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
from armadico.core.services import SERVICES, Kind
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.observe.recorder import Recording
from armadico.observe.recordings import rows
from armadico.observe.watching import Heard
from armadico_tools.faults.real_recording import check
from tests.missions.test_surveillance import FINAL, ORIGINAL

M = TypeVar("M", bound=Message)

SECOND = 1_000_000_000
SAID = [s.message for s in SERVICES if s.kind is not Kind.QUERY]


def drive(path: Path) -> list[tuple[str, Message]]:
    """The surveillance scenario with everything recorded that is said; and what that was."""
    options = Options(seed=6, sensors="ideal")
    rehearsal = Rehearsal(prepared(load_scenario("surveillance"), options), options)
    recording, said = Recording(path), list[tuple[str, Message]]()

    def take(key: str, message: Message, now: float) -> None:
        said.append((key, message))
        recording.take(Heard("robot1", key, encode(message), round(now * SECOND)))

    rehearsal.mesh.watch(take, *dict.fromkeys([*SAID, Claim, Card]))
    assert rehearsal.run().passed
    recording.close()
    assert not recording.refused
    return said


def test_a_mission_is_read_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "mission.mcap"
    said = drive(path)
    read = [(row.key, row.message) for row in rows(path, pytest.fail)]
    assert len(read) == len(said)
    assert all(one == other for one, other in zip(read, said, strict=True))

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
