"""An agent that has the robot driven by an errand: what tests of its rivals compete with."""

from __future__ import annotations

from typing import Any

from armadico.agents.missions.errands import DeliberativeAgent
from armadico.core.exchange import Bid
from armadico.core.resources import Resource
from armadico.mobile.messages import Pose


class Sender(DeliberativeAgent):
    """A subclass says in `send` where the robot is to go."""

    name = "sender"
    utility = 0.5

    def send(self, pose: Pose) -> None:
        """Begin or drop the errand, at each pose."""

    def on_pose(self, pose: Pose) -> None:
        super().on_pose(pose)
        self.send(pose)

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:
        return self.errand.bid_for(resource, self.utility)
