"""The owner of a resource alone: its verdicts, its state and its acks."""

from __future__ import annotations

from typing import Any

import pytest

from armadico.core.coordination import LEAP_CYCLES, STEP, Owner, Verdict
from armadico.core.cycles import PERIOD, CycleClock
from armadico.core.messages import JUMP, Ack, Ballot, Claim, Command, Cycle
from armadico.core.resources import WHEELS

from .solo import running

AT = 9
NOW = AT * PERIOD


def ballot(term: int = 3, utility: float = 0.6, instance: str = "a-1") -> Ballot:
    """A new object each time, as decoding makes them."""
    return Ballot(term, utility, False, instance)


def command(
    cycle: int = AT, of: Ballot | None = None, action: tuple[float, ...] | None = (0.3, 0.0)
) -> Command:
    return Command("wheels", Cycle(1, cycle), of or ballot(), action)


def claim(cycle: int = AT, of: Ballot | None = None, utility: float | None = 0.7) -> Claim:
    return Claim("wheels", of or ballot(), Cycle(1, cycle), utility, utility is not None)


@pytest.fixture
def owner() -> Owner:
    return Owner(WHEELS, running(AT))


def obeying(cycle: int = AT, of: Ballot | None = None) -> Owner:
    owner = Owner(WHEELS, running(AT))
    assert owner.judge(command(cycle, of), NOW) is Verdict.OBEYED
    return owner


@pytest.mark.parametrize(
    ("cycle", "verdict"),
    [
        (AT - 4, Verdict.OLD_CYCLE),
        (AT - 3, Verdict.OBEYED),
        (AT + 3, Verdict.OBEYED),
        (AT + 4, Verdict.OLD_CYCLE),
    ],
)
def test_what_answers_no_present_cycle_is_refused(
    owner: Owner, cycle: int, verdict: Verdict
) -> None:
    assert owner.judge(command(cycle), NOW) is verdict


def test_an_owner_that_hung_refuses_what_waited_meanwhile(owner: Owner) -> None:
    assert owner.judge(command(), NOW + 3.5 * PERIOD) is Verdict.OLD_CYCLE
    assert owner.judge(command(action=None), NOW + 3.5 * PERIOD) is Verdict.OLD_CYCLE


def test_of_one_tenure_no_older_cycle_is_obeyed_after_a_newer_one() -> None:
    owner = obeying(AT)
    assert owner.judge(command(AT - 1), NOW) is Verdict.OLD_CYCLE
    assert owner.judge(command(AT - 1, action=None), NOW) is Verdict.OLD_CYCLE
    assert owner.judge(command(AT), NOW) is Verdict.OBEYED
    larger = command(AT - 1, ballot(4))
    assert owner.judge(larger, NOW) is Verdict.OBEYED, "another's command may answer an older one"


@pytest.mark.parametrize("known", ["obeyed", "claimed", "released"])
def test_a_smaller_ballot_is_refused_however_the_larger_came_to_be_known(
    owner: Owner, known: str
) -> None:
    if known == "obeyed":
        assert owner.judge(command(), NOW) is Verdict.OBEYED
    elif known == "claimed":
        assert not owner.on_claim(claim())
    else:
        assert owner.judge(command(action=None), NOW) is Verdict.RELEASED
    assert owner.largest == ballot()
    for smaller in (ballot(2), ballot(3, 0.5), ballot(3, 0.6, "Z-1")):
        assert owner.judge(command(of=smaller), NOW) is Verdict.STALE_BALLOT
        assert not owner.on_claim(claim(of=smaller))
    assert owner.largest == ballot()


@pytest.mark.parametrize("first", [True, False])
def test_a_term_may_be_a_jump_ahead_and_no_more(first: bool) -> None:
    owner = Owner(WHEELS, running(AT))
    known = 0
    if not first:
        owner.on_claim(claim())
        known = 3
    assert not owner.on_claim(claim(of=ballot(known + JUMP + 1)))
    huge = command(of=ballot(known + JUMP + 1))
    assert owner.judge(huge, NOW) is Verdict.IMPLAUSIBLE
    assert owner.largest == (None if first else ballot())
    assert owner.judge(command(of=ballot(known + JUMP)), NOW) is Verdict.OBEYED


def test_terms_leap_once_in_so_many_cycles_and_rise_by_steps_meanwhile(owner: Owner) -> None:
    at, now = AT, NOW
    owner.on_claim(claim(of=ballot(JUMP)))
    assert owner.largest == ballot(JUMP)
    for _ in range(LEAP_CYCLES - 1):
        at, now = at + 1, now + PERIOD
        owner.clock.advance(Cycle(1, at), now)
        owner.on_claim(claim(at, ballot(2 * JUMP)))
        assert owner.judge(command(at, ballot(JUMP + STEP + 1)), now) is Verdict.IMPLAUSIBLE
    assert owner.largest == ballot(JUMP)
    assert owner.judge(command(at, ballot(JUMP + STEP)), now) is Verdict.OBEYED
    owner.clock.advance(Cycle(1, at + 1), now + PERIOD)
    owner.on_claim(claim(at + 1, ballot(2 * JUMP)))
    assert owner.largest == ballot(2 * JUMP)


def test_a_claim_of_an_old_cycle_teaches_nothing(owner: Owner) -> None:
    assert not owner.on_claim(claim(AT - 4))
    assert owner.largest is None


@pytest.mark.parametrize("by", ["command", "claim"])
def test_a_released_tenure_is_over_and_nothing_of_it_is_obeyed(by: str) -> None:
    owner = obeying()
    if by == "command":
        assert owner.judge(command(action=None), NOW) is Verdict.RELEASED
        assert not owner.on_claim(claim(utility=None)), "it is at rest already"
    else:
        assert owner.on_claim(claim(utility=None)), "it is to be rested"
    assert (owner.obeyed, owner.obeyed_cycle) == (None, Cycle(1, AT))
    assert owner.judge(command(), NOW) is Verdict.OVER
    assert owner.judge(command(action=None), NOW) is Verdict.OVER
    assert not owner.on_claim(claim(utility=None))
    assert owner.judge(command(of=ballot(4)), NOW) is Verdict.OBEYED


def test_a_smaller_release_does_not_make_a_larger_tenure_good_again() -> None:
    owner = obeying()
    assert owner.on_claim(claim(utility=None))
    assert not owner.on_claim(claim(of=ballot(2), utility=None))
    assert owner.judge(command(), NOW) is Verdict.OVER


def test_a_release_of_another_ballot_ends_no_tenure() -> None:
    owner = obeying()
    assert not owner.on_claim(claim(of=ballot(2), utility=None))
    assert owner.obeyed == ballot()
    assert not owner.on_claim(claim(of=ballot(4), utility=None)), "it was not obeyed"
    assert owner.obeyed == ballot()
    assert owner.judge(command(of=ballot(4)), NOW) is Verdict.OVER


@pytest.mark.parametrize(
    ("about", "verdict"),
    [
        ({"fault": "too fast"}, Verdict.OUT_OF_RANGE),
        ({"stopped": True}, Verdict.STOPPED),
        ({"stopped": True, "fault": "too fast"}, Verdict.OUT_OF_RANGE),
    ],
    ids=str,
)
def test_a_rejected_command_changes_nothing_but_a_release_always_counts(
    about: dict[str, Any], verdict: Verdict
) -> None:
    owner = obeying()
    assert owner.judge(command(of=ballot(4)), NOW, **about) is verdict
    assert owner.largest == owner.obeyed == ballot()
    assert owner.judge(command(action=None), NOW, **about) is Verdict.RELEASED


def test_an_owner_that_began_recently_obeys_no_command() -> None:
    clock = CycleClock()
    owner = Owner(WHEELS, clock)
    for number in (1, 2, 3):
        clock.advance(Cycle(1, number), number * PERIOD)
        assert owner.judge(command(number), number * PERIOD) is Verdict.LISTENING
    clock.advance(Cycle(1, 4), 4 * PERIOD)
    assert owner.judge(command(4), 4 * PERIOD) is Verdict.OBEYED


def test_refusals_are_counted_by_their_reason() -> None:
    owner = obeying()
    owner.judge(command(action=None), NOW)
    assert not owner.refusals, "neither to obey nor to release is one"
    for _ in range(2):
        owner.judge(command(), NOW)
    owner.judge(command(of=ballot(1)), NOW)
    assert owner.refusals == {Verdict.OVER: 2, Verdict.STALE_BALLOT: 1}


def test_the_silence_begins_with_each_command_and_ends_with_a_rest(owner: Owner) -> None:
    assert owner.silent_at is None
    assert not owner.active
    owner.judge(command(), NOW)
    assert owner.silent_at == pytest.approx(NOW + 0.3)
    owner.judge(command(), NOW + 0.1)
    assert owner.silent_at == pytest.approx(NOW + 0.4)
    owner.judge(command(of=ballot(2)), NOW + 0.2)
    assert owner.silent_at == pytest.approx(NOW + 0.4), "what is refused is no command"
    owner.rested()
    assert owner.silent_at is None


def test_an_ack_has_the_largest_ballot_the_obeyed_one_and_its_rank(
    owner: Owner,
) -> None:
    def ack(
        largest: Ballot | None,
        obeyed: Ballot | None,
        cycle: Cycle | None,
        utility: float,
        critical: bool,
    ) -> Ack:
        now = Cycle(1, AT)
        return Ack("wheels", now, largest, obeyed, cycle, utility, critical, (0.1, 0.2))

    assert Owner(WHEELS, CycleClock()).ack((0.1, 0.2)) is None, "before the first cycle"
    assert owner.ack((0.1, 0.2)) == ack(None, None, None, 0.0, False)
    owner.judge(command(), NOW)
    at = Cycle(1, AT)
    assert owner.ack((0.1, 0.2)) == ack(ballot(), ballot(), at, 0.6, False)
    owner.on_claim(claim())
    assert owner.ack((0.1, 0.2)) == ack(ballot(), ballot(), at, 0.7, True), "its claim has the rank"
    owner.judge(command(), NOW)
    assert owner.ack((0.1, 0.2)) == ack(ballot(), ballot(), at, 0.7, True)
    owner.on_claim(claim(of=ballot(4, 0.9), utility=0.9))
    assert owner.ack((0.1, 0.2)) == ack(ballot(4, 0.9), ballot(), at, 0.7, True)
    owner.judge(command(of=ballot(4, 0.9)), NOW)
    assert owner.ack((0.1, 0.2)) == ack(ballot(4, 0.9), ballot(4, 0.9), at, 0.9, False)
    owner.judge(command(of=ballot(4, 0.9), action=None), NOW)
    assert owner.ack((0.1, 0.2)) == ack(ballot(4, 0.9), None, at, 0.0, False)
