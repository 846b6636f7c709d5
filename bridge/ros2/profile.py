"""The section [ros2] of a profile: a robot that speaks ROS 2, and its topics."""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec import Meta, Struct

from armadico.config.profile import FrameName, ModelledRobot, NonNegative, Section

_WORD = r"[A-Za-z][A-Za-z0-9_]*"
TopicName = Annotated[str, Meta(max_length=255, pattern=rf"^/?{_WORD}(/{_WORD})*\Z")]


class Topic(Struct, frozen=True, forbid_unknown_fields=True):
    """A ROS 2 topic, and the quality of service that the robot agent requests or offers."""

    name: TopicName  # below the robot's namespace, unless it begins with a slash
    reliable: bool = True
    latched: bool = False  # transient local: late subscribers receive the last samples
    depth: Annotated[int, Meta(ge=1, le=1000)] = 10


class Ros2(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The topics of a robot that speaks ROS 2, and how it obeys.

    A cycle is an odometry message whose stamp is `cycle_s` or more after the last cycle's.
    """

    latency_s: Annotated[float, Meta(ge=0, le=1)]  # from a command until the base starts to follow
    stamped: bool  # cmd_vel is a TwistStamped, not a Twist
    odom_hz: Annotated[float, Meta(ge=5, le=1000)]
    odom_frame: FrameName
    base_frame: FrameName
    odom: Topic
    cmd_vel: Topic
    v_step: NonNegative = 0.0  # m/s: the base obeys whole multiples; less than one counts as zero
    w_step: NonNegative = 0.0  # rad/s
    laser_frame: FrameName = "base_scan"
    scan: Topic | None = None
    sonar: tuple[Topic, ...] = ()  # one for all sonars, or one for each
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
        """All topics, the command's last."""
        read = (self.odom, self.scan, *self.sonar, self.battery, self.hazards)
        read += (self.tf, self.tf_static)
        return (*(topic for topic in read if topic is not None), self.cmd_vel)


class Ros2Robot(ModelledRobot, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A robot that speaks ROS 2, with a model of its motion."""

    section: ClassVar[str] = "ros2"

    ros2: Ros2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.laser is not None and self.ros2.scan is None:
            raise ValueError("a [laser] needs its topic, [ros2.scan]")
        self._check_sonars()

    @property
    def scans_from(self) -> str:
        """The topic of its scans, "" without one."""
        return "" if self.ros2.scan is None else self.ros2.scan.name

    def _check_sonars(self) -> None:
        """Check that each message can be attributed to one sonar. Raises ValueError."""
        sonars = () if self.sonar is None else self.sonar.sonars
        frames = [sonar.frame for sonar in sonars]
        if None in frames or len(set(frames)) < len(frames):
            raise ValueError(
                "each sonar of [sonar] needs a frame of its own: its readings' frame_id"
            )
        topics = self.ros2.sonar
        if len(topics) not in {min(1, len(sonars)), len(sonars)}:
            raise ValueError(
                f"[[ros2.sonar]] needs one table for all sonars, or one for each ({len(sonars)}"
                f" sonars, {len(topics)} tables)"
            )
