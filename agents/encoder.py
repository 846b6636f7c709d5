"""The encoder agent: where the robot is in the world, by its encoders (thesis 3.4.1)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from armadico import agent
from armadico.agent import Agent
from armadico.geometry import Pose2, compose, relative
from armadico.messages import Message, Pose, RobotState

Metres = Annotated[float, Meta(ge=-1e5, le=1e5)]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Where the robot stands in the world when the robot agent starts: m, m, rad."""

    x: Metres = 0.0
    y: Metres = 0.0
    theta: Annotated[float, Meta(ge=-6.2832, le=6.2832)] = 0.0


class Encoder(Agent):
    """Turns the controller's local odometry into a pose in the world frame."""

    name = "encoder"
    provides: ClassVar[tuple[type[Message], ...]] = (Pose,)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._origin: Pose2 = (self.p.x, self.p.y, self.p.theta)
        self._pose: Pose2 = self._origin
        self._epoch: int | None = None

    def on_robot_state(self, state: RobotState) -> None:
        """One status packet, one pose."""
        odometry = (state.x, state.y, state.theta)
        if self._epoch is not None and state.cycle.epoch != self._epoch:
            # A restarted robot agent counts from elsewhere; the robot has not jumped.
            self._origin = compose(self._pose, relative(odometry, (0.0, 0.0, 0.0)))
        self._epoch = state.cycle.epoch
        self._pose = compose(self._origin, odometry)
        self.publish(Pose(state.cycle, *self._pose))
