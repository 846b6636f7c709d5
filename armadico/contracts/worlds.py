"""The contract of a world file: a map in which a robot can start, and reach what has a name.

class TestOffice(WorldContract):
    world = "office.map"
    profile = "turtlebot4"
"""

from __future__ import annotations

from math import atan2, isfinite
from pathlib import Path
from typing import ClassVar

from armadico.config.profile import load_profile
from armadico.config.scenarios import scenario_from
from armadico.config.worlds import Pose, World, load_world
from armadico.contracts.contract import Contract
from armadico.core.config_errors import ConfigError
from armadico.core.judgement import Judgement, all_of, no, unknown, whether, yes
from armadico.launch.api import run


class WorldContract(Contract):
    """The checks of one world, for one robot.

    Attributes:
        world: A shipped world, or a `.map` or `.yaml` file.
        profile: The robot that is to drive there.
    """

    world: ClassVar[str | Path] = ""
    profile: ClassVar[str] = "pioneer-2dx"

    def check_is_read(self) -> Judgement:
        """It is read, has finite walls within its bounds, and a start."""
        world = self._read()
        x1, y1, x2, y2 = world.bounds
        numbers = (*world.bounds, *(value for wall in world.walls for value in wall))
        outside = [
            wall
            for wall in world.walls
            if not all(
                x1 - 1e-6 <= x <= x2 + 1e-6 and y1 - 1e-6 <= y <= y2 + 1e-6
                for x, y in (wall[:2], wall[2:])
            )
        ]
        return all_of(
            (
                whether(all(map(isfinite, numbers)), "a wall or a border is not finite"),
                whether(not outside, f"{len(outside)} walls are outside the bounds {world.bounds}"),
                whether(
                    True if world.outlines else None,
                    "it has no walls, so there is nothing to plan around or to localize against",
                    "check occupied_thresh, negate and mode of a map_server's file",
                ),
                whether(
                    None if world.start is None else True,
                    "it names no start, so none was tried",
                    "add a RobotHome to the .map",
                ),
            )
        )

    def check_start_has_room(self) -> Judgement:
        """The robot can turn at the start."""
        world = self._read()
        if world.start is None:
            return unknown("it names no start", "add a RobotHome to the .map")
        x, y, _ = world.start
        needed, there = load_profile(self.profile).body.goal_room_m, world.clearance(x, y)
        return whether(there >= needed, f"{there:.2f} m of room; {self.profile} needs {needed:.2f}")

    def check_every_place_can_be_reached(self) -> Judgement:
        """From the start there is a path for the robot to each goal, dock and door."""
        world = self._read()
        if world.start is None:
            return unknown("it names no start", "add a RobotHome to the .map")
        sx, sy, _ = world.start
        places: dict[str, Pose] = dict(world.goals)
        for door in world.doors:
            places[f"door {door.name}"] = (door.x, door.y, atan2(door.y - sy, door.x - sx))
        if not places:
            return unknown("it names no goal and no door", "add a Goal to the .map")
        found = []
        for name, pose in places.items():
            try:
                scenario_from(str(self.world), world.start, pose, self.profile)
            except ConfigError as error:
                found.append(no(f"{name}: {error}"))
        return all_of(found) if found else yes()

    def check_is_driven(self) -> Judgement:
        """With all agents the robot drives from the start to the first goal without a collision."""
        world = self._read()
        if world.start is None or not world.goals:
            return unknown("it names no start, or no goal", "add a RobotHome and a Goal")
        goal = next(iter(world.goals.values()))
        scenario = scenario_from(str(self.world), world.start, goal, self.profile)
        result = run(scenario, virtual=True, seed=1).measures
        collisions = result.collisions
        return all_of(
            (
                whether(result.reached, result.outcome),
                whether(
                    None if collisions is None else not collisions, f"collisions: {collisions}"
                ),
            )
        )

    def _read(self) -> World:
        return load_world(self.world)
