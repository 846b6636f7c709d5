"""ROS 2 by rmw_zenoh as others write it: zenoh-ros2-sdk talks and listens, pamoja-ros2 names keys.

To be run by an interpreter that has both. Events are JSON lines on the standard output; the end of
the standard input ends it.
"""

from __future__ import annotations

import json
import select
import sys
from dataclasses import asdict

from pamoja import ros2 as pamoja

DOMAIN = 5
STRING, DEFINITION = "std_msgs/msg/String", "string data\n"


def report(**event) -> None:
    """Report an event to the test."""
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Be the peer of the router at the port that is given."""
    from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, get_topic_info

    port, hashed = int(sys.argv[1]), sys.argv[2]
    where = {"router_port": port, "domain_id": DOMAIN, "msg_definition": DEFINITION}
    where |= {"type_hash": hashed, "namespace": "/tb1"}
    talker = ROS2Publisher("/tb1/talk", STRING, node_name="talker", **where)
    ROS2Subscriber(
        "/tb1/listen", STRING, lambda m: report(heard=m.data), node_name="listener", **where
    )
    report(
        key=pamoja.entity_key(DOMAIN, "/tb1/talk", STRING, hashed),
        dds=pamoja.dds_type_name("sensor_msgs/msg/LaserScan"),
        mangled=pamoja.percent_mangle("/tb1/talk"),
        twist=pamoja.twist_to_cdr((0.25, 0.0, 0.0), (0.0, 0.0, -1.5)).hex(),
        published=talker.keyexpr,
    )
    while not select.select([sys.stdin], [], [], 0.05)[0]:
        talker.publish(data="grüße")
    found = get_topic_info("/tb1/listen", DOMAIN, router_port=port, verbose=True)
    report(publishers=[asdict(each) for each in found.publishers])


if __name__ == "__main__":
    main()
