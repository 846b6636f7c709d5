"""Where a robot's socket is, which process listens on it, and which robots are a fleet."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from armadico.mesh.sockets import (
    IDENTITY,
    LONGEST,
    RUNTIME_VARIABLE,
    clear,
    elsewhere,
    endpoint,
    folder,
    guard_now,
    guard_of,
    holder,
    identity,
    lock_of,
    peer_sockets,
    peers_here,
    robots_here,
    share_of,
    socket_of,
    starting,
    stop,
)
from armadico.mesh.topology import MeshError, TopologyError, topology
from armadico.mesh.zenoh import ZenohMesh
from tests.runtime_folder import fresh_folder, locked

from .conftest import SpawnRouter


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder with a short path, for the sockets of one test."""
    made = Path(fresh_folder())
    monkeypatch.setenv(RUNTIME_VARIABLE, str(made))
    return made


@pytest.fixture
def without_runtime_folder(base: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No folder is given, and the folder for temporary files is empty."""
    monkeypatch.delenv(RUNTIME_VARIABLE)
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(base))
    return base


@contextmanager
def listening(path: Path) -> Iterator[None]:
    """Listen on a socket as a router does; afterwards its file is left behind, as by a kill."""
    path.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as server:
        server.bind(str(path))
        server.listen()
        yield


# The folder ---------------------------------------------------------------------------------------


def test_sockets_are_in_a_folder_of_this_users_alone(base: Path) -> None:
    assert socket_of("robot1") == base / "armadico" / "robot1.sock"
    assert stat.S_IMODE(folder().stat().st_mode) == 0o700


def test_without_a_runtime_folder_they_are_in_one_of_this_users_beside_temporary_files(
    without_runtime_folder: Path,
) -> None:
    made = folder()
    assert made.parent == without_runtime_folder
    assert str(os.getuid()) in made.name
    assert stat.S_IMODE(made.stat().st_mode) == 0o700


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write to every folder")
def test_a_runtime_folder_that_cannot_be_written_to_counts_as_none(
    without_runtime_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shut = without_runtime_folder / "shut"
    shut.mkdir(mode=0o500)
    monkeypatch.setenv(RUNTIME_VARIABLE, str(shut))
    assert folder().parent == without_runtime_folder


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_folder_that_others_can_write_to_is_refused(base: Path, mode: int) -> None:
    folder().chmod(mode)
    with pytest.raises(TopologyError, match=f"chmod 700 {base / 'armadico'}"):
        socket_of("robot1")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
def test_a_folder_of_another_user_is_refused(base: Path) -> None:
    os.chown(folder(), os.getuid() + 1, -1)
    with pytest.raises(TopologyError, match=f"{base / 'armadico'} belongs to another user"):
        folder()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
@pytest.mark.parametrize("home", [True, False])
def test_beside_temporary_files_another_user_can_be_first_and_it_costs_nothing(
    without_runtime_folder: Path, monkeypatch: pytest.MonkeyPatch, home: bool
) -> None:
    os.chown(folder(), 65534, 65534)
    if home:
        monkeypatch.setenv("HOME", str(without_runtime_folder))
        assert folder() == without_runtime_folder / ".armadico.run"
        assert folder().stat().st_uid == os.getuid()
        return

    def none() -> Path:
        raise RuntimeError("could not determine home directory")

    monkeypatch.setattr(Path, "home", none)
    with pytest.raises(TopologyError, match=f"another user; set {RUNTIME_VARIABLE}"):
        folder()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
def test_the_folder_that_a_process_uses_counts_when_another_users_folder_goes(
    without_runtime_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(without_runtime_folder))
    taken = folder()
    os.chown(taken, 65534, 65534)
    home = folder()
    with locked(lock_of(socket_of("robot1"))):
        taken.rmdir()
        assert folder() == home
    assert folder() == taken


@pytest.mark.parametrize("deleted", [False, True])
def test_a_robot_that_runs_with_another_runtime_folder_is_found(
    base: Path, monkeypatch: pytest.MonkeyPatch, deleted: bool
) -> None:
    # Names of this process: the robots of the whole computer are searched.
    lab, r2 = f"lab/r{os.getpid()}", f"r{os.getpid()}-2"
    other = Path(fresh_folder())
    here = folder()
    monkeypatch.setenv(RUNTIME_VARIABLE, str(other))
    with locked(lock_of(socket_of(lab))), locked(share_of(r2, "desk")):
        assert (elsewhere(lab), elsewhere(r2)) == ({}, {})
        if deleted:
            shutil.rmtree(other)
        monkeypatch.setenv(RUNTIME_VARIABLE, str(base))
        assert folder() == here
        assert elsewhere(lab) == {other / "armadico": os.getpid()}
        assert elsewhere(r2) == {other / "armadico": os.getpid()}
        assert elsewhere(lab.removeprefix("lab/")) == {}


def test_a_society_is_starting_while_its_share_is_young_and_runs(base: Path) -> None:
    path = share_of("robot1", "desk")
    path.touch()
    assert not starting("robot1", 1e6)
    with locked(path):
        assert starting("robot1", 1e6)
        assert not starting("robot2", 1e6)
        os.utime(path, (0, 0))
        assert not starting("robot1", 1e6)


def test_the_robots_of_this_computer_are_those_that_run(base: Path) -> None:
    lock_of(socket_of("ended")).touch()
    with (
        locked(lock_of(socket_of("lab/r1"))),
        locked(share_of("lab/r1", "desk")),
        locked(share_of("r_2", "desk")),
        locked(lock_of(socket_of(NAMES[0]))),
    ):
        found = robots_here()
    assert {"lab/r1", "r_2"} <= {*found} <= {"lab/r1", "r_2", NAMES[0]}


@pytest.mark.live
def test_a_folder_where_the_socket_would_be_is_an_error_that_says_so(base: Path) -> None:
    socket_of("robot1").mkdir()
    mesh = ZenohMesh("robot1", topology(router=True))
    with pytest.raises(MeshError, match="is a folder, and the socket would be there: remove it"):
        mesh.open()
    assert base.exists()


CAUGHT = """
import fcntl, signal, sys
signal.signal(signal.SIGUSR1, lambda *_: print("stopped", flush=True))
file = open(sys.argv[1], "w")
fcntl.flock(file, fcntl.LOCK_EX)
print("locked", flush=True)
sys.stdin.read()
"""


def test_a_stop_is_a_signal_to_the_process_that_has_the_lock_if_it_knows_the_signal(
    base: Path,
) -> None:
    assert base.exists()
    lock = socket_of("robot1").with_name("robot1.sock.lock")
    pipe = subprocess.PIPE
    words = [sys.executable, "-c", CAUGHT, str(lock)]
    assert stop("robot1").pid is None, "no process"
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        assert stop("robot2").pid is None, "another robot"
        assert stop("robot1").pid == process.pid
        assert process.stdout.readline() == "stopped\n"
        process.communicate("")
    words[2] = "\n".join(row for row in CAUGHT.splitlines() if "SIGUSR1" not in row)
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert stop("robot1").pid is None, "the signal would end it"
        process.communicate("")
        assert process.returncode == 0


def test_where_the_robot_is_not_the_hosts_launcher_gets_the_signal(base: Path) -> None:
    assert base.exists()
    pipe = subprocess.PIPE
    words = [sys.executable, "-c", CAUGHT, str(share_of("lab/r1", "desk"))]
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        assert stop("lab/r2").pid is None, "another robot's"
        assert stop("lab/r1").pid == process.pid
        assert process.stdout.readline() == "stopped\n"
        process.communicate("")
        assert stop("lab/r1").pid is None, "it has ended, and its file stays"


@pytest.mark.parametrize(
    ("words", "stopped"),
    [
        ("stop", "robot1"),
        ("stop --namespace lab/a/r1 --timeout=3", "lab/a/r1"),
        ("stop --timeout 3 --namespace=lab/r1", "lab/r1"),
        ("stop --hosts lab.toml --host desk", "robot1"),
        ("stop --help", ""),
        ("stop --namespace", ""),
        ("stop --connect tcp/10.0.0.1:7447", ""),
        ("stop now", ""),
        ("ps --namespace robot1", ""),
    ],
)
def test_the_command_stops_a_robot_before_python_starts_only_if_its_words_are_certain(
    words: str, stopped: str, base: Path
) -> None:
    program = _command(base)
    names = ("robot1", "lab/r1", "lab/a/r1")
    with ExitStack() as stack:
        guards = {name: stack.enter_context(_signalled(name)) for name in names}
        done = subprocess.run(
            [program, *words.split()],
            env={**os.environ, "ARMADICO_NAMESPACE": "robot1"},
            capture_output=True,
            text=True,
            check=True,
        )
        assert (done.stdout, done.stderr) == (f"{words}\n", "")
        for process in guards.values():
            process.terminate()
        ended = {name: process.wait() for name, process in guards.items()}
    assert ended == {
        name: -signal.SIGUSR1 if name == stopped else -signal.SIGTERM for name in names
    }


def test_a_guard_on_a_busy_computer_answers_late_and_is_heard(base: Path) -> None:
    place = guard_of("robot1")
    place.parent.mkdir(exist_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as guard:
        guard.bind(str(place))
        assert guard_now("robot1", within=0.01) is None  # this question is answered to nobody
        guard.recvfrom(64)

        def answer() -> None:
            _, asker = guard.recvfrom(64)
            threading.Event().wait(0.5)  # longer than the usual patience
            guard.sendto(b"holds 7 8", asker)

        late = threading.Thread(target=answer)
        late.start()
        try:
            assert guard_now("robot1", within=60.0) == ("holds", 7, 8)
        finally:
            late.join()


def test_the_command_signals_no_process_that_has_the_pid_of_an_ended_one(base: Path) -> None:
    program = _command(base)
    with _signalled("robot1") as process:
        place = guard_of("robot1").with_suffix(IDENTITY)
        pid, start = identity(process.pid).split()
        for text in (f"{pid} {int(start) + 1}", pid, "", f"999999999 {start}", "no number"):
            place.write_text(f"{text}\n")
            subprocess.run([program, "stop"], check=True, capture_output=True)
        process.terminate()
        assert process.wait() == -signal.SIGTERM


def test_what_belongs_to_no_process_is_removed(base: Path) -> None:
    with listening(socket_of("robot1")):
        clear("robot1")
        assert socket_of("robot1").exists()
    clear("robot1")
    assert not list((base / "armadico").iterdir())


def _command(base: Path) -> str:
    """The command `armadico`, whose program prints its words."""
    folder = base / "bin"
    folder.mkdir()
    program = shutil.copy(Path(__file__).parents[3] / "deploy" / "bin" / "armadico", folder)
    echo = folder / "armadico-command"
    echo.write_text('#!/bin/sh\necho "$@"\n')
    echo.chmod(0o755)
    link = base / "link"
    link.symlink_to(program)
    return str(link)


@contextmanager
def _signalled(namespace: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process in the place of a robot's guard; the signal ends it."""
    with subprocess.Popen(["sleep", "30"]) as process:
        guard_of(namespace).with_suffix(IDENTITY).write_text(f"{identity(process.pid)}\n")
        try:
            yield process
        finally:
            process.kill()


# Paths --------------------------------------------------------------------------------------------

LONG = "a-robot-with-a-name-that-is-as-long-as-it-may-be-" + "x" * 40
NAMES = [LONG, LONG[:-1] + "y", f"lab/{LONG}", f"lab/{LONG[:-1]}y", f"yard/{LONG}"]


def test_every_namespace_has_a_socket_of_its_own_that_the_system_takes(base: Path) -> None:
    short = ["robot1", "robot-1", "lab/r1", "lab-r1", "lab_r1", "lab.r1", "lab/r/1", "r1"]
    paths = [socket_of(name) for name in (*NAMES, *short)]
    assert len(set(paths)) == len(paths)
    for path in paths:
        assert path.parent == base / "armadico"
        with listening(path):
            assert holder(path) is not None


def test_a_folder_with_too_long_a_path_is_an_error_that_names_the_limit(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = base / ("d" * LONGEST)
    deep.mkdir()
    monkeypatch.setenv(RUNTIME_VARIABLE, str(deep))
    with pytest.raises(TopologyError, match=f"{LONGEST}.*{RUNTIME_VARIABLE}"):
        socket_of("robot1")


@pytest.mark.live
def test_robots_with_long_namespaces_find_their_routers(base: Path) -> None:
    with ExitStack() as stack:
        for name in NAMES[:2]:
            stack.enter_context(ZenohMesh(name, topology(router=True)))
            client = stack.enter_context(ZenohMesh(name, topology()))
            assert client.wait_joined(10.0)


# Which process listens ----------------------------------------------------------------------------


def test_the_holder_of_a_socket_is_the_process_that_listens_on_it(base: Path) -> None:
    path = base / "a.sock"
    assert holder(path) is None
    with listening(path):
        assert holder(path) == os.getpid()
    assert path.exists()
    assert holder(path) is None, "the process that left it behind has ended"


@pytest.mark.live
def test_a_second_router_of_a_namespace_is_an_error_that_names_the_process_of_the_first(
    spawn_router: SpawnRouter,
) -> None:
    first = spawn_router("twice")
    with pytest.raises(MeshError, match=rf"\b{first.pid}\b.*'twice'"):
        ZenohMesh("twice", topology(router=True)).open()
    with ZenohMesh("twice", topology()) as client:
        assert client.wait_joined(10.0), "the first goes on"
    first.kill()
    first.wait()
    with ZenohMesh("twice", topology(router=True)), ZenohMesh("twice", topology()) as client:
        assert client.wait_joined(10.0), "a killed router leaves nothing in the way"


# Fleets -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("one", "other", "is_fleet"),
    [
        ("r1", "r2", True),
        ("lab/r1", "lab/r2", True),
        ("a/b/r1", "a/b/r2", True),
        (f"lab/{LONG}", "lab/r1", True),
        (f"lab/{LONG}", f"lab/{LONG[:-1]}y", True),
        (LONG, "r1", True),
        ("r1", "lab/r1", False),
        ("lab/r1", "yard/r1", False),
        ("lab/r1", "lab/a/r1", False),
        ("lab/r1", "la/r1", False),
        (f"lab/{LONG}", f"yard/{LONG}", False),
        (f"lab/{LONG}", LONG, False),
    ],
)
@pytest.mark.usefixtures("base")
def test_robots_whose_namespaces_have_the_same_beginning_are_a_fleet(
    one: str, other: str, is_fleet: bool
) -> None:
    with listening(socket_of(one)), listening(socket_of(other)):
        assert (socket_of(other) in peer_sockets(one)) == is_fleet
        assert (socket_of(one) in peer_sockets(other)) == is_fleet
        assert (endpoint(socket_of(other)) in peers_here(one)) == is_fleet


@pytest.mark.usefixtures("base")
def test_a_robot_whose_router_was_killed_is_not_here_though_its_socket_is() -> None:
    with listening(socket_of("lab/r2")):
        pass
    assert peer_sockets("lab/r1") == [socket_of("lab/r2")]
    assert peers_here("lab/r1") == ()


def test_a_socket_that_was_deleted_under_a_router_is_reported_with_the_remedy(base: Path) -> None:
    with ZenohMesh("robot1", topology(router=True)):
        socket_of("robot1").unlink()
        with ZenohMesh("robot1", topology(), starts=True) as mesh:
            assert "was deleted while a robot agent listens on it" in mesh.missing
            assert "`armadico down`" in mesh.missing
    with ZenohMesh("robot1", topology(), starts=True) as mesh:
        assert "start one with `armadico up`" in mesh.missing
