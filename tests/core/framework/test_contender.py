"""One contender alone: its reasons to take over, to wait and to release."""

from __future__ import annotations

from random import Random

import pytest

from armadico.core.coordination import DRAW, Contender, State
from armadico.core.cycles import PERIOD
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.messages import JUMP, LARGEST_COUNT, Ack, Action, Ballot, Claim, Command, Cycle
from armadico.core.resources import WHEELS

from .solo import Solo


def contending(epoch: int = 1) -> Solo:
    """At cycle 5, a-1 holds by a claim of 0.6, and one's own bid is worse."""
    stage = Solo(epoch)
    stage.cycle(5)
    stage.bid(0.3)
    stage.receive("a-1", 5, 0.6)
    assert stage.contender.state is State.CONTENDING
    return stage


def holding(epoch: int = 1) -> Solo:
    """At cycle 4, when it has listened for long enough."""
    stage = Solo(epoch)
    stage.cycle(4)
    stage.bid(0.5)
    stage.tick()
    assert stage.contender.holding
    return stage


def own(stage: Solo) -> Ballot:
    """The holder's ballot as it comes back from the mesh: another object."""
    assert stage.contender.tenure is not None
    b = stage.contender.tenure.ballot
    return Ballot(b.term, b.utility, b.critical, "".join(list(b.instance)))


# Silence ------------------------------------------------------------------------------------------


def test_silence_is_two_cycles_and_a_third_from_the_last_claim() -> None:
    stage = contending()
    stage.cycle(6)
    stage.bid(0.3)
    due = stage.contender.wakeup
    assert due is not None
    assert due == pytest.approx(0.5 + 0.23)
    assert stage.contender.tick(due - 1e-6) == []
    assert stage.contender.wakeup == due, "still to come"
    assert stage.contender.tick(due) == []
    drawn = stage.contender.wakeup
    assert drawn is not None
    assert due <= drawn <= due + DRAW * PERIOD
    assert stage.contender.tick(drawn)


def test_who_has_heard_of_no_newer_cycle_does_not_know_that_the_holder_is_silent() -> None:
    stage = contending()
    stage.now = 0.74
    assert stage.tick() == []
    assert stage.tick() == [], "and its moment was not drawn"
    stage.cycle(8)  # those in between were lost
    assert stage.bid(0.3) == []
    assert stage.tick()


@pytest.mark.parametrize(
    "forged", [Ballot(LARGEST_COUNT, 0.9, False, "stranger-1"), Ballot(2, 0.9, False, "a-1"), None]
)
def test_one_ack_with_an_implausible_ballot_does_not_tell_that_nobody_is_obeyed(
    forged: Ballot | None,
) -> None:
    """Else a worse bid takes over at once, and in the same cycle the holder takes it back."""
    stage = contending()
    ballot = Ballot(3, 0.6, False, "a-1")
    for number in range(6, 14):
        stage.cycle(number, largest=ballot, obeyed=ballot, obeyed_cycle=Cycle(1, number))
        stage.receive("a-1", number, 0.6)
        stage.bid(0.3)
    stage.cycle(14, largest=forged)
    stage.receive("a-1", 14, 0.6)
    assert stage.bid(0.3) == []
    assert stage.tick() == []


def test_one_looks_once_a_silence_if_the_holder_is_obeyed_all_the_same() -> None:
    stage = contending()
    ballot = Ballot(3, 0.6, False, "a-1")
    for number in (6, 7, 8):
        stage.cycle(number, largest=ballot, obeyed=ballot, obeyed_cycle=Cycle(1, number))
        stage.bid(0.3)
    stage.tick()
    assert stage.contender.wakeup is None


@pytest.mark.parametrize(("utility", "least", "most"), [(1.0, 0.0, 0.5), (0.2, 0.4, 0.9)])
def test_the_better_a_bid_the_shorter_it_waits_where_many_may_take_over(
    utility: float, least: float, most: float
) -> None:
    for seed in range(30):
        stage = Solo()
        exchange, rng = EXCHANGES["smooth"], Random(seed)
        stage.contender = Contender(WHEELS, "b-1", stage.clock, exchange, rng)
        stage.cycle(5)
        stage.bid(utility)
        due = stage.contender.wakeup
        assert due is not None
        assert least <= (due - stage.now) / (DRAW * PERIOD) <= most


def test_after_its_release_a_contender_may_take_a_free_resource_at_once() -> None:
    stage = holding()
    stage.cycle(5)
    stage.contender.bid(stage.at, None, stage.now)
    assert stage.contender.tenure is None
    stage.bid(0.5)
    assert len(stage.tick()) == 1


def test_each_time_a_new_moment_is_drawn() -> None:
    stage = contending()
    stage.contender.gone("a-1", stage.now)
    stage.contender.bid(stage.at, None, stage.now)
    stage.now += 0.05
    assert stage.bid(0.3) == []
    due = stage.contender.wakeup
    assert due is not None
    assert due > stage.now


def test_what_was_bid_before_there_was_nothing_to_bid_is_forgotten() -> None:
    stage = Solo()
    stage.cycle(5)
    stage.bid(0.9)
    stage.contender.bid(stage.at, None, stage.now)
    stage.cycle(6)
    stage.bid(0.1)
    assert stage.receive("a-1", 5, 0.6) == []


def test_a_silent_holder_is_not_excused_by_what_the_owner_obeyed_before() -> None:
    stage = contending()
    before = Ballot(2, 0.6, False, "c-1")
    for number in (6, 7, 8):
        assert not stage.contender.holding
        stage.cycle(number, largest=before, obeyed=before, obeyed_cycle=Cycle(1, number))
        stage.bid(0.3)
    assert len(stage.tick()) == 1


@pytest.mark.parametrize("epoch", [0, 2])
def test_in_a_new_epoch_the_seven_cycles_begin_anew(epoch: int) -> None:
    stage = contending()
    before = (Ballot(3, 0.6, False, "a-1"),) * 2
    number, start = 0, stage.now + 1.0
    while not stage.contender.holding:
        number += 1
        at, now = Cycle(epoch, number), start + number * PERIOD
        assert stage.clock.advance(at, now)
        stage.contender.acked(Ack("wheels", at, *before, Cycle(1, 5)), now)
        stage.contender.bid(at, Bid(0.3, (0.5, 0.0)), now)
        stage.contender.on_claim(Claim("wheels", Ballot(3, 0.6, False, "a-1"), at, 0.6), now)
        stage.contender.tick(now + DRAW * PERIOD)
    assert number == 8


def test_a_beaten_holder_waits_for_the_winners_claim_as_for_any() -> None:
    stage = holding()
    larger = Ballot(9, 0.6, False, "x-1")
    took = []
    for number in range(5, 12):
        stage.cycle(number, largest=larger)
        stage.bid(1.0)
        stage.tick()
        took += [number] if stage.contender.holding else []
    assert took[0] == 8


@pytest.mark.parametrize("epoch", [1, 10**15])
def test_the_successor_of_a_holder_has_seven_cycles_of_its_own(epoch: int) -> None:
    stage = contending(epoch)
    number = 5
    while not stage.contender.holding:
        number += 1
        stage.cycle(number)
        stage.bid(0.3)
        if number < 10:
            stage.receive("a-1", number, 0.6)
        else:
            stage.receive("c-1", number - 2, 0.6, term=4)  # its claims come late
        stage.tick()
    assert number == 17


def test_a_release_by_another_does_not_count_as_being_obeyed() -> None:
    stage = contending()
    other = Ballot(2, 0.6, False, "c-1")
    while not stage.contender.holding:
        stage.cycle(stage.at.number + 1, largest=other, obeyed_cycle=Cycle(1, 9))
        stage.bid(0.3)
        stage.receive("a-1", stage.at.number, 0.6)
        stage.tick()
    assert stage.at.number == 12


def test_without_acks_a_contender_does_not_take_over_though_cycles_continue() -> None:
    stage = contending()
    for number in (6, 7, 8, 9):
        assert stage.clock.advance(stage.numbered(number), number * PERIOD)
    stage.at, stage.now = stage.numbered(9), 9 * PERIOD
    stage.bid(0.3)
    assert stage.tick() == []


def test_without_cycles_no_contender_takes_over_from_a_dead_holder() -> None:
    stage = contending()
    stage.contender.gone("a-1", stage.now)
    stage.now += 1.0
    assert stage.tick() == []


def test_without_a_larger_term_no_ballot_is_cast() -> None:
    stage = Solo()
    stage.cycle(5, largest=Ballot(LARGEST_COUNT, 0.6, False, "a-1"))
    stage.bid(0.9)
    assert stage.tick() == []
    assert not stage.contender.holding


# Terms out of all proportion ----------------------------------------------------------------------


def test_among_enormous_terms_a_new_contender_adopts_the_owners_at_the_second_ack() -> None:
    stage, largest = Solo(), Ballot(2 * JUMP, 0.6, False, "a-1")
    stage.cycle(1, largest=largest)
    assert stage.contender.largest is None
    stage.cycle(2, largest=largest)
    assert stage.contender.largest == largest
    stage.cycle(3)
    assert stage.contender.largest == largest, "once more it takes two"
    stage.cycle(4)
    assert stage.contender.largest is None


def test_one_ack_that_agrees_and_it_takes_two_again() -> None:
    stage, far = contending(), Ballot(3 + JUMP, 0.6, False, "c-1")
    stage.receive("c-1", 5, 0.6, term=3 + JUMP)
    stage.cycle(6)
    stage.cycle(7, largest=far)
    stage.cycle(8)
    assert stage.contender.largest == far
    stage.cycle(9)
    assert stage.contender.largest is None


# Ends of tenures ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("obeys", "epoch", "number", "gone"),
    [
        (False, 10**15, 5, True),
        (False, 10**15, 6, True),
        (False, 10**15, 4, False),
        (False, 10**15 + 1, 5, False),
        (False, 10**15 - 1, 5, False),
        (True, 10**15, 5, False),
    ],
)
def test_a_lost_release_is_known_by_the_owners_ack(
    obeys: bool, epoch: int, number: int, gone: bool
) -> None:
    stage = contending(10**15)
    ballot = Ballot(3, 0.6, False, "a-1")
    obeyed = ballot if obeys else None
    stage.cycle(6, largest=ballot, obeyed=obeyed, obeyed_cycle=Cycle(epoch, number))
    stage.bid(0.3)
    assert bool(stage.tick()) is gone


def test_an_owner_that_has_obeyed_no_command_yet_ends_no_tenure() -> None:
    stage = contending()
    stage.cycle(6, largest=Ballot(3, 0.6, False, "a-1"))
    stage.bid(0.3)
    assert stage.tick() == []


def test_after_a_release_a_late_claim_of_the_tenure_counts_for_nothing() -> None:
    stage = contending()
    stage.receive("a-1", 5, None)
    stage.receive("a-1", 5, 0.6)
    assert len(stage.tick()) == 1


def test_a_token_that_goes_when_the_silence_is_over_is_no_news() -> None:
    stage, ballot = contending(), Ballot(3, 0.6, False, "a-1")
    due = stage.contender.wakeup
    assert due is not None
    stage.cycle(7, largest=ballot, obeyed=ballot, obeyed_cycle=Cycle(1, 7), utility=0.6)
    stage.bid(0.3)
    stage.now = due
    stage.contender.gone("a-1", stage.now)
    assert stage.tick() == []
    assert not stage.contender.holding


def test_a_holder_that_claims_again_is_not_gone() -> None:
    stage = contending()
    stage.contender.gone("a-1", stage.now)
    stage.receive("a-1", 5, 0.6)
    assert stage.tick() == []


@pytest.mark.parametrize("other", ["A-1", "c-1"])
def test_the_token_of_another_agent_is_not_the_holders(other: str) -> None:
    stage = contending()
    assert stage.contender.gone(other, stage.now) == []
    assert stage.tick() == []


def test_that_a_dead_holder_was_obeyed_last_does_not_bring_it_back() -> None:
    stage = contending()
    stage.contender.gone("a-1", stage.now)
    ballot = Ballot(3, 0.6, False, "a-1")
    stage.cycle(6, largest=ballot, obeyed=ballot, obeyed_cycle=Cycle(1, 5), utility=0.6)
    assert len(stage.bid(0.3)) == 1


def test_a_release_before_the_holder_began_is_not_the_holders() -> None:
    stage = contending()
    stage.receive("c-1", 5, 0.6, term=4)
    stage.cycle(6, largest=Ballot(3, 0.6, False, "a-1"), obeyed_cycle=Cycle(1, 5))
    stage.bid(0.3)
    assert stage.tick() == []


@pytest.mark.parametrize("instance", ["a-1", "c-1"])
def test_a_contender_with_acks_only_compares_by_the_obeyed_bid(instance: str) -> None:
    stage = Solo()
    ballot = Ballot(3, 0.6, False, instance)
    about = {"largest": ballot, "obeyed": ballot, "obeyed_cycle": Cycle(1, 5), "utility": 0.6}
    stage.cycle(5, **about)
    assert stage.bid(0.64) == []
    stage = Solo()
    stage.cycle(5, **about)
    assert len(stage.bid(0.66)) == 1


def test_a_received_claim_counts_before_the_owners_ack() -> None:
    stage = contending()
    ballot = Ballot(3, 0.6, False, "a-1")
    stage.cycle(6, largest=ballot, obeyed=ballot, obeyed_cycle=Cycle(1, 5), utility=0.1)
    assert not stage.contender.holding


def test_a_holder_with_a_known_larger_successor_is_not_compared_with() -> None:
    stage = contending()
    beaten, larger = Ballot(3, 0.6, False, "a-1"), Ballot(5, 0.6, False, "c-1")
    stage.cycle(6, largest=larger, obeyed=beaten, obeyed_cycle=Cycle(1, 6), utility=0.1)
    assert stage.bid(0.3) == []
    assert stage.contender.rival is None


def test_an_ack_of_the_own_tenure_is_no_rival() -> None:
    stage = holding()
    mine = own(stage)
    stage.cycle(5, largest=mine, obeyed=mine, obeyed_cycle=Cycle(1, 4))
    assert stage.contender.rival is None
    assert stage.contender.holding


# Holding ------------------------------------------------------------------------------------------


def test_an_own_claim_that_comes_back_outbids_no_tenure() -> None:
    stage = holding()
    assert (
        stage.contender.on_claim(Claim("wheels", own(stage), stage.numbered(4), 0.5), stage.now)
        == []
    )
    assert stage.contender.holding


def test_an_owner_that_does_not_know_ones_ballot_yet_ends_nothing() -> None:
    stage = holding()
    stage.cycle(5, largest=Ballot(1, 0.1, False, "x-1"))
    assert len(stage.bid(0.5)) == 1


def test_an_obeyed_holder_continues() -> None:
    stage = holding(10**15)
    for number in range(5, 20):
        mine, before = own(stage), stage.numbered(number - 1)
        stage.cycle(number, largest=mine, obeyed=mine, obeyed_cycle=before)
        assert [c.action is None for c in stage.bid(0.5)] == [False]


def test_that_another_is_obeyed_does_not_excuse_a_holder_that_is_not() -> None:
    stage = holding()
    other = Ballot(1, 0.1, False, "x-1")
    for number in range(5, 11):
        assert stage.contender.holding
        stage.cycle(number, largest=other, obeyed=other, obeyed_cycle=Cycle(1, number))
        stage.bid(0.5)
    assert stage.contender.state is State.STANDING_BACK


@pytest.mark.parametrize("cycles", [5, 6, 7])
def test_a_holder_that_bids_seldom_releases_too(cycles: int) -> None:
    stage = holding()
    stage.cycle(4 + cycles)
    assert [c.action is None for c in stage.bid(0.5)] == [cycles >= 6]


def test_a_holder_that_had_no_bid_for_long_contends_again_without_standing_back() -> None:
    """Its last command was obeyed: that it was silent since is no lack of obedience."""
    stage = holding()
    mine, last = own(stage), stage.at
    stage.cycle(40, largest=mine, obeyed=mine, obeyed_cycle=last)
    assert stage.bid(0.5) == []
    assert stage.contender.state is State.CONTENDING
    stage.cycle(44, largest=mine, obeyed=mine, obeyed_cycle=last)
    commands = [*stage.bid(0.5), *stage.tick()]
    assert [command.ballot.term for command in commands] == [mine.term + 1]


def test_a_holder_that_bids_zero_lets_go_in_the_fourth_cycle() -> None:
    stage = holding()
    for number in (5, 6, 7):
        stage.cycle(number)
        assert [c.action is None for c in stage.bid(0.0)] == [False]
    stage.cycle(8)
    assert [c.action is None for c in stage.bid(0.0)] == [True]
    assert stage.contender.state is State.IDLE


def rests(stage: Solo, cycles: int, *, received: bool = False) -> list[float]:
    """Return each time that it stands back, s, unobeyed; `received`: obeyed in its first tenure."""
    found, since = [], 0.0
    for number in range(stage.at.number + 1, stage.at.number + 1 + cycles):
        about = {}
        if received and stage.contender.holding:
            mine = own(stage)
            about = {"largest": mine, "obeyed": mine, "obeyed_cycle": stage.at}
            received = False
        before = stage.contender.state
        stage.cycle(number, **about)
        stage.bid(0.5)
        stage.tick()
        after = stage.contender.state
        if before is not after and State.STANDING_BACK in {before, after}:
            if before is State.STANDING_BACK:
                found.append(stage.now - since)
            since = stage.now
    return found


def test_a_holder_that_is_not_obeyed_stands_back_one_two_and_then_four_seconds() -> None:
    stage = Solo()
    assert rests(stage, 142) == pytest.approx([1.0, 2.0, 4.0, 4.0], abs=0.05)
    assert rests(stage, 30, received=True) == pytest.approx([1.0], abs=0.05), "it was obeyed again"


# Exchanges ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("commanded", [(), (1.0,), (1.0, 0.0, 0.0), b"", b"vw"], ids=str)
def test_without_a_valid_action_of_the_loser_the_exchange_begins_from_the_measured_one(
    commanded: Action,
) -> None:
    stage = Solo()
    exchange, rng = EXCHANGES["smooth"], Random(1)
    stage.contender = Contender(WHEELS, "b-1", stage.clock, exchange, rng)
    stage.cycle(5)
    stage.receive("a-1", 5, 0.3, commanded=commanded)
    (first,) = stage.bid(0.9, action=(1.4, 0.0))
    assert first.action is not None
    assert not isinstance(first.action, bytes)
    # 3.10 over ten cycles, from 0.4 at t = 1: the weights are 0.9 / 10 and 0.3 / 10 * 9
    assert first.action[0] == pytest.approx((0.09 * 1.4 + 0.27 * 0.4) / 0.36)


@pytest.mark.parametrize("exchange", sorted(EXCHANGES))
@pytest.mark.parametrize("measured", [(), (1.0,), (0.1, 0.0, 0.0), b"", b"vw"], ids=str)
def test_malformed_measurements_do_not_stop_a_take_over(exchange: str, measured: Action) -> None:
    """Measurements of another shape than the resource's are ignored."""
    stage = Solo()
    stage.contender = Contender(WHEELS, "b-1", stage.clock, EXCHANGES[exchange], Random(1))
    stage.cycle(5)
    stage.contender.acked(Ack("wheels", stage.at, measured=measured), stage.now)
    assert stage.contender.measured == WHEELS.neutral
    (first,) = [*stage.bid(0.9, action=(1.4, 0.0)), *stage.tick()]
    assert first.action is not None
    assert WHEELS.fault(first.action) == ""


@pytest.mark.parametrize("epoch", [0, 2])
def test_an_exchange_is_over_when_a_new_epoch_begins(epoch: int) -> None:
    stage = Solo()
    exchange, rng = EXCHANGES["smooth"], Random(1)
    stage.contender = Contender(WHEELS, "b-1", stage.clock, exchange, rng)
    stage.cycle(5)
    stage.bid(0.9, action=(1.4, 0.0))
    assert [c.action for c in stage.tick()] != [(1.4, 0.0)]
    stage.at, stage.now = Cycle(epoch, 4), stage.now + 1.0
    assert stage.clock.advance(stage.at, stage.now)
    assert [c.action for c in stage.bid(0.9, action=(1.4, 0.0))] == [(1.4, 0.0)]


def test_an_exchange_goes_on_over_its_cycles() -> None:
    stage = Solo(10**15)
    exchange, rng = EXCHANGES["smooth"], Random(1)
    stage.contender = Contender(WHEELS, "b-1", stage.clock, exchange, rng)
    stage.cycle(5)
    stage.receive("a-1", 5, 0.3, commanded=(0.0, 0.0))
    (first,) = stage.bid(0.9, action=(1.4, 0.0))
    stage.cycle(6)
    (second,) = stage.bid(0.9, action=(1.4, 0.0))
    assert isinstance(first.action, tuple)
    assert isinstance(second.action, tuple)
    assert first.action[0] < second.action[0] < 1.4


def careful() -> Solo:
    """It has taken over from one that was about to collide, and was killed."""
    stage = Solo(10**15)
    stage.cycle(5)
    stage.receive("a-1", 5, 0.8, critical=True, commanded=(0.2, 0.0))
    stage.contender.gone("a-1", stage.now)
    stage.bid(0.7, action=(0.1, 0.0), inputs=stage.numbered(4))
    (first,) = stage.tick()
    assert first.action == (0.1, 0.0)
    stage.cycle(6)
    return stage


@pytest.mark.parametrize(
    "inputs", [None, Cycle(0, 9), Cycle(2 * 10**15, 1), Cycle(10**15, 6)], ids=str
)
def test_newer_inputs_or_another_epoch_end_the_caution(inputs: Cycle | None) -> None:
    (free,) = careful().bid(0.7, action=(0.2, 0.0), inputs=inputs)
    assert free.action == (0.2, 0.0)


# One cycle, one command ---------------------------------------------------------------------------


def obeyed(number: int, utility: float) -> Ack:
    """An ack by which the owner obeyed a-1 in the cycle before."""
    a = Ballot(3, 0.6, False, "a-1")
    return Ack("wheels", Cycle(1, number), a, a, Cycle(1, number - 1), utility, False, (0.4, 0.0))


def test_an_ack_takes_nothing_over_while_this_cycles_bid_is_still_to_come() -> None:
    stage = Solo()
    stage.cycle(5)
    stage.bid(0.9)
    stage.at = stage.numbered(6)
    stage.clock.advance(stage.at, stage.now)
    assert stage.contender.acked(obeyed(6, 0.3), stage.now) == [], "a-1 is beaten, by the last bid"
    (command,) = stage.bid(0.9)
    assert command.cycle == stage.at


def test_an_ack_takes_over_at_once_where_this_cycles_bid_is_there() -> None:
    stage = Solo()
    stage.cycle(5)
    stage.bid(0.9)
    stage.at = stage.numbered(6)
    stage.clock.advance(stage.at, stage.now)
    assert stage.bid(0.9) == []
    messages = stage.contender.acked(obeyed(6, 0.3), stage.now)
    assert [(type(message), getattr(message, "cycle", None)) for message in messages] == [
        (Command, stage.at),
        (Claim, stage.at),
    ]
