"""A small robot of real ROS 2, which shares no code with the project, and its oddities.

A differential drive in a rectangular room with a pillar: its own kinematics and ray casting. It
reads `cmd_vel`, and publishes `odom` and `scan`. The rays are taken one after another while it
moves. To be run by an interpreter that has rclpy; prints its true pose as JSON lines until it is
terminated.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import LaserScan

STEP_S, TURN_S, REACH_M = 0.02, 0.2, 8.0
ROOM = (0.0, 0.0, 4.0, 3.0)  # m: x and y of two corners
PILLAR = (2.0, 2.4, 0.2)  # m: x, y and radius
LATE_ODOM_S, LATE_SCAN_S = 0.03, 0.15


class Base:
    """True pose, odometry, and the commanded speeds."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.pose = [*options.start[:2], math.radians(options.start[2])]
        self.odometry = [0.0, 0.0, 0.0]
        self.ordered, self.speeds = (0.0, 0.0), [0.0, 0.0]
        self.trail: list[tuple[float, ...]] = []

    def step(self, now: float) -> None:
        share = self.options.share
        for axis, (order, most, step) in enumerate(
            zip(self.ordered, (0.22, 2.84), (2.5 * STEP_S, 12.0 * STEP_S), strict=True)
        ):
            change = share * max(-most, min(most, order)) - self.speeds[axis]
            self.speeds[axis] += max(-step, min(step, change))
        v, w = self.speeds
        before = self.pose[:]
        for at in (self.pose, self.odometry):
            heading = at[2] + 0.5 * w * STEP_S
            at[0] += v * STEP_S * math.cos(heading)
            at[1] += v * STEP_S * math.sin(heading)
            at[2] += w * STEP_S
        if not self.is_free():
            self.pose[:2] = before[:2]
        self.trail = [*self.trail[-80:], (now, *self.pose)]

    def is_free(self) -> bool:
        x, y, _ = self.pose
        left, low, right, high = ROOM
        aside = min(x - left, y - low, right - x, high - y)
        return min(aside, math.hypot(x - PILLAR[0], y - PILLAR[1]) - PILLAR[2]) > 0.1

    def ranges(self, times: np.ndarray, bearings: np.ndarray) -> np.ndarray:
        """The range of a ray at each time, s, and bearing, rad; infinite beyond the reach."""
        trail = np.array(self.trail)
        x, y, theta = (np.interp(times, trail[:, 0], trail[:, k]) for k in (1, 2, 3))
        x, y = x - 0.032 * np.cos(theta), y - 0.032 * np.sin(theta)  # where the laser is
        dx, dy = np.cos(theta + bearings), np.sin(theta + bearings)
        with np.errstate(divide="ignore"):
            to_x = np.where(dx > 0.0, ROOM[2] - x, ROOM[0] - x) / dx
            to_y = np.where(dy > 0.0, ROOM[3] - y, ROOM[1] - y) / dy
        along = (PILLAR[0] - x) * dx + (PILLAR[1] - y) * dy
        off = (PILLAR[0] - x) ** 2 + (PILLAR[1] - y) ** 2 - along**2
        inside = PILLAR[2] ** 2 - off
        pillar = np.where((inside > 0.0) & (along > 0.0), along - np.sqrt(np.abs(inside)), np.inf)
        found = np.minimum(np.minimum(to_x, to_y), pillar)
        return np.where(found < REACH_M, found, np.inf)


def main() -> None:
    """Run until SIGTERM."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--start", nargs=3, type=float, default=(1.0, 1.0, 0.0))
    parser.add_argument("--share", type=float, default=1.0, help="of the commanded speeds")
    parser.add_argument("--twist", action="store_true", help="read Twist, not TwistStamped")
    parser.add_argument("--no-speeds", action="store_true", help="a twist of 0 in the odometry")
    parser.add_argument("--clockwise", action="store_true", help="a negative angle_increment")
    parser.add_argument("--rays", choices=("360", "vary"), default="360", help="vary: 0 to 461")
    run(parser.parse_args())


def run(options: argparse.Namespace) -> None:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node, base = rclpy.create_node("some_base"), Base(options)
    kind = Twist if options.twist else TwistStamped

    def obey(message: Twist | TwistStamped) -> None:
        twist = message if options.twist else message.twist
        base.ordered = twist.linear.x, twist.angular.z

    node.create_subscription(kind, "cmd_vel", obey, 10)
    odoms = node.create_publisher(Odometry, "odom", 10)
    scans = node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
    waiting: list[tuple[float, object, object]] = []
    count = 0

    def step() -> None:
        nonlocal count
        now, count = time.time(), count + 1
        base.step(now)
        if count % 3 == 0:
            waiting.append((now + LATE_ODOM_S, odoms, odometry(base, now)))
        if count % 10 == 0 and count > 12:
            waiting.append((now + LATE_SCAN_S, scans, scan(base, now, count // 10)))
        if count % 10 == 0:
            x, y, theta = base.pose
            truth = {"x": x, "y": y, "degrees": math.degrees(theta)}
            sys.stdout.write(json.dumps(truth) + "\n")
            sys.stdout.flush()
        for each in [each for each in waiting if each[0] <= now]:
            waiting.remove(each)
            each[1].publish(each[2])

    node.create_timer(STEP_S, step)
    # It leaves in order: others would count a robot that just disappears for another 20 s.
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ended.append(number))
    while not ended:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()


def stamp(header: object, at: float) -> None:
    header.stamp.sec, header.stamp.nanosec = int(at), int(at % 1.0 * 1e9)


def odometry(base: Base, now: float) -> Odometry:
    message = Odometry()
    stamp(message.header, now)
    message.header.frame_id, message.child_frame_id = "odom", "base_footprint"
    x, y, theta = base.odometry
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z = math.sin(theta / 2)
    message.pose.pose.orientation.w = math.cos(theta / 2)
    if not base.options.no_speeds:
        message.twist.twist.linear.x, message.twist.twist.angular.z = base.speeds
    return message


def scan(base: Base, end: float, number: int) -> LaserScan:
    """A scan that has just ended; the ray of the last bearing was the first one."""
    message = LaserScan()
    stamp(message.header, end)
    message.header.frame_id = "base_scan"
    varying = (0, 0, 200, 459, 461)[number] if number < 5 else 447 + number * 7 % 15
    rays = varying if base.options.rays == "vary" else 360
    message.range_min, message.range_max, message.scan_time = 0.12, REACH_M, TURN_S
    if rays == 0:
        return message
    step = 2.0 * math.pi / rays
    bearings = np.arange(rays) * step
    ranges = base.ranges(end - TURN_S * np.arange(rays) / rays, bearings)
    first, last = 0.0, float(bearings[-1])
    if base.options.clockwise:
        first, last, step, ranges = last, first, -step, ranges[::-1]
    message.angle_min, message.angle_max, message.angle_increment = first, last, step
    message.time_increment = TURN_S / rays
    message.ranges = ranges.astype(np.float32).tolist()
    return message


if __name__ == "__main__":
    main()
