"""Clocks that are stepped: no agent counts time in which it observed nothing.

Every agent of a society is stepped, so an agent with a time limit of its own is found, too.
"""

from __future__ import annotations

from itertools import cycle

import pytest
from msgspec.structs import replace

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.config.scenarios import Scenario, exploring, load_scenario
from armadico.core.messages import Log
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import VirtualMesh

STEP_S = 3600.0
FLEET = load_scenario("fleet")
BLAMED = ("no nearer", "3600", "the charge of the battery is not known", "is given back")


class Stepped:
    """Steps the clocks of all processes again and again, one after another, from 8 s on."""

    def __init__(self, mesh: VirtualMesh) -> None:
        self._mesh, self._nodes, self._at = mesh, cycle(mesh.nodes), 8.0
        self.steps = 0
        self.lines: list[str] = []
        for namespace in {node.namespace for node in mesh.nodes}:
            mesh.watch(self._read, Log, namespace=namespace)

    def _read(self, _key: str, log: Log, _now: float) -> None:
        self.lines.append(log.text)

    def go_on(self) -> None:
        while self._mesh.now >= self._at:
            self._at += 1.0
            self.steps += 1
            next(self._nodes).jump(STEP_S)

    def blamed(self) -> list[str]:
        """What agents have given up by an hour that never was."""
        return [text for text in self.lines if any(word in text for word in BLAMED)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("scenario", "sets"),
    [
        (load_scenario("house"), ()),
        # A step of the robot agent's clock ends what its gate has seen beside it. Turning in a
        # corner then takes longer than 15 s, so a limit that only the hour exceeds.
        (exploring(load_scenario("sc3")), ("explore.stuck_s=120",)),
    ],
    ids=("house", "exploring"),
)
def test_a_step_of_every_clock_fails_no_mission(scenario: Scenario, sets: tuple[str, ...]) -> None:
    run = Rehearsal(scenario, Options(seed=1, sets=sets))
    stepped = Stepped(run.mesh)
    result = run.run(lambda _: stepped.go_on())
    assert stepped.steps >= len(run.mesh.nodes), "each was stepped on the way"
    assert result.passed, result.verdict
    assert stepped.blamed() == []


@pytest.mark.long
def test_a_step_of_every_clock_gives_no_task_of_a_fleet_back() -> None:
    scenario = replace(FLEET, tasks=FLEET.tasks[:1] + FLEET.tasks[9:11], look_s=2.0)
    fleet = FleetRehearsal(scenario, Options(seed=1), 2)
    stepped = Stepped(fleet.mesh)
    result = fleet.run(lambda _: stepped.go_on())
    assert stepped.steps >= len(fleet.mesh.nodes), "each was stepped on the way"
    assert result.passed, result.verdict
    assert stepped.blamed() == []
