"""The dashboard as a process: on loopback, without effect on agents, and its errors."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import threading
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="the dashboard's extra is not installed")

from armadico.cli import main as armadico
from armadico.cli.additions import Start
from armadico.cli.options import FailedError, Mesh
from armadico.config.scenarios import Scenario
from armadico.core import messages as m
from armadico.launch.client import Client
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import OccupancyGrid
from armadico.watch.commands import dashboard as command
from armadico.watch.commands.dashboard_option import Dashboard
from armadico.watch.dashboard import viewer
from armadico.watch.screen import has_screen
from tests.programs import starter
from tests.watch.kept import GOTO, NAMESPACE, Kept, ack, ballot, cycle, state
from tests.watch.test_page import check_end_of

LINK = "dashboard: "
FLOOD = 10_000


@pytest.fixture
def router() -> Iterator[ZenohMesh]:
    """A router in place of a robot agent."""
    with ZenohMesh(NAMESPACE, topology(router=True)) as mesh:
        yield mesh


def client() -> ZenohMesh:
    return ZenohMesh(NAMESPACE, topology())


@contextmanager
def started(*options: str) -> Iterator[subprocess.Popen[str]]:
    with starter() as start:
        yield start("dashboard", "--port=0", f"--namespace={NAMESPACE}", *options)


def children(pid: int) -> list[int]:
    listed = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(child) for child in listed.split()]


def publish(mesh: ZenohMesh, number: int) -> None:
    mesh.publish("robot/state", state(number))
    mesh.publish("resource/wheels/ack", ack(number, GOTO))
    claim = m.Claim("wheels", ballot(GOTO), cycle(number), 0.6, wanted=(0.2, 0.1))
    mesh.publish("resource/wheels/utility", claim)


class Society:
    """Publishes the messages of a robot and goto."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self._mesh = mesh
        self._number = 0
        self._enough = threading.Semaphore(0)
        self._stopping = threading.Event()
        mesh.declare_alive("robot", "robot-0")
        self._thread = threading.Thread(target=self._publish)
        self._thread.start()

    def wait_cycles(self, cycles: int) -> None:
        """Return after this many more cycles have been published."""
        while self._enough.acquire(blocking=False):
            pass
        for _ in range(cycles):
            assert self._enough.acquire(timeout=10.0)

    def leave(self) -> None:
        self._stopping.set()
        self._thread.join()

    def _publish(self) -> None:
        while not self._stopping.wait(0.02):
            self._number += 1
            publish(self._mesh, self._number)
            self._enough.release()


@contextmanager
def society(mesh: ZenohMesh) -> Iterator[Society]:
    publishing = Society(mesh)
    try:
        yield publishing
    finally:
        publishing.leave()


@pytest.mark.long
@pytest.mark.live
def test_it_serves_records_and_leaves_nothing_behind(router: ZenohMesh, tmp_path: Path) -> None:
    path = tmp_path / "live.rrd"
    with (
        society(router) as robot,
        started("--web", "--web-port=0", "--no-open", f"--record={path}") as process,
    ):
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith(f"{LINK}http://127.0.0.1:"), process.communicate()
        page = line.removeprefix(LINK).strip()
        with urllib.request.urlopen(page, timeout=20) as answer:
            assert b"rerun" in answer.read().lower()
        binaries = children(process.pid)
        assert binaries
        robot.wait_cycles(100)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0, process.communicate()
        assert not any(Path(f"/proc/{pid}/cmdline").exists() for pid in binaries)
    kept = Kept(path)
    assert {u for _, u in kept.values("/p/utility/wheels/goto", "scalars")} == {0.6}


@pytest.mark.long
@pytest.mark.live
def test_a_dashboard_that_hangs_does_not_delay_agents(router: ZenohMesh) -> None:
    """It is stopped while one agent publishes 20 MB for it, far more than links buffer."""
    with (
        client() as mapping,
        client() as mesh,
        client() as other,
        started("--headless") as process,
    ):
        assert process.stdout is not None
        assert process.stdout.readline().startswith(LINK)
        listener = Client(other)
        received: list[int] = []
        listener.listen(m.Command, then=lambda message, _: received.append(message.cycle.number))
        listener.listen(m.RobotState)
        publish_until_received(mesh, listener)
        process.send_signal(signal.SIGSTOP)
        try:
            for number in range(FLOOD):
                grid = OccupancyGrid(0.0, 0.0, 0.1, 40, 50, b"x" * 2000)
                mapping.publish("mapping/grid", grid)
                if number % 100 == 0:
                    command = m.Command("wheels", cycle(number), ballot(GOTO), (0.0, 0.0))
                    mesh.publish(f"robot/cmd/{GOTO}", command)
                    listener.wait_for(lambda: None, 0.001)  # the queue of a key holds 64
            last = FLOOD - 100
            listener.wait_for(lambda: last in received, 20.0)
        finally:
            process.send_signal(signal.SIGCONT)
        assert received == list(range(0, FLOOD, 100))  # each one, in order
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0


def publish_until_received(mesh: ZenohMesh, listener: Client) -> None:
    while listener.latest(m.RobotState) is None:  # links come up in the background
        publish(mesh, 1)
        listener.wait_for(lambda: None, 0.02)


def starting(world: str) -> Start:
    """The start of a live run in a world."""
    scenario = Scenario(world=world, start=(0, 0, 0))
    return Start(scenario=scenario, mesh=Mesh(namespace=NAMESPACE), namespaces=(NAMESPACE,))


@pytest.mark.long
@pytest.mark.live
def test_a_run_waits_for_a_viewer_and_its_dashboard_stays_until_ctrl_c(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happened: list[str] = []
    read, write = os.pipe()

    def view() -> None:
        with os.fdopen(read) as output:
            data = urllib.parse.unquote(output.readline()).partition("http://127.0.0.1:")[2]
            port = int(data.partition("127.0.0.1:")[2].partition("/")[0])
            assert output.readline()
            happened.append("connects")
            with socket.create_connection(("127.0.0.1", port)):
                assert output.readline()
            happened.append("leaves")
            os.kill(os.getpid(), signal.SIGINT)

    connecting = threading.Thread(target=view)
    with os.fdopen(write, "w", buffering=1) as stderr:
        monkeypatch.setattr("sys.stderr", stderr)
        connecting.start()
        with Dashboard(wait=True).beside(starting("sc1")):
            happened.append("runs")
        connecting.join()
    assert happened == ["connects", "runs", "leaves"]


def test_a_port_is_watched_if_a_viewer_is_connected() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert not viewer.watched(port)
        with socket.create_connection(("127.0.0.1", port)):
            assert viewer.watched(port)


def test_without_its_world_the_dashboard_does_not_start_and_the_run_neither() -> None:
    dashboard = Dashboard(dashboard=True)
    with pytest.raises(FailedError), dashboard.beside(starting("nowhere")):
        pytest.fail("it has not started")


# Errors -------------------------------------------------------------------------------------------


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = armadico(["dashboard", *arguments])
    return code, capsys.readouterr().err


def test_without_the_extra_the_error_names_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> str:
        raise command.PackageNotFoundError(name)

    monkeypatch.setattr(command, "installed", missing)
    code, error = refusal(capsys)
    assert (code, "armadico[dashboard]" in error) == (1, True)


def test_a_port_in_use_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = used.getsockname()[1]
        code, error = refusal(capsys, "--headless", f"--port={port}")
    assert code == 1
    assert str(port) in error
    assert "--port 0" in error


def test_native_without_a_screen_suggests_the_other_options(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if has_screen(os.environ):
        pytest.skip("this system always has a screen")
    with pytest.raises(viewer.ViewerError, match=r"--native.*--web.*--headless"):
        viewer.native("rerun+http://127.0.0.1:1/proxy")


def test_a_virtual_run_is_recorded_for_rerun(tmp_path: Path) -> None:
    path = tmp_path / "new" / "run.rrd"
    assert (
        armadico(["run", "sc1", "--virtual", "--sensors", "ideal", "--json", "--rrd", str(path)])
        == 0
    )
    assert "/robot1/map/world/path" in Kept(path).rows


@pytest.mark.live
def test_a_viewer_whose_dashboard_is_killed_ends_too() -> None:
    with started("--web-port=0", "--no-open") as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(LINK)
        (child,) = children(process.pid)
        check_end_of(child, process)
