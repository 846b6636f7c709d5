"""Between the robots' meshes and the browsers: one thread, woken by what comes from either.

A guest on each mesh: it has no token and answers nothing, agents do not see it, and what it does
not read in time is dropped at its own link. So whether it runs, hangs or is killed nobody feels; a
hand's stick falls silent with it, and its agent lets go.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol

import msgspec

from armadico.core.mailbox import EVENTS
from armadico.core.messages import Ask, Message, ParametersRequest
from armadico.core.services import BIDS, CARD, Kind, Service, service_at, service_of
from armadico.gateways.page.model import Robot, reader
from armadico.gateways.page.part import Publish, Put, Spawn, Tell
from armadico.gateways.page.requests import Asked, RequestError
from armadico.mesh.base import Mesh, Receiver
from armadico.observe.watching import ASK_S, EVERYTHING, Heard, read_or_none
from armadico.runtime.inbox import Inbox

TURN_S: Final = 0.05
"""What is shown is looked at anew so often, s."""

TICK_S: Final = 0.5
"""And though nothing is otherwise, so often."""

TUNED_S: Final = 5.0
"""While somebody looks everybody is asked for bids and cards each `ASK_S`, and for parameters so
often, s; changes of these are published besides."""

CARDS_S: Final = 0.8
"""What their answers may take."""


Spawns = Callable[[str, str], str]
"""Starts an agent for a namespace, and returns at once: why it cannot, or nothing."""


class Browsers(Protocol):
    """Where things are shown; called on the session's thread."""

    def ready(self, browser: str) -> bool:
        """Whether it has read what it was shown: who is slow is shown the newest only."""

    def send(self, browser: str, data: bytes) -> None:
        """Show it something, a JSON object."""

    def tell(self, browser: str, data: bytes) -> None:
        """Answer it; answers are not left out."""


class Session:
    """Several robots, and all who look at them."""

    def __init__(
        self, robots: Mapping[str, Robot], meshes: Sequence[Mesh], spawn: Spawns | None = None
    ) -> None:
        """Listen; the meshes have been opened, one for each robot's namespace.

        `spawn` starts the robots' helpers.
        """
        self.robots = dict(robots)
        self.browsers: Browsers | None = None
        self._meshes = {mesh.namespace: mesh for mesh in meshes}
        self._time = meshes[0]
        self._spawn = spawn
        self._reader = reader()
        self._inbox = Inbox(meshes[0])
        self._shown: dict[str, dict[tuple[str, str], bytes]] = {}
        self._show_at = self._ask_at = self._tuned_at = self._tick_at = self._time.now()
        for namespace, mesh in self._meshes.items():
            self._listen(self.robots[namespace], mesh)

    # Called from any thread ----------------------------------------------------------------------

    def came(self, browser: str) -> None:
        self._inbox.put(f"browser {browser}", self._came, browser)

    def said(self, browser: str, data: str | bytes) -> None:
        """A browser has said something."""
        self._inbox.put(f"browser {browser}", self._said, browser, data)

    def left(self, browser: str) -> None:
        self._inbox.put(f"browser {browser}", self._left, browser)

    def ring(self) -> None:
        """Have a turn end soon."""
        self._inbox.ring()

    # Its own thread ------------------------------------------------------------------------------

    def turn(self, timeout: float = TURN_S) -> None:
        """Do what comes within `timeout` (s), and show what it has come to."""
        now = self._time.now()
        end = now + timeout
        while (left := min(end, self._show_at) - now) > 0.0:
            item = self._inbox.get(left)
            if item is not None:
                call, args = item
                call(*args)
                self._flush()
            now = self._time.now()
        for robot in self.robots.values():
            robot.wake(now)
        self._flush()
        if now >= self._ask_at:
            self._ask_at = now + ASK_S
            for robot in self.robots.values():
                self._ask_everybody(robot, now)
            if now >= self._tuned_at:
                self._tuned_at = now + TUNED_S
        if now >= self._show_at:
            self._show_at = now + TURN_S
            self._send_changes(now)

    def _came(self, browser: str) -> None:
        """It is shown at once what does not change, and the way that was driven."""
        self._shown[browser] = {}
        self._tuned_at = self._time.now()
        still = {ns: robot.fixed | {"trail": robot.trail} for ns, robot in self.robots.items()}
        hello = {"type": "hello", "you": browser, "robots": still, "t": self._time.now()}
        self._tell(browser, hello)

    def _left(self, browser: str) -> None:
        self._shown.pop(browser, None)
        for robot in self.robots.values():
            robot.leave(browser)

    def _said(self, browser: str, data: str | bytes) -> None:
        """Do what a browser asks for, or say why not."""
        number = -1
        try:
            request = self._reader.read(data)
            number = request.id
            self._robot(request).request(browser, request, self._time.now())
        except RequestError as error:
            number = max(number, error.id)
            self._tell(browser, _answer(Tell(browser, number, False, str(error))))

    def _robot(self, request: Asked) -> Robot:
        robot = self.robots.get(request.robot)
        if robot is None:
            raise RequestError(f"there is no robot {request.robot!r} here")
        return robot

    def _flush(self) -> None:
        for namespace, robot in self.robots.items():
            for out in robot.drain():
                match out:
                    case Publish(message):
                        mesh = self._meshes[namespace]
                        mesh.publish(service_of(type(message)).key, message)
                    case Put():
                        self._put(robot, self._meshes[namespace], out)
                    case Spawn():
                        self._tell(out.browser, _answer(self._spawned(namespace, out)))
                    case Tell():
                        self._tell(out.browser, _answer(out))

    def _spawned(self, namespace: str, what: Spawn) -> Tell:
        assert self._spawn is not None, "robots have helpers where somebody starts them"
        fault = self._spawn(namespace, what.agent)
        said = fault or f"{what.agent} is started beside the page"
        return Tell(what.browser, what.id, not fault, said)

    def _send_changes(self, now: float) -> None:
        """To each browser that has read the last what is otherwise since then."""
        if self.browsers is None or not self._shown:
            return
        encoded = {
            (namespace, part): msgspec.json.encode(value)
            for namespace, robot in self.robots.items()
            for part, value in robot.parts(now).items()
        }
        for browser, shown in self._shown.items():
            if not self.browsers.ready(browser):
                continue
            changed = {key: data for key, data in encoded.items() if shown.get(key) != data}
            if changed or now >= self._tick_at:  # a page that hears nothing says so
                shown.update(changed)
                self.browsers.send(browser, _state(changed, now))
        if now >= self._tick_at:
            self._tick_at = now + TICK_S

    def _tell(self, browser: str, what: Mapping[str, Any]) -> None:
        if self.browsers is not None and browser in self._shown:
            self.browsers.tell(browser, msgspec.json.encode(what))

    # The mesh ------------------------------------------------------------------------------------

    def _listen(self, robot: Robot, mesh: Mesh) -> None:
        """To everything: why the robot stands hangs on who has fallen silent, too."""
        mesh.subscribe(EVERYTHING, self._receiver(robot, asked=False))

        def changed(_name: str, instance: str, there: bool) -> None:
            at = self._time.now()
            key = f"{robot.namespace} token/{instance}"
            self._inbox.put(key, lambda: robot.token(instance, there=there, t=at), keep=1)

        def reached(there: bool) -> None:
            at = self._time.now()
            key = f"{robot.namespace} router"
            self._inbox.put(key, lambda: robot.router(there=there, t=at), keep=1)

        mesh.watch_alive(changed)
        mesh.watch_router(reached)

    def _receiver(self, robot: Robot, *, asked: bool) -> Receiver:
        def arrived(key: str, data: bytes) -> None:
            at = self._time.now()

            def deliver() -> None:
                message = read_or_none(Heard(robot.namespace, key, data, 0))
                robot.receive(key, message, at, asked=asked)

            service = service_at(key)
            events = service is not None and service.kind is Kind.EVENT
            self._inbox.put(f"{robot.namespace} {key}", deliver, keep=EVENTS if events else 1)

        return arrived

    def _ask_everybody(self, robot: Robot, now: float) -> None:
        """For cards, bids and parameters; nobody is asked while nobody looks."""
        if not self._shown:
            return
        mesh, receiver = self._meshes[robot.namespace], self._receiver(robot, asked=True)
        questions: list[tuple[Service, Message]] = [(CARD, Ask()), (BIDS, Ask())]
        if now >= self._tuned_at:
            questions.append((service_of(ParametersRequest), ParametersRequest()))
        for service, question in questions:
            mesh.ask(service.pattern, question, CARDS_S, receiver, lambda: None)

    def _put(self, robot: Robot, mesh: Mesh, put: Put) -> None:
        lane = f"{robot.namespace} answer {put.number}"

        def arrived(key: str, data: bytes) -> None:
            def deliver() -> None:
                message = mesh.read(put.reply, key, data)
                if message is not None:
                    robot.answered(put.number, message)

            self._inbox.put(lane, deliver)

        def over() -> None:
            self._inbox.put(lane, robot.answered, put.number, None)

        mesh.ask(put.key, put.message, put.timeout, arrived, over)


def _answer(tell: Tell) -> dict[str, Any]:
    found = {"type": "answer", "id": tell.id, "ok": tell.ok, "text": tell.text}
    return found | {"over": tell.over}


def _state(changed: Mapping[tuple[str, str], bytes], now: float) -> bytes:
    """What is otherwise, by robot and part; each part has been encoded once for all browsers."""
    robots: dict[str, list[bytes]] = {}
    for (namespace, part), data in changed.items():
        pair = msgspec.json.encode(part) + b":" + data
        robots.setdefault(namespace, []).append(pair)
    parts = [msgspec.json.encode(ns) + b":{" + b",".join(p) + b"}" for ns, p in robots.items()]
    t = msgspec.json.encode(round(now, 2))
    return b'{"type":"state","t":' + t + b',"robots":{' + b",".join(parts) + b"}}"
