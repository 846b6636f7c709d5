"""A viewer on real ROS 2: subscribes like RViz, and sends goals.

Run it with an interpreter that has rclpy. It writes received samples as JSON lines to stdout. A
line on stdin is a goal, `X Y`; the end of stdin ends it.
"""

from __future__ import annotations

import json
import select
import sys

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, PointCloud2, Range

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
READ = {
    "odom": (Odometry, 10, lambda m: m.pose.pose.position.x),
    "pose": (PoseWithCovarianceStamped, 10, lambda m: m.pose.covariance[35]),
    "sonar": (Range, qos_profile_sensor_data, lambda m: m.range),
    "obstacles": (PointCloud2, qos_profile_sensor_data, lambda m: m.width),
    "map": (OccupancyGrid, LATCHED, lambda m: m.info.width),
    "local_map": (OccupancyGrid, LATCHED, lambda m: max(m.data)),
    "path": (Path, LATCHED, lambda m: len(m.poses)),
    "battery_state": (BatteryState, 10, lambda m: m.voltage),
}


def report(**event) -> None:
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def main() -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("viewer", namespace=sys.argv[1] if len(sys.argv) > 1 else "")
    goals = node.create_publisher(PoseStamped, "goal_pose", 10)
    for topic, (kind, quality, value) in READ.items():

        def on_message(message, topic=topic, value=value) -> None:
            stamp = message.header.stamp
            frame = message.header.frame_id
            report(topic=topic, frame=frame, at=[stamp.sec, stamp.nanosec], value=value(message))

        node.create_subscription(kind, topic, on_message, quality)
    report(ready=True)
    goal = None
    while True:
        rclpy.spin_once(node, timeout_sec=0.02)
        if goal is not None:
            goals.publish(goal)  # repeated, because subscribers may not be matched yet
        if not select.select([sys.stdin], [], [], 0)[0]:
            continue
        line = sys.stdin.readline()
        if not line:
            break
        goal = PoseStamped()
        goal.header.frame_id = "map"
        goal.pose.position.x, goal.pose.position.y = map(float, line.split())
    while len(node.get_node_names()) < 2:  # node names are discovered later than topics
        rclpy.spin_once(node, timeout_sec=0.02)
    nodes = [
        f"{namespace.rstrip('/')}/{name}"
        for name, namespace in node.get_node_names_and_namespaces()
    ]
    report(nodes=sorted(nodes))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
