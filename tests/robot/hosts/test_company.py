"""Admission to a namespace: one robot agent, one protocol, any clock."""

from __future__ import annotations

import json

import pytest

from armadico.core.messages import PROTOCOL
from tests.programs import Start
from tests.robot.hosts.conftest import call
from tests.robot.society import Observer

pytestmark = pytest.mark.live

# One robot agent ----------------------------------------------------------------------------------


def test_a_robot_agent_on_a_host_that_is_not_the_robots_does_not_start(
    up: Start, observer: Observer
) -> None:
    up("robot")
    observer.until(lambda: observer.states, "the robot talks")
    (robot,) = (each for each in observer.client.alive if each[0] == "robot")
    epoch = observer.state.cycle.epoch
    second = call("robot", "--host", "lab1", program="armadico-agent")
    assert second.returncode == 2
    assert "cannot listen on" in second.stderr
    assert "is open" not in second.stderr, "it did not touch the port"
    observer.cycles(3)
    assert observer.state.cycle.epoch == epoch
    assert {each for each in observer.client.alive if each[0] == "robot"} == {robot}


def test_of_two_that_start_in_one_instant_exactly_one_drives(
    start: Start, observer: Observer
) -> None:
    simulator = start("sim", "empty", "--port", "0", "--host", "robot")
    assert simulator.stdout is not None
    url = simulator.stdout.readline().partition(" at ")[2].partition(";")[0]
    words = ("robot", "--host", "robot", "--set", f"port={url}")
    both = [start(*words, program="armadico-agent") for _ in range(2)]
    observer.until(lambda: any(p.poll() is not None for p in both), "one of them leaves")
    observer.until(lambda: len(observer.states) > 5, "the other talks")
    (left,) = [process for process in both if process.poll() is not None]
    (stayed,) = [process for process in both if process.poll() is None]
    assert left.returncode == 2
    assert left.stderr is not None
    printed = left.stderr.read()
    assert f"process {stayed.pid} is the router" in printed
    assert "is open" not in printed, "it did not touch the port"
    assert len({state.cycle.epoch for state in observer.states}) == 1


# One protocol -------------------------------------------------------------------------------------


def test_a_newcomer_among_agents_of_another_protocol_refuses_and_names_one(
    router: None, toy: Start, observer: Observer
) -> None:
    stranger = toy("foreign", "lab2")
    observer.until(lambda: observer.names == {"driver"}, "it is there")
    done = call("encoder", "--host", "lab1", program="armadico-agent")
    assert done.returncode == 2
    for part in ("driver-", "host lab2", f"pid {stranger.pid}"):
        assert part in done.stderr
    assert f"uses protocol {PROTOCOL + 1}, this agent {PROTOCOL}" in done.stderr


@pytest.mark.long(but=("driver",))
@pytest.mark.parametrize("kind", ["driver", "foreign"])
def test_one_of_another_protocol_that_joins_all_the_same_is_not_obeyed_and_is_named(
    up: Start, toy: Start, observer: Observer, kind: str
) -> None:
    up("robot")
    observer.until(lambda: observer.states, "the robot talks")
    stranger = toy(kind, "lab2")
    observer.until(lambda: len(observer.commands) > 10, "it commands")
    if kind == "driver":
        observer.until(lambda: observer.holder.startswith("driver-"), "it is obeyed")
        return
    named = f"host lab2, pid {stranger.pid}) uses protocol {PROTOCOL + 1}"
    observer.until(lambda: any(named in text for text in observer.logs), "it is named")
    observer.cycles(10)
    assert observer.acks[-1].obeyed is None
    assert observer.acks[-1].largest is None, "its claims have no effect either"


# Any clock ----------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_clock_an_hour_ahead_is_reported_and_has_no_effect(
    up: Start, toy: Start, observer: Observer
) -> None:
    up("robot")
    observer.until(lambda: observer.states, "the robot talks")
    toy("late", "lab2")
    observer.until(lambda: observer.holder.startswith("driver-"), "it is obeyed")
    observer.until(observer.driving, "the robot moves")
    assert "clock 3600 s ahead of this machine's" in call("ps").stdout
    found = {host["name"]: host for host in json.loads(call("ps", "--json").stdout)["hosts"]}
    assert found["lab2"]["clock_s"] == pytest.approx(3600.0, abs=2.0)
    assert found["robot"]["clock_s"] == pytest.approx(0.0, abs=2.0)
