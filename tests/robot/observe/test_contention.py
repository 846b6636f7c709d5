"""Whether a mechanism had anything to decide, of which silence is no evidence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from msgspec.structs import replace

from armadico.core.messages import (
    Award,
    Ballot,
    BidRecord,
    Card,
    Claim,
    Cycle,
    Proposal,
)
from armadico.core.resources import WHEELS, Resource
from armadico.core.services import service_of
from armadico.observe.contention import KEPT, Contention


@dataclass(frozen=True)
class Made:
    """A coordination, as far as it is needed."""

    arbiter: str = "judge"
    resource: Resource | str = WHEELS

    def contender(self, *_: Any) -> None:
        return None


def contention(**made: Any) -> Contention:
    return Contention({"made": Made(**made)})


def proposal(instance: str, number: int, utility: float | None, of: str = "wheels") -> Proposal:
    return Proposal(of, Cycle(1, number), instance, utility)


def record(number: int, utility: float | None) -> BidRecord:
    return BidRecord(Cycle(1, number), WHEELS.name, utility, False, (), "")


def test_cycles_are_counted_in_which_two_agents_propose_with_a_utility() -> None:
    found = contention()
    for number in range(3):
        found.update(proposal("goto-1", number, 0.5))
        found.update(proposal("avoid-1", number, 0.8 if number else None))
        found.update(proposal("avoid-1", number, 0.8 if number else None))
    assert (found.least, found.undecided) == (2, "")


def test_a_lone_agent_leaves_nothing_to_decide_and_silence_leaves_it_unknown() -> None:
    found = contention()
    assert found.least is None
    assert "is not known: not all bids for wheels" in found.undecided
    found.update(proposal("goto-1", 1, 0.5))
    found.update(proposal("avoid-1", 2, 0.5))
    assert found.least == 0
    assert "made had nothing to decide: no two agents wanted wheels" in found.undecided


def test_bids_that_agents_keep_count_once_and_those_of_an_arbiter_do_not() -> None:
    found = contention()
    found.update(Award("wheels", Cycle(1, 1), "judge-1"))
    for instance in ("judge-1", "judge-2"):  # a standby arbiter publishes no award
        found.learn(instance, [record(1, 1.0), record(2, 1.0)])
        assert found.least is None
    found.learn("goto-1", [record(1, 0.5), record(2, 0.5)])
    assert found.least == 0
    for _ in range(2):
        found.learn("avoid-1", [record(1, None), record(2, 0.3)])
    assert found.least == 1
    for number in range(2 * KEPT):
        found.update(proposal("goto-1", number, 0.5))
    assert found.least == 1


def test_bids_read_again_after_many_cycles_or_of_another_robot_count_once() -> None:
    found = contention()
    dead = [record(number, 0.5) for number in range(50)]
    for second in range(4):
        for instance in ("goto-1", "avoid-1"):
            found.learn(instance, dead)
        for number in range(KEPT):
            found.update(proposal("late-1", 50 + second * KEPT + number, 0.5))
            found.update(replace(proposal("late-1", number, 0.5), cycle=Cycle(2, number)))
        assert found.least == 50


def test_the_twin_of_a_redundant_agent_is_no_rival_and_that_of_another_robot_is() -> None:
    found = contention()
    for instance in ("goto-1", "goto-2"):
        found.update(proposal(instance, 1, 0.5), "r1")
    assert found.least == 0
    found.update(proposal("goto-3", 1, 0.5), "r2")
    assert found.least == 1


def test_a_bid_of_utility_0_wants_nothing_unless_it_has_votes_or_a_vector() -> None:
    found = contention()
    for number, more in enumerate(({}, {"votes": (0, 50)}, {"vector": (0.1, 0.0)})):
        found.update(proposal("goto-1", number, 0.5))
        found.update(replace(proposal("avoid-1", number, 0.0), **more))
        assert found.least == number
    found.learn("avoid-1", [record(0, 0.0)])
    found.update(Claim("wheels", Ballot(1, 0.0, False, "avoid-1"), Cycle(1, 0), 0.0))
    assert found.least == 2


def test_without_an_arbiter_claims_of_two_show_contention_and_those_of_one_show_nothing() -> None:
    found = contention(arbiter="")
    for instance, known in (("goto-1", None), ("avoid-1", 1)):
        found.update(Claim("wheels", Ballot(1, 0.5, False, instance), Cycle(1, 1), 0.5))
        assert found.least == known
    found = contention(arbiter="")
    found.learn("goto-1", [record(1, 0.5)])
    assert found.least == 0


def test_resources_that_exist_only_later_count_by_how_their_names_begin() -> None:
    found = contention(resource="task-")
    for robot in ("r1", "r2"):
        found.update(proposal("fleet-1", 1, 0.5, "passage-0"), robot)
    assert "task-*" in found.undecided
    for robot in ("r1", "r2"):
        found.update(proposal("fleet-1", 1, 0.5, "task-0"), robot)
    assert (found.least, found.undecided) == (1, "")


def test_of_several_mechanisms_the_one_with_least_counts_and_one_unknown_is_no_count() -> None:
    found = Contention({"made": Made(), "other": Made(resource="task-")})
    for instance in ("goto-1", "avoid-1"):
        found.update(proposal(instance, 1, 0.5))
    assert found.least is None
    found.update(proposal("fleet-1", 1, 0.5, "task-0"))
    assert found.least == 0
    assert "other had nothing" in found.undecided


def test_by_ballots_nothing_is_said() -> None:
    assert (Contention().least, Contention().undecided) == (None, "")


def card(name: str, *provides: str) -> Card:
    return Card(
        *(name, f"{name}-1", "here", 1, "", 1, provides, (), ("wheels",)),
        mechanisms=("wheels made",),
    )


def test_an_observer_asks_it_of_the_mechanisms_that_cards_name() -> None:
    found, cards = Contention(), [card("goto"), card("avoid")]
    for instance in ("goto-1", "avoid-1"):
        (told,) = found.among(cards)
        assert "made had anything to decide is not known: not all bids for wheels" in told
        found.learn(instance, [record(1, None if instance == "avoid-1" else 0.5)])
    (told,) = found.among(cards)
    assert "made had nothing to decide: no two agents wanted wheels" in told
    found.cards = {each.instance: each for each in cards}
    assert (found.least, found.undecided) == (0, told)
    found.update(Claim("wheels", Ballot(1, 0.5, False, "avoid-1"), Cycle(1, 1), 0.5))
    assert found.among(cards) == []
    assert (found.least, found.undecided) == (1, "")


def test_an_observer_knows_an_arbiter_by_its_card_also_after_its_bids() -> None:
    found = Contention()
    for instance in ("judge-1", "judge-2", "goto-1"):
        found.learn(instance, [record(1, 0.5)])
    found.update(Claim("wheels", Ballot(1, 1.0, False, "judge-1"), Cycle(1, 1), 1.0))
    judge = card("judge", service_of(Award).key_for(resource="wheels", instance="judge-1"))
    (told,) = found.among([card("goto"), judge])
    assert "made had nothing to decide" in told


def test_what_no_mechanism_decides_about_is_not_kept() -> None:
    for found in (Contention({}), contention(resource="task-")):
        for number in range(KEPT):
            found.update(proposal("goto-1", number, 0.5, f"passage-{number}"))
            found.update(Claim("wheels", Ballot(1, 0.5, False, "goto-1"), Cycle(1, number), 0.5))
        assert not found._wanted, "it would grow for as long as the society runs"
