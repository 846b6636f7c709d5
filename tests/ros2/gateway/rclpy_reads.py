"""Decode and encode samples with real ROS 2: JSON lines with type and bytes in, results out.

Run it with an interpreter that has rclpy.
"""

from __future__ import annotations

import importlib
import json
import sys

from rclpy.serialization import deserialize_message, serialize_message


def main() -> None:
    for line in sys.stdin:
        name, data = json.loads(line)
        package, _, kind = name.split("/")
        try:
            of = getattr(importlib.import_module(f"{package}.msg"), kind)
        except ModuleNotFoundError:
            reply = None
        else:
            message = deserialize_message(bytes.fromhex(data), of)
            frame = message.header.frame_id
            reply = {"frame": frame, "again": bytes(serialize_message(message)).hex()}
        sys.stdout.write(json.dumps(reply) + "\n")


if __name__ == "__main__":
    main()
