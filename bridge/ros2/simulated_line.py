"""A simulated robot among ROS 2 nodes: any node may read its topics, and drive it."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.frames import Wanted, Wants, control_frame
from armadico.bridge.ros2.profile import Ros2
from armadico.bridge.ros2.samples import SampleTransport
from armadico.bridge.ros2.session import wanted, wants


def published(ros2: Ros2) -> tuple[Wanted, ...]:
    """All topics of the robot, also those that the robot agent does not read."""
    others = () if ros2.tf is None else (wanted(ros2.tf, types.TFMessage),)
    return (*wants(ros2).topics, *others)


class Ros2Line:
    """The robot's end of a network of samples, as long as it runs: a `Line`.

    The robot sees one permanent client that reads every topic: real robots also publish whether or
    not a node subscribes.
    """

    def __init__(self, transport: SampleTransport, ros2: Ros2) -> None:
        """Join the network. Raises OSError."""
        topics = published(ros2)
        self._transport = transport
        self._transport.open()
        self._transport.want([replace(topic, writes=not topic.writes) for topic in topics])
        self._begins = control_frame(Wants(topics))

    def read(self, timeout_s: float) -> bytes:
        begins, self._begins = self._begins, b""
        return begins or self._transport.read(timeout_s)

    def write(self, data: bytes) -> None:
        self._transport.write(data)

    def hang_up(self) -> bool:
        """Return False: there is no connection."""
        return False

    def close(self) -> None:
        self._transport.close()
