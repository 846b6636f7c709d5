"""An agent alone: it receives the messages of each cycle, and its outputs are kept."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, degrees, hypot, radians
from typing import Final, TypeVar, cast

from armadico.core.agent import Agent, Question
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
    Twist,
)
from armadico.core.outgoing import Answer, Publish, SendQuery
from armadico.core.resources import WHEELS
from armadico.mobile.messages import Pose, Trajectory, Waypoint
from armadico.mobile.obstacles import Obstacles

M = TypeVar("M", bound=Message)

NO_STOP = Stop()

PIONEER: Final = Description(
    robot="pioneer-2dx",
    cycle_s=PERIOD,
    front=0.21,
    rear=0.23,
    half_width=0.165,
    v_max=1.6,
    w_max=5.2,
    v_accel=0.3,
    v_decel=0.6,
    w_accel=1.745,
    w_decel=1.745,
    silence_s=3 * PERIOD,
    watchdog_s=2.0,
    sensors=("sonar",),
    cone=radians(30.0),
    nearest=0.1,
)
"""The footprint and the limits of a Pioneer 2 DX, with sonars."""


class Alone:
    """Delivers the messages of a robot's cycles to an agent, and keeps its outputs.

    The robot obeys the agent immediately, and stays at `pose`.

    Attributes:
        agent: The agent.
        number: The number of the robot's cycle.
        now: The time, s.
        pose: The robot's pose: m, m, rad in the world.
        off_m: The pose's standard deviation, m; 0: no covariance.
        odometry: The controller's odometry: m, m, rad.
        speed: The measured speeds, m/s and rad/s.
        volts: The battery's voltage.
        charging: Whether a charger is connected.
        stalled: Whether something blocks the robot.
        touch: The place that the bumpers touch, in the body frame, m.
        capped: Why the robot agent lets none of its commands through; empty: it does.
        published: All messages that the agent has published.
        asked: All queries that it has sent.
        answers: Its replies, by the number of the query.
    """

    def __init__(self, agent: Agent, epoch: int = 1, robot: Description | None = PIONEER) -> None:
        """Deliver the robot's description, if the agent subscribes to it.

        Args:
            agent: An agent that has not begun.
            epoch: The epoch of the robot's cycles.
            robot: The robot; None: no description.
        """
        self.agent = agent
        self.epoch = epoch
        self.number = 0
        self.now = 0.0
        self.pose = (0.0, 0.0, 0.0)
        self.off_m = 0.0
        self.odometry = (0.0, 0.0, 0.0)
        self.speed = (0.0, 0.0)
        self.volts = 12.0
        self.stalled = self.charging = False
        self.touch: Point | None = None
        self.capped = ""
        self.published: list[Message] = []
        self.on_query: list[SendQuery] = []
        self.answers: dict[int, Message] = {}
        self._replied: set[int] = set()
        if robot and any(each.message is Description for each in agent.kernel.subscriptions):
            self.give(robot)

    @property
    def at(self) -> Cycle:
        """The present cycle."""
        return Cycle(self.epoch, self.number)

    @property
    def bid(self) -> BidRecord:
        """Its last bid, or its reason for none."""
        return self.agent.kernel.bids[-1]

    @property
    def commanded(self) -> tuple[float, float]:
        """The last commanded speeds, m/s and rad/s; zeros after a release."""
        sent = commands(self.published)
        action = sent[-1].action if sent else None
        return cast("tuple[float, float]", action or WHEELS.neutral)

    def give(self, *messages: Message) -> list[Message]:
        """Deliver messages in order; return what the agent publishes."""
        for message in messages:
            self.agent.kernel.receive(message, self.now)
        return self.collect()

    def collect(self) -> list[Message]:
        """Return what it has published since the last call."""
        kernel = self.agent.kernel
        out, kernel.outbox = kernel.outbox, []
        found = [item.message for item in out if isinstance(item, Publish)]
        self.on_query += [item for item in out if isinstance(item, SendQuery)]
        self.answers |= {item.id: item.message for item in out if isinstance(item, Answer)}
        self.published += found
        return found

    def all(self, kind: type[M]) -> list[M]:
        """Return all published messages of a kind."""
        return [message for message in self.published if isinstance(message, kind)]

    def last(self, kind: type[M]) -> M:
        """Return the last published message of a kind."""
        return self.all(kind)[-1]

    def query(self, request: Message, number: int = 1) -> Message | None:
        """Send it a query; return the reply, or None if it comes later, in `answers`."""
        self.answers.pop(number, None)
        self.agent.kernel.on_query(request, Question(number), self.now)
        self.collect()
        return self.answers.get(number)

    @property
    def waits(self) -> bool:
        """Whether it waits for the reply to its last query."""
        return bool(self.on_query) and self.on_query[-1].id not in self._replied

    def reply(self, message: Message | None) -> list[Message]:
        """Reply to its last query; return what it publishes."""
        self._replied.add(self.on_query[-1].id)
        self.agent.kernel.on_reply(self.on_query[-1].id, message, self.now)
        return self.collect()

    def wake(self) -> list[Message]:
        """Wake it if that is due; return what it publishes."""
        due = self.agent.kernel.wakeup
        if due is not None and self.now >= due:
            self.agent.kernel.wake(self.now)
        return self.collect()

    def state(self, stop: Stop = NO_STOP, *, cycles: int = 1) -> list[Message]:
        """Advance by cycles and deliver the robot's state and ack; return what it publishes."""
        self.number += cycles
        self.now += PERIOD * cycles
        v, w = self.speed
        stalled = self.stalled or self.touch is not None
        state = RobotState(
            *(self.at, *self.odometry, v, w, self.volts, True, stalled, stop),
            touch=self.touch,
            charging=self.charging,
            ordered=Twist(*self.commanded),
            admitted=Twist(0.0, 0.0) if self.capped else Twist(*self.commanded),
            capped=self.capped,
            driver=self.agent.instance if any(self.commanded) else "",
        )
        return self.give(state, *([self.ack()] if self.agent.competes_for else []))

    def ack(self) -> Ack:
        """Return the robot agent's ack, which obeys the agent's last command."""
        last = next((c for c in reversed(self.published) if isinstance(c, Command)), None)
        if last is None:
            return Ack("wheels", self.at, measured=self.speed)
        claimed = next((c for c in reversed(self.published) if isinstance(c, Claim)), None)
        rank = (0.0, False)
        if claimed is not None and claimed.utility is not None:
            rank = (claimed.utility, claimed.critical)
        obeyed = None if last.action is None else last.ballot
        return Ack("wheels", self.at, last.ballot, obeyed, last.cycle, *rank, self.speed)

    def cycle(
        self, stop: Stop = NO_STOP, *, cycles: int = 1, points: Iterable[Point] = ()
    ) -> list[Message]:
        """Do as `state`, then deliver a pose and obstacles; return what it publishes."""
        found = self.state(stop, cycles=cycles)
        inputs = [obstacles(self.at, *points), Pose(self.at, *self.pose, covariance(self.off_m))]
        inputs.sort(key=lambda message: type(message) is self.agent.reacts_to)  # that one last
        return found + self.give(*inputs) + self._settle()

    def _settle(self) -> list[Message]:
        """Let the drawn delay pass if it is about to take over the resource."""
        for resource in self.agent.competes_for:
            due = self.agent.kernel.bidding(resource).contender.wakeup
            if due is not None and due <= self.now + DRAW * PERIOD:
                self.agent.kernel.wake(due)
        return self.collect()

    def holding(self, *, points: Iterable[Point] = ()) -> list[Message]:
        """Run cycles until it holds the resource; return what it publishes in the last one."""
        points = tuple(points)
        for _ in range(4):
            found = self.cycle(points=points)
        assert claims(found), "it has no bid"
        return found


def covariance(off_m: float) -> tuple[float, ...]:
    """Return a pose's covariance for a standard deviation of the position, m; () for 0."""
    return (off_m**2 / 2, 0.0, 0.0, off_m**2 / 2, 0.0, 0.0) if off_m else ()


def obstacles(cycle: Cycle, *points: Point) -> Obstacles:
    """Return obstacles at points (body frame, m), with the nearest of each side (3.4.2)."""
    near = sorted(points, key=lambda p: hypot(p.x, p.y))

    def first(low: float, high: float) -> Point | None:
        return next((p for p in near if low <= degrees(atan2(p.y, p.x)) < high), None)

    closest = near[0] if near else None
    return Obstacles(cycle, closest, first(-40, 40), first(40, 120), first(-120, -40), points)


def drive_to(*waypoints: tuple[float, float, float], mission: int = 1) -> Trajectory:
    """Return a trajectory from the origin over these poses: m, m, rad."""
    return Trajectory(1, mission, tuple(Waypoint(*pose) for pose in waypoints))


def wall(x: float, low: float, high: float, step: float = 0.1) -> list[Point]:
    """Return points of a wall across the path at `x`, from y `low` to `high`, m."""
    count = round((high - low) / step)
    return [Point(x, low + (high - low) * n / count) for n in range(count + 1)]


def commands(messages: Iterable[Message]) -> list[Command]:
    return [message for message in messages if isinstance(message, Command)]


def claims(messages: Iterable[Message]) -> list[Claim]:
    return [message for message in messages if isinstance(message, Claim)]
