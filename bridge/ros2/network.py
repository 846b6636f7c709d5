"""Simulated robots as nodes of a ROS 2 network: `armadico sim jackal --ros2`."""

from __future__ import annotations

import secrets
from contextlib import ExitStack
from urllib.parse import urlsplit

from armadico.bridge.ros2 import addresses
from armadico.bridge.ros2.graph import resolve
from armadico.bridge.ros2.profile import Ros2Robot
from armadico.bridge.ros2.simulated_line import Ros2Line


def node(address: str, robot: str, namespace: str | None) -> str:
    """The full name of a new robot's node; `namespace` is that of a further robot.

    Raises ValueError.
    """
    within = addresses.read_address(address).namespace if namespace is None else namespace
    kind = "".join(c if c.isascii() and c.isalnum() else "_" for c in robot)
    return resolve(within, f"sim_{kind}_{secrets.token_hex(3)}")


def beside(address: str, namespace: str) -> str:
    """The address of another robot in the same network."""
    parts = urlsplit(address)
    if parts.scheme == "ros2":
        return parts._replace(netloc=namespace, path="").geturl()
    return parts._replace(path=f"/{namespace}").geturl()


def line(address: str, profile: Ros2Robot, name: str, stack: ExitStack) -> Ros2Line:
    """The line of the robot whose node has this name, closed by `stack`.

    Raises ValueError or OSError.
    """
    transport = addresses.robot_transport(address, name.rpartition("/")[2])
    made = Ros2Line(transport, profile.ros2)
    stack.callback(made.close)
    return made
