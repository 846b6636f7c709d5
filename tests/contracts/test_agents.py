"""The contracts of agents and resources: ours keep them, and each planted defect breaks one."""

from __future__ import annotations

import random
from typing import Any

import pytest

from armadico.agents.driving.avoid import Avoid
from armadico.contracts.agents import AgentContract, ResourceContract
from armadico.contracts.contract import judged
from armadico.core.agent import Agent, Identity
from armadico.core.judgement import Answer
from armadico.core.messages import Ack, Log, RobotState
from armadico.core.resources import WHEELS, Resource
from armadico.mobile.messages import Echo, Sonar

LAMP = Resource(
    name="lamp-of-tests", parameters=("light",), scale=(1.0,), neutral=(0.0,), period_s=0.2
)


class Lamp(Agent):
    name = "lamp-of-tests"
    owns = (LAMP,)

    def on_start(self) -> None:
        self.light = 0.0

    def obey(self, resource: Resource, action: Any) -> None:
        (self.light,) = action

    def rest(self, resource: Resource) -> None:
        self.light = 0.0

    def measure(self, resource: Resource) -> tuple[float, ...]:
        return (self.light,)

    def beyond(self, resource: Resource, action: Any) -> str:
        return "" if abs(action[0]) <= 1.0 else "too bright"


class TestAvoid(AgentContract):
    agent = Avoid
    limit_s = 12.0  # it bids by then


class TestLamp(ResourceContract):
    owner = Lamp
    action = (0.5,)


class Undeclared(Agent):
    """Publishes what it does not provide."""

    name = "undeclared"
    receives = (Sonar,)

    def on_sonar(self, sonar: Sonar) -> None:
        self.publish(Sonar(sonar.cycle, 1.0, (Echo(0.0, 0.0, 0.0, None),)))


class Random(Agent):
    """Has random numbers of its own."""

    name = "at-random"
    receives = (RobotState,)

    def on_robot_state(self, state: RobotState) -> None:
        self.publish(Log(20, f"{random.random()} at {state.cycle.number}"))


class Idle(Agent):
    """Competes, and never bids."""

    name = "idler"
    competes_for = (WHEELS,)

    def bid(self, message: Ack) -> None: ...


@pytest.mark.parametrize(
    ("kind", "check", "answer", "reason"),
    [
        (Undeclared, "does_what_it_declares", Answer.NO, "publishes Sonar"),
        (Random, "repeats_itself", Answer.NO, "differs"),
        (Idle, "does_what_it_declares", Answer.UNKNOWN, "did not publish a bid"),
    ],
)
def test_a_defect_of_an_agent_breaks_its_check(
    kind: type[Agent], check: str, answer: Answer, reason: str
) -> None:
    contract: Any = type("Judged", (AgentContract,), {"agent": kind, "limit_s": 6.0})()
    judgement = judged(getattr(contract, f"check_{check}"))
    assert judgement.answer is answer, judgement
    assert reason in judgement.reason


class Careless(Lamp):
    """Accepts everything."""

    def beyond(self, resource: Resource, action: Any) -> str:
        return ""


class Ragged(Lamp):
    """Measures another shape."""

    def measure(self, resource: Resource) -> tuple[float, ...]:
        return (self.light, 1.0)


class Once(Lamp):
    """Does not come back."""

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        if identity.instance != FIRST:
            raise RuntimeError("the device is busy")


FIRST = "owner-1"


@pytest.mark.parametrize(
    ("kind", "check", "reason"),
    [
        (Careless, "refuses_what_it_cannot_do", "is accepted"),
        (Ragged, "obeys_its_holder", "another shape"),
        (Once, "obeys_its_holder", "RuntimeError: the device is busy"),
    ],
)
def test_a_defect_of_an_owner_breaks_its_check(kind: type[Agent], check: str, reason: str) -> None:
    contract: Any = type("Judged", (ResourceContract,), {"owner": kind})()
    judgement = judged(getattr(contract, f"check_{check}"))
    assert judgement.answer is Answer.NO, judgement
    assert reason in judgement.reason
