"""The tools that the assistant agent offers to programs and language models.

The server of programs and the agent read this table. The server answers a tool that only reads,
after the agent has recorded the request. The agent executes all other tools, or refuses them.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Final

from msgspec import Meta, Struct

from armadico.core.messages import LARGEST

Metres = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]
Reason = Annotated[str, Meta(max_length=200)]


class Nothing(Struct, frozen=True, forbid_unknown_fields=True):
    """No arguments."""


class Goal(Struct, frozen=True, forbid_unknown_fields=True):
    """A pose in the world: m, and degrees counter-clockwise from the x axis."""

    x: Metres
    y: Metres
    heading: Degrees = 0.0


class Because(Struct, frozen=True, forbid_unknown_fields=True):
    reason: Reason = ""


class Named(Struct, frozen=True, forbid_unknown_fields=True):
    """The name of a mission that comes with Armadico."""

    name: Annotated[str, Meta(min_length=1, max_length=128)]


class Numbered(Struct, frozen=True, forbid_unknown_fields=True):
    """The number of a mission on the board, as text: JSON's numbers have too few digits."""

    number: Annotated[str, Meta(pattern=r"^[0-9]{1,19}$")]


class Subject(Enum):
    STANDING = "standing"
    NOW = "now"


class Why(Struct, frozen=True, forbid_unknown_fields=True):
    """`standing`: why the robot stands; `now`: which agent drives, and what the others would do."""

    what: Subject = Subject.STANDING


class Last(Struct, frozen=True, forbid_unknown_fields=True):
    """How many of the last lines."""

    lines: Annotated[int, Meta(ge=1, le=200)] = 40


class Tool(Struct, frozen=True):
    """A tool; `does` is false if it only reads."""

    name: str
    what: str
    arguments: type[Struct] = Nothing
    does: bool = False


TOOLS: Final = {
    tool.name: tool
    for tool in (
        Tool("where", "The robot's pose, speed, driving agent, mission, battery and stop"),
        Tool("map", "The world: places by name with their poses, and a picture of it in letters"),
        Tool("who", "The agents that are alive: host, what they provide, what they hold"),
        Tool(
            "why",
            "Why the robot stands, or which agent drives now and why, as a chain of reasons",
            Why,
        ),
        Tool("history", "What has happened: exchanges, stops, requests, the agents' lines", Last),
        Tool("missions", "Missions that can be ordered, and those that were, with their states"),
        Tool(
            "goto",
            "Send the robot to a pose. Refused while it is stopped, or driving for another client",
            Goal,
            does=True,
        ),
        Tool("mission", "Order a mission by its name, at the lowest priority", Named, does=True),
        Tool("cancel", "Cancel a mission that was ordered with `mission`", Numbered, does=True),
        Tool(
            "stop",
            "Stop the robot, whichever agent drives; only people release the stop",
            Because,
            True,
        ),
        Tool(
            "resume",
            "Request people to release the stop: returns the command to type; releases nothing",
            Because,
            does=True,
        ),
    )
}
