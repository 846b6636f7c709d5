"""Translators: what a society says in the words of other people's tools, live and in recordings.

A translator is installed by name, in the entry points of `armadico.translators`. It takes messages
and the time in and gives samples out, each on a channel that says how it is to be read. Whoever
records or serves asks all that are installed, and knows none of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

from armadico.config.discovery import TRANSLATORS, find, installed

if TYPE_CHECKING:
    from armadico.config.worlds import World
    from armadico.core.messages import Message
    from armadico.mobile.messages import MissionRequest


@dataclass(frozen=True)
class Channel:
    """Samples of one type under one topic."""

    topic: str  # as the other tools have it: "/odom"
    encoding: str  # of the samples: "cdr"
    schema: str  # what the type is called: "nav_msgs/msg/Odometry"
    schema_encoding: str  # how it is defined: "ros2msg"
    definition: str  # the type's own and those within
    latched: bool = False  # who comes late is to have the last sample
    depth: int = 10  # samples that are kept for a reader who lags
    own: bool = False  # a robot that is spoken to in the same words says this by itself
    metadata: Mapping[str, str] = field(default_factory=dict, hash=False)


class Sample(NamedTuple):
    """One sample and its channel."""

    channel: Channel
    data: bytes


class Translator(Protocol):
    kinds: Sequence[type[Message]]
    """What it makes something of."""

    channels: Sequence[Channel]
    """All that it may give samples of."""

    goals: Channel
    """Where it takes goals."""

    profile: str
    """What an MCAP file that holds nothing else is called,"""

    about: Mapping[str, Mapping[str, str]]
    """and the metadata that whoever reads it looks for."""

    def translate(self, key: str, message: Message, at: int) -> Iterable[Sample]:
        """What a message comes to; it was received at `at`, ns since 1970."""

    def goal(
        self, data: bytes, encoding: str = "", schema: str = "", at: int = 0
    ) -> MissionRequest:
        """Where a sample for `goals` sends the robot; by default encoded and of the type as there.

        It was received at `at`, ns since 1970. Raises ValueError, saying why nowhere.
        """


class Makes(Protocol):
    """What an entry point leads to."""

    def __call__(self, namespace: str = "", world: World | None = None) -> Translator:
        """A translator for a robot.

        Args:
            namespace: What its topics and frames of reference begin with; empty: the only robot.
            world: Whose walls are its map until it makes one.
        """


def translators(
    namespaces: Sequence[str], worlds: Mapping[str, World | None] | None = None
) -> dict[str, list[Translator]]:
    """One of each that is installed for each namespace; the only robot has none in its topics.

    Raises ImportError saying which of them cannot be loaded.
    """
    makers: list[Makes] = [found.load() for found in installed(TRANSLATORS).values()]
    return {
        ns: [make("" if len(namespaces) == 1 else ns, (worlds or {}).get(ns)) for make in makers]
        for ns in namespaces
    }


def translator(
    name: str, namespaces: Sequence[str], world: World | None = None
) -> dict[str, list[Translator]]:
    """The same, of one that is named. Raises UnknownNameError, ImportError."""
    make: Makes = find(TRANSLATORS, name).load()
    return {ns: [make("" if len(namespaces) == 1 else ns, world)] for ns in namespaces}
