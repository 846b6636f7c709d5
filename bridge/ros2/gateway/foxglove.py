"""The Foxglove gateway: samples of all robots on one WebSocket server.

The samples are those of the installed translators, sent with Foxglove's SDK. A slow client loses
samples, without effect on agents and other clients.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

import foxglove
from foxglove.websocket import Capability, ServerListener

from armadico.bridge.ros2.gateway.gateway import ReceivedGoal
from armadico.observe.translators import Channel, Sample

if TYPE_CHECKING:
    from foxglove.websocket import ChannelView, Client, ClientChannel

ENCODINGS: Final = ("cdr", "json")  # of goals
WAITING: Final = 64  # goals that may wait for their gateway; further ones are dropped


class ServerError(Exception):
    """The server cannot start; the message has the reason and what to do."""


class Server(ServerListener):
    """A WebSocket server; its callbacks run on threads of the SDK."""

    def __init__(self, name: str, address: str, port: int, goals: Sequence[str]) -> None:
        """Start to listen. Raises ServerError.

        Args:
            name: Shown by viewers.
            address: To listen on; 127.0.0.1 is for programs on this machine only.
            port: A port; 0 selects a free one.
            goals: The topics that clients may publish on.
        """
        self._context = foxglove.Context()
        self._goals = frozenset(goals)
        self._channels: dict[str, foxglove.Channel] = {}
        self._advertised: dict[tuple[int, int], ClientChannel] = {}
        self._pending: list[ReceivedGoal] = []
        self._watched: list[set[str]] = []
        try:
            self._server = foxglove.start_server(
                name=name,
                host=address,
                port=port,
                capabilities=[Capability.ClientPublish] if goals else [],
                server_listener=self,
                supported_encodings=list(ENCODINGS) if goals else [],
                context=self._context,
            )
        except (RuntimeError, OverflowError, ValueError) as error:
            hint = "; --port 0 selects a free one" if "in use" in str(error) else ""
            raise ServerError(f"cannot listen on {address}, port {port}: {error}{hint}") from None

    @property
    def port(self) -> int:
        return self._server.port

    def close(self) -> None:
        """Stop listening, and disconnect all clients."""
        self._server.stop()

    def publish(self, sample: Sample, at: int) -> None:
        self._channels[sample.channel.topic].log(sample.data, log_time=at)

    def offer(self, channel: Channel) -> None:
        """Advertise a topic, once."""
        if channel.topic not in self._channels:
            self._channels[channel.topic] = self._make_channel(channel)

    def watched(self) -> set[str]:
        """A new set, to which each topic is added when a client subscribes to it."""
        self._watched.append(set())
        return self._watched[-1]

    def goals(self, topic: str) -> list[ReceivedGoal]:
        """The goals received on a topic since the last call."""
        found = [each for each in self._pending if each.topic == topic]
        for each in found:
            self._pending.remove(each)
        return found

    def _make_channel(self, what: Channel) -> foxglove.Channel:
        schema = foxglove.Schema(
            name=what.schema, encoding=what.schema_encoding, data=what.definition.encode()
        )
        return foxglove.Channel(
            what.topic,
            schema=schema,
            message_encoding=what.encoding,
            context=self._context,
            metadata=dict(what.metadata),
        )

    # On the SDK's threads -------------------------------------------------------------------------

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        del client
        for each in self._watched:
            each.add(channel.topic)

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        if channel.topic in self._goals:
            self._advertised[client.id, channel.id] = channel

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        self._advertised.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        channel = self._advertised.get((client.id, client_channel_id))
        if channel is not None and len(self._pending) < WAITING:
            self._pending.append(
                ReceivedGoal(channel.topic, data, channel.encoding, channel.schema_name)
            )


class Served:
    """One robot's `Outside`; a new subscriber receives the latched samples again."""

    def __init__(self, server: Server, channels: Iterable[Channel], goals: Iterable[str]) -> None:
        """`channels` are advertised at once; `goals` are the robot's topics."""
        self._server = server
        self._goals = tuple(goals)
        self._kept: dict[str, tuple[Sample, int]] = {}
        self._watched = server.watched()
        for channel in channels:
            server.offer(channel)

    def publish(self, sample: Sample, at: int) -> None:
        if sample.channel.latched:
            self._kept[sample.channel.topic] = sample, at
        self._server.publish(sample, at)

    def goals(self) -> list[ReceivedGoal]:
        while self._watched:
            kept = self._kept.get(self._watched.pop())
            if kept is not None:
                self._server.publish(*kept)
        return [goal for topic in self._goals for goal in self._server.goals(topic)]
