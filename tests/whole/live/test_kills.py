"""Promises 1, 3 and 4 with real processes: any agent may be killed, one after another."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.society import LINE
from tests.whole.live.speeds import statuses_until_stop

pytestmark = pytest.mark.live

MOST_STATUSES = 8
"""Status packets until a stop is ordered: 3 when all is well, and some for a loaded machine."""


@pytest.mark.long
def test_without_the_driver_fresh_obstacles_or_a_pose_a_stop_is_ordered(start: Start) -> None:
    """And who is started again takes its place."""
    society = start()
    for name in ("goto", "sonar", "encoder"):
        mark = len(society.tap.packets)
        society.kill(name)
        society.stops(mark)
        society.nobody_drives()
        assert statuses_until_stop(society.tap.packets) <= MOST_STATUSES, name
        society.nobody_else_died(name)
        society.restart(name)
        society.drives_on()
    ballots_never_go_down(society.acks)


@pytest.mark.long
def test_the_second_of_each_behaviour_drives_on_when_the_first_is_killed(start: Start) -> None:
    society = start(replace(LINE, redundant=True))
    dead = society.holder
    (process,) = (
        p for p in society.launcher.processes if p.popen.pid == society.pid_of("goto", dead)
    )
    society.kill(process.name)
    society.until(lambda: society.holder not in ("", dead), "another one is obeyed")
    society.drives_on()
    assert society.holder.startswith("goto-")
    assert [p.name for p in society.launcher.processes if p.ended()] == [process.name]
    ballots_never_go_down(society.acks)


@pytest.mark.long
def test_those_who_do_not_drive_may_die_one_after_another(start: Start) -> None:
    society = start()
    dead: list[str] = []
    for name in ("interface", "path-planning", "gothrough", "avoid"):
        holder = society.holder
        society.kill(name)
        dead.append(name)
        society.drives_on()
        assert society.holder == holder
        society.nobody_else_died(*dead)
    ballots_never_go_down(society.acks)


def test_without_the_robot_agent_the_guard_of_its_line_stops_the_wheels(start: Start) -> None:
    society = start()
    mark = len(society.tap.packets)
    society.kill("robot")
    society.until(society.at_rest, "the wheels rest")
    assert society.tap.commands(mark), "the guard brakes"
    society.nobody_drives()
    society.nobody_else_died("robot")


@pytest.mark.long
def test_without_the_simulator_the_robot_agent_says_so_and_all_live(start: Start) -> None:
    society = start()
    society.kill("simulator")
    society.until(lambda: any("is gone" in text for text in society.logs), "the port is gone")
    ended = [process.name for process in society.launcher.processes if process.ended()]
    assert ended == ["simulator"]
