"""The commands against real agents: who is there, stop and resume, a mission and its refusal."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import signal
import subprocess
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import pytest

from armadico.agents.interface.messages import MissionOrder
from armadico.core.messages import Cycle, Message, RobotState, Stop, decode
from armadico.core.services import service_of
from armadico.launch.client import Client
from armadico.mesh import sockets
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import MissionReply, MissionRequest, Trajectory, Truth
from tests.programs import BIN, Done, Start, call, starter

pytestmark = pytest.mark.live

SOON = 30.0

Run = Callable[..., Done]


def named(namespace: str) -> dict[str, str]:
    """The environment of processes of one robot."""
    return os.environ | {"ARMADICO_NAMESPACE": namespace}


@pytest.fixture
def environment() -> dict[str, str]:
    return named("cli-test")


@pytest.fixture
def run(environment: dict[str, str]) -> Run:
    return partial(call, env=environment)


@pytest.fixture
def start(environment: dict[str, str]) -> Iterator[Start]:
    with starter(env=environment, stderr=subprocess.DEVNULL) as begin:
        yield begin


@contextmanager
def joined(environment: dict[str, str], *, router: bool = False) -> Iterator[ZenohMesh]:
    """A session on the mesh of the processes that have this environment."""
    with ZenohMesh(environment["ARMADICO_NAMESPACE"], topology(router=router)) as mesh:
        yield mesh


def agents(done: Done) -> list[dict[str, Any]]:
    """The agents that `ps --json` says are there."""
    rows: list[dict[str, Any]] = json.loads(done.stdout)["agents"]
    return rows


def who(run: Run, *names: str) -> dict[str, Any]:
    """The rows of `ps`, asked again until all of these are there and answer."""
    for _ in range(30):
        rows = {row["name"]: row for row in agents(run("ps", "--json"))}
        if set(names) <= set(rows) and all(row["answering"] for row in rows.values()):
            return rows
    raise AssertionError(f"{names} did not come: {rows}")


@pytest.fixture
def robot(start: Start) -> None:
    """A simulated robot and its agent."""
    simulated(start)


def simulated(start: Start) -> subprocess.Popen[str]:
    """Start a simulator and its robot agent; returns the simulator."""
    simulator = start("sim", "empty", "--port", "0", "--start", "0", "0", "0")
    assert simulator.stdout is not None
    where = "tcp://" + simulator.stdout.readline().partition("tcp://")[2].partition(";")[0]
    start("robot", "--set", f"port={where}", program="armadico-agent")
    return simulator


@pytest.fixture
def router(environment: dict[str, str]) -> Iterator[ZenohMesh]:
    """The router of a society without a robot, which its robot agent would be."""
    with joined(environment, router=True) as mesh:
        yield mesh


@pytest.mark.long
def test_ps_shows_who_is_there_and_marks_who_does_not_answer(
    run: Run, start: Start, router: ZenohMesh
) -> None:
    none = run("ps", "--json")
    assert agents(none) == []
    assert none.returncode == 1
    process = start("encoder", program="armadico-agent")
    row = who(run, "encoder")["encoder"]
    assert row["pid"] == process.pid
    assert row["provides"] == ["encoder/pose", "encoder/origin/*"]
    assert "encoder/pose" in run("ps").stdout
    process.send_signal(signal.SIGSTOP)
    rows = agents(run("ps", "--json", "--timeout", "0.2"))
    # The token stays until the lease is over; never is it shown as answering.
    assert [row["answering"] for row in rows] in ([False], [])


@pytest.mark.long(but=("2",))
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_an_agent_whose_imports_start_threads_leaves_in_order(
    run: Run, start: Start, router: ZenohMesh, ending: signal.Signals
) -> None:
    process = start("path-planning", program="armadico-agent")  # it imports numpy
    who(run, "path-planning")
    process.send_signal(ending)
    assert process.wait(SOON) == 0


def test_stop_stays_until_resume(run: Run, start: Start, robot: None) -> None:
    who(run, "robot")
    for command, says in (
        ("stop", "stopped"),
        ("stop", "stopped"),
        ("resume", "free to move"),
        ("stop", "stopped"),
    ):
        done = run(command, "--timeout", "10")
        assert done.returncode == 0, done.stderr
        assert says in done.stdout


def test_a_stop_names_the_other_robots_that_go_on(run: Run, robot: None) -> None:
    who(run, "robot")
    path = sockets.share_of("another", "desk")
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        done = run("stop")
        path.unlink()
    assert done.returncode == 0, done.stderr
    assert "armadico stop --namespace another" in done.stderr


@pytest.mark.long
def test_a_goal_sent_while_the_society_starts_is_driven_to(environment: dict[str, str]) -> None:
    with starter(env=environment) as start:
        up = start("up", "sc1")
        assert up.stderr is not None
        while "starting" not in (line := up.stderr.readline()):
            assert line, "it ended"
        done = call("goto", "1", "0", "--timeout", "60", env=environment)
        assert done.returncode == 0, done.stderr
        assert "the goal is reached" in done.stdout


def test_a_stop_by_signal_is_latched_and_needs_no_connection(
    run: Run, environment: dict[str, str], robot: None
) -> None:
    row = who(run, "robot")["robot"]
    with joined(environment) as mesh:
        client = Client(mesh)
        assert client.latest(RobotState, SOON)
        assert sockets.stop(mesh.namespace).pid == row["pid"]
        state = client.wait_for(
            lambda: (s := client.latest(RobotState)) and s.stop.stopped and s, SOON
        )
    assert state
    assert state.stop.requester == "armadico stop"


def test_a_stop_beside_a_hung_controller_tells_what_is_known_while_it_waits(
    run: Run, start: Start
) -> None:
    simulator = simulated(start)
    who(run, "robot")
    simulator.send_signal(signal.SIGSTOP)
    try:
        done = run("stop", "--timeout", "2")
    finally:
        simulator.send_signal(signal.SIGCONT)
    assert done.returncode == 3, done.stderr
    first, last = done.stderr.splitlines()
    assert "has latched the stop" in first
    assert "its controller does not answer" in first
    assert "no state of the robot confirms it" in last


@pytest.mark.long
def test_a_program_looks_stops_the_robot_and_a_person_releases_it(
    run: Run, environment: dict[str, str], robot: None
) -> None:
    """With no assistant agent about: one is started, and leaves with the server."""
    who(run, "robot")
    words = [str(BIN / "armadico"), "mcp"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, env=environment, **pipes) as server:

        def answered(line: str) -> dict[str, Any]:
            server.stdin.write(f"{line}\n")
            server.stdin.flush()
            answer: dict[str, Any] = json.loads(server.stdout.readline())
            return answer

        def query(method: str, **params: object) -> dict[str, Any]:
            request = {"jsonrpc": "2.0", "id": 7, "method": method, "params": params}
            answer = answered(json.dumps(request))
            assert answer["id"] == 7
            return answer["result"]

        def tool(name: str, **told: object) -> dict[str, Any]:
            found: dict[str, Any] = query("tools/call", name=name, arguments=told)
            return found["structuredContent"]

        query("initialize", clientInfo={"name": "model"}, protocolVersion="2025-06-18")
        assert tool("where")["connected"]
        assert tool("drive") == {"refused": "no tool 'drive'"}
        assert "too long" in tool("history", lines="x" * 3000)["refused"]
        assert answered("no JSON")["error"]["code"] == -32700
        assert answered("x" * 200_000)["error"]["code"] == -32600
        assert tool("stop", reason="a cat")["stopped"]
        events = tool("history")["events"]
        assert any('model asked: stop {"reason":"a cat"}' in each["what"] for each in events)
        code = tool("resume")["text"].partition("--confirm ")[2].strip("`")
        assert "another stop" in run("resume", "--confirm", "000000").stderr
        assert "free to move" in run("resume", "--confirm", code.lower()).stdout
        server.stdin.close()
        assert server.wait(SOON) == 0
    assert [row["name"] for row in agents(run("ps", "--json"))] == ["robot"], "it has left"


@pytest.fixture(scope="module")
def whole() -> Iterator[dict[str, str]]:
    """A society that is up for the tests of this file that leave it as it was: its environment."""
    environment = named("cli-test-whole")
    with starter(env=environment, stderr=subprocess.DEVNULL) as begin:
        simulated(begin)
        for name in ("encoder", "sonar", "goto", "interface"):
            begin(name, program="armadico-agent")
        run = partial(call, env=environment)
        who(run, "robot", "encoder", "sonar", "goto", "interface")
        yield environment


def say_states(mesh: ZenohMesh, stop: Callable[[int], Stop], over: threading.Event) -> None:
    """Say what a robot agent says, cycle by cycle."""
    number = 0
    while not over.wait(0.05):
        number += 1
        state = RobotState(Cycle(1, number), 0, 0, 0, 0, 0, 12, True, False, stop(number))
        mesh.publish("robot/state", state)


def test_a_stop_that_is_sent_and_never_acknowledged_is_not_said_to_be_done(
    run: Run, router: ZenohMesh
) -> None:
    heard: list[Stop] = []
    router.subscribe("robot/stop/*", lambda _key, data: heard.append(decode(data, Stop)))
    done = run("stop", "--timeout", "2")
    assert done.returncode == 1
    assert "the stop was sent, not acknowledged" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert len(heard) >= 5, "it is said again and again"
    assert {(stop.counter, stop.stopped, stop.by) for stop in heard} == {(1, True, "armadico stop")}
    assert len({stop.press for stop in heard}) == 1
    assert heard[0].press > 0


@pytest.mark.long(but=("at the largest counter",))
@pytest.mark.parametrize(
    ("says", "code", "told"),
    [
        (lambda number: Stop(3, number % 8 != 0, "x", 5), 1, "not acknowledged"),
        (lambda _: Stop(2**52, True, "x", 5), 0, "the robot is stopped"),
    ],
    ids=["to and fro", "at the largest counter"],
)
def test_stopped_is_said_if_the_robot_agent_goes_on_saying_so(
    run: Run,
    router: ZenohMesh,
    says: Callable[[int], Stop],
    code: int,
    told: str,
) -> None:
    over = threading.Event()
    thread = threading.Thread(target=say_states, args=(router, says, over))
    thread.start()
    try:
        done = run("stop", "--timeout", "3")
    finally:
        over.set()
        thread.join()
    assert done.returncode == code, done.stderr
    assert told in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long(but=("words1-2-1e+06 m",))
@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("800000", "800000", "0", "--direct"), 1, "at most 200 m are driven without a plan"),
        (("1e9", "2", "0"), 2, "1e+06 m"),
    ],
)
def test_a_goal_that_is_no_place_is_refused_in_one_line_and_nothing_moves(
    whole: dict[str, str], words: tuple[str, ...], code: int, told: str
) -> None:
    with joined(whole) as mesh:
        client = Client(mesh)
        moved: list[Truth] = []

        def keep(message: Message, _now: float) -> None:
            assert isinstance(message, Truth)
            if abs(message.v) > 0.01 or abs(message.w) > 0.01:
                moved.append(message)

        client.listen(Truth, then=keep)
        client.listen(Trajectory)
        assert client.wait_for(lambda: client.latest(Truth), SOON)
        done = call("goto", *words, env=whole)
        client.wait_for(lambda: None, 1.0)
        driven = client.latest(Trajectory)
    assert done.returncode == code, done.stdout + done.stderr
    *_, last = done.stderr.splitlines()
    assert told in last
    assert "Traceback" not in done.stderr
    assert not moved
    assert driven is None or not driven.waypoints


def test_a_goal_is_arrived_at_and_without_localization_nobody_knows_how_well(
    whole: dict[str, str],
) -> None:
    done = call("goto", "0.5", "0", "0", "--direct", env=whole)
    assert done.returncode == 3, done.stdout + done.stderr
    assert "arrived by a pose of unknown error: 0.0" in done.stdout


def test_without_an_interface_agent_a_mission_goes_nowhere(run: Run, router: ZenohMesh) -> None:
    done = run("goto", "1", "2", "90")
    assert done.returncode == 1
    assert "no agent that takes missions" in done.stderr


@pytest.mark.long
def test_a_goal_of_which_nothing_more_is_received_is_unknown_and_stands(
    run: Run, router: ZenohMesh
) -> None:
    key = service_of(MissionRequest).key
    router.answer(key, lambda call: call.reply(key, MissionReply(7)))
    done = run("goto", "1", "2", "90", "--direct")
    assert done.returncode == 3, done.stderr
    assert "no status of the mission for 5 s" in done.stderr
    assert "The mission continues: it is not known whether the robot drives" in done.stderr
    assert "`armadico stop` stops it" in done.stderr


@pytest.mark.long
def test_a_mission_that_is_refused_says_why(run: Run, start: Start, router: ZenohMesh) -> None:
    start("interface", program="armadico-agent")
    who(run, "interface")
    done = run("goto", "1", "2", "90", "--direct")
    assert done.returncode == 1
    assert "refused" in done.stderr
    assert "encoder/pose" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_missions_of_a_society_that_is_up_are_shown_and_cancelled(
    run: Run, start: Start, router: ZenohMesh
) -> None:
    start("interface", program="armadico-agent")
    # Nobody will ever say where the robot is; that is not waited for.
    settings = ("--set", "world=surveillance", "--set", "lost_s=0")
    start("mission-planning", *settings, program="armadico-agent")
    who(run, "interface", "mission-planning")
    assert run("mission", "status").stdout == "no missions\n"
    rows = 'steps = [{ do = "take-photo", else = [{ do = "wait", seconds = 600 }] }]'
    order = MissionOrder("long", zlib.compress(rows.encode()), 0.7, "a test")
    reply = Client(router).query(order, SOON)
    assert isinstance(reply, MissionReply)
    assert reply.refusal == ""
    done = run("mission", "status")
    assert done.returncode == 0, done.stderr
    assert f"long             0.7  active     {reply.mission}  0 done, wait(600.0)" in done.stdout
    (row,) = json.loads(run("mission", "status", "--json").stdout)
    assert (row["name"], row["doing"], row["by"]) == ("long", "wait(600.0)", "a test")
    told = run("mission", "log", "long").stdout
    assert "take-photo failed: the robot's pose is not known" in told
    for words, code, says in (
        (("log", "lung"), 1, "no mission 'lung' on the board; did you mean 'long'?"),
        (("cancel", "long"), 0, "cancelled"),
        (("cancel", "long"), 1, "over already"),
        (("cancel", "--all"), 1, "no mission is under way"),
        (("status",), 0, "cancelled"),
    ):
        done = run("mission", *words)
        assert done.returncode == code, done.stderr
        assert says in done.stdout + done.stderr


# By hand ------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_terminal_that_is_killed_leaves_a_robot_that_stands(
    environment: dict[str, str], start: Start, robot: None
) -> None:
    """With it goes the agent that it has started, which takes its stick."""
    start("sonar", program="armadico-agent")
    keyboard, terminal = pty.openpty()
    os.set_blocking(keyboard, False)
    command = [str(BIN / "armadico"), "teleop"]
    with (
        joined(environment) as mesh,
        subprocess.Popen(
            command, env=environment, stdin=terminal, stdout=terminal, stderr=subprocess.PIPE
        ) as process,
    ):
        client = Client(mesh)
        try:

            def driven() -> bool:
                with suppress(BlockingIOError):
                    os.read(keyboard, 4096)  # what it shows
                os.write(keyboard, b"w")
                state = client.latest(RobotState)
                return state is not None and state.v > 0.15

            client.listen(RobotState)
            assert client.wait_for(driven, SOON)
            assert any(name == "teleop" for name, _ in client.alive)
            process.kill()

            def stands() -> bool:
                state = client.latest(RobotState)
                gone = all(name != "teleop" for name, _ in client.alive)
                return gone and state is not None and abs(state.v) < 0.01

            assert client.wait_for(stands, SOON)
        finally:
            process.kill()
            os.close(keyboard)
            os.close(terminal)


def test_a_goal_given_too_early_waits_and_a_robot_that_stands_is_explained(
    robot: None, start: Start, environment: dict[str, str]
) -> None:
    start("interface", program="armadico-agent")
    with subprocess.Popen(
        [BIN / "armadico", "goto", "1", "0", "0", "--direct", "--timeout", "30"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as sent:
        assert sent.stdout is not None
        assert sent.stderr is not None
        try:
            waits = "the goal is refused: the robot's pose is not known"
            assert any(waits in line for line in sent.stderr)  # maybe not first
            start("encoder", program="armadico-agent")
            said = next((line for line in sent.stdout if "->" in line), "")
            assert "m to go, No agent that competes for wheels is alive." in said
        finally:
            sent.kill()
