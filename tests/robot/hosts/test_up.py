"""`armadico up` and `down`: a share comes up, stays up, is given up, and leaves nothing."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from signal import SIGINT, SIGTERM, Signals

import pytest

from armadico.launch.pidfile import shares
from tests.programs import Start
from tests.robot.hosts.conftest import (
    NAMESPACE,
    ROBOT,
    SOON,
    all_gone,
    call,
    children,
    wait_for_line,
)
from tests.robot.society import Observer

pytestmark = pytest.mark.live


def test_a_share_comes_up_is_seen_and_goes_down(router: None, up: Start) -> None:
    process = up("lab1")
    kept = children(process)
    assert sorted(kept) == ["encoder", "sonar"]
    seen = call("ps", "--host", "lab1")
    assert (seen.returncode, seen.stdout) == (0, "lab1: up\n"), seen.stderr
    second = call("up", "--host", "lab1")
    assert second.returncode == 1
    assert f"by process {process.pid}" in second.stderr
    assert "armadico down" in second.stderr
    down = call("down", "--host", "lab1")
    assert (down.returncode, down.stdout) == (0, "lab1 is down: encoder, sonar\n"), down.stderr
    assert process.wait(SOON) == 0
    assert all_gone(list(kept.values()))
    assert call("ps", "--host", "lab1").returncode == 1
    again = call("down")
    assert again.returncode == 0
    assert NAMESPACE in again.stdout


@pytest.mark.long
def test_a_second_wakeup_agent_of_a_host_ends_and_the_first_ones_agents_stay(
    router: None, up: Start
) -> None:
    """Another user's: it has no file of the share."""
    first = up("lab1")
    kept = children(first)
    second = call("up", "--host", "lab1", on="another user")
    assert second.returncode == 1, second.stderr
    assert "agent is alive already" in second.stderr
    assert any(f"(host lab1, pid {one.pid}, " in second.stderr for one in kept.values())
    assert {name: one.pid for name, one in children(first).items()} == {
        name: one.pid for name, one in kept.items()
    }


def test_a_share_whose_robot_agent_finds_another_ends_and_names_it(
    start: Start, observer: Observer
) -> None:
    nowhere = "port=tcp://127.0.0.1:1"
    by_hand = start("robot", "--host", "robot", "--set", nowhere, program="armadico-agent")
    observer.until(lambda: observer.names == {"robot"}, "it is there")
    done = call("up", "--host", "robot")
    assert done.returncode == 1
    assert "robot ended with status 2" in done.stderr
    assert f"process {by_hand.pid} is the router" in done.stderr
    assert by_hand.poll() is None


@pytest.mark.long
def test_down_without_a_host_is_for_all_shares_of_the_namespace(router: None, start: Start) -> None:
    both = [start("up", "--host", host, on=ROBOT) for host in ("lab1", "lab2")]
    for process, host in zip(both, ("lab1", "lab2"), strict=True):
        wait_for_line(process, f"{host} is up")
    other = call("down", "--namespace", "another-robot")
    assert "nothing is up" in other.stdout
    down = call("down")
    assert [line.partition(" ")[0] for line in down.stdout.splitlines()] == ["lab1", "lab2"]
    assert [process.wait(SOON) for process in both] == [0, 0]


def test_an_agent_that_dies_comes_back_as_a_new_instance(
    router: None, up: Start, observer: Observer
) -> None:
    process = up("lab1")
    observer.until(lambda: observer.names == {"encoder", "sonar", "wakeup"}, "both are there")
    before = set(observer.client.alive)
    children(process)["sonar"].kill()
    observer.until(lambda: len(observer.client.alive) == 2, "the sonar agent is gone")
    observer.until(lambda: observer.names == {"encoder", "sonar", "wakeup"}, "it is back")
    assert len(before & observer.client.alive) == 2, "the encoder agent and its host stayed"
    process.terminate()
    _, errors = process.communicate(timeout=SOON)
    assert "sonar ended with signal SIGKILL" in errors


def test_when_the_restart_budget_is_spent_the_host_ends_with_the_reason(
    router: None, up: Start
) -> None:
    process = up("lab1", "--restarts", "0")
    kept = children(process)
    kept["sonar"].kill()
    _, errors = process.communicate(timeout=SOON)
    assert process.returncode == 1
    assert all_gone(list(kept.values()))
    assert "lab1: sonar ended with signal SIGKILL" in errors
    assert "0 restarts in 30 s" in errors
    logs = Path(errors.rpartition("logs are in ")[2].strip())
    assert sorted(path.name for path in logs.iterdir()) == ["encoder.log", "sonar.log"]


def test_a_misconfigured_agent_is_not_restarted_and_its_error_is_shown(
    router: None,
) -> None:
    done = call("up", "--host", "lab3", "--set", "path-planning.world=nowhere.map")
    assert done.returncode == 1
    assert "path-planning ended with status 2" in done.stderr
    assert "no file 'nowhere.map'" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(shares(NAMESPACE)) == []


@pytest.mark.long(but=("2-130",))
@pytest.mark.parametrize(("number", "code"), [(SIGINT, 130), (SIGTERM, 0)])
def test_a_signal_ends_all_agents_and_leaves_no_logs(
    router: None, up: Start, tmp_path: Path, number: Signals, code: int
) -> None:
    process = up("lab2")
    kept = list(children(process).values())
    assert len(kept) == 4
    process.send_signal(number)
    _, errors = process.communicate(timeout=SOON)
    assert process.returncode == code, errors
    assert all_gone(kept)
    assert not list(tmp_path.glob("armadico-*"))


@pytest.mark.long
def test_when_it_is_killed_its_agents_leave_and_it_can_be_started_again(up: Start) -> None:
    process = up("robot")
    kept = children(process)
    assert sorted(kept) == ["robot", "simulator"]
    process.kill()
    process.wait(SOON)
    assert all_gone(list(kept.values()))
    assert list(shares(NAMESPACE)) == []
    up("robot")


@pytest.mark.long
def test_a_simulator_that_dies_comes_back_where_it_was(up: Start, observer: Observer) -> None:
    process = up("robot")
    observer.until(lambda: observer.truths and observer.states, "the robot talks")
    children(process)["simulator"].kill()
    cycles = len(observer.states)
    observer.until(lambda: any("is gone:" in text for text in observer.logs), "it is missed")
    observer.until(lambda: len(observer.states) > cycles + 10, "the robot talks again")


def test_agents_are_those_of_the_scenario_and_the_command_line(
    router: None, up: Start, observer: Observer, tmp_path: Path
) -> None:
    scenario = tmp_path / "own.toml"
    scenario.write_text(
        'world = "empty"\nstart = [0, 0, 0]\ngoal = [1, 0, 0]\nagents = ["encoder", "goto"]\n'
    )
    up("lab1", str(scenario), "--with", "avoid", "--with", "avoid", "--set", "avoid.v_max=0.2")
    observer.until(lambda: len(observer.client.alive) == 4, "three are there, and their host")
    assert sorted(name for name, _ in observer.client.alive) == [
        "avoid",
        "avoid",
        "encoder",
        "wakeup",
    ]


def test_systemd_is_notified_when_it_is_up(
    router: None, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "notify"))
        line.settimeout(SOON)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        start("up", "--host", "lab1")
        assert line.recv(100) == b"READY=1"


@pytest.mark.long
def test_ps_shows_missing_agents_by_host_and_the_exit_code_for_one_host(
    router: None, start: Start
) -> None:
    """On the machine where it is up: another one counts by the table."""
    words = ("--restarts", "0", "--without", "sonar")
    process = start("up", "--host", "lab1", *words, on=ROBOT)
    wait_for_line(process, "lab1 is up")
    here = call("ps", "--host", "lab1", on=ROBOT)
    assert here.returncode == 0, "it was started without that"
    found = {host["name"]: host for host in json.loads(call("ps", "--json").stdout)["hosts"]}
    assert found["lab1"]["state"] == "up"
    assert found["lab2"]["lacks"] == ["goto", "avoid", "gothrough", "relocate"]
    shown = call("ps")
    assert "lab3: no agent is alive" in shown.stdout
    by_hand = call("ps", "--host", "lab2")
    assert (by_hand.returncode, by_hand.stdout) == (1, "lab2: no agent is alive\n")
    process.terminate()
    assert process.wait(SOON) == 0


def test_an_agent_by_hand_counts_as_the_hosts(
    router: None, start: Start, observer: Observer
) -> None:
    start("goto", "--host", "lab2", program="armadico-agent")
    observer.until(lambda: observer.names == {"goto"}, "it is there")
    seen = call("ps", "--host", "lab2")
    assert (seen.returncode, seen.stdout) == (1, "lab2: missing: avoid, gothrough, relocate\n")


def test_an_agent_of_another_machine_is_reported(table: Path) -> None:
    text = table.read_text().replace("127.0.0.22", "192.0.2.77")
    table.write_text(text)
    for words, program in ((("up",), "armadico"), (("sonar",), "armadico-agent")):
        done = call(*words, "--host", "lab1", program=program)
        assert done.returncode == 2
        assert "host 'lab1' is not this machine: 192.0.2.77 is no address of its own" in done.stderr
        assert "this machine is 'robot' or 'lab2' or 'lab3'" in done.stderr


def test_the_process_prints_nothing_else_on_standard_output(router: None, up: Start) -> None:
    process = up("lab1")
    process.terminate()
    out, _ = process.communicate(timeout=SOON)
    assert out == ""
