"""Closing a link delays no other link: no socket of Zenoh's lingers once its link is up."""

from __future__ import annotations

import os
import queue
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from armadico.mesh.linger import release_links
from armadico.mesh.ports import LOOPBACK, free_port
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh

pytestmark = pytest.mark.live

TEN = struct.pack("ii", 1, 10)
ENOUGH = 10.0  # s


def lingering() -> list[bytes]:
    """The linger times of this process's sockets that have any."""
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # gone
            copy = os.dup(int(entry.name))
            try:
                with suppress(OSError), socket.socket(fileno=copy) as one:  # no socket
                    found.append(one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))
                    copy = one.detach()
            finally:
                os.close(copy)
    return [each for each in found if struct.unpack("ii", each)[0]]


@pytest.fixture
def endpoint() -> str:
    return f"tcp/{LOOPBACK}:{free_port()}"


@pytest.fixture
def ours() -> Iterator[socket.socket]:
    with socket.socket() as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, TEN)
        yield made


def test_what_lingers_is_found_and_stopped(ours: socket.socket) -> None:
    assert lingering() == [TEN]
    release_links()
    assert lingering() == []


def test_once_a_client_has_a_link_to_a_router_no_socket_lingers(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    left: queue.SimpleQueue[int] = queue.SimpleQueue()

    def release() -> None:
        release_links()
        left.put(len(lingering()))

    monkeypatch.setattr("armadico.mesh.zenoh.release_links", release)
    router = ZenohMesh("linger", topology(router=True, robot=endpoint))
    with router, ZenohMesh("linger", topology(connect=endpoint)) as client:
        assert client.wait_joined(ENOUGH)
        counts = [left.get(timeout=ENOUGH) for _ in "ab"]  # both ends are in this process
        assert counts[-1] == 0
