"""Promises 1 to 4 with real processes: any agent may be killed or hang, one after another.

A hung process keeps its sockets, and for a while its token; on waking it has a burst to read.
"""

from __future__ import annotations

from signal import SIGCONT, SIGSTOP

import pytest

from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.speeds import statuses_until_stop

pytestmark = pytest.mark.live

MOST_STATUSES = 8
"""Status packets until a stop is ordered: 3 when all is well, and some for a loaded machine."""


@pytest.mark.long
@pytest.mark.parametrize("hangs", [False, True], ids=["killed", "hung"])
def test_without_the_driver_fresh_obstacles_or_a_pose_a_stop_is_ordered_until_they_are_back(
    start: Start, hangs: bool
) -> None:
    society = start()
    for name in ("goto", "sonar", "encoder"):
        mark = len(society.tap.packets)
        if hangs:
            society.send(name, SIGSTOP)
        else:
            society.kill(name)
        society.stops(mark)
        assert statuses_until_stop(society.tap.packets) <= MOST_STATUSES, name
        society.nobody_drives()
        if hangs:
            society.send(name, SIGCONT)
        else:
            society.nobody_else_died(name)
            society.restart(name)
        society.drives_on()
    society.nobody_else_died()
    ballots_never_go_down(society.acks)
