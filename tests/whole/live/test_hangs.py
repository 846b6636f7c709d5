"""Promises 2 and 3 with real processes: who hangs is replaced or stopped, and comes back in vain.

A hung process keeps its sockets, and for a while its token; on waking it has a burst to read.
"""

from __future__ import annotations

from signal import SIGCONT, SIGSTOP

import pytest

from armadico.bridge.p2os.commands import Cmd
from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.speeds import moves, statuses_until_stop
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


@pytest.mark.long
def test_those_who_do_not_drive_may_hang_and_come_back(start: Start) -> None:
    society = start()
    holder = society.holder
    for name in ("gothrough", "avoid"):
        society.send(name, SIGSTOP)
        society.drives_on(15)  # cycles: longer than the lease
        society.send(name, SIGCONT)
        society.drives_on()
        assert society.holder == holder
    society.nobody_else_died()
    ballots_never_go_down(society.acks)


def test_when_the_robot_agent_hangs_the_watchdog_stops_and_on_waking_the_first_speed_is_zero(
    start: Start,
) -> None:
    society = start()
    society.send("robot", SIGSTOP)
    society.truths_pass(5)
    society.until(society.at_rest, "the controller's watchdog stops the wheels")
    society.nobody_drives()
    mark = len(society.tap.packets)
    society.send("robot", SIGCONT)
    society.drives_on()
    first, second = society.tap.commands(mark)[:2]
    assert (first.number, second.number) == (Cmd.VEL, Cmd.RVEL)
    assert not moves(first)
    assert not moves(second)
    ballots_never_go_down(society.acks)
