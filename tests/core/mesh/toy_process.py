"""A toy agent as a process of its own: python toy_process.py KIND NAMESPACE."""

from __future__ import annotations

import logging
import sys
from typing import ClassVar

from armadico.core.agent import Agent, Question
from armadico.core.messages import Claim, Message, Stop
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import Plan, PlanRequest
from armadico.runtime.process import identity, serve


class Toy(Agent):
    """Answers plans; what it does on a stop depends on its kind."""

    name = "toy"
    receives: ClassVar[tuple[type[Message], ...]] = (Stop,)
    answers: ClassVar[tuple[type[Message], ...]] = (PlanRequest,)

    def on_plan_request(self, _request: PlanRequest, _question: Question) -> Plan:
        return Plan(waypoints=(), refusal=f"{self.instance} does not plan")


class Broken(Toy):
    """Fails."""

    def on_stop(self, stop: Stop) -> None:
        raise RuntimeError(f"cannot bear {stop.by}")


class Hanging(Toy):
    """Never comes back from its turn."""

    def on_stop(self, stop: Stop) -> None:
        while True:
            pass


class Attentive(Toy):
    """Subscribes to claims, which may be large."""

    receives: ClassVar[tuple[type[Message], ...]] = (Stop, Claim)

    def on_claim(self, claim: Claim) -> None:
        """Nothing."""


KINDS: dict[str, type[Toy]] = {
    "calm": Toy,
    "broken": Broken,
    "hanging": Hanging,
    "attentive": Attentive,
}

if __name__ == "__main__":
    logging.basicConfig(stream=sys.stderr)
    serve([KINDS[sys.argv[1]](identity("toy"))], ZenohMesh(sys.argv[2], topology()))
