"""An agent that has the robot driven by an errand: what tests of its rivals compete with."""

from __future__ import annotations

from typing import Any, ClassVar

from armadico.agents.missions.errands import Errand
from armadico.core.agent import Agent, Identity
from armadico.core.exchange import Bid
from armadico.core.messages import Message
from armadico.core.resources import Resource
from armadico.mobile.messages import MissionStatus, Planned, Pose, Trajectory
from armadico.mobile.resources import PLANNER, TRAJECTORY


class Sender(Agent):
    """Hands everything over to its errand; a subclass says in `send` where the robot is to go."""

    name = "sender"
    hears: ClassVar[tuple[type[Message], ...]] = (Pose, Trajectory, Planned, MissionStatus)
    competes_for = (PLANNER, TRAJECTORY)
    utility = 0.5

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.errand = Errand(self.rng)

    def send(self, pose: Pose) -> None:
        """Begin or drop the errand, at each pose."""

    def on_pose(self, pose: Pose) -> None:
        self.errand.pose(pose)
        self.send(pose)

    def on_trajectory(self, trajectory: Trajectory) -> None:
        self.errand.trajectory(trajectory)

    def on_planned(self, planned: Planned) -> None:
        self.errand.planned(planned)

    def on_mission_status(self, status: MissionStatus) -> None:
        self.errand.status(status)

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:
        return self.errand.bid_for(resource, self.utility)
