"""The latch with real processes: stop means stopped, until it is released."""

from __future__ import annotations

import pytest

from tests.programs import call
from tests.whole.live.conftest import Start

pytestmark = pytest.mark.live


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
