"""A virtual society with a page; its session runs in the test, or on a thread for a browser."""

from __future__ import annotations

import json
import threading
from base64 import urlsafe_b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any

from msgspec.structs import replace

from armadico.config.named import Gazetteer
from armadico.config.scenarios import ideal, load_scenario
from armadico.config.worlds import load_world
from armadico.core.discovery import agent_class
from armadico.core.messages import Message
from armadico.launch.client import Client
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.ports import LOOPBACK
from armadico.watch.page.guard import TOKEN_PREFIX, Guard
from armadico.watch.page.model import Robot
from armadico.watch.page.server import Server
from armadico.watch.page.session import TURN_S, Session
from armadico.watch.teleop.messages import Stick

HOME = "robot1"


def subprotocol(token: str) -> str:
    """A token as the page's script offers it."""
    return TOKEN_PREFIX + urlsafe_b64encode(token.encode()).decode().rstrip("=")


PACE_S = 0.006  # real duration of a turn (0.05 s of the society), so that browsers can follow
SLOW_S = 0.001  # duration of a turn while a browser must observe a short event


class Shown:
    """Browsers that keep all data and answers."""

    def __init__(self) -> None:
        self.parts: dict[str, dict[str, Any]] = {}
        self.messages: list[dict[str, Any]] = []
        self.slow: set[str] = set()
        self.count = 0

    def ready(self, browser: str) -> bool:
        return browser not in self.slow

    def send(self, browser: str, data: bytes) -> None:
        self.count += 1
        for robot, parts in json.loads(data)["robots"].items():
            self.parts.setdefault(robot, {}).update(parts)

    def answer(self, browser: str, data: bytes) -> None:
        self.messages.append(json.loads(data) | {"browser": browser})

    @property
    def answers(self) -> list[dict[str, Any]]:
        return [each for each in self.messages if each["type"] == "answer"]


class Stage:
    """One robot's society on the virtual mesh, and a session."""

    def __init__(
        self, scenario: str = "sc1", seed: int = 5, *, run: Rehearsal | None = None
    ) -> None:
        drawn = replace(ideal(load_scenario(scenario)), goal=None)
        self.run = run or Rehearsal(drawn, Options(seed=seed))
        self.world = load_world(self.run.scenario.world)
        self.mesh = self.run.mesh
        self.place = VirtualSession(self.mesh, HOME)
        presses = iter(range(1, 1000))
        places = Gazetteer(self.run.scenario.world)
        robot = Robot(HOME, self.world, lambda: next(presses), ("teleop",), gazetteer=places)
        self.spawned: list[tuple[str, str]] = []
        self.session = Session({HOME: robot}, [self.place], self._spawn)
        self.robot = robot
        self.shown = Shown()
        self.session.browsers = self.shown
        self._ids = iter(range(1, 100_000))

    def _spawn(self, namespace: str, name: str) -> str:
        self.spawned.append((namespace, name))
        self.run.add(agent_class(name))
        return ""

    @property
    def client(self) -> Client:
        return self.run.client

    @property
    def parts(self) -> dict[str, Any]:
        return self.shown.parts.get(HOME, {})

    def request(self, browser: str, do: str, **words: Any) -> int:
        number = next(self._ids)
        self.session.on_message(
            browser, json.dumps({"id": number, "robot": HOME, "do": do, **words})
        )
        return number

    def until(self, condition: Callable[[], object], seconds: float = 120.0) -> None:
        end = self.mesh.now + seconds
        while not condition():
            assert self.mesh.now < end, (self.shown.answers, self.parts.get("standing"))
            self.session.turn()

    def run_for(self, seconds: float) -> None:
        end = self.mesh.now + seconds
        while self.mesh.now < end:
            self.session.turn()

    def answer(self, number: int, seconds: float = 60.0) -> dict[str, Any]:
        found: list[dict[str, Any]] = []

        def there() -> bool:
            found[:] = [each for each in self.shown.answers if each["id"] == number]
            return bool(found)

        self.until(there, seconds)
        return found[-1]

    def ask(self, browser: str, do: str, **words: Any) -> dict[str, Any]:
        """The answer to a request."""
        return self.answer(self.request(browser, do, **words))

    def sticks(self) -> list[Stick]:
        """The sticks that are published from now on."""
        found: list[Stick] = []

        def watch(key: str, stick: Message, _t: float) -> None:
            if key != "teleop/stick":  # the copy for agents of protocol 2
                assert isinstance(stick, Stick)
                assert key == f"teleop/stick/{stick.hand}"
                found.append(stick)

        self.mesh.watch(watch, Stick)
        return found

    def ready(self) -> None:
        """Wait until all agents are alive and have answered queries."""
        self.session.on_connect("page 1")
        self.until(lambda: self.parts.get("motion", {}).get("x") is not None)
        self.until(lambda: len(self.parts["wheels"]["contenders"]) > 1)


class Served(Stage):
    """A stage with a server, run by a thread; `call` executes a function on that thread.

    Its time is slow while the robot is faster than `watched` (m/s).
    """

    def __init__(self, *words: Any, pace: float = PACE_S, **more: Any) -> None:
        super().__init__(*words, **more)
        self._pace = pace
        self.watched = inf
        self.server: Server | None = None
        self._stopping = threading.Event()
        self._todo: list[tuple[Callable[[], Any], threading.Event, list[Any]]] = []

    @property
    def address(self) -> str:
        assert self.server is not None, "it is served"
        return f"http://{LOOPBACK}:{self.server.port}/"

    def call(self, what: Callable[[], Any]) -> Any:
        done, found = threading.Event(), list[Any]()
        self._todo.append((what, done, found))
        assert done.wait(30.0)
        return found[0]

    def work(self) -> None:
        while not self._stopping.wait(self._pace):
            state = self.robot.view.state
            watched = state is not None and state.v > self.watched
            self.session.turn(SLOW_S if watched else TURN_S)
            while self._todo:
                what, done, found = self._todo.pop(0)
                found.append(what())
                done.set()

    def stop(self) -> None:
        self._stopping.set()


@contextmanager
def served(stage: Served, guard: Guard | None = None) -> Iterator[Served]:
    with Server(stage.session, guard or Guard.of(LOOPBACK, None), LOOPBACK, 0) as stage.server:
        thread = threading.Thread(target=stage.work)
        thread.start()
        try:
            yield stage
        finally:
            stage.stop()
            thread.join()
