"""Commands of a robot in a terminal, with a small society on real Zenoh."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.bridge.simulator.server import TcpLine
from armadico.cli import doctor, logs, main
from armadico.cli.options import FAILED, Mesh, UsageError
from armadico.launch.processes import logs_folder
from armadico.mesh.sockets import socket_of
from tests.robot.terminal import NAMESPACE, SOON, Run, Society

pytestmark = pytest.mark.live


@pytest.mark.long
def test_logs_follows_one_agent(run: Run, society: Society) -> None:
    done = run("logs", "-f", "goto", "--timeout", "2", "--level", "warning")
    assert "goto WARNING a wall is near" in done.stdout
    assert run("logs", "-f", "goto", "--timeout", "0.5", "--level", "error").stdout == ""


def test_logs_of_a_run_come_in_order(run: Run, tmp_path: Path) -> None:
    (tmp_path / "robot.log").write_text("10:00:00.100 robot INFO one\n10:00:00.300 robot INFO 3\n")
    (tmp_path / "goto.log").write_text("10:00:00.200 goto ERROR two\nTraceback\n")
    done = run("logs", "--folder", str(tmp_path))
    assert [line.split()[-1] for line in done.stdout.splitlines()] == [
        "one",
        "two",
        "Traceback",
        "3",
    ]
    assert run("logs", "nobody", "--folder", str(tmp_path)).returncode == 1


def test_logs_are_of_the_robot_that_was_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A newer run of another robot would be taken for this one's."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for number, namespace in enumerate(("a", "a-b", "a/b")):
        folder = logs_folder(namespace)
        (folder / "goto.log").write_text(f"10:00:00.100 goto INFO of {namespace}\n")
        os.utime(folder, (number, number))
    for namespace in ("a", "a-b", "a/b"):
        monkeypatch.delenv("ARMADICO_NAMESPACE", raising=False)
        assert main(["logs", "--namespace", namespace]) == 0
        monkeypatch.setenv("ARMADICO_NAMESPACE", namespace)
        assert main(["logs"]) == 0
        assert capsys.readouterr().out.splitlines() == 2 * [
            f"10:00:00.100 goto INFO of {namespace}"
        ]
    monkeypatch.setenv("ARMADICO_NAMESPACE", "c")
    assert main(["logs"]) == FAILED
    assert "logs of a, a-b, a/b: choose with --namespace" in capsys.readouterr().err


def test_logs_of_a_robot_of_a_fleet_are_in_the_fleets_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def run(number: int, namespace: str, *names: str) -> None:
        folder = logs_folder(namespace)
        for name in names:
            (folder / f"{name}.log").write_text(f"10:00:00.100 {name} INFO of run {number}\n")
        os.utime(folder, (number, number))

    run(1, "hall/r1", "goto")
    run(2, "hall", "r1-avoid", "r1-goto", "r2-goto", "simulator")
    run(3, "hall", "r2-goto")
    assert main(["logs", "goto", "--namespace", "hall/r1"]) == 0
    assert capsys.readouterr().out == "10:00:00.100 r1-goto INFO of run 2\n"
    assert main(["logs", "robot", "--namespace", "hall/r1"]) == FAILED
    assert "there are logs of: avoid, goto" in capsys.readouterr().err
    run(4, "hall/r1", "goto")
    assert main(["logs", "--namespace", "hall/r1"]) == 0
    assert capsys.readouterr().out == "10:00:00.100 goto INFO of run 4\n"


@pytest.mark.parametrize(
    "only", [["--level", "error"], ["--timeout", "2"], ["--connect", "tcp/a:1"]]
)
def test_logs_of_files_refuses_what_would_select_nothing_in_them(only: list[str]) -> None:
    """All lines, or those of another robot, would be taken for the ones that were asked for."""
    with pytest.raises(UsageError, match="add -f"):
        logs.run(logs.main.parse(only))


def test_doctor_finds_the_society(run: Run, society: Society) -> None:
    found = json.loads(run("doctor", "--json").stdout)
    findings = {f["who"]: f for f in found}
    assert any(f["sort"] == "agents" and "not known" in f["what"] for f in found)
    assert {"python", "packages", "socket", "port 8101", "serial", "graphics"} <= set(findings)
    assert findings["socket"]["answer"] == "yes"
    assert f"(pid {os.getpid()})" in findings["socket"]["what"], "the router's process is named"
    assert {"ports", "multicast"}.isdisjoint(findings)


@pytest.mark.parametrize(("answers", "named"), [(True, []), (False, ["robot"])])
def test_doctor_says_whether_the_robots_router_answers(
    tmp_path: Path, answers: bool, named: list[str]
) -> None:
    table = tmp_path / "hosts.toml"
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        if answers:
            place.listen()
        port = place.getsockname()[1]
        table.write_text(
            f'[robot]\nrouter = "tcp/127.0.0.1:{port}"\n[lab1]\naddress = "203.0.113.1"\n'
        )
        assert [f.who for f in doctor.routers(Mesh(hosts=str(table)))] == named


def test_the_port_of_a_simulator_that_is_driven_is_not_free() -> None:
    """It listens no more, and a second simulator would get its port."""
    line = TcpLine("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", line.port)):
        line.read(SOON)
        assert line.connected
        assert str(os.getpid()) in (doctor.listener(line.port) or "")
        assert main(["sim", "sc1", "--port", str(line.port)]) == 1
    line.close()


ONCE = (
    ("get", "goto"),
    ("stop", "--timeout", "0.3"),
    ("map", "save", "no.yaml"),
)


@pytest.mark.long(but=("command0",))
@pytest.mark.parametrize("command", ONCE)
def test_without_a_robot_agent_one_line_says_so(run: Run, command: tuple[str, ...]) -> None:
    done = run(*command)
    assert done.returncode == 1, done.stderr
    (line,) = done.stderr.splitlines()
    assert "no robot agent at " in line
    assert f"/{NAMESPACE}.sock" in line
    assert "`armadico up`" in line
    assert done.stdout == ""


def test_a_stop_is_tried_for_as_long_as_it_may_take(run: Run) -> None:
    missing, last = run("stop", "--timeout", "2.5").stderr.splitlines()
    assert "no robot agent at " in missing
    assert "could not be sent" in last


def test_ps_lists_nothing_for_programs_where_there_is_no_robot_agent(run: Run) -> None:
    done = run("ps", "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["agents"] == []
    assert "no robot agent at " in done.stderr


@pytest.fixture
def hung() -> Iterator[Path]:
    """The socket of a router that hangs: connections are accepted, and nothing else happens."""
    path = socket_of(NAMESPACE)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        yield path
    path.unlink()


@pytest.mark.long(but=("command1",))
@pytest.mark.parametrize("command", [("ps",), ("stop", "--timeout", "0.3")])
def test_a_robot_agent_that_hangs_is_not_waited_for_forever(
    run: Run, hung: Path, command: tuple[str, ...]
) -> None:
    done = run(*command)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"the robot agent does not answer at {hung}" in line


def test_doctor_finds_a_robot_agent_that_hangs(run: Run, hung: Path) -> None:
    findings = {f["who"]: f for f in json.loads(run("doctor", "--json").stdout)}
    assert f"(pid {os.getpid()})" in findings["socket"]["what"]
    assert findings["mesh"]["answer"] == "no"
    assert "does not answer" in findings["mesh"]["what"]
