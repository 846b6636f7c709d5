"""The matrix: each way to break a society, times each command that shows the diagnosis."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from armadico.cli import options
from armadico.config.scenarios import load_scenario
from armadico.core.discovery import providers
from armadico.core.judgement import Answer
from armadico.core.messages import MonitorReport
from armadico.core.services import service_of
from armadico.observe.diagnosis import OF_HOSTS, diagnose, settled
from armadico.observe.findings import Demand, Finding, Sort, judgement, short, sight, summary, those
from armadico.observe.view import View
from armadico.watch.why import Chronicle
from tests.watch.broken import (
    BASE,
    BREAKAGES,
    DEMAND,
    LAB,
    TABLE,
    kill,
    on_card,
    shown,
    two_hosts,
    whole,
)
from tests.watch.observed import LINE, Observed

WITHIN_S = 5.0


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


SOME = (
    "host switched off",
    "agent of a host killed",
    "robot agent hung",
    "agent slow",
    "motors off",
)


@pytest.mark.parametrize("name", SOME)
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


@pytest.mark.parametrize(
    ("without", "named"),
    [
        (("sonar",), "sonar/obstacles"),
        (("encoder",), "encoder/pose"),
        (("goto", "avoid"), "No agent that competes for wheels"),
        (("interface",), "mission/status"),
    ],
)
def test_an_idle_robot_that_no_agent_could_drive_is_not_well(
    without: tuple[str, ...], named: str
) -> None:
    """It stands for want of a goal, and a new observer misses no agent by the table."""
    society = Observed(hosts=two_hosts)
    kill(*without)(society)
    society.let_pass(3.0)
    society.chronicle = Chronicle()
    table = {h: tuple(a for a in agents if a not in without) for h, agents in TABLE.items()}
    found = shown(society.let_pass(4.0), Demand(table, "", providers))
    assert Sort.NO_GOAL in {f.sort for f in found.findings}
    assert any(named in str(f) for f in those(found.findings, Answer.NO)), found.findings
    for command in ("doctor", "ps", "page", "mcp"):
        assert "nothing is wrong" not in found.texts[command]
    assert sight(found.findings) == options.FAILED


def test_a_missing_planner_is_told_before_the_first_goal() -> None:
    society = whole()
    kill("path-planning")(society)
    society.let_pass(3.0)
    society.chronicle = Chronicle()
    found = diagnose(
        society.let_pass(3.0).view, Demand({"a": BASE}, "", providers), society.mesh.now
    )
    assert any("path/plan" in f.what and "--direct" in f.todo for f in found), found


def test_an_exploration_needs_no_planner() -> None:
    status = pytest.importorskip("armadico.agents.missions.messages").ExploreStatus
    society = whole()
    kill("path-planning")(society)
    noted = [f for f in shown(society.let_pass(3.0)).findings if f.who == "path/plan"]
    assert [f.answer for f in noted] == [Answer.YES]
    on_card(society, "sonar", provides=("sonar/obstacles", service_of(status).key))
    assert not [f for f in shown(society.let_pass(1.5)).findings if f.who == "path/plan"]


def test_an_agent_that_never_published_what_it_promises_is_named() -> None:
    """Of a key that was never received there is no rate to compare, and that is no good one."""
    society = whole()
    on_card(society, "interface", provides=("mission/status", "fleet/r2/pose"))  # not observed
    on_card(society, "path-planning", provides=("localization/correction",))
    found = shown(society.let_pass(3.0)).findings
    (mute,) = those(found, Answer.NO)
    assert (mute.sort, mute.who) == (Sort.SILENT, "path-planning")


@pytest.mark.parametrize("new", ["agent", "robot"])
def test_an_agent_that_has_just_started_may_still_publish_what_it_promises(new: str) -> None:
    """An observer that has been there for longer, such as the page, does not count that."""
    society = whole()
    on_card(society, "path-planning", provides=("localization/correction",))
    view = society.let_pass(3.0).view
    if new == "agent":
        view.alive[society.agent("path-planning").instance] = society.mesh.now - 0.5
    else:
        view.rates["robot/state"].since = society.mesh.now - 0.5
    found = diagnose(view, DEMAND, society.mesh.now)
    assert not those(found, Answer.NO)
    assert not settled(found)


def test_an_agent_whose_card_a_new_observer_lacks_is_not_called_absent() -> None:
    society = Observed(hosts=two_hosts)
    society.let_pass(3.0).mesh.node("sonar").hang()
    society.chronicle = Chronicle()
    found = diagnose(society.let_pass(4.5).view, DEMAND, society.mesh.now)
    assert {(f.sort, f.who) for f in those(found, Answer.NO)} >= {(Sort.SILENT, "sonar")}
    assert not [f for f in found if f.sort is Sort.ABSENT], found


def test_a_check_that_needs_a_longer_look_is_not_passed_before() -> None:
    society = whole()
    society.chronicle = Chronicle()
    early = shown(society.let_pass(1.5)).findings
    assert Sort.SLOW in {f.sort for f in those(early, Answer.UNKNOWN)}
    assert not settled(early)
    assert settled(shown(society.let_pass(2.5)).findings)


def test_the_state_of_a_host_waits_for_its_agents_and_not_for_rates() -> None:
    society = whole()
    society.chronicle = Chronicle()
    assert not settled(shown(society.let_pass(0.5)).findings, OF_HOSTS)  # one may be missing
    assert settled(shown(society.let_pass(1.0)).findings, OF_HOSTS)
    society.mesh.node("sonar").hang()
    society.let_pass(1.0)
    society.chronicle = Chronicle()
    assert not settled(shown(society.let_pass(1.5)).findings, OF_HOSTS)
    assert settled(shown(society.let_pass(2.0)).findings, OF_HOSTS)


def test_a_pose_that_stopped_is_not_the_known_one() -> None:
    society = whole()
    society.mesh.node("encoder").kill()
    found = shown(society.let_pass(3.0)).findings
    assert [f.answer for f in found if f.sort is Sort.POSE] == [Answer.UNKNOWN]


def test_a_pose_that_nothing_corrects_any_more_is_not_the_known_one() -> None:
    society = Observed(scenario=load_scenario("sc4"))

    def pose() -> Finding:
        found = diagnose(society.view, Demand(), society.mesh.now)
        (only,) = (f for f in found if f.sort is Sort.POSE)
        return only

    society.let_pass(4.0)
    assert pose().answer is Answer.YES
    society.mesh.node("localization").hang()
    society.let_pass(5.0)
    assert pose().answer is Answer.UNKNOWN
    assert "by the wheels alone for 5 s" in pose().what
    joined = View()
    joined.begin(0.0)
    assert society.view.pose is not None
    joined.learn(society.view.pose, 6.0)
    assert "by the wheels alone for 6 s or longer" in joined.pose_text(6.0)


def test_hosts_whose_table_or_clock_no_agent_told_are_not_known_to_agree() -> None:
    society = whole()
    for name in (*BASE, *LAB):
        on_card(society, name, table="")
    society.chronicle = Chronicle()
    society.let_pass(4.0)
    society.view.ahead[society.agent("robot").instance] = 0.1
    found = shown(society).findings
    assert {f.sort for f in those(found, Answer.UNKNOWN)} == {Sort.TABLE, Sort.CLOCK}


def test_a_computer_of_another_program_need_not_give_its_clock() -> None:
    society = whole()
    society.let_pass(4.0)
    society.view.ahead = {society.agent("robot").instance: 0.1}
    (clock,) = (f for f in shown(society).findings if f.sort is Sort.CLOCK)
    assert clock.answer is Answer.UNKNOWN
    for name in LAB:
        on_card(society, name, version="")
    (clock,) = (f for f in shown(society.let_pass(1.5)).findings if f.sort is Sort.CLOCK)
    assert (clock.answer, "lab gives none" in clock.what) == (Answer.YES, True)


def test_before_the_cards_no_agent_has_to_be_started_again_for_its_table() -> None:
    society = whole()
    view = View()
    for name in (*BASE, *LAB):
        view.token(society.agent(name).instance, there=True, t=0.0)
    (table,) = (f for f in diagnose(view, DEMAND, 1.5) if f.sort is Sort.TABLE)
    assert table.answer is Answer.UNKNOWN
    assert not settled([table])


def test_a_monitor_without_a_report_has_found_nothing_missing_nor_kept() -> None:
    society = whole()
    key = service_of(MonitorReport).key_for(instance=society.agent("sonar").instance)
    on_card(society, "sonar", provides=("sonar/obstacles", key))
    found = shown(society.let_pass(3.0)).findings
    assert [f.sort for f in those(found, Answer.UNKNOWN)] == [Sort.MONITOR]


@pytest.mark.parametrize(
    ("agents", "mute", "answer"),
    [
        (("sonar",), False, Answer.YES),
        (("sonar",), True, Answer.UNKNOWN),
        (("sonar", "goto", "interface"), False, Answer.UNKNOWN),
    ],
)
def test_a_pose_is_missing_only_where_an_agent_needs_it(
    agents: tuple[str, ...], mute: bool, answer: Answer
) -> None:
    """The sonar agent asks for it, and publishes all that it promises without."""
    society = Observed(scenario=replace(LINE, agents=agents))
    if mute:
        on_card(society, "sonar", provides=("sonar/obstacles", "localization/correction"))
    (pose,) = (f for f in shown(society.let_pass(4.0)).findings if f.sort is Sort.POSE)
    assert pose.answer is answer


def test_a_pose_that_no_card_asks_for_is_not_missing() -> None:
    society = Observed(scenario=replace(LINE, agents=("sonar",)))
    on_card(society, "sonar", requests=("robot/state",), provides=())
    (pose,) = (f for f in shown(society.let_pass(4.0)).findings if f.sort is Sort.POSE)
    assert pose.answer is Answer.YES


def test_an_agent_whose_input_no_agent_provides_is_not_at_fault_for_its_silence() -> None:
    scenario = replace(LINE, agents=("sonar", "localization", "goto", "interface"))
    society = Observed(scenario=scenario).let_pass(5.0)
    found = diagnose(society.view, Demand(installed=providers), society.mesh.now)
    assert [(f.sort, f.who) for f in those(found, Answer.NO)] == [(Sort.ABSENT, "encoder")]


@pytest.mark.parametrize("asks", [(), ("robot/scan",)])
def test_an_agent_is_at_fault_for_its_silence_unless_another_is_before_it(
    asks: tuple[str, ...],
) -> None:
    """Of two that wait for each other both are named: no finding at all would be no answer."""
    society = whole()
    on_card(society, "interface", provides=("robot/scan",), requests=("localization/correction",))
    on_card(society, "path-planning", provides=("localization/correction",), requests=asks)
    found = those(shown(society.let_pass(3.0)).findings, Answer.NO)
    assert {f.who for f in found} == {"path-planning", *(("interface",) if asks else ())}
