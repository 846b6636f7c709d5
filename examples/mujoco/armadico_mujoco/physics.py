"""The robot and its world in MuJoCo: wheels on a floor, a hull among walls, rays of a laser.

Armadico's plant gives the world, the battery, the sensors' noise and the clearance. Motion, slip
and contacts are MuJoCo's: two wheels with velocity servos of limited torque carry the hull,
together with two casters without friction. Frame of the hull: x ahead, y left, the origin on the
floor at the middle of the wheel axle.
"""

from __future__ import annotations

from math import atan2, cos, hypot, inf, sin

import mujoco
import numpy as np

from armadico.bridge.simulator.encoders import TICKS_PER_M
from armadico.bridge.simulator.plant import Driver, Plant, Site, Streams
from armadico.bridge.simulator.walls import Floats
from armadico.config.profile import IdentifiedRobot, ModelledRobot, SensorProfile
from armadico.core.config_errors import ConfigError
from armadico_mujoco.kind import MujocoRobot

SUBSTEPS = 2
"""Of MuJoCo in a step of the plant."""

WALL_M, HIGH_M = 0.005, 0.4
"""Half the thickness of walls, and half their height."""

HULL_Z_M, HULL_HIGH_M = 0.12, 0.08
"""Height of the hull's middle, and half its height."""

CASTER_UP_M = 0.001
"""The casters hang that high: otherwise they would carry the robot, and its wheels would slip."""

ROBOT, WORLD = 1, 0
"""Groups of geometries: rays meet the world only."""


def model_of(profile: MujocoRobot, site: Site) -> str:
    """The robot in its world as MJCF."""
    body, physics = profile.body, profile.mujoco
    length, middle = body.front_m + body.rear_m, 0.5 * (body.front_m - body.rear_m)
    x, y, theta = site.start
    radius, track = body.wheel_radius_m, body.half_track_m
    walls = "".join(
        f'<geom type="box" pos="{(x1 + x2) / 2} {(y1 + y2) / 2} {HIGH_M}" class="wall"'
        f' euler="0 0 {atan2(y2 - y1, x2 - x1)}"'
        f' size="{hypot(x2 - x1, y2 - y1) / 2 + WALL_M} {WALL_M} {HIGH_M}"/>'
        for x1, y1, x2, y2 in site.walls
    ) + "".join(
        f'<geom type="cylinder" pos="{cx} {cy} {HIGH_M}" size="{r} {HIGH_M}" class="wall"/>'
        for cx, cy, r in site.columns
    )
    wheels = "".join(
        f'<body pos="0 {y_m} {radius}">'
        f'<joint name="{side}" type="hinge" axis="0 1 0" armature="0.005"/>'
        f'<geom type="ellipsoid" size="{radius} 0.012 {radius}" mass="0.3"'
        f' friction="{physics.friction} 0.002 0.0001" group="{ROBOT}"/></body>'
        for side, y_m in (("left", track), ("right", -track))
    )
    ball = min(radius, 0.03)
    casters = "".join(
        f'<geom type="sphere" pos="{x_m} 0 {ball + CASTER_UP_M}" size="{ball}" mass="0.1"'
        f' condim="1" friction="0 0 0" group="{ROBOT}"/>'
        for x_m in (0.8 * body.front_m, -0.8 * body.rear_m)
    )
    motors = "".join(
        f'<velocity joint="{side}" kv="{physics.damping_nms}"'
        f' forcerange="{-physics.torque_nm} {physics.torque_nm}"/>'
        for side in ("left", "right")
    )
    return f"""<mujoco>
  <compiler angle="radian"/>
  <option timestep="{Plant.step_s / SUBSTEPS}" cone="elliptic" impratio="10"
    integrator="implicitfast"/>
  <default><default class="wall">
    <geom group="{WORLD}" friction="{physics.wall_friction} 0.005 0.0001"/>
  </default></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" group="2"/>
    {walls}
    <body name="robot" pos="{x} {y} 0" euler="0 0 {theta}">
      <freejoint/>
      <geom name="hull" type="box" pos="{middle} 0 {HULL_Z_M}" mass="{body.mass_kg - 0.8}"
        size="{length / 2} {body.width_m / 2} {HULL_HIGH_M}" group="{ROBOT}"
        friction="{physics.wall_friction} 0.005 0.0001"/>
      {wheels}
      {casters}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>"""


class MujocoPlant(Plant):
    """A plant whose motion and contacts are MuJoCo's."""

    def __init__(
        self,
        profile: IdentifiedRobot | ModelledRobot,
        sensors: SensorProfile,
        site: Site,
        rng: Streams,
    ) -> None:
        if not isinstance(profile, MujocoRobot):
            raise TypeError(f"{profile.name} has no section [mujoco]")
        if site.moving:
            raise ConfigError("nothing moves by itself in the MuJoCo example: leave out `moving`")
        super().__init__(profile, sensors, site, rng)
        self._made = profile
        self.model = mujoco.MjModel.from_xml_string(model_of(profile, site))
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self._walls_end = 1 + len(site.walls) + len(site.columns)  # geometry 0 is the floor
        self._noise = np.random.default_rng(rng("laser").getrandbits(64))
        self._dropout = sensors.laser_dropout
        laser = profile.laser
        self._angles = np.radians(
            laser.bearing_deg + laser.angle_min_deg + laser.step_deg * np.arange(laser.rays)
        )
        self._groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
        self._wheels = [self.model.joint(side).qposadr[0] for side in ("left", "right")]
        self._rates = [self.model.joint(side).dofadr[0] for side in ("left", "right")]

    # The wheels' encoders, by their turning: they measure a wheel that slips, too -----------------

    @property
    def _rims(self) -> tuple[float, float]:
        """Speeds of the rims, m/s."""
        left, right = (float(self.data.qvel[at]) for at in self._rates)
        radius = self._made.body.wheel_radius_m
        return left * radius, right * radius

    @property
    def v(self) -> float:
        return sum(self._rims) / 2

    @property
    def w(self) -> float:
        left, right = self._rims
        return (right - left) / (2 * self._made.body.half_track_m)

    @property
    def encoder_counts(self) -> tuple[int, int]:
        scale = self._made.body.wheel_radius_m * TICKS_PER_M
        left, right = (int(scale * float(self.data.qpos[at])) for at in self._wheels)
        return left, right

    def scan(self) -> Floats:
        laser = self._made.laser
        x, y, theta = self.pose
        c, s = cos(theta), sin(theta)
        eye = np.array(
            [x + laser.x_m * c - laser.y_m * s, y + laser.x_m * s + laser.y_m * c,
             self._made.mujoco.laser_z_m]
        )  # fmt: skip
        rays = np.zeros((laser.rays, 3))
        rays[:, 0], rays[:, 1] = np.cos(self._angles + theta), np.sin(self._angles + theta)
        met, ranges = np.zeros(laser.rays, dtype=np.int32), np.zeros(laser.rays)
        mujoco.mj_multiRay(
            *(self.model, self.data, eye, rays.ravel(), self._groups, True, -1, met, ranges),
            *(None, laser.rays, laser.max_m),
        )
        nothing = (ranges < 0.0) | (ranges > laser.max_m)
        nothing |= self._noise.random(laser.rays) < self._dropout
        ranges += laser.noise_m * self._noise.standard_normal(laser.rays)
        ranges[ranges < laser.min_m] = 0.0
        ranges[nothing] = inf
        return ranges

    def run(self, steps: int, driver: Driver) -> None:
        body = self._made.body
        self.battery.charge_in(self.pose)
        for _ in range(steps):
            v, w = driver(self.v, self.w)
            aside = w * body.half_track_m
            self.data.ctrl[:] = (v - aside) / body.wheel_radius_m, (v + aside) / body.wheel_radius_m
            mujoco.mj_step(self.model, self.data, SUBSTEPS)
            self._steps += 1
            self._locate()
            self._feel()
            left, right = self._rims
            watts = self._dynamics.watts(v, w, left, right, body.half_track_m)
            self.battery.drain(watts, self.step_s)
        self.show_body()

    def _locate(self) -> None:
        """The true pose and speeds."""
        x, y, _, qw, qx, qy, qz = self.data.qpos[:7]
        theta = atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        before = self.pose[2]
        theta = before + (theta - before + np.pi) % (2 * np.pi) - np.pi  # not wrapped
        self.pose = (float(x), float(y), float(theta))
        vx, vy, w = float(self.data.qvel[0]), float(self.data.qvel[1]), float(self.data.qvel[5])
        self._dynamics.v = vx * cos(theta) + vy * sin(theta)
        self._dynamics.w = w

    def _feel(self) -> None:
        """Count contacts of the hull with the world."""
        touching, c, s = False, cos(self.pose[2]), sin(self.pose[2])
        for contact in self.data.contact[: self.data.ncon]:
            one, other = sorted((contact.geom1, contact.geom2))
            if 0 < one < self._walls_end <= other:
                touching = True
                ahead = (contact.pos[0] - self.pose[0]) * c + (contact.pos[1] - self.pose[1]) * s
                if ahead > 0.8 * self._made.body.front_m:
                    self.touches.pressed_s = self._steps * self.step_s
        self.touches.count(touching, False, self._steps)
        self._margin = 0.0

    def set_pose(self, x: float, y: float, theta: float) -> None:
        super().set_pose(x, y, theta)
        self.data.qpos[:2] = x, y
        self.data.qpos[3:7] = cos(theta / 2), 0.0, 0.0, sin(theta / 2)
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
