"""The systems of chapter 2 are presets, and a society has one mechanism at a time."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec import structs, to_builtins

from armadico.agents.driving.avoid import Avoid
from armadico.agents.driving.goto import Goto
from armadico.agents.rivals.systems import AVAILABLE, ELSEWHERE, MECHANISMS, SYSTEMS
from armadico.cli import coordinations
from armadico.config.hosts import Host, HostTable
from armadico.config.scenarios import ideal, load_scenario
from armadico.core import mechanisms
from armadico.core.agent import Agent
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import agent_class
from armadico.core.mechanisms import all_coordinations, coordination, lacks
from armadico.core.messages import Log
from armadico.core.parameters import agents_named
from armadico.core.resources import WHEELS
from armadico.launch.society import (
    Options,
    arbiters,
    check,
    checked_arbiters,
    members,
    prepared,
    share,
    with_arbiters,
)
from armadico.launch.virtual import Rehearsal
from armadico.mesh.ports import free_port
from tests.programs import call, starter

CHAPTER_2 = (
    *("subsumption", "aura", "rap", "atlantis", "sss", "tca", "damn", "saphira", "3t", "ara"),
    *("artis", "berra", "yavuz", "busquets", "socio-intentional", "tripodal", "vomas", "o2ca2"),
    *("dpaa", "rogi"),
)
AGENTS = (
    *("robot", "encoder", "sonar", "localization", "goto", "avoid", "gothrough", "relocate"),
    *("path-planning", "interface"),
)


@pytest.mark.parametrize("name", CHAPTER_2)
def test_each_system_for_one_robot_of_chapter_2_has_a_mechanism_with_valid_parameters(
    name: str,
) -> None:
    options = Options(coordination=name)
    scenario = prepared(ideal(load_scenario("sc4")), options)
    found = members(scenario, options, "")
    check(found)
    (arbiter,) = (each for each in found if each.name == AVAILABLE[name].arbiter)
    assert {*SYSTEMS[name].sets} <= {*arbiter.sets}


@pytest.mark.parametrize(
    ("name", "why"),
    [("carmen", "CARMEN.*a platform: one navigator"), ("swarm-bots", "bodies that dock")],
)
def test_a_system_that_nothing_stands_for_is_refused_with_the_reason(name: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        coordination(name)
    assert name not in all_coordinations()


class Nothing:
    """A third party's coordination that decides nothing, and does not say so."""

    arbiter = ""

    @staticmethod
    def contender(*_: object) -> None:
        return None


@pytest.mark.parametrize(
    ("sets", "options", "why"),
    [
        ((), Options(coordination="learned"), "no agent has learned weights.*--parameters learned"),
        ((), Options(coordination="nothing"), r"nothing: its contender\(\) returns None.*goto"),
        ((), Options(coordination="auction", besides=("mean",)), "mean is the arbiter of another"),
        ((), Options(besides=("mean",)), "mean is the arbiter of another mechanism than ballots"),
        (
            ("goto.social.coordination=mean",),
            Options(coordination="auction"),
            "compete for wheels by different mechanisms .*by auction: .*avoid.*by mean: goto",
        ),
    ],
)
def test_a_coordination_that_would_decide_nothing_or_beside_another_one_is_refused(
    sets: tuple[str, ...], options: Options, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = {**mechanisms.all_coordinations(), "nothing": Nothing()}
    monkeypatch.setattr(mechanisms, "_named", lambda: both)
    with pytest.raises(ConfigError, match=why):
        prepared(ideal(load_scenario("sc4")), replace(options, sets=sets))


def test_a_mechanism_for_one_agent_is_refused_only_where_it_decides_beside_another() -> None:
    pytest.importorskip("armadico.agents.fleet")
    hall, options = load_scenario("fleet"), Options(sets=("giveway.social.coordination=mutex",))
    narrow = structs.replace(hall, world="house", start=(2.0, 2.0, 0.0))
    assert prepared(narrow, options), "mutex decides about passages, not about the wheels"
    wheels = Options(sets=("giveway.social.coordination=mean",))
    with pytest.raises(ConfigError, match="compete for wheels by different"):
        prepared(narrow, wheels)


def test_passages_are_not_decided_about_where_the_map_has_none() -> None:
    pytest.importorskip("armadico.agents.fleet")
    hall, options = load_scenario("fleet"), Options(coordination="mutex")
    with pytest.raises(ConfigError, match=r"mutex: no agent here competes.*passage.*some"):
        prepared(hall, options)
    narrow = structs.replace(hall, world="house", start=(2.0, 2.0, 0.0))
    assert "mutex" in prepared(narrow, options).agents


def test_a_users_parameter_is_preferred_to_the_presets() -> None:
    options = Options(coordination="rap", sets=("sequencing.patience_s=3",))
    scenario = prepared(ideal(load_scenario("sc4")), options)
    (arbiter,) = (each for each in members(scenario, options, "") if each.name == "sequencing")
    assert arbiter.sets.index("patience_s=20") < arbiter.sets.index("patience_s=3")


def reaches(name: str) -> None:
    if lacking := lacks(coordination(name), {}):
        pytest.skip(f"{name}: {lacking}")
    options = Options(seed=1, coordination=name)
    result = Rehearsal(prepared(ideal(load_scenario("sc4")), options), options).run()
    assert result.reached
    assert result.collisions == 0


@pytest.mark.long(but=("damn",))
@pytest.mark.parametrize("name", sorted({*MECHANISMS} - {*ELSEWHERE, "learned"}))  # has no weights
def test_every_mechanism_drives_to_the_goal(name: str) -> None:
    reaches(name)


def test_an_agent_that_lacks_what_a_mechanism_needs_is_refused_by_its_name() -> None:
    class Silent(Agent):
        competes_for = (WHEELS,)

    assert "and silent has none" in lacks(coordination("damn"), {"silent": Silent, "goto": Goto})
    assert not lacks(coordination("damn"), {"goto": Goto, "avoid": Avoid})
    assert not lacks(coordination("auction"), {"silent": Silent})


def test_without_the_library_a_mechanism_is_refused_with_what_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("armadico.core.mechanisms.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r"py_trees.*armadico\[rivals\]"):
        prepared(ideal(load_scenario("sc4")), Options(coordination="behaviour-tree"))


def test_list_names_what_cannot_be_chosen_here_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("armadico.core.mechanisms.find_spec", lambda _: None)
    coordinations.show()
    blocks = re.split(r"\n(?=\S)", capsys.readouterr().out)
    lacking = [each for each in blocks if "cannot be chosen here" in each]
    assert [each.partition("\n")[0] for each in lacking] == ["arbitration-graph", "behaviour-tree"]
    assert all("armadico[rivals]" in each for each in lacking)


def test_list_shows_each_with_what_it_lacks_and_an_unknown_name_the_nearest() -> None:
    shown = call("run", "--coordination", "list")
    assert shown.returncode == 0
    for name in AVAILABLE:
        assert f"\n{name}\n" in f"\n{shown.stdout}"
    assert "sequencing only" in shown.stdout
    refused = call("run", "sc4", "--virtual", "--coordination", "subsumtion")
    assert refused.returncode == 2
    assert "did you mean 'subsumption'" in refused.stderr


RUN, UP = ("run", "sc1", "--virtual"), ("up", "sc1")


def refused(*words: str) -> str:
    done = call(*words)
    assert done.returncode == 2, done.stdout
    return done.stderr


@pytest.mark.parametrize("words", [RUN, UP], ids=lambda words: words[0])
def test_a_mechanism_that_is_given_twice_counts_twice(words: tuple[str, ...]) -> None:
    said = refused(*words, "--coordination", "auction", "--coordination", "damn")
    assert "auction and damn both decide about wheels" in said


@pytest.mark.parametrize("words", [RUN, UP], ids=lambda words: words[0])
def test_a_mechanism_for_what_nobody_competes_for_is_refused_with_what_it_needs(
    words: tuple[str, ...],
) -> None:
    assert "armadico run fleet" in refused(*words, "--coordination", "contract-net")
    assert "the scenario fleet has none" in refused(*words, "--coordination", "mutex")
    assert "no agent here competes for what it decides about, trajectory" in refused(
        *words, "--coordination", "auction,executive"
    )


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("learned", "no agent has learned weights"),
        ("auction", "its arbiter auction takes no part"),
        ("queue", "no agent here competes"),
    ],
)
def test_one_that_each_agent_has_chosen_by_its_settings_is_checked_too(
    name: str, expected: str
) -> None:
    sets = tuple(f"{each}.social.coordination={name}" for each in ("goto", "avoid", "gothrough"))
    with pytest.raises(ConfigError, match=f"--coordination {name}: {expected}"):
        prepared(ideal(load_scenario("sc1")), Options(sets=sets))


@pytest.mark.parametrize("name", sorted(MECHANISMS))
def test_all_agents_in_a_mechanisms_settings_are_known_as_such(name: str) -> None:
    usual = agent_class(MECHANISMS[name].arbiter).parameters()
    written = {word for word in AGENTS if word in re.findall(r"[\w-]+", str(to_builtins(usual)))}
    named = {each for _, each in agents_named(usual)}
    assert written <= named
    assert named <= {*AGENTS, "teleop"}


@pytest.mark.parametrize(
    "setting",
    [
        'sequencing.methods=[["avoid"],["gotoo"]]',
        'subsumption.wires=[{source="avoid",target="gotoo"}]',
        "operators.rule=-(avoid, gotoo*0.5)",
        "damn.close.weights.gotoo=1",
    ],
)
def test_a_setting_that_names_no_installed_agent_is_refused(setting: str) -> None:
    name, _, rest = setting.partition(".")
    at = re.split(r"[.=]", rest)[0]
    options = Options(coordination=name, sets=(setting,))
    with pytest.raises(ConfigError, match=f"{name}: {at} names 'gotoo'.*did you mean 'goto'"):
        prepared(ideal(load_scenario("sc1")), options)


def test_an_agent_that_a_setting_names_and_that_does_not_come_is_reported() -> None:
    setting = 'sequencing.methods=[["damn"]]'  # installed, and no proposer
    options = Options(seed=1, coordination="sequencing", sets=(setting,))
    run = Rehearsal(prepared(ideal(load_scenario("sc1")), options), options)
    logs = list[str]()
    run.mesh.watch(lambda _k, log, _t: logs.append(log.text), Log)
    run.start()
    run.begin()
    run.mesh.run(run.mesh.now + 8.0)
    (said,) = (text for text in logs if "damn" in text)
    assert "name damn (methods), and no such agent proposes" in said
    bids = run.mesh.node("sequencing").agent.kernel.history().bids
    assert bids[-1].reason.startswith("follows none of avoid, goto; its settings name damn")


def test_who_takes_part_elsewhere_competes_too() -> None:
    options, mine = Options(coordination="auction"), ("encoder",)
    with pytest.raises(ConfigError, match=r"no agent here competes .* wheels"):
        checked_arbiters(options, mine, mine)
    assert checked_arbiters(options, mine, ("goto", *mine)) == ("auction",)
    unknown = checked_arbiters(options, mine, ("a-strangers", *mine))
    assert unknown == ("auction",), "it may compete: it is not installed here"


@pytest.mark.parametrize("named", [True, False])
def test_a_host_that_the_table_gives_the_arbiter_starts_it_with_a_scenario_too(
    named: bool,
) -> None:
    here = Host(agents=(*AGENTS, *(("auction",) if named else ())), robot="tcp://localhost:8101")
    there = Host(agents=("avoid",))
    table, options = HostTable({"here": here, "there": there}), Options(coordination="auction")
    for given in (None, ideal(load_scenario("sc4"))):
        scenario = given if given is None else with_arbiters(given, options, table)
        started = [each.name for each in share(scenario, options, here)]
        started += arbiters(scenario, options, started, table)
        assert started.count("auction") == 1
        other = [each.name for each in share(scenario, options, there)]
        assert "auction" not in (*other, *arbiters(scenario, options, other, table))


@pytest.mark.live
def test_up_starts_the_arbiter_and_the_society_drives(tmp_path: Path) -> None:
    table = tmp_path / "here.toml"
    table.write_text(
        f'[here]\nrouter = "tcp/127.0.0.1:{free_port("127.0.0.1")}"\n'
        f"agents = {json.dumps(AGENTS)}\n",
        encoding="utf-8",
    )
    mesh = ("--hosts", str(table), "--host", "here", "--namespace", "mechanism-test")
    with starter() as start:
        process = start("up", "sc4", "--coordination", "contract", *mesh)
        assert process.stdout is not None
        said = iter(process.stdout.readline, "")
        assert any(" is up after " in line for line in said)
        driven = call("goto", "4", "2", *mesh, within=90.0)
        assert driven.returncode == 0, driven.stderr
        assert "The mechanism contract decides who drives" in call("doctor", *mesh).stdout
