"""A fleet as real processes: it drives, and whatever ends it leaves nothing running."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from signal import SIGINT, SIGKILL

import pytest

from armadico.core.messages import FleetStatus
from armadico.runtime.client import Client
from tests.live.society import SOON, mesh_of
from tests.live.test_run import all_gone, children
from tests.programs import Start, starter

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


def test_two_robots_do_two_tasks_and_leave_nothing(run: Start, tmp_path: Path) -> None:
    process = run(*words(tmp_path, "--json"))
    held()
    everybody = children(process.pid)
    assert len(everybody) == 7, "a simulator, and three processes a robot"
    out, errors = process.communicate(timeout=100.0)
    assert process.returncode == 0, errors
    result = json.loads(out)
    assert result["done"] == 2
    assert sorted(task for row in result["robots"] for task in row["tasks"]) == [0, 1]
    assert all_gone(everybody)


@pytest.mark.parametrize("how", [SIGINT, SIGKILL])
def test_whatever_ends_it_nothing_is_left(run: Start, tmp_path: Path, how: int) -> None:
    process = run(*words(tmp_path))
    held()
    everybody = children(process.pid)
    process.send_signal(how)
    process.communicate(timeout=SOON)
    assert all_gone(everybody)


def test_a_second_fleet_of_the_same_name_is_refused(run: Start, tmp_path: Path) -> None:
    first = run(*words(tmp_path))
    held()
    second = run(*words(tmp_path))
    _, errors = second.communicate(timeout=SOON)
    assert second.returncode == 1
    assert f"a fleet named '{FLEET}' is there already, with r1, r2: " in errors
    assert first.poll() is None
