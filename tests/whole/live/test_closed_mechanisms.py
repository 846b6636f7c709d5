"""Societies with keys that drive by a mechanism with an arbiter, as real processes."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.cli.options import UNKNOWN
from armadico.core.messages import Ack
from armadico.launch.client import Client
from armadico.mesh.ports import free_port
from armadico.observe.view import driver
from tests.programs import Start, call, starter
from tests.robot.hosts.conftest import wait_for_line
from tests.whole.live.test_fleet import SCENARIO

pytestmark = [pytest.mark.live, pytest.mark.long, pytest.mark.timeout(240)]

SOON_S = 40.0  # a deadline, not an expectation


OF_A_FLEET = """\
keys = "keys"
fleet = ["tcp/127.0.0.1:{first}", "tcp/127.0.0.1:{second}"]
[{name}]
router = "tcp/127.0.0.1:{own}"
agents = ["robot", "encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface",
          "fleet", "contract-net"]
together = [["encoder", "sonar", "goto", "avoid", "gothrough"],
            ["path-planning", "interface", "fleet"]]
takes = []
"""


@pytest.fixture
def start(apart: None) -> Iterator[Start]:
    with starter() as start:
        yield start


def does(*words: str, code: int = 0) -> str:
    done = call(*words)
    assert done.returncode == code, (words, done.stdout, done.stderr)
    return done.stdout


def refusals(folder: Path) -> dict[str, list[str]]:
    """What the router refused, by the log of the process."""
    logs = {log.name: log.read_text(encoding="utf-8") for log in folder.rglob("*.log")}
    assert "auction.log" in logs or "contract-net.log" in logs, sorted(logs)
    found = {
        name: [line for line in text.splitlines() if "has no right" in line]
        for name, text in logs.items()
    }
    return {name: lines for name, lines in found.items() if lines}


def drives(guest: Client) -> str:
    """The instance whose commands the robot obeys; "" without one."""
    ack = guest.latest(Ack)
    return "" if ack is None else driver(ack) or ""


def test_a_fleet_with_keys_shares_tasks_by_a_contract_net(start: Start, tmp_path: Path) -> None:
    fleet = f"closed-fleet-{os.getpid()}"
    scenario = tmp_path / "two.toml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    first, second = free_port("127.0.0.1"), free_port("127.0.0.1")
    for name, own in (("r1", first), ("r2", second)):
        text = OF_A_FLEET.format(name=name, own=own, first=first, second=second)
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    robots = [f"{fleet}/{name}" for name in ("r1", "r2")]
    of = [
        ("--hosts", str(tmp_path / f"{name}.toml"), "--host", name, "--namespace", robot)
        for name, robot in zip(("r1", "r2"), robots, strict=True)
    ]
    for each in of:  # one folder is for all
        does("keys", "init", *each)
    starts = ("1.5", "1.5", "0"), ("1.5", "3.5", "0")
    world = start(
        *("sim", "hall", "--port=0", "--namespace", robots[0], "--start", *starts[0]),
        *("--also", robots[1], *starts[1]),
    )
    ports = re.findall(r"tcp://\S+?(?=[,;])", wait_for_line(world, "2 simulated robots"))
    ups: list[subprocess.Popen[str]] = [
        start(
            *("up", str(scenario), *each, "--robot", port, "--start", *at),
            *("--coordination", "contract-net"),
        )
        for each, port, at in zip(of, ports, starts, strict=True)
    ]
    for process in ups:
        wait_for_line(process, "is up")
    routers = [word for port in (first, second) for word in ("--connect", f"tcp/127.0.0.1:{port}")]
    hosts, host = of[0][:2], of[0][2:4]
    attached = start(
        *("run", str(scenario), "--attach", "--namespace", fleet, "--robots", "2", "--json"),
        *(*hosts, *host, *routers),
    )
    out, errors = attached.communicate(timeout=100.0)
    assert attached.returncode == UNKNOWN, errors
    result = json.loads(out)
    assert sorted(task for row in result["robots"] for task in row["tasks"]) == [0, 1]
    assert all(len(row["tasks"]) == 1 for row in result["robots"])
    assert not refusals(tmp_path)
    for robot in robots:
        does("down", "--namespace", robot)
