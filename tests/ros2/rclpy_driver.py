"""A foreign program that drives a robot: real ROS 2, which knows the namespace only.

To be run by an interpreter that has rclpy. Drives on until the robot has gone 0.2 m and its laser
and battery have been received, stops it, and prints what it saw as JSON.
"""

from __future__ import annotations

import json
import sys

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, LaserScan


def main() -> None:
    """Drive it."""
    rclpy.init(args=[])
    node = rclpy.create_node("driver", namespace=sys.argv[1])
    seen = {}
    for kind, topic in ((Odometry, "odom"), (LaserScan, "scan"), (BatteryState, "battery_state")):
        node.create_subscription(
            kind, topic, lambda m, t=topic: seen.__setitem__(t, m), qos_profile_sensor_data
        )
    commands = node.create_publisher(TwistStamped, "cmd_vel", 10)
    speed = 0.2

    def command() -> None:
        message = TwistStamped()
        message.twist.linear.x = speed
        commands.publish(message)

    node.create_timer(0.1, command)
    while len(seen) < 3 or seen["odom"].pose.pose.position.x < 0.2:
        rclpy.spin_once(node, timeout_sec=0.1)
    speed = 0.0
    while abs(seen["odom"].twist.twist.linear.x) > 1e-3:
        rclpy.spin_once(node, timeout_sec=0.1)
    while len(nodes := node.get_node_names_and_namespaces()) < 2:  # names come after topics
        rclpy.spin_once(node, timeout_sec=0.1)
    report = {
        "nodes": sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in nodes),
        "x": seen["odom"].pose.pose.position.x,
        "rays": len(seen["scan"].ranges),
        "volts": seen["battery_state"].voltage,
        "hash": str(node.get_publishers_info_by_topic(f"{sys.argv[1]}/odom")[0].topic_type_hash),
    }
    sys.stdout.write(json.dumps(report) + "\n")
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
