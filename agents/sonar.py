"""The sonar agent: a local map of what is around the robot (thesis 3.4.2)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from armadico import agent
from armadico.agent import Agent
from armadico.agents.methods.geometry import Placed
from armadico.agents.methods.local_map import LocalMap, Obstacle, Settings
from armadico.geometry import Pose2, relative
from armadico.messages import Message, Obstacles, Point, RobotState, Sonar


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How the map believes and forgets."""

    map: Settings = Settings()


class SonarAgent(Agent):
    """Moves its map with the robot, takes the echoes in, and says what is near.

    The map is local, so the controller's own odometry moves it: a frame's echoes become obstacles
    one hop after they came, whoever else is slow.
    """

    name = "sonar"
    hears: ClassVar[tuple[type[Message], ...]] = (Sonar,)
    provides: ClassVar[tuple[type[Message], ...]] = (Obstacles,)
    Parameters = Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._map = LocalMap(self.p.map)
        self._odometry: Pose2 | None = None
        self._epoch: int | None = None

    def on_robot_state(self, state: RobotState) -> None:
        """Apply the robot's motion to the map."""
        odometry = (state.x, state.y, state.theta)
        if self._odometry is not None and state.frame.epoch == self._epoch:
            self._map.move(Placed(*relative(self._odometry, odometry)))
        self._odometry, self._epoch = odometry, state.frame.epoch

    def on_sonar(self, sonar: Sonar) -> None:
        """Take the echoes in, and say where the obstacles are."""
        seen = self._map
        seen.update(sonar.echoes)
        self.publish(
            Obstacles(
                frame=sonar.frame,
                closest=_point(seen.closest()),
                front=_point(seen.front()),
                left=_point(seen.left()),
                right=_point(seen.right()),
                points=_points(seen.points()),
            )
        )


def _point(obstacle: Obstacle | None) -> Point | None:
    return None if obstacle is None else Point(obstacle.x, obstacle.y)


def _points(obstacles: Iterable[Obstacle]) -> tuple[Point, ...]:
    return tuple(Point(o.x, o.y) for o in obstacles)
