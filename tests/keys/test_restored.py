"""With keys a restarted author is given its own state back, as its predecessor signed it."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

import armadico
from armadico.launch.client import Client
from armadico.mesh.ports import free_port
from armadico.mesh.topology import HOSTS_VARIABLE, NAMESPACE_VARIABLE
from armadico.mobile.messages import Pose, Trajectory
from tests.programs import call, starter

pytestmark = pytest.mark.live

TABLE = """\
keys = "keys"
[lab1]
router = "tcp/127.0.0.1:{port}"
agents = ["robot", "encoder", "sonar", "path-planning", "interface", "goto"]
"""
SOON_S = 20.0


def test_a_mission_outlives_its_interface_agent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NAMESPACE_VARIABLE, "signed")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.delenv(HOSTS_VARIABLE, raising=False)
    table = tmp_path / "lab.toml"
    table.write_text(TABLE.format(port=free_port("127.0.0.1")))
    assert call("keys", "init", "--hosts", str(table), "--host", "lab1").returncode == 0
    with starter(env=dict(os.environ)) as start:
        up = start("up", "sc1", "--hosts", str(table), "--host", "lab1")
        assert up.stdout is not None
        assert up.stdout.readline()
        with armadico.connect("signed") as guest:
            authors: list[str] = []
            guest.listen(Trajectory, then=lambda *_: authors.append(guest.key.rpartition("/")[2]))
            assert guest.wait_for(lambda: _interface(guest), SOON_S)
            assert guest.latest(Pose, SOON_S) is not None
            guest.goto(3.0, 0.0, 0.0, direct=True)
            assert guest.wait_for(lambda: authors, SOON_S)
            mission = guest.latest(Trajectory)
            assert mission is not None
            guest.stop(by="the test")  # it must not arrive meanwhile
            before = _interface(guest)
            assert authors[-1] == before
            card = guest.card("interface", before)
            assert card is not None
            os.kill(card.pid, signal.SIGKILL)
            assert guest.wait_for(lambda: authors[-1] not in ("", before), SOON_S)
            assert authors[-1] == _interface(guest)
            again = guest.latest(Trajectory)
            assert again is not None
            assert again.waypoints == mission.waypoints != ()
            guest.resume(by="the test")
        assert call("down").returncode == 0


def _interface(guest: Client) -> str:
    return next((instance for name, instance in guest.alive if name == "interface"), "")
