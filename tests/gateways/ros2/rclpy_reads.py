"""Whether real ROS 2 reads samples: type and bytes as JSON lines in, what it makes of each out.

To be run by an interpreter that has rclpy. Each sample is deserialised and serialised again.
"""

from __future__ import annotations

import importlib
import json
import sys

from rclpy.serialization import deserialize_message, serialize_message


def main() -> None:
    """Read them."""
    for line in sys.stdin:
        name, data = json.loads(line)
        package, _, kind = name.split("/")
        try:
            of = getattr(importlib.import_module(f"{package}.msg"), kind)
        except ModuleNotFoundError:
            said = None
        else:
            message = deserialize_message(bytes.fromhex(data), of)
            frame = message.header.frame_id
            said = {"frame": frame, "again": bytes(serialize_message(message)).hex()}
        sys.stdout.write(json.dumps(said) + "\n")


if __name__ == "__main__":
    main()
