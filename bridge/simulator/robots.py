"""The simulated robot that a scenario names, whichever protocol it speaks."""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from armadico.bridge.simulator.pioneer import Pioneer
from armadico.bridge.simulator.plant import Site, Streams
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.loading import find, load_entry
from armadico.config.profile import Ros2Robot, SensorProfile, load_profile
from armadico.config.scenarios import Scenario
from armadico.config.worlds import load_world
from armadico.core.messages import Message


def of_scenario(
    scenario: Scenario, streams: Streams, name: str = "", traps: frozenset[Trap] = KIND
) -> SimulatedRobot:
    """The robot that a scenario names, where the scenario puts it.

    Its controller has a name of its own where other simulators may be about. `traps` are those of
    controllers that speak P2OS.
    """
    start = scenario.start
    profile, world = load_profile(scenario.robot), load_world(scenario.world)
    capacity_ah = scenario.battery.capacity_ah or profile.battery.capacity_ah
    profile = replace(profile, battery=replace(profile.battery, capacity_ah=capacity_ah))
    sensors = load_entry(find("robots", "sensors"), SensorProfile, scenario.sensors)
    docks, charge = tuple(world.docks.values()), scenario.battery.charge
    site = Site(world.walls, start, world.columns, scenario.moving, docks, charge)
    if isinstance(profile, Ros2Robot):
        # As in `armadico.bridge.robot`: who speaks P2OS does not wait for ROS 2's messages.
        from armadico.bridge.simulator.ros2_robot import Ros2SimulatedRobot  # noqa: PLC0415

        return Ros2SimulatedRobot(profile, sensors, site, streams, name)
    profile = replace(profile, p2os=replace(profile.p2os, name=name or profile.p2os.name))
    return Pioneer(profile, sensors, site, streams, traps)


def on_virtual_mesh(
    scenario: Scenario, streams: Streams, publish: Callable[[Message], None]
) -> SimulatedRobot:
    """The same, publishing the truth on a mesh."""
    robot = of_scenario(scenario, streams)
    robot.watch(publish)
    return robot
