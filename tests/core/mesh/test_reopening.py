"""A router that replaces its session in its own process, and its clients, on real Zenoh."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

import pytest

from armadico.core.messages import Cycle
from armadico.mesh.ports import LOOPBACK, free_port
from armadico.mesh.topology import MeshError, topology
from armadico.mobile.messages import Pose

from .conftest import NAMESPACE, SOON, Join, Route

pytestmark = pytest.mark.live

POSE = Pose(Cycle(1, 2), 1.0, -2.0, 0.5)
ROUTER = topology(router=True)


def comes(arrived: SimpleQueue[str], publish: Callable[[], None]) -> bool:
    """Whether anything arrives of what is published again and again."""
    while not arrived.empty():
        arrived.get()
    for _ in range(int(SOON / 0.05)):
        publish()
        try:
            return bool(arrived.get(timeout=0.05))
        except Empty:
            continue
    return False


def test_clients_come_back_to_a_reopened_router_by_themselves(route: Route, join: Join) -> None:
    router, first, second = route(NAMESPACE), join(), join()
    at_router, at_second = SimpleQueue[str](), SimpleQueue[str]()
    router.subscribe("encoder/pose", lambda key, _: at_router.put(key))
    second.subscribe("encoder/pose", lambda key, _: at_second.put(key))
    first.answer("encoder/ask", lambda call: call.reply("encoder/ask", POSE))

    for _ in range(3):
        former = router.router
        router.reopen(ROUTER)
        assert router.router != former
        assert comes(at_router, lambda: first.publish("encoder/pose", POSE))
        assert comes(at_second, lambda: first.publish("encoder/pose", POSE))
        assert comes(at_second, lambda: router.publish("encoder/pose", POSE))
    replies, over = SimpleQueue[str](), threading.Event()
    router.query("encoder/ask", POSE, SOON, lambda key, _: replies.put(key), over.set)
    assert over.wait(SOON)
    assert replies.get_nowait() == "encoder/ask"


def test_no_process_takes_a_reopening_for_the_end_of_the_robots_agent(
    route: Route, join: Join
) -> None:
    """Its own agent keeps its token, as the others know that they are cut off themselves."""
    router, client, onlooker = route(NAMESPACE), join(), join()
    router.declare_alive("robot", "robot-1")
    client.declare_alive("goto", "goto-1")
    seen, gone = SimpleQueue[str](), list[str]()

    def changed(name: str, instance: str, there: bool) -> None:
        (seen.put if there else gone.append)(instance)

    onlooker.watch_alive(changed)
    links = SimpleQueue[bool]()
    onlooker.watch_router(links.put)
    assert {seen.get(timeout=SOON), seen.get(timeout=SOON)} == {"robot-1", "goto-1"}

    router.reopen(ROUTER)

    assert [links.get(timeout=SOON) for _ in range(3)] == [True, False, True]
    client.declare_alive("goto", "goto-2")  # comes after whatever the first link brought
    assert seen.get(timeout=SOON) == "goto-2"
    assert not gone


def test_a_router_sees_an_agent_go_that_does_not_return(route: Route, join: Join) -> None:
    router, client = route(NAMESPACE), join()
    changes = SimpleQueue[tuple[str, bool]]()
    router.watch_alive(lambda _, instance, there: changes.put((instance, there)))
    client.declare_alive("goto", "goto-1")
    assert changes.get(timeout=SOON) == ("goto-1", True)

    router.reopen(ROUTER)
    client.close()

    assert changes.get(timeout=SOON) == ("goto-1", False)


def test_settings_that_cannot_be_used_leave_the_old_ones_in_force(route: Route, join: Join) -> None:
    router, client = route(NAMESPACE), join()
    arrived = SimpleQueue[str]()
    router.subscribe("encoder/pose", lambda key, _: arrived.put(key))
    with socket.create_server((LOOPBACK, free_port())) as taken:
        endpoint = f"tcp/{LOOPBACK}:{taken.getsockname()[1]}"
        with pytest.raises(MeshError, match="another process uses that port"):
            router.reopen(topology(router=True, robot=endpoint))

    assert comes(arrived, lambda: client.publish("encoder/pose", POSE))


def test_a_router_that_has_been_left_does_not_reopen(route: Route) -> None:
    router = route(NAMESPACE)
    router.close()
    with pytest.raises(MeshError):
        router.reopen(ROUTER)
