"""A fleet as real processes: it drives, and whatever ends it leaves nothing running."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from signal import SIGINT, SIGKILL

import pytest

from armadico.agents.fleet.messages import FleetStatus
from armadico.cli.options import UNKNOWN
from armadico.launch.client import Client
from tests.programs import Start, call, starter
from tests.robot.hosts.conftest import wait_for_line
from tests.robot.society import SOON, mesh_of
from tests.whole.live.test_run import all_gone, children

pytestmark = [pytest.mark.live, pytest.mark.timeout(240)]

FLEET = f"live-fleet-{os.getpid()}"
START_S = 60.0

SCENARIO = """\
title = "Two robots, two places"
world = "hall"
start = [1.5, 1.5, 0.0]
others = [[1.5, 3.5, 0.0]]
sensors = "ideal"
look_s = 1.0
agents = [
  "encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface", "fleet",
]
tasks = [[3.5, 1.5, 0.0], [3.5, 3.5, 0.0]]
"""


@pytest.fixture
def run(apart: None) -> Iterator[Start]:
    """Start `armadico` with these words; killed with all its children if it is left."""
    with starter() as start:
        yield start


TABLE = """\
[here]
agents = ["robot", "encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface",
          "fleet"]
together = [["encoder", "sonar", "goto", "avoid", "gothrough"],
            ["path-planning", "interface", "fleet"]]
takes = []
"""


def words(tmp_path: Path, *more: str) -> list[str]:
    path = tmp_path / "two.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return ["run", str(path), "--namespace", FLEET, *more]


def held() -> None:
    """Until each robot's fleet agent has told how far it is with the list."""
    for name in ("r1", "r2"):
        with mesh_of(f"{FLEET}/{name}") as mesh:
            client = Client(mesh)
            client.listen(FleetStatus)
            assert client.wait_for(
                lambda c=client: (s := c.latest(FleetStatus)) is not None and s.tasks, START_S
            )


def told(process: subprocess.Popen[str], what: str) -> None:
    """Until it says something on standard error."""
    assert process.stderr is not None
    said = ""
    while what not in said:
        line = process.stderr.readline()
        assert line, said
        said += line


@pytest.mark.long
def test_two_robots_do_two_tasks_and_leave_nothing_and_a_second_fleet_is_refused(
    run: Start, tmp_path: Path
) -> None:
    process = run(*words(tmp_path, "--json"))
    held()
    everybody = children(process.pid)
    assert len(everybody) == 9, "a simulator, and three processes and a guard a robot"
    second = run(*words(tmp_path))
    _, errors = second.communicate(timeout=SOON)
    assert second.returncode == 1
    assert f"a fleet named '{FLEET}' is there already, with r1, r2: " in errors
    out, errors = process.communicate(timeout=100.0)
    assert process.returncode == 0, errors
    result = json.loads(out)
    assert result["done"] == 2
    assert sorted(task for row in result["robots"] for task in row["tasks"]) == [0, 1]
    assert all_gone(everybody)
    assert not [*tmp_path.glob("armadico-*")], "no logs of a run that ended well"


@pytest.mark.long
@pytest.mark.parametrize("how", [SIGINT, SIGKILL])
def test_whatever_ends_it_nothing_is_left(run: Start, tmp_path: Path, how: int) -> None:
    process = run(*words(tmp_path))
    held()
    everybody = children(process.pid)
    process.send_signal(how)
    process.communicate(timeout=SOON)
    assert all_gone(everybody)


@pytest.mark.long
def test_a_fleet_that_is_up_does_a_list_though_a_robot_dies_and_is_left_stopped_by_ctrl_c(
    run: Start, tmp_path: Path
) -> None:
    table = tmp_path / "lab.toml"
    table.write_text(TABLE, encoding="utf-8")
    first, second = (f"{FLEET}/{name}" for name in ("r1", "r2"))
    starts = ("1.5", "1.5", "0"), ("1.5", "3.5", "0")
    world = run(
        *("sim", "hall", "--port=0", "--namespace", first, "--start", *starts[0]),
        *("--also", second, *starts[1]),
    )
    ports = re.findall(r"tcp://\S+?(?=[,;])", wait_for_line(world, "2 simulated robots"))
    file = words(tmp_path)[1]
    here = ("up", file, "--hosts", str(table), "--host", "here")
    ups = [
        run(*here, "--namespace", name, "--robot", port, "--start", *start)
        for name, port, start in zip((first, second), ports, starts, strict=True)
    ]
    for process in ups:
        wait_for_line(process, "here is up")
    attached = run("run", file, "--attach", "--namespace", FLEET, "--robots", "2", "--json")
    with mesh_of(first) as mesh:
        client = Client(mesh)
        client.listen(FleetStatus)
        assert client.wait_for(
            lambda: (status := client.latest(FleetStatus)) is not None and status.holds, START_S
        )
    everybody = children(ups[0].pid)
    ups[0].kill()
    assert all_gone(everybody), "agents leave with who started them"
    out, errors = attached.communicate(timeout=100.0)
    assert attached.returncode == UNKNOWN, errors
    result = json.loads(out)
    assert "r1's collisions: unknown" in result["judgement"]["reason"], "its router is gone"
    assert sorted(task for row in result["robots"] for task in row["tasks"]) == [0, 1]
    assert f"{first}: its fleet agent is silent" in errors

    again = run("run", file, "--attach", "--namespace", FLEET)
    told(again, "0 of 2 done")
    again.send_signal(SIGINT)
    _, errors = again.communicate(timeout=SOON)
    assert again.returncode == 130, errors
    assert f"stopped: {second}; `armadico resume --namespace {second}` releases one" in errors
    assert "the fleet remembers the list, of which" in errors
    assert ups[1].poll() is None, "it is up"
    assert call("down", "--namespace", second).returncode == 0
