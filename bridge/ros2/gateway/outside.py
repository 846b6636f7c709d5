"""The ROS 2 side of a gateway: publishes samples, receives goals, and logs conflicts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from armadico.bridge.ros2.frames import Wanted
from armadico.bridge.ros2.graph import ODOMETRY, Endpoint
from armadico.bridge.ros2.samples import LOOK_S, SETTLE_S, Wire
from armadico.observe.translators import Channel, Sample

NODE: Final = (
    "armadico_society"  # the node's name; the robot agent of a ROS 2 robot is another node
)
BACKLOG: Final = 64  # goals of one turn; only the newest is used
SHARED: Final = ("/tf", "/tf_static", "/diagnostics")  # topics that may have several publishers


class SocietyNode:
    """One robot's society as a node."""

    def __init__(
        self,
        wire: Wire,
        channels: Sequence[Channel],
        goals: Channel | None,
        log: Callable[[str], None],
        *,
        beside: bool = False,
        settle_s: float = SETTLE_S,
    ) -> None:
        """Publish and subscribe; the caller closes the wire. Raises OSError.

        Without a channel of goals none are accepted; `log` receives lines about conflicts with
        other nodes. `beside`: the robot itself runs ROS 2, so the topics that it publishes are left
        out. A robot that publishes its odometry is detected for `settle_s` before the topics of a
        robot are published.
        """
        self._wire, self._beside, self._log = wire, beside, log
        self._channels, self._goals = channels, goals
        self._odometry = {each.topic for each in channels if each.schema == ODOMETRY}
        self._own: bool | None = None  # whether the topics of a robot are published
        self._own_at = time.monotonic() + settle_s
        self._kept: dict[str, Sample] = {}  # latched samples, by topic
        self._wanted: dict[str, Wanted] = {}
        self._known: set[str] = set()
        self._polled_at = 0.0
        self._choose(())

    def publish(self, sample: Sample) -> None:
        if sample.channel.latched:
            self._kept[sample.channel.topic] = sample
        if self._own or not sample.channel.own:
            self._wire.publish(sample.channel.topic, sample.data)

    def goals(self) -> list[bytes]:
        now = time.monotonic()
        if now - self._polled_at >= LOOK_S:
            self._polled_at = now
            self._poll()
        return [data for _, data in self._wire.receive(0.0)[-BACKLOG:]]

    def _choose(self, others: Iterable[Endpoint]) -> None:
        """Publish the topics of a robot, unless a robot publishes them itself.

        Otherwise the robot agent would read both odometries, and its pose would jump. Once a robot
        was detected, its topics are never published again, because it may return.
        """
        for other in others:
            if _is_robot(other) and other.topic in self._odometry and not self._beside:
                self._beside = True
                self._log(
                    f"{other.node} publishes {other.topic}, the odometry of a ROS 2 robot:"
                    " odometry, scan and battery are not published here (--beside)"
                )
        own = not self._beside and time.monotonic() >= self._own_at
        if own is self._own:
            return
        self._own = own
        chosen = [channel for channel in self._channels if own or not channel.own]
        self._wanted = {channel.topic: _wanted(channel, writes=True) for channel in chosen}
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
            self._log(note)
        self._known |= notes


def unfit(wanted: Sequence[Wanted], others: Iterable[Endpoint]) -> list[str]:
    """Conflicts of other nodes' endpoints with those of this node, as text."""
    by_topic = {each.topic: each for each in wanted}
    robot = any(each.writes and each.type == ODOMETRY for each in wanted)
    found = []
    for other in others:
        ours = by_topic.get(other.topic)
        if robot and _is_robot(other):
            found.append(
                f"{other.node} publishes odometry on {other.topic}; if it is a ROS 2 robot, use"
                " --beside, which leaves out the topics that the robot publishes"
            )
        elif ours is None:
            continue
        elif other.type != ours.type:
            does = "publishes" if other.writes else "subscribes to"
            found.append(f"{other.node} {does} {other.topic} as {other.type}, not as {ours.type}")
        elif other.writes and ours.writes and ours.topic not in SHARED:
            found.append(f"{other.node} also publishes {other.topic}")
        elif not other.writes and ours.writes and other.latched and not ours.latched:
            found.append(
                f"{other.node} subscribes to {other.topic} as transient local, but it is volatile:"
                " it receives nothing"
            )
    return found


def _is_robot(other: Endpoint) -> bool:
    return other.writes and other.type == ODOMETRY and not other.node.endswith(f"/{NODE}")


def _wanted(channel: Channel, *, writes: bool) -> Wanted:
    return Wanted(
        channel.topic, channel.schema, writes, latched=channel.latched, depth=channel.depth
    )
