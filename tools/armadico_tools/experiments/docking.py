"""How well the robot is driven into a dock, by sonars and localization (thesis 3.6.4)."""

from __future__ import annotations

from math import degrees, hypot
from statistics import mean
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from armadico.agents.missions.messages import ChargeState, ChargeStatus
from armadico.config.scenarios import Battery, Scenario, load_scenario
from armadico.config.worlds import load_world
from armadico.core.messages import Message
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import relative
from armadico_tools.markdown import table

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Into a dock, with sensors as real ones are"
CHARGING: Final = ("battery-sensor", "battery-charger", "dock")
WAYS: Final = {"house": (12.6, 1.2, -90.0), "offices": None, "floor": None}
"""World, and where it begins if that is not the scenario's start."""

CHARGE: Final = 0.4  # of a battery of 5 Ah: nobody else wants to drive, so it is charged
LONGEST_S: Final = 300.0
SETTLED_S: Final = 2.0

NOTE: Final = (
    "Everybody takes part, localization and the three agents of charging among them; 40 % of the"
    " battery are left, and nobody sends the robot anywhere. *Ahead*, *aside* and *turned* are how"
    " far off the dock's pose the robot truly stands, the mean of the sizes and the largest one;"
    " contact is met within 5 cm and 8 degrees. *Attempts* is how often it was driven in."
)


class Docked(Struct, frozen=True):
    """One run; m, m, degrees, s."""

    world: str
    seed: int
    charging: bool
    attempts: int
    took_s: float
    ahead_m: float
    aside_m: float
    turned_deg: float
    collisions: int


def scenario_of(world: str) -> Scenario:
    """The world's scenario, with nobody to send the robot, and a battery to be charged."""
    found, start = load_scenario(world), WAYS[world]
    return replace(
        found,
        goal=None,
        start=start or found.start,
        agents=(*found.agents, *CHARGING),
        battery=Battery(CHARGE, 5.0),
    )


def drive(task: tuple[str, int]) -> Docked:
    world, seed = task
    rehearsal = Rehearsal(scenario_of(world), Options(seed=seed))
    mesh, states = rehearsal.mesh, [ChargeState.NONE]

    def heard(_key: str, status: Message, _now: float) -> None:
        if isinstance(status, ChargeStatus) and status.state is not states[-1]:
            states.append(status.state)

    mesh.watch(heard, ChargeStatus)
    rehearsal.start()
    mesh.run(mesh.now + LONGEST_S, lambda: states[-1] is ChargeState.CHARGING)
    took = mesh.now
    mesh.run(mesh.now + SETTLED_S)
    truth = rehearsal.watch.view.truth
    assert truth is not None, "it is simulated"
    here = (truth.x, truth.y, truth.theta)
    docks = load_world(rehearsal.scenario.world).docks.values()
    dock = min(docks, key=lambda pose: hypot(pose[0] - here[0], pose[1] - here[1]))
    ahead, aside, turned = relative(dock, here)
    charging, attempts = states[-1] is ChargeState.CHARGING, states.count(ChargeState.DOCKING)
    off = (ahead, aside, degrees(turned))
    return Docked(world, seed, charging, attempts, took, *off, truth.collisions)


def run(context: Context) -> None:
    runs = context.map(drive, [(w, seed) for w in WAYS for seed in context.seeds], "docking")
    fields = Docked.__struct_fields__
    context.rows("runs", fields, [[getattr(one, field) for field in fields] for one in runs])
    head = (
        *("world", "charging", "at the first attempt", "s"),
        *("ahead, cm", "aside, cm", "turned, degrees", "touched"),
    )
    rows = [_line(world, [one for one in runs if one.world == world]) for world in WAYS]
    context.summary |= {"charging": sum(one.charging for one in runs), "runs": len(runs)}
    context.table(f"# {TITLE}\n\n{NOTE}\n\n{table(head, rows)}")


def _line(world: str, runs: list[Docked]) -> list[object]:
    good = [one for one in runs if one.charging]
    counts = f"{len(good)} of {len(runs)}", sum(one.attempts == 1 for one in good)
    if not good:
        return [world, *counts, *["-"] * 4, sum(bool(one.collisions) for one in runs)]
    return [
        world,
        *counts,
        f"{mean(one.took_s for one in good):.0f}",
        _spread([100.0 * one.ahead_m for one in good]),
        _spread([100.0 * one.aside_m for one in good]),
        _spread([one.turned_deg for one in good]),
        sum(bool(one.collisions) for one in runs),
    ]


def _spread(values: list[float]) -> str:
    sizes = [abs(value) for value in values]
    return f"{mean(sizes):.1f}, {max(sizes):.1f}"
