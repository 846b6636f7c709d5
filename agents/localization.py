"""The localization agent: where the robot is on the map, by its sonars (thesis 3.6.3)."""

from __future__ import annotations

from math import radians
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from armadico.agents.methods.grid import Grid
from armadico.agents.methods.monte_carlo import Estimate, MonteCarlo, Settings
from armadico.agents.methods.sonar_model import SonarModel
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.geometry import Pose2, compose, relative
from armadico.core.messages import Correction, Message, Pose, RobotState, Sonar

Metres = Annotated[float, Meta(gt=0, le=100)]
Angle = Annotated[float, Meta(gt=0, le=6.2832)]
Share = Annotated[float, Meta(ge=0, le=1)]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The map, the robot, and what is believed at the start.

    `start` "pose" begins about the pose that the encoder agent publishes, "anywhere" with no idea.
    """

    world: Annotated[str, Meta(min_length=1)] = "empty"
    profile: str = "pioneer-2dx"
    start: Literal["pose", "anywhere"] = "pose"
    start_m: Metres = 0.15  # standard deviation about that pose
    start_rad: Angle = radians(6.0)
    sure: Share = 0.8  # a correction is published with at least this share of the weight in it,
    sure_m: Metres = 0.5  # and no wider than this: an idea of two places is none
    filter: Settings = Settings()


class Localization(Agent):
    """Moves its particles with the odometry, weighs them by the sonars, and says where that is.

    It works on the odometry as the controller counts it, so what it publishes does not come back to
    it by the pose: a correction is where the odometry's origin lies in the world, as tf's
    transform from map to odom. The encoder agent composes it.
    """

    name = "localization"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (Sonar, Pose)
    provides: ClassVar[tuple[type[Message], ...]] = (Correction,)
    parameters = Parameters
    launched_with = ("world", "profile")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        world, profile = load_world(self.p.world), load_profile(self.p.profile)
        grid = Grid(world.walls, world.bounds)
        ring = profile.sonar
        rows, columns = np.nonzero(grid.clearance > profile.body.width_m / 2)
        free = np.column_stack([grid.xs[columns], grid.ys[rows]])
        self._useful = bool(world.walls) and len(free) > 0
        self._filter = MonteCarlo(
            SonarModel(grid, radians(ring.cone_deg), ring.max_m),
            free,
            np.random.default_rng(self.rng.getrandbits(63)),
            self.p.filter,
        )
        self._odometry: Pose2 | None = None
        self._epoch: int | None = None
        self._begun = False
        self._lost = False

    def on_pose(self, pose: Pose) -> None:
        """Where to begin."""
        if self._begun or not self._useful or self._odometry is None:
            return
        self._begun = True
        if self.p.start == "anywhere":
            self._filter.start_anywhere()
        else:
            self._filter.start_at((pose.x, pose.y, pose.theta), self.p.start_m, self.p.start_rad)

    def on_robot_state(self, state: RobotState) -> None:
        """Move the particles."""
        odometry = (state.x, state.y, state.theta)
        if self._odometry is not None and state.cycle.epoch == self._epoch and self._begun:
            self._filter.move(relative(self._odometry, odometry))
        self._odometry, self._epoch = odometry, state.cycle.epoch

    def on_sonar(self, sonar: Sonar) -> None:
        """Weigh the particles, and publish where they are."""
        if not self._begun or self._odometry is None:
            return
        if self._filter.due:
            self._filter.weigh(sonar.echoes)
        found = self._filter.estimate()
        self._tell(found)
        lost = found.share < self.p.sure or found.deviation_m > self.p.sure_m
        origin = compose(found.pose, relative(self._odometry, (0.0, 0.0, 0.0)))
        c = found.covariance
        self.publish(
            Correction(
                sonar.cycle,
                *origin,
                covariance=tuple(float(c[i, j]) for i in range(3) for j in range(i, 3)),
                confidence=0.0 if lost else min(1.0, found.share),
            )
        )

    def _tell(self, found: Estimate) -> None:
        lost = found.share < self.p.sure or found.deviation_m > self.p.sure_m
        if lost != self._lost:
            self._lost = lost
            x, y, _ = found.pose
            where = f"({x:.2f}, {y:.2f}), {100 * found.share:.0f} % of the weight"
            if lost:
                self.log(f"the robot is lost: at best at {where}", WARNING)
            else:
                self.log(f"the robot is at {where}")
