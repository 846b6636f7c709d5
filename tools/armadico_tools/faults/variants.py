"""The variants of the workload: which robot, in which world, with which task and company.

A case names its variant; all else that is drawn is in the case, so that it can be repeated and
shrunk. `scenario_of` makes the scenario of a case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import hypot
from random import Random
from typing import Final

from msgspec.structs import replace

from armadico.config.moving import Moving
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario, load_scenario, society
from armadico.config.slots import slot
from armadico.config.worlds import Segment, World, load_world
from armadico.core.config_errors import ConfigError, ConfigNameError
from armadico.launch.society import Options, names, prepared
from armadico_tools.faults.fault_types import KINDS
from armadico_tools.faults.plan import Case, Walker, draw, vary

HERE: Final = ""
"""The robot of the scenario."""

ROOMS: Final = ("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "offices", "house")
LASERS: Final = ("jackal", "turtlebot3-burger", "turtlebot4")

GOALS, MISSIONS, BY_HAND, FLEET = "goals", "missions", "by hand", "fleet"


@dataclass(frozen=True)
class Variant:
    """One variant; `weight` is its own in a draw.

    `people` are the numbers of people that may be drawn, `charge` is the range of the battery's
    charge at the beginning.
    """

    name: str
    meaning: str
    robots: tuple[str, ...] = (HERE,)
    scenarios: tuple[str, ...] = ROOMS
    does: str = GOALS
    people: tuple[int, ...] = (0,)
    charge: tuple[float, float] = (1.0, 1.0)
    mission: str = ""
    weight: float = 1.0


VARIANTS: Final = {
    variant.name: variant
    for variant in (
        Variant("sonar", "a Pioneer by sonar, to and fro", weight=3.0),
        Variant("laser", "a ROS 2 robot by laser, to and fro", LASERS, weight=3.0),
        Variant(
            "ros2-sonar", "a ROS 2 robot with sonars and a laser, to and fro", ("jackal-sonars",)
        ),
        Variant(
            "people",
            "to and fro among people, some of whom do not heed the robot",
            (HERE, *LASERS),
            (*ROOMS, "floor-people"),
            people=(1, 2, 4),
            weight=2.0,
        ),
        Variant(
            "mission",
            "a mission of several tasks, with an alarm",
            scenarios=("surveillance",),
            does=MISSIONS,
        ),
        Variant(
            "battery",
            "rounds with a battery that runs low, and a dock",
            scenarios=("surveillance",),
            does=MISSIONS,
            charge=(0.29, 0.4),
            mission="rounds",
        ),
        Variant(
            "by-hand",
            "to and fro, and a hand that drives for a while and lets go",
            (HERE, "turtlebot4"),
            does=BY_HAND,
        ),
        Variant(
            "fleet",
            "to and fro with two more robots, which share a list of tasks",
            scenarios=("fleet",),
            does=FLEET,
        ),
    )
}
"""Every variant by its name. The weights are a choice: by sonar and by laser most often."""

SMALL_AH: Final = 0.35
"""Capacity of the battery in the variant `battery`: its charge falls by a tenth in some minutes."""

ROOM_M: Final = 0.7
"""Boxes and people begin this far from walls, and from the robot's start and goal."""

GRID_M: Final = 0.5


def drivable(scenario: str, robot: str) -> bool:
    """Whether a robot has room at a scenario's start and goal."""
    try:
        _load(scenario, robot)
    except ConfigError:
        return False
    return True


@cache
def _load(scenario: str, robot: str) -> Scenario:
    """A scenario with a robot, unprepared. Raises ConfigError."""
    loaded = load_scenario(scenario)
    if robot in (HERE, loaded.robot):
        return loaded
    # An own goal's check only: a mission's robots may turn in each of its rooms.
    return replace(prepared(loaded, Options(), profile=robot), agents=loaded.agents)


def among(
    variant: str | None = None, scenario: str | None = None, robot: str | None = None
) -> list[Variant]:
    """The variants that a choice leaves. Raises ConfigError if that is none.

    A scenario or robot that no variant lists can be driven to and fro, among people and by hand.
    """
    every = [*VARIANTS.values()] if variant is None else [VARIANTS[variant]]
    to_and_fro = [each for each in every if each.scenarios[: len(ROOMS)] == ROOMS]
    found = every
    if scenario is not None:
        listed = [each for each in found if scenario in each.scenarios]
        found = listed or to_and_fro
    if robot is not None:
        listed = [each for each in found if robot in each.robots]
        laser = load_profile(robot).laser is not None
        able = [each for each in found if each in to_and_fro and each.name != "ros2-sonar"]
        able = [each for each in able if each.name != ("sonar" if laser else "laser")]
        found = listed or able
    if not found:
        given = " ".join(each for each in (variant, scenario, robot) if each)
        raise ConfigError(f"no variant has this choice: {given}")
    if scenario is not None:
        _load(scenario, robot or HERE)
    return found


def check_coordination(
    coordination: str,
    variants: Sequence[Variant],
    scenario: str | None = None,
    robot: str | None = None,
) -> None:
    """Raises ConfigError if a mechanism cannot decide in one of the variants."""
    for one in variants:
        drawn = robot or one.robots[0]
        where = scenario or next(name for name in one.scenarios if drivable(name, drawn))
        case = Case(0, where, 1.0, (), variant=one.name, robot=drawn, coordination=coordination)
        try:
            scenario_of(case)
        except ConfigError as error:
            text = f"the variant {one.name!r} is one that may be drawn (--variant chooses one)"
            raise ConfigError(f"{error}; {text}") from None


def case_of(
    seed: int,
    lasts: float,
    only: Sequence[str] = (),
    scenario: str | None = None,
    robot: str | None = None,
    variant: str | None = None,
    coordination: str | None = None,
) -> Case:
    """The case of a seed: variant, scenario, robot, company and faults, for so many s.

    The faults are of the kinds in `only`, else of some that the seed draws; what is None is drawn.
    """
    rng = Random(f"faults/{seed}")
    variants = among(variant, scenario, robot)
    (one,) = rng.choices(variants, [each.weight for each in variants])
    drawn = rng.choice(one.robots) if robot is None else robot
    able = [name for name in one.scenarios if drivable(name, drawn)]
    case = Case(
        seed,
        scenario or rng.choice(able),
        lasts,
        (),
        vary(Random(f"variation/{seed}")),
        variant=one.name,
        robot=drawn,
        charge=round(rng.uniform(*one.charge), 3),
        coordination=coordination or "",
    )
    ready, options = scenario_of(case)
    people = _people(rng, ready, rng.choice(one.people))
    agents = names(ready, options.without)
    faults = draw(rng, lasts, only, kinds_of(ready), agents)
    return replace(case, people=people, faults=faults)


def kinds_of(scenario: Scenario) -> tuple[str, ...]:
    """The kinds of faults that a scenario's robot and world can have."""
    profile = load_profile(scenario.robot)
    able = {
        "": True,
        "sonar": profile.sonar is not None,
        "laser": profile.laser is not None,
        "serial": profile.section == "p2os",
        "walls": not scenario.others and bool(_inner(load_world(scenario.world))),
        "places": not scenario.others and bool(_places(scenario)),
    }
    return tuple(name for name, kind in KINDS.items() if able[kind.only])


def scenario_of(case: Case) -> tuple[Scenario, Options]:
    """The prepared scenario of a case, and the options of its run. Raises ConfigError."""
    if case.variant not in VARIANTS:
        raise ConfigNameError("variant", case.variant, VARIANTS)
    variant = VARIANTS[case.variant]
    scenario = _load(case.scenario, case.robot)
    besides = society().ideal.without
    if variant.does == BY_HAND:
        besides += slot("by-hand").besides
    if variant.charge != (1.0, 1.0):
        battery = replace(scenario.battery, charge=case.charge, capacity_ah=SMALL_AH)
        scenario = replace(scenario, battery=battery)
    options = Options(
        seed=case.seed,
        margin=case.variation.margin,
        sensors=case.sensors,
        besides=besides,
        coordination=case.coordination or None,
    )
    moving = (*scenario.moving, *_company(case, scenario))
    scenario = replace(scenario, moving=() if scenario.others else moving)
    return prepared(scenario, options, mission=variant.mission or None), options


# The company --------------------------------------------------------------------------------------


def _people(rng: Random, scenario: Scenario, count: int) -> tuple[Walker, ...]:
    places = _places(scenario)
    chosen = rng.sample(places, min(count, len(places)))
    speeds = [rng.choice((0.5, 1.0, 1.3)) for _ in chosen]
    heeds = [rng.random() < 0.75 for _ in chosen]
    return tuple(
        Walker(x, y, speed, heed) for (x, y), speed, heed in zip(chosen, speeds, heeds, strict=True)
    )


def _company(case: Case, scenario: Scenario) -> list[Moving]:
    """People, and what a wrong map has in the wrong place, as far as the faults say."""
    found = [
        Moving(kind="person", at=(p.x, p.y), speed=p.speed, heeds=p.heeds) for p in case.people
    ]
    for fault in case.faults:
        if fault.kind == "missing-wall" and (inner := _inner(load_world(scenario.world))):
            wall = inner[_index(fault.amount, len(inner))]
            if all(wall != moving.wall for moving in found):
                away = (0.0, fault.at, fault.until)  # it is there at first, and again at the end
                found.append(Moving(kind="door", wall=wall, times=away))
        elif fault.kind == "unmapped-box" and (places := _places(scenario)):
            at = places[_index(fault.amount, len(places))]
            size, times = (fault.spread, fault.spread), (fault.at, fault.until)
            found.append(Moving(kind="box", at=at, size=size, times=times))
    return found


def _index(share: float, count: int) -> int:
    """The place at a share of a list; a rounded share may be 1."""
    return min(int(share * count), count - 1)


@cache
def _places_in(world: str) -> tuple[tuple[float, float], ...]:
    here = load_world(world)
    x1, y1, x2, y2 = here.bounds
    columns, rows = int((x2 - x1) / GRID_M), int((y2 - y1) / GRID_M)
    points = [
        (round(x1 + GRID_M * (i + 0.5), 3), round(y1 + GRID_M * (j + 0.5), 3))
        for i in range(columns)
        for j in range(rows)
    ]
    return tuple(p for p in points if here.inside(*p) and here.clearance(*p) >= ROOM_M)


def _places(scenario: Scenario) -> list[tuple[float, float]]:
    """Free places, away from where the robot begins and stops."""
    taken = [scenario.start, *([] if scenario.goal is None else [scenario.goal])]
    return [
        (x, y)
        for x, y in _places_in(scenario.world)
        if all(hypot(x - pose[0], y - pose[1]) > 2.0 * ROOM_M for pose in taken)
    ]


def _inner(world: World) -> Sequence[Segment]:
    """The walls that may be missing: those within the world's rectangle, of some length."""
    x1, y1, x2, y2 = world.bounds

    def outer(wall: Segment) -> bool:
        a, b, c, d = wall
        return (a == c and a in (x1, x2)) or (b == d and b in (y1, y2))

    return [
        wall
        for wall in world.walls
        if not outer(wall) and hypot(wall[2] - wall[0], wall[3] - wall[1]) > GRID_M
    ]
