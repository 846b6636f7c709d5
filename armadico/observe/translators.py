"""Translators: messages converted to the formats of other tools, in recordings.

A translator is installed by name as an entry point of `armadico.translators`. It converts messages
and times to samples. Each sample belongs to a channel, which defines its type and encoding. The
recorder and the export use all installed translators.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

from armadico.core.discovery import TRANSLATORS, find
from armadico.core.installed import loaded

if TYPE_CHECKING:
    from armadico.config.worlds import World
    from armadico.core.messages import Message


@dataclass(frozen=True)
class Channel:
    """Samples of one type on one topic."""

    topic: str  # in the other tools: "/odom"
    encoding: str  # of the samples: "cdr"
    schema: str  # the name of the type: "nav_msgs/msg/Odometry"
    schema_encoding: str  # the format of its definition: "ros2msg"
    definition: str  # of the type and its parts
    latched: bool = False  # new readers receive the last sample
    depth: int = 10  # samples kept for slow readers
    own: bool = False  # a robot of the same middleware publishes this itself
    metadata: Mapping[str, str] = field(default_factory=dict, hash=False)


class Sample(NamedTuple):
    """One sample and its channel."""

    channel: Channel
    data: bytes


class Translator(Protocol):
    kinds: Sequence[type[Message]]  # messages that it converts
    channels: Sequence[Channel]  # all channels that it may use
    profile: str  # of an MCAP file with its samples only
    about: Mapping[str, Mapping[str, str]]  # metadata of such a file

    def translate(self, key: str, message: Message, at: int) -> Iterable[Sample]:
        """The samples of a message that was received at `at`, ns since 1970."""


class Makes(Protocol):
    """The type of an entry point."""

    def __call__(self, namespace: str = "", world: World | None = None) -> Translator:
        """A translator for a robot.

        The namespace is before its topics and frames; empty for a single robot. The walls of
        `world` are the map until the robot makes one.
        """


def translators(
    namespaces: Sequence[str], worlds: Mapping[str, World | None] | None = None
) -> dict[str, list[Translator]]:
    """All installed translators, by namespace; topics of a single robot have no prefix."""
    return _made([make for _, make in loaded(TRANSLATORS)], namespaces, worlds or {})


def translator(
    name: str, namespaces: Sequence[str], world: World | None = None
) -> dict[str, list[Translator]]:
    """The translator of a name, by namespace. Raises UnknownNameError and ImportError."""
    return _made([find(TRANSLATORS, name).load()], namespaces, dict.fromkeys(namespaces, world))


def _made(
    makers: Sequence[Makes], namespaces: Sequence[str], worlds: Mapping[str, World | None]
) -> dict[str, list[Translator]]:
    single = len(namespaces) == 1
    return {
        ns: [make("" if single else ns, worlds.get(ns)) for make in makers] for ns in namespaces
    }
