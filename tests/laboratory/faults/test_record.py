"""The record of what was observed: from when to when figures count, on made-up times."""

from __future__ import annotations

import pytest

from armadico.core.messages import Ack, Ballot, BidRecord, Command, Cycle, RobotState
from armadico.mobile.messages import Truth
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.live import COMMAND_DELAY_S
from armadico_tools.faults.observations import Bids, Came, Faulted, Left, Ordered, Passed, Published
from armadico_tools.faults.record import Bounds, Record

OLD, NEW = "goto-0000000000000001", "goto-0000000000000002"


def ballot(term: int, instance: str) -> Ballot:
    return Ballot(term, 0.6, False, instance)


def ack(number: int, by: Ballot | None = None, answered: int = 0) -> Ack:
    at = None if by is None else Cycle(1, answered)
    return Ack("wheels", Cycle(1, number), by, by, at)


def command(number: int, by: Ballot) -> Command:
    return Command("wheels", Cycle(1, number), by, (0.3, 0.0))


def truth(t: float, v: float) -> Truth:
    return Truth(t, 0, 0, 0, v, 0, 0, None)


def test_the_next_obeyed_command_is_the_one_that_is_acknowledged() -> None:
    record = Record()
    first, second = ballot(1, OLD), ballot(2, NEW)
    record.update(Published(1.00, command(10, first)))
    record.update(Published(1.10, ack(11, first, 10)))
    record.update(Published(1.15, command(11, second)))
    assert record.kept.obeyed_after(1.12) is None, "published, and not known to be obeyed"
    record.update(Published(1.20, ack(12, second, 11)))
    assert record.kept.obeyed_after(1.12) == 1.15
    assert record.kept.obeyed_after(1.12, (NEW,)) is None
    assert record.driver == NEW


def test_a_command_from_before_the_fault_does_not_count() -> None:
    record = Record()
    record.update(Published(1.00, command(10, ballot(1, OLD))))
    record.update(Published(1.10, ack(11, ballot(1, OLD), 10)))
    assert record.kept.obeyed_after(1.05) is None


def test_stop_rest_and_silence() -> None:
    record = Record()
    for at, v in ((1.0, 0.3), (1.1, 0.3), (1.4, 0.0)):
        record.update(Ordered(at, v, 0.0))
    for at, v in ((1.5, 0.2), (1.6, 0.005)):
        record.update(Published(at, truth(at, v)))
    record.update(Ordered(2.0, 0.2, 0.0))
    record.update(Published(2.1, truth(2.1, 0.1)))
    assert record.kept.stop_after(1.05) == 1.4
    assert record.kept.moves_after(1.2) == 2.0
    assert record.kept.rest_after(1.4) == 1.6
    assert record.kept.rest_after(1.7) is None
    assert record.kept.fastest(1.55, 2.2) == 0.1
    assert round(record.kept.longest_silence(1.05, record.now), 6) == 0.6
    record.update(Passed(3.1))
    assert round(record.kept.longest_silence(1.05, record.now), 6) == 1.1


def test_tokens_come_and_go_and_are_counted_from_when_they_came() -> None:
    record = Record()
    for at, instance in ((1.0, OLD), (1.5, NEW), (1.6, NEW)):
        record.update(Came(at, instance))
    assert record.contest.instances("goto") == [OLD, NEW]
    assert record.contest.alive[NEW] == 1.5
    record.update(Left(2.0, OLD))
    record.update(Came(2.1, OLD))
    assert record.contest.alive[OLD] == 2.1


def test_bids_count_for_a_while() -> None:
    record = Record()
    bid = BidRecord(Cycle(1, 5), "wheels", 0.6, False, (0.3, 0.0), "leg 0")
    record.update(Bids(1.0, NEW, bid))
    assert record.bids_lately(NEW)
    record.update(Ordered(4.0, 0.0, 0.0))
    assert not record.bids_lately(NEW)
    assert not record.bids_lately(OLD)


def test_late_commands_are_those_of_a_ballot_of_before() -> None:
    record = Record()
    before = ballot(3, OLD)
    for at, by in ((1.0, before), (2.0, before), (2.1, ballot(5, OLD)), (2.2, ballot(2, NEW))):
        record.update(Published(at, command(10, by)))
    assert record.kept.late_commands(1.5, before) == 1


def test_the_share_of_cycles_with_an_obeyed_command() -> None:
    record = Record()
    for number in range(10, 20):
        record.update(Published(number / 10, ack(number, ballot(1, OLD), min(number, 12))))
    assert record.kept.share_obeyed(1.0) == 0.6  # cycles 10 to 15 are within 3 of the last obeyed
    assert record.driver is None


@pytest.mark.parametrize("cut_at", [1.04, 1.06, None])
def test_orders_are_not_checked_while_the_observer_is_cut_off(
    cut_at: float | None,
) -> None:
    """Nor of what was ordered just before the cut that may have taken the command from it."""
    checker = Checker(Bounds(command_delay_s=COMMAND_DELAY_S))
    checker.update(Published(1.0, RobotState(Cycle(1, 10), 0, 0, 0, 0.3, 0, 12, True, False)))
    checker.update(Published(1.0, ack(10, ballot(1, OLD), 9)))
    for at in (1.04, 1.05, 1.06):
        checker.update(Ordered(at, 0.3, 0.0) if at == 1.05 else Passed(at))
        if at == cut_at:
            checker.update(Faulted(at, "partition", ("goto",), began=True))
    checker.update(Ordered(1.3, 0.0, 0.0))
    checker.update(Passed(1.1 + COMMAND_DELAY_S))
    assert bool(checker.violations) is (cut_at is None)
