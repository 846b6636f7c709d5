"""Societies with keys that drive by a mechanism with an arbiter, as real processes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import armadico
from armadico.cli.options import UNKNOWN
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Proposal
from armadico.launch.client import Client
from armadico.mesh.ports import free_port
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.observe.view import driver
from tests.programs import Start, call, starter
from tests.robot.hosts.conftest import wait_for_line
from tests.runtime_folder import fresh_folder
from tests.whole.live.test_fleet import SCENARIO

pytestmark = [pytest.mark.live, pytest.mark.long, pytest.mark.timeout(240)]

SOON_S = 40.0  # a deadline, not an expectation

TWO_COMPUTERS = """\
keys = "keys"
[lab1]
router = "tcp/127.0.0.1:{port}"
agents = ["robot", "encoder", "sonar", "path-planning", "interface", "goto", "auction"]
[lab2]
address = "127.0.0.2"
agents = ["avoid"]
"""

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


def test_an_arbiter_awards_to_two_computers_and_is_followed_when_it_is_killed(
    start: Start, tmp_path: Path
) -> None:
    table = tmp_path / "lab.toml"
    table.write_text(TWO_COMPUTERS.format(port=free_port("127.0.0.1")), encoding="utf-8")
    elsewhere = tmp_path / "lab2" / "lab.toml"
    does("keys", "init", "--hosts", str(table), "--host", "lab1")
    keys2 = str(elsewhere.parent / "keys")
    does("keys", "host", "lab2", "--hosts", str(table), "--out", keys2)
    elsewhere.write_text(table.read_text(encoding="utf-8"), encoding="utf-8")
    by = ("--coordination", "auction")
    env = {**os.environ, RUNTIME_VARIABLE: fresh_folder()}
    with starter(env=env) as start_elsewhere:
        wait_for_line(start("up", "sc1", "--hosts", str(table), "--host", "lab1", *by), "is up")
        there = ("up", "sc1", "--hosts", str(elsewhere), "--host", "lab2", *by)
        wait_for_line(start_elsewhere(*there), "is up")
        with armadico.connect() as guest:
            proposing: set[str] = set()
            guest.listen(Proposal, then=lambda p, _: proposing.add(agent_of(p.instance)))
            guest.listen(Ack)
            going = start("goto", "4.0", "0.0", "--timeout", "90")
            assert guest.wait_for(lambda: proposing == {"goto", "avoid"}, SOON_S)
            killed = drives(guest)
            assert agent_of(killed) == "auction"
            card = guest.card("auction", killed)
            assert card is not None
            os.kill(card.pid, signal.SIGKILL)
            assert agent_of(drives(guest, but=killed)) == "auction"
        _, errors = going.communicate(timeout=100.0)
        assert going.returncode == 0, errors
        said = call("doctor").stdout
        assert "The mechanism auction decides who drives" in said
        assert "HELD" not in said, "who was killed can release nothing"
        assert not refusals(tmp_path)
        does("down")


def drives(guest: Client, *, but: str = "") -> str:
    """The instance whose commands the robot obeys, once there is one other than `but`."""
    found: list[str] = []

    def look() -> bool:
        ack = guest.latest(Ack)
        name = "" if ack is None else driver(ack) or ""
        found.extend([name] * (name not in ("", but)))
        return bool(found)

    assert guest.wait_for(look, SOON_S)
    return found[0]


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
