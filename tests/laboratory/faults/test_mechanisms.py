"""By another mechanism than ballots, what the owner obeyed is judged, and no rule of ballots."""

from __future__ import annotations

import pytest

from armadico.core.messages import Ballot, Claim, Cycle
from armadico.core.resources import WHEELS
from armadico.launch.society import names
from armadico_tools.faults import plan
from armadico_tools.faults.checker import OF_BALLOTS, Checker
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Faulted, Obeyed, Published
from armadico_tools.faults.record import Bounds
from armadico_tools.faults.series import Summary
from armadico_tools.faults.variants import case_of, scenario_of

A, B = "goto-0123456789abcdef", "avoid-0123456789abcdef"


def broken(checker: Checker) -> list[Promise]:
    return [violation.promise for violation in checker.violations]


@pytest.mark.parametrize("coordination", ["", "auction"])
@pytest.mark.parametrize("reordered", [False, True])
def test_in_a_whole_network_the_wheels_change_hands_once_in_a_cycle_at_most(
    coordination: str, reordered: bool
) -> None:
    checker = Checker(Bounds(coordination=coordination))
    checker.update(Obeyed(0.0, Ballot(1, 0.5, False, A), Cycle(1, 6)))
    if reordered:
        checker.update(Faulted(0.5, "reorder", ("goto",), True))
    for term, instance in enumerate((A, B), 2):
        checker.update(Obeyed(1.0, Ballot(term, 0.5, False, instance), Cycle(1, 7)))
    assert broken(checker) == []
    checker.update(Obeyed(1.0, Ballot(4, 0.5, False, A), Cycle(1, 7)))
    assert broken(checker) == ([] if reordered else [Promise.ONE_DRIVER])


@pytest.mark.parametrize("coordination", ["", "auction"])
def test_claims_are_judged_by_ballots_only(coordination: str) -> None:
    checker = Checker(Bounds(coordination=coordination))
    for n in range(10):
        for term, instance in enumerate((A, B), 1):
            ballot = Ballot(term, 0.5, False, instance)
            claim = Claim(WHEELS.name, ballot, Cycle(1, n), 0.5, False, (0.1, 0.0), (0.1, 0.0))
            checker.update(Published(100.0 + 0.1 * n, claim))
    assert (Promise.ONE_HOLDER in broken(checker)) is (coordination == "")
    assert Promise.ONE_HOLDER in OF_BALLOTS


def test_a_case_of_a_mechanism_has_its_arbiter_and_can_be_repeated() -> None:
    case = case_of(3, 20.0, variant="sonar", scenario="sc4", coordination="auction")
    scenario, options = scenario_of(plan.loads(case.dumps()))
    assert options.coordination == "auction"
    assert "auction" in names(scenario, options.without)


def test_what_is_not_checked_is_not_reported_as_kept() -> None:
    summary = Summary(unchecked=OF_BALLOTS)
    found = summary.plain()
    assert isinstance(found["violations"], dict)
    assert found["violations"]["HANDOVER"] is None
    assert found["violations"]["COLLISION"] == 0
    assert found["violations"]["SMOOTH"] == 0, "its ramps are checked"
    assert "SMOOTH" in str(found["not_checked"])
