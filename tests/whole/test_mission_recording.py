"""A mission that was recorded: what it did can be told from the file alone."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TypeVar

import pytest

pytest.importorskip("mcap")

from mcap.reader import make_reader

from armadico.agents.missions.messages import Alarm, Board, MissionEnd, Photo, Subplan
from armadico.core.messages import Ack, Claim, Message, RobotState, encode
from armadico.mobile.messages import Pose, Truth
from armadico.observe.watching import Received
from armadico.watch.recorder import Recording
from armadico.watch.recordings import HERE, kinds, rows
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.recording import check, observations
from tests.laboratory.recorded import LIVE
from tests.missions.test_surveillance import FINAL, ORIGINAL, surveillance
from tests.once import Once

M = TypeVar("M", bound=Message)

SECOND = 1_000_000_000


@pytest.mark.long
@pytest.mark.timeout(300)  # a whole mission, and four workers share two cores
def test_a_mission_is_read_back_as_it_was(tmp_path: Path, once: Once) -> None:
    path = tmp_path / "mission.mcap"
    said = surveillance(once, "ideal").said
    recording = Recording(path)
    for now, key, message in said:
        recording.add(Received("robot1", key, encode(message), round(now * SECOND)))
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
    # On the publisher's key, and a copy for agents of protocol 2.
    on = [key for key, alarm in read if isinstance(alarm, Alarm) and alarm.on]
    assert on == ["alarm/guest-client", "alarm"]
    assert {alarm.room for alarm in heard(Alarm) if alarm.on} == {"R21"}
    assert [photo.room for photo in heard(Photo)] == ["R1", "R11"]
    assert len(heard(Subplan)) == 2
    assert heard(Truth)[-1].collisions == 0
    cycles = {state.cycle.number for state in heard(RobotState)}
    assert len({pose.cycle.number for pose in heard(Pose)} & cycles) > 1000
    who = {claim.ballot.instance.rpartition("-")[0] for claim in heard(Claim)}
    assert {"goto", "gothrough", "mission-planning"} <= who
    assert not check(path, None, pytest.fail).violations


@pytest.mark.long
def test_ten_minutes_of_real_processes_kept_every_promise() -> None:
    """`armadico up surveillance`, recorded live, and read back (`tests.laboratory.recorded`)."""
    read = [*rows(LIVE, pytest.fail)]
    who = Counter(row.fields["name"] for row in read if row.schema == HERE)
    assert read[-1].t - read[0].t > 595 * SECOND
    assert set(who.values()) == {1}, "nobody left, or was started again"
    assert {"robot", "mission-planning", "planner-onward", "monitor", "wakeup"} <= set(who)
    assert len(who) >= 15

    def all_of(kind: type[M]) -> list[M]:
        said = (row.message for row in read if kinds().get(row.schema) is kind)
        return [message for message in said if isinstance(message, kind)]

    missions = {mission.name: mission for mission in all_of(Board)[-1].missions}
    assert {name: mission.state for name, mission in missions.items()} == {
        "surveillance": MissionEnd.DONE,
        "rounds": MissionEnd.ACTIVE,
    }
    steps = [result.step for result in missions["surveillance"].course.results]
    assert steps == [*ORIGINAL[:3], *FINAL]
    assert {alarm.room for alarm in all_of(Alarm) if alarm.on} == {"R21"}
    assert [photo.room for photo in all_of(Photo)][:2] == ["R1", "R11"]
    assert all_of(Truth)[-1].collisions == 0
    obeyed = {ack.obeyed.instance for ack in all_of(Ack) if ack.obeyed is not None}
    assert {one.rpartition("-")[0] for one in obeyed} >= {"goto", "gothrough", "mission-planning"}
    with LIVE.open("rb") as stream:  # by a reader that is not ours
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(read)
    assert not Checker().update_all(observations(read))
