"""Robot profiles: all numbers of one make of robot (thesis tables 4.2, 4.3, 4.6).

A profile is a TOML file in `configs/robots` or elsewhere. All values are in SI units, except in the
section of the kind of robot, which may use the controller's units. The kind, found by an entry
point (`armadico.bridge.kind`), reads that section. Values that the robot agent publishes have the
bounds of the messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from math import radians
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

from msgspec import Meta, Struct

from armadico.config.lines import line_of
from armadico.config.loading import convert, document, read_text
from armadico.config.shipped import find
from armadico.core import discovery
from armadico.core.config_errors import ConfigError, ConfigNameError, advice
from armadico.core.discovery import ROBOTS, installed
from armadico.core.messages import Length, Name, Patience, Period, Place, Ramp, TopSpeed, TopTurn
from armadico.mobile.geometry import Pose2, turning_circle
from armadico.mobile.messages import RAYS, REACH_M

NEVER_S = 60.0
"""The published watchdog of a robot without one: the longest that the message allows."""

Positive = Annotated[float, Meta(ge=1e-6, le=1e6)]
"""Smaller values overflow or underflow when divided by or squared, and no robot has them."""
NonNegative = Annotated[float, Meta(ge=0, le=1e6)]
Real = Annotated[float, Meta(ge=-1e6, le=1e6)]
Share = Annotated[float, Meta(ge=0, le=1)]
Angle = Annotated[float, Meta(ge=0, le=90)]
Bearing = Annotated[float, Meta(ge=-180, le=180)]
Turned = Annotated[float, Meta(ge=-360, le=360)]
FrameName = Annotated[str, Meta(min_length=1, max_length=64)]


POSE_M: Final = 0.04
"""Clearance of a goal beyond the turning circle, for the error of the pose at the stop. With it 6
of 6 runs reach a goal beside a wall, without it 1 of 6."""


class Body(Struct, frozen=True, forbid_unknown_fields=True):
    """Footprint, wheels and mass (table 4.3), in the REP-103 frame at the middle of the wheel axle.

    With four wheels it is the middle between both axles.
    """

    front_m: Length  # from the axle to the front edge
    rear_m: Length  # from the axle to the rear edge
    width_m: Length
    wheel_radius_m: Positive  # R
    half_track_m: Positive  # L
    mass_kg: Positive  # M, without the wheels of [inertia] and [caster]

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """The corners of the footprint, m."""
        front, rear, side = self.front_m, -self.rear_m, self.width_m / 2
        return (front, side), (rear, side), (rear, -side), (front, -side)

    @property
    def circle_m(self) -> float:
        """The radius of the turning circle, m."""
        return turning_circle(self.front_m, self.rear_m, self.width_m / 2)

    @property
    def goal_room_m(self) -> float:
        """Least distance from a goal to every wall, m."""
        return self.circle_m + POSE_M

    @property
    def goal_needs(self) -> str:
        """The parts of `goal_room_m`, in words."""
        return f"{self.circle_m:.2f} m to turn, {POSE_M:.2f} m for the error of the pose"


class Caster(Struct, frozen=True, forbid_unknown_fields=True):
    """The caster wheel (table 4.3)."""

    radius_m: Positive  # R_1
    arm_m: Positive  # l_1, axle to its pivot
    trail_m: Positive  # d
    mass_kg: Positive  # m_1


class Inertia(Struct, frozen=True, forbid_unknown_fields=True):
    """The centre of mass (table 4.3), and the identified inertias and friction (table 4.6)."""

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
    """A kinematic model of the drive, for a robot whose motors are not identified.

    The base follows commands with a lag and with these accelerations. The limits of the table
    [limits] bound the commands and are lower.
    """

    lag_s: Positive  # time constant of its speed loops
    v_accel: Ramp  # m/s^2, up and down
    w_accel: Ramp  # rad/s^2
    scrub: Share  # turn error that tyres dragged sideways add to the drawn one
    heading: Share  # share of the odometry's turn errors left by a gyroscope; 1: no gyroscope
    rolling_n: NonNegative  # rolling resistance
    turning_nm: NonNegative  # resistance to turning
    efficiency: Annotated[float, Meta(ge=0.01, le=1)]  # from battery to wheel


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """The controller's largest speeds and its ramps."""

    v_max: TopSpeed  # m/s
    w_max: TopTurn  # rad/s
    v_accel: Ramp  # m/s^2
    v_decel: Ramp  # m/s^2
    w_accel: Ramp  # rad/s^2
    w_decel: Ramp  # rad/s^2


class Sonar(Struct, frozen=True, forbid_unknown_fields=True):
    """The pose of one sonar of the ring in the body frame (x forward, y left)."""

    x_m: Place
    y_m: Place
    bearing_deg: Bearing
    frame: FrameName | None = None  # frame_id of its readings, if they have one

    @property
    def place(self) -> Pose2:
        """Its pose on the body: m, m, rad."""
        return self.x_m, self.y_m, radians(self.bearing_deg)


class SonarRing(Struct, frozen=True, forbid_unknown_fields=True):
    """The array of ultrasonic sensors (thesis 4.4)."""

    min_m: Annotated[float, Meta(ge=1e-6, le=100)]
    max_m: Annotated[float, Meta(ge=1e-6, le=100)]
    cone_deg: Annotated[float, Meta(ge=1e-6, le=360)]
    period_s: Period  # from one sonar's ping to the next one's
    sonars: tuple[Sonar, ...]
    firing_order: tuple[int, ...]  # indices of `sonars`, from 0

    def __post_init__(self) -> None:
        if not self.min_m < self.max_m:
            raise ValueError(f"min_m = {self.min_m:g}: expected less than max_m = {self.max_m:g}")
        fired, known = set(self.firing_order), set(range(len(self.sonars)))
        if unknown := sorted(fired - known):
            raise ValueError(f"firing_order has sonar {unknown[0]}; expected 0 to {len(known) - 1}")
        if silent := sorted(known - fired):
            raise ValueError(f"firing_order lacks sonar {silent[0]}, which would never fire")


class Laser(Struct, frozen=True, forbid_unknown_fields=True):
    """A scanning laser range finder: its pose in the body frame, and its rays.

    The rays are evenly spaced from `angle_min_deg` to `angle_max_deg` about the laser's own axis,
    counter-clockwise in the laser's frame. A laser mounted upside down has its left on the robot's
    right. If it covers the full circle, the last ray lies one step before the first.

    Scans are corrected for the robot's motion by the times of their rays. Drivers of lasers that
    turn clockwise often sort the rays, which reverses their order in time, and some stamp a scan
    when it is complete.
    """

    x_m: Place
    y_m: Place
    bearing_deg: Bearing
    min_m: Positive  # nearer objects have no valid range
    max_m: Annotated[float, Meta(gt=0, le=REACH_M)]
    angle_min_deg: Turned
    angle_max_deg: Turned
    rays: Annotated[int, Meta(ge=2, le=RAYS)]
    rate_hz: Annotated[float, Meta(ge=1, le=200)]  # a scan is valid for two periods
    noise_m: NonNegative  # standard deviation of a range
    upside_down: bool = False
    time_order: Literal[-1, 0, 1] = 1  # -1: the last ray is measured first; 0: no correction
    stamped: Literal["first", "last"] = "first"  # the ray that the stamp of a scan is of

    def __post_init__(self) -> None:
        if not self.min_m < self.max_m:
            raise ValueError(f"min_m = {self.min_m}: expected less than max_m = {self.max_m}")
        if not 0.0 < self.angle_max_deg - self.angle_min_deg <= 360.0:
            raise ValueError("angle_max_deg: expected up to 360 more than angle_min_deg")

    @property
    def place(self) -> Pose2:
        """Its pose on the body: m, m, rad."""
        return self.x_m, self.y_m, radians(self.bearing_deg)

    @property
    def step_deg(self) -> float:
        """The angle between two rays."""
        return (self.angle_max_deg - self.angle_min_deg) / (self.rays - 1)


class Odometry(Struct, frozen=True, forbid_unknown_fields=True):
    """Standard deviations of the odometry's errors.

    They are numbered as in *Probabilistic Robotics*, table 5.6 (AMCL's parameters of these names
    are the squares). The greater part of each error is constant, from wheel sizes, wheel base and
    floor, and localization estimates it while the robot drives. The rest is random.
    """

    alpha1: Share = 0.1  # of the heading, by turning: rad/rad
    alpha2: Share = 0.06  # of the heading, by driving: rad/m
    alpha3: Share = 0.04  # of the distance, by driving: m/m
    alpha4: Share = 0.0  # of the distance, by turning: m/rad


WIDE: Final = Odometry()
"""Default for robots with a laser: the errors of a real Pioneer 2 in a log of the Intel laboratory
(drift 0.057 rad/m, turns 10 %, distances 4 %)."""

NARROW: Final = Odometry(alpha1=0.025, alpha2=0.03, alpha3=0.016)
"""Default for robots with sonars only. Along a corridor their position comes from the wheels alone;
with an error of 4 % they would count as lost after 12 m."""


class Battery(Struct, frozen=True, forbid_unknown_fields=True):
    """A battery, discharged by motors and electronics, charged in a dock."""

    full_v: Positive
    low_v: Positive  # below this it has to be charged soon
    empty_v: Positive  # below this it has to be charged at once
    capacity_ah: Positive
    internal_ohm: NonNegative
    idle_a: NonNegative
    charge_a: NonNegative  # current of the charger
    taper_from: Share  # from this charge on the current falls, to 0 when full

    def __post_init__(self) -> None:
        if not self.empty_v < self.low_v < self.full_v:
            raise ValueError("expected empty_v < low_v < full_v")


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table of the kind of robot: the keys that all kinds have."""

    cycle_s: Period  # between two reports of the robot
    watchdog_s: Patience | None = None  # the robot stops this long after a command; None: never


class RobotProfile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot with differential drive, or one that turns in the same way.

    A kind of robot derives its class from `IdentifiedRobot` or `ModelledRobot` and adds one field,
    its section. The field has the name of the kind's entry point in `armadico.robots`.
    """

    section: ClassVar[str] = ""
    """The name of that field and of the entry point."""

    name: Name
    body: Body
    limits: Limits
    battery: Battery
    stop_within_m: Length = 0.5
    """The way it may go on, before it begins to brake, if the robot agent or its guard fails."""
    caster: Caster | None = None
    inertia: Inertia | None = None
    motor: Motor | None = None
    speed_loop: SpeedLoop | None = None
    drive: Drive | None = None
    sonar: SonarRing | None = None
    laser: Laser | None = None
    odometry: Odometry | None = None  # None: a default for its sensors

    def __post_init__(self) -> None:
        if self.sonar is None and self.laser is None:
            raise ValueError("needs a [sonar] or a [laser] section")

    @property
    def ring(self) -> SonarRing:
        """Its sonars. Raises ConfigError if it has none."""
        if self.sonar is None:
            raise ConfigError(f"{self.name} has no sonars")
        return self.sonar

    @property
    def wheels(self) -> Odometry:
        """The errors of its odometry."""
        return self.odometry or (NARROW if self.laser is None else WIDE)

    @property
    def reach_m(self) -> float:
        """The longest range of its sensors, m."""
        return max(sensor.max_m for sensor in (self.sonar, self.laser) if sensor is not None)

    @property
    def cycle_s(self) -> float:
        """The length of a cycle, s."""
        return self._section.cycle_s

    @property
    def watchdog_s(self) -> float:
        """The controller stops this long after the last command, s; `NEVER_S` for never."""
        return self._section.watchdog_s or NEVER_S

    @property
    def scans_from(self) -> str:
        """The source of its scans, for messages; "": its controller."""
        return ""

    @property
    def _section(self) -> Section:
        section: Section = getattr(self, self.section)
        return section


class IdentifiedRobot(RobotProfile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot with known masses and motors: the simulator solves its equations of motion."""

    caster: Caster
    inertia: Inertia
    motor: Motor
    speed_loop: SpeedLoop

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive is not None:
            raise ValueError(f"a robot with [{self.section}] must not have [drive]")


class ModelledRobot(RobotProfile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot with a kinematic model of its drive."""

    drive: Drive

    def __post_init__(self) -> None:
        super().__post_init__()
        for table in ("caster", "inertia", "motor", "speed_loop"):
            if getattr(self, table) is not None:
                raise ValueError(f"a robot with [{self.section}] must not have [{table}]")


def load_profile(name_or_path: str | Path) -> RobotProfile:
    """A shipped profile by its name, or a TOML file. Raises ConfigError."""
    path = find("robots", name_or_path)
    return _read(read_text(path), path)


def load_kind(section: str) -> Any:
    """The kind of robot of a section. Raises UnknownNameError or ImportError."""
    found = discovery.find(ROBOTS, section)
    kind: Any = found.load()
    profile: object = getattr(kind, "profile", None)
    if not (isinstance(profile, type) and issubclass(profile, RobotProfile)):
        raise found.unusable("must have a `profile`, a class derived from RobotProfile")
    if profile.section != section:
        raise found.unusable(f"has a profile whose section is {profile.section!r}")
    return kind


@lru_cache(maxsize=8)  # it takes 3 ms, and a society reads its robot's profile a dozen times
def _read(text: str, path: Path) -> RobotProfile:
    table = document(text, path)
    kinds = installed(ROBOTS)
    sections = [name for name in table if name in kinds]
    if len(sections) != 1:
        raise _of_no_kind(table, sections, tuple(kinds), path, text)
    if isinstance(table[sections[0]], list):
        what = f"[[{sections[0]}]] is an array of tables; expected one table [{sections[0]}]"
        raise ConfigError(what, path, line_of(text, sections))
    try:
        kind: type[RobotProfile] = load_kind(sections[0]).profile
    except ImportError as error:
        raise ConfigError(str(error), path, line_of(text, sections)) from error
    return convert(table, kind, path, text)


def _of_no_kind(
    table: Mapping[str, object], sections: list[str], kinds: tuple[str, ...], path: Path, text: str
) -> ConfigError:
    """The error for a profile with no section of a kind of robot, or with several."""
    if sections:
        both = " and ".join(f"[{name}]" for name in sections)
        line = line_of(text, sections[1:])
        return ConfigError(f"has tables {both}; expected one kind of robot", path, line)
    fields = {*IdentifiedRobot.__struct_fields__, *ModelledRobot.__struct_fields__}
    for name, value in table.items():
        if name not in fields and isinstance(value, dict):
            what = f"[{name}] is not an installed kind of robot; {advice(name, kinds)}"
            line = line_of(text, (name,))
            return ConfigNameError("kind of robot", name, kinds, path, line, what)
    known = f"installed kinds of robots: {', '.join(kinds) or 'none'}"
    return ConfigError(f"missing the table of a kind of robot ({known})", path)


class SensorProfile(Struct, frozen=True, forbid_unknown_fields=True):
    """The errors of the simulated sensors: `ideal` or `real`.

    Values marked "drawn" are limits: a run draws its error uniformly within +- this value.
    """

    name: str
    sonar_noise_m: NonNegative  # least standard deviation of a range
    sonar_noise: Share  # standard deviation as a share of the range
    glancing_deg: Angle  # a rough wall beyond this angle from its normal gives no echo
    dropout: Share  # probability of a lost echo
    dead_walls: Share  # share of walls without any echo
    rough_walls: Share  # share of walls that scatter; the others are specular
    gone_deg: tuple[Angle, Angle]  # a specular wall gives no echo from an angle in this range on
    edge_m: NonNegative  # an edge always gives an echo up to here, beyond it as 1 / range
    multipath: Share  # probability that a returning specular reflection is detected
    crosstalk: Share  # probability that the next sonar detects an unreturned ping
    laser_sweep: Share  # 1: a laser takes the time of its turn for a scan; 0: an instant
    laser_dropout: Share  # share of a laser's rays that are lost
    black_walls: Share  # share of walls that a laser detects within `black_m` only
    black_m: NonNegative
    glass_walls: Share  # share of walls that a laser passes through,
    glass_deg: Angle  # except within this angle from their normal
    slip: Share  # standard deviation of each wheel's relative slip
    drift_rad_m: NonNegative  # heading error that grows with distance: drawn
    turn_error: Share  # of the wheel base, so of all turning: drawn
    way_error: Share  # of both wheels' diameters, so of all distances: drawn
