"""A link that is closed holds up nobody: no socket of Zenoh's lingers once its link is up."""

from __future__ import annotations

import json
import os
import queue
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import zenoh

from armadico.mesh.linger import release_links
from armadico.mesh.ports import private_endpoints
from armadico.mesh.zenoh import SETTINGS, ZenohMesh
from armadico.runtime.client import Client

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
def ours() -> Iterator[socket.socket]:
    with socket.socket() as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, TEN)
        yield made


def test_what_lingers_is_found_and_stopped(ours: socket.socket) -> None:
    assert lingering() == [TEN]
    release_links()
    assert lingering() == []


def test_once_two_sessions_have_a_link_none_of_their_sockets_lingers(
    join: Callable[..., ZenohMesh], monkeypatch: pytest.MonkeyPatch
) -> None:
    left: queue.SimpleQueue[int] = queue.SimpleQueue()

    def release() -> None:
        release_links()
        left.put(len(lingering()))

    monkeypatch.setattr("armadico.mesh.zenoh.release_links", release)
    first, second = join(), join()
    counts = [left.get(timeout=ENOUGH) for _ in "ab"]  # both ends are in this process
    assert counts[-1] == 0
    assert Client(second).wait_for(lambda: first.met() and second.met(), ENOUGH)


def test_zenoh_alone_still_needs_it() -> None:
    endpoint = private_endpoints(1)

    def session(listen: str, *connect: str) -> zenoh.Session:
        config = zenoh.Config()
        ends = {"listen/endpoints": [listen], "connect/endpoints": list(connect)}
        for key, value in (SETTINGS | ends).items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    events = zenoh.handlers.FifoChannel(16)
    with session(endpoint) as first:
        links = first.info.declare_link_events_listener(events, history=True)
        with session("tcp/127.0.0.1:0", endpoint):
            links.recv()
            assert TEN in lingering()
