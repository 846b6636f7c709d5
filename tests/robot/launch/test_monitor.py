"""The monitor and the wakeup agents of hosts, under the virtual clock: whole societies that drive.

Agents die, hang with or without their token, or stop publishing; hosts go and come back.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.localization.localization import Localization
from armadico.agents.supervision.monitor import Parameters
from armadico.agents.supervision.wakeup import Wakeup
from armadico.config.hosts import Host, HostTable
from armadico.config.scenarios import Scenario, exploring, ideal, load_scenario, with_sensors
from armadico.core.agent import DeviceAgent
from armadico.core.messages import Message, MonitorReport, RobotState, Stop
from armadico.core.restart_policy import Budget
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node
from armadico.mobile.messages import Correction
from tests.driven import Driven

SC4 = load_scenario("sc4")
DRIVEN = ideal(SC4, keeping=("relocate",))
"""Ideal sensors, and one agent that is not needed."""

ALL = (*DRIVEN.agents, "monitor")
ONE = HostTable({"here": Host(agents=("robot", *ALL))})
LOCALIZED = HostTable({"here": Host(agents=("robot", *SC4.agents, "monitor"))})
TWO = HostTable(
    {
        "a": Host(agents=("robot", "encoder", "sonar", "localization", "monitor")),
        "b": Host(agents=(*SC4.agents[3:], "monitor")),
    }
)
NONE_TAKES = HostTable({name: replace(host, takes=()) for name, host in TWO.hosts.items()})

FAULTS = {
    "killed": Node.kill,
    "hung": Node.hang,
    "deaf": lambda node: node.slow_down(1e9),  # its token stays, for its mesh is well
}

BACK_S = {"killed": 1.5, "hung": 5.0, "deaf": 7.0}
"""s until another instance is at work, as docs/results-reliability.md has it."""


class Society(Driven):
    """A scenario on hosts, and what monitors and hosts do in it."""

    def __init__(self, table: HostTable = ONE, scenario: Scenario = DRIVEN, seed: int = 1) -> None:
        run = Rehearsal(scenario, Options(seed=seed, limit=150.0), hosts=table)
        super().__init__(run, MonitorReport, Stop)
        self.notes: list[str] = []
        self.stops: list[Stop] = []
        self.reports: dict[str, MonitorReport] = {}
        self.begun = Counter(node.name for node in self.mesh.nodes)
        self.begin()

    def _keep(self, _key: str, message: Message, _now: float) -> None:
        if isinstance(message, Stop):
            self.stops.append(message)
        elif isinstance(message, MonitorReport):
            self.reports[message.instance] = message
            if message.note and message.note not in self.notes:
                self.notes.append(message.note)

    def back(self, name: str, within: float) -> None:
        """A new instance of an agent is at work within so long."""
        before = self.mesh.node(name)
        end = self.mesh.now + within

        def there() -> bool:
            node = self.mesh.node(name)
            return node is not before and node.driver.started

        self.mesh.run(end, there)
        assert there(), f"{name} is not back after {within} s: {self.notes} {self.host_notes()}"

    def more(self) -> dict[str, int]:
        """Number of restarts, by agent."""
        return dict(Counter(node.name for node in self.mesh.nodes) - self.begun)

    def host_notes(self) -> list[str]:
        return [text for host in self.run.hosts.values() for text in host.notes]

    def arrives(self) -> bool:
        end = self.mesh.now + 120.0
        while not self.run.watch.done and self.mesh.now < end:
            self.mesh.run(min(self.mesh.now + 1.0, end), lambda: self.run.watch.done)
        return bool(self.run.watch.result().reached)

    def host_of(self, name: str) -> str:
        return self.mesh.node(name).agent.identity.host

    def acting(self) -> list[str]:
        """The hosts of the monitors that are alive and act."""
        alive = {n.agent.instance: n for n in self.mesh.nodes if n.alive and n.name == "monitor"}
        found = [alive[i] for i, r in self.reports.items() if i in alive and r.acts]
        return sorted(node.agent.identity.host for node in found)


# Nothing is wrong ---------------------------------------------------------------------------------


@pytest.mark.long(but=("ideal",))
@pytest.mark.parametrize(
    "scenario",
    [
        pytest.param(SC4, id="real sensors"),
        pytest.param(ideal(SC4), id="ideal"),
        pytest.param(exploring(load_scenario("sc2")), id="exploring"),
    ],
)
def test_without_faults_nothing_is_requested(scenario: Scenario) -> None:
    table = HostTable({"here": Host(agents=("robot", *scenario.agents, "monitor"))})
    society = Society(table, scenario)
    society.let_pass(30.0)
    assert (society.notes, society.more(), society.host_notes()) == ([], {}, [])
    assert [report.missing for report in society.reports.values()] == [()]


# Restarts, exactly once -------------------------------------------------------------------------


@pytest.mark.long(but=("hung-goto",))
@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("killed", "robot"),
        *(("hung", name) for name in ("goto", "monitor")),
        ("deaf", "localization"),
    ],
)
def test_an_agent_that_dies_or_hangs_is_restarted_once_and_the_mission_continues(
    name: str, fault: str
) -> None:
    scenario = SC4 if name == "localization" else DRIVEN
    society = Society(TWO, scenario, seed=2).let_pass(6.0)
    FAULTS[fault](society.mesh.node(name))
    society.back(name, BACK_S[fault])
    society.let_pass(12.0)
    assert society.more() == {name: 1}
    requests = [note for note in society.notes if f"restart {name}" in note]
    assert len(requests) == (fault != "killed"), "its host restarts an agent that ended"
    assert society.arrives()


def test_only_the_agent_that_stops_publishing_is_restarted() -> None:
    society = Society().let_pass(6.0)
    society.mesh.node("encoder").agent.kernel._routes[RobotState].handler = None
    society.back("encoder", 7.0)
    assert "encoder/pose" in society.notes[0]
    society.let_pass(15.0)
    assert society.more() == {"encoder": 1}, "the others only lacked the pose"


@pytest.mark.long
def test_each_restart_doubles_the_limit_of_lateness() -> None:
    """Otherwise an overloaded machine would restart it for ever."""
    society, took = Society().let_pass(6.0), []
    for within in (7.0, 10.0, 16.0):
        begun = society.mesh.now
        society.mesh.node("encoder").agent.kernel._routes[RobotState].handler = None
        society.back("encoder", within)
        society.let_pass(4.0)  # it is late only with what it has published regularly
        took.append(society.mesh.now - begun - 4.0)
    late_s = Parameters().late_s
    assert took[0] < 2 * late_s < took[1] < 4 * late_s < took[2]
    society.let_pass(30.0)
    assert society.more() == {"encoder": 3}


# Slow is not hung, and sometimes is not late ------------------------------------------------------


@pytest.mark.long
def test_an_agent_that_never_publishes_what_its_card_provides_is_left_alone() -> None:
    """In a world without walls localization has nothing to correct."""
    empty = with_sensors(load_scenario("sc1"), "real")
    society = Society(LOCALIZED, replace(empty, goal=None))
    society.let_pass(60.0)
    assert "localization" in {node.name for node in society.mesh.nodes}
    assert (society.notes, society.more()) == ([], {})


class Muted:
    """Keeps localization, each instance of it, from publishing corrections while `quiet`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.quiet = False
        publish = Localization.publish

        def muted(agent: Localization, message: Message, **how: Any) -> None:
            if not (self.quiet and isinstance(message, Correction)):
                publish(agent, message, **how)

        monkeypatch.setattr(Localization, "publish", muted)


@pytest.mark.long
def test_a_pause_that_an_agent_ended_by_itself_is_allowed_to_be_longer_next_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    muted, society = Muted(monkeypatch), Society(LOCALIZED, SC4).let_pass(8.0)
    for seconds in (3.0, 5.0, 9.0):
        muted.quiet = True
        society.let_pass(seconds)
        muted.quiet = False
        society.let_pass(6.0)
    assert (society.notes, society.more()) == ([], {})


@pytest.mark.long
def test_an_agent_that_publishes_on_and_off_is_restarted_once_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    muted, society = Muted(monkeypatch), Society(LOCALIZED, SC4).let_pass(8.0)
    for _ in range(6):
        muted.quiet = not muted.quiet
        society.let_pass(9.0)
    assert society.more() == {"localization": 1}


@pytest.mark.long(but=("hung",))
@pytest.mark.parametrize("fault", ["hung", "slow"])
def test_if_most_of_a_host_is_silent_at_once_it_is_the_machine(fault: str) -> None:
    society = Society(TWO).let_pass(6.0)
    slow = [
        node
        for node in society.mesh.nodes
        if node.agent.identity.host == "b" and node.name not in ("monitor", "wakeup")
    ]
    for node in slow:
        node.hang() if fault == "hung" else node.slow_down(6.0)
    society.let_pass(8.0)
    for node in slow:
        node.resume() if fault == "hung" else node.slow_down(0.0)
    society.let_pass(15.0)
    assert society.more() == {}
    assert any(note.startswith("b: ") for note in society.notes)


@pytest.mark.long
def test_a_host_that_stays_silent_is_given_up_in_the_end_within_its_budget() -> None:
    society = Society(TWO).let_pass(6.0)
    for node in list(society.mesh.nodes):
        if node.agent.identity.host == "b" and node.name not in ("monitor", "wakeup"):
            FAULTS["deaf"](node)
    society.let_pass(Parameters().machine_s + 15.0)
    assert society.more().keys() <= {"goto", "avoid", "gothrough", "path-planning", "interface"}
    assert sum(society.more().values()) == Parameters().restarts


# Hosts --------------------------------------------------------------------------------------------


def test_what_is_needed_of_a_host_that_is_gone_is_started_on_another_and_the_mission_goes_on() -> (
    None
):
    society = Society(TWO).let_pass(6.0)
    society.run.hosts["b"].lose()
    society.back("goto", 8.0)
    society.let_pass(5.0)
    needed = {"goto", "avoid", "gothrough", "path-planning", "interface"}
    assert society.more() == dict.fromkeys(needed, 1), "relocate is not needed"
    assert {society.host_of(name) for name in needed} == {"a"}
    assert society.arrives()
    assert society.stops == []


@pytest.mark.long
def test_a_host_that_comes_back_leaves_its_agents_where_they_were_started() -> None:
    society = Society(TWO).let_pass(6.0)
    society.run.hosts["b"].lose()
    society.let_pass(12.0)
    society.run.start_host("b")
    society.let_pass(30.0)
    assert society.run.hosts["b"].wakeup.alive, "that they are elsewhere is no fault of its own"
    assert society.host_of("relocate") == "b"
    there = Counter(node.name for node in society.mesh.nodes if node.alive)
    assert {name: there[name] for name in ("interface", "path-planning", "goto", "avoid")} == {
        "interface": 1,
        "path-planning": 1,
        "goto": 1,
        "avoid": 1,
    }, "one of each: what need not be alone was given back"
    assert society.arrives()


def test_a_host_that_was_never_there_is_waited_for() -> None:
    """Hosts come up in any order, minutes apart."""
    run = Rehearsal(replace(DRIVEN, goal=None), Options(seed=1), hosts=TWO)
    run.hosts["b"].lose()
    run.mesh.run(40.0)
    late = run.start_host("b")
    run.mesh.run(50.0)
    assert [node.agent.identity.host for node in run.mesh.nodes if node.name == "goto"] == ["b"] * 2
    assert late.wakeup.alive


@pytest.mark.long
def test_a_host_that_never_comes_is_replaced() -> None:
    run = Rehearsal(replace(DRIVEN, goal=None), Options(seed=1), hosts=TWO)
    run.hosts["b"].lose()
    run.mesh.run(70.0)
    assert run.mesh.node("goto").agent.identity.host == "a"


@pytest.mark.long
def test_a_host_that_leaves_in_order_is_not_replaced() -> None:
    society = Society(TWO).let_pass(6.0)
    society.run.hosts["b"].leave()
    society.let_pass(30.0)
    assert society.more() == {}
    assert society.stops == []


@pytest.mark.long
def test_of_two_monitors_one_acts_and_the_other_takes_over() -> None:
    society = Society(TWO).let_pass(6.0)
    (first,) = society.acting()
    (other,) = {"a", "b"} - {first}
    if first == "a":  # the robot is there: the monitor alone is lost
        monitor = next(n for n in society.mesh.nodes if n.name == "monitor" and n.alive)
        assert monitor.agent.identity.host == first
        monitor.kill()
    else:
        society.run.hosts[first].lose()
    society.let_pass(6.0)
    assert society.acting() == [other]


@pytest.mark.long
def test_an_agent_that_dies_while_its_wakeup_agent_hangs_is_started_on_another_host() -> None:
    society = Society(TWO).let_pass(6.0)
    society.run.hosts["b"].wakeup.hang()
    society.let_pass(3.0)
    society.mesh.node("goto").kill()
    society.back("goto", 8.0)
    assert society.host_of("goto") == "a"
    society.run.hosts["b"].wakeup.resume()
    society.let_pass(20.0)
    there = [n.agent.identity.host for n in society.mesh.nodes if n.name == "goto" and n.alive]
    assert there == ["b"], "it was given back"


@pytest.mark.long
def test_another_host_starts_the_agent_if_the_budget_is_spent() -> None:
    society = Society(TWO).let_pass(6.0)
    agent = society.run.hosts["b"].wakeup.agent
    assert isinstance(agent, Wakeup)
    agent.budget = Budget(0, 30.0)
    society.mesh.node("goto").hang()
    society.back("goto", 20.0)
    assert society.host_of("goto") == "a"
    assert any("b: the budget of 0 restarts" in note for note in society.notes)
    assert society.run.hosts["b"].wakeup.alive, "a request ends no process"


@pytest.mark.long
def test_a_monitor_that_hung_itself_requests_no_restarts() -> None:
    society = Society().let_pass(6.0)
    node = society.mesh.node("monitor")
    for seconds in (0.9, 3.0, 8.0):  # within the lease, and beyond it; its host waits for longer
        node.hang()
        society.let_pass(seconds)
        node.resume()
        society.let_pass(12.0)
    assert (society.notes, society.more()) == ([], {})


def test_a_restart_is_requested_with_what_the_monitor_itself_received_and_missed() -> None:
    society = Society().let_pass(8.0)
    society.mesh.node("encoder").hang()
    society.back("encoder", 12.0)
    evidence = [note for note in society.notes if "encoder" in note]
    assert "its token has been gone for 2." in evidence[0]
    assert "the monitor of here has been linked for " in evidence[0]
    heard, others = re.findall(r"received (\d+) of (\d+) other agents", evidence[0])[0]
    assert int(heard) > 2
    assert int(heard) <= int(others)


# When it cannot be whole --------------------------------------------------------------------------


def test_the_robot_is_stopped_if_agents_stay_missing_and_not_again_after_a_release() -> None:
    society = Society(NONE_TAKES).let_pass(6.0)
    society.run.hosts["b"].lose()
    society.let_pass(19.0)
    assert society.stops == []
    society.let_pass(3.0)
    (stop,) = {stop.press: stop for stop in society.stops}.values()
    assert stop.stopped
    assert stop.by.startswith("monitor: no avoid, gothrough, goto, interface, path-planning for")
    society.mesh.publish(Stop(stop.counter + 1, stopped=False, by="somebody", press=stop.press))
    society.let_pass(30.0)
    assert {s.press for s in society.stops if s.stopped} == {stop.press}
    society.run.start_host("b")
    society.let_pass(10.0)
    assert [report.missing for report in society.reports.values() if report.acts][-1] == ()


@pytest.mark.long
def test_a_robot_at_rest_without_a_goal_is_not_stopped() -> None:
    society = Society(NONE_TAKES, replace(DRIVEN, goal=None)).let_pass(6.0)
    society.run.hosts["b"].lose()
    society.let_pass(40.0)
    assert society.stops == []


# Requests over the mesh ---------------------------------------------------------------------------


@pytest.mark.long
def test_an_agent_that_comes_and_goes_does_not_hide_one_that_hangs() -> None:
    society = Society().let_pass(6.0)
    FAULTS["deaf"](society.mesh.node("goto"))
    monitor = society.mesh.node("monitor").agent
    for turn in range(8):
        monitor.on_appeared("guest", f"guest-{turn}")
        society.let_pass(1.0)
        monitor.on_disappeared("guest", f"guest-{turn}")
        society.let_pass(1.5)
    assert society.more().get("goto", 0) >= 1


@pytest.mark.long
def test_a_silence_of_the_robot_is_no_agents_fault() -> None:
    """Without cycles no agent has anything to publish; afterwards each has time to begin again."""
    society = Society(LOCALIZED, SC4).let_pass(8.0)
    robot = society.mesh.node("robot").agent
    assert isinstance(robot, DeviceAgent)
    hears, robot.on_bytes = robot.on_bytes, lambda _: None  # type: ignore[method-assign]
    society.let_pass(12.0)
    robot.on_bytes = hears  # type: ignore[method-assign]
    society.let_pass(20.0)
    assert (society.notes, society.more()) == ([], {})
