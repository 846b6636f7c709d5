"""A simulated Pioneer: the plant, its speed loops and its controller, which speaks P2OS."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec.structs import replace

from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant, Streams
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.moving import Moving
from armadico.config.profile import P2osRobot, SensorProfile
from armadico.config.worlds import Column, Pose

Wall = tuple[float, float, float, float]


class Pioneer(SimulatedRobot):
    """A robot with a controller that speaks P2OS."""

    def __init__(
        self,
        profile: P2osRobot,
        sensors: SensorProfile,
        walls: Sequence[Wall],
        start: tuple[float, float, float],
        streams: Streams,
        traps: frozenset[Trap] = KIND,
        moving: Sequence[Moving] = (),
        docks: Sequence[Pose] = (),
        charge: float = 1.0,
        columns: Sequence[Column] = (),
    ) -> None:
        """Stand at `start` (m, m, rad) among walls and columns (m), what moves, and docks (poses).

        `charge` is the share of its battery that is left.
        """
        if Trap.RAYS in traps:
            profile = replace(profile, sonar=replace(profile.sonar, cone_deg=0.0))
        plant = Plant(*(profile, sensors, walls, start, streams, moving, docks, charge, columns))
        loops = SpeedLoops(profile.speed_loop, profile.motor.supply_v)
        controller = Microcontroller(profile, plant, loops, traps)
        super().__init__(plant, controller, profile.p2os.name, profile.p2os.cycle_s)
