"""Agents on both meshes: the same rules of admission, tokens and queries."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from armadico.agents.localization.encoder import Encoder
from armadico.bridge.robot import Robot
from armadico.core.agent import Agent, Question
from armadico.core.driver import Driver
from armadico.core.membership import Stage
from armadico.core.messages import (
    PROTOCOL,
    Card,
    Message,
    Stop,
)
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Plan, PlanRequest, Waypoint
from tests.core.mesh.conftest import Crowd

REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 2, 0.5))


class Toy(Agent):
    """Subscribes to the stop, and plans nothing."""

    name = "toy"
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def on_plan_request(self, _request: PlanRequest, _question: Question) -> Plan:
        return Plan((), refusal=f"{self.instance} does not plan")


class Stopping(Toy):
    name = "stopping"
    receives: ClassVar[tuple[type[Message], ...]] = (Stop,)


class Foreign(Toy):
    """Speaks another protocol."""

    name = "foreign"

    def fill_card(self, card: Card) -> Card:
        return replace(card, protocol=PROTOCOL + 1)


class Other(Agent):
    """Owns the wheels too, by another name."""

    name = "other"
    owns = (WHEELS,)

    def obey(self, resource: Any, action: Any) -> None:
        """Nothing."""

    def rest(self, resource: Any) -> None:
        """Nothing."""


def start(crowd: Crowd, kind: type[Agent]) -> Driver:
    return crowd.start(kind(crowd.identity(kind.name)))


def joined(crowd: Crowd, kind: type[Agent]) -> Driver:
    """One that is at work, and seen to be."""
    driver = start(crowd, kind)
    agent = (driver.agent.name, driver.agent.instance)
    assert crowd.until(lambda: driver.started and agent in crowd.client.alive)
    return driver


def refusal(crowd: Crowd, driver: Driver) -> str:
    assert crowd.until(lambda: driver.refusal)
    assert driver.stage is Stage.REFUSED
    return driver.refusal


def alive(crowd: Crowd) -> set[str]:
    """Return the names of the remaining agents once nothing changes any more."""
    crowd.client.settle()
    return {name for name, _ in crowd.client.alive}


@pytest.mark.parametrize("kind", [Robot, Encoder])
def test_a_second_robot_or_encoder_agent_is_refused_and_never_seen(
    crowd: Crowd, kind: type[Agent]
) -> None:
    first = joined(crowd, kind)
    seen: set[tuple[str, str]] = set()
    second = start(crowd, kind)
    assert crowd.until(lambda: seen.update(crowd.client.alive) or second.refusal)
    why = refusal(crowd, second)
    assert why.startswith(f"another {kind.name} agent is alive already: {first.agent.instance} (")
    assert why.endswith("end that one, or use another namespace: --namespace")
    crowd.client.settle()
    assert seen | crowd.client.alive == {(kind.name, first.agent.instance)}
    assert first.started


def test_a_second_owner_of_a_resource_is_refused_by_whatever_name(crowd: Crowd) -> None:
    first = joined(crowd, Robot)
    why = refusal(crowd, start(crowd, Other))
    assert why.startswith(f"wheels has an owner already: {first.agent.instance} (")
    assert alive(crowd) == {"robot"}


def test_of_several_that_begin_at_once_one_stays(crowd: Crowd) -> None:
    drivers = [start(crowd, Encoder) for _ in range(3)]
    assert crowd.until(lambda: sum(bool(d.refusal) for d in drivers) == 2)
    (left,) = (driver for driver in drivers if not driver.refusal)
    assert crowd.until(lambda: left.started)
    assert alive(crowd) == {"encoder"}


def test_where_an_owner_speaks_its_protocol_it_may_join_beside_another(crowd: Crowd) -> None:
    joined(crowd, Robot)
    joined(crowd, Foreign)
    joined(crowd, Toy)
    assert alive(crowd) == {"robot", "foreign", "toy"}


def test_a_joining_agent_gets_the_tokens_and_the_latched_states(
    crowd: Crowd,
) -> None:
    first, stop = joined(crowd, Stopping), Stop(7, True, "tester", 1)

    def has_stop(driver: Driver) -> bool:
        return driver.agent.memory.newest(Stop) == stop

    crowd.client.publish(stop)
    assert crowd.until(lambda: has_stop(first))
    second = joined(crowd, Stopping)
    assert crowd.until(
        lambda: ("stopping", first.agent.instance) in second.alive and has_stop(second)
    )
