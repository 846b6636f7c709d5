"""`armadico run` as people start it: measured, interrupted, and alone in its namespace."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from shutil import rmtree
from signal import SIGHUP, SIGINT, SIGSTOP, Signals

import psutil
import pytest
from msgspec.structs import replace

from armadico.bridge.p2os.commands import Cmd
from armadico.config import grid_map
from armadico.core.config_errors import ConfigError
from armadico.core.judgement import Answer
from armadico.launch.local import Launcher
from armadico.launch.processes import simulator_words
from armadico.launch.society import Options
from armadico.mesh.ports import free_port
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.observe.measures import Result, RunWatch
from armadico.runtime.errors import RunFailedError
from tests.programs import Start, starter
from tests.robot.society import SOON, Observer, mesh_of
from tests.whole.live.conftest import NAMESPACE
from tests.whole.live.society import LINE, Society, joining_observer
from tests.whole.live.speeds import PacketTap, moves

pytestmark = pytest.mark.live

LONG = """2D-Map
LineMinPos: -30000 -3000
LineMaxPos: 30000 3000
LINES
DATA
"""
"""A field without walls, 60 m long: see `far`."""


@pytest.fixture
def run(apart: None) -> Iterator[Start]:
    """Start `armadico` with these words; killed with all its children if it is left."""
    with starter() as start:
        yield start


@pytest.fixture
def far(tmp_path: Path) -> list[str]:
    """`armadico run` of 50 m straight on. It lasts 75 s, so that on a busy machine the run still
    goes on when another program has started beside it.
    """
    world = tmp_path / "long.map"
    world.write_text(LONG)
    ends = ("--start", "-25", "0", "0", "--goal", "25", "0", "0")
    return ["run", "--world", str(world), *ends, "--sensors", "ideal", "--no-plot"]


def children(pid: int) -> list[psutil.Process]:
    found: list[psutil.Process] = psutil.Process(pid).children(recursive=True)
    return found


def all_gone(processes: list[psutil.Process]) -> bool:
    return not psutil.wait_procs(processes, SOON)[1]


def test_a_run_reaches_its_goal_says_json_and_leaves_nothing(
    run: Start, observer: Observer
) -> None:
    process = run(
        "run", "sc1", "--sensors", "ideal", "--goal", "1.5", "0", "0", "--no-plot", "--json"
    )
    observer.until(observer.driving, "the robot is on its way")
    everybody = children(process.pid)
    assert len(everybody) == 10, "a process for each agent, the simulator, and the guard"
    out, errors = process.communicate(timeout=2 * SOON)
    assert process.returncode == 0, errors
    result = json.loads(out)
    assert tuple(result) == Result.__struct_fields__
    assert result["reached"]
    assert result["collisions"] == 0
    assert result["shares"] == {"goto": 100.0}
    assert all_gone(everybody)
    with ZenohMesh(NAMESPACE, topology(router=True)):
        observer.until(lambda: not observer.client.alive, "nobody is left on the mesh")


@pytest.mark.long
def test_a_run_that_does_not_reach_its_goal_leaves_its_logs(run: Start, far: list[str]) -> None:
    process = run(*far, "--for", "2")
    out, errors = process.communicate(timeout=2 * SOON)
    assert process.returncode == 1, errors
    assert "NOT reached" in out
    logs = Path(errors.partition("logs are in ")[2].splitlines()[0])
    assert (logs / "goto.log").is_file()
    rmtree(logs)


@pytest.mark.long
@pytest.mark.parametrize("number", [SIGINT, SIGHUP])
def test_a_run_that_is_interrupted_leaves_the_robot_at_rest_and_nothing_running(
    run: Start, observer: Observer, number: Signals
) -> None:
    there = ("--port", "0", "--start", "-1.5", "0", "0", *joining_observer(NAMESPACE))
    simulator = run("sim", "sc1", *there)
    assert simulator.stdout is not None
    tap = PacketTap(simulator.stdout.readline().partition(" at ")[2].partition(";")[0])
    try:
        process = run("run", "sc1", "--no-plot", "--robot", tap.url, "--start", "-1.5", "0", "0")
        observer.until(observer.driving, "the robot is on its way")
        everybody = children(process.pid)
        process.send_signal(number)
        _, errors = process.communicate(timeout=SOON)
        assert process.returncode == 130, errors
        assert "sc1: interrupted; all its processes have ended" in errors
        assert "Traceback" not in errors
        assert all_gone(everybody)
        observer.until(observer.at_rest, "the wheels rest")
        last = tap.commands()[-4:]
        assert [command.number for command in last] == [Cmd.VEL, Cmd.RVEL, Cmd.ENABLE, Cmd.CLOSE]
        assert not any(map(moves, last))
    finally:
        tap.close()


@pytest.mark.long
def test_an_exploration_that_is_interrupted_keeps_the_map_so_far(
    run: Start, observer: Observer, tmp_path: Path
) -> None:
    saved = tmp_path / "so #far.yaml"
    process = run("explore", "sc3", "--sensors", "ideal", "--no-plot", "--map", str(saved))
    observer.until(observer.obeyed_lately, "somebody drives")
    observer.until(lambda: abs(observer.state.v) > 0.05, "to a frontier, since there is a map")
    everybody = children(process.pid)
    process.send_signal(SIGINT)
    _, errors = process.communicate(timeout=SOON)
    assert process.returncode == 130, errors
    assert "m^2 of it free" in errors
    assert grid_map.read(saved).area(grid_map.FREE) > 0.0
    assert all_gone(everybody)


def test_when_the_launcher_is_killed_the_society_drives_on_and_down_ends_it(
    run: Start, observer: Observer, far: list[str]
) -> None:
    process = run(*far)
    observer.until(observer.driving, "the robot is on its way")
    everybody = children(process.pid)
    try:
        process.kill()
        process.wait(SOON)
        observer.drives_on()
        assert all(child.is_running() for child in everybody)
        said, errors = run("down").communicate(timeout=SOON)
        assert "left by a killed launcher: encoder, " in said, errors
        assert all_gone(everybody)
    finally:
        for child in everybody:
            with suppress(psutil.NoSuchProcess):
                child.kill()


@pytest.mark.long
def test_down_leaves_alone_what_somebody_who_lives_has_started(
    start: Callable[[], Society], run: Start
) -> None:
    """A test or a notebook, say: nothing in its own command line speaks of Armadico."""
    society = start()
    said, errors = run("down").communicate(timeout=SOON)
    assert "nothing is up" in said, errors
    assert not any(process.ended() for process in society.launcher.processes)


def test_a_second_run_in_the_namespace_is_told_who_is_there_and_disturbs_nobody(
    run: Start, observer: Observer, far: list[str]
) -> None:
    first = run(*far)
    observer.until(observer.driving, "the first is on its way")
    (robot,) = [instance for name, instance in observer.client.alive if name == "robot"]
    second = run("run", "sc1", "--no-plot")
    _, errors = second.communicate(timeout=SOON)
    assert second.returncode == 1
    assert robot in errors
    assert repr(NAMESPACE) in errors
    assert "--namespace" in errors
    observer.drives_on()
    assert first.poll() is None


@pytest.mark.long
def test_a_mission_that_is_sent_into_a_run_is_driven_to_its_end(
    run: Start, observer: Observer, far: list[str]
) -> None:
    first = run(*far)
    observer.until(observer.driving, "the run is on its way")
    sent = run("goto", "-20", "0.5")
    said, errors = sent.communicate(timeout=SOON)
    assert "the goal is reached" in said, errors
    _, errors = first.communicate(timeout=SOON)
    assert first.returncode == 1
    assert "another mission has replaced this run" in errors


@pytest.mark.long
def test_of_two_runs_that_begin_together_one_at_most_drives(run: Start) -> None:
    both = [run("run", "sc1", "--goal", "0.3", "0", "0", "--no-plot") for _ in range(2)]
    errors = [process.communicate(timeout=2 * SOON)[1] for process in both]
    assert sorted(process.returncode for process in both)[1:] == [1], errors
    told = [text for text in errors if repr(NAMESPACE) in text and "--namespace" in text]
    assert len(told) >= len(both) - 1, errors


@pytest.mark.long
def test_a_run_whose_robot_agent_finds_one_that_hangs_is_told_which_process_that_is(
    apart: None,
) -> None:
    """A society whose router hangs cannot be seen before."""
    few = replace(LINE, agents=("robot", "encoder"))
    with (
        mesh_of(NAMESPACE) as mesh,
        Launcher(few, Options(), mesh, NAMESPACE) as there,
        mesh_of(NAMESPACE) as another,
        Launcher(few, Options(), another, NAMESPACE) as launcher,
    ):
        there.start()
        (robot,) = (process for process in there.processes if process.has_robot)
        robot.popen.send_signal(SIGSTOP)
        pattern = rf"(?s)^robot ended with .* process {robot.popen.pid} is the router .* down`"
        with pytest.raises(RunFailedError, match=pattern):
            launcher.start()


@pytest.mark.long
def test_the_robots_router_listens_where_the_table_says_and_no_picture_spoils_no_run(
    run: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture that nobody asked for, and that cannot be written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").write_text("no folder")
    here = f"tcp/127.0.0.1:{free_port()}"
    (tmp_path / "lab.toml").write_text(f'[here]\nrouter = "{here}"\nagents = ["robot"]\n')
    with ZenohMesh(NAMESPACE, topology(connect=here), starts=True) as mesh:
        observer = Observer(mesh)
        process = run(
            *("run", "sc1", "--goal", "0.3", "0", "0", "--json"),
            *("--host", "here", "--hosts", "lab.toml"),
        )
        observer.until(observer.obeyed_lately, "somebody drives")
        out, errors = process.communicate(timeout=2 * SOON)
    assert process.returncode == 0, errors
    assert json.loads(out)["reached"]
    assert "no picture: cannot write runs/sc1.png" in errors


@pytest.mark.long(but=("sc1",))
@pytest.mark.parametrize("scenario", ["sc1", "fleet"])
def test_a_router_is_not_named_for_a_run_that_starts_the_robots_own(
    run: Start, scenario: str
) -> None:
    process = run("run", scenario, "--connect", "tcp/127.0.0.1:7447")
    _, errors = process.communicate(timeout=SOON)
    assert process.returncode == 2
    assert "--connect is for --attach" in errors


def test_the_simulated_robot_is_the_scenarios(apart: None) -> None:
    assert "--robot=amigobot" in simulator_words(replace(LINE, robot="amigobot"), 1, NAMESPACE)
    stranger = replace(LINE, robot="unplaced")
    with mesh_of(NAMESPACE) as mesh, pytest.raises(ConfigError, match="no robot 'unplaced'"):
        Launcher(stranger, Options(), mesh, NAMESPACE)


@pytest.mark.long
def test_a_run_whose_simulator_dies_ends_as_unknown_and_says_so(
    apart: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.launch.run.SILENT_S", 1.5)
    said: list[str] = []

    with (
        mesh_of(NAMESPACE) as mesh,
        Launcher(LINE, Options(), mesh, NAMESPACE) as launcher,
    ):

        def cut(watch: RunWatch) -> None:
            if watch.driven.distance > 0.2:
                next(p for p in launcher.processes if p.name == "simulator").popen.kill()

        result = launcher.run(cut, said.append)
        everybody = [process.popen for process in launcher.processes]
    assert (result.reached, result.judgement.answer) == (None, Answer.UNKNOWN)
    assert "the simulator has ended (signal SIGKILL)" in result.judgement.reason
    assert any(text.startswith("simulator has ended") for text in said), said
    assert all(process.poll() is not None for process in everybody)


@pytest.mark.long
def test_a_run_in_which_nobody_can_drive_any_more_ends_and_names_who_is_missing(
    apart: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.launch.run.IDLE_S", 1.5)
    said: list[str] = []
    with (
        mesh_of(NAMESPACE) as mesh,
        Launcher(LINE, Options(), mesh, NAMESPACE) as launcher,
    ):

        def kill(watch: RunWatch) -> None:
            if watch.driven.distance > 0.2:
                for process in launcher.processes:
                    if process.name in ("goto", "avoid", "gothrough"):
                        process.popen.kill()

        result = launcher.run(kill, said.append)
    assert not result.reached
    assert result.tt_s < launcher.limit / 2, "it did not wait for its time to be up"
    over = "1.5 s, and avoid, gothrough, goto are missing"
    assert any(over in text for text in said), said
    assert (launcher.logs / "goto.log").is_file(), "there is something to read"
    rmtree(launcher.logs)


def test_a_robot_that_does_not_answer_is_named_with_what_its_agent_says(
    apart: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    nowhere = Options(robot="nothing-that-is-an-address")
    monkeypatch.setattr("armadico.launch.local.ANSWER_S", 0.5)
    with (
        mesh_of(NAMESPACE) as mesh,
        Launcher(LINE, nowhere, mesh, NAMESPACE) as launcher,
        pytest.raises(RunFailedError, match=r"(?s)did not answer.*begins with none of ros2"),
    ):
        launcher.start()
