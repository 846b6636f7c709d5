"""The robot profile: every number that belongs to one make of robot (thesis tables 4.2, 4.3, 4.6).

A profile is a TOML file under ``configs/robots``, or anywhere. SI units throughout; only the
section of a kind of robot may have units of its controller's. That section is read by the kind,
which is found by an entry point (`armadico.bridge.kind`). What the robot agent publishes of its
robot is as bounded here as on the mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from math import radians
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Protocol

from msgspec import Meta, Struct

from armadico.config import discovery
from armadico.config.discovery import ROBOTS, installed
from armadico.config.errors import ConfigError, ConfigNameError, advice
from armadico.config.lines import line_of
from armadico.config.loading import convert, document, read_text
from armadico.config.shipped import find
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
    frame: FrameName | None = None  # as its readings name it, if they do

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
    firing_order: tuple[int, ...]  # by their places in `sonars`, from 0

    def __post_init__(self) -> None:
        if not self.min_m < self.max_m:
            raise ValueError(f"min_m = {self.min_m:g} is not less than max_m = {self.max_m:g}")
        fired, known = set(self.firing_order), set(range(len(self.sonars)))
        if unknown := sorted(fired - known):
            raise ValueError(
                f"firing_order has sonar {unknown[0]}, and there are {len(known)}, counted from 0"
            )
        if silent := sorted(known - fired):
            raise ValueError(f"firing_order does not have sonar {silent[0]}: it would never fire")


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


class Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table that says which kind of robot a profile is of: what it has for every kind."""

    cycle_s: Period  # from one report of the robot to the next
    watchdog_s: Patience | None = None  # the robot stops so long after a command; None: never


class RobotProfile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot on two wheels, or that turns as if it were.

    A kind of robot has a class derived from `IdentifiedRobot` or `ModelledRobot`, with one more
    field: its section, which goes by the name of the kind's entry point in `armadico.robots`.
    """

    section: ClassVar[str] = ""
    """The name of that field, and of the entry point."""

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

    def __post_init__(self) -> None:
        if self.sonar is None and self.laser is None:
            raise ValueError("needs a table [sonar] or a table [laser]: no agent drives blind")

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
        return self._section.cycle_s

    @property
    def watchdog_s(self) -> float:
        """Without a command for so long the controller stops by itself, s; `NEVER_S`: or never."""
        return self._section.watchdog_s or NEVER_S

    @property
    def scans_from(self) -> str:
        """Where its laser's scans come from, for messages to people; "": its controller."""
        return ""

    @property
    def _section(self) -> Section:
        section: Section = getattr(self, self.section)
        return section


class IdentifiedRobot(RobotProfile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot whose masses and motors are known: the simulator solves its equations of motion."""

    caster: Caster
    inertia: Inertia
    motor: Motor
    speed_loop: SpeedLoop

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive is not None:
            raise ValueError(f"a robot with a table [{self.section}] has no use for [drive]")


class ModelledRobot(RobotProfile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot of which is known how it moves, and not why."""

    drive: Drive

    def __post_init__(self) -> None:
        super().__post_init__()
        for table in ("caster", "inertia", "motor", "speed_loop"):
            if getattr(self, table) is not None:
                raise ValueError(f"a robot with a table [{self.section}] has no use for [{table}]")


class _Kind(Protocol):
    """What an entry point in `armadico.robots` leads to; `armadico.bridge.kind` has the rest."""

    @property
    def profile(self) -> type[RobotProfile]:
        """The class of its profiles."""


def load_profile(name_or_path: str | Path) -> RobotProfile:
    """A shipped profile by its name, or a TOML file. Raises ConfigError."""
    path = find("robots", name_or_path)
    return _read(read_text(path), path)


def load_kind(section: str) -> Any:
    """The kind of robot that a section is of. Raises UnknownNameError, ImportError."""
    found = discovery.find(ROBOTS, section)
    kind: _Kind = found.load()
    profile: object = getattr(kind, "profile", None)
    if not (isinstance(profile, type) and issubclass(profile, RobotProfile)):
        raise found.unusable("is no RobotKind: its `profile` is a class derived from RobotProfile")
    if profile.section != section:
        raise found.unusable(f"has a profile whose section is {profile.section!r}")
    return kind


@lru_cache(maxsize=8)  # 3 ms, and a society asks for its robot's a dozen times
def _read(text: str, path: Path) -> RobotProfile:
    table = document(text, path)
    kinds = installed(ROBOTS)
    sections = [name for name in table if name in kinds]
    if len(sections) != 1:
        raise _of_no_kind(table, sections, tuple(kinds), path, text)
    if isinstance(table[sections[0]], list):
        what = f"[[{sections[0]}]] is an array of tables: write [{sections[0]}], once"
        raise ConfigError(what, path, line_of(text, sections))
    try:
        kind: _Kind = load_kind(sections[0])
    except ImportError as error:
        raise ConfigError(str(error), path, line_of(text, sections)) from error
    return convert(table, kind.profile, path, text)


def _of_no_kind(
    table: Mapping[str, Any], sections: list[str], kinds: tuple[str, ...], path: Path, text: str
) -> ConfigError:
    """The error for a profile that is of no kind of robot, or of several."""
    if sections:
        both = " and ".join(f"[{name}]" for name in sections)
        line = line_of(text, sections[1:])
        return ConfigError(f"has tables {both}: a robot is of one kind", path, line)
    fields = {*IdentifiedRobot.__struct_fields__, *ModelledRobot.__struct_fields__}
    for name, value in table.items():
        if name not in fields and isinstance(value, dict):
            what = f"[{name}] is not an installed kind of robot; {advice(name, kinds)}"
            line = line_of(text, (name,))
            return ConfigNameError("kind of robot", name, kinds, path, line, what)
    known = f"installed kinds of robots: {', '.join(kinds) or 'none'}"
    return ConfigError(f"missing the table of a kind of robot ({known})", path)


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
