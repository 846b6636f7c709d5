"""The society against the unkind controller."""

from __future__ import annotations

import json
import math
from contextlib import ExitStack
from pathlib import Path

import pytest

from armadico.bridge.kind import RobotKind
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.plant import Streams
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.bridge.simulator.traps import UNKIND
from armadico.config.scenarios import Scenario, ideal, load_scenario
from armadico.core.messages import Description
from armadico.launch.client import Client
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.ports import free_port
from armadico.mobile.messages import Pose, Truth
from armadico.observe.view import View
from tests.programs import NO_PICTURE, SOON, starter
from tests.robot.society import mesh_of


def agree(pose: Pose | None, truth: Truth | None) -> bool:
    """Whether the robot rests where it estimates to be."""
    assert pose is not None
    assert truth is not None
    turned = math.remainder(pose.theta - truth.theta, math.tau)
    return math.hypot(pose.x - truth.x, pose.y - truth.y) < 0.02 and abs(turned) < 0.02


SEEN = (Description, Pose, Truth)  # the truth counts by the description of its robot


@pytest.mark.long(but=("house",))
@pytest.mark.parametrize("name", ["sc2", "sc4", "house"])
def test_a_scenario_reaches_its_goal(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Three of nine; live, all were driven by hand (docs/controller.md)."""

    def unkind(kind: RobotKind[P2osRobot], scenario: Scenario, streams: Streams) -> SimulatedRobot:
        return in_scenario(kind, scenario, streams, traps=UNKIND)

    in_scenario = RobotKind.in_scenario
    monkeypatch.setattr(RobotKind, "in_scenario", unkind)
    rehearsal, view = Rehearsal(ideal(load_scenario(name)), Options(seed=7)), View()
    rehearsal.mesh.watch(lambda _, message, now: view.learn(message, now), *SEEN)
    assert rehearsal.run().reached
    assert agree(view.pose, view.truth)


@pytest.mark.long
@pytest.mark.live
def test_live_it_does_so_over_tcp_and_over_a_serial_line_at_once(tmp_path: Path) -> None:
    lines = {
        "unkind-tcp": ("--port", str(free_port())),
        "unkind-pty": ("--pty", str(tmp_path / "robot")),
    }
    with starter() as start, ExitStack() as stack:
        runs = []
        for namespace, line in lines.items():
            guest = Client(stack.enter_context(mesh_of(namespace)))
            guest.listen(Pose, Truth)
            simulator = start("sim", "sc1", "--unkind", *line, "--namespace", namespace)
            assert simulator.stdout is not None
            url = simulator.stdout.readline().partition(" at ")[2].partition(";")[0]
            words = ("--robot", url, "--namespace", namespace, *NO_PICTURE, "--json")
            runs.append((guest, start("run", "sc1", "--goal", "0.6", "0", "0", *words)))
        for guest, run in runs:
            out, errors = run.communicate(timeout=SOON)
            assert run.returncode == 0, errors
            assert json.loads(out)["reached"]
            assert agree(guest.latest(Pose), guest.latest(Truth))
