"""A stage for one agent: cycles are handed to it, and what it says is kept; no mesh, no clock."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, degrees, hypot

from armadico.core.agent import Agent, Publish
from armadico.core.coordination import DRAW
from armadico.core.cycles import PERIOD
from armadico.core.messages import (
    Ack,
    BidRecord,
    Claim,
    Command,
    Cycle,
    Description,
    Message,
    Point,
    RobotState,
    Stop,
)
from armadico.mobile.messages import Pose, Trajectory, Waypoint
from armadico.mobile.obstacles import Obstacles
from tests.framework.robots import described

NOTHING = (None, None, None, None)
NO_STOP = Stop()


class Stage:
    """Hands an agent what a cycle brings, and keeps what it says.

    It is told which robot that is, if it listens, unless `robot` is None.
    """

    def __init__(self, agent: Agent, epoch: int = 1, robot: str | None = "pioneer-2dx") -> None:
        self.agent = agent
        self.epoch = epoch
        self.number = 0
        self.now = 0.0
        self.pose = (0.0, 0.0, 0.0)
        self.off_m = 0.0  # by so much the pose may be off; 0: nobody says
        self.speed = (0.0, 0.0)
        self.stalled = False
        self.said: list[Message] = []
        if robot is not None and any(s.message is Description for s in agent.subscriptions()):
            self.hand(described(robot))

    @property
    def at(self) -> Cycle:
        """The cycle that the robot is at."""
        return Cycle(self.epoch, self.number)

    def hand(self, *messages: Message) -> list[Message]:
        """Give it messages, one after another; what it says to them."""
        for message in messages:
            self.agent.receive(message, self.now)
        return self.take()

    def take(self) -> list[Message]:
        """What it has said since."""
        said = [item.message for item in self.agent.outbox if isinstance(item, Publish)]
        self.agent.outbox.clear()
        self.said += said
        return said

    def state(self, stop: Stop = NO_STOP, *, cycles: int = 1) -> list[Message]:
        """So many cycles later, the robot's state and its acknowledgement."""
        self.number += cycles
        self.now += 0.1 * cycles
        v, w = self.speed
        state = RobotState(self.at, 0, 0, 0, v, w, 12, True, self.stalled, stop)
        return self.hand(state, self.ack())

    def ack(self) -> Ack:
        """The robot agent's word: it obeyed what the agent last commanded, or released."""
        last = next((c for c in reversed(self.said) if isinstance(c, Command)), None)
        if last is None:
            return Ack("wheels", self.at, measured=self.speed)
        claimed = next((c for c in reversed(self.said) if isinstance(c, Claim)), None)
        rank = (0.0, False)
        if claimed is not None and claimed.utility is not None:
            rank = (claimed.utility, claimed.critical)
        obeyed = None if last.action is None else last.ballot
        return Ack("wheels", self.at, last.ballot, obeyed, last.cycle, *rank, self.speed)

    def cycle(
        self, stop: Stop = NO_STOP, *, cycles: int = 1, points: Iterable[Point] = ()
    ) -> list[Message]:
        """The same with pose and obstacles, the one that it reacts to last."""
        said = self.state(stop, cycles=cycles)
        brought = [obstacles(self.at, *points), Pose(self.at, *self.pose, spread(self.off_m))]
        brought.sort(key=lambda message: type(message) is self.agent.reacts_to)
        return said + self.hand(*brought) + self._settle()

    def _settle(self) -> list[Message]:
        """Let what it drew pass, if it is about to take the resource over."""
        for contender in self.agent._contenders.values():
            due = contender.wakeup
            if due is not None and due <= self.now + DRAW * PERIOD:
                self.agent.wake(due)
        return self.take()

    def holding(self, *, points: Iterable[Point] = ()) -> list[Message]:
        """Cycles until it has taken the resource that nobody else wants; the last one's words."""
        points = tuple(points)
        for _ in range(4):
            said = self.cycle(points=points)
        assert claims(said), "it has no bid"
        return said

    def bid(self) -> BidRecord:
        """What it last thought of bidding."""
        return self.agent.bids[-1]


def spread(off_m: float) -> tuple[float, ...]:
    """The covariance of a pose that may be so far off, m."""
    return (off_m**2 / 2, 0.0, 0.0, off_m**2 / 2, 0.0, 0.0) if off_m else ()


def obstacles(cycle: Cycle, *points: Point) -> Obstacles:
    """Points with the nearest of all, in front and at each side told apart (thesis 3.4.2)."""
    near = sorted(points, key=lambda p: hypot(p.x, p.y))

    def first(low: float, high: float) -> Point | None:
        return next((p for p in near if low <= degrees(atan2(p.y, p.x)) < high), None)

    closest = near[0] if near else None
    return Obstacles(cycle, closest, first(-40, 40), first(40, 120), first(-120, -40), points)


def drive_to(*waypoints: tuple[float, float, float], mission: int = 1) -> Trajectory:
    """A mission from the origin over these poses."""
    return Trajectory(1, mission, tuple(Waypoint(*pose) for pose in waypoints))


def wall(x: float, low: float, high: float, step: float = 0.1) -> list[Point]:
    """Points across the way at `x`, from y `low` to `high`."""
    count = round((high - low) / step)
    return [Point(x, low + (high - low) * n / count) for n in range(count + 1)]


def commands(said: Iterable[Message]) -> list[Command]:
    """The commands among what was said."""
    return [message for message in said if isinstance(message, Command)]


def claims(said: Iterable[Message]) -> list[Claim]:
    """The claims among what was said."""
    return [message for message in said if isinstance(message, Claim)]
