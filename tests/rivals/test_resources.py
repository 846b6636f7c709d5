"""The seam serves any resource: an arbiter of its own, and two mechanisms at once are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pytest

from armadico.agents.rivals.arbiter import Arbiter, Decision, Wish
from armadico.agents.rivals.mechanisms import AUCTION, Auction
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import mechanisms
from armadico.core.agent import Agent
from armadico.core.config_errors import ConfigError
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.messages import Ack, Award, Claim, Command, Cycle, Log, Proposal
from armadico.core.parameters import Social
from armadico.core.resources import WHEELS, Resource
from armadico.mesh.virtual import VirtualMesh
from armadico.mobile.messages import Waypoint
from armadico.testing.society import ResourceOwner, RobotOwner, bidder

HEAD = Resource("head-of-rivals", ("pan",), (1.0,), (0.0,), period_s=0.25)
PLACE = Resource("place-of-rivals", message=Waypoint, exchange="abrupt", period_s=0.25)


class Least(Arbiter):
    """Follows the smallest utility, as no other mechanism does."""

    name = "least"
    competes_for = (HEAD,)
    critical_for = ()

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:
        name = min(wishes, key=lambda each: wishes[each].utility)
        return Decision(wishes[name].action, {name: 1.0})


class LeastPlace(Least):
    name = "least-place"
    competes_for = (PLACE,)


class HeadAuction(Auction):
    """The auction of a second resource, as docs/rivals.md has it."""

    name = "head-auction"
    competes_for = (HEAD,)
    critical_for = ()


@dataclass(frozen=True)
class Point:
    """An entry point, as far as it is needed."""

    name: str
    found: Any
    value: str = ""

    def load(self) -> Any:
        return self.found


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        Point("least", Arbitrated("least", resource=HEAD)),
        Point("least-place", Arbitrated("least-place", resource=PLACE)),
        Point("auction", AUCTION),
        Point("head-auction", Arbitrated("head-auction", resource=HEAD)),
        Point("second", Arbitrated("second")),
    ]
    found = [(point, point.load()) for point in points]
    monkeypatch.setattr(mechanisms, "loaded", lambda _group: found)


def chosen(kind: type[Agent], names: str) -> Any:
    return kind.parameters(social=Social(coordination=names))


def hand(name: str, utility: float, resource: Resource, action: Any) -> type[Agent]:
    def bid(_self: Agent, _message: Ack) -> Bid:
        return Bid(utility, action)

    return type(name.title(), (Agent,), {"name": name, "competes_for": (resource,), "bid": bid})


@pytest.mark.parametrize(
    ("resource", "arbiter", "actions"),
    [
        (HEAD, Least, ((0.25,), (0.75,))),
        (PLACE, LeastPlace, (Waypoint(1.0, 2.0, 0.0), Waypoint(3.0, 4.0, 0.0))),
    ],
)
def test_an_arbiter_decides_about_a_resource_with_its_own_cycle(
    resource: Resource, arbiter: type[Arbiter], actions: tuple[Any, Any]
) -> None:
    owner = type("Owner", (ResourceOwner,), {"name": "owner", "owns": (resource,)})
    mesh = VirtualMesh(1)
    seen: dict[type, list[Any]] = {kind: [] for kind in (Ack, Award, Claim, Command, Proposal)}
    for kind, found in seen.items():
        mesh.watch(lambda _k, each, _t, found=found: found.append(each), kind)
    mesh.add(RobotOwner(mesh.identity("robot")), admit=False)
    mesh.add(owner(mesh.identity("owner")), admit=False)
    kinds = (hand("low", 0.2, resource, actions[0]), hand("high", 0.9, resource, actions[1]))
    for kind in (*kinds, arbiter):
        mesh.add(kind(mesh.identity(kind.name), chosen(kind, arbiter.name)), admit=False)
    mesh.run(10.0)
    commands = [each for each in seen[Command] if each.resource == resource.name]
    assert {each.ballot.instance.rpartition("-")[0] for each in commands} == {arbiter.name}
    assert len(commands) > 20
    assert commands[-1].action == resource.pack(actions[0])
    awarded = {each.agents[0].rpartition("-")[0] for each in seen[Award]}
    assert awarded == {"low"}
    last = [each for each in seen[Ack] if each.resource == resource.name][-1]
    assert last.obeyed.instance.rpartition("-")[0] == arbiter.name


def test_two_auctions_decide_about_the_wheels_and_about_a_head_at_once() -> None:
    """Busquets's robot has two resources, the motion and a camera, and an auction of each."""
    owner = type("Owner", (ResourceOwner,), {"name": "owner", "owns": (HEAD,)})
    mesh, commands, both = VirtualMesh(1), list[Command](), "auction,head-auction"
    mesh.watch(lambda _k, each, _t: commands.append(each), Command)
    for kind in (RobotOwner, owner):
        mesh.add(kind(mesh.identity(kind.name)), admit=False)
    drivers = (bidder("near", 0.3, action=(0.1, 0.0)), bidder("far", 0.7, action=(0.3, 0.0)))
    looks = (hand("left", 0.4, HEAD, (0.5,)), hand("right", 0.6, HEAD, (-0.5,)))
    for kind in (*drivers, *looks, Auction, HeadAuction):
        mesh.add(kind(mesh.identity(kind.name), chosen(kind, both)), admit=False)
    mesh.run(6.0)
    last = {each.resource: each for each in commands}
    assert {name: each.ballot.instance.rpartition("-")[0] for name, each in last.items()} == {
        "wheels": "auction",
        HEAD.name: "head-auction",
    }
    assert last["wheels"].action == pytest.approx((0.3, 0.0))
    assert last[HEAD.name].action == (-0.5,)
    mesh.node("right").kill()
    mesh.run(7.0)
    pans = [each.action[0] for each in commands if each.resource == HEAD.name and each.action]
    assert any(-0.5 < pan < 0.5 for pan in pans), "blended, by the head's own scale"  # type: ignore[operator]
    mesh.run(12.0)
    assert [each for each in commands if each.resource == HEAD.name][-1].action == (0.5,)


def test_two_mechanisms_for_one_resource_and_an_unknown_one_are_refused_for_one_agent() -> None:
    kind = hand("low", 0.2, WHEELS, (0.1, 0.0))
    agent = kind(VirtualMesh(1).identity("low"))
    agent.p = chosen(kind, "auction,second")
    with pytest.raises(ConfigError, match="auction and second both decide about wheels"):
        mechanisms.contender(WHEELS, agent, CycleClock(0.1))
    agent.p = chosen(kind, "auction,least")
    assert mechanisms.contender(WHEELS, agent, CycleClock(0.1))[0] == "auction"
    assert mechanisms.contender(HEAD, agent, CycleClock(0.1))[0] == "least"
    agent.p = chosen(kind, "nothing")
    with pytest.raises(ConfigError, match="no coordination 'nothing'"):
        mechanisms.contender(WHEELS, agent, CycleClock(0.1))


def test_the_owner_names_both_mechanisms_of_its_resource_once() -> None:
    mesh, logs = VirtualMesh(1), list[str]()
    mesh.watch(lambda _k, log, _t: logs.append(log.text), Log)
    kinds: list[type[Agent]] = [RobotOwner, bidder("one", 0.5), bidder("two", 0.4)]
    for kind in kinds:
        mesh.add(kind(mesh.identity(kind.name)))
    mesh.run(5.0)
    assert not any("mechanism" in text for text in logs)
    for kind in (Auction, bidder("three", 0.6)):
        mesh.add(kind(mesh.identity(kind.name), chosen(kind, "auction")))
    mesh.run(10.0)
    (told,) = (text for text in logs if "mechanism" in text)
    assert "by auction: " in told
    assert "by ballots: " in told
    assert "wheels" in told
