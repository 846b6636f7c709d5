"""The terminal tools against a small society that a thread of the test plays on real Zenoh."""

from __future__ import annotations

import csv
import json
import os
import pty
import re
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest

from armadico.bridge.simulator.server import TcpLine
from armadico.cli import doctor, main
from armadico.cli.options import Mesh
from armadico.core.judgement import Answer
from armadico.core.messages import (
    PROTOCOL,
    Ack,
    Ballot,
    BidHistory,
    BidRecord,
    Card,
    Claim,
    Cycle,
    Log,
    RobotState,
    Stop,
)
from armadico.core.services import BIDS, CARD
from armadico.mesh.sockets import socket_of
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import Call, ZenohMesh
from armadico.mobile.messages import Pose
from armadico.observe.watching import Observer, Received
from tests.programs import BIN, Done, call, heavy, imports_nothing

pytestmark = pytest.mark.live

NAMESPACE = "terminal-test"
WHO = {"name": "goto", "instance": "goto-00000000000000aa"}
SOON = 40.0

Run = Callable[..., Done]


class Society:
    """One agent that holds the wheels, and a robot: what they would say each cycle."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self.number = 0
        self._mesh = mesh
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live)

    def __enter__(self) -> Society:
        card = Card(
            **WHO,
            host=socket.gethostname(),
            pid=os.getpid(),
            version="1",
            protocol=PROTOCOL,
            provides=(),
            requests=("encoder/pose",),
            resources=("wheels",),
        )
        self._answer(CARD.key_for(**WHO), lambda: card)
        self._answer(BIDS.key_for(**WHO), self._bids)
        self._mesh.declare_alive(WHO["name"], WHO["instance"])
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _answer(self, key: str, reply: Callable[[], Any]) -> None:
        def arrived(call: Call) -> None:
            call.reply(key, reply())

        self._mesh.answer(key, arrived)

    def _bids(self) -> BidHistory:
        newest = self.number
        numbers = range(max(newest - 40, 1), newest + 1)
        return BidHistory(
            WHO["instance"],
            tuple(BidRecord(Cycle(1, n), "wheels", 0.4, False, (0.0, 0.0), "") for n in numbers),
        )

    def _live(self) -> None:
        ballot = Ballot(4, 0.6, False, WHO["instance"])
        while not self._over.wait(0.02):
            self.number += 1
            cycle = Cycle(1, self.number)
            x = float(self.number)
            state = RobotState(cycle, x, 0, 0, 0.25, 0, 12.5, True, False)
            self._mesh.publish("robot/state", state)
            ack = Ack("wheels", cycle, ballot, ballot, cycle, 0.6)
            self._mesh.publish("resource/wheels/ack", ack)
            self._mesh.publish("encoder/pose", Pose(cycle, x, 0, 0))
            self._mesh.publish("resource/wheels/utility", Claim("wheels", ballot, cycle, 0.6))
            self._mesh.publish(f"log/{WHO['instance']}", Log(30, "a wall is near"))


@pytest.fixture
def environment() -> dict[str, str]:
    return os.environ | {
        "ARMADICO_NAMESPACE": NAMESPACE,
        "COLUMNS": "100",
        "LINES": "40",
        "TERM": "xterm",
    }


@pytest.fixture
def router() -> Iterator[ZenohMesh]:
    """The router that a robot agent would be."""
    with ZenohMesh(NAMESPACE, topology(router=True)) as mesh:
        yield mesh


@pytest.fixture
def society(router: ZenohMesh) -> Iterator[Society]:
    with Society(router) as played:
        yield played


@pytest.fixture
def run(environment: dict[str, str]) -> Run:
    return partial(call, env=environment)


# The recorder -------------------------------------------------------------------------------------


def poses(path: Path, run: Run) -> tuple[list[float], str]:
    """The numbers of the poses that are in a recording, and what export had to say."""
    out = path.with_name(path.stem)
    done = run("export", str(path), "--to", "csv", "--out", str(out))
    assert done.returncode == 0, done.stderr
    with (out / f"{NAMESPACE}_encoder_pose.csv").open() as stream:
        return [float(row["x"]) for row in csv.DictReader(stream)], done.stderr


def recorder(environment: dict[str, str], path: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [str(BIN / "armadico"), "record", str(path)],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )


def grown(path: Path, size: int) -> None:
    """Wait until a file has grown to a size."""
    end = time.monotonic() + SOON
    pause = threading.Event()
    while not path.exists() or path.stat().st_size < size:
        assert time.monotonic() < end, "nothing is recorded"
        pause.wait(0.02)


@pytest.mark.long
def test_a_recording_has_everything_and_ctrl_c_closes_it(
    run: Run, environment: dict[str, str], society: Society, tmp_path: Path
) -> None:
    pytest.importorskip("mcap")
    path = tmp_path / "run.mcap"
    with recorder(environment, path) as process:
        grown(path, 20_000)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=SOON)
    assert process.returncode == 0
    assert "closed" in said
    assert "LOST" not in said
    found, said = poses(path, run)
    assert "cut short" not in said
    assert found == [found[0] + n for n in range(len(found))]
    topics = {file.name for file in (tmp_path / "run").iterdir()}
    agent = f"{NAMESPACE}_agent_goto_{WHO['instance']}"
    assert topics >= {f"{agent}.csv", f"{agent}_card.csv", f"{agent}_bids.csv"}
    with (tmp_path / "run" / f"{agent}_bids.csv").open() as stream:
        bids = [int(row["cycle.number"]) for row in csv.DictReader(stream)]
    assert len(bids) == len(set(bids))


def test_killed_a_recorder_loses_no_more_than_the_last_second(
    run: Run, environment: dict[str, str], society: Society, tmp_path: Path
) -> None:
    pytest.importorskip("mcap")
    path = tmp_path / "run.mcap"
    with recorder(environment, path) as process:
        grown(path, 20_000)
        before = society.number
        process.kill()
    found, said = poses(path, run)
    assert "cut short" in said
    assert found == [found[0] + n for n in range(len(found))]
    assert found[-1] >= before - 50  # 50 a second are said


def test_a_recording_is_not_written_over(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    done = run("record", str(path), "--duration", "1")
    assert done.returncode == 1
    assert "exists already" in done.stderr
    assert path.read_text() == "precious"


# The terminal -------------------------------------------------------------------------------------


def test_echo_prints_so_many_messages(run: Run, society: Society) -> None:
    done = run("echo", "encoder/*", "-n", "3", "--json")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["key"] for line in lines] == ["encoder/pose"] * 3
    assert lines[2]["message"]["x"] == lines[0]["message"]["x"] + 2
    assert "RobotState" in run("echo", "robot/state", "-n", "1").stdout


def test_hz_measures_every_key(run: Run, society: Society) -> None:
    done = run("hz", "**", "-n", "100", "--json")
    rows = {row["key"]: row for row in json.loads(done.stdout)}
    assert rows["robot/state"]["promised_hz"] == 10
    assert rows["robot/state"]["hz"] > 0
    assert sum(row["messages"] for row in rows.values()) == 100


def test_top_knows_agents_holder_and_rates(run: Run, society: Society) -> None:
    done = run("top", "--json", "--for", "1")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    (wheels,) = found["resources"]
    assert wheels["holder"] == WHO["instance"]
    assert wheels["obeyed"] == "goto"
    assert wheels["contenders"] == ["goto"]
    (agent,) = found["agents"]
    assert agent["pid"] == os.getpid()
    assert agent["memory_mb"] > 0
    assert {row["key"] for row in found["services"]} >= {"robot/state", "encoder/pose"}
    assert found["robot"]["battery_v"] == 12.5
    assert (found["robot"]["battery_share"], found["robot"]["charging"]) == (None, False)


def test_top_into_a_pipe_measures_once_and_ends(run: Run, society: Society) -> None:
    said = run("top", "--for", "0.5").stdout
    assert WHO["instance"][:13] in said
    assert "\x1b" not in said


def test_why_live_tells_the_moment_and_whether_it_stands(run: Run, society: Society) -> None:
    found = json.loads(run("why", "--live", "--for", "1.5", "--json").stdout)
    (wheels,) = found["contests"]
    assert wheels["holder"] == wheels["obeyed"] == WHO["instance"]
    assert [each["agent"] for each in wheels["bids"]] == ["goto"]
    said = run("why", "--live", "--standing", "--for", "1.5").stdout
    assert said.startswith(found["sentences"][1])


def test_what_arrives_during_a_slow_step_of_top_is_no_silence() -> None:
    calls = ("subscribe", "watch_alive", "watch_router", "query")
    mesh: Any = SimpleNamespace(namespace=NAMESPACE, **dict.fromkeys(calls, lambda *_: None))
    observer = Observer(mesh)
    for _ in range(9):
        now = observer.watcher.clock()
        observer.watcher._put(Received(NAMESPACE, "encoder/pose", b"", now))
    observer.take(0.0)
    assert observer.view.rates["encoder/pose"].count == 9


def on_a_terminal(environment: dict[str, str], until: bytes) -> bytes:
    """What `armadico top` shows until it has shown that, and Ctrl-C has ended it."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [str(BIN / "armadico"), "top"], env=environment, stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    seen = b""
    try:
        while until not in seen:
            chunk = os.read(ours, 4096)
            assert chunk, seen
            seen += chunk
        process.send_signal(signal.SIGINT)
        with suppress(OSError):  # the terminal goes with its last process
            while os.read(ours, 4096):
                pass
        assert process.wait(SOON) == 0
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return seen


def test_top_shows_the_holder_on_a_terminal(environment: dict[str, str], society: Society) -> None:
    assert b"goto-00000000" in on_a_terminal(environment, b"goto-00000000")


@pytest.mark.long
def test_graph_draws_agents_and_keys(run: Run, society: Society) -> None:
    assert "resource/wheels/utility  goto -> -" in run("graph").stdout
    assert '"goto" -> "robot/cmd/*";' in run("graph", "--dot").stdout
    drawn = run("graph", "--mermaid").stdout
    assert drawn.startswith("flowchart LR")
    found = {name: node for node, name in re.findall(r'(n\d+)\(?\[+"(.+?)"', drawn)}
    assert f"{found['goto']} --> {found['robot/cmd/*']}" in drawn
    assert "encoder/pose" in found


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


def test_logs_of_the_newest_run_say_which_run_that_was(
    run: Run, environment: dict[str, str], tmp_path: Path
) -> None:
    environment["TMPDIR"] = str(tmp_path)
    for age, name in enumerate(("armadico-new", "armadico-old")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "goto.log").write_text(f"10:00:00.000 goto INFO {name}\n")
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    done = run("logs")
    assert done.stdout.split()[-1] == "armadico-new"
    assert f"from {tmp_path / 'armadico-new'}" in done.stderr


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


def test_doctor_says_what_to_do_about_a_port_that_is_locked(tmp_path: Path) -> None:
    (finding,) = doctor.serial_ports(tmp_path)
    assert finding.answer is Answer.YES
    assert finding.todo
    (tmp_path / "ttyUSB0").touch()
    (finding,) = doctor.serial_ports(tmp_path)
    assert (finding.answer, finding.what) == (Answer.YES, f"serial: {tmp_path / 'ttyUSB0'}")


def test_doctor_knows_who_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        owner = doctor.listener(port)
    assert owner is not None
    assert str(os.getpid()) in owner
    assert doctor.listener(port) is None


def test_the_port_of_a_simulator_that_is_driven_is_not_free() -> None:
    """It listens no more, and a second simulator would get its port."""
    line = TcpLine("127.0.0.1", 0)
    with socket.create_connection(("127.0.0.1", line.port)):
        line.read(SOON)
        assert line.connected
        assert str(os.getpid()) in (doctor.listener(line.port) or "")
        assert main(["sim", "sc1", "--port", str(line.port)]) == 1
    line.close()


# Whoever else is on the mesh ----------------------------------------------------------------------

CLEAR = "\x1b[2J\u202e"  # and right to left from there
EVIL = "evil-00000000000000bb"


class Hostile:
    """A peer whose names and keys are markup, and control the terminal."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self._mesh = mesh
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self.name = f"[/nope]{CLEAR}"
        for name, instance in (("[bold]evil", EVIL), (self.name, f"{CLEAR}x-1"), ("mute", "m-1")):
            mesh.declare_alive(name, instance)
            if name != "mute":
                card = self._card(name.replace(CLEAR, ""), instance.replace(CLEAR, ""))
                key = CARD.key_for(name=name, instance=instance)
                mesh.answer(key, lambda call, key=key, card=card: call.reply(key, card))

    @staticmethod
    def _card(name: str, instance: str) -> Card:
        texts = ("[/nope]", '"]; evil [shape="x', "<script>")
        return Card(
            name=name,
            instance=instance,
            host="[red]here[/red]",
            pid=1,
            version="[/]",
            protocol=PROTOCOL,
            provides=texts,
            requests=texts,
            resources=texts,
            holds=texts,
            owns=texts,
        )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _live(self) -> None:
        ballot = Ballot(2**40, 1.0, True, "[/nope]")
        cycle = Cycle(1, 7)
        while not self._over.wait(0.02):
            stop = Stop(2**52, True, "[/nope]", 1)
            state = RobotState(cycle, 0, 0, 0, 0, 0, 12.5, True, False, stop)
            self._mesh.publish("robot/state", state)
            claim = Claim("[/nope]", ballot, cycle, 1.0)
            self._mesh.publish(f"resource/{CLEAR}/utility", claim)
            ack = Ack("[/nope]", cycle, ballot, ballot, cycle)
            self._mesh.publish("resource/x/ack", ack)
            self._mesh.publish(f"log/{CLEAR}-1", Log(40, "[/nope]"))
            self._mesh.publish(f"a/key/{CLEAR}", Log(40, "x"))


@pytest.mark.long(but=("command7-a/key/",))
@pytest.mark.parametrize(
    ("command", "shows"),
    [
        (("ps",), "[/nope]"),
        (("top", "--once", "--for", "1.5"), "[/nope]"),
        (("graph",), "[/nope]"),
        (("graph", "--dot"), "[/nope]"),
        (("graph", "--mermaid"), "[/nope]"),
        (("doctor",), "m is alive, but has not answered"),
        (("logs", "-f", "--timeout", "1"), "ERROR [/nope]"),
        (("echo", "**", "-n", "20"), "a/key/"),
        (("hz", "**", "-n", "20"), "a/key/"),
    ],
)
def test_what_others_say_is_neither_markup_nor_does_it_control_the_terminal(
    run: Run, router: ZenohMesh, command: tuple[str, ...], shows: str
) -> None:
    with Hostile(router):
        done = run(*command)
    said = done.stdout + done.stderr
    assert "Traceback" not in said
    assert shows in said
    unprintable = {c for c in said if not c.isprintable() and c != "\n"}
    assert not unprintable


def test_a_hostile_name_does_not_end_the_live_view(
    environment: dict[str, str], router: ZenohMesh
) -> None:
    with Hostile(router):
        seen = on_a_terminal(environment, b"[/nope]")
    assert CLEAR.encode() not in seen.partition(b"[/nope]")[0][-200:]


# Used wrongly, or alone ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "code", "says"),
    [
        (("echo", "a//b"), 2, "KEYEXPR"),
        (("echo", "robot/st*te"), 2, "KEYEXPR"),
        (("echo", "**/**"), 2, "KEYEXPR"),
        (("echo", "robot/state", "--namespace", "a*"), 2, "namespace"),
        (("echo", "robot/state", "-n", "0"), 2, "from 1"),
        (("hz", "robot/state", "--json"), 2, "-n N"),
        (("logs", "-f", "--folder", "x"), 2, "--folder"),
        (("logs", "--folder", "/no/such"), 2, "no such folder"),
        (("record", "run.bag"), 2, ".mcap"),
        (("record", "run.mcap", "--max-size", "0"), 2, "--max-size"),
        (("record", "/no/such/run.mcap"), 1, "cannot write"),
        (("record", "run.mcap", "--namespace", "a", "--namespace", "b*"), 2, "namespace"),
        (("export", "/no/such.mcap", "--to", "csv"), 2, "no such file"),
        (("completion", "tcsh"), 2, "tcsh"),
    ],
)
def test_a_wrong_use_is_told_clearly(
    run: Run, command: tuple[str, ...], code: int, says: str
) -> None:
    done = run(*command)
    assert done.returncode == code, done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr


ABSENT = {
    ("echo", "robot/state", "--timeout", "0.3"): "nothing is published on robot/state",
    ("hz", "robot/state", "--timeout", "0.3"): "nothing is published on robot/state",
    ("top", "--once", "--for", "0.5"): "no agent is alive",
    ("graph",): "no agent is alive",
    ("why", "--live", "--for", "0.5"): "no agent is alive",
    ("get", "goto"): "no live agent 'goto'",
}
"""Commands that are soon done, and what is missing where there is a router and no agent."""


@pytest.mark.long(but=("command0",))
@pytest.mark.parametrize("command", ABSENT)
def test_an_agent_that_is_missing_is_named(
    run: Run, router: ZenohMesh, command: tuple[str, ...]
) -> None:
    done = run(*command)
    assert done.returncode == 1, done.stderr
    (line,) = done.stderr.splitlines()
    assert ABSENT[command] in line


ONCE = (
    *ABSENT,
    ("ps",),
    ("stop", "--timeout", "0.3"),
    ("resume", "--timeout", "0.3"),
    ("goto", "1", "2"),
    ("set", "goto", "v_max=0.4"),
    ("map", "save", "no.yaml"),
    ("mission", "status"),
    ("mission", "log"),
    ("mission", "cancel", "--all"),
)
"""Commands that are soon done."""


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


def test_a_command_waits_for_the_robot_agent_and_goes_on_when_it_comes(
    environment: dict[str, str],
) -> None:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command = [str(BIN / "armadico"), "echo", "robot/state", "-n", "1", "--json"]
    with subprocess.Popen(command, env=environment, **pipes) as process:
        try:
            assert "no robot agent at " in process.stderr.readline()
            with ZenohMesh(NAMESPACE, topology(router=True)) as mesh, Society(mesh):
                assert json.loads(process.stdout.readline())["key"] == "robot/state"
                assert process.wait(SOON) == 0
            assert process.stderr.read() == ""
        finally:
            process.kill()


def test_a_live_view_says_that_there_is_no_robot_agent(environment: dict[str, str]) -> None:
    assert b"no robot agent at " in on_a_terminal(environment, b"no robot agent at ")


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
@pytest.mark.parametrize("command", [("ps",), ("graph",), ("stop", "--timeout", "0.3")])
def test_a_robot_agent_that_hangs_is_not_waited_for_forever(
    run: Run, hung: Path, command: tuple[str, ...]
) -> None:
    done = run(*command)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"the router at {hung} does not answer" in line


def test_doctor_finds_a_robot_agent_that_hangs(run: Run, hung: Path) -> None:
    findings = {f["who"]: f for f in json.loads(run("doctor", "--json").stdout)}
    assert f"(pid {os.getpid()})" in findings["socket"]["what"]
    assert findings["mesh"]["answer"] == "no"
    assert "does not answer" in findings["mesh"]["what"]


@pytest.mark.parametrize(
    "name",
    ["record", "export", "top", "echo", "hz", "graph", "logs", "doctor", "why", "completion"],
)
def test_help_imports_nothing_heavy_and_has_examples(name: str) -> None:
    among = ("numpy", "zenoh", "cbor2", "msgspec", "rich", "rerun", "mcap", "psutil")
    done = heavy("armadico.cli", [name, "--help"], among)
    assert imports_nothing(done)
    assert done.stdout.partition("examples:")[2].count(f"armadico {name}") >= 2
