"""The robot profile: every number that belongs to one make of robot (thesis tables 4.2, 4.3, 4.6).

A profile is a TOML file under ``configs/robots``. SI units throughout; conversion factors of the
P2OS codec are the only ones in the controller's own units. What the robot agent says of its robot
is as bounded here as on the mesh.
"""

from __future__ import annotations

from functools import lru_cache
from math import radians
from pathlib import Path
from typing import Annotated, Final

from msgspec import Meta, Struct
from msgspec.structs import replace

from armadico.config.errors import ConfigError
from armadico.config.loading import convert, document, read_text
from armadico.config.shipped import find, names
from armadico.core.messages import Length, Name, Patience, Period, Place, Ramp, TopSpeed, TopTurn
from armadico.mobile.geometry import Pose2, turning_circle
from armadico.mobile.messages import RAYS, REACH_M

NEVER_S = 60.0
"""The longest that the mesh can tell of a watchdog: of a robot that has none."""

Positive = Annotated[float, Meta(ge=1e-6, le=1e6)]
"""Smaller ones, divided by or squared, are beyond what a float holds, and no robot has any."""
NonNegative = Annotated[float, Meta(ge=0, le=1e6)]
Real = Annotated[float, Meta(ge=-1e6, le=1e6)]
Share = Annotated[float, Meta(ge=0, le=1)]
Angle = Annotated[float, Meta(ge=0, le=90)]
Bearing = Annotated[float, Meta(ge=-180, le=180)]
Turned = Annotated[float, Meta(ge=-360, le=360)]
_WORD = r"[A-Za-z][A-Za-z0-9_]*"
TopicName = Annotated[str, Meta(max_length=255, pattern=rf"^/?{_WORD}(/{_WORD})*\Z")]
FrameName = Annotated[str, Meta(min_length=1, max_length=64)]


POSE_M: Final = 0.04
"""Room that a goal needs beside the turning circle: the robot stops within the error of its pose.
With it 6 of 6 runs reach a goal beside a wall, without it 1 of 6."""


class Body(Struct, frozen=True, forbid_unknown_fields=True):
    """Outline, wheels and mass (table 4.3), in the REP-103 frame at the middle of the wheel axle.

    The middle of four wheels is where they would have one axle: between both.
    """

    front_m: Length  # from the axle to the front edge
    rear_m: Length  # from the axle to the rear edge
    width_m: Length
    wheel_radius_m: Positive  # R
    half_track_m: Positive  # L
    mass_kg: Positive  # M, without what [inertia] and [caster] have for themselves

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """The outline's, m."""
        front, rear, side = self.front_m, -self.rear_m, self.width_m / 2
        return (front, side), (rear, side), (rear, -side), (front, -side)

    @property
    def circle_m(self) -> float:
        """How far its middle must be from walls to turn on the spot."""
        return turning_circle(self.front_m, self.rear_m, self.width_m / 2)

    @property
    def goal_room_m(self) -> float:
        """Least distance from a goal to every wall, m."""
        return self.circle_m + POSE_M

    @property
    def goal_needs(self) -> str:
        """What that distance is made of, in words."""
        return f"{self.circle_m:.2f} m to turn, {POSE_M:.2f} m for the error of the pose"


class Caster(Struct, frozen=True, forbid_unknown_fields=True):
    """The wheel that follows (table 4.3)."""

    radius_m: Positive  # R_1
    arm_m: Positive  # l_1, axle to its pivot
    trail_m: Positive  # d
    mass_kg: Positive  # m_1


class Inertia(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the mass lies (table 4.3), and the identified inertias and friction (table 4.6)."""

    mass_centre_x_m: Real  # the thesis's y_m: negative is behind the axle
    mass_centre_y_m: Real  # the thesis's x_m
    wheel_mass_kg: Positive  # m
    body_kg_m2: Positive  # I_0
    caster_roll_kg_m2: Positive  # I_r1
    wheel_roll_kg_m2: Positive  # I_r
    caster_yaw_kg_m2: Positive  # I_p1
    wheel_yaw_kg_m2: Positive  # I_p
    caster_coulomb_nm: NonNegative  # C_s1
    caster_viscous_nms: NonNegative  # C_v1
    wheel_coulomb_nm: NonNegative  # C_s
    wheel_viscous_nms: NonNegative  # C_v


class Motor(Struct, frozen=True, forbid_unknown_fields=True):
    """The DC motors and their gearbox (table 4.2)."""

    torque_constant_nm_a: Positive  # K_T
    back_emf_v_s: Positive  # K_E
    resistance_ohm: Positive  # R_a
    gear_ratio: Positive  # t_r
    efficiency: Positive  # mu
    friction_nm: NonNegative  # tau_fr
    supply_v: Positive


class SpeedLoop(Struct, frozen=True, forbid_unknown_fields=True):
    """The microcontroller's two PI speed loops (thesis 4.6.1)."""

    linear_kp: NonNegative  # V per m/s
    linear_ki: NonNegative  # V per m
    angular_kp: NonNegative  # V per rad/s
    angular_ki: NonNegative  # V per rad
    antiwindup: NonNegative


class Drive(Struct, frozen=True, forbid_unknown_fields=True):
    """A drive of which is known how it moves, not why: of a robot whose motors nobody identified.

    The base follows what it is told to a moment later, as fast as its own limits allow; those of
    the table of limits are what it is told at the most, and lie below.
    """

    lag_s: Positive  # time constant of its speed loops
    v_accel: Ramp  # m/s^2, up and down
    w_accel: Ramp  # rad/s^2
    scrub: Share  # of tyres dragged sideways: what the floor adds to the turn error drawn,
    heading: Share  # and what a gyroscope leaves of its odometry's errors in turning; 1: all
    rolling_n: NonNegative  # what it takes to roll,
    turning_nm: NonNegative  # and to turn,
    efficiency: Annotated[float, Meta(ge=0.01, le=1)]  # of battery to wheel


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """What the controller obeys at the most, and its ramps."""

    v_max: TopSpeed  # m/s
    w_max: TopTurn  # rad/s
    v_accel: Ramp  # m/s^2
    v_decel: Ramp  # m/s^2
    w_accel: Ramp  # rad/s^2
    w_decel: Ramp  # rad/s^2


class Sonar(Struct, frozen=True, forbid_unknown_fields=True):
    """One sonar of the ring: where it sits and looks, in the body frame (x forward, y left)."""

    x_m: Place
    y_m: Place
    bearing_deg: Bearing
    frame: FrameName | None = None  # with [ros2]: the frame_id that its readings have

    @property
    def place(self) -> Pose2:
        """On the body: m, m, rad."""
        return self.x_m, self.y_m, radians(self.bearing_deg)


class SonarRing(Struct, frozen=True, forbid_unknown_fields=True):
    """The array of ultrasonic sensors (thesis 4.4)."""

    min_m: Annotated[float, Meta(ge=1e-6, le=100)]
    max_m: Annotated[float, Meta(ge=1e-6, le=100)]
    cone_deg: Annotated[float, Meta(ge=1e-6, le=360)]
    period_s: Period  # from one sonar's ping to the next one's
    sonars: tuple[Sonar, ...]
    firing_order: tuple[int, ...]


class Laser(Struct, frozen=True, forbid_unknown_fields=True):
    """A scanning laser range finder: where it sits and looks, in the body frame, and its rays.

    `angle_min_deg` is the first ray's, about the laser's own axis; the others follow evenly up to
    `angle_max_deg`, the last one's, counter-clockwise as the laser sees it: one that is mounted
    upside down sees its left on the robot's right. Of a laser that looks all around the last ray
    lies a step before the first.
    """

    x_m: Place
    y_m: Place
    bearing_deg: Bearing
    min_m: Positive  # what is nearer has no valid range
    max_m: Annotated[float, Meta(gt=0, le=REACH_M)]
    angle_min_deg: Turned
    angle_max_deg: Turned
    rays: Annotated[int, Meta(ge=2, le=RAYS)]
    rate_hz: Annotated[float, Meta(ge=1, le=200)]  # scans are believed for two turns
    noise_m: NonNegative  # standard deviation of a range
    upside_down: bool = False

    def __post_init__(self) -> None:
        if not self.min_m < self.max_m:
            raise ValueError(f"min_m = {self.min_m} is not less than max_m = {self.max_m}")
        if not 0.0 < self.angle_max_deg - self.angle_min_deg <= 360.0:
            raise ValueError("angle_max_deg is to be up to 360 more than angle_min_deg")

    @property
    def place(self) -> Pose2:
        """On the body: m, m, rad."""
        return self.x_m, self.y_m, radians(self.bearing_deg)

    @property
    def step_deg(self) -> float:
        """From one ray to the next."""
        return (self.angle_max_deg - self.angle_min_deg) / (self.rays - 1)


class Odometry(Struct, frozen=True, forbid_unknown_fields=True):
    """How wrong the wheels count: standard deviations of what a robot's odometry is off by.

    Numbered as in *Probabilistic Robotics*, table 5.6 (AMCL's parameters of these names are the
    squares). The greater part of each error lasts, since it comes from the wheels' sizes, the base
    and the floor: localization estimates it while the robot drives. The rest varies at random.
    """

    alpha1: Share = 0.1  # of the heading, by turning: rad/rad
    alpha2: Share = 0.06  # of the heading, by driving: rad/m
    alpha3: Share = 0.04  # of the way, by driving: m/m
    alpha4: Share = 0.0  # of the way, by turning: m/rad


WIDE: Final = Odometry()
"""Of a robot with a laser whose wheels nobody has measured: what a real Pioneer 2 in a log of the
Intel laboratory is off by (drift 0.057 rad/m, turns 10 %, ways 4 %)."""

NARROW: Final = Odometry(alpha1=0.025, alpha2=0.03, alpha3=0.016)
"""Of a robot with sonars alone. In a corridor it sees no end: its way along it is known by the
wheels only, and with an error of 4 % it would count as lost after 12 m."""


class Battery(Struct, frozen=True, forbid_unknown_fields=True):
    """A battery, drained by the motors and the electronics, charged in a dock."""

    full_v: Positive
    low_v: Positive  # below this it has to be charged soon,
    empty_v: Positive  # and here at once
    capacity_ah: Positive
    internal_ohm: NonNegative
    idle_a: NonNegative
    charge_a: NonNegative  # what the charger gives,
    taper_from: Share  # and less and less of it from this charge on, to nothing when full

    def __post_init__(self) -> None:
        if not self.empty_v < self.low_v < self.full_v:
            raise ValueError("empty_v is to be less than low_v, and that less than full_v")


class Variant(Struct, frozen=True, forbid_unknown_fields=True):
    """Another subclass of the same robot; factors that are not given are those of the profile."""

    subclass: Annotated[str, Meta(max_length=19)]  # "": a controller that reports none
    distance_mm: Positive | None = None
    range_mm: Positive | None = None


class P2osUnits(Struct, frozen=True, forbid_unknown_fields=True):
    """The codec's conversion factors, and what the controller says of itself."""

    distance_mm: Positive  # mm for one count of XPOS
    angle_rad: Positive  # rad for one unit of THPOS
    velocity_mm: Positive
    range_mm: Positive
    vel2_mm: Positive
    diff_conv: Positive
    name: Annotated[str, Meta(min_length=1, max_length=19)]
    class_name: Annotated[str, Meta(min_length=1, max_length=19)]
    subclass: Annotated[str, Meta(min_length=1, max_length=19)]
    cycle_s: Period  # from one status packet to the next
    watchdog_s: Patience
    variants: tuple[Variant, ...] = ()

    def of(self, class_name: str, subclass: str) -> P2osUnits | None:
        """The factors for a controller that names itself so; None: the profile does not fit it."""
        if class_name.casefold() != self.class_name.casefold() and (class_name or subclass):
            return None
        if subclass.casefold() == self.subclass.casefold():
            return self
        for each in self.variants:
            if subclass.casefold() == each.subclass.casefold():
                return replace(
                    self,
                    subclass=each.subclass,
                    distance_mm=each.distance_mm or self.distance_mm,
                    range_mm=each.range_mm or self.range_mm,
                )
        return None


class Topic(Struct, frozen=True, forbid_unknown_fields=True):
    """A ROS 2 topic, and the quality of service that is asked for, or offered, on our side."""

    name: TopicName  # below the robot's namespace; with a slash in front it is not
    reliable: bool = True
    latched: bool = False  # transient local: who joins late is given the last ones
    depth: Annotated[int, Meta(ge=1, le=1000)] = 10


class Ros2(Struct, frozen=True, forbid_unknown_fields=True):
    """What a robot that speaks ROS 2 publishes and obeys.

    A cycle is an odometry message whose stamp is `cycle_s` or more after the last cycle's.
    """

    cycle_s: Period
    latency_s: Annotated[float, Meta(ge=0, le=1)]  # from a command until the base begins to follow
    stamped: bool  # cmd_vel is a TwistStamped, not a Twist
    odom_hz: Annotated[float, Meta(ge=5, le=1000)]
    odom_frame: FrameName
    base_frame: FrameName
    odom: Topic
    cmd_vel: Topic
    watchdog_s: Patience | None = None  # without a command for so long it stops by itself; or never
    v_step: NonNegative = 0.0  # m/s: the base obeys whole ones of these, and less than one is none
    w_step: NonNegative = 0.0  # rad/s
    laser_frame: FrameName = "base_scan"
    scan: Topic | None = None
    sonar: tuple[Topic, ...] = ()  # one for all sonars, or one for each of them
    battery: Topic | None = None
    hazards: Topic | None = None
    tf: Topic | None = None
    tf_static: Topic | None = None

    def __post_init__(self) -> None:
        names = [topic.name.removeprefix("/") for topic in self.topics]
        if len(set(names)) < len(names):
            raise ValueError("two of its topics have one name")

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All that there are, the command's last."""
        heard = (self.odom, self.scan, *self.sonar, self.battery, self.hazards)
        heard += (self.tf, self.tf_static)
        return (*(topic for topic in heard if topic is not None), self.cmd_vel)


class RobotProfile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot on two wheels, or that turns as if it were, whole: a `P2osRobot` or a `Ros2Robot`.

    It speaks one of P2OS and ROS 2, and has sonars, a laser, or both. Of its drive the masses and
    motors are known, or how it moves.
    """

    name: Name
    body: Body
    limits: Limits
    battery: Battery
    caster: Caster | None = None
    inertia: Inertia | None = None
    motor: Motor | None = None
    speed_loop: SpeedLoop | None = None
    drive: Drive | None = None
    sonar: SonarRing | None = None
    laser: Laser | None = None
    odometry: Odometry | None = None  # None: a default for its sensors
    p2os: P2osUnits | None = None
    ros2: Ros2 | None = None

    def __post_init__(self) -> None:
        if (self.p2os is None) == (self.ros2 is None):
            raise ValueError("a robot has a table [p2os] or a table [ros2], and not both")
        if self.sonar is None and self.laser is None:
            raise ValueError("neither [sonar] nor [laser]: nobody drives blind")
        if self.laser is not None and self.ros2 is not None and self.ros2.scan is None:
            raise ValueError("a laser and no [ros2.scan]: where it is heard")
        if self.ros2 is not None:
            self._check_sonars(self.ros2)
        masses = {
            "[caster]": self.caster,
            "[inertia]": self.inertia,
            "[motor]": self.motor,
            "[speed_loop]": self.speed_loop,
        }
        drive = {"[drive]": self.drive}
        speaks, needs, useless = (
            ("[ros2]", drive, masses)
            if self.p2os is None
            else ("[p2os]", masses | {"[sonar]": self.sonar}, drive)
        )
        for table, value in needs.items():
            if value is None:
                raise ValueError(f"a robot with a table {speaks} needs {table}, too")
        for table, value in useless.items():
            if value is not None:
                raise ValueError(f"a robot with a table {speaks} has no use for {table}")

    def _check_sonars(self, ros2: Ros2) -> None:
        """Each has to be told from the others by what it says. Raises ValueError."""
        sonars = () if self.sonar is None else self.sonar.sonars
        frames = [sonar.frame for sonar in sonars]
        if None in frames or len(set(frames)) < len(frames):
            raise ValueError(
                "of [sonar] each sonar needs a frame of its own: its readings' frame_id"
            )
        if len(ros2.sonar) not in {min(1, len(sonars)), len(sonars)}:
            raise ValueError(
                f"{len(sonars)} sonars and {len(ros2.sonar)} tables [[ros2.sonar]], where they are"
                " heard: it is to be one for all, or one for each"
            )

    @property
    def ring(self) -> SonarRing:
        """Its sonars. Raises ConfigError if it has none."""
        if self.sonar is None:
            raise ConfigError(f"{self.name} has no sonars")
        return self.sonar

    @property
    def wheels(self) -> Odometry:
        """How wrong its odometry may be."""
        return self.odometry or (NARROW if self.laser is None else WIDE)

    @property
    def reach_m(self) -> float:
        """The farthest that any of its sensors tells."""
        return max(sensor.max_m for sensor in (self.sonar, self.laser) if sensor is not None)

    @property
    def cycle_s(self) -> float:
        """From one cycle to the next, s."""
        return self._line.cycle_s

    @property
    def watchdog_s(self) -> float:
        """Without a command for so long the controller stops by itself, s; `NEVER_S`: or never."""
        return self._line.watchdog_s or NEVER_S

    @property
    def _line(self) -> P2osUnits | Ros2:
        line = self.p2os or self.ros2
        assert line is not None, "it speaks one of them"
        return line


class P2osRobot(RobotProfile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot with a controller that speaks P2OS, whose masses and motors are known."""

    caster: Caster
    inertia: Inertia
    motor: Motor
    speed_loop: SpeedLoop
    sonar: SonarRing
    p2os: P2osUnits


class Ros2Robot(RobotProfile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot that speaks ROS 2, of which is known how it moves."""

    drive: Drive
    ros2: Ros2


def load_profile(name_or_path: str | Path) -> P2osRobot | Ros2Robot:
    """A shipped profile by its name, or a TOML file. Raises ConfigError."""
    path = find("robots", name_or_path)
    return _read(read_text(path), path)


def profiles_for(class_name: str, subclass: str) -> tuple[str, ...]:
    """The names of the shipped profiles that fit a controller with these names, sorted."""
    found = {name: load_profile(name).p2os for name in names("robots")}
    return tuple(n for n, units in found.items() if units and units.of(class_name, subclass))


@lru_cache(maxsize=8)  # 3 ms, and a society asks for its robot's a dozen times
def _read(text: str, path: Path) -> P2osRobot | Ros2Robot:
    table = document(text, path)
    speaks_p2os = convert(table, RobotProfile, path, text).p2os is not None
    return (
        convert(table, P2osRobot, path, text)
        if speaks_p2os
        else convert(table, Ros2Robot, path, text)
    )


class SensorProfile(Struct, frozen=True, forbid_unknown_fields=True):
    """How well the simulated robot senses: `ideal` or `real`.

    What a run draws from its seed is drawn uniformly up to the value here, to either side.
    """

    name: str
    sonar_noise_m: NonNegative  # standard deviation of a range, at least,
    sonar_noise: Share  # and as a share of it
    glancing_deg: Angle  # a rough wall met at more than this from its normal has no echo
    dropout: Share  # an echo lost by chance
    dead_walls: Share  # share of walls that do not answer
    rough_walls: Share  # of walls that scatter; the others are mirrors,
    gone_deg: tuple[Angle, Angle]  # which are heard no more from somewhere between these on
    edge_m: NonNegative  # an edge is always heard up to here, beyond it by the inverse of the range
    multipath: Share  # how often what a mirror threw off is heard if it comes back
    crosstalk: Share  # how often what came back to nobody is heard by the next sonar
    laser_dropout: Share  # of a laser's rays that come back to nobody by chance
    black_walls: Share  # share of walls that a laser sees from `black_m` only,
    black_m: NonNegative
    glass_walls: Share  # and that it looks through, but for where they are square to it
    glass_deg: Angle  # within this
    slip: Share  # standard deviation of each wheel's relative slip
    drift_rad_m: NonNegative  # heading error that grows with distance: drawn
    turn_error: Share  # of the wheel base, so of all turning: drawn
    way_error: Share  # of both wheels' diameters, so of all ways: drawn
