"""A scenario as a list of processes, the same for real and in rehearsal."""

from __future__ import annotations

from math import pi

import msgspec
import pytest

from armadico.config.hosts import Host, HostTable, load_hosts
from armadico.config.loading import load_parameters
from armadico.config.scenarios import load_scenario
from armadico.core.agent import Agent
from armadico.core.discovery import AGENTS, agent_class, load
from armadico.launch.society import (
    Options,
    members,
    mission,
    processes,
    share,
    spare,
)

SC4 = load_scenario("sc4")


def by_name(options: Options = Options(), scenario: object = SC4) -> dict[str, tuple[str, ...]]:  # noqa: B008
    return {
        member.name: member.sets
        for member in members(scenario, options, "tcp://127.0.0.1:1")  # type: ignore[arg-type]
    }


@pytest.mark.parametrize(
    ("plan", "robot", "told"),
    [
        ("seen", "pioneer-2dx", ("safety.unmapped=true",)),
        ("rooms", "pioneer-2dx", ()),
    ],
)
def test_whoever_drives_by_sonars_without_a_map_is_told_so(
    plan: str, robot: str, told: tuple[str, ...]
) -> None:
    sets = by_name(scenario=msgspec.structs.replace(SC4, plan=plan, robot=robot))
    assert {sets[name] for name in ("goto", "avoid", "gothrough")} == {told}
    for name in ("goto", "avoid", "gothrough"):
        assert load_parameters(agent_class(name).parameters, None, told).safety.unmapped == bool(
            told
        )


def test_a_redundant_society_has_two_of_each_behaviour_in_processes_of_their_own() -> None:
    twice = msgspec.structs.replace(SC4, redundant=True)
    found = members(twice, Options(without=("relocate",)), "memory:")
    labels = processes(found, [["encoder", "sonar"], ["goto", "avoid"]])
    assert list(labels) == [
        *("robot", "encoder+sonar", "localization", "goto+avoid", "goto+avoid-2"),
        *("gothrough", "gothrough-2", "path-planning", "interface"),
    ]
    assert [m.name for m in labels["goto+avoid-2"]] == ["goto", "avoid"]
    (host,) = load_hosts().hosts.values()
    assert [m.name for m in share(twice, Options(), host)].count("goto") == 2


LAB = HostTable(
    {
        "robot": Host(agents=("robot", "encoder", "sonar", "monitor")),
        "lab": Host(agents=("goto", "avoid", "path-planning", "interface", "relocate")),
    }
)


def test_a_host_has_the_watchers_of_its_entry_whatever_the_scenario_says() -> None:
    found = share(SC4, Options(), LAB.host("robot"))
    assert [member.name for member in found] == ["robot", "encoder", "sonar", "monitor"]


def test_a_host_could_start_what_another_has_but_for_who_owns_a_device() -> None:
    found = {m.name: m.sets for m in spare(SC4, Options(), LAB.host("lab"), LAB)}
    assert [*found][:3] == ["encoder", "sonar", "monitor"]
    assert found["encoder"] == by_name()["encoder"], "as its own host would have"
    no = Host(agents=("goto",), takes=("sonar", "gothrough"))
    assert [m.name for m in spare(SC4, Options(), no, LAB)] == ["sonar"], "who is placed"
    rest = [m.name for m in spare(None, Options(), LAB.host("robot"), LAB)]
    assert rest[: len(LAB.host("lab").agents)] == [*LAB.host("lab").agents]


def test_a_controller_is_gotos_and_an_exchange_every_behaviours() -> None:
    sets = by_name(Options(controller="fast", exchange="abrupt"))
    assert sets["goto"] == ("controller=fast", "social.exchange=abrupt")
    assert sets["avoid"] == sets["gothrough"] == ("social.exchange=abrupt",)
    assert not any("exchange" in one for one in sets["encoder"])


def test_a_scenarios_speed_limit_is_told_to_all_that_drive() -> None:
    slow = msgspec.structs.replace(SC4, v_max=0.4)
    sets = by_name(scenario=slow)
    assert all("v_max=0.4" in sets[name] for name in ("goto", "avoid", "gothrough"))
    assert not any("v_max" in one for one in sets["encoder"])


def test_what_the_command_line_says_comes_after_the_set_and_wins() -> None:
    sets = by_name(Options(parameters="thesis", exchange="abrupt"))
    assert sets["goto"][-1] == "social.exchange=abrupt"
    parameters = load_parameters(load(AGENTS, "goto", Agent).parameters, None, list(sets["goto"]))
    assert parameters.rules == "thesis"  # type: ignore[attr-defined]
    assert parameters.social.exchange == "abrupt"
    assert parameters.social.margin == 0.0


def test_a_mission_over_waypoints_brings_them() -> None:
    on_query = mission(msgspec.structs.replace(SC4, plan="waypoints"))
    assert on_query is not None
    assert not on_query.planned
    assert [(w.x, w.y) for w in on_query.waypoints] == [
        (1.5, 2.5),
        (1.5, 3.6),
        (6.3, 3.75),
        (6.3, 2.4),
    ]
    assert on_query.waypoints[0].theta == pytest.approx(pi / 2)
