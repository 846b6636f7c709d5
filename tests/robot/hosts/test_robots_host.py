"""Hosts wait for the robot's host and outlive it: their agents continue with the next one."""

from __future__ import annotations

import json
from pathlib import Path

import psutil
import pytest

from armadico.launch.processes import kill_trees
from tests.programs import Start
from tests.robot.hosts.conftest import AGENTS, ROBOT, children, sent_off
from tests.robot.society import Observer

pytestmark = pytest.mark.live

SCENARIO = """\
world = "empty"
start = [0, 0, 0]
plan = "direct"
sensors = "ideal"
"""

OTHERS = [name for host, names in AGENTS.items() if host != ROBOT for name in names]


@pytest.mark.long
def test_hosts_that_lose_the_robots_host_keep_all_their_processes_and_drive_on_with_the_next(
    start: Start, up: Start, observer: Observer, tmp_path: Path
) -> None:
    scenario = tmp_path / "far.toml"
    scenario.write_text(f"{SCENARIO}agents = {json.dumps(OTHERS)}\n")
    hosts = {h: start("up", str(scenario), "--host", h) for h in ("lab1", "lab2", "lab3")}
    kept: dict[str, dict[str, psutil.Process]] = {}
    for _ in range(2):
        robots = up(ROBOT, str(scenario))
        observer.until(lambda: {ROBOT, *OTHERS} <= observer.names, "all see each other")
        kept = kept or {host: children(process) for host, process in hosts.items()}
        sent_off(observer)
        kill_trees(robots)
        observer.until(lambda: not observer.client.mesh.reachable, "the router is gone")
    for host, process in hosts.items():
        assert process.poll() is None
        assert children(process) == kept[host]
