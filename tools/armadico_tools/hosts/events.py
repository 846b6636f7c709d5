"""What a watcher on one host tells a program on another machine or outside: lines of JSON.

Times are s of the watcher's own clock, and are compared with nobody else's.
"""

from __future__ import annotations

import msgspec
from msgspec import Struct


class Cycle(Struct, frozen=True, tag="cycle"):
    """The robot agent's word in a cycle: who is obeyed by now, for which cycle, and how fast."""

    at: float
    number: int
    holder: str  # an instance; empty if nobody was obeyed of late
    obeyed: int  # the number of the cycle that was answered
    v: float


class Commanded(Struct, frozen=True, tag="command"):
    """Somebody commanded the wheels, for a cycle."""

    at: float
    instance: str
    number: int


class Token(Struct, frozen=True, tag="token"):
    """An instance's liveliness token came or went."""

    at: float
    instance: str
    there: bool


class Home(Struct, frozen=True, tag="home"):
    """Which host an instance is on, by its card."""

    instance: str
    host: str


class Bidding(Struct, frozen=True, tag="bid"):
    """What an instance last thought of bidding."""

    at: float
    instance: str
    utility: float | None
    reason: str


class Mission(Struct, frozen=True, tag="mission"):
    """How far the mission has come."""

    at: float
    state: str
    to_go: float


News = Cycle | Commanded | Token | Home | Bidding | Mission

_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[News] = msgspec.json.Decoder(News)


def written(news: News) -> str:
    """One line, without its end."""
    return _ENCODER.encode(news).decode()


def read(line: str) -> News | None:
    """What a line says; None if it is none of ours."""
    try:
        return _DECODER.decode(line)
    except msgspec.DecodeError:
        return None
