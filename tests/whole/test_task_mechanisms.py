"""Robots share tasks by other mechanisms than ballots, on one virtual mesh."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.agents.fleet.messages import FleetClaims
from armadico.config.scenarios import load_scenario
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Log
from armadico.launch.society import Options, prepared
from armadico.mobile.messages import FleetAwards, FleetProposals

FLEET = load_scenario("fleet")
SHORT = replace(FLEET, tasks=FLEET.tasks[:1] + FLEET.tasks[9:11], look_s=2.0)


def rehearsal(coordination: str | None, **given: Any) -> FleetRehearsal:
    options = Options(seed=1, coordination=coordination, **given)
    return FleetRehearsal(prepared(SHORT, options), options, 2)


def test_two_mechanisms_for_tasks_are_refused_before_an_agent_is_built() -> None:
    with pytest.raises(ConfigError, match="contract-net and alliance both decide about task-"):
        prepared(SHORT, Options(coordination="contract-net,alliance"))


@pytest.mark.long
@pytest.mark.parametrize("name", ["contract-net", "central", "alliance"])
def test_all_tasks_are_done_once(name: str) -> None:
    fleet, seen = rehearsal(name), dict.fromkeys((FleetProposals, FleetAwards, FleetClaims), 0)

    def note(_key: str, message: Any, _now: float) -> None:
        claims = isinstance(message, FleetClaims) and not message.claims
        seen[type(message)] += not claims

    for each in fleet.names:
        fleet.mesh.watch(note, *seen, namespace=each)
    result = fleet.run()
    assert result.passed, result.verdict
    if name == "alliance":
        assert not seen[FleetProposals] + seen[FleetAwards], "it negotiates nothing"
        assert seen[FleetClaims]
    else:
        assert seen[FleetProposals] > seen[FleetAwards] > 0
        assert not seen[FleetClaims], "no robot claims by itself"


def test_without_an_arbiter_nothing_is_awarded_and_with_a_second_one_it_is() -> None:
    fleet = rehearsal("contract-net")
    arbiters = [node for node in fleet.mesh.nodes if node.name == "contract-net"]
    assert len(arbiters) == 2
    fleet.start()
    arbiters[0].kill()
    fleet.begin()
    fleet.mesh.run(fleet.mesh.now + 8.0)
    assert any(status.holds for status in fleet.watch.status.values()), "the second one awards"
    alone = rehearsal("contract-net")
    alone.start()
    for node in alone.mesh.nodes:
        if node.name == "contract-net":
            node.kill()
    alone.begin()
    alone.mesh.run(alone.mesh.now + 8.0)
    assert len(alone.watch.status) == 2
    assert not any(status.holds for status in alone.watch.status.values())


def test_a_robot_that_shares_by_ballots_refuses_awards_and_says_so() -> None:
    options = Options(seed=1, coordination="contract-net")
    fleet = FleetRehearsal(prepared(SHORT, options), options, 2)
    odd = fleet.mesh.node("fleet", fleet.names[1]).agent
    odd.p = replace(odd.p, social=replace(odd.p.social, coordination=None))
    logs: list[str] = []
    fleet.mesh.watch(lambda _k, log, _t: logs.append(log.text), Log, namespace=fleet.names[1])
    fleet.start()
    fleet.begin()

    def said() -> bool:
        return any("contract-net awards tasks" in text for text in logs)

    fleet.mesh.run(fleet.mesh.now + 20.0, said)
    assert said(), logs
