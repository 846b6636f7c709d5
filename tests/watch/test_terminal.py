"""The commands of `watch` in a terminal, with a small society on real Zenoh."""

from __future__ import annotations

import csv
import json
import os
import pty
import re
import signal
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

import pytest

from armadico.cli import options
from armadico.core.messages import (
    PROTOCOL,
    Ack,
    Ballot,
    Card,
    Claim,
    Cycle,
    Log,
    RobotState,
    Stop,
)
from armadico.core.services import CARD
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from tests.programs import BIN
from tests.robot.terminal import NAMESPACE, SOON, WHO, Run, Society

pytestmark = pytest.mark.live


def poses(path: Path, run: Run) -> tuple[list[float], str]:
    """The numbers of the poses that are in a recording, and what export had to say."""
    out = path.with_name(path.stem)
    done = run("export", str(path), "--to", "csv", "--out", str(out))
    assert done.returncode == (options.UNKNOWN if "cut short" in done.stderr else 0), done.stderr
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
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGHUP])
def test_a_recording_has_everything_and_a_signal_closes_it(
    run: Run,
    environment: dict[str, str],
    society: Society,
    tmp_path: Path,
    ending: signal.Signals,
) -> None:
    pytest.importorskip("mcap")
    path = tmp_path / "run.mcap"
    with recorder(environment, path) as process:
        grown(path, 20_000)
        process.send_signal(ending)
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
    assert [each["name"] for each in wheels["contenders"]] == ["goto"]
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
    assert "resource/wheels/utility/*  goto -> -" in run("graph").stdout
    assert '"goto" -> "robot/cmd/*";' in run("graph", "--dot").stdout
    drawn = run("graph", "--mermaid").stdout
    assert drawn.startswith("flowchart LR")
    found = {name: node for node, name in re.findall(r'(n\d+)\(?\[+"(.+?)"', drawn)}
    assert f"{found['goto']} --> {found['robot/cmd/*']}" in drawn
    assert "encoder/pose" in found


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


@pytest.mark.long(but=("command4-a/key/",))
@pytest.mark.parametrize(
    ("command", "shows"),
    [
        (("ps",), "[/nope]"),
        (("top", "--once", "--for", "1.5"), "[/nope]"),
        (("graph", "--dot"), "[/nope]"),
        (("logs", "-f", "--timeout", "1"), "ERROR [/nope]"),
        (("echo", "**", "-n", "20"), "a/key/"),
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


ABSENT = {
    ("echo", "robot/state", "--timeout", "0.3"): "nothing is published on robot/state",
    ("top", "--once", "--for", "0.5"): "no agent is alive",
    ("get", "goto"): "no live agent 'goto'",
}


@pytest.mark.long(but=("command0",))
@pytest.mark.parametrize("command", ABSENT)
def test_an_agent_that_is_missing_is_named(
    run: Run, router: ZenohMesh, command: tuple[str, ...]
) -> None:
    done = run(*command)
    assert done.returncode == 1, done.stderr
    (line,) = done.stderr.splitlines()
    assert ABSENT[command] in line


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
