"""Promises 2 and 3 with real processes: who hangs is replaced or stopped, and drives on.

A hung process keeps its sockets, and for a while its token; on waking it has a burst to read.
"""

from __future__ import annotations

from signal import SIGCONT, SIGSTOP

import pytest

from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.speeds import statuses_until_stop
from tests.whole.live.test_kills import MOST_STATUSES

pytestmark = pytest.mark.live


@pytest.mark.long
def test_when_the_driver_or_its_senses_hang_a_stop_is_ordered_and_on_waking_it_goes_on(
    start: Start,
) -> None:
    society = start()
    for name in ("goto", "sonar", "encoder"):
        mark = len(society.tap.packets)
        society.send(name, SIGSTOP)
        society.stops(mark)
        assert statuses_until_stop(society.tap.packets) <= MOST_STATUSES, name
        society.nobody_drives()
        society.send(name, SIGCONT)
        society.drives_on()
    society.nobody_else_died()
    ballots_never_go_down(society.acks)
