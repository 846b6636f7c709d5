"""Whether a mechanism had anything to decide, of which silence is no evidence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

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
    assert "is not known: no proposal for wheels" in found.undecided
    found.update(proposal("goto-1", 1, 0.5))
    found.update(proposal("avoid-1", 2, 0.5))
    assert found.least == 0
    assert "made had nothing to decide: no two agents wanted wheels" in found.undecided


def test_bids_that_agents_keep_count_once_and_those_of_an_arbiter_do_not() -> None:
    found = contention()
    found.update(Award("wheels", Cycle(1, 1), "judge-1"))
    found.learn("judge-1", [record(1, 0.5), record(2, 0.5)])
    found.learn("goto-1", [record(1, 0.5), record(2, 0.5)])
    assert found.least == 0
    for _ in range(2):
        found.learn("avoid-1", [record(1, None), record(2, 0.3)])
    assert found.least == 1
    for number in range(2 * KEPT):
        found.update(proposal("goto-1", number, 0.5))
    assert found.least == 1


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
    for instance in ("fleet-1", "fleet-2"):
        found.update(proposal(instance, 1, 0.5, "passage-0"))
    assert "task-*" in found.undecided
    for instance in ("fleet-1", "fleet-2"):
        found.update(proposal(instance, 1, 0.5, "task-0"))
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


@pytest.mark.parametrize("known", [True, False])
def test_an_observer_asks_it_of_the_mechanisms_that_cards_name(known: bool) -> None:
    found = Contention()
    if known:
        found.learn("goto-1", [record(1, 0.5)])
    card = Card(
        *("goto", "goto-1", "here", 1, "", 1, (), (), ("wheels",)), mechanisms=("wheels made",)
    )
    (told,) = found.among([card, card])
    assert ("had nothing to decide" in told) is known
