"""A simulated Pioneer: the plant, its speed loops and its controller, which speaks P2OS."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.bridge.simulator.traps import Trap


class Pioneer(SimulatedRobot):
    def __init__(self, profile: P2osRobot, stage: Stage) -> None:
        """Place the robot at the stage's start."""
        units = profile.p2os
        profile = replace(profile, p2os=replace(units, name=stage.name or units.name))
        if Trap.RAYS in stage.traps:
            profile = replace(profile, sonar=replace(profile.sonar, cone_deg=0.0))
        plant = Plant(profile, stage.sensors, stage.site, stage.streams)
        motor, body = profile.motor, profile.body
        emf = motor.back_emf_v_s * motor.gear_ratio / body.wheel_radius_m
        per_axis = emf, emf * body.half_track_m
        loops = SpeedLoops(profile.speed_loop, motor.supply_v, emf=per_axis)
        controller = Microcontroller(profile, plant, loops, stage.traps)
        super().__init__(plant, controller, profile.p2os.name, profile.p2os.cycle_s)
