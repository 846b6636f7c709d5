"""Promise 6: the tutorials' agent, exactly as printed, joins a society that is up.

No other file is touched and no other process started again, on the virtual mesh and on real ones.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.config.scenarios import ideal, load_scenario
from armadico.core.agent import Agent
from armadico.core.discovery import agent_class, find
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from tests.whole.docs.blocks import Block, blocks, files
from tests.whole.docs.shell import Shell
from tests.whole.docs.watcher import watching

TUTORIALS = ("docs/tutorial.md", "docs/own-agent.md", "docs/own-resource.md")
"""Pages whose blocks are one session, in this order."""

NAMESPACE = "tutorial-test"
NEWCOMER = "wall-follower"
SOCIETY = {"robot", "encoder", "sonar", "goto", "avoid", "path-planning", "interface"}
FAR = 120.0  # s of virtual time

SESSION: dict[str, Block] = {
    block.value: block
    for tutorial in TUTORIALS
    for block in blocks()
    if block.document == tutorial and block.note == "session"
}
FILES: dict[str, str] = {
    name: text for tutorial in TUTORIALS for name, text in files(tutorial).items()
}


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    with Shell(tmp_path, NAMESPACE) as made:
        made.write(FILES)
        yield made


def do(shell: Shell, name: str, code: int = 0) -> str:
    """Run a block of the tutorial; what it printed."""
    done = shell.run(SESSION[name].text)
    assert done.returncode == code, f"{SESSION[name]}\n{done.stdout}"
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """Where the tutorial's agent has been installed, as it says."""
    with Shell(tmp_path_factory.mktemp("installed"), NAMESPACE) as made:
        made.write(FILES)
        do(made, "install")
        yield made


@pytest.fixture
def newcomer(installed: Shell, monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Agent]]:
    """The class of the agent that the tutorial writes."""
    monkeypatch.syspath_prepend(installed.folder / "site")
    importlib.invalidate_caches()
    yield agent_class(NEWCOMER)
    sys.modules.pop("wall_follower", None)


@pytest.mark.long
def test_it_joins_a_run_that_goes_on_and_drives_while_the_others_stay_as_they_were(
    newcomer: type[Agent],
) -> None:
    rehearsal = Rehearsal(ideal(load_scenario("sc2")), Options(without=("gothrough",)))
    mesh, watch = rehearsal.mesh, rehearsal.watch
    rehearsal.start()
    rehearsal.begin()
    mesh.run(FAR, lambda: watch.holder == "goto")
    before = [(node.agent, node.agent.instance) for node in mesh.nodes]
    assert {node.name for node in mesh.nodes} == SOCIETY
    rehearsal.add(newcomer)
    mesh.run(FAR, lambda: watch.holder == NEWCOMER)
    assert watch.holder == NEWCOMER
    mesh.run(FAR, lambda: watch.done)
    result = watch.result()
    assert result.passed
    assert watch.holder != NEWCOMER, "it let go when the way was open"
    assert [(node.agent, node.agent.instance) for node in mesh.nodes[:-1]] == before
    assert all(node.alive for node in mesh.nodes)


def test_without_a_goal_it_does_not_bid(newcomer: type[Agent]) -> None:
    rehearsal = Rehearsal(ideal(load_scenario("sc2")), Options())
    rehearsal.add(newcomer)
    mesh = rehearsal.mesh
    agent = mesh.node(NEWCOMER).agent
    mesh.run(5.0)
    said = {(record.utility, record.reason) for record in agent.kernel.history().bids}
    assert (None, "no goal") in said
    assert {utility for utility, _ in said} == {None}
    assert not agent.kernel.card().holds


def test_it_is_found_by_the_name_of_its_entry_point(newcomer: type[Agent]) -> None:
    found = find("armadico.agents", NEWCOMER)
    assert (found.package, found.value) == (NEWCOMER, "wall_follower:WallFollower")
    assert found.summary.startswith("The wall-follower")
    assert newcomer.name == NEWCOMER


@pytest.mark.long
def test_an_agent_from_nothing_drives_and_so_it_does_when_it_is_changed(shell: Shell) -> None:
    do(shell, "begin")
    assert "2 passed" in do(shell, "begin-test")
    installed, own = shell.folder / "site" / "weaver.py", shell.folder / "weaver" / "weaver.py"
    installed.unlink()
    installed.symlink_to(own)  # as `pip install -e` has it, which installs into no other folder
    driven = [do(shell, "begin-drive")]
    before = own.read_text()
    driven.append(do(shell, "begin-change"))
    assert own.read_text() != before
    for said in driven:
        assert "weaver" in said
        assert "reached" in said
    assert driven[0] != driven[1]


def test_the_test_that_the_tutorial_prints_passes(installed: Shell) -> None:
    assert "1 passed" in do(installed, "test")


@pytest.mark.long
@pytest.mark.live
def test_the_tutorial_from_a_society_by_hand_to_an_agent_that_joins_it(shell: Shell) -> None:
    with watching(shell) as watcher:
        do(shell, "society")
        watcher.everybody(SOCIETY)
        assert "goto" in do(shell, "look")
        assert "arrived by a pose of unknown error" in do(shell, "drive", code=3)
        do(shell, "stop")
        assert NEWCOMER in do(shell, "install")
        do(shell, "rehearse")
        before = {name: (card.instance, card.pid) for name, card in watcher.cards().items()}
        do(shell, "join")
        watcher.everybody(SOCIETY | {NEWCOMER})
        do(shell, "beyond")
        watcher.driven_by("goto")
        watcher.driven_by(NEWCOMER)
        after = {name: (card.instance, card.pid) for name, card in watcher.cards().items()}
    assert {name: after[name] for name in SOCIETY} == before
    assert set(after) == SOCIETY | {NEWCOMER}


def test_every_block_of_the_session_is_run_above() -> None:
    names = "society look drive stop begin begin-test begin-drive begin-change "
    names += "install rehearse test join beyond head-install head-rehearse"
    assert list(SESSION) == names.split()
