"""A simulated Pioneer: the plant, its speed loops and its controller, which speaks P2OS."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant, Site, Streams
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.profile import P2osRobot, SensorProfile


class Pioneer(SimulatedRobot):
    """A robot with a controller that speaks P2OS."""

    def __init__(
        self,
        profile: P2osRobot,
        sensors: SensorProfile,
        site: Site,
        streams: Streams,
        traps: frozenset[Trap] = KIND,
    ) -> None:
        """Stand where the site has it begin, among all that is there."""
        if Trap.RAYS in traps:
            profile = replace(profile, sonar=replace(profile.sonar, cone_deg=0.0))
        plant = Plant(profile, sensors, site, streams)
        motor, body = profile.motor, profile.body
        emf = motor.back_emf_v_s * motor.gear_ratio / body.wheel_radius_m
        per_axis = emf, emf * body.half_track_m
        loops = SpeedLoops(profile.speed_loop, motor.supply_v, emf=per_axis)
        controller = Microcontroller(profile, plant, loops, traps)
        super().__init__(plant, controller, profile.p2os.name, profile.p2os.cycle_s)
