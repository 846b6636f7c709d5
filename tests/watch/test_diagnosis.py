"""The matrix: each way to break a society, times each command that shows the diagnosis."""

from __future__ import annotations

import pytest

from armadico.core.judgement import Answer
from armadico.observe.diagnosis import diagnose, settled
from armadico.observe.findings import Demand, Sort, judgement, short, summary, those
from armadico.observe.view import View
from armadico.watch.why import Chronicle
from tests.watch.broken import BREAKAGES, DEMAND, on_card, shown, whole

WITHIN_S = 5.0

OF_THE_VIEW = {  # planted in the observer's view, or with nobody left to observe
    *("clock off by a minute", "router unreachable", "cable passes one way: queries are lost"),
    *("two robot agents", "two encoders", "second simulator", "all agents killed"),
}


def test_a_whole_society_has_nothing_wrong_and_nothing_unknown() -> None:
    society = whole()
    for _ in range(6):
        found = shown(society.let_pass(0.7))
        assert [f for f in found.findings if f.answer is not Answer.YES] == []
        assert summary(found.findings) == "nothing is wrong"
        assert found.texts["ps"] == found.texts["goto"] == ""


def test_a_program_that_is_not_armadico_has_no_version_to_install() -> None:
    society = whole()
    on_card(society, "avoid", version="")
    found = shown(society.let_pass(4.0)).findings
    assert those(found, Answer.NO) == [], found


@pytest.mark.parametrize("work_s", [0.02, 0.04])
def test_a_busy_machine_raises_no_alarm(work_s: float) -> None:
    """All agents are slowed down alike, by half a cycle and more for each few messages."""
    society = whole()
    for node in society.mesh.nodes:
        if node.name != "robot":
            node.slow_down(work_s)
    society.let_pass(5.0)
    assert those(shown(society).findings, Answer.NO) == []


@pytest.mark.parametrize("name", BREAKAGES)
def test_each_command_names_the_cause_and_none_claims_health(name: str) -> None:
    breakage, society = BREAKAGES[name], whole()
    breakage.plant(society)
    found = shown(society.let_pass(WITHIN_S), breakage.demand)
    wrong = those(found.findings, Answer.NO)
    assert any(f.sort is breakage.sort and breakage.named in str(f) for f in wrong), wrong
    assert judgement(found.findings).answer is Answer.NO
    for command, text in found.texts.items():
        assert "nothing is wrong" not in text, command
        if command == "goto":  # it shows the first cause
            assert text
        else:
            assert breakage.named in text, command


@pytest.mark.parametrize("name", [name for name in BREAKAGES if name not in OF_THE_VIEW])
def test_a_new_observer_names_the_cause_too(name: str) -> None:
    """As each short command is one: it never met the agents that are gone."""
    breakage, society = BREAKAGES[name], whole()
    breakage.plant(society)
    society.let_pass(1.5)
    society.chronicle = Chronicle()
    early = shown(society.let_pass(0.05), breakage.demand).findings
    assert summary(early) != "nothing is wrong"
    late = shown(society.let_pass(4.5), breakage.demand)
    assert any(breakage.named in str(f) for f in those(late.findings, Answer.NO)), late.findings
    assert all(breakage.named in late.texts[command] for command in ("doctor", "why", "ps", "top"))


def test_a_short_command_observes_for_longer_while_that_may_change_an_answer() -> None:
    society = whole()
    society.mesh.node("sonar").hang()
    society.let_pass(1.5)
    society.chronicle = Chronicle()
    assert not settled(shown(society.let_pass(1.0)).findings)
    assert settled(shown(society.let_pass(3.5)).findings)


def test_what_was_not_observed_long_enough_is_unknown_and_no_accusation() -> None:
    """The first moments of any observer of a society that works."""
    society = whole()
    society.chronicle = Chronicle()
    for _ in range(20):
        assert those(shown(society.let_pass(0.1)).findings, Answer.NO) == []


def test_the_first_seconds_of_a_drive_accuse_no_agent() -> None:
    """An agent that has just begun to bid is not obeyed yet."""
    society = whole()
    society.let_pass(20.0)  # it has arrived
    society.run.begin()
    for _ in range(30):
        assert those(shown(society.let_pass(0.1)).findings, Answer.NO) == []


def test_without_a_table_it_is_not_known_which_agents_should_be_alive() -> None:
    society = whole()
    found = diagnose(society.view, Demand(), society.mesh.now)
    assert [f.sort for f in those(found, Answer.UNKNOWN)] == [Sort.AGENTS]
    assert judgement(found).exit_code == 3
    assert "0 wrong, 1 unknown" in short(found)[-1]


def test_without_an_agent_nothing_is_known_and_with_a_table_that_is_wrong() -> None:
    view = View()
    view.begin(0.0)
    assert judgement(diagnose(view, DEMAND, 0.5)).answer is Answer.UNKNOWN, "too early"
    assert judgement(diagnose(view, now=2.0)).answer is Answer.UNKNOWN
    assert judgement(diagnose(view, DEMAND, 2.0)).answer is Answer.NO
