"""The physical robot in its world: voltages in; motion, odometry, echoes and contacts out.

`Plant` steps the dynamics by 5 ms and has the true state. Contacts are expensive, so pymunk is used
only where they are possible. The plant keeps a lower bound of the distance between footprint and
walls. Each step subtracts the largest possible motion of a corner, turning included; at zero the
bound is computed anew. The motion is bit for bit the same as with a query in every step.

All randomness comes from named streams (`seeded`, or the virtual mesh's `stream`): one per purpose,
so that a new purpose does not change the noise of others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, inf, sin
from random import Random

import numpy as np

from armadico.bridge.simulator.battery import Battery
from armadico.bridge.simulator.broken import Readings
from armadico.bridge.simulator.company import Body, Company
from armadico.bridge.simulator.contact import SKIN_M, Contact, Motion, Outline, box_of
from armadico.bridge.simulator.dynamics import Dynamics
from armadico.bridge.simulator.encoders import Odometry
from armadico.bridge.simulator.kinematics import Kinematics
from armadico.bridge.simulator.laser import LaserScanner, shifted
from armadico.bridge.simulator.moving import STEP_S as MOVE_S
from armadico.bridge.simulator.moving import Movement
from armadico.bridge.simulator.sonar import Sonars, Surfaces
from armadico.bridge.simulator.walls import TOUCH_M, Floats, Wall, Walls
from armadico.config.moving import Moving
from armadico.config.profile import IdentifiedRobot, ModelledRobot, SensorProfile
from armadico.config.worlds import Column, Pose
from armadico.core.config_errors import ConfigError

STEP_S = 0.005
MOVE_STEPS = round(MOVE_S / STEP_S)
APART_S = 0.5  # contacts less than this apart are one collision
FASTEST_M_S = 1e3  # faster means that the robot is too light or stiff for the steps
WENT = 256  # of the newest moves, from which the poses during a scan are found
STALLED_M_S = 0.02  # rims slower than this, pushing a wall, are stalled
PUSH_OUT = 0.2  # share of a penetration that is corrected in a step
PUSH_OUT_M = 0.005  # largest correction in a step
PRESSED_M = 0.002  # travel of a bumper, which is more than the gap left between body and wall
PUSHING_M_S = 0.02  # a robot that is slower does not count as running into another

Driver = Callable[[float, float], tuple[float, float]]
"""From measured speeds ahead (m/s) and around (rad/s) to voltages of left and right motor, V."""

Streams = Callable[[str], Random]
"""A random stream by name; the same name gives the same numbers."""


def seeded(seed: int) -> Streams:
    """Independent streams from one seed and their names."""
    return lambda name: Random(f"{seed}/{name}")


@dataclass(frozen=True)
class Site:
    """A robot's start and surroundings: m and rad, in the world frame."""

    walls: Sequence[Wall] = ()
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    columns: Sequence[Column] = ()
    moving: Sequence[Moving] = ()
    docks: Sequence[Pose] = ()  # poses of a docked robot
    charge: float = 1.0  # of its battery, as a share


Drive = Dynamics | Kinematics
"""The robot's motion: motors with voltages, or a base that receives speeds.

With `by_volts` the inputs are the voltages of left and right motor, limited by the battery; else
the speed ahead and the turn rate. `mobility` is the change of speed per force and step.
"""


@dataclass
class Touches:
    """Contacts of the footprint; those less than `APART_S` apart are one episode."""

    collisions: int = 0  # episodes without bumps
    bumps: int = 0  # episodes in which a person or robot ran into this one
    pushed: bool = False  # the robot now pushes an obstacle
    pressed_s: float = -inf  # time of the last contact at its front, s of simulation
    step: float = -inf  # the last step with a contact

    def begin(self) -> None:
        """Forget contacts: the robot was moved."""
        self.pushed, self.pressed_s, self.step = False, -inf, -inf

    def count(self, touching: bool, bumped: bool, step: int) -> None:
        """Count a step, with or without a contact; `bumped`: the other one caused it."""
        self.pushed = touching and not bumped
        if touching:
            if (step - self.step) * STEP_S > APART_S:
                self.bumps += bumped
                self.collisions += not bumped
            self.step = float(step)


class Plant:
    """A robot among walls. Left is the thesis's motor 3, right its motor 2; SI and REP-103.

    `blocked`: in the last step the robot pushed a wall without advancing (rims below 2 cm/s).
    `pose` is the true one in the world: m, m, rad (not wrapped). `sonar_readings` and
    `laser_readings` are what the sensors report; they can be broken. `jammed`: the wheels are
    blocked, so the robot stands whatever its motors do.
    """

    step_s = STEP_S

    def __init__(
        self,
        profile: IdentifiedRobot | ModelledRobot,
        sensors: SensorProfile,
        site: Site,
        rng: Streams,
    ) -> None:
        self.blocked = self.jammed = False
        self.touches = Touches()
        self.pose = site.start
        self.sonar_readings = Readings[float | None](_farther)
        self.laser_readings = Readings[Floats](shifted)
        self._grip = 1.0  # way over the floor per way of a wheel's rim
        self.battery = Battery(profile.battery, site.charge, site.docks)
        self._profile = profile
        self._dynamics: Drive = (
            Kinematics(profile, STEP_S)
            if isinstance(profile, ModelledRobot)
            else Dynamics(profile, STEP_S)
        )
        self._odometry = Odometry(profile, sensors, STEP_S, rng)
        self._walls = Walls()
        self._outline = Outline(profile, self._walls)
        self._sonars = (
            None if profile.sonar is None else Sonars(profile.sonar, sensors, self._walls, rng)
        )
        self._laser = (
            None
            if profile.laser is None
            else LaserScanner(profile.laser, sensors, self._walls, rng)
        )
        self._box = box_of(profile)
        self._surfaces = Surfaces(sensors, rng)
        self._sideways = 0.0  # m/s to the left, only while a wall pushes
        self._margin = 0.0  # lower bound of the distance to walls, m; 0 is unknown
        self._steps = 0
        self._went: deque[tuple[float, ...]] = deque(maxlen=WENT)  # steps and pose, for scans
        self.add_walls(site.walls)
        self.add_columns(site.columns)
        self.body = Body(self._box, self._outline.mass_kg, STEP_S)  # for other robots
        self._company: Company | None = None
        self._movement = (
            Movement(site.moving, site.walls, self._walls, self._box, rng) if site.moving else None
        )
        self._move_world()

    # The world -----------------------------------------------------------------------------------

    def add_walls(self, walls: Sequence[Wall]) -> None:
        """Add walls; their surfaces depend on the seed and the order of adding."""
        self._walls.add(walls, [self._surfaces.draw() for _ in walls])
        self._margin = 0.0

    def add_columns(self, columns: Sequence[Column]) -> None:
        """Add columns; their surfaces are drawn like those of walls."""
        self._walls.add_columns(columns, [self._surfaces.draw() for _ in columns])
        self._margin = 0.0

    def slip(self, left: float, right: float) -> None:
        """Let the wheels turn so many times as far as they roll over the floor; 1: they grip."""
        self._odometry.slip(left, right)
        self._grip = 2.0 / (left + right)

    def glaze(self, share: float) -> None:
        """Let this share of the walls be of glass for the laser, besides those that are so."""
        if self._laser is not None:
            self._laser.glaze(share)

    def meet(self, others: Sequence[Body]) -> None:
        """Join other robots in one world; the caller then calls `locate_others`."""
        self._company = Company(self._walls, others)
        self._margin = 0.0

    def locate_others(self) -> None:
        """Update the poses of the other robots."""
        if self._company is not None:
            self._margin = max(0.0, self._margin - self._company.locate())

    def set_pose(self, x: float, y: float, theta: float) -> None:
        """Lift the robot and put it down elsewhere, at rest; its odometry does not change."""
        self.pose = (x, y, theta)
        self._went.clear()
        self._dynamics.v = self._dynamics.w = self._sideways = 0.0
        self._margin = 0.0
        self.blocked = False
        self.touches.begin()

    @property
    def wheels(self) -> Odometry:
        """The encoders, and their lasting errors."""
        return self._odometry

    def set_speeds(self, v: float, w: float) -> None:
        """Let it move so fast, ahead (m/s) and around (rad/s), as if it had done so before."""
        self._dynamics.v, self._dynamics.w = v, w
        self._margin = 0.0

    def holding(self, v: float, w: float) -> tuple[float, float]:
        """What keeps these speeds (m/s, rad/s), ahead and turning: voltages, or the speeds."""
        return self._dynamics.holding(v, w)

    @property
    def speeds(self) -> tuple[float, float]:
        """The true speed ahead (m/s) and turn rate (rad/s)."""
        return self._dynamics.v, self._dynamics.w

    # Measurements --------------------------------------------------------------------------------

    @property
    def v(self) -> float:
        """Speed ahead by the encoders, m/s."""
        return self._odometry.v

    @property
    def w(self) -> float:
        """Turn rate by the encoders, rad/s."""
        return self._odometry.w

    @property
    def left_m_s(self) -> float:
        """Speed of the left wheel's rim by its encoder, m/s."""
        return self._odometry.left_m_s

    @property
    def right_m_s(self) -> float:
        """Speed of the right wheel's rim by its encoder, m/s."""
        return self._odometry.right_m_s

    @property
    def odometry(self) -> tuple[float, float, float]:
        """Pose since the last reset, by the encoders: m, m, rad (not wrapped)."""
        return self._odometry.x, self._odometry.y, self._odometry.theta

    @property
    def encoder_counts(self) -> tuple[int, int]:
        """Ticks of the left and the right wheel since power-on."""
        return self._odometry.ticks

    def reset_odometry(self) -> None:
        self._odometry.reset()

    def ping(self, index: int) -> float | None:
        """Range that sonar `index` measures now, m; None without an echo."""
        sonars = self._sonars
        if sonars is None:
            return None
        return self.sonar_readings.reading(index, lambda: sonars.ping(index, self.pose))

    @property
    def scan_lasts_s(self) -> float:
        """The time from the first ray of a scan to the last one."""
        return 0.0 if self._laser is None else self._laser.lasts_s

    def scan(self) -> Floats:
        """A scan whose last ray is measured now: see `LaserScanner.scan`."""
        return self.laser_readings.reading(0, self._scan)

    def _scan(self) -> Floats:
        laser, shape = self._laser, self._profile.laser
        assert laser is not None, "the profile has a laser"
        assert shape is not None
        if laser.lasts_s == 0.0 or len(self._went) < 2:
            return laser.scan(self.pose)
        times = self._steps - np.linspace(laser.lasts_s / STEP_S, 0.0, shape.rays)
        newest = enumerate(reversed(self._went))
        before = next((k for k, went in newest if went[0] <= times[0]), WENT)
        steps, *places = np.array([*self._went][-before - 1 :]).T
        poses = np.column_stack([np.interp(times, steps, each) for each in places])
        return laser.scan(poses if shape.time_order >= 0 else poses[::-1])

    @property
    def profile(self) -> IdentifiedRobot | ModelledRobot:
        return self._profile

    @property
    def walls(self) -> Walls:
        """Its surroundings, as they are now."""
        return self._walls

    def clearance(self) -> float:
        """True distance from footprint to the nearest wall, m; 0: touching, inf: without walls."""
        nearest = self._walls.clearance(self.pose, self._box)
        self._margin = max(self._margin, nearest - TOUCH_M)
        return nearest

    # Motion --------------------------------------------------------------------------------------

    def step(self, left_v: float, right_v: float) -> None:
        """Advance by `step_s` with these motor voltages, V (or speeds: see `Drive`)."""
        self.run(1, lambda _v, _w: (left_v, right_v))

    def run(self, steps: int, driver: Driver) -> None:  # noqa: PLR0915 - calls would cost
        """Advance by steps of `step_s`; `driver` returns the inputs of `Drive` for each.

        Voltages are limited to the battery's.

        This loop runs 200 times per simulated second. So constants are looked up before it, and the
        pose stays in locals while no wall is near.
        """
        dynamics, odometry, battery = self._dynamics, self._odometry, self.battery
        corner, half_track = self.body.reach_m, self._profile.body.half_track_m
        by_volts, watts = dynamics.by_volts, dynamics.watts
        self._take_push()
        x, y, theta = self.pose
        margin, walls_push = self._margin, self.touches.pushed or self._sideways != 0.0
        v, w = dynamics.v, dynamics.w
        pace = abs(v) + corner * abs(w)  # upper bound of the footprint's speeds, m/s
        self.blocked = self.blocked and not steps
        moves, jammed = self._movement is not None, self.jammed
        grip = 1.0 if by_volts else self._grip  # motors with voltages are regulated by encoders
        battery.charge_in(self.pose)  # once per call, which is every 40 ms or more often
        rests = False  # the step before changed only the battery's charge
        for _ in range(steps):
            if moves and not self._steps % MOVE_STEPS:
                self.pose, self._margin = (x, y, theta), margin
                self._move_world()
                margin = self._margin
            one, other = driver(odometry.v, odometry.w)
            if rests and one == 0.0 == other and margin > 0.0:
                self._steps += 1
                battery.drain(0.0, STEP_S)
                continue
            if by_volts:
                most = battery.volts
                if not (-most <= one <= most and -most <= other <= most):
                    one, other = max(-most, min(most, one)), max(-most, min(most, other))
            elif grip != 1.0:
                one, other = grip * one, grip * other
            dynamics.accelerate(one, other)
            if jammed:
                dynamics.v = dynamics.w = 0.0
            v0, w0, v, w = v, w, dynamics.v, dynamics.w
            pace0, pace = pace, abs(v) + corner * abs(w)
            if not pace < FASTEST_M_S:  # also if it is NaN
                raise self._runaway()
            reach = STEP_S * (pace if pace > pace0 else pace0)
            margin -= reach
            mean_v, mean_w = 0.5 * (v0 + v), 0.5 * (w0 + w)
            self._steps += 1
            if margin > 0.0 and not walls_push:
                heading = theta + 0.5 * STEP_S * mean_w
                x += mean_v * (STEP_S * cos(heading))
                y += mean_v * (STEP_S * sin(heading))
                theta += STEP_S * mean_w
            else:
                self.pose, self._margin = (x, y, theta), margin
                mean_v, mean_w = self._near(reach, mean_v, mean_w)
                x, y, theta = self.pose
                margin, walls_push = self._margin, self.touches.pushed or self._sideways != 0.0
                v, w = dynamics.v, dynamics.w
                pace = abs(v) + corner * abs(w)
            dynamics.roll(mean_v, mean_w)
            aside = mean_w * half_track
            left, right = mean_v - aside, mean_v + aside
            odometry.move(STEP_S * left, STEP_S * right)
            used = watts(one, other, left, right, half_track)
            battery.drain(used, STEP_S)
            rests = by_volts and pace0 == 0.0 == pace == used == one == other and margin > 0.0
            rests = rests and not walls_push and odometry.v == 0.0 == odometry.w
        self.pose, self._margin = (x, y, theta), margin
        self.blocked = self.blocked or (jammed and steps > 0)
        if self._laser is not None:
            self._went.append((self._steps, x, y, theta))
        self.show_body()

    def _take_push(self) -> None:
        """Adopt the speeds after pushes by others since the last step."""
        dynamics, body = self._dynamics, self.body
        if self._company is None:
            return
        if (body.v, body.u, body.w) != (dynamics.v, self._sideways, dynamics.w):
            dynamics.v, self._sideways, dynamics.w = body.v, body.u, body.w
            self._margin = 0.0

    def show_body(self) -> None:
        """Update the body that other robots meet."""
        dynamics, body = self._dynamics, self.body
        body.pose = self.pose
        body.v, body.u, body.w = dynamics.v, self._sideways, dynamics.w
        body.mobility = dynamics.mobility

    def _move_world(self) -> None:
        """Move people, doors and boxes, which may come nearer."""
        if self._movement is None:
            return
        went, met, bumped = self._movement.step(self._steps * STEP_S, self.pose, self.speeds)
        self._margin = max(0.0, self._margin - went)
        if met:
            self.touches.count(True, bumped, self._steps)

    def _move(self, v: float, u: float, w: float) -> None:
        """Move the body by a step ahead, to the left and around."""
        x, y, theta = self.pose
        heading = theta + 0.5 * STEP_S * w
        c, s = STEP_S * cos(heading), STEP_S * sin(heading)
        self.pose = (x + v * c - u * s, y + v * s + u * c, theta + STEP_S * w)

    def _near(self, reach: float, v: float, w: float) -> tuple[float, float]:
        """A step in which the footprint may meet a wall. Returns the resulting mean speeds."""
        self.blocked = False
        contacts = self._outline.contacts(self.pose)
        gap = min((contact.gap for contact in contacts), default=SKIN_M)
        if gap > reach and not self._sideways:
            self._margin = gap - reach
            self.touches.pushed = False
            self._move(v, 0.0, w)
            return v, w
        force, speeds, met = 0.0, self.speeds, self._is_met(contacts)
        if reach or self._sideways:
            force = self._collide(contacts)
        touching = force > 0.0 or gap <= TOUCH_M
        if touching and any(met.v > 0.0 and met.gap <= PRESSED_M for met in contacts):
            self.touches.pressed_s = self._steps * STEP_S
        moves = self._movement
        into = moves is not None and moves.walked_into(self.pose, speeds)
        self.touches.count(touching, touching and (met or into), self._steps)
        self._margin = 0.0
        v, w = self._dynamics.v, self._dynamics.w
        rim = abs(v) + self._profile.body.half_track_m * abs(w)
        self.blocked = force > 0.0 and rim < STALLED_M_S
        return v, w

    def _is_met(self, contacts: list[Contact]) -> bool:
        """Whether the nearest contact is with a robot that this one does not drive into."""
        met = min(contacts, key=lambda contact: contact.gap, default=None)
        if met is None or met.other is None:
            return False
        dynamics = self._dynamics
        speed = met.v * dynamics.v + met.u * self._sideways + met.w * dynamics.w
        return speed < PUSHING_M_S

    def _collide(self, contacts: list[Contact]) -> float:
        """Move as the walls allow. Returns the greatest force of a contact, N."""
        dynamics = self._dynamics
        motion = Motion(dynamics.v, self._sideways, dynamics.w)
        motion, force = self._outline.resolve(contacts, motion, dynamics.mobility, STEP_S)
        dynamics.v, self._sideways, dynamics.w = motion
        self._move(*motion)
        deepest = min(contacts, key=lambda contact: contact.gap, default=None)
        if deepest is not None and deepest.gap < 0.0:
            speed = max(PUSH_OUT * deepest.gap, -PUSH_OUT_M) / STEP_S
            self._move(speed * deepest.v, speed * deepest.u, 0.0)
        return force

    def _runaway(self) -> ConfigError:
        return ConfigError(
            f"robot {self._profile.name!r}: its speeds grow without bound in the simulator's steps"
            f" of {1e3 * STEP_S:g} ms; compare its [body], [inertia] and [motor] with"
            " pioneer-2dx's"
        )


def _farther(range_m: float | None, bias_m: float) -> float | None:
    """A sonar's range with a bias, m."""
    return None if range_m is None else max(0.0, range_m + bias_m)
