"""A society's samples on ROS 2, by whatever wire; goals back. What happens around it is noted."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from armadico.bridge.ros2.frames import Wanted
from armadico.bridge.ros2.graph import ODOMETRY, Endpoint
from armadico.bridge.ros2.samples import LOOK_S, SETTLE_S, Wire
from armadico.gateways.gateway import Asked
from armadico.observe.translators import Channel, Sample

NODE: Final = "armadico_society"
"""What `ros2 node list` calls it; the robot agent of a ROS 2 robot is another node."""

BACKLOG: Final = 64
"""Goals of one turn; only the newest counts."""

SHARED: Final = ("/tf", "/tf_static", "/diagnostics")
"""Topics on which many publish."""


class SocietyNode:
    """One robot's society as a node."""

    def __init__(
        self,
        wire: Wire,
        channels: Sequence[Channel],
        goals: Channel | None,
        say: Callable[[str], None],
        *,
        beside: bool = False,
        settle_s: float = SETTLE_S,
    ) -> None:
        """Publish and read; the wire is closed elsewhere. Raises OSError.

        Args:
            wire: Joined.
            channels: All that may be said.
            goals: Where goals come from; None: none are taken.
            say: Told what does not fit around here.
            beside: The robot itself speaks ROS 2: what it says by itself is left out.
            settle_s: So long is looked for a robot that publishes its odometry here, before
                anything is said that such a one says.
        """
        self._wire, self._beside, self._say = wire, beside, say
        self._channels, self._goals = channels, goals
        self._odometry = {each.topic for each in channels if each.schema == ODOMETRY}
        self._own: bool | None = None  # whether what a robot would say is said here
        self._own_at = time.monotonic() + settle_s
        self._kept: dict[str, Sample] = {}  # by topic, for who comes late
        self._wanted: dict[str, Wanted] = {}
        self._known: set[str] = set()
        self._looked_at = 0.0
        self._choose(())

    def publish(self, sample: Sample, at: int) -> None:
        del at  # it is in the sample
        if sample.channel.latched:
            self._kept[sample.channel.topic] = sample
        if self._own or not sample.channel.own:
            self._wire.publish(sample.channel.topic, sample.data)

    def asked(self) -> Iterable[Asked]:
        now = time.monotonic()
        if now - self._looked_at >= LOOK_S:
            self._looked_at = now
            self._poll()
        frames = self._wire.receive(0.0)
        return [Asked(topic, data, "cdr") for topic, data in frames[-BACKLOG:]]

    def _choose(self, others: Iterable[Endpoint]) -> None:
        """Say what a robot would say, unless there is one that says it.

        Its robot agent would read both, and believe that robot to jump to and fro. Where one has
        been, nothing of that is said any more: it may come back at any time.
        """
        for other in others:
            if _is_robot(other) and other.topic in self._odometry and not self._beside:
                self._beside = True
                self._say(
                    f"{other.node} publishes {other.topic}, the odometry of a robot that speaks"
                    " ROS 2 itself: odometry, scan and battery are left to it (--beside)"
                )
        own = not self._beside and time.monotonic() >= self._own_at
        if own is self._own:
            return
        self._own = own
        said = [channel for channel in self._channels if own or not channel.own]
        self._wanted = {channel.topic: _wanted(channel, writes=True) for channel in said}
        if self._goals is not None:
            self._wanted[self._goals.topic] = _wanted(self._goals, writes=False)
        self._wire.want(tuple(self._wanted.values()))
        for sample in self._kept.values():
            if own or not sample.channel.own:
                self._wire.publish(sample.channel.topic, sample.data)

    def _poll(self) -> None:
        others = tuple(self._wire.others())
        self._choose(others)
        notes = {
            *unfit(tuple(self._wanted.values()), others),
            *self._wire.complaints(),
        }
        for note in sorted(notes - self._known):
            self._say(note)
        self._known |= notes


def unfit(wanted: Sequence[Wanted], others: Iterable[Endpoint]) -> list[str]:
    """What of others does not fit what is said and read here, in words."""
    by_topic = {want.topic: want for want in wanted}
    robot = any(want.writes and want.type == ODOMETRY for want in wanted)
    found = []
    for other in others:
        want = by_topic.get(other.topic)
        if robot and _is_robot(other):
            found.append(
                f"{other.node} publishes {other.topic}, the odometry of a robot that speaks ROS 2"
                " itself? Then --beside leaves out what it says"
            )
        elif want is None:
            continue
        elif other.type != want.type:
            does = "publishes" if other.writes else "reads"
            found.append(f"{other.node} {does} {other.topic} as {other.type}, and not {want.type}")
        elif other.writes and want.writes and want.topic not in SHARED:
            found.append(f"{other.node} publishes {other.topic}, too")
        elif not other.writes and want.writes and other.latched and not want.latched:
            found.append(
                f"{other.node} reads {other.topic} as transient local, and it is volatile: nothing"
                " is sent to it"
            )
    return found


def _is_robot(other: Endpoint) -> bool:
    return other.writes and other.type == ODOMETRY and not other.node.endswith(f"/{NODE}")


def _wanted(channel: Channel, *, writes: bool) -> Wanted:
    return Wanted(
        channel.topic, channel.schema, writes, latched=channel.latched, depth=channel.depth
    )
