"""The three use cases of thesis 3.2: their requirements, and whether they were met."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from statistics import median
from typing import Final

from msgspec import Struct

from armadico.agents.missions.messages import Board, ChargeState, ChargeStatus, MissionEnd
from armadico.config.scenarios import Battery
from armadico.mobile.messages import Planned, Truth
from armadico_tools.building import Building, text
from armadico_tools.experiments.runner import Context, Experiment, Part, Table
from armadico_tools.markdown import table

SENSORS: Final = ("ideal", "real")

THERE_AND_BACK: Final = text('do = "move", to = "R1"', 'do = "move", to = "hall"')
SMALL_AH: Final = 0.1
"""A battery that is charged in a minute."""

NOTE: Final = (
    "The building of thesis 3.6.1 with its whole society on the virtual mesh. The number of runs"
    " that met each requirement of a use case; each run has a new society. *s* is the duration of"
    " the use case, the median of the runs that met all."
)

Demands = Iterator[tuple[str, bool]]
"""Requirements, and whether each was met; a wait without result raises `AssertionError`."""


class Came(Struct, frozen=True):
    """The result of one use case with one seed."""

    case: str
    sensors: str
    seed: int
    took_s: float
    demands: tuple[tuple[str, bool], ...]
    fault: str = ""  # the wait without result


def accepting(building: Building) -> Demands:
    """Use case 1, accepting a new robot mission: the more urgent one is done first."""
    first = building.taken(THERE_AND_BACK, 0.5, "first")
    building.until(lambda: building.mission(first).course.elapsed > 4.0)
    waits = building.taken(text('do = "take-photo"'), 0.2, "waits")
    yield "a less urgent mission waits", building.mission(waits).state is MissionEnd.QUEUED
    urgent = building.taken(text('do = "move", to = "R2"', 'do = "take-photo"'), 0.9, "urgent")
    building.run(1.0)
    begun = building.mission(first).course
    suspended = building.mission(first).state is MissionEnd.SUSPENDED
    active = building.mission(urgent).state is MissionEnd.ACTIVE
    yield "a more urgent one suspends the active mission", suspended and active
    building.until(lambda: building.ended(urgent), 300.0)
    stood = building.mission(first).course.elapsed - begun.elapsed < 1.0
    yield "no time counts for a suspended mission", stood
    building.until(lambda: building.ended(first), 300.0)
    yield "it goes on, and does all its steps", building.steps(first) == ["move(R1)", "move(hall)"]
    building.until(lambda: building.ended(waits), 60.0)
    ends = {m.state for m in building.board.missions} if building.board else set()
    yield "all are done", ends == {MissionEnd.DONE}
    order = [m.name for board in building.heard(Board) for m in board.missions if m.doing]
    turns = [*dict.fromkeys(order)], "first" in order[order.index("urgent") :]
    yield "in the order of their urgency", turns == (["first", "urgent", "waits"], True)


def planning(building: Building) -> Demands:
    """Use case 2, planning a robot movement: the charger warns, and the robot charges first."""
    number = building.taken(THERE_AND_BACK, 1.0)
    building.until(lambda: any("the energy will not do" in line for line in building.logs), 20.0)
    warning = next(line for line in building.logs if "the energy will not do" in line)
    stated = "kJ are left" in warning and "kJ are needed" in warning
    yield "the charger states the remaining and the needed energy", stated
    ways = {planned.plan.energy for planned in building.heard(Planned)}
    yield "it has planned the way, and on to a dock", len(ways) >= 2
    building.until(lambda: building.doing(number).startswith("dock"), 5.0)
    ahead = building.mission(number).ahead == ("move(R1)", "move(hall)")
    yield "the mission charges first, and keeps its steps", ahead
    building.until(lambda: building.ended(number), 900.0)
    steps = building.steps(number)
    yield "then it does them", steps == ["dock", "move(R1)", "move(hall)"]
    states = {status.state for status in building.heard(ChargeStatus)}
    yield "it was charged in between", ChargeState.CHARGING in states


def moving(building: Building) -> Demands:
    """Use case 3, moving the robot: the charger takes the trajectory on the way, and returns it."""
    rows = 'do = "move", to = "R11"', 'do = "move", to = "R2"'
    number = building.taken(text(*rows, above='energy = "risk"'), 0.2)
    building.until(lambda: building.ended(number), 1800.0)
    yield "the mission is done", building.mission(number).state is MissionEnd.DONE
    yield "all its steps are", building.steps(number) == ["move(R11)", "move(R2)"]
    back = ["mission-planning", "battery-charger", "mission-planning"]
    held = building.who_had("trajectory")[:3] == back
    yield "the charger takes the trajectory, and returns it", held
    wheels = {"goto", "gothrough"} <= {*building.who_had("wheels")}
    yield "goto and gothrough share the wheels", wheels


Case = Callable[[Building], Demands]
CASES: Final[dict[str, tuple[Case, Battery]]] = {
    "1, accepting a new robot mission": (accepting, Battery()),
    "2, planning a robot movement": (planning, Battery(0.3, SMALL_AH)),
    "3, moving the robot": (moving, Battery(0.8, SMALL_AH)),
}
"""By name: the requirements, and the battery at the start."""


def come(task: tuple[str, str, int]) -> Came:
    """One use case with these sensors and a seed."""
    name, sensors, seed = task
    case, battery = CASES[name]
    building = Building(seed, battery=battery, sensors=sensors)
    touched = [0]

    def knocked(_key: str, truth: object, _now: float) -> None:
        if isinstance(truth, Truth):
            touched[0] = truth.collisions

    building.mesh.watch(knocked, Truth)
    begun, demands, fault = building.mesh.now, list[tuple[str, bool]](), ""
    try:
        demands.extend(case(building))
    except AssertionError as error:
        fault = str(error)
    demands.append(("nothing is touched", not touched[0]))
    took = building.mesh.now - begun
    return Came(name, sensors, seed, took, tuple(demands), fault)


def is_met(came: Came) -> bool:
    """Whether all requirements were met."""
    return not came.fault and all(so for _, so in came.demands)


def _rows(found: Sequence[Came]) -> Table:
    head = "case", "sensors", "seed", "took_s", "unmet", "fault"
    unmet = ["; ".join(what for what, so in one.demands if not so) for one in found]
    return head, [
        (one.case, one.sensors, one.seed, round(one.took_s, 1), what, one.fault)
        for one, what in zip(found, unmet, strict=True)
    ]


def as_table(found: list[Came]) -> str:
    """A row for each requirement, and one for the whole of each use case."""
    rows = []
    for name in CASES:
        arms = [[c for c in found if (c.case, c.sensors) == (name, kind)] for kind in SENSORS]
        whats = dict.fromkeys(what for arm in arms for one in arm for what, _ in one.demands)
        rows += [[name, what, *(_count(arm, what) for arm in arms)] for what in whats]
        rows.append([name, "**all of it**", *(_whole(arm) for arm in arms)])
    return table(("use case", "requirement", *SENSORS), rows)


def _count(arm: list[Came], what: str) -> str:
    return f"{sum((what, True) in one.demands for one in arm)} of {len(arm)}"


def _whole(arm: list[Came]) -> str:
    good = [one.took_s for one in arm if is_met(one)]
    took = f", {median(good):.0f} s" if good else ""
    return f"**{len(good)} of {len(arm)}**{took}"


def _tasks(context: Context) -> list[tuple[str, str, int]]:
    return [(name, kind, seed) for name in CASES for kind in SENSORS for seed in context.seeds]


def _report(context: Context) -> str:
    found = context.found["runs"]
    context.summary = {"runs": len(found), "as asked": sum(map(is_met, found))}
    return as_table(found)


USE_CASES: Final = Experiment(
    note=NOTE, parts=(Part("runs", come, _tasks, _rows),), report=_report, runs=10
)
