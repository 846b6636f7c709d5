"""Clients and routers on real Zenoh: routers that start late, restart and hang, and fleets.

The robot agent's process is the router of its society, and all other processes are its clients.
"""

from __future__ import annotations

import itertools
import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from threading import Event
from typing import Any

import pytest
import zenoh

from armadico.core.messages import LARGEST_PAYLOAD, Ballot, Claim, Cycle
from armadico.launch.client import Client
from armadico.mesh.base import Mesh
from armadico.mesh.ports import LOOPBACK, free_port
from armadico.mesh.sockets import RUNTIME_VARIABLE, endpoint, socket_of
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import PEERS_S, SETTINGS, ZenohMesh
from armadico.mobile.messages import Plan, PlanRequest, Pose, Waypoint
from tests.runtime_folder import fresh_folder

from .conftest import NAMESPACE, SOON, Join, Spawn, SpawnRouter

pytestmark = pytest.mark.live

LEASE_S = SETTINGS["transport/link/tx/lease"] / 1000
POSE = Pose(Cycle(1, 2), 1.0, -2.0, 0.5)
REQUEST = PlanRequest(Waypoint(0, 0, 0), Waypoint(1, 2, 0.5))
GOTO, AVOID, SONAR = ("goto", "goto-1"), ("avoid", "avoid-1"), ("sonar", "sonar-1")

PAUSE = Event()
"""Never set: it lets other threads run while something is polled."""

Open = Callable[..., ZenohMesh]


class Robot:
    """A robot's router, and how its clients connect."""

    def __init__(self, spawn_router: SpawnRouter, client_of: Open, *, by_tcp: bool) -> None:
        """Choose; the router is not started.

        Args:
            spawn_router: Starts it.
            client_of: Opens a client.
            by_tcp: Clients connect as from another host, and not by the socket.
        """
        own = f"tcp/{LOOPBACK}:{free_port()}"
        self._words = (NAMESPACE, own) if by_tcp else (NAMESPACE,)
        self._where = {"robot": own, "here": False} if by_tcp else {}
        self._spawn_router, self._client_of = spawn_router, client_of
        self.router: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self.router = self._spawn_router(*self._words)

    def client(self) -> ZenohMesh:
        return self._client_of(**self._where)

    def end(self, how: str) -> None:
        assert self.router is not None
        end(self.router, how)

    def send(self, signal: int) -> None:
        assert self.router is not None
        self.router.send_signal(signal)


@pytest.fixture(params=["socket", "tcp"])
def robot(request: pytest.FixtureRequest, spawn_router: SpawnRouter, client_of: Open) -> Robot:
    return Robot(spawn_router, client_of, by_tcp=request.param == "tcp")


@pytest.fixture
def client_of() -> Iterator[Open]:
    """Open clients of a namespace, whether or not its router is there."""
    with ExitStack() as stack:

        def make(namespace: str = NAMESPACE, **where: Any) -> ZenohMesh:
            return stack.enter_context(ZenohMesh(namespace, topology(**where), starts=True))

        yield make


def eventually(condition: Callable[[], object]) -> bool:
    end = time.monotonic() + SOON
    while not condition():
        if time.monotonic() > end:
            return False
        PAUSE.wait(0.01)
    return True


class News:
    """What a mesh reports of agents and of the router, in order."""

    def __init__(self, mesh: Mesh) -> None:
        self.all: list[Any] = []
        self.alive: set[tuple[str, str]] = set()
        mesh.watch_router(self.all.append)
        mesh.watch_alive(self._changed)

    def _changed(self, name: str, instance: str, there: bool) -> None:
        (self.alive.add if there else self.alive.discard)((name, instance))
        self.all.append(("+" if there else "-") + name)

    @property
    def gone(self) -> list[str]:
        """The agents that were reported as gone."""
        return [news for news in self.all if str(news).startswith("-")]

    def read(self) -> list[Any]:
        """The news since the last reading."""
        news = self.all[:]
        del self.all[: len(news)]
        return news


def received(mesh: Mesh, pattern: str) -> list[tuple[str, bytes]]:
    """What a mesh receives on a pattern from now on."""
    got: list[tuple[str, bytes]] = []
    mesh.subscribe(pattern, lambda key, data: got.append((key, data)))
    return got


def publishes_until(mesh: Mesh, key: str, got: list[Any]) -> bool:
    """Publish again and again until something has arrived: links need time to come up."""

    def arrived() -> bool:
        mesh.publish(key, POSE)
        return bool(got)

    return eventually(arrived)


def end(router: subprocess.Popen[str], how: str) -> None:
    if how == "killed":
        router.kill()
    else:
        assert router.stdin is not None
        router.stdin.close()
    router.wait(SOON)


# A client without a router ------------------------------------------------------------------------


def test_what_a_client_declares_before_its_router_is_there_works_once_it_comes(
    client_of: Open, spawn_router: SpawnRouter
) -> None:
    early = client_of()
    got = received(early, "encoder/*")
    early.answer("path/plan", lambda call: call.reply("path/plan", Plan((), 1.0)))
    early.declare_alive(*GOTO)
    news = News(early)
    assert not early.wait_joined(0.0)
    assert not early.reachable

    spawn_router(NAMESPACE)
    late = client_of()
    late.declare_alive(*AVOID)
    assert early.wait_joined(SOON)
    assert eventually(lambda: news.alive == {GOTO, AVOID})
    assert news.all[0] is False
    assert True in news.all
    client = Client(late)
    assert client.wait_for(lambda: GOTO in client.alive, SOON)
    assert client.query(REQUEST, SOON) == Plan((), 1.0)
    assert publishes_until(late, "encoder/pose", got)
    assert early.read(Pose, *got[0]) == POSE


def test_what_a_client_publishes_before_its_router_is_there_arrives_nowhere(
    client_of: Open, spawn_router: SpawnRouter
) -> None:
    early, late = client_of(), client_of()
    got = received(late, "**")
    early.publish("encoder/pose", POSE)
    spawn_router(NAMESPACE)
    assert publishes_until(early, "encoder/later", got)
    assert {key for key, _ in got} == {"encoder/later"}


def test_a_query_before_the_router_is_there_ends_at_once_without_a_reply(client_of: Open) -> None:
    early, replies, ends = client_of(), [], []
    early.answer("path/plan", lambda call: call.reply("path/plan", Plan((), 1.0)))
    early.query(
        "path/plan", REQUEST, SOON, lambda *reply: replies.append(reply), lambda: ends.append(1)
    )
    assert ends == [1]
    assert replies == []


def test_a_client_does_not_wait_for_a_router_that_hangs_and_joins_when_it_goes_on(
    client_of: Open, spawn_router: SpawnRouter
) -> None:
    router = spawn_router(NAMESPACE)
    router.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    client = client_of()
    assert time.monotonic() - began < 2.0
    assert not client.wait_joined(0.0)
    router.send_signal(signal.SIGCONT)
    assert client.wait_joined(SOON)


def test_an_agents_process_that_starts_before_its_router_joins_once_it_comes(
    spawn_router: SpawnRouter, client_of: Open, spawn_alone: Spawn
) -> None:
    spawn_alone()
    router = spawn_router(NAMESPACE)
    news = News(client_of())
    assert eventually(lambda: len(news.alive) == 1)
    end(router, "killed")
    spawn_router(NAMESPACE)
    assert eventually(lambda: news.all[-1] is True)
    assert news.gone == []


# A router that restarts ---------------------------------------------------------------------------


@pytest.mark.long(but=("tcp-killed",))
@pytest.mark.parametrize("how", ["killed", "closed"])
def test_after_a_restart_of_the_router_only_agents_that_do_not_come_back_are_reported_as_gone(
    robot: Robot, how: str
) -> None:
    robot.start()
    watcher, goto, avoid, sonar = (robot.client() for _ in range(4))
    got = received(watcher, "encoder/*")
    avoid.answer("path/plan", lambda call: call.reply("path/plan", Plan((), 1.0)))
    goto.declare_alive(*GOTO)
    avoid.declare_alive(*AVOID)
    sonar.declare_alive(*SONAR)
    news = News(watcher)
    assert eventually(lambda: news.alive == {GOTO, AVOID, SONAR})
    for _ in range(2):
        assert news.gone == []
        got.clear()
        robot.end(how)
        assert eventually(lambda: not any(mesh.reachable for mesh in (watcher, goto, avoid)))
        goto.publish("encoder/lost", POSE)
        robot.start()
        assert eventually(lambda: all(mesh.reachable for mesh in (watcher, goto, avoid)))
        assert publishes_until(goto, "encoder/pose", got)
        assert {key for key, _ in got} == {"encoder/pose"}
        assert Client(goto).query(REQUEST, SOON) == Plan((), 1.0)
    news.read()
    robot.end(how)
    assert eventually(lambda: news.all == [False])
    sonar.close()
    robot.start()
    assert eventually(lambda: news.gone), "the agent that has gone is reported afterwards"
    assert news.read() == [False, True, "-sonar"]
    assert news.alive == {GOTO, AVOID}
    avoid.close()
    assert eventually(lambda: news.read() == ["-avoid"])


# A router that hangs ------------------------------------------------------------------------------


@pytest.mark.long(but=("socket",))
def test_after_a_hang_of_the_router_only_agents_that_do_not_come_back_are_reported_as_gone(
    robot: Robot,
) -> None:
    robot.start()
    watcher, goto, avoid = (robot.client() for _ in range(3))
    news, got = News(watcher), received(watcher, "encoder/*")
    goto.declare_alive(*GOTO)
    avoid.declare_alive(*AVOID)
    assert eventually(lambda: news.alive == {GOTO, AVOID})
    news.read()
    robot.send(signal.SIGSTOP)
    assert eventually(lambda: news.all == [False]), "when the lease ends"
    avoid.close()
    robot.send(signal.SIGCONT)
    assert eventually(lambda: news.gone)
    assert news.read() == [False, True, "-avoid"]
    assert publishes_until(goto, "encoder/pose", got)


@pytest.mark.long(but=("tcp",))
def test_after_a_hang_of_the_router_each_message_still_arrives_by_its_own_key(
    robot: Robot,
) -> None:
    """Zenoh's own reconnection mixes keys up."""
    robot.start()
    speakers, watcher = [robot.client() for _ in range(3)], robot.client()
    got = received(watcher, "**")
    numbers = itertools.count()

    def speak() -> None:
        for speaker, mesh in enumerate(speakers):
            for row in range(5):
                mesh.publish(f"a{speaker}/b{row}", Pose(Cycle(1, next(numbers)), speaker, row, 0))

    def speak_until(condition: Callable[[], object]) -> bool:
        return eventually(lambda: (speak(), condition())[1])

    assert speak_until(lambda: len({key for key, _ in got}) == 15)
    for _ in range(2):
        robot.send(signal.SIGSTOP)
        assert speak_until(lambda: not any(mesh.reachable for mesh in (*speakers, watcher)))
        robot.send(signal.SIGCONT)
        assert speak_until(lambda: all(mesh.reachable for mesh in (*speakers, watcher)))
        got.clear()
        assert speak_until(lambda: len({key for key, _ in got}) == 15)
        for key, data in got:
            pose = watcher.read(Pose, key, data)
            assert pose is not None
            assert key == f"a{pose.x:.0f}/b{pose.y:.0f}"


def test_what_is_sent_through_a_router_that_hangs_for_less_than_the_lease_arrives(
    client_of: Open, spawn_router: SpawnRouter
) -> None:
    router = spawn_router(NAMESPACE)
    watcher, goto = client_of(), client_of()
    got, news = received(watcher, "encoder/*"), News(watcher)
    assert publishes_until(goto, "encoder/pose", got)
    news.read()
    router.send_signal(signal.SIGSTOP)
    for number in range(10):
        goto.publish(f"encoder/{number}", POSE)
    router.send_signal(signal.SIGCONT)
    assert eventually(lambda: got[-1][0] == "encoder/9")
    assert [key for key, _ in got[-10:]] == [f"encoder/{number}" for number in range(10)]
    assert news.read() == []


# Fleets -------------------------------------------------------------------------------------------


def stranger(namespace: str) -> zenoh.Session:
    """A session on a robot's router that does not keep to the keys of its namespace."""
    config = zenoh.Config()
    own = {"mode": "client", "connect/endpoints": [endpoint(socket_of(namespace))]}
    for key, value in (SETTINGS | own).items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def test_a_client_makes_nothing_wait_overtake_or_grow(spawn_router: SpawnRouter) -> None:
    """A large message, or a flood that waits for slow receivers, would stop all forwarding."""
    spawn_router(NAMESPACE)
    with stranger(NAMESPACE) as receiver, stranger(NAMESPACE) as sender:
        got: list[zenoh.Sample] = []
        key = f"{NAMESPACE}/robot/stop/x"
        subscriber = receiver.declare_subscriber(key, got.append)

        def send(payload: bytes, attachment: bytes | None = None) -> None:
            sender.put(
                key,
                payload,
                attachment=attachment,
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )

        def arrived() -> bool:
            send(b"small")
            return bool(got)

        assert eventually(arrived)
        send(bytes(10_000_000))
        send(bytes(LARGEST_PAYLOAD + 100))
        send(b"small", bytes(LARGEST_PAYLOAD + 100))

        def largest_arrived() -> bool:
            send(bytes(LARGEST_PAYLOAD))
            return len(got[-1].payload) == LARGEST_PAYLOAD

        assert eventually(largest_arrived)
        assert {len(sample.payload) for sample in got} == {len(b"small"), LARGEST_PAYLOAD}
        assert all(sample.attachment is None for sample in got)
        for sample in got:
            assert sample.congestion_control == zenoh.CongestionControl.DROP
            assert sample.priority == zenoh.Priority.DATA
            assert not sample.express
        subscriber.undeclare()


PATTERNS = ["lab/r2/robot/stop", "lab/r2/**", "lab/r2/robot/*", "lab/*/robot/stop", "lab/**", "**"]


def test_nothing_of_one_robot_reaches_another_by_whatever_key(join: Join) -> None:
    one, two = join("lab/r1"), join("lab/r2")
    got, shared = received(two, "**"), received(two, "fleet/**")
    two.declare_alive(*GOTO)
    queried: list[str] = []
    two.answer("path/plan", lambda call: queried.append(call.key))
    news = News(two)
    assert publishes_until(one, "fleet/pose", shared)
    shared.clear()
    with stranger("lab/r1") as session:
        for pattern in PATTERNS:
            session.put(pattern, b"\xa0")
            session.delete(pattern)
            replies = session.get(pattern, timeout=SOON)
            assert [reply.ok for reply in replies if reply.ok is not None] == []
        session.liveliness().declare_token("lab/r2/agent/false/false-1")
        while not shared:  # it comes after all of that, by the same links
            session.put("lab/fleet/pose", b"\xa0")
            PAUSE.wait(0.01)
    assert {key for key, _ in shared} == {"fleet/pose"}
    assert got == []
    assert queried == []
    assert two.refused == {}
    assert news.alive == {GOTO}


@pytest.mark.long(but=("True",))
@pytest.mark.parametrize("turned", [False, True])
def test_of_several_routers_a_client_joins_its_own_robots(
    client_of: Open, spawn_router: SpawnRouter, turned: bool
) -> None:
    names = ("lab/r1", "lab/r2")
    where = [f"tcp/{LOOPBACK}:{free_port()}" for _ in names]
    for name, own in zip(names, where, strict=True):
        spawn_router(name, own)
    where.sort(reverse=turned)
    for name in names:
        by_socket = client_of(name)
        got = received(by_socket, "encoder/pose")
        assert publishes_until(client_of(name, connect=where), "encoder/pose", got)
    assert not client_of("lab/r3", connect=where).wait_joined(1.0)


ROBOTS = ("lab/r1", "lab/r2", "lab/r3")


class Fleet:
    """The routers of three robots, each with a client that keeps what the fleet shares."""

    def __init__(self, spawn_router: SpawnRouter, client_of: Open) -> None:
        self._spawn_router, self._client_of = spawn_router, client_of
        self._numbers = itertools.count()
        self.routers: dict[str, subprocess.Popen[str]] = {}
        self.meshes: dict[str, ZenohMesh] = {}
        self.got: dict[str, list[tuple[str, bytes]]] = {}

    def start(self, name: str, *words: str) -> None:
        self.routers[name] = self._spawn_router(name, *words)
        if name not in self.meshes:
            self.meshes[name] = mesh = self._client_of(name)
            self.got[name] = received(mesh, "fleet/*")

    def crosses(self, one: str, other: str) -> bool:
        """Whether what one publishes arrives at the other, once each."""
        last = ""

        def arrived() -> bool:
            nonlocal last
            keys = [key for key, _ in self.got[other]]
            if last in keys:
                return True
            last = f"fleet/{next(self._numbers)}"
            self.meshes[one].publish(last, POSE)
            return False

        crossed = eventually(arrived)
        keys = [key for key, _ in self.got[other]]
        assert len(set(keys)) == len(keys)
        return crossed

    def is_whole(self) -> bool:
        return all(self.crosses(*pair) for pair in itertools.permutations(self.meshes, 2))


@pytest.fixture
def fleet(spawn_router: SpawnRouter, client_of: Open) -> Fleet:
    return Fleet(spawn_router, client_of)


@pytest.mark.long(but=("lab/r2",))
@pytest.mark.parametrize("restarted", ROBOTS)
def test_robots_of_a_fleet_share_its_keys_whichever_starts_or_restarts(
    fleet: Fleet, restarted: str
) -> None:
    for name in ROBOTS:
        fleet.start(name)
    assert fleet.is_whole()
    for how in ("killed", "closed"):
        end(fleet.routers[restarted], how)
        fleet.start(restarted)
        assert fleet.is_whole()


def test_robots_on_several_computers_share_the_keys_of_their_fleet(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoints = [f"tcp/{LOOPBACK}:{free_port()}" for _ in ROBOTS]
    here = iter([fresh_folder(), fresh_folder()])
    for name, own in zip(ROBOTS, endpoints, strict=True):
        if name != "lab/r2":  # the first two are on one computer
            monkeypatch.setenv(RUNTIME_VARIABLE, next(here))
        fleet.start(name, own, *endpoints)
        assert fleet.meshes[name].wait_joined(SOON)
    assert fleet.is_whole()


@pytest.mark.long
def test_robots_with_a_socket_and_an_endpoint_receive_each_message_once(fleet: Fleet) -> None:
    """They are on one computer, and the fleet's list has the endpoints of both."""
    endpoints = [f"tcp/{LOOPBACK}:{free_port()}" for _ in range(2)]
    for name, own in zip(ROBOTS, endpoints, strict=False):
        fleet.start(name, own, *endpoints)
    end_at = time.monotonic() + 3 * PEERS_S  # both links are up long before
    while time.monotonic() < end_at:
        assert fleet.is_whole()


@pytest.mark.long
def test_a_robot_whose_router_hangs_delays_no_other_and_is_back_afterwards(fleet: Fleet) -> None:
    for name in ROBOTS:
        fleet.start(name)
    assert fleet.is_whole()
    fleet.routers["lab/r1"].send_signal(signal.SIGSTOP)
    assert eventually(lambda: not fleet.meshes["lab/r1"].reachable)
    took = []
    for _ in range(20):
        began = time.monotonic()
        assert fleet.crosses("lab/r2", "lab/r3")
        assert fleet.crosses("lab/r3", "lab/r2")
        took.append(time.monotonic() - began)
    assert max(took) < 0.8 * LEASE_S
    assert all(fleet.meshes[name].reachable for name in ("lab/r2", "lab/r3"))
    fleet.routers["lab/r1"].send_signal(signal.SIGCONT)
    assert fleet.is_whole()


# A client that does not read ----------------------------------------------------------------------


def test_a_client_that_never_reads_delays_nothing_else(join: Join, spawn: Spawn) -> None:
    speaker, one, other = join(), join(), join()
    news = News(one)
    process = spawn("attentive")
    assert eventually(lambda: news.alive)
    large = bytes(25_000)
    claim = Claim("wheels", Ballot(1, 0.5, False, "a-1"), Cycle(1, 2), 0.5, False, large, large)
    claims = received(one, "resource/*/utility")
    arrived = {"one": received(one, "encoder/*"), "other": received(other, "encoder/*")}
    assert publishes_until(one, "encoder/pose", arrived["other"])
    assert publishes_until(other, "encoder/pose", arrived["one"])

    def crosses(number: int) -> float:
        """How long a message takes there and back, s."""
        began = time.monotonic()
        for by, to, name in ((one, "other", "there"), (other, "one", "back")):
            key = f"encoder/{name}-{number}"
            by.publish(key, POSE)
            while arrived[to][-1][0] != key:
                assert time.monotonic() < began + SOON
                PAUSE.wait(0.001)
        return time.monotonic() - began

    process.send_signal(signal.SIGSTOP)
    began, sends, took = time.monotonic(), [], []
    while time.monotonic() < began + 3 * LEASE_S:
        now = time.monotonic()
        speaker.publish("resource/wheels/utility", claim)
        sends.append(time.monotonic() - now)
        took.append(crosses(len(took)))
    assert len(claims) > 0.9 * len(sends)
    assert max(took) < 0.8 * LEASE_S
    assert max(sends) < 0.8 * LEASE_S
    process.send_signal(signal.SIGCONT)


# Strangers ----------------------------------------------------------------------------------------


def test_silent_connections_keep_no_client_out(spawn_router: SpawnRouter, client_of: Open) -> None:
    port = free_port()
    spawn_router(NAMESPACE, f"tcp/{LOOPBACK}:{port}")
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(socket.create_connection((LOOPBACK, port), SOON))
        # By Zenoh's default 100 may wait, for 10 s each, and everyone else waits for them.
        assert client_of().wait_joined(8.0), "by the socket"
        assert client_of(robot=f"tcp/{LOOPBACK}:{port}", here=False).wait_joined(SOON)


def test_a_token_that_anyone_may_declare_does_not_end_a_link(robot: Robot) -> None:
    robot.start()
    watcher, goto, stranger = (robot.client() for _ in range(3))
    goto.declare_alive(*GOTO)
    news = News(watcher)
    assert eventually(lambda: news.alive == {GOTO})
    news.read()
    for name in (watcher.router, "anything"):
        session = stranger._open
        token = session.liveliness().declare_token(f"{NAMESPACE}/router/{name}")
        token.undeclare()
    # What follows arrives after it, by the same link.
    stranger.declare_alive(*AVOID)
    assert eventually(lambda: AVOID in news.alive)
    assert watcher.reachable
    assert news.read() == ["+avoid"]
