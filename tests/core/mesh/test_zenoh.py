"""Opening and closing real sessions: endpoints that cannot be used, and programs that end."""

from __future__ import annotations

import signal
import socket
import sys
import threading
from typing import Any, cast

import pytest

from armadico.core.messages import Stop
from armadico.mesh.ports import LOOPBACK, free_port
from armadico.mesh.topology import MeshError, topology
from armadico.mesh.zenoh import ZenohMesh
from tests.programs import call

from .conftest import Join, SpawnRouter

pytestmark = pytest.mark.live

SOON = 10.0  # s; nothing here takes a tenth of it


# Endpoints ----------------------------------------------------------------------------------------


def test_an_endpoint_that_another_process_has_is_named() -> None:
    with socket.create_server((LOOPBACK, free_port())) as taken:
        endpoint = f"tcp/{LOOPBACK}:{taken.getsockname()[1]}"
        with pytest.raises(MeshError, match=f"{endpoint}: another process uses that port"):
            ZenohMesh("endpoints", topology(router=True, robot=endpoint)).open()
    with ZenohMesh("endpoints", topology(router=True, robot=endpoint)):
        pass  # the failed attempt has left nothing behind


def test_an_endpoint_that_is_not_this_computers_is_named() -> None:
    with pytest.raises(
        MeshError, match=r"192\.0\.2\.1:7447: that is not an address of this machine"
    ):
        ZenohMesh("endpoints", topology(router=True, robot="tcp/192.0.2.1:7447")).open()


# Programs that end --------------------------------------------------------------------------------

LEFT_OPEN = """
import armadico
joined = armadico.connect("left-open")
guest = joined.__enter__()
guest.latest(armadico.Pose)
assert guest.wait_for(lambda: guest.alive, 10.0)
raise ValueError("over")
"""

NEVER_JOINED = """
import armadico
joined = armadico.connect("left-open")
joined.__enter__().latest(armadico.Pose)
raise ValueError("over")
"""


def ends(program: str) -> bool:
    """Whether a program that leaves its session open ends by its own exception."""
    ended = call("-c", program, program=sys.executable)
    assert ended.stderr.endswith("ValueError: over\n"), ended.stderr
    return ended.returncode == 1


def test_a_program_that_ends_by_an_exception_ends_though_its_mesh_is_open(join: Join) -> None:
    join("left-open").declare_alive("goto", "goto-1")
    assert ends(LEFT_OPEN)


def test_a_program_that_still_waits_for_its_router_ends() -> None:
    assert ends(NEVER_JOINED)


def test_a_program_that_waits_for_a_router_that_hangs_ends(spawn_router: SpawnRouter) -> None:
    router = spawn_router("left-open")
    router.send_signal(signal.SIGSTOP)
    assert ends(NEVER_JOINED)
    router.send_signal(signal.SIGCONT)


def test_a_session_that_does_not_close_is_left_behind(join: Join) -> None:
    mesh = join()
    stuck = threading.Event()

    class Stuck:
        def close(self) -> None:
            stuck.wait(SOON)

    session, mesh._session = mesh._session, cast("Any", Stuck())
    assert mesh.close(deadline=0.01) is False
    stuck.set()
    mesh._session = session


def test_a_client_that_was_closed_before_it_joined_can_be_used_no_more() -> None:
    mesh = ZenohMesh("never-joined", topology())
    mesh.open()
    mesh.close()
    with pytest.raises(MeshError):
        mesh.publish("robot/stop", Stop())
    with pytest.raises(MeshError):
        mesh.subscribe("encoder/pose", lambda _key, _data: None)
    with pytest.raises(MeshError):
        mesh.declare_alive("goto", "goto-1")
