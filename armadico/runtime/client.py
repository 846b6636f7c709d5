"""A guest on the mesh: listen, ask, wait, send the robot somewhere, stop it; one thread.

For commands, notebooks and tests. Whoever is a guest has no token: agents do not see it, nobody
waits for it, and it decides nothing. `connect` is how a program of one's own comes to be one.
"""

from __future__ import annotations

import json
import math
import random
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TypeVar, cast

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
from armadico.mesh.base import Mesh
from armadico.mesh.endpoints import endpoints
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
from armadico.runtime.latch import Latching

M = TypeVar("M", bound=Message)
T = TypeVar("T")

AGAIN_S: Final = 0.1
"""A query without an alive answerer is repeated after this."""

QUIET_S: Final = 0.3
"""Without a new token for so long, all alive agents are taken to be known."""

FIND_S: Final = 3.0
"""How long an agent that takes missions is looked for."""

PLANNING_S: Final = 30.0
"""How long its answer may take once it is alive."""

POSE_S: Final = 1.0
"""How long the robot's pose is waited for, of which a goal without a heading takes its own."""

REFUSED_S: Final = 0.5
"""How long until a mission that was refused is asked for again, if it is."""

SILENCE_S: Final = 5.0
"""Without a mission status for so long, the agent that took the mission is gone."""

STOP_S: Final = 5.0
"""What finding the robot agent, its acknowledgement and braking may take: a Pioneer at full speed
brakes for 3 s."""

PRESS_S: Final = 0.1
"""How often a stop is published until it is acknowledged, and while that is looked at."""


def heading_to(x: float, y: float, pose: Pose | Waypoint | None) -> float:
    """The heading of a straight line from a robot's pose to a place (m), rad; 0 without a pose."""
    return 0.0 if pose is None else math.atan2(y - pose.y, x - pose.x)


@contextmanager
def connect(
    namespace: str | None = None,
    *,
    hosts: str | Path | None = None,
    connect: str | Sequence[str] = (),
) -> Iterator[Client]:
    """Be a guest in a society that is up, here or elsewhere, for as long as the block lasts.

        with armadico.connect() as guest:
            print(guest.agents())
            guest.goto(4.0, 2.0, math.pi / 2).wait()
            print(guest.latest(Pose))

    Leaving stops nobody: the robot drives on, and a stop stays latched.

    Args:
        namespace: Which robot; by default $ARMADICO_NAMESPACE, or robot1.
        hosts: A host table, its path or a shipped one's name; by default $ARMADICO_HOSTS, unless
            `connect` says where to look.
        connect: Where the robot's router is, such as tcp/192.168.1.5:7447; by default the table's,
            else this machine's.

    Raises:
        TopologyError: A namespace or an endpoint that cannot be one.
        ConfigError: A host table that cannot be used.
    """
    with endpoints(namespace, hosts=hosts, connect=connect).mesh() as mesh:
        yield Client(mesh)


class Client:
    """A guest on either mesh: it has no token, and agents do not see it.

    Everything happens on the thread that calls: what arrives is kept until somebody waits, or asks
    for the latest. Times are the mesh's, in s; poses are in metres and radians, in the world frame.
    """

    def __init__(self, mesh: Mesh, rng: random.Random | None = None) -> None:
        """Listen to tokens.

        Args:
            mesh: Where.
            rng: Draws the numbers of its orders; None: one of its own.
        """
        self.mesh = mesh
        self._rng = rng or random.Random()
        self.alive: set[tuple[str, str]] = set()  # (name, instance) of the tokens
        self.key = ""  # of the message that is being handed on
        self.ahead: dict[str, float] = {}  # s; by instance, of the clocks in cards
        self._inbox = Inbox(mesh)
        self._latest: dict[type[Message], tuple[Message, float]] = {}
        self._listened: set[type[Message]] = set()
        self._handing_on = 0  # within a wait, messages are handed on one by one
        self._changed_at = self.mesh.now()
        mesh.watch_alive(self._token)

    def listen(
        self, *kinds: type[Message], then: Callable[[Message, float], None] | None = None
    ) -> None:
        """Keep the latest message of each kind; `then` is shown each one, and when it came (s).

        `then` is called while this thread waits, and told the time of a clock that only counts.
        """
        for kind in kinds:
            if then is not None or kind not in self._listened:
                self._listened.add(kind)
                self._listen(kind, then)

    def latest(self, kind: type[M], timeout: float = 0.0) -> M | None:
        """The newest message of a kind; it is listened for from the first call on.

        None if none has come. The first may be waited for, `timeout` s at most:

            pose = guest.latest(Pose, timeout=2.0)
        """
        self.listen(kind)
        if not self._handing_on:
            self._catch_up()
            self.wait_for(lambda: kind in self._latest, timeout)
        message, _ = self._latest.get(kind, (None, 0.0))
        return cast("M | None", message)

    def age(self, kind: type[Message]) -> float:
        """Seconds since the newest message of a kind came; infinite if none did."""
        found = self._latest.get(kind)
        return float("inf") if found is None else self.mesh.now() - found[1]

    def fresh(self, kind: type[M]) -> M | None:
        """The newest message of a kind, while it tells of now by its row of the services."""
        message = self.latest(kind)
        return message if self.age(kind) <= service_of(kind).tells_s else None

    def publish(self, message: Message) -> None:
        """Publish a message on its service's key. MessageError if it could not be decoded."""
        self.mesh.publish(service_of(type(message)).key, message)

    def wait_for(self, condition: Callable[[], T | None], timeout: float) -> T | None:
        """What a condition gives as soon as that is true, asked after everything that arrives.

        Returns its last value if that does not happen within `timeout` (s):

            guest.listen(RobotState)
            guest.wait_for(lambda: (s := guest.latest(RobotState)) and s.v > 0.3, timeout=10.0)
        """
        deadline = self.mesh.now() + timeout
        self._handing_on += 1
        try:
            while not (value := condition()):
                left = deadline - self.mesh.now()
                if left <= 0:
                    return value
                self._dispatch(left)
        finally:
            self._handing_on -= 1
        return value

    def ask(
        self, request: Message, timeout: float = 5.0, patience: float | None = None
    ) -> Message | None:
        """The first answer to a query; None if nobody gave one within `timeout` (s).

            plan = guest.ask(PlanRequest(start=Waypoint(0, 0, 0), goal=Waypoint(4, 2, 0)))

        Without an alive answerer it queries again, since links come up in the background;
        for `patience` s at most, if that is given. Raises TypeError for what is no query.
        """
        service = service_of(type(request))
        if service.reply is None:
            raise TypeError(f"{service.key} is not a query")
        begun = self.mesh.now()
        while (gone := self.mesh.now() - begun) < timeout:
            replies = self._ask(service.key, request, service.reply, timeout - gone, enough=1)
            if replies:
                return next(iter(replies.values()))
            if patience is not None and self.mesh.now() - begun >= patience:
                return None
            self.wait_for(lambda: None, AGAIN_S)
        return None

    # The robot ------------------------------------------------------------------------------------

    def goto(
        self,
        x: float,
        y: float,
        theta: float | None = None,
        *,
        direct: bool = False,
        start: tuple[float, float, float] | None = None,
    ) -> Mission:
        """Send the robot to a pose (m, m, rad); returns as soon as the mission is accepted.

            mission = guest.goto(4.0, 2.0, math.pi / 2)
            mission.wait(timeout=60.0)

        Without a heading the robot is to look from where it is now towards the goal. The way is the
        path planner's, unless it is to be `direct`. `start` tells the robot where it stands now (m,
        m, rad), if that is known better than by its pose.

        Raises:
            AbsentError: There is no interface agent.
            MissionRefusedError: It says why not: no way, no pose, the robot is stopped.
            MessageError: A pose that is no place.
        """
        self.listen(MissionStatus, RobotState)
        here = None if start is None else Waypoint(*start[:2], math.remainder(start[2], math.tau))
        if theta is None:
            theta = heading_to(x, y, here or self.latest(Pose, POSE_S))
        goal = Waypoint(x, y, math.remainder(theta, math.tau))
        request = MissionRequest(goal, planned=not direct, start=here)
        return Mission(self, self.hand_over(request))

    def hand_over(
        self,
        request: Order,
        *,
        find: float = FIND_S,
        again: float = 0.0,
    ) -> MissionReply:
        """Have a mission taken on, or an exploration.

        Args:
            request: What is to be driven.
            find: How long somebody who takes it is looked for, s.
            again: For so long it is asked for again if it is refused, s: among processes that have
                just started, links are coming up.

        Raises:
            AbsentError: There is no interface agent, or no explore agent.
            MissionRefusedError: It was refused; the reason is the agent's.
        """
        until = self.mesh.now() + again
        while True:
            request = request.numbered(self._rng.getrandbits(63) or 1)
            begun = self.mesh.now()
            reply = self.ask(request, PLANNING_S, patience=find)
            if not isinstance(reply, MissionReply):
                withdrawal, what = request.withdrawal(), request.asks_for
                if withdrawal is not None:
                    key = service_of(type(withdrawal)).key
                    self._ask(key, withdrawal, MissionReply, AGAIN_S, enough=1)
                there = self.mesh.now() - begun < PLANNING_S
                answers = "is alive" if there else "answers"
                raise AbsentError(f"no agent that takes {what} {answers}", self.mesh.namespace)
            if not reply.refusal:
                return reply
            if self.mesh.now() >= until:
                raise MissionRefusedError(reply.refusal)
            self.wait_for(lambda: None, REFUSED_S)

    def stop(self, timeout: float = STOP_S, *, by: str = "a guest") -> None:
        """Stop the robot, whoever drives it; returns once it is latched and the wheels rest.

        It stays stopped until somebody releases it (`resume`), whoever leaves or restarts.

        Args:
            timeout: What finding the robot agent and braking may take, s.
            by: Who stops it, for people.

        Raises:
            AbsentError: No robot answers.
            StopError: It was not acknowledged, or the wheels still turn.
        """
        self._latch(stopped=True, by=by, timeout=timeout)

    def resume(
        self, timeout: float = STOP_S, *, by: str = "a guest", code: str | None = None
    ) -> None:
        """Release the stop, whoever pressed it; returns once the robot agent acknowledges it.

        Args:
            timeout: What finding the robot agent may take, s.
            by: Who releases it, for people.
            code: Of the only stop that is to be released (`Stop.code`).

        Raises:
            AbsentError: No robot answers.
            StopError: It was not acknowledged, or somebody has stopped the robot again meanwhile.
        """
        self._latch(stopped=False, by=by, timeout=timeout, code=code)

    # Who is alive ---------------------------------------------------------------------------------

    def agents(self) -> tuple[tuple[str, str], ...]:
        """Who is alive, as (name, instance); what they offer and hold is on their `cards`."""
        self.settle()
        return tuple(sorted(self.alive))

    def cards(self, timeout: float = 1.0) -> dict[tuple[str, str], Card | None]:
        """The cards of all alive agents; None for one that does not answer in time."""
        self.settle()
        everybody = CARD.key_for(name="*", instance="*")
        replies = self._ask(everybody, Ask(), Card, timeout, enough=len(self.alive))
        keys = {who: CARD.key_for(name=who[0], instance=who[1]) for who in sorted(self.alive)}
        return {who: _own(replies.get(key), who[1]) for who, key in keys.items()}

    def card(self, name: str, instance: str, timeout: float = 1.0) -> Card | None:
        """The card of one agent; None if it does not answer within `timeout` (s)."""
        key = CARD.key_for(name=name, instance=instance)
        return _own(self._ask(key, Ask(), Card, timeout, enough=1).get(key), instance)

    def request_card(
        self, name: str, instance: str, timeout: float, then: Callable[[Card | None], None]
    ) -> None:
        """Ask for the card of one agent, and go on: `then` gets it, or None, in a later wait."""
        key = CARD.key_for(name=name, instance=instance)
        answered: list[bool] = []

        def each(where: str, card: Card) -> None:
            if where == key and not answered:
                answered.append(True)
                then(_own(card, instance))

        def over() -> None:
            if not answered:
                then(None)

        self._put(key, Ask(), Card, timeout, each, over)

    # Parameters -----------------------------------------------------------------------------------

    def parameters(
        self, agent: str = "", timeout: float = 1.0
    ) -> dict[tuple[str, str], ParametersReply]:
        """What may be changed of agents while they are at work, and how it is set.

            guest.parameters("goto")

        Args:
            agent: Its name, or an instance's id or the beginning of one; empty: all that there are.
            timeout: How long they may take to answer, s.

        Returns:
            By (name, instance), of those that answer.

        Raises:
            AbsentError: There is no such agent.
        """
        asked = self._named(agent)
        return self._put_settings(ParametersRequest(), asked, timeout)

    def change(
        self,
        agent: str,
        values: Mapping[str, bool | float | str | None],
        *,
        by: str = "a guest",
        timeout: float = 2.0,
    ) -> ParametersReply:
        """Change parameters of an agent that is at work: all of them, or none.

            guest.change("goto", {"v_max": 0.4, "safety.margin_m": 0.1})

        Args:
            agent: As in `parameters`. What is set is the agent's: if there are several instances
                one is asked, and the others follow.
            values: By the parameters' names; None clears an optional one.
            by: Who changes them, for people.
            timeout: How long the agent may take to answer, s.

        Returns:
            All of its parameters that may be changed, as they are then.

        Raises:
            AbsentError: There is no such agent, or it does not answer.
            ParameterError: It refuses, and says what is right; or several agents are meant.
        """
        asked = self._named(agent)
        if len({name for name, _ in asked}) > 1:
            raise ParameterError(f"{agent!r} is the beginning of several: name one agent")
        asked = asked[:1]
        change = tuple(Setting(name, json.dumps(value)) for name, value in values.items())
        try:
            request = checked(ParametersRequest(change, by))
        except MessageError as error:
            raise ParameterError(f"{agent}: {error}") from None
        replies = self._put_settings(request, asked, timeout)
        if not replies:
            raise AbsentError(f"{asked[0][1]} does not answer", self.mesh.namespace)
        (reply,) = replies.values()
        if reply.refusal:
            raise ParameterError(f"{asked[0][0]}: {reply.refusal}")
        return reply

    def _named(self, agent: str) -> list[tuple[str, str]]:
        """Those alive that a name stands for. Raises AbsentError if it is nobody's."""
        self.settle()
        alive = sorted(self.alive)
        found = [who for who in alive if agent in ("", who[0])]
        found = found or [who for who in alive if who[1].startswith(agent)]
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
        replies = self._ask(key, request, ParametersReply, timeout, enough=len(keys))
        return {
            who: replies[key]
            for key, who in keys.items()
            if key in replies and replies[key].instance == who[1]
        }

    def settle(self, timeout: float = 2.0) -> None:
        """Wait until the links are up and no token has come or gone for a while."""

        def quiet() -> bool:
            return self.mesh.now() - self._changed_at >= QUIET_S

        deadline = self.mesh.now() + timeout
        while not quiet() and self.mesh.now() < deadline:
            self.wait_for(quiet, QUIET_S)

    # Inside --------------------------------------------------------------------------------------

    def _dispatch(self, timeout: float) -> bool:
        """Hand on the next that comes within `timeout` (s); whether there was one."""
        item = self._inbox.get(timeout)
        if item is not None:
            call, args = item
            call(*args)
        return item is not None

    def _catch_up(self) -> None:
        """Hand on what has come while nobody waited."""
        self._handing_on += 1
        try:
            while self._dispatch(0.0):
                pass
        finally:
            self._handing_on -= 1

    def _latch(self, *, stopped: bool, by: str, timeout: float, code: str | None = None) -> None:
        """Stop or release the robot. Raises AbsentError or StopError."""
        press = random.SystemRandom().getrandbits(63)
        latching = Latching(stopped=stopped, by=by, press=press, code=code)
        self.listen(RobotState)

        def over() -> bool:
            state = self.latest(RobotState)
            if state is not None:
                latching.on_robot_state(state, self.mesh.now())
            return latching.done or bool(latching.refusal)

        end = self.mesh.now() + timeout
        while not self.wait_for(over, 0.0) and self.mesh.now() < end:
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
        raise StopError(f"{what}: the robot agent did not go on saying so; it last said {still}")

    def _listen(self, kind: type[Message], then: Callable[[Message, float], None] | None) -> None:
        service = service_of(kind)

        def arrived(key: str, data: bytes) -> None:
            at = self.mesh.now()  # now, and not when somebody comes to look

            def deliver() -> None:
                message = self.mesh.read(kind, key, data)
                if message is not None:
                    self._latest[kind] = (message, at)
                    self.key = key
                    if then is not None:
                        then(message, at)

            self._inbox.put(key, deliver, keep=1 if service.kind is Kind.STATE else EVENTS)

        for row in rows_of(kind):
            self.mesh.subscribe(row.pattern, arrived)

    def _token(self, name: str, instance: str, there: bool) -> None:
        def deliver() -> None:
            who = (name, instance)
            if there != (who in self.alive):
                (self.alive.add if there else self.alive.discard)(who)
                self._changed_at = self.mesh.now()

        self._inbox.put(f"token/{instance}", deliver, keep=1)

    def _ask(
        self, key: str, request: Message, reply: type[M], timeout: float, enough: int
    ) -> dict[str, M]:
        """Replies by key, until there are enough, everybody has answered, or time is up."""
        replies: dict[str, M] = {}
        over: list[bool] = []
        self._put(key, request, reply, timeout, replies.__setitem__, lambda: over.append(True))
        self.wait_for(lambda: len(replies) >= enough or bool(over), timeout)
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
        """Put a query; each reply and its key, and then its end, are handed over while it waits."""

        def arrived(where: str, data: bytes) -> None:
            def deliver() -> None:
                message = self.mesh.read(reply, where, data)
                if message is not None:
                    each(where, message)
                    if isinstance(message, Card) and message.clock:
                        self.ahead[message.instance] = message.clock - time.time()

            self._inbox.put(f"reply/{where}", deliver)

        self.mesh.ask(key, request, timeout, arrived, lambda: self._inbox.put(f"over/{key}", over))


class Mission:
    """A goal that was taken on. The society drives there whether or not anybody looks.

    Attributes:
        number: Tells it from other missions.
        length: The way along its waypoints, m.
    """

    def __init__(self, client: Client, reply: MissionReply) -> None:
        self.number = reply.mission
        self.length = reply.length
        self._client = client

    @property
    def status(self) -> MissionStatus | None:
        """The interface agent's newest report on it; None if there is none, or on another one."""
        status = self._client.latest(MissionStatus)
        return status if status is not None and status.mission == self.number else None

    @property
    def reached(self) -> bool:
        """Whether the mission's status is reached: the robot is at the goal, its wheels at rest."""
        status = self.status
        return status is not None and status.state is MissionState.REACHED

    @property
    def failed(self) -> str | None:
        """Why the mission was given up; None if it was not."""
        status = self.status
        return status.note if status is not None and status.state is MissionState.FAILED else None

    @property
    def to_go(self) -> float | None:
        """The way that is left along its waypoints, m; None if that is not known."""
        status = self.status
        return None if status is None else status.to_go

    def wait(
        self, timeout: float | None = None, progress: Callable[[Mission], None] | None = None
    ) -> bool:
        """Until the goal is reached, `timeout` s at the most; whether it is.

        The mission goes on if it is not, unless it has `failed`. `progress` is called about ten
        times a second.

        Raises:
            AbsentError: No status of the mission has been received for 5 s.
            MissionReplacedError: Somebody has sent the robot elsewhere.
        """
        client = self._client
        begun = client.mesh.now()
        while not self.reached:
            elapsed = client.mesh.now() - begun
            if min(client.age(MissionStatus), elapsed) > SILENCE_S:
                raise AbsentError("nothing more is heard of the mission", client.mesh.namespace)
            if self.status is None and elapsed > SILENCE_S:
                raise MissionReplacedError("another mission has taken this one's place")
            if self.failed is not None or (timeout is not None and elapsed > timeout):
                return False
            if progress is not None and self.status is not None:
                progress(self)
            client.wait_for(lambda: None, AGAIN_S)
        return True


def _own(card: Card | None, instance: str) -> Card | None:
    """A card, if it is the instance's own: nobody speaks for others."""
    return card if card is not None and card.instance == instance else None
