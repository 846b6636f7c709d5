"""A guest on the mesh: subscribe, query, wait, send the robot to a goal, stop it; one thread.

For commands, notebooks and tests. A guest has no token: agents do not see it, no agent waits for
it, and it decides nothing. A program becomes a guest by `connect`.
"""

from __future__ import annotations

import json
import math
import random
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar, cast

from armadico.agents.interface.messages import NEAR_M, MissionCancel
from armadico.config.endpoints import endpoints
from armadico.core.errors import no_such
from armadico.core.mailbox import EVENTS
from armadico.core.messages import (
    Ask,
    Card,
    Message,
    MessageError,
    ParametersReply,
    ParametersRequest,
    RobotState,
    Setting,
    checked,
)
from armadico.core.services import CARD, Kind, rows_of, service_of
from armadico.core.unseen import Rule
from armadico.launch.latch import Latching
from armadico.mesh.base import Mesh, asked_on, publish
from armadico.mobile.errand import Order
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Pose,
    Waypoint,
)
from armadico.runtime.errors import (
    AbsentError,
    MissionRefusedError,
    MissionReplacedError,
    ParameterError,
    StopError,
)
from armadico.runtime.inbox import Inbox

M = TypeVar("M", bound=Message)
T = TypeVar("T")

AGAIN_S: Final = 0.1  # pause before a query without a reply is repeated, s
QUIET_S: Final = 0.3  # all agents count as known after this time without a change of a token, s
FIND_S: Final = 3.0  # how long an agent that accepts missions is sought, s
PLANNING_S: Final = 30.0  # timeout of its reply, which includes planning, s
POSE_S: Final = 1.0  # timeout for the robot's pose, needed for a goal without a heading, s
REFUSED_S: Final = 0.5  # pause before a refused mission is requested again, s
SILENCE_S: Final = 5.0  # timeout of the mission's status, after which its agent counts as gone, s
# Timeout of a stop: finding the robot agent, its acknowledgement and braking, s. A Pioneer at full
# speed brakes for 3 s.
STOP_S: Final = 5.0
PRESS_S: Final = 0.1  # period of publishing a stop, s
UNSEEN_S: Final = 0.5  # without a state of the robot for so long a stop is unconfirmed, s


def heading_to(x: float, y: float, pose: Pose | Waypoint | None) -> float:
    """Return the heading from a robot's pose to a place (m), rad; 0 without a pose.

    It is the robot's own heading at the place: there the direction would be that of an error.
    """
    if pose is None:
        return 0.0
    way = x - pose.x, y - pose.y
    return pose.theta if math.hypot(*way) <= NEAR_M else math.atan2(way[1], way[0])


@contextmanager
def connect(
    namespace: str | None = None,
    *,
    hosts: str | Path | None = None,
    connect: str | Sequence[str] = (),
) -> Iterator[Client]:
    """Join a running society, here or on another machine, as a guest for the block.

        with armadico.connect() as guest:
            print(guest.agents())
            guest.goto(4.0, 2.0, math.pi / 2).wait()
            print(guest.latest(Pose))

    Leaving changes nothing: the robot drives on, and a stop stays latched.

    Args:
        namespace: The robot's namespace; by default $ARMADICO_NAMESPACE, or robot1.
        hosts: A host table: its path or a shipped one's name; by default $ARMADICO_HOSTS, unless
            `connect` is given.
        connect: Endpoints of the robot's router, such as tcp/192.168.1.5:7447; by default the
            table's, else this machine's.

    Raises:
        TopologyError: An invalid namespace or endpoint.
        ConfigError: An invalid host table.
    """
    with endpoints(namespace, hosts=hosts, connect=connect).mesh() as mesh:
        yield Client(mesh)


class Client:
    """A guest on either mesh: it has no token, and agents do not see it.

    Everything runs on the calling thread: messages are queued until a method waits or gets the
    latest. Times are the mesh's, in s; poses are in metres and radians, in the world frame.
    """

    def __init__(self, mesh: Mesh, rng: random.Random | None = None) -> None:
        """Subscribe to tokens.

        Args:
            mesh: The mesh, joined or joining.
            rng: Draws the numbers of its orders; None: a new one.
        """
        self.mesh = mesh
        self._rng = rng or random.Random()
        self.alive: set[tuple[str, str]] = set()  # (name, instance) of the tokens
        self.key = ""  # of the message that is being delivered
        self.ahead: dict[str, float] = {}  # s; by instance, of the clocks in cards
        self._inbox = Inbox(mesh)
        self._latest: dict[type[Message], tuple[Message, float]] = {}
        self._subscribed: set[type[Message]] = set()
        self._delivering = 0  # depth of waits, which deliver messages one by one
        self._changed_at = self.mesh.now()
        mesh.watch_alive(self._token)

    def listen(
        self, *kinds: type[Message], then: Callable[[Message, float], None] | None = None
    ) -> None:
        """Subscribe to kinds and keep the latest message of each.

        `then` is called, while this thread waits, with each message and when it arrived (monotonic
        time, s).
        """
        for kind in kinds:
            if then is not None or kind not in self._subscribed:
                self._subscribed.add(kind)
                self._listen(kind, then)

    def latest(self, kind: type[M], timeout: float = 0.0) -> M | None:
        """Return the newest message of a kind, subscribed to at the first call; None without one.

        The first one may be waited for, at most `timeout` s:

            pose = guest.latest(Pose, timeout=2.0)
        """
        self.listen(kind)
        if not self._delivering:
            self.catch_up()
            self.wait_for(lambda: kind in self._latest, timeout)
        message, _ = self._latest.get(kind, (None, 0.0))
        return cast("M | None", message)

    def age(self, kind: type[Message]) -> float:
        """Return the age of the newest message of a kind, s; infinite without one."""
        found = self._latest.get(kind)
        return float("inf") if found is None else self.mesh.now() - found[1]

    def fresh(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind if it is fresh by its row of the services."""
        message = self.latest(kind)
        return message if self.age(kind) <= service_of(kind).stale_after_s else None

    def publish(self, message: Message) -> None:
        """Publish on the message's service keys. Raises MessageError if it cannot be decoded."""
        publish(self.mesh, message)

    def wait_for(self, condition: Callable[[], T | None], timeout: float) -> T | None:
        """Wait until a condition is true; it is checked after each arrival.

        Returns its value, or its last value after `timeout` (s):

            guest.listen(RobotState)
            guest.wait_for(lambda: (s := guest.latest(RobotState)) and s.v > 0.3, timeout=10.0)
        """
        deadline = self.mesh.now() + timeout
        self._delivering += 1
        try:
            while not (value := condition()):
                left = deadline - self.mesh.now()
                if left <= 0:
                    return value
                self._dispatch(left)
        finally:
            self._delivering -= 1
        return value

    def catch_up(self) -> None:
        """Deliver all queued arrivals."""
        self._delivering += 1
        try:
            while self._dispatch(0.0):
                pass
        finally:
            self._delivering -= 1

    def query(
        self, request: Message, timeout: float = 5.0, patience: float | None = None
    ) -> Message | None:
        """Send a query; return the first reply, or None after `timeout` (s).

            plan = guest.query(PlanRequest(start=Waypoint(0, 0, 0), goal=Waypoint(4, 2, 0)))

        Without a reply it queries again, as links come up in the background; for at most `patience`
        s, if given. Raises TypeError for a message that is no query.
        """
        key, reply = self._addressed(request)
        begun = self.mesh.now()
        while (gone := self.mesh.now() - begun) < timeout:
            replies = self._query(key, request, reply, timeout - gone)
            if replies:
                return next(iter(replies.values()))
            if patience is not None and self.mesh.now() - begun >= patience:
                return None
            self.wait_for(lambda: None, AGAIN_S)
        return None

    def begin_query(
        self, request: Message, timeout: float, then: Callable[[Message | None], None]
    ) -> None:
        """Send a query once; a later wait calls `then` with the first reply.

        It gets None if no reply arrives within `timeout` (s). Raises as `query`.
        """
        key, reply = self._addressed(request)
        answered: list[bool] = []

        def end(message: Message | None) -> None:
            if not answered:
                answered.append(True)
                then(message)

        self._put(key, request, reply, timeout, lambda _, found: end(found), lambda: end(None))

    # The robot ------------------------------------------------------------------------------------

    def goto(
        self,
        x: float,
        y: float,
        theta: float | None = None,
        *,
        direct: bool = False,
        start: tuple[float, float, float] | None = None,
        unseen: Rule | None = None,
        by: str = "a guest",
    ) -> Mission:
        """Send the robot to a pose (m, m, rad); return when the mission is accepted.

            mission = guest.goto(4.0, 2.0, math.pi / 2)
            mission.wait(timeout=60.0)

        Without `theta`, the heading is that of the line from the present pose to the goal, or the
        robot's own if it is there. The path is the planner's, or a straight line with `direct`.
        `start` sets the robot's present pose (m, m, rad), if it is known better than the robot
        estimates it. `unseen` is whether a path may lead through what nobody has seen, where no
        other leads to the goal; None: the planner's own rule. `by` is the person or program, for
        people.

        Raises:
            AbsentError: There is no interface agent.
            MissionRefusedError: With the reason: no path, no pose, the robot is stopped.
            MessageError: Invalid numbers.
        """
        self.listen(MissionStatus, RobotState)
        here = None if start is None else Waypoint(*start[:2], math.remainder(start[2], math.tau))
        if theta is None:
            theta = heading_to(x, y, here or self.latest(Pose, POSE_S))
        goal = Waypoint(x, y, math.remainder(theta, math.tau))
        request = MissionRequest(goal, planned=not direct, start=here, rule=unseen, by=by)
        return Mission(self, self.request_mission(request))

    def request_mission(
        self,
        request: Order,
        *,
        find: float = FIND_S,
        again: float = 0.0,
    ) -> MissionReply:
        """Request a mission or an exploration; return the acceptance.

        Args:
            request: The request.
            find: How long an agent that accepts it is sought, s.
            again: How long a refused request is repeated, s, as links may still be coming up.

        Raises:
            AbsentError: There is no interface agent, or no explore agent.
            MissionRefusedError: It was refused; the reason is the agent's.
        """
        until = self.mesh.now() + again
        while True:
            request = request.numbered(self._rng.getrandbits(63) or 1)
            begun = self.mesh.now()
            reply = self.query(request, PLANNING_S, patience=find)
            if not isinstance(reply, MissionReply):
                withdrawal, what = request.withdrawal(), request.kind_name
                if withdrawal is not None:
                    key = service_of(type(withdrawal)).key
                    self._query(key, withdrawal, MissionReply, AGAIN_S)
                there = self.mesh.now() - begun < PLANNING_S
                answers = "is alive" if there else "answers"
                raise AbsentError(f"no agent that takes {what} {answers}", self.mesh.namespace)
            if not reply.refusal:
                return reply
            if self.mesh.now() >= until:
                raise MissionRefusedError(reply.refusal)
            self.wait_for(lambda: None, REFUSED_S)

    def stop(
        self,
        timeout: float = STOP_S,
        *,
        by: str = "a guest",
        unseen: Callable[[], None] = lambda: None,
    ) -> None:
        """Stop the robot; return once the stop is latched and the wheels rest.

        It stays stopped until it is released (`resume`), also if processes end or restart.

        Args:
            timeout: The time for finding the robot agent and braking, s.
            by: The person or program, for people.
            unseen: Called once if no state of the robot arrives within `UNSEEN_S`.

        Raises:
            AbsentError: No robot answers.
            StopError: It was not acknowledged, or the wheels still turn.
        """
        self._latch(stopped=True, by=by, timeout=timeout, unseen=unseen)

    def resume(
        self, timeout: float = STOP_S, *, by: str = "a guest", code: str | None = None
    ) -> None:
        """Release the stop; return once the robot agent acknowledges it.

        Args:
            timeout: The time for finding the robot agent, s.
            by: The person or program, for people.
            code: The code of the only stop to release (`Stop.code`).

        Raises:
            AbsentError: No robot answers.
            StopError: It was not acknowledged, or the robot was stopped again.
        """
        self._latch(stopped=False, by=by, timeout=timeout, code=code)

    # Agents ---------------------------------------------------------------------------------------

    def agents(self) -> tuple[tuple[str, str], ...]:
        """Return the live agents as (name, instance); `cards` has what they offer and hold."""
        self.settle()
        return tuple(sorted(self.alive))

    def cards(self, timeout: float = 1.0) -> dict[tuple[str, str], Card | None]:
        """Return the cards of all live agents; None for an agent without a reply in time (s)."""
        self.settle()
        pattern = CARD.key_for(name="*", instance="*")
        keys = {
            (name, instance): CARD.key_for(name=name, instance=instance)
            for name, instance in sorted(self.alive)
        }
        replies = self._query(pattern, Ask(), Card, timeout, of=keys.values())
        return {agent: _own(replies.get(key), agent[1]) for agent, key in keys.items()}

    def card(self, name: str, instance: str, timeout: float = 1.0) -> Card | None:
        """Return the card of one agent; None without a reply within `timeout` (s)."""
        key = CARD.key_for(name=name, instance=instance)
        return _own(self._query(key, Ask(), Card, timeout).get(key), instance)

    # Parameters -----------------------------------------------------------------------------------

    def parameters(
        self, agent: str = "", timeout: float = 1.0
    ) -> dict[tuple[str, str], ParametersReply]:
        """Return the changeable parameters of running agents, with their values.

            guest.parameters("goto")

        Args:
            agent: A name, an instance's id or its beginning; empty: all agents.
            timeout: The timeout of the replies, s.

        Returns:
            The replies, by (name, instance); an agent that did not reply in time is left out.

        Raises:
            AbsentError: There is no such agent.
        """
        return self._put_settings(ParametersRequest(), self.named(agent), timeout)

    def change(
        self,
        agent: str,
        values: Mapping[str, bool | float | str | None],
        *,
        by: str = "a guest",
        timeout: float = 2.0,
    ) -> ParametersReply:
        """Change parameters of a running agent: all of them, or none.

            guest.change("goto", {"v_max": 0.4, "safety.margin_m": 0.1})

        Args:
            agent: As in `parameters`. All instances of the agent get the values.
            values: By the parameters' names; None clears an optional one.
            by: The person or program, for people.
            timeout: The timeout of the reply, s.

        Returns:
            All changeable parameters afterwards.

        Raises:
            AbsentError: There is no such agent, or it does not reply.
            ParameterError: The agent refused, with the allowed values; or several agents match.
        """
        agents = self.named(agent)
        if len({name for name, _ in agents}) > 1:
            raise ParameterError(f"{agent!r} is the beginning of several: name one agent")
        name, instance = agents[0]
        change = tuple(Setting(name, json.dumps(value)) for name, value in values.items())
        try:
            request = checked(ParametersRequest(change, by))
        except MessageError as error:
            raise ParameterError(f"{agent}: {error}") from None
        replies = self._put_settings(request, agents[:1], timeout)
        if not replies:
            raise AbsentError(f"{instance} does not answer", self.mesh.namespace)
        (reply,) = replies.values()
        if reply.refusal:
            raise ParameterError(f"{name}: {reply.refusal}")
        return reply

    def named(self, agent: str) -> list[tuple[str, str]]:
        """Return the live instances, with their names, that a name means; empty: all agents.

        Raises AbsentError if there is none.
        """
        self.settle()
        alive = sorted(self.alive)
        found = [each for each in alive if agent in ("", each[0])]
        found = found or [each for each in alive if each[1].startswith(agent)]
        if not found:
            names = sorted({name for name, _ in alive})
            raise AbsentError(no_such("live agent", agent, names))
        return found

    def _put_settings(
        self, request: ParametersRequest, to: Sequence[tuple[str, str]], timeout: float
    ) -> dict[tuple[str, str], ParametersReply]:
        service = service_of(ParametersRequest)
        keys = {service.key_for(name=name, instance=one): (name, one) for name, one in to}
        key = next(iter(keys)) if len(keys) == 1 else service.pattern
        replies = self._query(key, request, ParametersReply, timeout, of=keys)
        return {
            agent: replies[key]
            for key, agent in keys.items()
            if key in replies and replies[key].instance == agent[1]
        }

    def settle(self, timeout: float = 2.0) -> None:
        """Wait until the links are up and no token has changed for `QUIET_S`."""

        def quiet() -> bool:
            return self.mesh.now() - self._changed_at >= QUIET_S

        deadline = self.mesh.now() + timeout
        while not quiet() and self.mesh.now() < deadline:
            self.wait_for(quiet, QUIET_S)

    # Inside --------------------------------------------------------------------------------------

    def _dispatch(self, timeout: float) -> bool:
        """Deliver the next arrival within `timeout` (s); return whether there was one."""
        item = self._inbox.get(timeout)
        if item is not None:
            call, args = item
            call(*args)
        return item is not None

    def _latch(
        self,
        *,
        stopped: bool,
        by: str,
        timeout: float,
        code: str | None = None,
        unseen: Callable[[], None] | None = None,
    ) -> None:
        """Stop or release the robot. Raises AbsentError or StopError."""
        press = random.SystemRandom().getrandbits(63)
        latching = Latching(stopped=stopped, by=by, press=press, code=code)
        self.listen(RobotState)

        def over() -> bool:
            state = self.latest(RobotState)
            if state is not None:
                latching.on_robot_state(state, self.mesh.now())
            return latching.done or bool(latching.refusal)

        begun = self.mesh.now()
        end = begun + timeout
        while not self.wait_for(over, 0.0) and self.mesh.now() < end:
            if unseen is not None and self.mesh.now() - begun >= UNSEEN_S:
                if latching.known is None:
                    unseen()
                unseen = None
            message = latching.message()
            if message is not None:
                self.publish(message)
            self.wait_for(over, min(PRESS_S, max(end - self.mesh.now(), 0.0)))
        if latching.done:
            return
        if latching.refusal:
            raise StopError(f"the robot is not released: {latching.refusal}")
        if not stopped and latching.known is None:
            raise AbsentError(
                "no robot answers: nothing is known that could be released", self.mesh.namespace
            )
        if latching.latched:
            raise StopError(f"the stop is latched, and {latching.rolling}: look after the robot")
        what = f"the {'stop' if stopped else 'release'} was sent, not acknowledged"
        if latching.known is None:
            raise AbsentError(f"{what}: no robot answers", self.mesh.namespace)
        still = "stopped" if latching.known.stopped else "free to move"
        raise StopError(f"{what}: the robot agent's last state is {still}")

    def _listen(self, kind: type[Message], then: Callable[[Message, float], None] | None) -> None:
        service = service_of(kind)

        def arrived(key: str, data: bytes) -> None:
            at = self.mesh.now()  # of arrival, not of delivery

            def deliver() -> None:
                message = self.mesh.read(kind, key, data)
                if message is not None:
                    self._latest[kind] = (message, at)
                    self.key = key
                    if then is not None:
                        then(message, at)

            self._inbox.put(key, deliver, keep=1 if service.kind is Kind.STATE else EVENTS)

        for row in rows_of(kind):
            self.mesh.subscribe(row.heard, arrived)

    def _token(self, name: str, instance: str, there: bool) -> None:
        def deliver() -> None:
            agent = (name, instance)
            if there != (agent in self.alive):
                (self.alive.add if there else self.alive.discard)(agent)
                self._changed_at = self.mesh.now()

        self._inbox.put(f"token/{instance}", deliver, keep=1)

    def _addressed(self, request: Message) -> tuple[str, type[Message]]:
        """Return the key of a query, and the type of its reply. Raises TypeError."""
        service = service_of(type(request))
        if service.reply is None:
            raise TypeError(f"{service.key} is not a query")
        return asked_on(self.mesh, request), service.reply

    def _query(
        self, key: str, request: Message, reply: type[M], timeout: float, of: Iterable[str] = ()
    ) -> dict[str, M]:
        """Return replies by key: until those `of` some keys, all have replied, or the timeout (s).

        Without keys one reply is enough.
        """
        wanted = set(of)  # not their number: one that has just started may reply before them
        replies: dict[str, M] = {}
        over: list[bool] = []
        self._put(key, request, reply, timeout, replies.__setitem__, lambda: over.append(True))

        def whole() -> bool:
            return bool(over) or (wanted <= replies.keys() if wanted else bool(replies))

        self.wait_for(whole, timeout)
        return replies

    def _put(
        self,
        key: str,
        request: Message,
        reply: type[M],
        timeout: float,
        each: Callable[[str, M], None],
        over: Callable[[], None],
    ) -> None:
        """Send a query; waits call `each` with each reply and its key, and then `over`."""

        def arrived(where: str, data: bytes) -> None:
            def deliver() -> None:
                message = self.mesh.read(reply, where, data)
                if message is not None:
                    each(where, message)
                    if isinstance(message, Card) and message.clock:
                        self.ahead[message.instance] = message.clock - time.time()

            self._inbox.put(f"reply/{where}", deliver)

        self.mesh.query(
            key, request, timeout, arrived, lambda: self._inbox.put(f"over/{key}", over)
        )


class Mission:
    """An accepted goal. The society drives there also after the client has left.

    Attributes:
        number: Identifies the mission.
        length: The length of the path along its waypoints, m.
        unseen: Its parts where nobody has seen the map.
    """

    def __init__(self, client: Client, reply: MissionReply) -> None:
        self.number = reply.mission
        self.length = reply.length
        self.unseen = reply.unseen
        self._client = client

    @property
    def status(self) -> MissionStatus | None:
        """The newest status of this mission; None if there is none or it is another mission's."""
        status = self._client.latest(MissionStatus)
        return status if status is not None and status.mission == self.number else None

    @property
    def reached(self) -> bool:
        """Whether the mission has ended at its goal with the wheels at rest; see `doubt`."""
        status = self.status
        return status is not None and status.state is MissionState.REACHED

    @property
    def doubt(self) -> str:
        """By how much a robot that has reached the goal may be off it; "" within the tolerance."""
        status = self.status
        return "" if status is None else status.doubt

    @property
    def failed(self) -> str | None:
        """Why the mission failed; None if it did not."""
        status = self.status
        return status.note if status is not None and status.state is MissionState.FAILED else None

    @property
    def to_go(self) -> float | None:
        """The remaining length along its waypoints, m; None if unknown."""
        status = self.status
        return None if status is None else status.to_go

    def wait(
        self, timeout: float | None = None, progress: Callable[[Mission], None] | None = None
    ) -> bool:
        """Wait until the goal is reached, at most `timeout` s; return whether it is.

        After a timeout the mission goes on. `progress` is called about ten times a second.

        Raises:
            AbsentError: No status of the mission has been received for 5 s.
            MissionReplacedError: Another mission has replaced this one.
        """
        client = self._client
        begun = client.mesh.now()
        while not self.reached:
            elapsed = client.mesh.now() - begun
            if min(client.age(MissionStatus), elapsed) > SILENCE_S:
                raise AbsentError(
                    f"no status of the mission for {SILENCE_S:g} s", client.mesh.namespace
                )
            if self.status is None and elapsed > SILENCE_S:
                raise MissionReplacedError("another mission has replaced this one")
            if self.failed is not None or (timeout is not None and elapsed > timeout):
                return False
            if progress is not None and self.status is not None:
                progress(self)
            client.wait_for(lambda: None, AGAIN_S)
        return True

    def cancel(self, by: str = "a guest") -> None:
        """End the drive where the robot is, without a stop: the next goal may follow at once.

        Raises:
            AbsentError: There is no interface agent.
            MissionRefusedError: With the reason, such as that the goal is reached.
        """
        client = self._client
        reply = client.query(MissionCancel(self.number, by), PLANNING_S, patience=FIND_S)
        if not isinstance(reply, MissionReply):
            raise AbsentError("no agent that takes missions answers", client.mesh.namespace)
        if reply.refusal:
            raise MissionRefusedError(reply.refusal)


def _own(card: Card | None, instance: str) -> Card | None:
    """Return a card if it is the instance's own; an instance cannot reply for another one."""
    return card if card is not None and card.instance == instance else None
