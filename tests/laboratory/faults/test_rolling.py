"""A robot without a watchdog, its robot agent and its guard, which are killed and hang."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import closing, suppress

import psutil
import pytest

from armadico.core.messages import RobotState
from armadico.launch.client import Client
from armadico.mesh import sockets
from armadico.runtime.errors import StopError
from armadico_tools.bench.rolling import FAULTS, Line, Rig
from armadico_tools.testbed import Place

pytestmark = pytest.mark.live

SOON = 20.0
LINE = Line("tcp", "turtlebot3-burger", 0.2)


@pytest.fixture
def rig() -> Iterator[tuple[Rig, Place]]:
    with Place("rolling-test") as place:
        rig = Rig(LINE, place)
        with rig.driving():
            yield rig, place


def test_whatever_of_it_is_killed_or_hangs_the_robot_rests_and_drives_again(
    rig: tuple[Rig, Place],
) -> None:
    for fault in (*FAULTS, "kill"):
        assert not rig[0].make(fault).rolls_on, fault


def test_a_stop_at_the_guard_of_a_hanging_robot_agent_is_latched_until_it_is_released(
    rig: tuple[Rig, Place],
) -> None:
    robot, place = rig
    with closing(place.mesh()) as mesh:
        client = Client(mesh)
        client.listen(RobotState)
        robot.drive()
        robot.robot.send_signal(signal.SIGSTOP)
        found = sockets.stop(place.namespace)
        assert found.guard is not None
        assert (found.guard.agent, found.latched) == (robot.robot.pid, False)
        robot.awaits_rest()
        robot.robot.resume()
        assert client.wait_for(lambda: _stopped(client), SOON)
        # The guard's order and the signal reach the agent one after the other: two stops.
        assert any(_released(client) for _ in range(2))
        robot.drive()


def test_no_guard_is_left_of_a_robot_agent_that_is_ended(rig: tuple[Rig, Place]) -> None:
    robot, place = rig
    robot.drive()
    guard = robot.guard
    robot.robot.send_signal(signal.SIGTERM)
    psutil.wait_procs([guard], SOON)
    assert not guard.is_running()
    assert sockets.guard_now(place.namespace) is None
    robot.awaits_rest()


def _released(client: Client) -> bool:
    with suppress(StopError):
        client.resume(SOON)
        return True
    return False


def _stopped(client: Client) -> bool:
    state = client.latest(RobotState)
    return state is not None and state.stop.stopped
