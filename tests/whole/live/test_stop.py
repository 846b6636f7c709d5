"""The latch with real processes: stop means stopped, until it is released."""

from __future__ import annotations

import pytest

from tests.programs import call
from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start

pytestmark = pytest.mark.live


@pytest.mark.long
def test_a_robot_that_is_stopped_stays_so_until_it_is_released(start: Start) -> None:
    society = start()
    mark = len(society.tap.packets)
    done = call("stop")
    assert done.returncode == 0, done.stderr
    society.stops(mark)
    society.nobody_drives(15)
    latch = society.state.stop
    assert (latch.stopped, latch.by) == (True, "armadico stop")

    done = call("resume")
    assert done.returncode == 0, done.stderr
    society.drives_on()
    assert not society.state.stop.stopped
    ballots_never_go_down(society.acks)


def test_a_stop_outlives_the_robot_agent_and_whoever_asked_for_it(start: Start) -> None:
    society = start()
    mark = len(society.tap.packets)
    assert call("stop").returncode == 0
    society.stops(mark)
    epoch = society.state.cycle.epoch
    society.kill("robot")
    society.restart("robot")
    society.until(lambda: society.state.cycle.epoch != epoch, "a new epoch")
    society.until(lambda: society.state.stop.stopped, "the others remember the stop")
    society.nobody_drives(15)
    assert call("resume").returncode == 0
    society.drives_on()
