"""What is told of a robot that stands because its arbiter has failed."""

from __future__ import annotations

from armadico.observe.findings import Sort
from armadico.watch.why import Chronicle
from tests.watch.observed import Observed


def test_a_killed_or_hung_arbiter_is_the_cause_and_no_agent_that_only_proposes() -> None:
    for fails, sort in (("kill", Sort.ABSENT), ("hang", Sort.SILENT)):
        society = Observed(coordination="auction").drive()
        assert not society.standing.stands
        getattr(society.mesh.node("auction"), fails)()
        found = society.let_pass(5.0).standing.cause
        assert found is not None
        assert (found.sort, found.who) == (sort, "auction")
    society = Observed(coordination="auction").drive()
    society.mesh.node("auction").kill()
    society.chronicle = Chronicle()
    unseen = society.let_pass(5.0).standing.cause
    assert unseen is not None
    assert (unseen.sort, unseen.who) == (Sort.ABSENT, "auction")
    assert "--coordination auction" in unseen.todo
