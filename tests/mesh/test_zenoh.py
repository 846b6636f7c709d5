"""What only Zenoh can show: endpoints, and a session that does not close."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, cast

import pytest

from armadico.mesh.topology import MeshError, Topology
from armadico.mesh.zenoh import ZenohMesh

pytestmark = pytest.mark.live

Join = Callable[..., ZenohMesh]
SOON = 10.0  # s; nothing here takes a tenth of it


def test_an_endpoint_that_is_taken_is_named(join: Join, endpoints: str) -> None:
    join()  # takes the first
    taken = endpoints.partition(",")[0]
    with pytest.raises(MeshError, match=taken):
        ZenohMesh("test", Topology(((taken,),), ())).open()


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
