"""The stage of a scenario's simulated robot, for any kind of robot."""

from __future__ import annotations

from dataclasses import dataclass

from msgspec.structs import replace

from armadico.bridge.simulator.plant import Site, Streams
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.loading import find, load_entry
from armadico.config.profile import RobotProfile, SensorProfile, load_profile
from armadico.config.scenarios import Scenario
from armadico.config.worlds import load_world


@dataclass(frozen=True)
class Stage:
    """The surroundings of a simulated robot."""

    sensors: SensorProfile
    site: Site
    streams: Streams  # of random numbers, by name
    name: str = ""  # of its controller, to tell simulators apart; "": the profile's
    traps: frozenset[Trap] = KIND
    clock_s: float = 0.0  # of the robot's clock at the start


def staged(
    scenario: Scenario, streams: Streams, name: str, traps: frozenset[Trap], clock_s: float
) -> tuple[RobotProfile, Stage]:
    """The profile of a scenario's robot, with the scenario's battery, and its stage.

    A wall of the world is left out where a moving door has its place: it is there only at times,
    though it is on the map.
    """
    start = scenario.start
    profile, world = load_profile(scenario.robot), load_world(scenario.world)
    capacity_ah = scenario.battery.capacity_ah or profile.battery.capacity_ah
    profile = replace(profile, battery=replace(profile.battery, capacity_ah=capacity_ah))
    sensors = load_entry(find("robots", "sensors"), SensorProfile, scenario.sensors)
    docks, charge = tuple(world.docks.values()), scenario.battery.charge
    doors = {moving.wall for moving in scenario.moving}
    walls = tuple(wall for wall in world.walls if wall not in doors)
    site = Site(walls, start, world.columns, scenario.moving, docks, charge)
    return profile, Stage(sensors, site, streams, name, traps, clock_s)
