"""What real ROS 2 makes of `samples.json`: bytes and type hashes, as JSON on the standard output.

To be run by an interpreter that has rclpy; `golden.json` is its output. `tf2_msgs` and
`irobot_create_msgs` are not among the packages that can be had: their bytes and hashes are those of
rosbags 0.11, of the latter by its `.msg` text.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import rclpy
from rclpy.serialization import serialize_message


def fill(message, values):
    """Set the fields that are given."""
    for name, value in values.items():
        slot = getattr(message, name)
        if isinstance(value, dict):
            fill(slot, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = message.get_fields_and_field_types()[name].split("<")[1].rstrip(">")
            setattr(message, name, [fill(of(kind.replace("/", "/msg/"))(), v) for v in value])
        else:
            kept = slot if isinstance(slot, (str, bool, int)) else None
            setattr(message, name, value if kept is not None else _like(slot, value))
    return message


def _like(slot, value):
    if isinstance(value, list):
        whole = type(slot).__name__ == "array" and slot.typecode in "bBhHiIlLqQ"
        return [int(v) if whole else float(v) for v in value]
    return type(slot)(value)


def of(name):
    """The class of a type."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def main() -> None:
    """Print them."""
    samples = json.loads(Path(__file__).with_name("samples.json").read_text())
    rclpy.init(args=[])
    node = rclpy.create_node("golden")
    found = {}
    for number, (name, values) in enumerate(samples.items()):
        try:
            kind = of(name)
        except ModuleNotFoundError:
            continue
        topic = f"/golden_{number}"
        node.create_publisher(kind, topic, 1)
        infos = node.get_publishers_info_by_topic(topic)
        while not infos:
            rclpy.spin_once(node, timeout_sec=0.01)
            infos = node.get_publishers_info_by_topic(topic)
        found[name] = {
            "bytes": serialize_message(fill(kind(), values)).hex(),
            "hash": str(infos[0].topic_type_hash),
        }
    json.dump(found, sys.stdout, indent=1)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
