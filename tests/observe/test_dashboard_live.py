"""The dashboard as a process: served on loopback, felt by nobody, clear when it cannot be had."""

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

from armadico.cli import dashboard as command
from armadico.cli import main as armadico
from armadico.cli.beside import beside
from armadico.cli.options import FailedError, Mesh
from armadico.core import messages as m
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import OccupancyGrid
from armadico.observe.dashboard import live, viewer
from armadico.observe.screen import has_screen
from armadico.runtime.client import Client
from tests.observe.kept import GOTO, NAMESPACE, Kept, ack, ballot, cycle, drawn, state
from tests.programs import heavy, imports_nothing, starter

LINK = "dashboard: "
FLOOD = 10_000


@pytest.fixture
def router() -> Iterator[ZenohMesh]:
    """The router that a robot agent would be."""
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
    """A robot and goto, as far as they are heard."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self._mesh = mesh
        self._number = 0
        self._enough = threading.Semaphore(0)
        self._stopping = threading.Event()
        mesh.declare_alive("robot", "robot-0")
        self._thread = threading.Thread(target=self._talk)
        self._thread.start()

    def say(self, cycles: int) -> None:
        """Return when so many more cycles have been said."""
        while self._enough.acquire(blocking=False):
            pass
        for _ in range(cycles):
            assert self._enough.acquire(timeout=10.0)

    def leave(self) -> None:
        self._stopping.set()
        self._thread.join()

    def _talk(self) -> None:
        while not self._stopping.wait(0.02):
            self._number += 1
            publish(self._mesh, self._number)
            self._enough.release()


@contextmanager
def society(mesh: ZenohMesh) -> Iterator[Society]:
    talking = Society(mesh)
    try:
        yield talking
    finally:
        talking.leave()


@pytest.mark.live
def test_it_serves_records_and_leaves_nothing_behind(router: ZenohMesh, tmp_path: Path) -> None:
    path = tmp_path / "live.rrd"
    with (
        society(router) as robot,
        started("--web", "--web-port=0", "--no-open", f"--record={path}") as process,
    ):
        assert process.stdout is not None
        said = process.stdout.readline()
        assert said.startswith(f"{LINK}http://127.0.0.1:"), process.communicate()
        page = said.removeprefix(LINK).strip()
        with urllib.request.urlopen(page, timeout=20) as answer:
            assert b"rerun" in answer.read().lower()
        binaries = children(process.pid)
        assert binaries
        robot.say(100)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0, process.communicate()
        assert not any(Path(f"/proc/{pid}/cmdline").exists() for pid in binaries)
    kept = Kept(path)
    assert {u for _, u in kept.values("/p/utility/wheels/goto", "scalars")} == {0.6}


@pytest.mark.live
def test_a_dashboard_that_hangs_is_not_felt(router: ZenohMesh) -> None:
    """It is stopped while one agent publishes 20 MB for it, far more than links hold."""
    with (
        client() as mapping,
        client() as mesh,
        client() as other,
        started("--headless") as process,
    ):
        assert process.stdout is not None
        assert process.stdout.readline().startswith(LINK)
        listener = Client(other)
        heard: list[int] = []
        listener.listen(m.Command, then=lambda message, _: heard.append(message.cycle.number))
        listener.listen(m.RobotState)
        publish_until_heard(mesh, listener)
        process.send_signal(signal.SIGSTOP)
        try:
            for number in range(FLOOD):
                grid = OccupancyGrid(0.0, 0.0, 0.1, 40, 50, b"x" * 2000)
                mapping.publish("mapping/grid", grid)
                if number % 100 == 0:
                    command = m.Command("wheels", cycle(number), ballot(GOTO), (0.0, 0.0))
                    mesh.publish(f"robot/cmd/{GOTO}", command)
                    listener.wait_for(lambda: None, 0.001)  # of one key 64 may wait
            last = FLOOD - 100
            listener.wait_for(lambda: last in heard, 20.0)
        finally:
            process.send_signal(signal.SIGCONT)
        assert heard == list(range(0, FLOOD, 100))  # each one, in order
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0


def publish_until_heard(mesh: ZenohMesh, listener: Client) -> None:
    while listener.latest(m.RobotState) is None:  # links come up in the background
        publish(mesh, 1)
        listener.wait_for(lambda: None, 0.02)


@pytest.mark.live
def test_beside_a_run_it_prints_its_link_and_ends_with_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    args = Mesh(namespace=NAMESPACE)
    with beside(args, "dashboard", "sc1"):
        page = capsys.readouterr().err.removeprefix(LINK).strip()
        with urllib.request.urlopen(page, timeout=20) as answer:
            assert answer.status == 200
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page, timeout=20)


@pytest.mark.live
def test_a_run_waits_until_somebody_looks_and_its_dashboard_stays_until_ctrl_c(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    args = Mesh(namespace=NAMESPACE)
    happened: list[str] = []
    read, write = os.pipe()

    def look() -> None:
        with os.fdopen(read) as told:
            data = urllib.parse.unquote(told.readline()).partition("http://127.0.0.1:")[2]
            port = int(data.partition("127.0.0.1:")[2].partition("/")[0])
            assert "open the link" in told.readline()
            happened.append("looks")
            with socket.create_connection(("127.0.0.1", port)):
                assert "the run is over" in told.readline()
            happened.append("leaves")
            os.kill(os.getpid(), signal.SIGINT)

    looker = threading.Thread(target=look)
    with os.fdopen(write, "w", buffering=1) as told:
        monkeypatch.setattr("sys.stderr", told)
        looker.start()
        with beside(args, "dashboard", "sc1", wait=True):
            happened.append("runs")
        looker.join()
    assert happened == ["looks", "runs", "leaves"]


def test_a_viewer_is_who_is_connected_and_not_who_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert not viewer.watched(port)
        with socket.create_connection(("127.0.0.1", port)):
            assert viewer.watched(port)


def test_beside_a_run_a_world_that_is_not_there_is_no_run() -> None:
    args = Mesh(namespace=NAMESPACE)
    with pytest.raises(FailedError, match="did not start"), beside(args, "dashboard", "nowhere"):
        pytest.fail("it has not started")


def test_a_namespace_without_a_robot_is_said(
    router: ZenohMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "ALONE_S", 0.0)
    said: list[str] = []
    with client() as mesh, drawn(tmp_path / "a.rrd") as scene:
        live.Live([mesh], [scene], said.append).run(ended=lambda: bool(said))
    assert said[0].startswith("no robot in namespace 'p'")


# Used wrongly -------------------------------------------------------------------------------------


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = armadico(["dashboard", *arguments])
    return code, capsys.readouterr().err


def test_without_the_extra_it_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> str:
        raise command.PackageNotFoundError(name)

    monkeypatch.setattr(command, "installed", missing)
    code, said = refusal(capsys)
    assert (code, "pip install 'armadico[dashboard]'" in said) == (1, True)


def test_another_version_of_rerun_is_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "installed", lambda name: "0.30.1")
    assert all(version in refusal(capsys)[1] for version in ("0.30.1", "0.41"))


def test_a_port_that_is_taken_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, said = refusal(capsys, "--headless", f"--port={port}")
    assert code == 1
    assert f"port {port} cannot be used" in said
    assert "--port 0 takes one that is free" in said


def test_native_without_a_screen_offers_the_other_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if has_screen(os.environ):
        pytest.skip("this system always has a screen")
    with pytest.raises(viewer.ViewerError, match="--native needs a screen"):
        viewer.native("rerun+http://127.0.0.1:1/proxy")


def test_a_viewer_without_graphics_says_what_it_found() -> None:
    words = "Error: No graphics adapter was found"
    assert "mesa-vulkan-drivers" in str(viewer._explained(words))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--record", "x.mcap"], ".rrd"),
        (["--record", "/proc/none/x.rrd"], "cannot write"),
        (["--namespace", "a b"], "cannot be a namespace"),
        (["--world", "nowhere"], "nowhere"),
    ],
)
def test_bad_arguments_are_refused_before_anything_starts(
    capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    code, said = refusal(capsys, *arguments)
    assert code in (1, 2)
    assert expected in said


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["sc1", "--virtual", "--dashboard"], "--rrd FILE"),
        (["sc1", "--virtual", "--wait"], "--rrd FILE"),
        (["sc1", "--wait", "--runs", "2"], "--wait is for one run"),
        (["sc1", "--rrd", "x.rrd"], "--rrd is for --virtual"),
        (["sc1", "--virtual", "--rrd", "x.csv"], ".rrd"),
    ],
)
def test_a_run_says_which_of_the_two_it_offers(
    capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    assert armadico(["run", *arguments]) == 2
    assert expected in capsys.readouterr().err


def test_a_virtual_run_is_kept_for_rerun(tmp_path: Path) -> None:
    path = tmp_path / "new" / "run.rrd"
    assert (
        armadico(["run", "sc1", "--virtual", "--sensors", "ideal", "--json", "--rrd", str(path)])
        == 0
    )
    assert "/robot1/map/world/path" in Kept(path).rows


def test_help_imports_nothing_heavy() -> None:
    among = ("numpy", "zenoh", "rerun", "msgspec")
    assert imports_nothing(heavy("armadico.cli", ["dashboard", "--help"], among))
