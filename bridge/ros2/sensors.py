"""What a ROS 2 robot publishes beside odometry: scans, ranges, battery, hazards; sans-IO.

All readings are reported with the odometry of their cycle, and count as of its age.
"""

from __future__ import annotations

from armadico.bridge.counting import Counts
from armadico.bridge.ros2 import types
from armadico.bridge.ros2.cdr import decode
from armadico.bridge.ros2.described import odometry_differs, scan_differs
from armadico.bridge.ros2.hazards import Hazards
from armadico.bridge.ros2.mounts import Mount, Mounting
from armadico.bridge.ros2.notices import COMPLAIN_S, Notices
from armadico.bridge.ros2.odometry import Measured
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.bridge.ros2.rangers import Rangers
from armadico.bridge.ros2.scans import Scans, UnusableScanError
from armadico.bridge.ros2.stamps import stamp_of
from armadico.bridge.ros2.trail import Trail
from armadico.bridge.session import Differs, Event, Pose, Reported, Swept
from armadico.mobile.geometry import Pose2

OLD_TURNS, OLD_CYCLES = 2.0, 2.0
"""A reading is stale if it differs from the odometry's stamp by more than both."""


class Sensors:
    """The sensors of a robot, and their readings since the last cycle."""

    def __init__(self, profile: Ros2Robot, events: list[Event], counts: Counts, now: float) -> None:
        self.notices = Notices(events)
        self.mounting = Mounting(profile.ros2, self.notices, now)
        self._profile, self._events, self._counts = profile, events, counts
        laser = profile.laser
        turn_s = 0.0 if laser is None else 1.0 / laser.rate_hz
        self._old_s = max(OLD_TURNS * turn_s, OLD_CYCLES * profile.ros2.cycle_s)
        self._scans = None if laser is None else Scans(laser, self._old_s)
        self._trail = Trail()
        self._hazards = Hazards()
        self._battery = (0.0, False)  # V, and whether it is charging
        self._rangers: Rangers | None = None
        self._compared: set[str] = set()  # topics already compared with the profile

    def begin(self, now: float) -> None:
        """Wait for the robot; earlier readings are discarded."""
        ring = self._profile.sonar
        self._rangers = None if ring is None else Rangers(ring, self._old_s, now)
        self._compared.clear()
        self._trail.begin()
        self.mounting.begin(now)
        if self._scans is not None:
            self._scans.begin()

    def receive(self, topic: str, payload: bytes, now: float) -> bool:
        """Process a message. Returns whether the topic is a sensor's. Raises ValueError."""
        ros2 = self._profile.ros2
        if ros2.scan is not None and topic == ros2.scan.name and self._scans is not None:
            self._scans.receive(payload)
        elif ros2.battery is not None and topic == ros2.battery.name:
            state = decode(types.BatteryState, payload)
            volts, status = float(state.voltage), state.power_supply_status
            self._battery = volts if 0.0 <= volts <= 1e4 else 0.0, status == types.CHARGING
        elif any(topic == each.name for each in ros2.sonar):
            self._on_range(payload, now)
        elif ros2.hazards is not None and topic == ros2.hazards.name:
            self._hazards.on_hazards(decode(types.HazardDetectionVector, payload))
        elif ros2.tf_static is not None and topic == ros2.tf_static.name:
            self.mounting.on_tf_static(decode(types.TFMessage, payload))
        else:
            return False
        return True

    def on_odometry(self, odometry: types.Odometry) -> None:
        """Compare the frames of an odometry, and adopt the one that it moves."""
        self._compare(self._profile.ros2.odom.name, odometry)
        self.mounting.move_base(odometry.child_frame_id)

    def report(self, pose: Pose, here: Measured, stamp: float, now: float) -> Reported:
        """The report of a cycle whose odometry has this stamp (s)."""
        hazards, (volts, charging) = self._hazards, self._battery
        hazards.collect()
        self._trail.add(stamp, pose, here)
        for text in hazards.texts:
            self.notices.note(text, now, COMPLAIN_S)
        return Reported(
            pose=pose,
            v=here.v,
            w=here.w,
            battery_v=volts,
            charging=charging,
            stalled=hazards.stalled,
            lifted=hazards.lifted,
            front_bumpers=hazards.ahead,
            rear_bumpers=hazards.behind,
            echoes=self._echoes(stamp, now),
            sonars=self._places(now),
            scan=self._scan(stamp, now),
        )

    def _on_range(self, payload: bytes, now: float) -> None:
        message = decode(types.Range, payload)
        if self._rangers is None:
            return
        try:
            self._rangers.on_range(message, stamp_of(payload), now)
        except ValueError as error:
            self.notices.note(f"a sonar is not heeded: {error}", now)
            raise

    def _echoes(self, stamp: float, now: float) -> tuple[tuple[int, float], ...]:
        if self._rangers is None:
            return ()
        echoes = self._rangers.collect(stamp, now)
        self.notices.report_fault("the sonars are", self._rangers.wrong, now)
        return echoes

    def _places(self, now: float) -> tuple[Pose2, ...]:
        ring = self._profile.sonar
        return tuple(
            self.mounting.mount(sonar.frame or "", Mount(sonar.place), "sonar", now).place
            for sonar in (() if ring is None else ring.sonars)
        )

    def _scan(self, stamp: float, now: float) -> Swept | None:
        scans = self._scans
        if scans is None:
            return None
        try:
            scan = scans.decode(stamp)
            if scan is not None:
                ours = Mount(scans.laser.place, scans.laser.upside_down)
                mount = self.mounting.mount(scan.header.frame_id, ours, "laser", now)
                scans.accept(scan, mount, self._trail)
                self._compare("scan", scan)
                self.notices.report_fault("the laser is", "", now)
        except UnusableScanError as error:
            self.notices.report_fault("the laser is", str(error), now)
        except ValueError as error:
            self._counts.malformed += 1
            self.notices.report_fault("the laser is", str(error), now)
        return scans.newest(stamp, self._trail)

    def _compare(self, topic: str, message: types.Odometry | types.LaserScan) -> None:
        """Report the differences between a topic's first valid message and the profile."""
        if topic in self._compared:
            return
        self._compared.add(topic)
        if isinstance(message, types.Odometry):
            found = odometry_differs(self._profile, message)
        elif self._scans is not None:
            found = scan_differs(self._profile, self._scans.laser, message)
        self._events += map(Differs, found)
