"""The ROS 2 messages that are used, with the fields of ROS 2's `.msg` files (Jazzy).

Units and frames are those of ROS: SI, REP-103, REP-105. `cdr` encodes and decodes them, and has
their names and hashes. Sequences take lists (numpy arrays: `tolist()`), `uint8` also bytes.

Source: github.com/ros2/common_interfaces, rcl_interfaces, geometry2, rmw_dds_common, branch jazzy;
github.com/iRobotEducation/irobot_create_msgs.
"""

# No `from __future__ import annotations`: pycdr2 reads the annotations at runtime.
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pycdr2 import IdlStruct
from pycdr2.types import array, bounded_str, sequence, uint8, uint32
from pycdr2.types import float32 as f32
from pycdr2.types import float64 as f64
from pycdr2.types import int8 as i8
from pycdr2.types import int32 as i32

Floats = Annotated[Sequence[float], sequence(f32)]
Bytes = Annotated[Sequence[int], sequence(uint8)]
Cells = Annotated[Sequence[int], sequence(i8)]
Covariance6 = Annotated[Sequence[float], array(f64, 36)]
Gid16 = Annotated[Sequence[int], array(uint8, 16)]
Name = Annotated[str, bounded_str(256)]


def _zeros36() -> Sequence[float]:
    return [0.0] * 36


@dataclass
class Time(IdlStruct, typename="builtin_interfaces/msg/Time"):
    """Seconds since 1970, or since the robot's start if it has no clock."""

    sec: i32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs/msg/Header"):
    """Time of the measurement, and frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class String(IdlStruct, typename="std_msgs/msg/String"):
    data: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs/msg/Vector3"):
    """A direction, or speeds along or about three axes."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs/msg/Point"):
    """A position, m."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs/msg/Quaternion"):
    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0
    w: f64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs/msg/Pose"):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs/msg/PoseStamped"):
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs/msg/PoseWithCovariance"):
    """A pose and the covariance of x, y, z, roll, pitch, yaw, by rows."""

    pose: Pose = field(default_factory=Pose)
    covariance: Covariance6 = field(default_factory=_zeros36)


@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename="geometry_msgs/msg/PoseWithCovarianceStamped"):
    header: Header = field(default_factory=Header)
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)


@dataclass
class Twist(IdlStruct, typename="geometry_msgs/msg/Twist"):
    """Speeds, m/s and rad/s."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs/msg/TwistStamped"):
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs/msg/TwistWithCovariance"):
    """Speeds and their covariance, by rows."""

    twist: Twist = field(default_factory=Twist)
    covariance: Covariance6 = field(default_factory=_zeros36)


@dataclass
class Transform(IdlStruct, typename="geometry_msgs/msg/Transform"):
    """The pose of one frame in another."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs/msg/TransformStamped"):
    """The pose of the child frame in the header's."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs/msg/TFMessage"):
    transforms: Annotated[Sequence[TransformStamped], sequence(TransformStamped)] = field(
        default_factory=list
    )


@dataclass
class Odometry(IdlStruct, typename="nav_msgs/msg/Odometry"):
    """Pose in the header's frame, speeds in the child's."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs/msg/MapMetaData"):
    """A grid's size; `origin` is the pose of cell (0, 0)'s corner."""

    map_load_time: Time = field(default_factory=Time)
    resolution: f32 = 0.0
    width: uint32 = 0
    height: uint32 = 0
    origin: Pose = field(default_factory=Pose)


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs/msg/OccupancyGrid"):
    """Cells by rows from (0, 0): 0 free to 100 occupied, -1 unknown."""

    header: Header = field(default_factory=Header)
    info: MapMetaData = field(default_factory=MapMetaData)
    data: Cells = field(default_factory=list)


@dataclass
class Path(IdlStruct, typename="nav_msgs/msg/Path"):
    header: Header = field(default_factory=Header)
    poses: Annotated[Sequence[PoseStamped], sequence(PoseStamped)] = field(default_factory=list)


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces/msg/Duration"):
    sec: i32 = 0
    nanosec: uint32 = 0


@dataclass
class ColorRGBA(IdlStruct, typename="std_msgs/msg/ColorRGBA"):
    """Shares of red, green, blue and opacity."""

    r: f32 = 0.0
    g: f32 = 0.0
    b: f32 = 0.0
    a: f32 = 1.0


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs/msg/CompressedImage"):
    header: Header = field(default_factory=Header)
    format: str = ""
    data: Bytes = field(default_factory=list)


@dataclass
class UVCoordinate(IdlStruct, typename="visualization_msgs/msg/UVCoordinate"):
    u: f32 = 0.0
    v: f32 = 0.0


@dataclass
class MeshFile(IdlStruct, typename="visualization_msgs/msg/MeshFile"):
    filename: str = ""
    data: Bytes = field(default_factory=list)


@dataclass
class Marker(IdlStruct, typename="visualization_msgs/msg/Marker"):
    """A shape for RViz: `type` is one of those below; `scale.x` is the width of lines, m."""

    header: Header = field(default_factory=Header)
    ns: str = ""
    id: i32 = 0
    type: i32 = 0
    action: i32 = 0
    pose: Pose = field(default_factory=Pose)
    scale: Vector3 = field(default_factory=Vector3)
    color: ColorRGBA = field(default_factory=ColorRGBA)
    lifetime: Duration = field(default_factory=Duration)
    frame_locked: bool = False
    points: Annotated[Sequence[Point], sequence(Point)] = field(default_factory=list)
    colors: Annotated[Sequence[ColorRGBA], sequence(ColorRGBA)] = field(default_factory=list)
    texture_resource: str = ""
    texture: CompressedImage = field(default_factory=CompressedImage)
    uv_coordinates: Annotated[Sequence[UVCoordinate], sequence(UVCoordinate)] = field(
        default_factory=list
    )
    text: str = ""
    mesh_resource: str = ""
    mesh_file: MeshFile = field(default_factory=MeshFile)
    mesh_use_embedded_materials: bool = False


LINE_STRIP, LINE_LIST = 4, 5
"""A marker's `type`: points in a row, or pairs of points."""

ADD, DELETE = 0, 2
"""A marker's `action`."""


@dataclass
class MarkerArray(IdlStruct, typename="visualization_msgs/msg/MarkerArray"):
    markers: Annotated[Sequence[Marker], sequence(Marker)] = field(default_factory=list)


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs/msg/LaserScan"):
    """One turn of a laser: rad, s, m; a range outside `range_min`..`range_max` is invalid."""

    header: Header = field(default_factory=Header)
    angle_min: f32 = 0.0
    angle_max: f32 = 0.0
    angle_increment: f32 = 0.0
    time_increment: f32 = 0.0
    scan_time: f32 = 0.0
    range_min: f32 = 0.0
    range_max: f32 = 0.0
    ranges: Floats = field(default_factory=list)
    intensities: Floats = field(default_factory=list)


@dataclass
class Range(IdlStruct, typename="sensor_msgs/msg/Range"):
    """One ranger's reading, m; `radiation_type` 0 is ultrasound, 1 infrared."""

    header: Header = field(default_factory=Header)
    radiation_type: uint8 = 0
    field_of_view: f32 = 0.0
    min_range: f32 = 0.0
    max_range: f32 = 0.0
    range: f32 = 0.0
    variance: f32 = 0.0


@dataclass
class BatteryState(IdlStruct, typename="sensor_msgs/msg/BatteryState"):
    """V, A, Ah, deg C; NaN is not measured."""

    header: Header = field(default_factory=Header)
    voltage: f32 = 0.0
    temperature: f32 = 0.0
    current: f32 = 0.0
    charge: f32 = 0.0
    capacity: f32 = 0.0
    design_capacity: f32 = 0.0
    percentage: f32 = 0.0
    power_supply_status: uint8 = 0
    power_supply_health: uint8 = 0
    power_supply_technology: uint8 = 0
    present: bool = False
    cell_voltage: Floats = field(default_factory=list)
    cell_temperature: Floats = field(default_factory=list)
    location: str = ""
    serial_number: str = ""


CHARGING, DISCHARGING = 1, 2
"""A battery's `power_supply_status`."""


@dataclass
class HazardDetection(IdlStruct, typename="irobot_create_msgs/msg/HazardDetection"):
    """A hazard of a Create 3: `type` is one of those below; the header has the sensor's frame."""

    header: Header = field(default_factory=Header)
    type: uint8 = 0


BACKUP_LIMIT, BUMP, CLIFF, STALL, WHEEL_DROP, OBJECT_PROXIMITY = range(6)
"""Hazards; BACKUP_LIMIT: it backs no farther for safety, OBJECT_PROXIMITY: an obstacle is near."""


@dataclass
class HazardDetectionVector(IdlStruct, typename="irobot_create_msgs/msg/HazardDetectionVector"):
    """All present hazards."""

    header: Header = field(default_factory=Header)
    detections: Annotated[Sequence[HazardDetection], sequence(HazardDetection)] = field(
        default_factory=list
    )


@dataclass
class PointField(IdlStruct, typename="sensor_msgs/msg/PointField"):
    """One field of a cloud's points; `datatype` 7 is float32."""

    name: str = ""
    offset: uint32 = 0
    datatype: uint8 = 0
    count: uint32 = 0


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs/msg/PointCloud2"):
    """Points, `point_step` bytes each."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    fields: Annotated[Sequence[PointField], sequence(PointField)] = field(default_factory=list)
    is_bigendian: bool = False
    point_step: uint32 = 0
    row_step: uint32 = 0
    data: Bytes = field(default_factory=list)
    is_dense: bool = False


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs/msg/KeyValue"):
    key: str = ""
    value: str = ""


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs/msg/DiagnosticStatus"):
    """State of one component: `level` 0 is OK, 1 warning, 2 error, 3 stale."""

    level: uint8 = field(default=0, metadata={"msg": "byte"})
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: Annotated[Sequence[KeyValue], sequence(KeyValue)] = field(default_factory=list)


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs/msg/DiagnosticArray"):
    header: Header = field(default_factory=Header)
    status: Annotated[Sequence[DiagnosticStatus], sequence(DiagnosticStatus)] = field(
        default_factory=list
    )


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common/msg/Gid"):
    """Id of an endpoint: 12 bytes of participant, 4 of entity."""

    data: Gid16 = bytes(16)


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common/msg/NodeEntitiesInfo"):
    """The readers and writers of one node."""

    node_namespace: Name = ""
    node_name: Name = ""
    reader_gid_seq: Annotated[Sequence[Gid], sequence(Gid)] = field(default_factory=list)
    writer_gid_seq: Annotated[Sequence[Gid], sequence(Gid)] = field(default_factory=list)


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common/msg/ParticipantEntitiesInfo"):
    """The nodes of a participant, on `ros_discovery_info`: it relates endpoints to nodes."""

    gid: Gid = field(default_factory=Gid)
    node_entities_info_seq: Annotated[Sequence[NodeEntitiesInfo], sequence(NodeEntitiesInfo)] = (
        field(default_factory=list)
    )
