"""Societies on one core that has far too much to do, and routers that hang again and again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack

import psutil
import pytest

from armadico.launch.client import Client
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from tests.programs import starter

from .conftest import TOY, TOY_ROUTER

pytestmark = pytest.mark.live

SOCIETIES = ("left", "right")
AGENTS = 12  # of each, besides its router
BUSY = 8
HANGS = 5
HANG_S = 1.5  # longer than the lease: all links are lost
DEADLINE_S = 90.0
MOST = 1.2  # links after it all, as a multiple of those before


@pytest.fixture
def crowded() -> Iterator[tuple[list[subprocess.Popen[str]], list[subprocess.Popen[str]]]]:
    """The routers and the agents of all societies, on one core."""
    core = min(os.sched_getaffinity(0))
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "stdin": subprocess.PIPE}
    pinned = {"preexec_fn": lambda: os.sched_setaffinity(0, {core})}
    with starter([sys.executable], **options, **pinned) as start:
        routers = [start(str(TOY_ROUTER), name) for name in SOCIETIES]
        agents = [start(str(TOY), "calm", name) for name in SOCIETIES for _ in range(AGENTS)]
        yield routers, agents


def links(processes: list[subprocess.Popen[str]]) -> int:
    found = (psutil.Process(process.pid).net_connections("all") for process in processes)
    return sum(len(each) for each in found)


@pytest.mark.long
def test_societies_on_a_starved_core_are_whole_again_after_their_links_were_lost_five_times(
    crowded: tuple[list[subprocess.Popen[str]], list[subprocess.Popen[str]]],
) -> None:
    routers, agents = crowded
    processes = [*routers, *agents]
    core = min(os.sched_getaffinity(0))
    with ExitStack() as stack:
        clients = [
            Client(stack.enter_context(ZenohMesh(name, topology(), starts=True)))
            for name in SOCIETIES
        ]

        def whole(client: Client) -> bool:
            client.wait_for(lambda: len(client.alive) >= AGENTS, 1.0)
            return sum(card is not None for card in client.cards().values()) == AGENTS

        def all_whole() -> bool:
            return all(map(whole, clients))

        end = clients[0].mesh.now() + DEADLINE_S
        while not all_whole():
            assert clients[0].mesh.now() < end, [len(client.alive) for client in clients]
        before = links(processes)
        busy = stack.enter_context(starter([sys.executable, "-c", "while True: pass"]))
        load = [busy() for _ in range(BUSY)]
        for process in load:
            os.sched_setaffinity(process.pid, {core})
        for _ in range(HANGS):
            for router in routers:
                router.send_signal(signal.SIGSTOP)
            clients[0].wait_for(lambda: False, HANG_S)
            for router in routers:
                router.send_signal(signal.SIGCONT)
            clients[0].wait_for(lambda: False, HANG_S)
        for process in load:
            process.kill()
        end = clients[0].mesh.now() + DEADLINE_S
        while not all_whole():
            assert clients[0].mesh.now() < end, [sorted(client.alive) for client in clients]
        assert [process.poll() for process in processes] == [None] * len(processes)
        assert links(processes) <= MOST * before
