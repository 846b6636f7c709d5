"""`armadico run --attach`: hosts in any order, a mission, and a society that stays."""

from __future__ import annotations

import json
from pathlib import Path
from signal import SIGINT

import pytest

from tests.programs import NO_PICTURE, Start
from tests.robot.hosts.conftest import SOON, call, wait_for_line
from tests.robot.society import Observer

pytestmark = pytest.mark.live

SHORT = 'world = "empty"\nstart = [0, 0, 0]\ngoal = [0.6, 0, 0]\nplan = "direct"\n'
FAR = SHORT.replace("0.6", "9")


def scenario(folder: Path, text: str) -> str:
    file = folder / "own.toml"
    file.write_text(text)
    return str(file)


def test_hosts_that_come_in_any_order_are_driven_to_the_goal_and_stay_up(
    start: Start, tmp_path: Path
) -> None:
    """The run starts before all agents, behaviours before the robot, without effect."""
    name = scenario(tmp_path, SHORT)
    run = start("run", name, "--attach", "--json", *NO_PICTURE)
    assert run.stderr is not None
    assert any("waiting for " in line for line in run.stderr)
    hosts = ("lab2", "lab3", "lab1", "robot")
    ups = [start("up", name, "--host", host) for host in hosts]
    out, errors = run.communicate(timeout=2 * SOON)
    assert run.returncode == 0, errors
    assert json.loads(out)["reached"]
    for process, host in zip(ups, hosts, strict=True):
        wait_for_line(process, f"{host} is up")
        assert process.poll() is None
    again = call("run", name, "--attach", "--json", *NO_PICTURE)
    assert again.returncode == 0, again.stderr
    assert "not at the scenario's start (0, 0)" in again.stderr


@pytest.mark.long
def test_an_interrupted_run_leaves_the_robot_stopped_and_the_society_up(
    up: Start, start: Start, observer: Observer, tmp_path: Path
) -> None:
    name = scenario(tmp_path, FAR)
    for host in ("robot", "lab1", "lab2", "lab3"):
        up(host, name)
    run = start("run", name, "--attach", *NO_PICTURE)
    observer.until(observer.driving, "the robot is on its way")
    run.send_signal(SIGINT)
    _, errors = run.communicate(timeout=SOON)
    assert run.returncode == 130, errors
    assert "the robot is stopped; `armadico resume` releases it" in errors
    observer.until(lambda: observer.state.stop.stopped, "it is stopped")
    assert observer.state.stop.by == "armadico run"
    observer.until(observer.at_rest, "the wheels rest")
    assert len(observer.names) == 11, "ten, and the wakeup agent"
    refused = call("run", name, "--attach", *NO_PICTURE)
    assert refused.returncode == 1
    assert "the robot is stopped by armadico run; `armadico resume` releases it" in refused.stderr


@pytest.mark.long
def test_a_missing_agent_is_named(
    up: Start, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from armadico.cli import main

    up("robot")
    up("lab3")
    monkeypatch.setattr("armadico.launch.attached.AttachedRun.come_s", 3.0)
    code = main(["run", scenario(tmp_path, SHORT), "--attach"])
    errors = capsys.readouterr().err
    assert code == 1
    assert "avoid, encoder, gothrough, goto, relocate, sonar" in errors
    assert "armadico up" in errors


@pytest.mark.parametrize("option", ["--seed=1", "--controller=fast"])
def test_options_of_the_societys_start_are_refused(option: str) -> None:
    done = call("run", "sc1", "--attach", option)
    assert done.returncode == 2
    assert option.partition("=")[0] in done.stderr
