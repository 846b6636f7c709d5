"""What people ask of one robot on its page, and what becomes of it (sans-IO).

Requests, answers, the robot's states and the time go in; `take` gives what is to be published,
asked and told. It decides nothing: a goal is a mission as anybody's, and a stop holds when the
robot says so.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import remainder, tau
from typing import Any, Final

from msgspec.structs import replace

from armadico.agents.missions.messages import MissionCancel, MissionOrder
from armadico.agents.supervision.messages import WakeupOrder, WakeupReply, WakeupRequest
from armadico.agents.teleop.messages import Stick
from armadico.core.messages import (
    Cycle,
    Message,
    ParametersReply,
    ParametersRequest,
    RobotState,
    Setting,
    Stop,
    plain,
)
from armadico.core.services import service_of
from armadico.gateways.page.known import Known
from armadico.gateways.page.requests import (
    Cancel,
    Goto,
    Halt,
    Hold,
    Order,
    Request,
    RequestError,
    Restart,
    Resume,
    Start,
    Tune,
    bits,
)
from armadico.mobile.messages import MissionReply, MissionRequest, Waypoint
from armadico.observe.view import agent_of
from armadico.runtime.client import PLANNING_S, PRESS_S, STOP_S, heading_to
from armadico.runtime.latch import Latching

ANSWER_S: Final = 10.0
"""What an answer to all but a goal may take."""

UNDER_WAY: Final = 8
"""Questions of one browser that may wait for one robot's answers."""

STICK_S: Final = 0.05
"""A browser's stick is passed on no oftener: the newest, or a flood would be one on the mesh."""


@dataclass(frozen=True)
class Publish:
    """A message to be published on its service's key."""

    message: Message


@dataclass(frozen=True)
class Put:
    """A query; what is answered goes to `Asked.answered` by its number."""

    number: int
    key: str
    message: Message
    reply: type[Message]
    timeout: float


@dataclass(frozen=True)
class Tell:
    """What came of a browser's request."""

    browser: str
    id: int
    ok: bool
    text: str
    over: bool = True
    """False: there is more to come of it."""


@dataclass(frozen=True)
class Spawn:
    """An agent is to be started here, beside the page."""

    browser: str
    id: int
    agent: str


Out = Publish | Put | Tell | Spawn


@dataclass(frozen=True)
class Shipped:
    """A mission that can be ordered by its name."""

    name: str
    title: str
    text: str


@dataclass
class _Waiting:
    """A question that is under way, and whose."""

    browser: str
    id: int
    done: Callable[[Message], tuple[bool, str]]


@dataclass
class Pressed:
    """A stop or a release that has not been acknowledged yet."""

    latching: Latching
    press: int
    stopped: bool
    since: float
    say_at: float
    whose: list[tuple[str, int]] = field(default_factory=list)


@dataclass
class _Hand:
    """A browser's, on the stick."""

    number: int = 0  # how often it has moved
    say_at: float = 0.0
    newest: Stick | None = None  # that waits until then


class Asked:
    """What has been asked for of one robot.

    Attributes:
        pressed: The stop, or the release, that the robot has not acknowledged yet.
    """

    def __init__(
        self, known: Known, missions: Mapping[str, Shipped], bits64: Callable[[], int]
    ) -> None:
        """Nothing was asked for yet; arguments as `Robot` has them."""
        self.pressed: Pressed | None = None
        self._known = known
        self._missions = missions
        self._draw = bits64
        self._out: list[Out] = []
        self._number = 0
        self._waiting: dict[int, _Waiting] = {}
        self._sticks: dict[str, _Hand] = {}  # by browser

    def ask(self, browser: str, request: Request, t: float) -> None:
        """A person asks for something. Raises RequestError if that cannot be asked for."""
        match request:
            case Halt():
                self._stop(browser, request.id, t)
            case Resume():
                self._resume(browser, request, t)
            case Goto():
                self._goto(browser, request)
            case Order():
                self._order(browser, request)
            case Cancel():
                cancel = MissionCancel(bits(request.mission), browser)
                self._put(browser, request.id, cancel, lambda _: "cancelled")
            case Restart():
                self._restart(browser, request, t)
            case Start():
                self._start(browser, request, t)
            case Tune():
                self._tune(browser, request)
            case Hold():
                self._hold(browser, request, t)

    def gone(self, browser: str) -> None:
        """A browser has gone: whatever its hand held it lets go of."""
        state = self._known.view.state
        if browser in self._sticks and state is not None:
            self._sticks[browser].newest = Stick(state.cycle, browser, 0, 0.0, 0.0, held=False)
            self._publish_stick(self._sticks[browser])
        self._sticks.pop(browser, None)

    def answered(self, number: int, message: Message | None) -> None:
        """What a question was answered; None: nothing, and nothing more will come."""
        waiting = self._waiting.pop(number, None)
        if waiting is None:
            return
        if message is None:
            self._tell(waiting.browser, waiting.id, False, "nobody answered")
        else:
            self._tell(waiting.browser, waiting.id, *waiting.done(message))

    def wake(self, t: float) -> None:
        """Do what is due by the time: an order to stop is repeated until it is acknowledged."""
        for hand in self._sticks.values():
            self._say_stick(hand, t)
        pressed = self.pressed
        if pressed is None:
            return
        if t >= pressed.say_at:
            self._press(pressed, t)
        late = t - pressed.since > STOP_S
        if late and not pressed.stopped:
            self._over(False, "the release was not acknowledged: nothing is heard of the robot")
        elif late:
            for browser, number in pressed.whose:
                said = "SENT, NOT ACKNOWLEDGED by the robot, and sent again until it is"
                self._tell(browser, number, False, said, over=False)
            pressed.whose = []

    def take(self) -> list[Out]:
        """What is to be published, asked and told, in this order; each once."""
        out, self._out = self._out, []
        return out

    def heard(self, state: RobotState, t: float) -> None:
        """The robot agent's newest state: what was pressed holds, or not, by its own word."""
        pressed = self.pressed
        if pressed is None:
            return
        pressed.latching.hear(state, t)
        if pressed.stopped:
            self._stopping(pressed, state.stop)
        elif pressed.latching.done:
            self._over(True, "released")
        elif pressed.latching.refusal:
            self._over(False, pressed.latching.refusal)

    def _stopping(self, pressed: Pressed, stop: Stop) -> None:
        if pressed.latching.done:
            self._over(True, "the robot is stopped, by its own word")
        elif not stop.stopped and stop.press == pressed.press:
            self._over(False, f"released meanwhile, by {stop.who}")

    # What is asked for ---------------------------------------------------------------------------

    def _stop(self, browser: str, number: int, t: float) -> None:
        pressed = self.pressed
        if pressed is None or not pressed.stopped:
            if pressed is not None:
                self._over(False, f"stopped again, by {browser}")
            press = self._draw()
            latching = Latching(stopped=True, by=browser, press=press)
            pressed = self.pressed = Pressed(latching, press, stopped=True, since=t, say_at=t)
            self._press(pressed, t)
        pressed.whose.append((browser, number))

    def _resume(self, browser: str, request: Resume, t: float) -> None:
        """Release the stop that was seen: one that was pressed since is another."""
        stop, pressed = self._known.view.stop, self.pressed
        if pressed is not None and pressed.stopped and not stop.stopped:
            self._over(False, f"given up, by {browser}: it was never acknowledged")
            self._tell(browser, request.id, True, "the order to stop is given up")
            return
        if not stop.stopped:
            raise RequestError("the robot is not stopped")
        if stop.press != bits(request.press):
            raise RequestError(f"it was stopped again meanwhile, by {stop.who}")
        if pressed is not None:
            self._over(False, f"released, by {browser}")
        latching = Latching(stopped=False, by=browser, press=0)
        assert self._known.view.state is not None, "it said who stopped it"
        latching.hear(self._known.view.state, t)
        self.pressed = Pressed(latching, stop.press, stopped=False, since=t, say_at=t)
        self.pressed.whose.append((browser, request.id))
        self._press(self.pressed, t)

    def _press(self, pressed: Pressed, t: float) -> None:
        message = pressed.latching.message()
        if message is not None:
            self._out.append(Publish(message))
        pressed.say_at = t + PRESS_S

    def _over(self, ok: bool, text: str) -> None:
        """What was pressed is acknowledged, or given up."""
        pressed, self.pressed = self.pressed, None
        for browser, number in () if pressed is None else pressed.whose:
            self._tell(browser, number, ok, text)

    def _goto(self, browser: str, request: Goto) -> None:
        theta = request.theta
        if theta is None:
            theta = heading_to(request.x, request.y, self._known.view.pose)
        goal = Waypoint(request.x, request.y, remainder(theta, tau))

        def said(reply: MissionReply) -> str:
            stop = ", once the stop is released" if self._known.view.stop.stopped else ""
            return f"on its way{stop}: {reply.length:.1f} m to go"

        self._put(browser, request.id, MissionRequest(goal), said, PLANNING_S)

    def _order(self, browser: str, request: Order) -> None:
        shipped = self._missions.get(request.mission)
        if shipped is None:
            raise RequestError(f"there is no mission {request.mission!r}")
        packed = zlib.compress(shipped.text.encode())
        order = MissionOrder(shipped.name, packed, None, browser)
        self._put(browser, request.id, order, lambda _: f"{shipped.name} is ordered")

    def _restart(self, browser: str, request: Restart, t: float) -> None:
        """By the wakeup agent that keeps it up: nobody else may end a process."""
        kept = [each for each in self._known.kept(t) if each.agent == request.agent]
        chosen = next((each for each in kept if each.pid == request.pid), None)
        if chosen is None:
            raise RequestError(
                f"nobody keeps {request.agent} up, so nobody would start it again: that is done by"
                " `armadico up`"
            )
        order = WakeupRequest(WakeupOrder.RESTART, request.agent, chosen.pid, f"asked by {browser}")
        key = service_of(WakeupRequest).key_for(instance=chosen.wakeup)
        done = f"{request.agent} is restarted"
        self._put(browser, request.id, order, lambda _: done, key=key)

    def _start(self, browser: str, request: Start, t: float) -> None:
        wakeup = self._known.could(t).get(request.agent)
        if wakeup is None:
            raise RequestError(
                f"no host says that it could start {request.agent}; `armadico-agent"
                f" {request.agent}` does so by hand"
            )
        if not wakeup:
            self._out.append(Spawn(browser, request.id, request.agent))
            return
        order = WakeupRequest(WakeupOrder.START, request.agent, 0, f"asked by {browser}")
        key = service_of(WakeupRequest).key_for(instance=wakeup)
        done = f"{request.agent} is started"
        self._put(browser, request.id, order, lambda _: done, key=key)

    def _tune(self, browser: str, request: Tune) -> None:
        """Whether it is in its range the agent says, and why not."""
        instance = request.instance
        if instance not in self._known.view.alive:
            raise RequestError(f"{instance} is not alive")
        names = {"name": agent_of(instance), "instance": instance}
        key = service_of(ParametersRequest).key_for(**names)
        change = ParametersRequest((Setting(request.name, request.json),), browser)

        def said(reply: ParametersReply) -> str:
            self._known.parameters[instance] = [*map(plain, reply.parameters)]
            return f"{agent_of(instance)}: {request.name} = {request.json}"

        self._put(browser, request.id, change, said, key=key)

    def _hold(self, browser: str, request: Hold, t: float) -> None:
        """Pass on where a stick is, with the cycle that its hand saw."""
        state = self._known.view.state
        if state is None:
            raise RequestError("nothing is heard of the robot")
        cycle = Cycle(state.cycle.epoch, min(request.cycle, state.cycle.number))
        hand = self._sticks.setdefault(browser, _Hand())
        hand.newest = Stick(cycle, browser, 0, request.v, request.w, request.held)
        self._say_stick(hand, t)

    def _say_stick(self, hand: _Hand, t: float) -> None:
        if hand.newest is not None and t >= hand.say_at:
            hand.say_at = t + STICK_S
            self._publish_stick(hand)

    def _publish_stick(self, hand: _Hand) -> None:
        assert hand.newest is not None, "there is one to be said"
        hand.number += 1
        self._out.append(Publish(replace(hand.newest, number=hand.number)))
        hand.newest = None

    def _put(
        self,
        browser: str,
        number: int,
        message: Message,
        said: Callable[[Any], str],
        timeout: float = ANSWER_S,
        key: str = "",
    ) -> None:
        if sum(each.browser == browser for each in self._waiting.values()) >= UNDER_WAY:
            raise RequestError("too much is asked for at once")
        service = service_of(type(message))
        assert service.reply is not None, "it is a question"

        def done(reply: Message) -> tuple[bool, str]:
            assert isinstance(reply, MissionReply | WakeupReply | ParametersReply)
            return (False, reply.refusal) if reply.refusal else (True, said(reply))

        self._number += 1
        self._waiting[self._number] = _Waiting(browser, number, done)
        put = Put(self._number, key or service.key, message, service.reply, timeout)
        self._out.append(put)

    def _tell(self, browser: str, number: int, ok: bool, text: str, *, over: bool = True) -> None:
        self._out.append(Tell(browser, number, ok, text, over))
