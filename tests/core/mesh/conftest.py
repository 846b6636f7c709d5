"""Places on either mesh, agents on either, and real processes."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path

import pytest

from armadico.core.agent import Agent, Identity
from armadico.core.driver import Driver
from armadico.launch.client import Client
from armadico.launch.virtual_session import VirtualSession
from armadico.mesh.base import Mesh
from armadico.mesh.topology import topology
from armadico.mesh.virtual import VirtualMesh
from armadico.mesh.zenoh import ZenohMesh
from armadico.runtime.process import AgentHost, identity
from tests.programs import starter

TOY = Path(__file__).parent / "toy_process.py"
TOY_ROUTER = Path(__file__).parent / "toy_router.py"
NAMESPACE = "test"
SOON = 20.0  # s; a deadline, not an expectation

Spawn = Callable[..., subprocess.Popen[str]]
SpawnRouter = Callable[..., subprocess.Popen[str]]


Route = Callable[[str], ZenohMesh]
Join = Callable[..., ZenohMesh]


@pytest.fixture
def route() -> Iterator[Route]:
    """Open a namespace's router, as the robot agent's process does, once in a test."""
    routers: dict[str, ZenohMesh] = {}
    with ExitStack() as stack:

        def opened(namespace: str) -> ZenohMesh:
            if namespace not in routers:
                router = ZenohMesh(namespace, topology(router=True))
                routers[namespace] = stack.enter_context(router)
            return routers[namespace]

        yield opened


@pytest.fixture
def join(route: Route) -> Iterator[Join]:
    """Open clients of this test's routers; the first one of a namespace starts its router."""
    with ExitStack() as stack:

        def make(namespace: str = NAMESPACE) -> ZenohMesh:
            route(namespace)
            return stack.enter_context(ZenohMesh(namespace, topology()))

        yield make


MESHES = ["virtual", pytest.param("zenoh", marks=pytest.mark.live)]
"""A test of what a mesh promises is run on each."""

Enter = Callable[..., Mesh]


@pytest.fixture(params=MESHES)
def enter(request: pytest.FixtureRequest) -> Enter:
    """Join this test's mesh, of either kind, as often as wanted."""
    if request.param == "zenoh":
        joined: Enter = request.getfixturevalue("join")
        return joined
    mesh, numbers = VirtualMesh(1), count()

    def make(namespace: str = NAMESPACE) -> Mesh:
        return VirtualSession(mesh, namespace, f"guest-{next(numbers)}")

    return make


class Crowd:
    """Agents on one mesh, and a client that observes them."""

    client: Client

    def identity(self, name: str) -> Identity:
        """Return the identity of a new instance."""
        raise NotImplementedError

    def start(self, agent: Agent) -> Driver:
        """Start an agent's process, with admission."""
        raise NotImplementedError

    def until(self, condition: Callable[[], object]) -> bool:
        """Let time pass until something holds; whether it does in the end."""
        mesh = self.client.mesh
        end = mesh.now() + SOON
        while mesh.now() < end and not condition():
            self.client.wait_for(condition, 0.05)  # what is not published wakes no client
        return bool(condition())


class VirtualCrowd(Crowd):
    """On a virtual mesh."""

    def __init__(self) -> None:
        self.mesh = VirtualMesh(1)
        self.client = Client(VirtualSession(self.mesh))
        self._starts = count()

    def identity(self, name: str) -> Identity:
        return self.mesh.identity(name, next(self._starts))

    def start(self, agent: Agent) -> Driver:
        return self.mesh.add(agent).driver


class LiveCrowd(Crowd):
    """On Zenoh, each in a thread of its own."""

    def __init__(self, join: Join, stack: ExitStack) -> None:
        self._join, self._stack = join, stack
        self.client = Client(join())

    def identity(self, name: str) -> Identity:
        return identity(name)

    def start(self, agent: Agent) -> Driver:
        mesh = self._join()
        host = AgentHost([agent], mesh)

        def live() -> None:
            host.live()
            host.leave()
            mesh.close()

        thread = threading.Thread(target=live)
        thread.start()
        self._stack.callback(thread.join)
        self._stack.callback(host.request_stop)
        return host.drivers[0]


@pytest.fixture(params=MESHES)
def crowd(request: pytest.FixtureRequest) -> Iterator[Crowd]:
    """A society on either mesh."""
    if request.param == "virtual":
        yield VirtualCrowd()
        return
    join = request.getfixturevalue("join")
    with ExitStack() as stack:
        yield LiveCrowd(join, stack)


@pytest.fixture
def client(join: Join) -> Client:
    return Client(join())


@pytest.fixture
def spawn_alone() -> Iterator[Spawn]:
    """Start toy agents as processes, whether or not there is a router."""
    with starter([sys.executable, str(TOY)], stdout=None) as begin:

        def start(kind: str = "calm") -> subprocess.Popen[str]:
            return begin(kind, NAMESPACE)

        yield start


@pytest.fixture
def spawn(route: Route, spawn_alone: Spawn) -> Spawn:
    """Start toy agents as processes on the mesh of this test."""
    route(NAMESPACE)
    return spawn_alone


@pytest.fixture
def spawn_router() -> Iterator[SpawnRouter]:
    """Start routers as processes, which can be killed and hung; see `toy_router`."""
    with starter([sys.executable, str(TOY_ROUTER)], stderr=None, stdin=subprocess.PIPE) as begin:

        def start(*words: str) -> subprocess.Popen[str]:
            process = begin(*words)
            assert process.stdout is not None
            assert process.stdout.readline() == "listening\n"
            return process

        yield start
