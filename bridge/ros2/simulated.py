"""A simulated robot that speaks ROS 2: what its base publishes, and how it obeys; sans-IO.

It publishes those of its topics that the client reads (`frames.Wants`), each at its rate, driven or
not. A command takes effect after a latency, and until the watchdog's timeout after the last one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from math import copysign, cos, inf, isfinite, nan, radians, sin, trunc

from pycdr2 import IdlStruct

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode, encode
from armadico.bridge.ros2.frames import WANTS, Decoder, Seen, Wants, control_frame, frame, read
from armadico.bridge.ros2.geometry import rotation
from armadico.bridge.ros2.profile import Ros2Robot, Topic
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.simulated import Controller, SimulatedRobot
from armadico.mobile.geometry import Pose2

IDLE_S = 10.0
"""A client that reads no topic for so long is disconnected."""

BATTERY_HZ = 1.0
HAZARDS_HZ = 20.0


class Base(Controller):
    """The base of a simulated robot.

    A laser's scan is taken in one instant, which is its stamp.
    """

    def __init__(self, profile: Ros2Robot, plant: Plant, name: str, clock_s: float = 0.0) -> None:
        super().__init__(plant)
        self.decoder = Decoder()  # of the client's frames
        self.clock_s = clock_s  # its clock at the start of the simulation; stamps count from there
        self._profile, self._ros2 = profile, profile.ros2
        self._name = name
        self._wanted: frozenset[str] = frozenset()
        self._received_at = 0  # this and all times below in steps of the plant
        self._latency = round(profile.ros2.latency_s / plant.step_s)
        watchdog_s = profile.ros2.watchdog_s
        self._patience = inf if watchdog_s is None else round(watchdog_s / plant.step_s)
        self._commands: deque[tuple[int, float, float]] = deque()  # step of effect, m/s, rad/s
        self._set = (0.0, 0.0)
        self._trips: float = inf  # step at which the watchdog trips
        self._odom: deque[tuple[float, ...]] = deque()
        rates: list[tuple[Topic | None, float, Callable[[], IdlStruct | None]]] = [
            (profile.ros2.odom, profile.ros2.odom_hz, self._odometry),
            (profile.ros2.tf, profile.ros2.odom_hz, self._transforms),
            (profile.ros2.battery, BATTERY_HZ, self._battery),
            (profile.ros2.hazards, HAZARDS_HZ, self._hazards),
        ]
        self._pings = 0
        if profile.sonar is not None:
            order = profile.sonar.firing_order
            topics = profile.ros2.sonar
            turn_hz = 1.0 / (profile.sonar.period_s * len(order))
            if len(topics) == 1:
                rates.append((topics[0], turn_hz * len(order), partial(self._range, order)))
            else:
                rates += [(topics[i], turn_hz, partial(self._range, (i,))) for i in order]
        if profile.laser is not None:
            rates.append((profile.ros2.scan, profile.laser.rate_hz, self._scan))
        self._topics = [
            (topic.name, rate_hz * plant.step_s, make) for topic, rate_hz, make in rates if topic
        ]
        self._counts = [0] * len(self._topics)  # of messages published

    @property
    def is_open(self) -> bool:
        """Whether a client reads any topic."""
        return bool(self._wanted)

    @property
    def hangs_up(self) -> bool:
        """Whether to disconnect the client; never one that reads topics."""
        silent = self._now - self._received_at
        return not self._wanted and silent >= round(IDLE_S / self._plant.step_s)

    def receive(self, data: bytes) -> None:
        """Process the client's frames, at the time reached; invalid ones are ignored."""
        for topic, payload in self.decoder.feed(data, self.time_s):
            self._received_at = self._now
            try:
                if topic == WANTS:
                    self._want(read(payload, Wants))
                elif topic == self._ros2.cmd_vel.name:
                    self._command(payload)
            except ValueError:
                continue

    def go_on(self, v: float, w: float) -> None:
        self._set = v, w
        self._trips = self._now + self._patience

    def disconnect(self) -> None:
        """Forget the client, which is gone or a new one. The watchdog stops the robot."""
        self.decoder = Decoder()
        self._wanted = frozenset()
        self._received_at = self._now
        self._out.clear()

    def _want(self, wants: Wants) -> None:
        mine = [topic.name for topic in self._ros2.topics]
        self._wanted = frozenset(
            wanted.topic for wanted in wants.topics if not wanted.writes and wanted.topic in mine
        )
        self._counts = [int(self._now * per_step) for _, per_step, _ in self._topics]
        self._out += control_frame(Seen(robot=self._name))
        static = self._ros2.tf_static
        if static is not None and static.name in self._wanted:
            self._out += frame(static.name, encode(self._mounted()))

    def _command(self, payload: bytes) -> None:
        if self._ros2.stamped:
            twist = decode(types.TwistStamped, payload).twist
        else:
            twist = decode(types.Twist, payload)
        v, w = twist.linear.x, twist.angular.z
        if isfinite(v) and isfinite(w):
            most, most_w = self._profile.limits.v_max, self._profile.limits.w_max
            v, w = min(max(v, -most), most), min(max(w, -most_w), most_w)
            v, w = _whole(v, self._ros2.v_step), _whole(w, self._ros2.w_step)
            self._commands.append((self._now + self._latency, v, w))

    def _next_report(self) -> int:
        return min(
            (
                -int(-(count + 1) // per_step)
                for (name, per_step, _), count in zip(self._topics, self._counts, strict=True)
                if name in self._wanted
            ),
            default=self._now + 1,
        )

    def _next_event(self, until: int) -> int:
        """The step until which there is only motion."""
        if self._wanted:
            until = min(until, max(self._next_report(), self._now + 1))
        if self._commands:
            until = min(until, max(self._commands[0][0], self._now + 1))
        if self._now < self._trips < until:
            until = int(self._trips)
        return until

    def _move(self, steps: int) -> None:
        if self._trips <= self._now:
            self._set, self._trips = (0.0, 0.0), inf
        v, w = self._set
        self._plant.run(steps, lambda _v, _w: (v, w))

    def _report(self) -> None:
        """Obey the commands that are due, and publish the topics that are due, once."""
        while self._commands and self._commands[0][0] <= self._now:
            _, *speeds = self._commands.popleft()
            self._set = (speeds[0], speeds[1])
            self._trips = self._now + self._patience
        for index, (name, per_step, make) in enumerate(self._topics):
            due = int(self._now * per_step + 1e-9)
            if due > self._counts[index]:
                self._counts[index] = due
                if name in self._wanted and (message := make()) is not None:
                    self._out += frame(name, encode(message))

    def _stamp(self, steps: float = 0.0) -> types.Time:
        sec, rest = divmod(self.clock_s + (self._now + steps) * self._plant.step_s, 1.0)
        return types.Time(sec=int(sec), nanosec=min(int(rest * 1e9 + 0.5), 999_999_999))

    def _odometry(self) -> types.Odometry:
        plant, ros2 = self._plant, self._ros2
        x, y, theta = plant.odometry
        return types.Odometry(
            header=types.Header(stamp=self._stamp(), frame_id=ros2.odom_frame),
            child_frame_id=ros2.base_frame,
            pose=types.PoseWithCovariance(
                pose=types.Pose(
                    position=types.Point(x=x, y=y),
                    orientation=rotation(theta),
                )
            ),
            twist=types.TwistWithCovariance(
                twist=types.Twist(linear=types.Vector3(x=plant.v), angular=types.Vector3(z=plant.w))
            ),
        )

    def _transforms(self) -> types.TFMessage:
        ros2 = self._ros2
        moved = self._transform(ros2.odom_frame, ros2.base_frame, self._plant.odometry)
        return types.TFMessage(transforms=[moved])

    def _mounted(self) -> types.TFMessage:
        """The poses of its sensors, published once."""
        base, ring, laser = self._ros2.base_frame, self._profile.sonar, self._profile.laser
        sonars = () if ring is None else ring.sonars
        found = [self._transform(base, sonar.frame or "", sonar.place) for sonar in sonars]
        if laser is not None:
            found.append(self._transform(base, self._ros2.laser_frame, laser.place))
            if laser.upside_down:  # half a turn about its bearing
                _, _, bearing = laser.place
                q = types.Quaternion(x=cos(0.5 * bearing), y=sin(0.5 * bearing), w=0.0)
                found[-1].transform.rotation = q
        return types.TFMessage(transforms=found)

    def _transform(self, parent: str, child: str, at: Pose2) -> types.TransformStamped:
        return types.TransformStamped(
            header=types.Header(stamp=self._stamp(), frame_id=parent),
            child_frame_id=child,
            transform=types.Transform(
                translation=types.Vector3(x=at[0], y=at[1]), rotation=rotation(at[2])
            ),
        )

    def _range(self, order: Sequence[int]) -> types.Range | None:
        """The reading of the sonar whose turn it is."""
        ring = self._profile.sonar
        assert ring is not None, "published only with sonars"
        if self._plant.sonar_readings.silent:
            return None
        index = order[self._pings % len(order)]
        self._pings += 1
        range_m = self._plant.ping(index)
        return types.Range(
            header=types.Header(stamp=self._stamp(), frame_id=ring.sonars[index].frame or ""),
            field_of_view=radians(ring.cone_deg),
            min_range=ring.min_m,
            max_range=ring.max_m,
            range=inf if range_m is None else range_m,
        )

    def _hazards(self) -> types.HazardDetectionVector:
        """The hazards since the last message: its bumper only, for there are no cliffs."""
        felt = []
        if self.time_s - self._plant.touches.pressed_s <= 1.0 / HAZARDS_HZ:
            where = types.Header(stamp=self._stamp(), frame_id="bump_front_center")
            felt.append(types.HazardDetection(header=where, type=types.BUMP))
        header = types.Header(stamp=self._stamp(), frame_id=self._ros2.base_frame)
        return types.HazardDetectionVector(header=header, detections=felt)

    def _scan(self) -> types.LaserScan | None:
        laser = self._profile.laser
        assert laser is not None, "published only with a laser"
        if self._plant.laser_readings.silent:
            return None
        first, step = radians(laser.angle_min_deg), radians(laser.step_deg)
        lasts_s = self._plant.scan_lasts_s
        late = lasts_s / self._plant.step_s if laser.stamped == "first" else 0.0
        return types.LaserScan(
            header=types.Header(stamp=self._stamp(-late), frame_id=self._ros2.laser_frame),
            angle_min=first,
            angle_max=first + step * (laser.rays - 1),
            angle_increment=step,
            time_increment=lasts_s / (laser.rays - 1),
            scan_time=1.0 / laser.rate_hz,
            range_min=laser.min_m,
            range_max=laser.max_m,
            ranges=self._plant.scan().tolist(),
        )

    def _battery(self) -> types.BatteryState:
        battery = self._plant.battery
        return types.BatteryState(
            header=types.Header(stamp=self._stamp()),
            voltage=battery.volts,
            temperature=nan,
            current=nan,
            charge=nan,
            capacity=nan,
            design_capacity=nan,
            percentage=battery.charge,
            power_supply_status=types.CHARGING if battery.charging else types.DISCHARGING,
            present=True,
        )


def _whole(speed: float, step: float) -> float:
    """The speed that a base with whole steps obeys: rounded towards zero."""
    return speed if step == 0.0 else step * trunc(speed / step + copysign(1e-6, speed))


class Ros2SimulatedRobot(SimulatedRobot):
    def __init__(
        self,
        profile: Ros2Robot,
        stage: Stage,
    ) -> None:
        """Place the robot at the stage's start; `stage.name` is its node's name."""
        plant = Plant(profile, stage.sensors, stage.site, stage.streams)
        name = stage.name or profile.name
        base = Base(profile, plant, name, stage.clock_s)
        super().__init__(plant, base, name, profile.cycle_s)
