"""What the behaviours have in common: they drive a mission's trajectory, and know where on it."""

from __future__ import annotations

from typing import Any, ClassVar

from armadico import agent
from armadico.agent import Agent
from armadico.agents.methods.route import Route
from armadico.exchange import Bid
from armadico.messages import Message, Obstacles, Pose, Trajectory
from armadico.resources import WHEELS


class Behaviour(Agent):
    """An agent that competes for the wheels while there is a trajectory to follow.

    A subclass says in `propose` what it would do. `route` knows the way and how far the robot has
    come on it. Nobody bids without a goal.
    """

    needs: ClassVar[tuple[type[Message], ...]] = (Pose, Obstacles)
    hears: ClassVar[tuple[type[Message], ...]] = (Trajectory,)
    competes_for = (WHEELS,)

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.route = Route()
        self._mission = 0

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """What it would do now, and how much that helps; None, and `why`, if nothing."""
        raise NotImplementedError

    def on_mission(self) -> None:
        """A new mission has begun, or the old one has ended."""

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """A new mission, or the old one said again."""
        if trajectory.mission != self._mission or not trajectory.waypoints:
            self._mission = trajectory.mission
            self.route = Route.of(trajectory)
            self.on_mission()

    def bid(self, message: Any) -> Bid | None:  # noqa: ARG002 - either starts the turn
        """Follow the route, and propose."""
        if not self.route.waypoints:
            self.why = "no goal"
            return None
        pose, obstacles = self.fresh(Pose), self.fresh(Obstacles)
        assert pose is not None, "the pattern lets nobody bid without what it needs"
        assert obstacles is not None, "nor without that"
        self.route.advance(pose.x, pose.y)
        return self.propose(pose, obstacles)
