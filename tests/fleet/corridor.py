"""Robots with giveway agents that drive straight on through a corridor, if these let them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from math import cos, pi, sin
from pathlib import Path
from typing import Final

from armadico.agents.fleet.giveway import GiveWay, Parameters
from armadico.agents.fleet.messages import FleetPassages
from armadico.core.agent import Agent, Identity
from armadico.core.messages import Message
from armadico.core.outgoing import Publish
from armadico.core.parameters import Social
from armadico.mobile.messages import FleetAwards, FleetPose, FleetProposals
from armadico.observe.measures import speeds
from armadico.testing.alone import Alone, commands, drive_to
from tests.fleet.rectangles import map_of

SHARED: Final = (FleetPassages, FleetProposals)

ARBITRATED: Final = (FleetProposals, FleetAwards)

MOUTHS = 6.0, 12.0
"""Of the corridor, m: along the x axis, in the middle of its rooms."""

Y = 2.5
V = 0.4


def corridor(folder: Path) -> str:
    """Write the map of a corridor between two rooms; return its path."""
    path = folder / "corridor.map"
    path.write_text(map_of([(0, 0, 6, 5), (6, 1.9, 12, 3.1), (12, 0, 18, 5)]))
    return str(path)


class Robot(Alone):
    """Drives along the x axis to its goal, but for what its agent commands."""

    def __init__(
        self,
        name: str,
        world: str | None,
        x: float,
        goal: float,
        start: int = 1,
        coordination: str | None = None,
    ) -> None:
        social = Social(coordination=coordination)
        parameters = Parameters(namespace=f"lab/{name}", world=world, social=social)
        super().__init__(GiveWay(Identity(f"giveway-{name}-{start}"), parameters))
        self.name, self.goal, self.sent, self.blind = name, goal, 0, False
        self.pose = (x, Y, 0.0 if goal > x else pi)
        self.agent.kernel.start(0.0)
        self.state()
        self.give(drive_to((goal, Y, 0.0)))

    @property
    def x(self) -> float:
        return self.pose[0]

    @property
    def inside(self) -> bool:
        """Whether its body is in the corridor."""
        return MOUTHS[0] - 0.2 < self.x < MOUTHS[1] + 0.2

    @property
    def there(self) -> bool:
        return abs(self.x - self.goal) < 0.1

    def tick(self) -> list[Message]:
        """One cycle of the robot, which stands while it has no pose."""
        said = self.state() if self.blind else self.cycle()
        if (self.agent.kernel.wakeup or self.now + 1.0) <= self.now:
            self.agent.kernel.wake(self.now)
            said += self.collect()
        x, y, theta = self.pose
        own = [c for c in commands(said) if c.action is not None]
        stands = self.there or self.blind
        self.speed = speeds(own[-1]) if own else (0.0 if stands else V, 0.0)
        self.pose = (
            x + 0.1 * self.speed[0] * cos(theta),
            y + 0.1 * self.speed[0] * sin(theta),
            theta,
        )
        return said

    def push(self, cycles: int) -> None:
        """Move it along the x axis at 1 m/s, whatever its agent commands; by hand, for example."""
        for _ in range(cycles):
            self.speed = (1.0, 0.0)
            self.cycle()
            x, y, theta = self.pose
            self.pose = (x + 0.1, y, theta)

    @property
    def told(self) -> FleetPose:
        x, y, theta = self.pose
        return FleetPose(self.name, x, y, theta, (), *self.speed, 0.21, 0.23, 0.17)


class Fleet:
    """Robots that receive what the others and the arbiters publish, but for what is lost."""

    def __init__(self, *robots: Robot, arbiters: Sequence[Agent] = ()) -> None:
        self.robots = {robot.name: robot for robot in robots}
        self.arbiters: dict[str, Agent] = {}
        self.lost: Callable[[str, str], bool] = lambda _sender, _receiver: False
        self.entered: list[str] = []
        self.most = 0  # robots in the corridor at once
        self.sent = 0  # messages, but for poses
        self.now = 0.0
        for arbiter in arbiters:
            self.begin(arbiter)

    def begin(self, arbiter: Agent) -> None:
        """Start an arbiter now."""
        arbiter.kernel.start(self.now)
        self.arbiters[arbiter.instance] = arbiter

    def enter(self, robot: Robot) -> None:
        """Add a robot now, or instead of the one of its name."""
        robot.number, robot.now = round(10 * self.now), self.now
        self.robots[robot.name] = robot

    def run(self, seconds: float) -> None:
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            for robot in list(self.robots.values()):
                robot.tick()
                said = [m for m in robot.published[robot.sent :] if isinstance(m, SHARED)]
                robot.sent = len(robot.published)
                self._send(robot.name, robot.told, *said)
                if robot.inside and robot.name not in self.entered:
                    self.entered.append(robot.name)
            for name, arbiter in self.arbiters.items():
                kernel = arbiter.kernel
                if (kernel.wakeup or self.now + 1.0) <= self.now:
                    kernel.wake(self.now)
                out, kernel.outbox = kernel.outbox, []
                self._send(name, *(item.message for item in out if isinstance(item, Publish)))
            self.most = max(self.most, sum(robot.inside for robot in self.robots.values()))

    def _send(self, sender: str, *messages: Message) -> None:
        for message in messages:
            self.sent += not isinstance(message, FleetPose)
            for name, robot in self.robots.items():
                if name != sender and not self.lost(sender, name):
                    robot.give(message)
            for name, arbiter in self.arbiters.items():
                takes = isinstance(message, ARBITRATED) and name != sender
                if takes and not self.lost(sender, name):
                    arbiter.kernel.receive(message, self.now)

    @property
    def arrived(self) -> bool:
        return all(robot.there for robot in self.robots.values())


def lossy(
    fleet: Fleet, draw: random.Random, loss: float, cut: float, until_s: float
) -> Callable[[str, str], bool]:
    """Lose a share of all messages, and each link for another share of all 4 s."""
    links: dict[tuple[str, str, int], bool] = {}

    def lost(sender: str, receiver: str) -> bool:
        if fleet.now > until_s:
            return False
        link = sender, receiver, int(fleet.now / 4.0)
        return links.setdefault(link, draw.random() < cut) or draw.random() < loss

    return lost
