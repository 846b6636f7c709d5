"""Doors that shut and things that are put down: another way, patience, or an end that says why."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.core.messages import RobotState
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MissionStatus, Trajectory
from armadico.observe.measures import Result
from tests.robot.agents.test_path_planning import TWO_DOORS

ONE_DOOR = (
    "\n".join(line for line in TWO_DOORS.splitlines() if '"far"' not in line)
    .replace("4500 3500 4500 4600", "4500 3500 4500 6000")
    .replace("NumLines: 7", "NumLines: 6")
    .replace("4500 5600 4500 6000\n", "")
)
"""Without the far one."""


class Drive:
    """A run between the rooms, watched."""

    def __init__(
        self,
        folder: Path,
        world: str,
        moving: str,
        seed: int,
        limit: float = 400,
        parameters: str = "",
    ) -> None:
        (folder / "doors.map").write_text(world + "\n")
        path = folder / "doors.toml"
        path.write_text(
            'world = "doors.map"\nstart = [1.5, 3.0, 0.0]\ngoal = [7.5, 3.0, 0.0]\n'
            f'plan = "rooms"\n{moving}'
        )
        chosen = folder / "parameters.toml"
        chosen.write_text(parameters)
        self.notes: list[tuple[float, str]] = []
        self.missions: set[int] = set()
        self.speed = 0.0
        self.scenario: Scenario = ideal(load_scenario(path))
        self.rehearsal = Rehearsal(
            self.scenario, Options(seed=seed, limit=limit, parameters=str(chosen))
        )
        mesh = self.rehearsal.mesh
        mesh.watch(lambda _k, m, t: self.notes.append((t, m.note)), MissionStatus)
        mesh.watch(lambda _k, m, _t: self.missions.add(m.mission), Trajectory)
        mesh.watch(self._state, RobotState)

    def _state(self, _key: str, state: RobotState, _now: float) -> None:
        self.speed = abs(state.v)

    def run(self) -> Result:
        result = self.rehearsal.run()
        assert len(self.missions) == 1, "the mission is the same, whatever its way"
        return result

    def waited(self) -> float:
        """For how long no way was free, s."""
        times = [t for t, note in self.notes if note.startswith("waits")]
        return times[-1] - times[0] if times else 0.0


IMPATIENT = "[interface]\ngive_up_s = 20.0\n"


def door(*times: float) -> str:
    """The near door shuts, and opens again."""
    return f'[[moving]]\nkind = "door"\nwall = [4.5, 2.5, 4.5, 3.5]\ntimes = {list(times)}\n'


@pytest.mark.parametrize("seed", [1])
def test_a_door_that_is_shut_is_gone_round_by_another(tmp_path: Path, seed: int) -> None:
    drive = Drive(tmp_path, TWO_DOORS, door(2.0), seed)
    result = drive.run()
    assert (result.reached, result.collisions) == (True, 0)
    assert max(mark.y for mark in drive.rehearsal.watch.path) > 4.5
    assert result.tt_s < 90.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [1])
def test_where_the_only_door_shuts_for_a_minute_it_waits_and_goes_on(
    tmp_path: Path, seed: int
) -> None:
    drive = Drive(tmp_path, ONE_DOOR, door(2.0, 62.0), seed)
    result = drive.run()
    assert (result.reached, result.collisions) == (True, 0)
    assert drive.waited() > 20.0
    assert 60.0 < result.tt_s < 120.0


@pytest.mark.long
def test_where_it_never_opens_the_mission_fails_with_the_reason_and_the_robot_stands(
    tmp_path: Path,
) -> None:
    drive = Drive(tmp_path, ONE_DOOR, door(2.0), seed=1, parameters=IMPATIENT)
    result = drive.run()
    assert not result.reached
    assert not result.passed
    assert result.limit_s is None, "it ended before its time"
    assert "door near leaves" in result.why
    drive.rehearsal.mesh.run(drive.rehearsal.mesh.now + 3.0)  # it may be under way to look again
    assert drive.speed < 0.01
    assert result.collisions == 0


@pytest.mark.long(but=("person",))
@pytest.mark.parametrize(
    "moving",
    [
        '[[moving]]\nkind = "box"\nat = [4.6, 3.0]\nsize = [0.5, 0.9]\ntimes = [2.0, 40.0]\n',
        '[[moving]]\nkind = "person"\nat = [4.5, 3.0]\nspeed = 0.01\n',
    ],
    ids=["box", "person"],
)
def test_what_stands_in_a_door_is_gone_round_by_another(tmp_path: Path, moving: str) -> None:
    result = Drive(tmp_path, TWO_DOORS, moving, seed=1).run()
    assert (result.reached, result.collisions) == (True, 0)


def test_a_box_put_down_across_the_way_is_driven_round_in_the_same_room(tmp_path: Path) -> None:
    box = '[[moving]]\nkind = "box"\nat = [3.0, 3.0]\nsize = [0.4, 1.6]\ntimes = [1.5]\n'
    result = Drive(tmp_path, TWO_DOORS, box, seed=1).run()
    assert (result.reached, result.collisions) == (True, 0)
