"""A society of real processes with keys: its commands, and a restarted agent's own state."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

import armadico
from armadico.launch.client import Client
from armadico.mesh.ports import free_port
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.topology import HOSTS_VARIABLE, NAMESPACE_VARIABLE
from armadico.mobile.messages import Pose, Trajectory
from tests.programs import Done, Start, call, starter

pytestmark = pytest.mark.live

SOON_S = 20.0

TABLE = """\
keys = "keys"
[lab1]
router = "tcp/127.0.0.1:{port}"
agents = ["robot", "encoder", "sonar", "path-planning", "interface", "goto"]
[lab2]
address = "127.0.0.2"
agents = ["avoid"]
"""

DESK = '[desk]\naddress = "127.0.0.3"\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(NAMESPACE_VARIABLE, "closed")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.delenv(HOSTS_VARIABLE, raising=False)
    table = tmp_path / "lab.toml"
    table.write_text(TABLE.format(port=free_port("127.0.0.1")))
    made = call("keys", "init", "--hosts", str(table), "--host", "lab1")
    assert made.returncode == 0, made.stderr
    return tmp_path


@pytest.fixture
def run2() -> Iterator[str]:
    """The folder of the second computer's sockets, whose paths must be short."""
    with TemporaryDirectory(dir="/tmp", prefix="run2-") as folder:
        yield folder


def _up(start: Start, host: str, table: Path) -> None:
    """Start a host's share of the society; return once it is up."""
    up = start("up", "sc1", "--hosts", str(table), "--host", host)
    assert up.stdout is not None
    assert f"{host} is up" in up.stdout.readline(), up.communicate()


@pytest.mark.long
def test_a_society_with_keys_needs_no_further_option(folder: Path, run2: str) -> None:
    table, keys2 = folder / "lab.toml", folder / "lab2" / "keys"
    archive = call("keys", "host", "lab2", "--hosts", str(table), "--out", str(keys2))
    assert archive.returncode == 0, archive.stderr
    (folder / "lab2" / "lab.toml").write_text(table.read_text())
    here = dict(os.environ)
    elsewhere = here | {RUNTIME_VARIABLE: run2}
    of_lab2 = ("--hosts", str(folder / "lab2" / "lab.toml"))

    def does(*words: str, env: dict[str, str], code: int = 0) -> Done:
        done = call(*words, env=env)
        assert done.returncode == code, (words, done.stdout, done.stderr)
        assert "has no right" not in done.stderr, words
        return done

    with starter(env=here) as start, starter(env=elsewhere) as start_elsewhere:
        _up(start, "lab1", table)
        _up(start_elsewhere, "lab2", folder / "lab2" / "lab.toml")

        # On the robot's computer by its socket, without the table; elsewhere by TLS.
        for words, env in (((), here), (of_lab2, elsewhere)):
            listed = call("ps", "--json", *words, env=env)
            assert listed.stdout, listed
            found = json.loads(listed.stdout)
            names = {agent["name"] for agent in found["agents"]}
            assert {"robot", "encoder", "interface", "goto", "avoid"} <= names
            assert "stopped" in does("stop", *words, env=env).stdout
            assert "free to move" in does("resume", *words, env=env).stdout
            assert "v_max" in does("get", "goto", *words, env=env).stdout
        assert "goal is reached" in does("goto", "1.0", "0.0", env=here).stdout

        # Nothing that an honest process sends is dropped.
        logs = [*folder.glob("armadico-*/*.log")]
        assert {"goto.log", "avoid.log", "interface.log"} <= {log.name for log in logs}
        assert not [log.name for log in logs if "has no right" in log.read_text()]

        # Without a usable key nothing is read, and a stop still reaches the robot agent.
        private = folder / "keys" / "closed"
        for key in private.glob("person-*/private.key"):
            key.chmod(0o644)
        assert "chmod 600" in does("ps", env=here, code=2).stderr
        assert "told to stop" in does("stop", env=here, code=3).stderr
        for key in private.glob("person-*/private.key"):
            key.chmod(0o600)
        assert "stopped by" in call("goto", "2.0", "0.0", "--timeout", "3", env=here).stdout
        does("down", env=here)


@pytest.mark.long
def test_a_revoked_computer_is_out_while_the_robot_drives_on_and_a_desk_stops_it(
    folder: Path, run2: str
) -> None:
    """Also once the computer has a new archive: its old one is void."""
    table = folder / "lab.toml"
    table.write_text(table.read_text().replace('["avoid"]', '["avoid", "goto"]') + DESK)
    for host in ("lab2", "desk"):
        made = call("keys", "host", host, "--hosts", str(table), "--out", str(folder / host / "k"))
        assert made.returncode == 0, made.stderr
        keys = 'keys = "keys"'
        (folder / host / "lab.toml").write_text(table.read_text().replace(keys, 'keys = "k"'))
    here = dict(os.environ)
    elsewhere = here | {RUNTIME_VARIABLE: run2}
    of_lab2, of_desk = (("--hosts", str(folder / h / "lab.toml")) for h in ("lab2", "desk"))
    with starter(env=here) as start, starter(env=elsewhere) as start_elsewhere:
        _up(start, "lab1", table)
        _up(start_elsewhere, "lab2", folder / "lab2" / "lab.toml")
        with armadico.connect("closed") as guest:

            def alive() -> list[str]:
                return sorted(name for name, _ in guest.alive)

            assert guest.wait_for(lambda: alive().count("goto") == 2 and "avoid" in alive(), SOON_S)
            gone = call("keys", "revoke", "lab2", "--hosts", str(table), "--host", "lab1")
            assert gone.returncode == 0, gone.stderr
            assert "lab2 loses" in gone.stdout
            assert guest.wait_for(lambda: alive().count("goto") == 1, SOON_S), alive()
            assert guest.wait_for(lambda: "avoid" not in alive(), SOON_S), alive()
        new = call("keys", "host", "lab2", "--hosts", str(table), "--out", str(folder / "new"))
        assert new.returncode == 0, new.stderr
        assert call("stop", *of_lab2, "--host", "lab2", env=elsewhere).returncode != 0
        assert "goal is reached" in call("goto", "1.0", "0.0", env=here).stdout
        stopped = call("stop", *of_desk, "--host", "desk", env=elsewhere)
        assert stopped.returncode == 0, stopped.stderr
        assert "stopped" in stopped.stdout
        call("down", env=elsewhere)
        assert call("down", env=here).returncode == 0


def test_a_mission_outlives_its_interface_agent(folder: Path) -> None:
    """Its successor is given the state that it signed."""
    with starter(env=dict(os.environ)) as start:
        _up(start, "lab1", folder / "lab.toml")
        with armadico.connect("closed") as guest:
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
