"""The page's own parts: goals, the stop, starting agents, and their parameters (sans-IO)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from math import remainder, tau

from armadico.core.membership import agent_of
from armadico.core.messages import (
    Message,
    ParameterChange,
    ParametersReply,
    ParametersRequest,
    RobotState,
    Setting,
    Stop,
    plain,
)
from armadico.core.services import service_of
from armadico.launch.client import PLANNING_S, PRESS_S, STOP_S, heading_to
from armadico.launch.latch import Latching
from armadico.mobile.messages import MissionReply, MissionRequest, Waypoint
from armadico.observe.jsons import JsonObject
from armadico.observe.page_part import Desk, Part
from armadico.observe.page_requests import Goto, Halt, RequestError, Resume, Start, Tune, bits


class Goals(Part):
    """Sends the robot to a place, as a mission."""

    requests = (Goto,)
    queries = (MissionRequest,)

    def request(self, browser: str, request: Goto, t: float) -> None:  # noqa: ARG002
        theta = request.theta
        if theta is None:
            theta = heading_to(request.x, request.y, self.view.pose)
        goal = Waypoint(request.x, request.y, remainder(theta, tau))

        def describe(reply: MissionReply) -> str:
            stop = ", starts when the stop is released" if self.view.stop.stopped else ""
            return f"goal accepted{stop}: {reply.length:.1f} m to go"

        self.desk.query(
            browser, request.id, MissionRequest(goal, by="the page"), describe, PLANNING_S
        )


@dataclass
class _Pressed:
    """A stop or a release that has not been acknowledged yet."""

    latching: Latching
    press: int
    stopped: bool
    since: float
    repeat_at: float
    requests: list[tuple[str, int]] = field(default_factory=list)


class StopLatch(Part):
    """Stops the robot and releases the stop; both are repeated until the robot acknowledges."""

    requests = (Halt, Resume)
    provides = (Stop,)

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._pressed: _Pressed | None = None

    def request(self, browser: str, request: Halt | Resume, t: float) -> None:
        if isinstance(request, Halt):
            self._stop(browser, request.id, t)
        else:
            self._resume(browser, request, t)

    def receive(self, key: str, message: Message, t: float) -> None:  # noqa: ARG002
        """Check in the robot's state whether the stop is latched or released."""
        pressed = self._pressed
        if pressed is None or not isinstance(message, RobotState):
            return
        pressed.latching.on_robot_state(message, t)
        if pressed.stopped:
            self._check_stop(pressed, message.stop)
        elif pressed.latching.done:
            self._close(True, "released")
        elif pressed.latching.refusal:
            self._close(False, pressed.latching.refusal)

    def wake(self, t: float) -> None:
        """Repeat an unacknowledged stop or release, and tell the browsers after `STOP_S`."""
        pressed = self._pressed
        if pressed is None:
            return
        if t >= pressed.repeat_at:
            self._press(pressed, t)
        late = t - pressed.since > STOP_S
        if late and not pressed.stopped:
            self._close(False, "the release was not acknowledged: no data from the robot")
        elif late:
            for browser, number in pressed.requests:
                text = "SENT, NOT ACKNOWLEDGED by the robot; it is repeated until acknowledged"
                self.desk.answer(browser, number, False, text, over=False)
            pressed.requests = []

    def show(self, parts: dict[str, object], t: float) -> None:
        """Add the stop; `held` only if a fresh robot state reports it."""
        stop, pressed = self.view.stop, self._pressed
        parts["stop"] = {
            "held": self.view.stopped(t) is True,
            "known": self.view.state is not None,
            "stopped": stop.stopped,
            "by": stop.by,
            "press": str(stop.press),
            "code": stop.code if stop.stopped else "",  # for programs, to confirm a release
            "asked": pressed is not None and pressed.stopped,
            "rolling": "" if pressed is None else pressed.latching.rolling,
        }

    def _check_stop(self, pressed: _Pressed, stop: Stop) -> None:
        if pressed.latching.done:
            self._close(True, "stopped, confirmed by the robot")
        elif not stop.stopped and stop.press == pressed.press:
            self._close(False, f"released meanwhile by {stop.requester}")

    def _stop(self, browser: str, number: int, t: float) -> None:
        pressed = self._pressed
        if pressed is None or not pressed.stopped:
            if pressed is not None:
                self._close(False, f"stopped again by {browser}")
            press = self.desk.bits64()
            latching = Latching(stopped=True, by=browser, press=press)
            if self.view.stopped(t) is not None:
                assert self.view.state is not None, "it is fresh"
                latching.on_robot_state(self.view.state, t)
            pressed = self._pressed = _Pressed(latching, press, True, since=t, repeat_at=t)
            self._press(pressed, t)
        pressed.requests.append((browser, number))

    def _resume(self, browser: str, request: Resume, t: float) -> None:
        """Release the stop that the browser has shown, and not a later one."""
        stop, pressed = self.view.stop, self._pressed
        if pressed is not None and pressed.stopped and not stop.stopped:
            self._close(False, f"cancelled by {browser}: the stop was never acknowledged")
            self.desk.answer(browser, request.id, True, "the unacknowledged stop is cancelled")
            return
        if not stop.stopped:
            raise RequestError("the robot is not stopped")
        if stop.press != bits(request.press):
            raise RequestError(
                f"the robot was stopped again by {stop.requester}; release that stop"
            )
        if pressed is not None:
            self._close(False, f"released by {browser}")
        latching = Latching(stopped=False, by=browser, press=0)
        assert self.view.state is not None, "it reported the stop"
        latching.on_robot_state(self.view.state, t)
        self._pressed = _Pressed(latching, stop.press, False, since=t, repeat_at=t)
        self._pressed.requests.append((browser, request.id))
        self._press(self._pressed, t)

    def _press(self, pressed: _Pressed, t: float) -> None:
        message = pressed.latching.message()
        if message is not None:
            self.desk.publish(message)
        pressed.repeat_at = t + PRESS_S

    def _close(self, ok: bool, text: str) -> None:
        """Answer all browsers: the stop or release is acknowledged, or has failed."""
        pressed, self._pressed = self._pressed, None
        for browser, number in () if pressed is None else pressed.requests:
            self.desk.answer(browser, number, ok, text)


class Starting(Part):
    """Starts agents: on a host that can, or beside the page."""

    requests = (Start,)

    def __init__(self, desk: Desk, helpers: Collection[str], parts: Sequence[Part]) -> None:
        """`helpers` can be started beside the page; `parts` start agents on hosts."""
        super().__init__(desk)
        self._helpers, self._parts = tuple(helpers), parts

    def request(self, browser: str, request: Start, t: float) -> None:
        agent = request.agent
        if agent not in self._missing(t):
            raise RequestError(f"no host can start {agent}; run `armadico-agent {agent}`")
        for part in self._parts:
            if agent in part.startable(t):
                part.start(browser, request, t)
                return
        self.desk.spawn(browser, request.id, agent)

    def show(self, parts: dict[str, object], t: float) -> None:
        parts["could"] = self._missing(t)

    def _missing(self, t: float) -> list[str]:
        names = {*self._helpers}.union(*(part.startable(t) for part in self._parts))
        return sorted(names - self.view.names)


class Parameters(Part):
    """Shows the agents' parameters and sets them; the agent checks the range."""

    requests = (Tune,)
    queries = (ParametersRequest,)

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._rows: dict[str, list[JsonObject]] = {}  # by instance

    def request(self, browser: str, request: Tune, t: float) -> None:  # noqa: ARG002
        instance = request.instance
        if instance not in self.view.alive:
            raise RequestError(f"{instance} is not alive")
        name = agent_of(instance)
        key = service_of(ParametersRequest).key_for(name=name, instance=instance)
        change = ParametersRequest((Setting(request.name, request.json),), browser)

        def describe(reply: ParametersReply) -> str:
            self._rows[instance] = [*map(plain, reply.parameters)]
            return f"{name}: {request.name} = {request.json}"

        self.desk.query(browser, request.id, change, describe, key=key)

    def receive(self, key: str, message: Message, t: float) -> None:  # noqa: ARG002
        """Process an agent's parameters, or a change of one by any client."""
        if isinstance(message, ParametersReply):
            self._rows[message.instance] = [*map(plain, message.parameters)]
        elif isinstance(message, ParameterChange):
            for row in self._rows.get(message.instance, ()):
                if row["name"] == message.name:
                    row["json"] = message.json

    def on_token(self, instance: str, *, there: bool) -> None:
        if not there:
            self._rows.pop(instance, None)

    def show(self, parts: dict[str, object], t: float) -> None:  # noqa: ARG002
        parts["parameters"] = [
            {"agent": agent.name, "instance": agent.instance, "rows": self._rows[agent.instance]}
            for agent in self.view.agents
            if self._rows.get(agent.instance)
        ]
