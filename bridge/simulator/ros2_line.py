"""A simulated robot among ROS 2's nodes: everybody may read what it publishes, and drive it."""

from __future__ import annotations

from msgspec.structs import replace

from armadico.bridge.ros2 import types
from armadico.bridge.ros2.frames import Wanted, Wants, said
from armadico.bridge.ros2.profile import Ros2
from armadico.bridge.ros2.samples import SampleTransport
from armadico.bridge.ros2.session import wanted, wants


def published(ros2: Ros2) -> tuple[Wanted, ...]:
    """All that a client may want of the robot: also what ours does without, for others look."""
    others = () if ros2.tf is None else (wanted(ros2.tf, types.TFMessage),)
    return (*wants(ros2).topics, *others)


class Ros2Line:
    """The robot's end of a network of samples, for as long as it lives: a `Line`.

    To the robot it is one client, there from the start, who wants everything: whoever reads it out
    there, the robot publishes, as real ones do.
    """

    def __init__(self, transport: SampleTransport, ros2: Ros2) -> None:
        """Join. Raises OSError if that cannot be."""
        topics = published(ros2)
        self._transport = transport
        self._transport.open()
        self._transport.want([replace(topic, writes=not topic.writes) for topic in topics])
        self._begins = said(Wants(topics))

    def read(self, timeout_s: float) -> bytes:
        begins, self._begins = self._begins, b""
        return begins or self._transport.read(timeout_s)

    def write(self, data: bytes) -> None:
        self._transport.write(data)

    def hang_up(self) -> bool:
        """Nobody can be hung up on."""
        return False

    def close(self) -> None:
        self._transport.close()
