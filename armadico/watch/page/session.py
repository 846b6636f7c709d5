"""The session: one thread between the robots' meshes and the browsers.

On each mesh it has no liveliness token and answers no queries, so agents do not see it. Messages
that it does not read in time are dropped at its link. Agents are therefore not affected if it hangs
or is killed; only the stick times out, and the teleop agent releases the wheels.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Protocol

import msgspec

from armadico.core.mailbox import EVENTS
from armadico.core.messages import Ask, Message, ParametersRequest
from armadico.core.services import BIDS, CARD, Kind, Service, service_at, service_of
from armadico.mesh.base import Mesh, Receiver, asked_on, publish
from armadico.observe.page_part import Answer, Publish, Put, Spawn, Work
from armadico.observe.page_requests import Asked, RequestError
from armadico.observe.watching import EVERYTHING, QUERY_S, Received, read_or_none
from armadico.runtime.inbox import Inbox
from armadico.watch.page.model import Robot, reader

TURN_S: Final = 0.05  # interval at which changed data are sent to browsers
TICK_S: Final = 0.5  # interval at which the time is sent, also without changes

# While a browser is connected, bids and cards are queried each QUERY_S, and parameters at this
# interval. Changes of parameters are also published.
TUNED_S: Final = 5.0
CARDS_S: Final = 0.8  # timeout of these queries

LOOKING: Final = "that needs the token: open the link that `armadico page` prints"

# Starts an agent for a namespace and returns immediately: an error, or an empty text.
Spawns = Callable[[str, str], str]


class Browsers(Protocol):
    """The connected browsers; called on the session's thread."""

    def ready(self, browser: str) -> bool:
        """Whether a browser has received the last data; a slow one skips intermediate data."""

    def send(self, browser: str, data: bytes) -> None:
        """Send data to show, a JSON object."""

    def answer(self, browser: str, data: bytes) -> None:
        """Send an answer; answers are never skipped."""


class Session:
    """Several robots, and the browsers that show them."""

    def __init__(
        self, robots: Mapping[str, Robot], meshes: Sequence[Mesh], spawn: Spawns | None = None
    ) -> None:
        """Subscribe on open meshes, one for each robot's namespace; `spawn` starts helpers."""
        self.robots = dict(robots)
        self.browsers: Browsers | None = None
        self._meshes = {mesh.namespace: mesh for mesh in meshes}
        self._time = meshes[0]
        self._spawn = spawn
        self._working: set[str] = set()  # namespaces with work on a thread
        self._reader = reader()
        self._inbox = Inbox(meshes[0])
        self._driving: set[str] = set()  # browsers that may drive
        self._shown: dict[str, dict[tuple[str, str], bytes]] = {}
        self._show_at = self._query_at = self._tuned_at = self._tick_at = self._time.now()
        for namespace, mesh in self._meshes.items():
            self._listen(self.robots[namespace], mesh)

    # Called from any thread ----------------------------------------------------------------------

    def on_connect(self, browser: str, *, may: bool = True) -> None:
        """Show a browser the robots; it `may` drive them, or look and stop them alone."""
        self._inbox.put(f"browser {browser}", self._connected, browser, may)

    def on_message(self, browser: str, data: str | bytes) -> None:
        self._inbox.put(f"browser {browser}", self._received, browser, data)

    def on_disconnect(self, browser: str) -> None:
        self._inbox.put(f"browser {browser}", self._disconnected, browser)

    def ring(self) -> None:
        """Make a turn end soon."""
        self._inbox.ring()

    # Its own thread ------------------------------------------------------------------------------

    def turn(self, timeout: float = TURN_S) -> None:
        """Process inputs for `timeout` (s), then send changes to the browsers."""
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
        if now >= self._query_at:
            self._query_at = now + QUERY_S
            for robot in self.robots.values():
                self._query_agents(robot, now)
            if now >= self._tuned_at:
                self._tuned_at = now + TUNED_S
        if now >= self._show_at:
            self._show_at = now + TURN_S
            self._send_changes(now)

    def _connected(self, browser: str, may: bool) -> None:
        """Send the data that do not change, and the path driven so far."""
        self._shown[browser] = {}
        if may:
            self._driving.add(browser)
        self._tuned_at = self._time.now()
        still = {ns: robot.fixed | {"trail": robot.trail} for ns, robot in self.robots.items()}
        hello = {"type": "hello", "you": browser, "may": may, "robots": still}
        hello["t"] = self._time.now()
        self._send(browser, hello)

    def _disconnected(self, browser: str) -> None:
        self._shown.pop(browser, None)
        self._driving.discard(browser)
        for robot in self.robots.values():
            robot.leave(browser)

    def _received(self, browser: str, data: str | bytes) -> None:
        """Handle a browser's request, or answer why it is refused."""
        number = -1
        try:
            request = self._reader.read(data)
            number = request.id
            if browser not in self._driving and not request.free:
                raise RequestError(LOOKING)
            self._robot(request).request(browser, request, self._time.now())
        except RequestError as error:
            number = max(number, error.id)
            self._send(browser, _answer(Answer(browser, number, False, str(error))))

    def _robot(self, request: Asked) -> Robot:
        robot = self.robots.get(request.robot)
        if robot is None:
            raise RequestError(f"this page has no robot {request.robot!r}")
        return robot

    def _flush(self) -> None:
        for namespace, robot in self.robots.items():
            for out in robot.drain():
                match out:
                    case Publish(message):
                        publish(self._meshes[namespace], message)
                    case Put():
                        self._put(robot, self._meshes[namespace], out)
                    case Spawn():
                        self._send(out.browser, _answer(self._spawned(namespace, out)))
                    case Work():
                        self._work(namespace, out)
                    case Answer():
                        self._send(out.browser, _answer(out))

    def _spawned(self, namespace: str, what: Spawn) -> Answer:
        assert self._spawn is not None, "only robots with helpers request a spawn"
        fault = self._spawn(namespace, what.agent)
        return Answer(
            what.browser, what.id, not fault, fault or f"{what.agent} is started beside the page"
        )

    def _work(self, namespace: str, what: Work) -> None:
        """Do it on a thread, one at a time for each robot, since it takes the spare processors."""
        if namespace in self._working:
            why = "another one is under way; ask again when it has ended"
            self._send(what.browser, _answer(Answer(what.browser, what.id, False, why)))
            return
        self._working.add(namespace)

        def run() -> None:
            try:
                text, more = what.run(self._meshes[namespace])
                done = Answer(what.browser, what.id, True, text, more=more)
            except Exception as error:
                done = Answer(what.browser, what.id, False, str(error) or repr(error))
            self._inbox.put(f"work {namespace}", self._worked, namespace, done)

        threading.Thread(target=run, name=f"work {namespace}", daemon=True).start()

    def _worked(self, namespace: str, done: Answer) -> None:
        self._working.discard(namespace)
        self._send(done.browser, _answer(done))

    def _send_changes(self, now: float) -> None:
        """Send the changed parts to each browser that is ready."""
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
            if changed or now >= self._tick_at:  # without data the page reports a lost server
                shown.update(changed)
                self.browsers.send(browser, _state(changed, now))
        if now >= self._tick_at:
            self._tick_at = now + TICK_S

    def _send(self, browser: str, what: Mapping[str, object]) -> None:
        if self.browsers is not None and browser in self._shown:
            self.browsers.answer(browser, msgspec.json.encode(what))

    # The mesh ------------------------------------------------------------------------------------

    def _listen(self, robot: Robot, mesh: Mesh) -> None:
        # All keys: why the robot stands can depend on any agent that has stopped publishing.
        mesh.subscribe(EVERYTHING, self._receiver(robot, is_reply=False))

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

    def _receiver(self, robot: Robot, *, is_reply: bool) -> Receiver:
        def on_data(key: str, data: bytes) -> None:
            at = self._time.now()

            def deliver() -> None:
                message = read_or_none(Received(robot.namespace, key, data, 0))
                robot.receive(key, message, at, is_reply=is_reply)

            service = service_at(key)
            events = service is not None and service.kind is Kind.EVENT
            self._inbox.put(f"{robot.namespace} {key}", deliver, keep=EVENTS if events else 1)

        return on_data

    def _query_agents(self, robot: Robot, now: float) -> None:
        """Query cards, bids and parameters, if a browser is connected."""
        if not self._shown:
            return
        robot.view.ask(now)
        mesh, receiver = self._meshes[robot.namespace], self._receiver(robot, is_reply=True)
        queries: list[tuple[Service, Message]] = [(CARD, Ask()), (BIDS, Ask())]
        if now >= self._tuned_at:
            queries.append((service_of(ParametersRequest), ParametersRequest()))
        for service, query in queries:
            mesh.query(service.pattern, query, CARDS_S, receiver, lambda: None)

    def _put(self, robot: Robot, mesh: Mesh, put: Put) -> None:
        lane = f"{robot.namespace} answer {put.number}"

        def on_data(key: str, data: bytes) -> None:
            def deliver() -> None:
                message = mesh.read(put.reply, key, data)
                if message is not None:
                    robot.on_reply(put.number, message)

            self._inbox.put(lane, deliver)

        def over() -> None:
            self._inbox.put(lane, robot.on_reply, put.number, None)

        mesh.query(put.key or asked_on(mesh, put.message), put.message, put.timeout, on_data, over)


def _answer(answer: Answer) -> Mapping[str, object]:
    found = {"type": "answer", "id": answer.id, "ok": answer.ok, "text": answer.text}
    return found | {"over": answer.over, "more": answer.more}


def _state(changed: Mapping[tuple[str, str], bytes], now: float) -> bytes:
    """The message with changed parts by robot; each part was encoded once for all browsers."""
    robots: dict[str, list[bytes]] = {}
    for (namespace, part), data in changed.items():
        pair = msgspec.json.encode(part) + b":" + data
        robots.setdefault(namespace, []).append(pair)
    parts = [msgspec.json.encode(ns) + b":{" + b",".join(p) + b"}" for ns, p in robots.items()]
    t = msgspec.json.encode(round(now, 2))
    return b'{"type":"state","t":' + t + b',"robots":{' + b",".join(parts) + b"}}"
