"""The watch over a robot that drives for a client: it cancels what would leave the policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from math import inf
from typing import Annotated, Final

from msgspec import Meta

from armadico.agents.interface.messages import MissionCancel
from armadico.config.shipped import find
from armadico.config.worlds import load_world
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.config_errors import ConfigError
from armadico.core.messages import LABEL, Description, RobotState, line
from armadico.mobile.messages import MissionReply, MissionState, MissionStatus, Pose, Trajectory
from armadico.mobile.obstacles import SONAR, Obstacles
from armadico.watch.assistant.goals import BY, LONGEST_BY, Goals, client_in, orderer
from armadico.watch.assistant.policy import approvals
from armadico.watch.assistant.policy.area import Place
from armadico.watch.assistant.policy.book import Book
from armadico.watch.assistant.policy.messages import Approvals
from armadico.watch.assistant.policy.policy import BY_SONARS, NO_POLICY, Rules, load
from armadico.watch.assistant.policy.scene import Scene

TOO_NEAR: Final = 3
"""A mission ends once so many messages in a row show something too near: one may be an echo."""

UNKNOWN: Final = "its policy is not known here"

BESIDE: Final = "another assistant agent, with a policy, is alive: ask again when one is left"

BESIDE_S: Final = 3.0
"""It is alive if it has published its policy within this time, s; it does each second."""

CANCELS: Final = 3
"""If nobody has answered so many cancellations, the robot is stopped: it would leave the policy."""

LEARN_S: Final = 2.0
"""Time in which an agent that has started receives where the robot is and how large, s, before a
mission ends, or a goal is refused, because that is not known."""

CANCEL_S: Final = 0.5  # the timeout of a cancellation


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The policy, the log, the rate limit, and the timeout for a mission agent's reply."""

    policy: str = ""  # a TOML file (docs/policy.md), or the name of a shipped one; "": none
    log: str = ""  # a file that each request is appended to; "": none
    world: str = ""  # the map with the policy's rooms; "": none
    a_second: Annotated[float, Meta(gt=0, le=100)] = 2.0  # requests per second, on average
    at_once: Annotated[float, Meta(ge=1, le=1000)] = 20.0  # requests in one burst
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 25.0


class Keeper(Agent):
    """Keeps the policy while the robot drives for a client; `Assistant` is the agent.

    A mission that would leave the policy is cancelled; if nobody answers that, the robot is
    stopped. The missions of people are not watched.
    """

    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.clock: Callable[[], datetime] = lambda: datetime.now().astimezone()
        """Returns the local time, for the policy's hours and the log."""
        self._policy, self._misread = NO_POLICY, ""  # why the policy cannot be used
        self._load()
        self._approvals = approvals.Approvals(under=self._policy.hash)
        self._book = Book(
            self.p.log,
            self._approvals,
            by=self.instance,
            hears=lambda: self._is_new,
            stamp=lambda: self.clock().isoformat(timespec="milliseconds"),
            publish=self.publish,
            log=self.log,
        )
        self._goals = Goals(self.memory)
        self._going: tuple[str, ...] | None = None  # rooms that what is passed on may go through
        self._near = 0  # messages in a row that show something too near
        self._cancelling = 0  # the mission that is being cancelled; 0: none
        self._unanswered = 0  # cancellations in a row
        self._to_go_m, self._started = inf, 0.0
        self._driven_at = inf  # s; since when something is driven for a client, as far as is seen
        self._other_at = -inf  # s; when another assistant last published its policy
        self._ended = 0  # the last mission whose end was noted
        self._warned = False  # that the robot's sonars do not suit the policy

    def _load(self) -> None:
        """Read the policy. What is wrong with it is kept: nothing is allowed then."""
        try:
            world = load_world(self.p.world) if self.p.world and self.p.policy else None
            if self.p.policy:
                self._policy = load(find("policies", self.p.policy), world)
        except ConfigError as error:
            self._misread = f"the policy cannot be used, so nothing is allowed: {error}"

    @property
    def _fault(self) -> str:
        """Why nothing is allowed; "" if that is not so."""
        log = self._book.fault
        return self._misread or (f"nothing is allowed: {log}" if log else "")

    def _look_at_clock(self) -> None:
        """End a mission whose hours are over, or that this agent cannot watch."""
        if (driven := self._driven) is not None:
            trajectory, rules = driven
            self._driven_at = min(self._driven_at, self.now)
            if why := self._lapsed or rules.closed(self.clock()):
                self._end(trajectory, why)

    @property
    def _scene(self) -> Scene:
        body = self.latest(Description)
        known = self.fresh(Pose), self.fresh(RobotState), self.fresh(Obstacles)
        return Scene(body, *known, to_go_m=self._to_go_m)

    @property
    def _learns(self) -> bool:
        """Whether this agent has started and has not received yet what it needs."""
        return bool(self._scene.unknown) and self._is_new

    @property
    def _is_new(self) -> bool:
        return self.now - self._started < LEARN_S

    def _rules_of(self, trajectory: Trajectory) -> Rules | None:
        """The rules of the client that a path is driven for; None: for none of them."""
        terms = trajectory.terms
        if terms is None or terms.guard != self.name or not trajectory.waypoints:
            return None
        return self._policy.of(client_in(terms.by))

    @property
    def _driven(self) -> tuple[Trajectory, Rules] | None:
        """The path that is driven for a client now, and the client's rules."""
        trajectory = self.memory.newest(Trajectory)
        rules = None if trajectory is None else self._rules_of(trajectory)
        return None if trajectory is None or rules is None else (trajectory, rules)

    @property
    def _lapsed(self) -> str:
        """Why this agent can watch no mission, so that each one ends; "" if it can.

        An agent that came back without its policy does not know what the mission has to keep,
        unless another one is alive that does.
        """
        heard = self.now - self._driven_at >= BESIDE_S  # enough to hear of another one
        unknown = self._policy is NO_POLICY and heard and not self._beside
        return self._fault or (UNKNOWN if unknown else "")

    @property
    def _beside(self) -> str:
        """Why another assistant agent answers and watches; "" if none with a policy is alive.

        Two are alive at the same time where the network was divided, until one has left.
        """
        there = self._policy is NO_POLICY and self.now - self._other_at < BESIDE_S
        return BESIDE if there else ""

    def on_approvals(self, approvals: Approvals) -> None:
        """Note that another assistant agent has a policy."""
        if approvals.policy:
            self._other_at = self.now

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Judge each path that is driven for a client, also one that was planned under way."""
        rules = self._rules_of(trajectory)
        if rules is None:
            self._near, self._unanswered, self._driven_at = 0, 0, inf
            return
        self._driven_at = min(self._driven_at, self.now)
        if self._learns and not self._lapsed:
            return
        path = [(at.x, at.y) for at in trajectory.waypoints[trajectory.leg :]]
        why = (
            self._lapsed
            or self._scene.strays(rules, path)
            or self._unapproved(trajectory, rules, path)
        )
        if why:
            self._end(trajectory, why)

    def _unapproved(self, trajectory: Trajectory, rules: Rules, path: Sequence[Place]) -> str:
        """Why the rest of a path lacks a person's approval; "" if it does not."""
        if not rules.asks or self._scene.unknown:
            return self._scene.unknown if rules.asks else ""
        allowed = self._goals.allowed(trajectory, self._going or ())
        more = [room for room in self._scene.rooms_to_ask(rules, path) if room not in allowed]
        return f"the way leads through {', '.join(more)}, which nobody has approved" if more else ""

    def on_description(self, description: Description) -> None:
        """Warn once of a limit that the robot's sensors cannot keep without false alarms."""
        limited = any(rules.keeps_off for rules in self._policy.all)
        if limited and SONAR in description.sensors and not self._warned:
            self._warned = True
            self.log(line(f"this robot has sonars, and {BY_SONARS}"), WARNING)

    def on_pose(self, pose: Pose) -> None:  # noqa: ARG002 - the scene has it
        """End a mission before the robot leaves the area."""
        driven = self._driven
        if driven is None or self._learns:
            return
        trajectory, rules = driven
        if why := self._scene.left(rules):
            self._end(trajectory, why)

    def on_obstacles(self, obstacles: Obstacles) -> None:  # noqa: ARG002 - the scene has them
        """End a mission if something that may be a person is too near, and not an echo."""
        driven = None if self._learns else self._driven
        why = "" if driven is None else self._scene.crowded(driven[1])
        self._near = self._near + 1 if why else 0
        if driven is not None and self._near >= TOO_NEAR:
            self._end(driven[0], why)

    def on_mission_status(self, status: MissionStatus) -> None:
        """Note how a client's mission ended."""
        self._to_go_m = status.to_go if status.state is MissionState.DRIVING else inf
        ended = status.state in (MissionState.REACHED, MissionState.FAILED)
        by = self._goals.client_of(status.mission)
        if ended and by is not None and status.mission != self._ended:
            self._ended = status.mission
            self._book.write(status.outcome, by, why=status.note, mission=status.mission)

    def _end(self, trajectory: Trajectory, why: str) -> None:
        """Cancel the mission that is driven for a client, because it would leave the policy."""
        if self._cancelling:
            return
        self._cancelling = number = self._goals.number_of(trajectory)
        client = client_in(orderer(trajectory))
        if self._unanswered == 0:
            self.log(line(f"the mission for {client} is cancelled: {why}"), WARNING)
            self._book.write("cancelled", client, why=why, mission=number)

        def on_reply(reply: MissionReply | None) -> None:
            self._cancelling = 0
            self._unanswered += 1
            failed = reply is None or bool(reply.refusal)
            if failed and self._unanswered >= CANCELS and self.stopped is None:
                self._unanswered = 0
                self.latch(line(f"{BY}: nobody cancels: {why}")[:LONGEST_BY])

        cancel = MissionCancel(number, line(f"the policy: {why}")[:LABEL])
        self.query(cancel, on_reply, CANCEL_S)
