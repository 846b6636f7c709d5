"""A robot of real ROS 2: publishes odometry and a scan, and reports the commands that it receives.

To be run by an interpreter that has rclpy. Events are JSON lines on the standard output. What comes
on the standard input: a line `quiet` has it publish no more, `speak` again, any other ends it.
"""

from __future__ import annotations

import argparse
import json
import select
import sys

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, LaserScan, Range

PERIOD_S = 0.02


def report(**event) -> None:
    """Report an event to the test."""
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Be the robot."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--namespace", default="")
    parser.add_argument("--best-effort", action="store_true", help="what it publishes")
    parser.add_argument("--latched", action="store_true", help="QoS for commands")
    parser.add_argument("--x", type=float, default=0.0)
    args = parser.parse_args()
    rclpy.init(args=[])
    node = rclpy.create_node("robot", namespace=args.namespace)
    sent = QoSProfile(depth=10)
    if args.best_effort:
        sent.reliability = ReliabilityPolicy.BEST_EFFORT
    read = QoSProfile(depth=10)
    if args.latched:
        read.durability = DurabilityPolicy.TRANSIENT_LOCAL
    odom = node.create_publisher(Odometry, "odom", sent)
    scan = node.create_publisher(LaserScan, "scan", sent)
    sonar = node.create_publisher(Range, "sonar", sent)
    battery = node.create_publisher(BatteryState, "battery_state", 1)

    def on_command(message) -> None:
        report(v=message.twist.linear.x, w=message.twist.angular.z)

    node.create_subscription(TwistStamped, "cmd_vel", on_command, read)

    count, quiet = 0, False

    def tick() -> None:
        nonlocal count
        count += 1
        if quiet:
            return
        message = Odometry()
        message.header.stamp = node.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        message.pose.pose.position.x = args.x
        message.twist.twist.linear.x = 0.125
        odom.publish(message)
        if count % 10 == 0:
            rays = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 2.0}
            message = LaserScan(header=message.header, range_max=30.0, ranges=[1.0, 2.5], **rays)
            scan.publish(message)
            message.header.frame_id = "sonar_3"
            sonar.publish(Range(header=message.header, max_range=5.0, range=1.5))
            battery.publish(BatteryState(voltage=12.5))

    node.create_timer(PERIOD_S, tick)
    report(ready=True)
    while True:
        rclpy.spin_once(node, timeout_sec=0.1)
        if select.select([sys.stdin], [], [], 0)[0]:
            word = sys.stdin.readline().strip()
            if word not in {"quiet", "speak"}:
                break
            quiet = word == "quiet"
    report(
        nodes=sorted(
            f"{ns.rstrip('/')}/{name}" for name, ns in node.get_node_names_and_namespaces()
        )
    )
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
