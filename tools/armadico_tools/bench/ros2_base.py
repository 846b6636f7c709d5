"""A base of real ROS 2 without a watchdog, for `rolling`: it drives at the last `cmd_vel` for ever.

It shares no code with the project. It prints its true way, m, and speed, m/s, each 20 ms. To be run
by an interpreter that has rclpy; ends with SIGTERM.
"""

from __future__ import annotations

import signal
import sys
import time
from typing import Any

STEP_S = 0.02
ACCEL = 2.5  # m/s^2: the motors', not a ramp
LATE = 2  # steps until a command has an effect


def main() -> None:
    # Here, since the rest of the project lives without ROS.
    import rclpy  # type: ignore[import-not-found]
    from geometry_msgs.msg import TwistStamped  # type: ignore[import-not-found]
    from nav_msgs.msg import Odometry  # type: ignore[import-not-found]
    from rclpy.signals import SignalHandlerOptions  # type: ignore[import-not-found]

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("base_without_watchdog")
    odoms = node.create_publisher(Odometry, "odom", 10)
    orders = [0.0] * LATE
    way = speed = 0.0
    count = 0

    def obey(message: Any) -> None:
        orders[-1] = message.twist.linear.x

    def step() -> None:
        nonlocal way, speed, count
        count += 1
        orders[:] = [*orders[1:], orders[-1]]
        change = ACCEL * STEP_S
        speed += max(-change, min(change, orders[0] - speed))
        way += speed * STEP_S
        sys.stdout.write(f"[{way}, {speed}]\n")
        sys.stdout.flush()
        if count % 3 == 0:
            message, at = Odometry(), time.time()
            message.header.stamp.sec, message.header.stamp.nanosec = int(at), int(at % 1 * 1e9)
            message.header.frame_id, message.child_frame_id = "odom", "base_footprint"
            message.pose.pose.position.x = way
            message.pose.pose.orientation.w = 1.0
            message.twist.twist.linear.x = speed
            odoms.publish(message)

    node.create_subscription(TwistStamped, "cmd_vel", obey, 10)
    node.create_timer(STEP_S, step)
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ended.append(number))
    while not ended:
        rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == "__main__":
    main()
