"""Promises 1 and 2 with real processes: the wheels change hands when their holder dies or hangs."""

from __future__ import annotations

from itertools import pairwise
from signal import SIGCONT, SIGSTOP

import pytest

from armadico.launch.society import Member
from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.society import Society

pytestmark = pytest.mark.live

MOST_CYCLES = 6
"""Between two commands that were obeyed, over a handover: 2 or 3 when all is well."""


def with_two_drivers(start: Start) -> tuple[Society, str, str]:
    """A society with two instances of goto that both bid; the one that holds, and the other."""
    society = start()
    holder = society.holder
    society.launcher.start_agent(Member("goto"))

    def others() -> list[str]:
        return [i for name, i in society.client.alive if name == "goto" and i != holder]

    society.until(others, "a second goto")
    (other,) = others()

    def bids() -> bool:
        return any(bid.utility is not None for bid in society.bids("goto", other))

    society.until(bids, "the second goto bids")
    assert society.holder == holder, "as good is not better"
    return society, holder, other


def most_cycles_between_obeyed_commands(society: Society) -> int:
    """From the first obeyed command to the last."""
    numbers = [ack.obeyed_cycle.number for ack in society.acks if ack.obeyed_cycle is not None]
    return max(b - a for a, b in pairwise(numbers))


def test_when_the_holder_is_killed_another_drives_on(start: Start) -> None:
    society, holder, other = with_two_drivers(start)
    first = next(p for p in society.launcher.processes if p.name == "goto")
    first.popen.kill()
    first.popen.wait()
    society.until(lambda: society.holder == other, "the other is obeyed")
    society.drives_on()
    assert society.holder == other
    assert most_cycles_between_obeyed_commands(society) <= MOST_CYCLES
    assert holder not in {instance for _, instance in society.client.alive}
    ballots_never_go_down(society.acks)


@pytest.mark.long
def test_when_the_holder_hangs_another_drives_on_and_the_old_one_comes_back_in_vain(
    start: Start,
) -> None:
    society, _, other = with_two_drivers(start)
    first = next(p for p in society.launcher.processes if p.name == "goto")
    first.popen.send_signal(SIGSTOP)
    society.until(lambda: society.holder == other, "the other is obeyed")
    society.drives_on(15)  # cycles: the old one's lease runs out
    woken = len(society.acks)
    first.popen.send_signal(SIGCONT)
    society.drives_on()
    assert {ack.obeyed.instance for ack in society.acks[woken:] if ack.obeyed} == {other}
    assert most_cycles_between_obeyed_commands(society) <= MOST_CYCLES
    ballots_never_go_down(society.acks)
