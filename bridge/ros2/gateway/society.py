"""A society as ROS 2 topics: types and frames (sans-IO); docs/ros2.md has the list.

Frames follow REP-105: `map` is the world, `odom` the controller's odometry, `base_link` the middle
of the wheel axle. `map` -> `odom` is computed from the pose and the odometry of one cycle, so
`map` -> `base_link` is the pose that agents use. A stamp is the time at which the cycle's status
packet was received; all samples of a cycle have the same stamp.

Unknown values: covariances are 0, a battery's numbers NaN, cells -1. A range without an echo is
infinite (REP-117).
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Final, NamedTuple, TypeVar

import numpy as np
from pycdr2 import IdlStruct

from armadico.bridge.ros2 import cdr, types
from armadico.bridge.ros2.gateway.goals import read_goal
from armadico.bridge.ros2.gateway.graphs import markers
from armadico.bridge.ros2.gateway.grids import drawn, occupancy
from armadico.bridge.ros2.gateway.health import MOST, Health
from armadico.bridge.ros2.geometry import pose_of, rotation, stamp_of
from armadico.bridge.ros2.guest import Gateway
from armadico.config.grid_map import cells_of
from armadico.config.map_graphs import graph_of
from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.mobile.geometry import Pose2, compose, relative, wrap
from armadico.mobile.messages import (
    COVARIANCE,
    LocalMap,
    MapGraph,
    MissionRequest,
    OccupancyGrid,
    Pose,
    Scan,
    Sonar,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.scans import ranges_of
from armadico.observe.translators import Channel, Sample
from armadico.observe.view import FRESH_CYCLES

MAP: Final = "map"  # the frame that all robots of a mesh share
ODOM, BASE, SCAN = "odom", "base_link", "base_scan"

STATES: Final = 32  # newest cycles whose stamp and odometry are in memory
LOCAL_M: Final = 0.1  # size of a cell of the local map
LOCAL_CELLS: Final = 256  # largest number of cells per side; a larger reach has larger cells
OLD_S: Final = 10.0  # a goal with an older stamp is refused: it was delayed, or is a playback
ULTRASOUND: Final = 0

_UNFIT: Final = re.compile(r"[^A-Za-z0-9_/]")
_DIGIT: Final = re.compile(r"(?<![^/])(?=[0-9])")


class _Topic(NamedTuple):
    """A topic with fields of `Channel`; a name without a slash is below the namespace."""

    name: str
    kind: type[IdlStruct]
    depth: int = 10
    latched: bool = False
    own: bool = False


_TF: Final = _Topic("/tf", types.TFMessage, 100)
_OWN_TF: Final = _TF._replace(own=True)
_TF_STATIC: Final = _Topic("/tf_static", types.TFMessage, 1, latched=True, own=True)
_DIAGNOSTICS: Final = _Topic("/diagnostics", types.DiagnosticArray)
_ODOM: Final = _Topic("odom", types.Odometry, own=True)
_POSE: Final = _Topic("pose", types.PoseWithCovarianceStamped)
_SCAN: Final = _Topic("scan", types.LaserScan, own=True)
_SONAR: Final = _Topic("sonar", types.Range, 50, own=True)
_OBSTACLES: Final = _Topic("obstacles", types.PointCloud2)
_LOCAL_MAP: Final = _Topic("local_map", types.OccupancyGrid, 1, latched=True)
_MAP: Final = _Topic("map", types.OccupancyGrid, 1, latched=True)
_GRAPH: Final = _Topic("graph", types.MarkerArray, 1, latched=True)
_PATH: Final = _Topic("path", types.Path, 1, latched=True)
_BATTERY: Final = _Topic("battery_state", types.BatteryState, own=True)
_GOAL: Final = _Topic("goal_pose", types.PoseStamped, 1)

_TOPICS: Final = (  # of samples
    *(_TF, _OWN_TF, _TF_STATIC, _DIAGNOSTICS, _ODOM, _POSE, _SCAN, _SONAR, _OBSTACLES),
    *(_LOCAL_MAP, _MAP, _GRAPH, _PATH, _BATTERY),
)

_Output = tuple[_Topic, IdlStruct]  # a topic and a sample
_Receiver = Callable[..., Iterator[_Output]]


class _State(NamedTuple):
    """Stamp and odometry of a cycle."""

    cycle: m.Cycle
    at: int  # ns
    odometry: Pose2


def ros_namespace(namespace: str) -> str:
    """A namespace valid in ROS 2: letters, digits and `_`, not beginning with a digit."""
    return _DIGIT.sub("_", _UNFIT.sub("_", namespace))


class Society:
    """One robot's society as ROS 2 topics; see `armadico.observe.translators`."""

    profile = "ros2"
    kinds: Sequence[type[m.Message]] = Gateway.receives
    # Without a version rosbag2 reads quality of service as numbers, which is Iron's format.
    about: Mapping[str, Mapping[str, str]] = {"rosbag2": {"ROS_DISTRO": "iron"}}

    def __init__(self, namespace: str = "", world: World | None = None) -> None:
        """See `Makes`. Topics (`/robot1/odom`) and frames (`robot1/odom`) have the namespace."""
        self.namespace = ros_namespace(namespace)
        self._prefix = f"{self.namespace}/" if namespace else ""
        self._world = world
        self._channels = {topic: self._channel(topic) for topic in _TOPICS}
        self.channels: Sequence[Channel] = tuple(self._channels.values())
        self.goals = self._channel(_GOAL)
        self._states: deque[_State] = deque(maxlen=STATES)
        self._base: Pose2 | None = None  # the robot's newest pose in the map
        self._odom: Pose2 | None = None  # the odometry's origin in the map
        self._sonars: dict[tuple[float, float, float], str] = {}
        self._scan: tuple[int, int] | None = None  # the epoch and number of the newest
        self._near: dict[str, Obstacles] = {}  # by key, for each sensor
        self._local: dict[str, LocalMap] = {}
        self._grid: OccupancyGrid | None = None
        self._revision = 0  # of the map that the newest pose is on
        self._held: OccupancyGrid | None = None  # a map that no pose is on yet
        self._path: tuple[object, ...] | None = None
        self._health = Health(self._prefix)
        kept: dict[type[m.Message], _Receiver] = dict.fromkeys(self.kinds, self._keep)
        self._receivers = kept | {
            m.RobotState: self._on_state,
            Pose: self._on_pose,
            Sonar: self._on_sonar,
            Scan: self._on_scan,
            Obstacles: self._on_obstacles,
            LocalMap: self._on_local_map,
            OccupancyGrid: self._on_grid,
            MapGraph: self._on_graph,
            Trajectory: self._on_trajectory,
            m.Ack: self._on_ack,
        }
        assert len(self._receivers) == len(self.kinds), "`Gateway` lists every kind that it gets"

    # Messages in, samples out ---------------------------------------------------------------------

    def translate(self, key: str, message: m.Message, at: int) -> Iterator[Sample]:
        for topic, sample in self._outputs(key, message, at):
            yield Sample(self._channels[topic], cdr.encode(sample))

    def _outputs(self, key: str, message: m.Message, at: int) -> Iterator[_Output]:
        if self._world is not None:
            yield _MAP, occupancy(drawn(self._world), self._on_map(at))
            self._world = None
        receiver = self._receivers.get(type(message))
        if receiver is not None:
            yield from receiver(key, message, at)
        if (diagnostics := self._health.diagnostics(at)) is not None:
            yield _DIAGNOSTICS, diagnostics

    def _on_state(self, _: str, state: m.RobotState, at: int) -> Iterator[_Output]:
        here = (state.x, state.y, state.theta)
        self._states.append(_State(state.cycle, at, here))
        self._health.newest[m.RobotState] = state
        yield _OWN_TF, types.TFMessage([self._transform(at, self._prefix + ODOM, BASE, here)])
        speeds = types.Twist(types.Vector3(state.v), types.Vector3(z=state.w))
        yield (
            _ODOM,
            types.Odometry(
                self._header(at, ODOM),
                self._prefix + BASE,
                types.PoseWithCovariance(pose_of(here)),
                types.TwistWithCovariance(speeds),
            ),
        )
        pose = self._health.known(Pose)
        if pose is not None and pose.cycle == state.cycle:
            yield self._corrected(pose, self._states[-1])  # the pose arrived before the state
        if (battery := self._health.battery(state, self._header(at, BASE), at)) is not None:
            yield _BATTERY, battery

    def _on_pose(self, _: str, pose: Pose, at: int) -> Iterator[_Output]:
        self._health.newest[Pose] = pose
        self._base = (pose.x, pose.y, pose.theta)
        state = self._at(pose.cycle)
        stamp = at if state is None else state.at
        if state is not None:
            yield self._corrected(pose, state)
        header = self._on_map(stamp)
        known = types.PoseWithCovariance(pose_of(self._base), _covariance(pose.covariance))
        yield _POSE, types.PoseWithCovarianceStamped(header, known)
        if pose.revision != self._revision:
            self._revision, held, self._held = pose.revision, self._held, None
            if held is not None:
                yield from self._on_grid("", held, at)

    def _corrected(self, pose: Pose, state: _State) -> _Output:
        """The odometry's origin in the map, from the pose and the odometry of one cycle."""
        origin = relative(state.odometry, (0.0, 0.0, 0.0))
        self._odom = compose((pose.x, pose.y, pose.theta), origin)
        return _TF, types.TFMessage([self._transform(state.at, MAP, ODOM, self._odom)])

    def _on_sonar(self, _: str, sonar: Sonar, at: int) -> Iterator[_Output]:
        mounted = {(echo.x, echo.y, echo.bearing) for echo in sonar.echoes}
        new = sorted(mounted - self._sonars.keys())
        if new and len(self._sonars) < MOST:
            for where in new:
                self._sonars[where] = self._sonar_frame(where)
            yield (
                _TF_STATIC,
                types.TFMessage(
                    [
                        self._transform(at, self._prefix + BASE, frame, where)
                        for where, frame in sorted(self._sonars.items())
                    ]
                ),
            )
        stamp = self._stamp(sonar.cycle, at)
        robot = self._health.known(m.Description)
        limits = (0.0, 0.0) if robot is None else (robot.cone, robot.nearest)
        for echo in sonar.echoes:
            frame = self._sonars.get((echo.x, echo.y, echo.bearing))
            if frame is None:
                continue
            measured = math.inf if echo.range is None else echo.range
            header = self._header(stamp, frame)
            yield _SONAR, types.Range(header, ULTRASOUND, *limits, sonar.reach, measured)

    def _on_grid(self, _: str, grid: OccupancyGrid, at: int) -> Iterator[_Output]:
        if grid.revision != self._revision:
            self._held = grid  # the pose moves with it in this cycle or the next one
            return
        if grid == self._grid:
            return  # agents repeat it each second
        self._grid, self._held = grid, None
        try:
            cells = cells_of(grid)
        except ValueError:  # a malformed grid is ignored
            return
        if cells.states.size:
            yield _MAP, occupancy(cells, self._on_map(at))

    def _on_graph(self, _: str, graph: MapGraph, at: int) -> Iterator[_Output]:
        self._health.newest[MapGraph] = graph
        with suppress(ValueError):  # a malformed graph is ignored
            yield _GRAPH, markers(graph_of(graph), self._on_map(at))

    def _on_trajectory(self, _: str, trajectory: Trajectory, at: int) -> Iterator[_Output]:
        path = (trajectory.mission, trajectory.start, trajectory.waypoints)
        if path == self._path:
            return  # agents repeat it each second
        self._path = path
        header = self._on_map(at)
        places = [(w.x, w.y, w.theta) for w in trajectory.waypoints]
        if places:
            x, y = trajectory.start.x, trajectory.start.y
            places = [(x, y, math.atan2(places[0][1] - y, places[0][0] - x)), *places]
        yield _PATH, types.Path(header, [types.PoseStamped(header, pose_of(at)) for at in places])

    def _on_ack(self, _: str, ack: m.Ack, _at: int) -> Iterator[_Output]:
        self._health.on_ack(ack)
        yield from ()

    def _keep(self, _: str, message: m.Message, _at: int) -> Iterator[_Output]:
        self._health.newest[type(message)] = message
        yield from ()

    def _on_scan(self, _: str, scan: Scan, at: int) -> Iterator[_Output]:
        """Each scan once, in a frame at the laser's place with the robot's heading."""
        which = (scan.cycle.epoch, scan.number)
        if which == self._scan:
            return  # the laser is slower than the cycles
        self._scan = which
        try:
            found = ranges_of(scan)  # REP-117: NaN is invalid, infinite is no obstacle
        except ValueError:  # a malformed scan is ignored
            return
        stamp = self._stamp(scan.cycle, at)
        place = (scan.x, scan.y, 0.0)
        yield _OWN_TF, types.TFMessage([self._transform(stamp, self._prefix + BASE, SCAN, place)])
        yield (
            _SCAN,
            types.LaserScan(
                self._header(stamp, SCAN),
                angle_min=scan.bearing,
                angle_max=scan.bearing + scan.step * max(len(found) - 1, 0),
                angle_increment=scan.step,
                range_max=scan.reach,
                ranges=found.tolist(),
            ),
        )

    def _on_obstacles(self, key: str, obstacles: Obstacles, at: int) -> Iterator[_Output]:
        """The points of all sensors with fresh obstacles."""
        self._near[key] = obstacles
        found = [p for each in _fresh(self._near, obstacles.cycle) for p in each.points]
        points = np.zeros((len(found), 3), dtype="<f4")
        points[:, :2] = np.array([(p.x, p.y) for p in found], dtype="<f4").reshape(-1, 2)
        fields = [types.PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
        header = self._header(self._stamp(obstacles.cycle, at), BASE)
        size = (1, len(found), fields, False, 12, 12 * len(found))
        yield _OBSTACLES, types.PointCloud2(header, *size, points.tobytes(), is_dense=True)

    def _on_local_map(self, key: str, local: LocalMap, at: int) -> Iterator[_Output]:
        """A square around the robot; places without a cell in the local map are unknown."""
        self._local[key] = local
        maps = _fresh(self._local, local.cycle)
        reach = max(each.reach for each in maps)
        side = max(LOCAL_M, 2.0 * reach / LOCAL_CELLS)
        half = math.ceil(reach / side)
        cells = np.full((2 * half, 2 * half), -1, dtype=np.int8)
        for cell in (cell for each in maps for cell in each.cells):
            row, column = (math.floor(v / side) + half for v in (cell.y, cell.x))
            if 0 <= row < 2 * half and 0 <= column < 2 * half:
                percent = round(100.0 * cell.probability)
                cells[row, column] = max(int(cells[row, column]), percent)
        corner = -half * side
        stamp = self._stamp(local.cycle, at)
        size = types.MapMetaData(
            stamp_of(stamp), side, 2 * half, 2 * half, pose_of((corner, corner, 0.0))
        )
        known: list[int] = cells.ravel().tolist()
        yield _LOCAL_MAP, types.OccupancyGrid(self._header(stamp, BASE), size, known)

    # Goals ----------------------------------------------------------------------------------------

    def goal(self, data: bytes, at: int = 0) -> MissionRequest:
        """The goal in a sample of `goals` that was received at `at`, ns since 1970.

        Raises ValueError for an invalid goal, an unknown frame, and a stamp over `OLD_S` old.
        """
        frame, place, stamp = read_goal(data)
        if stamp and (age_s := 1e-9 * (at - stamp)) > OLD_S:
            raise ValueError(
                f"its stamp is {age_s:.0f} s old, but may be at most {OLD_S:.0f} s (0 means now);"
                " check that the clocks agree"
            )
        x, y, theta = compose(self._frame(frame), place)
        if max(abs(x), abs(y)) > m.LARGEST:
            raise ValueError(f"it is {math.hypot(x, y):.3g} m away, which is too far")
        return MissionRequest(Waypoint(x, y, theta), by="ROS 2")

    def _frame(self, frame: str) -> Pose2:
        """The pose of a frame in the map. Raises ValueError."""
        known = {
            MAP: (0.0, 0.0, 0.0),
            self._prefix + ODOM: self._odom,
            self._prefix + BASE: self._base,
        }
        name = frame.removeprefix("/")
        if name not in known:
            raise ValueError(f"its frame is {frame!r}, but must be one of {', '.join(known)}")
        where = known[name]
        if where is None:
            raise ValueError(f"the pose of {name} in {MAP} is not known yet")
        return where

    # Stamps and frames ----------------------------------------------------------------------------

    def _at(self, cycle: m.Cycle) -> _State | None:
        return next((state for state in reversed(self._states) if state.cycle == cycle), None)

    def _stamp(self, cycle: m.Cycle, at: int) -> int:
        state = self._at(cycle)
        return at if state is None else state.at

    def _header(self, at: int, frame: str) -> types.Header:
        return types.Header(stamp_of(at), self._prefix + frame)

    def _on_map(self, at: int) -> types.Header:
        return types.Header(stamp_of(at), MAP)

    def _transform(self, at: int, parent: str, child: str, where: Pose2) -> types.TransformStamped:
        moved = types.Transform(types.Vector3(where[0], where[1]), rotation(wrap(where[2])))
        return types.TransformStamped(
            types.Header(stamp_of(at), parent), self._prefix + child, moved
        )

    def _sonar_frame(self, where: tuple[float, float, float]) -> str:
        """A sonar's frame, by its ring (front or rear) and its bearing."""
        row = "sonar" if where[0] >= 0.0 else "sonar_rear"
        name = f"{row}_{round(math.degrees(where[2]))}"
        same = sum(frame.partition(".")[0] == name for frame in self._sonars.values())
        return f"{name}.{same + 1}" if same else name

    def _channel(self, topic: _Topic) -> Channel:
        name, kind, depth, latched, own = topic
        return Channel(
            name if name.startswith("/") else f"/{self._prefix}{name}",
            "cdr",
            cdr.ros_name(kind),
            "ros2msg",
            cdr.definition(kind),
            latched,
            depth,
            own,
            {"offered_qos_profiles": _qos(latched, depth), "topic_type_hash": cdr.type_hash(kind)},
        )


_M = TypeVar("_M", Obstacles, LocalMap)


def _fresh(known: dict[str, _M], cycle: m.Cycle) -> list[_M]:
    """The messages of sensors whose cycle is at most `FRESH_CYCLES` from a cycle."""
    return [
        each
        for _, each in sorted(known.items())
        if each.cycle.epoch == cycle.epoch and abs(each.cycle.number - cycle.number) <= FRESH_CYCLES
    ]


def _covariance(known: Sequence[float]) -> list[float]:
    """The 6 x 6 covariance by rows, from the upper triangle for x, y and yaw."""
    whole = [0.0] * 36
    if len(known) == COVARIANCE:
        pairs = ((0, 0), (0, 1), (0, 5), (1, 1), (1, 5), (5, 5))
        for (row, column), value in zip(pairs, known, strict=True):
            whole[6 * row + column] = whole[6 * column + row] = value
    return whole


_INFINITE: Final = "sec: 9223372036\n    nsec: 854775807"


def _qos(latched: bool, depth: int) -> str:
    """Quality of service as rosbag2 up to version 8 writes it: YAML with rmw's numbers."""
    return (
        f"- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {1 if latched else 2}\n"
        f"  deadline:\n    {_INFINITE}\n  lifespan:\n    {_INFINITE}\n  liveliness: 1\n"
        f"  liveliness_lease_duration:\n    {_INFINITE}\n"
        "  avoid_ros_namespace_conventions: false"
    )
