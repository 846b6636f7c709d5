"""What only Zenoh can show: endpoints, and a session that does not close."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any, cast

import pytest

from armadico.mesh.topology import ENDPOINTS_VARIABLE, MeshError, Topology, topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.runtime.client import Client

pytestmark = pytest.mark.live

Join = Callable[..., ZenohMesh]
SOON = 10.0  # s; nothing here takes a tenth of it


def test_an_endpoint_that_is_taken_is_named(join: Join, endpoints: str) -> None:
    join()  # takes the first
    taken = endpoints.partition(",")[0]
    with pytest.raises(MeshError, match=taken):
        ZenohMesh("test", Topology(((taken,),), ())).open()


def test_when_all_who_had_a_well_known_endpoint_are_gone_those_who_are_left_can_be_met(
    join: Join, endpoints: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.mesh.repair.LOOK_S", (0.0, 0.1))
    first = [join() for _ in endpoints.split(",")]
    rest = [join() for _ in range(2)]
    for number, mesh in enumerate(rest):
        mesh.declare_alive("left", str(number))
    for mesh in first:
        mesh.close()
    where = topology(passing=True, environ={ENDPOINTS_VARIABLE: endpoints})
    with ZenohMesh(rest[0].namespace, where) as knows_only_these:
        client = Client(knows_only_these)
        assert client.wait_for(lambda: client.alive == {("left", "0"), ("left", "1")}, SOON)
        rest[0].close()  # with the endpoint that it may have taken
        assert client.wait_for(lambda: client.alive == {("left", "1")}, SOON)


LEFT_OPEN = """
import armadico
joined = armadico.connect("test")
guest = joined.__enter__()
guest.latest(armadico.Pose)
assert guest.wait_for(lambda: guest.alive, 10.0)
raise ValueError("over")
"""


def test_a_program_that_ends_by_an_exception_ends_though_its_mesh_is_open(
    join: Join, endpoints: str
) -> None:
    join().declare_alive("goto", "goto-1")
    ended = subprocess.run(
        [sys.executable, "-c", LEFT_OPEN],
        env={**os.environ, ENDPOINTS_VARIABLE: endpoints},
        capture_output=True,
        text=True,
        timeout=6 * SOON,
        check=False,
    )
    assert ended.returncode == 1
    assert ended.stderr.endswith("ValueError: over\n")


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
