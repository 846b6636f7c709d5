"""A simulated Pioneer, whole: the plant, its speed loops and its controller behind one port.

Bytes and the time in, bytes out, and the truth for those who watch: the same object stands behind a
TCP port or pty in real time (`server`) and behind the memory transport of the virtual mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite, radians

from msgspec.structs import replace

from armadico.bridge.simulator.arena import Arena
from armadico.bridge.simulator.microcontroller import Microcontroller
from armadico.bridge.simulator.plant import Plant, Streams
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.bridge.simulator.traps import KIND, Trap
from armadico.config.loading import find, load_entry
from armadico.config.moving import Moving
from armadico.config.profile import RobotProfile, SensorProfile, load_profile
from armadico.config.scenarios import Scenario
from armadico.config.worlds import Column, Pose, load_world
from armadico.core.messages import Message, Truth

Wall = tuple[float, float, float, float]


class Pioneer:
    """The robot as its port shows it."""

    def __init__(
        self,
        profile: RobotProfile,
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
        self.plant = Plant(
            *(profile, sensors, walls, start, streams, moving, docks, charge, columns)
        )
        loops = SpeedLoops(profile.speed_loop, profile.motor.supply_v)
        self.controller = Microcontroller(profile, self.plant, loops, traps)
        self._watchers: list[Callable[[Truth], None]] = []
        self._name, self._cycle = profile.p2os.name, profile.p2os.cycle_s
        self._answering = False
        self._truth_at = 0.0
        self._said = bytearray()  # for the client
        self.bring_forward: Callable[[float], None] = self.live
        """What lets time pass: for this robot alone, or for all that are in one world with it."""

    def watch(self, watcher: Callable[[Truth], None]) -> None:
        """Call `watcher` with the truth at every status packet."""
        self._watchers.append(watcher)

    def receive(self, data: bytes, now: float) -> None:
        """Take the client's bytes at a time, s of simulation."""
        self._answering = True
        if now > self.controller.time_s:
            self.bring_forward(now)
        self.controller.receive(data)

    def live(self, now: float) -> None:
        """Live up to a time, s of simulation, whoever else is in its world."""
        self._said += self.controller.advance(now)

    def advance(self, now: float) -> bytes:
        """Live up to a time, s of simulation; the bytes for the client."""
        self.bring_forward(now)
        data = bytes(self._said)
        self._said.clear()
        self._answering = False
        if now + 1e-9 >= self._truth_at:
            self._truth_at += self._cycle
            self._tell()
        return data

    @property
    def due(self) -> float:
        """When it next has something to send, s of simulation."""
        if self._answering:
            return self.controller.time_s + self.plant.step_s
        if not self.controller.is_open:
            return self._truth_at
        return self.controller.next_status_s

    def meet(self, *others: Pioneer) -> None:
        """Live in one world with others. Raises ValueError if one stands in something."""
        Arena((self, *others))

    def truth(self) -> Truth:
        """True pose, speeds and clearance, which no agent can measure."""
        plant = self.plant
        x, y, theta = plant.pose
        v, w = plant.speeds
        clearance = plant.clearance()
        return Truth(
            t=round(self.controller.time_s, 6),
            x=x,
            y=y,
            theta=theta,
            v=v,
            w=w,
            collisions=plant.collisions + plant.bumps,
            clearance=clearance if isfinite(clearance) else None,
            simulator=self._name,
            bumped=plant.bumps,
            charge=plant.battery.charge,
            used=plant.battery.used_j,
        )

    def _tell(self) -> None:
        if self._watchers:
            truth = self.truth()
            for watcher in self._watchers:
                watcher(truth)


def of_scenario(
    scenario: Scenario, streams: Streams, name: str = "", traps: frozenset[Trap] = KIND
) -> Pioneer:
    """The robot that a scenario names, where the scenario puts it.

    Its controller has a name of its own where other simulators may be about.
    """
    x, y, degrees = scenario.start
    profile, world = load_profile(scenario.robot), load_world(scenario.world)
    battery = profile.battery
    return Pioneer(
        replace(
            profile,
            p2os=replace(profile.p2os, name=name or profile.p2os.name),
            battery=replace(
                battery, capacity_ah=scenario.battery.capacity_ah or battery.capacity_ah
            ),
        ),
        load_entry(find("robots", "sensors"), SensorProfile, scenario.sensors),
        world.walls,
        (x, y, radians(degrees)),
        streams,
        traps,
        scenario.moving,
        tuple(world.docks.values()),
        scenario.battery.charge,
        world.columns,
    )


def on_virtual_mesh(
    scenario: Scenario, streams: Streams, publish: Callable[[Message], None]
) -> Pioneer:
    """The same, publishing the truth on a mesh."""
    pioneer = of_scenario(scenario, streams)
    pioneer.watch(publish)
    return pioneer
