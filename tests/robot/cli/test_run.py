"""`armadico run`: what is wrong is said before the robot moves; what is right can be repeated."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from armadico import cli
from armadico.config.shipped import resource_path
from tests.programs import call, starter

SHUT_IN = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 8000 4000
NumLines: 5
LINES
0 0 8000 0
8000 0 8000 4000
8000 4000 0 4000
0 4000 0 0
4000 0 4000 4000
DATA
"""
"""Two rooms and no door."""

SCENARIO = 'world = "{world}"\nstart = [1, 1, 0]\nplan = "direct"\n{goal}\n'


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of the test's own, with a map and scenarios."""
    monkeypatch.chdir(tmp_path)
    Path("shut-in.map").write_text(SHUT_IN)
    Path("blind.toml").write_text(SCENARIO.format(world="sc4", goal="goal = [8, 1, 0]"))
    Path("alone.toml").write_text(SCENARIO.format(world="sc1", goal='agents = ["encoder"]'))


Captured = pytest.CaptureFixture[str]


def run(captured: Captured, *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    try:
        code = cli.main(["run", *words])
    except SystemExit as end:  # argparse
        code = int(str(end.code))
    said = captured.readouterr()
    return code, said.out, said.err


VIRTUAL = ("sc1", "--virtual", "--sensors", "ideal")
SMALL_ROBOT = (*VIRTUAL, "--seed", "1", "--json")


def test_the_same_seed_says_the_same_bytes_and_another_one_others(capsys: Captured) -> None:
    first, again, other = (
        run(capsys, *VIRTUAL, "--json", "--seed", seed) for seed in ("7", "7", "8")
    )
    assert first == again
    assert first[0] == 0
    assert json.loads(first[1])["seed"] == 7
    assert other[1].replace('"seed": 8', '"seed": 7') != first[1]


@pytest.mark.long
def test_a_profile_named_is_the_robot_that_drives(capsys: Captured) -> None:
    small = run(capsys, *SMALL_ROBOT, "--profile", "amigobot")
    same = run(capsys, *SMALL_ROBOT, "--profile", str(resource_path("robots", "amigobot")))
    pioneer = run(capsys, *SMALL_ROBOT)
    measured = [out.partition("conditions")[0] for _, out, _ in (small, same, pioneer)]
    assert measured[0] == measured[1] != measured[2]
    assert {code for code, _, _ in (small, same, pioneer)} == {0}


@pytest.mark.long
def test_several_runs_have_a_mean_and_a_deviation(
    capsys: Captured,
) -> None:
    code, out, _ = run(capsys, *VIRTUAL, "--runs", "2", "--json", "--seed", "5")
    found = json.loads(out)
    rows = found["runs"]
    assert code == 0
    assert [row["seed"] for row in rows] == [5, 6]
    times = [row["tt_s"] for row in rows]
    assert found["mean"]["tt_s"] == pytest.approx(sum(times) / 2, abs=1e-3)
    assert found["deviation"]["tt_s"] == pytest.approx(abs(times[0] - times[1]) / 2**0.5, abs=1e-3)
    assert found["mean"]["shares"] == {"goto": 100.0}
    assert found["mean"]["min_clearance_m"] is None, "there is nothing to be near to"
    _, one, _ = run(capsys, *VIRTUAL, "--json", "--seed", "6")
    assert json.loads(one) == rows[1], "a run knows nothing of the one before it"


@pytest.mark.long
def test_workers_change_no_run_and_no_order(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = (*VIRTUAL, "--runs", "3", "--json")
    alone = run(capsys, *words)
    monkeypatch.setattr("armadico.cli.run.RUNS_FOR_A_WORKER", 1)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    assert run(capsys, *words)[:2] == alone[:2]


@pytest.mark.long
def test_a_goal_that_is_not_reached_is_measured_and_ends_with_exit_code_1(
    capsys: Captured,
) -> None:
    code, out, errors = run(capsys, "blind.toml", "--virtual", "--json", "--for", "20")
    row = json.loads(out)
    assert code == 1
    assert row["reached"] is False
    assert row["limit_s"] == 20.0
    assert 'plan = "rooms"' in errors


BEHAVIOURS = ("--without", "goto", "--without", "avoid", "--without", "gothrough")


@pytest.mark.parametrize("more", [(), ("--sensors", "real")], ids=["nobody", "relocate"])
def test_where_nobody_contends_for_the_wheels_it_is_said(
    capsys: Captured, more: tuple[str, ...]
) -> None:
    """The relocate agent drives only who is lost."""
    code, _, errors = run(capsys, *VIRTUAL, *more, "--for", "1", *BEHAVIOURS)
    assert code == 1
    assert "no agent competes for the wheels" in errors
    _, _, errors = run(capsys, *VIRTUAL, *more, "--for", "1", *BEHAVIOURS[2:])
    assert "contends" not in errors


def test_a_run_that_takes_too_long_says_its_limit_and_ends_with_exit_code_1(
    capsys: Captured,
) -> None:
    code, out, _ = run(capsys, *VIRTUAL, "--for", "2")
    assert code == 1
    assert "NOT reached: time limit of 2 s" in out


@pytest.mark.long
def test_a_robot_whose_odometry_drifts_gets_there_by_its_map(capsys: Captured) -> None:
    words = ("sc4", "--virtual", "--seed", "1000", "--json", "--for", "70")
    code, out, _ = run(capsys, *words)
    row = json.loads(out)
    assert (code, row["reached"], row["collisions"]) == (0, True, 0)
    assert "localization" in row["conditions"]["scenario"]["agents"]
    assert row["conditions"]["scenario"]["sensors"] == "real"
    lost, out, _ = run(capsys, *words, "--without", "localization", "--without", "relocate")
    assert (lost, json.loads(out)["reached"]) == (1, False)


@pytest.mark.long(but=("words0",))
@pytest.mark.parametrize("words", [("alone.toml",), (), ("shut-in.map", "--start", "1", "1", "0")])
def test_without_a_goal_it_runs_for_as_long_as_it_is_told(
    capsys: Captured, words: tuple[str, ...]
) -> None:
    code, out, errors = run(capsys, *words, "--virtual", "--json", "--for", "3")
    row = json.loads(out)
    assert (code, row["reached"], row["limit_s"]) == (0, None, 3.0)
    assert 2.5 < row["tt_s"] <= 3.1
    assert errors.splitlines()[0].endswith(": no goal"), "nobody can send it under --virtual"


@pytest.mark.long
def test_a_ros_map_is_a_world(capsys: Captured) -> None:
    Path("hall.yaml").write_text("image: hall.pgm\nresolution: 1.0\norigin: [-2, -1, 0.0]\n")
    Path("hall.pgm").write_bytes(b"P5 5 3 255\n" + b"\x00" * 5 + b"\xff" * 5 + b"\x00" * 5)
    words = ("hall.yaml", "--start", "-1.5", "0.5", "0", "--goal", "2", "0.5", "0")
    code, out, errors = run(capsys, *words, "--virtual", "--json")
    assert (code, json.loads(out)["reached"]) == (0, True), errors
    code, _, errors = run(capsys, "hall.pgm", *words[1:], "--virtual")
    assert code == 2
    assert "hall.pgm" in errors
    assert "map_server .yaml" in errors


@pytest.mark.parametrize(
    ("words", "exit_code", "why"),
    [
        (("sc4", "--goal", "8", "0.1", "0"), 2, "goal (8, 0.1)"),
        (("sc4", "--goal", "nan", "1", "0"), 2, "--goal nan"),
        (("sc1", "--without", "encoder"), 1, "no fresh encoder/pose"),
        (("none.yaml", "--start", "0", "0", "0"), 2, "none.yaml"),
        (("shut-in.map", "--start", "1", "1", "0", "--goal", "6", "2", "0"), 2, "goal (6, 2)"),
    ],
)
def test_a_run_that_is_refused_is_a_result_for_programs(
    capsys: Captured, words: tuple[str, ...], exit_code: int, why: str
) -> None:
    for runs in ((), ("--runs", "2")):
        code, out, errors = run(capsys, *words, "--virtual", "--json", *runs)
        rows = json.loads(out)["runs"] if runs else [json.loads(out)]
        assert [(row["reached"], why in row["why"]) for row in rows] == [(False, True)]
        assert (code, why in errors) == (exit_code, True)


@pytest.mark.parametrize(("world", "warned"), [("free.yaml", True), ("hall.map", False)])
def test_a_map_without_a_wall_is_named(capsys: Captured, world: str, warned: bool) -> None:
    Path("free.yaml").write_text("image: a.pgm\nresolution: 1\norigin: [-2, -2, 0]\n")
    Path("a.pgm").write_bytes(b"P5 5 5 255\n" + b"\xff" * 25)
    Path("hall.map").write_text("2D-Map\nLINES\n-2000 -2000 3000 -2000\n0 3000 0 2000\n")
    words = ("--start", "0", "0", "0", "--for", "1", "--virtual")
    code, _, errors = run(capsys, world, *words)
    assert (code, f"{world} has no wall" in errors) == (0, warned), errors


# Live ---------------------------------------------------------------------------------------------


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A robot and a folder for logs of the test's own."""
    monkeypatch.setenv("ARMADICO_NAMESPACE", "run-test")
    monkeypatch.setenv("TMPDIR", str(tmp_path))


@pytest.mark.long
@pytest.mark.live
def test_a_robot_that_is_not_there_is_said_with_what_to_do(apart: None) -> None:
    url = "tcp://127.0.0.1:1"
    done = call("run", "sc1", "--robot", url, within=100)
    assert done.returncode == 1
    assert f"the robot on {url} did not answer" in done.stderr
    assert "is the simulator running" in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout


@pytest.mark.long
@pytest.mark.live
def test_a_robot_of_another_type_than_the_profile_ends_the_run_with_the_profile_to_use(
    apart: None,
) -> None:
    with starter() as start:
        sim = start("sim", "sc1", "--robot", "amigobot", "--port", "0", "--namespace", "sim-of-it")
        assert sim.stdout is not None
        url = sim.stdout.readline().partition(" at ")[2].partition(";")[0]
        done = call("run", "sc1", "--robot", url, within=100)
    assert done.returncode == 1
    assert "the profile amigobot" in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout


@pytest.mark.live
def test_a_simulator_whose_port_is_taken_says_what_to_do(apart: None) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = call("sim", "sc1", "--port", port, within=100)
    assert done.returncode == 1
    assert f"127.0.0.1:{port}" in done.stderr
    assert "--port 0" in done.stderr
