"""Under an arbiter agents propose, it alone holds the wheels, and it may be killed."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import structs

from armadico.agents.rivals.arbiter import WAIT_S
from armadico.agents.rivals.mechanisms import Auction
from armadico.agents.rivals.rounds import Round
from armadico.config.scenarios import ideal, load_scenario
from armadico.core.config_errors import ConfigError
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Award, Command, Cycle, Proposal
from armadico.core.parameters import Social
from armadico.core.resources import WHEELS
from armadico.launch.attached import AttachedRun
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.virtual import VirtualMesh
from armadico.mobile.messages import Truth
from armadico.observe.view import driver
from armadico.testing.society import RobotOwner, bidder


class Driven:
    """A run of sc4 under a mechanism, to its end or for so long, and what was published in it."""

    def __init__(
        self, coordination: str | None, told: str | None = None, limit: float | None = None
    ) -> None:
        options = Options(seed=1, coordination=coordination, told=told, limit=limit)
        self.scenario = prepared(ideal(load_scenario("sc4")), options)
        self.run = Rehearsal(self.scenario, options)
        self.seen: dict[type, list[Any]] = {k: [] for k in (Ack, Award, Command, Truth, Proposal)}
        self.at: list[tuple[float, str | None]] = []
        self.run.mesh.watch(self._note, *self.seen)

    def _note(self, _key: str, message: Any, t: float) -> None:
        if getattr(message, "resource", WHEELS.name) != WHEELS.name:
            return
        self.seen[type(message)].append(message)
        if type(message) is Ack:
            self.at.append((t, driver(message)))


def test_the_arbiter_alone_commands_and_the_goal_is_reached() -> None:
    driven = Driven("auction")
    result = driven.run.run()
    assert result.reached
    assert result.collisions == 0
    commanding = {agent_of(command.ballot.instance) for command in driven.seen[Command]}
    assert len(commanding) == 1
    assert commanding <= set(driven.scenario.agents)
    assert result.shares["goto"] > 30.0, "the agents that it awards are counted, not the arbiter"
    assert result.conditions is not None
    assert "social.coordination=auction" in result.conditions.agents["goto"]


@pytest.mark.parametrize(
    ("agents", "told"),
    [
        (("encoder", "sonar", "interface", "goto"), "auction had nothing to decide"),
        (("encoder", "sonar", "interface", "goto", "avoid"), ""),
    ],
)
def test_an_attached_run_tells_whether_the_mechanism_on_the_cards_had_anything_to_decide(
    agents: tuple[str, ...], told: str
) -> None:
    """It has not started the agents, so it has not their settings."""
    options = Options(seed=1, coordination="auction", limit=10.0)
    asked = structs.replace(ideal(load_scenario("sc4")), agents=agents, plan="direct")
    scenario = prepared(asked, options)
    there = Rehearsal(structs.replace(scenario, goal=None), options)
    attached = Options(limit=10.0)
    with AttachedRun(scenario, attached, VirtualSession(there.mesh)) as run:
        result = run.run()
    assert result.contended is not None
    assert (result.contended == 0) == bool(told)
    assert told in result.undecided
    assert bool(result.undecided) == bool(told)


def test_what_an_agent_is_told_of_its_share_can_be_set() -> None:
    shares: dict[str, set[float]] = {}
    for told in ("award", "yes", "no"):
        driven = Driven("auction", told, limit=12.0)
        mesh, found = driven.run.mesh, shares.setdefault(told, set())
        agents = [mesh.node(name).agent for name in ("goto", "gothrough")]
        mesh.watch(
            lambda *_, found=found, agents=agents: found.update(a.share(WHEELS) for a in agents),
            Truth,
        )
        driven.run.run()
    assert shares == {"award": {0.0, 1.0}, "yes": {1.0}, "no": {0.0}}


@pytest.mark.parametrize("spare", [False, True])
def test_a_killed_arbiter_is_followed_by_its_standby_or_the_robot_rests(spare: bool) -> None:
    driven = Driven("auction", limit=20.0)
    run, mesh = driven.run, driven.run.mesh
    if spare:
        run.enter("auction")
    killed: list[Any] = []

    def kill(*_: object) -> None:
        holding = driver(driven.seen[Ack][-1])
        node = next(n for n in mesh.nodes if n.alive and n.agent.instance == holding)
        killed.append((mesh.now, node.agent.instance))
        node.kill()
        if not spare:
            mesh.call_at(mesh.now + 2.0, lambda *_: run.enter("auction"), None)

    mesh.call_at(12.0, kill, None)
    result = run.run()
    at, instance = killed[0]
    assert agent_of(instance) == "auction"
    after = next(t for t, holder in driven.at if t > at and holder not in (None, instance)) - at
    assert after < 0.3 if spare else 2.0 < after < 3.5
    assert result.collisions == 0
    obeyed = [ack.obeyed for ack in driven.seen[Ack] if ack.obeyed is not None]
    assert obeyed == sorted(obeyed), "ballots never go down"


def test_the_arbiter_waits_for_a_missing_proposal_for_20_ms_at_most() -> None:
    driven = Driven("auction", limit=16.0)
    mesh = driven.run.mesh
    first: dict[Cycle, float] = {}
    waited: dict[Cycle, float] = {}
    mesh.watch(lambda _k, p, t: first.setdefault(p.cycle, t), Proposal)
    mesh.watch(lambda _k, a, t: waited.setdefault(a.cycle, t - first[a.cycle]), Award)
    mesh.call_at(12.0, lambda *_: mesh.node("gothrough").hang(), None)
    driven.run.run()
    whole = [s for cycle, s in waited.items() if first[cycle] < 11.9]
    lacking = [s for cycle, s in waited.items() if 12.05 < first[cycle] < 12.25]
    later = [s for cycle, s in waited.items() if first[cycle] > 13.0]
    assert max(whole) < WAIT_S
    assert lacking
    assert all(WAIT_S <= s < WAIT_S + 0.01 for s in lacking)
    assert max(later) < WAIT_S, "an agent that has been silent for 3 cycles is not waited for"


def test_a_single_contender_is_not_waited_for_but_at_the_beginning_others_are() -> None:
    mesh, waited = VirtualMesh(1), list[float]()
    first: dict[Cycle, float] = {}
    mesh.watch(lambda _k, p, t: first.setdefault(p.cycle, t), Proposal)
    mesh.watch(lambda _k, a, t: waited.append(t - first[a.cycle]), Award)
    mesh.add(RobotOwner(mesh.identity("robot")), admit=False)
    for kind in (Auction, bidder("one", 0.5)):
        given = kind.parameters(social=Social(coordination="auction"))
        mesh.add(kind(mesh.identity(kind.name), given), admit=False)
    mesh.run(5.0)
    assert len(waited) > 40
    assert max(waited) < WAIT_S / 2


def test_a_round_is_complete_once_all_that_are_alive_have_proposed() -> None:
    now = Round[str]()

    def proposes(cycle: int, *names: str) -> bool:
        for name in names:
            now.add(name, Cycle(1, cycle), name)
        return now.complete

    assert not proposes(1, "a"), "others may begin with it"
    assert not proposes(1, "b"), "nor are two known to be all"
    now.decided()
    assert not proposes(2, "a")
    assert proposes(2, "b")
    assert not proposes(3, "c", "a", "b"), "c is new: so may others be"
    now.decided()
    now.drop("b")
    assert proposes(4, "a", "c")
    assert not proposes(7, "a"), "c may be late"
    assert proposes(8, "a"), "c has been silent for 4 cycles"
    assert [*now.since(4)] == ["a", "c"]
    now.add("c", Cycle(2, 1), "another epoch, as the owner has restarted")
    assert [*now.since(9)] == ["c"]


def test_what_is_told_of_shares_needs_an_arbiter() -> None:
    with pytest.raises(ConfigError, match="--told"):
        prepared(load_scenario("sc1"), Options(told="yes"))
