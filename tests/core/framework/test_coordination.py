"""The promises of coordination, on the virtual mesh: one test a promise."""

from __future__ import annotations

from itertools import pairwise
from math import sin
from random import Random

import pytest

from armadico.core.agent import Agent
from armadico.core.coordination import (
    COMPARISONS,
    Contender,
    State,
    Verdict,
    beats,
    braked,
)
from armadico.core.cycles import LISTEN, PERIOD
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.messages import (
    JUMP,
    LARGEST_COUNT,
    Ack,
    Ballot,
    Claim,
    Cycle,
    RobotState,
    Stop,
)
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import RECONNECT
from armadico.testing.society import RobotOwner, Society, bidder

from .solo import Solo

GRIP = Resource("test-grip", ("force",), (10.0,), (0.0,))
LIFT = Resource("test-heave", ("height",), (1.0,), (0.0,), period_s=0.2)


def test_a_better_bid_is_obeyed_in_the_cycle_it_wins() -> None:
    society = Society(bidder("steady", 0.5), bidder("riser", lambda now: 0.2 if now < 3.0 else 0.9))
    society.run(4.0)
    first = next((t, c) for t, c in society.owner.obeyed if c.ballot.instance.startswith("riser"))
    assert 3.0 <= first[0] < 3.0 + 0.1 + 0.02


def test_two_rising_utilities_do_not_swap_each_cycle() -> None:
    society = Society(
        bidder("a", lambda now: min(0.2 + 0.02 * now, 1.0)),
        bidder("b", lambda now: min(0.21 + 0.02 * now, 1.0)),
    )
    society.run(20.0)
    names = society.obeyed_names(since=2.0)
    exchanges = sum(a != b for a, b in pairwise(names))
    assert exchanges <= 1


def test_within_the_margin_no_contender_takes_over() -> None:
    society = Society(bidder("a", 0.50))
    society.run(1.0)
    society.join(bidder("b", lambda now: 0.52 + 0.02 * sin(now)))
    society.run(5.0)
    assert set(society.obeyed_names()) == {"a"}


def test_at_equal_utility_a_critical_bid_goes_first() -> None:
    society = Society(bidder("goer", 1.0))
    society.run(1.0)
    society.join(bidder("saver", 1.0, critical=True))
    society.run(1.0)
    assert society.holders() == ["saver"]


def test_a_hung_holder_is_replaced_and_its_late_commands_are_refused() -> None:
    society = Society(bidder("a", 0.9), bidder("b", 0.5))
    society.run(2.0)
    society.nodes["a"].hang()
    hung = society.mesh.now
    society.run(2.0)
    first = next(t for t, c in society.owner.obeyed if t > hung and c.ballot.instance[0] == "b")
    assert first - hung < 0.4
    society.nodes["a"].resume()
    society.run(1.0)
    ballots = [c.ballot for _, c in society.owner.obeyed]
    assert ballots == sorted(ballots)
    assert society.holders() == ["a"]  # it is better, and may take over again by a new ballot


def test_a_release_is_taken_up_at_once() -> None:
    society = Society(bidder("a", lambda now: 0.9 if now < 3.0 else None), bidder("b", 0.5))
    society.run(4.0)
    times = [t for t, _ in society.owner.obeyed]
    assert max(b - a for a, b in pairwise(times)) < 0.15
    assert society.holders() == ["b"]


def test_a_bid_of_zero_offers_the_resource_and_never_takes_it() -> None:
    society = Society(bidder("a", lambda now: 0.9 if now < 3.0 else 0.0), bidder("b", 0.5))
    society.run(4.0)
    assert society.holders() == ["b"]
    alone = Society(bidder("a", lambda now: 0.9 if now < 3.0 else 0.0))
    alone.run(4.0)
    assert alone.holders() == []
    assert alone.owner.does["wheels"] == (0.0, 0.0)
    assert alone.owner.rests


def test_one_agent_twice_settles_it_as_any_two_do() -> None:
    kind = bidder("twin", 0.7)
    society = Society(kind)
    society.run(0.05)
    society.mesh.add(kind(society.mesh.identity("twin", 1)), admit=False)
    society.run(3.0)
    assert len({c.ballot.instance for t, c in society.owner.obeyed if t > 1.5}) == 1


def test_a_stop_ends_the_reign_and_a_release_begins_another() -> None:
    society = Society(bidder("a", 0.9))
    society.run(1.0)
    society.mesh.publish(Stop(1, True, "tester", 1))
    society.run(1.0)
    assert society.holders() == []
    messages = len(society.commands)
    society.run(1.0)
    assert len(society.commands) == messages
    society.mesh.publish(Stop(2, False, "tester", 1))
    society.run(1.0)
    assert society.holders() == ["a"]


def test_a_restarted_owner_takes_the_stop_over_from_the_others() -> None:
    society = Society(bidder("a", 0.9))
    society.run(1.0)
    society.mesh.publish(Stop(1, True, "tester", 1))
    society.run(1.0)
    society.nodes["robot"].kill()
    society.run(0.5)
    society.nodes["robot"] = society.mesh.add(
        RobotOwner(society.mesh.identity("robot", 1)), admit=False
    )
    society.run(2.0)
    assert society.owner.stopped is not None
    assert not society.owner.obeyed


def test_a_restarted_owner_listens_before_it_obeys_and_goes_on_with_the_same_holder() -> None:
    society = Society(bidder("a", 0.9), bidder("b", 0.4))
    society.run(2.0)
    society.nodes["robot"].kill()
    society.run(0.5)
    society.nodes["robot"] = society.mesh.add(
        RobotOwner(society.mesh.identity("robot", 1)), admit=False
    )
    society.run(3.0)
    assert society.owner.obeyed[0][1].cycle.number >= 4
    assert {Verdict.LISTENING} >= {v for _, _, v in society.owner.refused}
    assert society.holders() == ["a"]


def test_a_restarted_lone_agent_starts_from_the_ack() -> None:
    kind = bidder("a", 0.9)
    society = Society(kind)
    society.run(2.0)
    society.nodes["a"].kill()
    society.run(1.0)
    restarted = society.mesh.now
    society.join(kind, start=1)
    society.run(1.0)
    first = next(t for t, _ in society.owner.obeyed if t > restarted)
    assert first - restarted < (LISTEN + 1.5) * PERIOD  # after a start it listens for 3 cycles


def test_a_beaten_holder_yields_to_a_larger_ballot_of_its_term() -> None:
    society = Society(bidder("a", 0.9), bidder("b", 0.8))
    society.mesh.link("a", "b").up = False
    society.mesh.link("b", "a").up = False
    society.run(2.0)
    society.mesh.link("a", "b").up = True
    society.mesh.link("b", "a").up = True
    society.run(1.0)
    assert society.holders() == ["a"]


def test_beats_is_by_margin_or_by_being_critical() -> None:
    ballot = Ballot(1, 0.5, False, "x")
    claim = Claim("wheels", ballot, Cycle(1, 1), 0.5)
    assert not beats(Bid(0.55, ()), claim, 0.05)
    assert beats(Bid(0.56, ()), claim, 0.05)
    assert beats(Bid(0.5, (), critical=True), claim, 0.05)
    assert beats(Bid(0.52, (), critical=True), claim, 0.05)
    assert not beats(Bid(0.49, (), critical=True), claim, 0.05)
    critical = Claim("wheels", ballot, Cycle(1, 1), 0.5, True)
    assert not beats(Bid(0.52, (), critical=True), critical, 0.05)
    assert beats(Bid(0.56, ()), critical, 0.05)


def test_after_its_own_hang_a_contender_does_not_take_the_holder_for_gone() -> None:
    society = Society(bidder("a", 0.5))
    society.run(1.0)
    sleeper = society.join(bidder("b", 0.5))
    society.run(1.0)
    sleeper.hang()
    society.run(2.0)
    holder = society.nodes["a"].agent.instance
    sleeper.mailbox.put(
        "token/a", lambda: sleeper.agent.kernel.disappeared("a", holder, society.mesh.now)
    )
    sleeper.resume()
    society.run(2.0)
    assert set(society.obeyed_names()) == {"a"}


def test_after_a_long_hang_missed_cycles_do_not_count() -> None:
    society = Society(bidder("a", 0.9))
    society.run(2.0)
    society.nodes["a"].hang()
    society.run(3.0)
    society.nodes["a"].resume()
    woken = society.mesh.now
    society.run(1.0)
    first = next(t for t, _ in society.owner.obeyed if t > woken)
    assert first - woken < RECONNECT[1] + 2 * PERIOD  # it stood back for a second before


def test_what_a_holder_commanded_that_died_long_ago_is_not_where_an_exchange_begins() -> None:
    late = bidder("b", lambda now: 0.5 if now > 6.0 else None, action=(0.2, 0.0))
    society = Society(bidder("a", 0.9, action=(1.0, 0.0)), late)
    society.run(2.0)
    society.nodes["a"].kill()
    society.run(3.0)
    society.owner.does["wheels"] = (0.0, 0.0)  # the robot agent has ordered a stop meanwhile
    society.run(2.0)
    commanded = [c.action[0] for t, c in society.owner.obeyed if t > 6.0]
    assert max(commanded) <= 0.2


def test_a_late_claim_of_an_older_cycle_is_not_compared_with_a_newer_bid() -> None:
    stage = Solo()
    stage.cycle(1)
    for number, utility in ((4, 0.9), (5, 0.1)):
        stage.cycle(number)
        stage.bid(utility)
    stage.receive("a-1", 5, 0.6)
    assert stage.contender.state is State.CONTENDING
    assert stage.receive("a-1", 4, 0.6) == []  # it was better in cycle 4, and is worse in 5
    assert not stage.contender.holding


def test_without_the_holders_claims_a_contender_compares_by_the_ack() -> None:
    a = bidder("a", 0.5, critical=False)
    society = Society(a)
    society.run(1.0)
    society.mesh.link("a", "b").up = False
    society.join(bidder("b", 0.9))
    society.run(1.0)
    assert set(society.obeyed_names(since=society.mesh.now - 0.3)) == {"b"}


def test_a_token_hidden_by_a_cut_does_not_depose_an_obeyed_holder() -> None:
    society = Society(bidder("a", 0.9), bidder("b", 0.3))
    society.run(2.0)
    society.mesh.cut(["a"], ["b"], lease=True)
    society.mesh.cut(["b"], ["a"], lease=True)
    society.run(4.0)  # the lease has run out: each has seen the other's token go
    assert set(society.obeyed_names(since=1.0)) == {"a"}
    assert society.holders() == ["a"]


def test_one_huge_term_excludes_no_contender() -> None:
    society = Society(bidder("a", lambda now: 0.9 if now > 3.0 else None))
    society.run(1.0)
    cycle = society.owner.cycles.newest
    assert cycle is not None
    forged = Ballot(LARGEST_COUNT, 1.0, True, "forger-1")
    society.mesh.publish(Claim("wheels", forged, cycle, 1.0), key="resource/wheels/utility")
    ack = Ack("wheels", cycle, largest=forged)
    society.mesh.publish(ack, key="resource/wheels/ack")
    society.run(4.0)
    assert set(society.obeyed_names(since=3.0)) == {"a"}


def test_a_newcomer_takes_the_owners_word_for_how_far_others_have_counted() -> None:
    society = Society(bidder("a", lambda now: 0.9 if now > 3.0 else None))
    society.run(1.0)
    society.owner.owner(WHEELS).largest = Ballot(3 * JUMP, 1.0, True, "forger-1")
    society.run(4.0)
    assert set(society.obeyed_names(since=3.0)) == {"a"}


def test_an_owner_that_starts_anew_is_obeyed_though_all_have_counted_far() -> None:
    society = Society(bidder("a", 0.9), bidder("b", 0.5))
    society.run(1.0)
    society.owner.owner(WHEELS).largest = Ballot(3 * JUMP, 0.1, False, "forger-1")
    society.run(4.0)
    assert society.obeyed_names(since=society.mesh.now - 0.5)
    owner = society.owner.owner(WHEELS)
    owner.largest = owner.obeyed = owner.obeyed_cycle = None
    society.run(6.0)
    assert society.obeyed_names(since=society.mesh.now - 0.5)


def test_claims_that_rise_by_leaps_use_up_no_terms_and_exclude_no_contender() -> None:
    society = Society(bidder("a", 0.9), bidder("b", 0.5))
    society.run(1.0)
    for leaps in range(1, 200):
        cycle = society.owner.cycles.newest
        assert cycle is not None
        forged = Ballot(leaps * JUMP, 1.0, True, "forger-1")
        society.mesh.publish(Claim("wheels", forged, cycle, 1.0), key="resource/wheels/utility")
        society.run(0.02)
    largest = society.owner.owner(WHEELS).largest
    assert largest is not None
    assert largest.term < 2 * JUMP
    society.run(2.0)
    assert set(society.obeyed_names(since=society.mesh.now - 0.5)) == {"a"}


@pytest.mark.parametrize("other", [0.5, 0.95])
def test_a_tenure_of_a_false_cycle_is_released_and_a_contender_is_obeyed(
    other: float,
) -> None:
    """The owner hangs, and one state far ahead of it is believed by all."""
    society = Society(bidder("a", 0.8), bidder("b", lambda now: other if now > 2.0 else None))
    society.run(1.0)
    cycle, robot = society.owner.cycles.newest, society.nodes["robot"]
    assert cycle is not None
    robot.hang()
    society.run(0.5)
    far = Cycle(cycle.epoch, LARGEST_COUNT)
    society.mesh.publish(RobotState(far, 0, 0, 0, 0, 0, 12, True, False))
    society.run(0.1)
    robot.resume()
    society.run(4.0)
    assert set(society.obeyed_names(since=society.mesh.now - 1.0)) == {"a" if other < 0.8 else "b"}
    late = [c for at, c in society.claims if at > society.mesh.now - 3.0]
    assert {c.cycle.number < LARGEST_COUNT for c in late} == {True}
    assert max(c.ballot.term for c in late) < 8, "and they do not fight"


@pytest.mark.parametrize("hangs", ["robot", "gripper"])
def test_a_resource_that_is_not_the_robots_is_driven_on_after_a_cycle_that_never_was(
    hangs: str,
) -> None:
    """The robot's cycles, which its owner follows; or its own, which its acks number."""
    grip = LIFT if hangs == "gripper" else GRIP

    class Gripper(Agent):
        name = "gripper"
        owns = (grip,)

    society = Society(bidder("a", 0.8, competes_for=(grip,), action=(1.0,)))
    gripper = society.join(Gripper)
    society.run(2.5)
    owner, node = gripper.agent.owner(grip), society.nodes[hangs]
    cycle = owner.clock.newest
    assert cycle is not None
    assert owner.obeyed is not None
    node.hang()
    society.run(5 * owner.clock.period)
    far = Cycle(cycle.epoch, LARGEST_COUNT)
    if hangs == "gripper":
        society.mesh.publish(Ack(grip.name, far), key=grip.ack_key)
    else:
        society.mesh.publish(RobotState(far, 0, 0, 0, 0, 0, 12, True, False))
    society.run(0.1)
    node.resume()
    society.run(6.0)
    newest, obeyed = owner.clock.newest, owner.obeyed_cycle
    assert newest is not None
    assert obeyed is not None
    assert newest.number - 2 <= obeyed.number <= newest.number


def test_after_a_critical_holder_a_contender_may_only_brake_until_its_inputs_are_newer() -> None:
    stage = Solo()
    stage.cycle(1)
    stage.cycle(5)
    stage.receive("a-1", 5, 0.8, critical=True, commanded=(0.2, 0.0))
    stage.contender.gone("a-1", stage.now)  # it was killed
    stage.bid(0.7, action=(0.5, 0.3), inputs=Cycle(1, 4))
    first = stage.tick()
    assert [c.action for c in first] == [(0.2, 0.0)], "no faster, no turn"
    stage.cycle(6)
    held = stage.bid(0.7, action=(0.5, 0.3), inputs=Cycle(1, 5))
    assert [c.action for c in held] == [(0.2, 0.0)], "its inputs are as old as the claim"
    stage.cycle(7)
    seen = stage.bid(0.7, action=(0.5, 0.3), inputs=Cycle(1, 6))
    assert seen[0].action != (0.2, 0.0)


def test_nor_may_a_contender_after_that_ones_timeout() -> None:
    stage = Solo()
    for number in (1, 5):
        stage.cycle(number)
    stage.receive("a-1", 5, 0.8, critical=True, commanded=(0.2, 0.0))
    for number in (6, 7, 8):
        stage.cycle(number)
        messages = stage.bid(0.7, action=(0.5, 0.3), inputs=Cycle(1, 5))
    messages += stage.tick()
    assert [c.action for c in messages] == [(0.4, 0.0)], "no faster than is measured"
    stage.cycle(9)
    (seen,) = stage.bid(0.7, action=(0.5, 0.3), inputs=Cycle(1, 6))
    assert seen.action == (0.5, 0.3)


def test_bids_of_one_cycle_are_compared_and_by_the_thesis_the_newest() -> None:
    ballot = Ballot(1, 0.5, False, "x")
    first, second = Cycle(1, 1), Cycle(1, 2)
    falling = {first: Bid(0.9, ()), second: Bid(0.3, ())}
    claims = {first: Claim("wheels", ballot, first, 0.5)}
    assert COMPARISONS["same-cycle"](falling, claims, 0.05)
    assert not COMPARISONS["last-heard"](falling, claims, 0.05)
    rising = {first: Bid(0.3, ()), second: Bid(0.9, ())}
    assert not COMPARISONS["same-cycle"](rising, claims, 0.05)
    assert COMPARISONS["last-heard"](rising, claims, 0.05)
    for compare in COMPARISONS.values():
        assert not compare(rising, {}, 0.05)


def test_braking_is_towards_the_neutral_action_in_each_number() -> None:
    assert braked((0.5, -0.3), (0.2, -0.1), (0.0, 0.0)) == (0.2, -0.1)
    assert braked((-0.5, 0.3), (0.2, -0.1), (0.0, 0.0)) == (0.0, 0.0)
    assert braked((0.1, -0.05), (0.2, -0.1), (0.0, 0.0)) == (0.1, -0.05)


def test_messages_are_not_braked_and_numbers_that_do_not_fit_are_neutral() -> None:
    assert braked(b"go", b"on", b"") == b"go"
    assert braked(b"go", (0.2, 0.1), (0.0, 0.0)) == b"go"
    assert braked((0.5,), (0.2, 0.1), (0.0, 0.0)) == (0.0, 0.0)
    assert braked((0.5, 0.5), (0.2,), (0.0, 0.0)) == (0.0, 0.0)
    assert braked((0.5, 0.5), (0.2,), (0.0,)) == (0.0,)
    assert braked((0.5, 0.5), (0.2, 0.1), (0.0,)) == (0.0,)


def test_of_many_contenders_that_may_take_over_few_publish() -> None:
    count = 40
    society = Society(*(bidder(f"a{i}", 0.5) for i in range(count)))
    society.run(2.0)
    speakers = {c.ballot.instance for t, c in society.claims}
    assert len(speakers) < count / 4


def test_claims_for_old_cycles_are_not_believed() -> None:
    stage = Solo()
    stage.cycle(1)
    stage.cycle(9)
    stage.receive("a-1", 5, 0.9)
    assert stage.contender.rival is None
    assert stage.contender.largest is None


def smooth() -> Solo:
    """A contender that exchanges smoothly. The resource does (0.4, 0.0) by the acks."""
    stage = Solo()
    exchange, rng = EXCHANGES["smooth"], Random(1)
    stage.contender = Contender(WHEELS, "b-1", stage.clock, exchange, rng)
    return stage


@pytest.mark.parametrize("age", range(4))
def test_what_went_with_a_release_is_not_where_an_exchange_begins(age: int) -> None:
    stage = smooth()
    stage.cycle(5)
    stage.receive("a-1", 5 - age, None, commanded=(0.0, 0.0))
    stage.bid(0.6)
    assert [c.action >= (0.4, 0.0) for c in stage.tick() if c.action] == [True]


@pytest.mark.parametrize("driven", [True, False], ids=["obeyed", "not obeyed"])
def test_an_exchange_begins_with_a_command_that_the_owner_obeys(driven: bool) -> None:
    stage = smooth()
    stage.cycle(5)
    of = Ballot(3, 0.5, False, "a-1")
    stage.receive("a-1", 5, 0.5, commanded=(0.0, 0.0))
    stage.cycle(6, largest=of, obeyed=of if driven else None, obeyed_cycle=Cycle(1, 5))
    stage.receive("a-1", 6, 0.5, commanded=(0.0, 0.0))
    (first,) = stage.bid(0.8)
    assert first.action is not None
    assert (first.action < (0.4, 0.0)) == driven
