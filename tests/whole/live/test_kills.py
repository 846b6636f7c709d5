"""Promises 1, 3 and 4 with real processes: any agent may be killed, one after another."""

from __future__ import annotations

import pytest

from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
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
