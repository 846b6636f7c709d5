"""The tools that the assistant agent offers to programs and language models.

The server of programs and the agent read this table. The server answers a tool that only reads,
after the agent has recorded the request. The agent executes all other tools, or refuses them.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Final

from msgspec import Meta, Struct

from armadico.config.named import Degrees, Metres
from armadico.core.discovery import REHEARSALS, installed

PlaceName = Annotated[str, Meta(max_length=60)]
WaitS = Annotated[float, Meta(ge=0, le=600)]
Reason = Annotated[str, Meta(max_length=200)]


class Nothing(Struct, frozen=True, forbid_unknown_fields=True):
    """No arguments."""


class Goal(Struct, frozen=True, forbid_unknown_fields=True):
    """A place by its name, or a pose: m, and degrees counter-clockwise from the x axis.

    The server looks a name up before it passes the request on, so that the agent judges a pose.
    """

    place: PlaceName = ""
    x: Metres | None = None
    y: Metres | None = None
    heading: Degrees | None = None  # None: in the direction from the robot to the place
    wait_s: WaitS = 0.0  # how long to wait for the end; the server does


class Trial(Struct, frozen=True, forbid_unknown_fields=True):
    """What is rehearsed: a way to a place as with `goto`, or a mission; else the present goal."""

    place: PlaceName = ""
    x: Metres | None = None
    y: Metres | None = None
    heading: Degrees | None = None
    mission: Annotated[str, Meta(max_length=128)] = ""
    samples: Annotated[int, Meta(ge=1, le=16)] = 4


class Waiting(Struct, frozen=True, forbid_unknown_fields=True):
    """How long to wait for the end of the goal that was ordered last, s."""

    wait_s: WaitS = 30.0


class More(Struct, frozen=True, forbid_unknown_fields=True):
    """`more`: everything that is known, instead of a short answer."""

    more: bool = False


class Because(Struct, frozen=True, forbid_unknown_fields=True):
    reason: Reason = ""


class Named(Struct, frozen=True, forbid_unknown_fields=True):
    """The name of a mission that comes with Armadico."""

    name: Annotated[str, Meta(min_length=1, max_length=128)]


class Polled(Struct, frozen=True):
    """A question of the server: what has become of a request that waits for a person?"""

    number: Annotated[str, Meta(pattern=r"^[0-9]{1,19}$")]
    gone: bool = False  # none: the client is gone, or has withdrawn the request


class Numbered(Struct, frozen=True, forbid_unknown_fields=True):
    """The number of a goal or a mission, as text, since JSON's numbers have too few digits.

    Without a number it is the goal that was ordered last.
    """

    number: Annotated[str, Meta(pattern=r"^[0-9]{0,19}$")] = ""


class Subject(Enum):
    STANDING = "standing"
    NOW = "now"


class Why(Struct, frozen=True, forbid_unknown_fields=True):
    """`standing`: why the robot stands; `now`: which agent drives, and what the others would do."""

    what: Subject = Subject.STANDING
    more: bool = False


class Last(Struct, frozen=True, forbid_unknown_fields=True):
    """How many of the last lines."""

    lines: Annotated[int, Meta(ge=1, le=200)] = 8
    more: bool = False


class Tool(Struct, frozen=True):
    """A tool; `does` is false if it only reads."""

    name: str
    what: str
    arguments: type[Struct] = Nothing
    does: bool = False


REHEARSE: Final = Tool(
    "rehearse",
    "What would happen, driven virtually before the robot moves: does it arrive, when, how near to"
    " walls, and what is not known",
    Trial,
)

TOOLS: Final = {
    tool.name: tool
    for tool in (
        *((REHEARSE,) if installed(REHEARSALS) else ()),
        Tool("where", "The robot's pose, speed, driving agent, goal, battery and stop", More),
        Tool("places", "The places that `goto` knows by name, with their poses", More),
        Tool("map", "The world's size and the picture of it; with `more` in letters, 3 kB", More),
        Tool("who", "The agents that are alive: host, what they provide, what they hold", More),
        Tool(
            "why",
            "Why the robot stands, or which agent drives now and why, as a chain of reasons",
            Why,
        ),
        Tool("history", "What has happened: exchanges, stops, requests, the agents' lines", Last),
        Tool(
            "missions",
            "Missions that can be ordered, and those that were, with their states",
            More,
        ),
        Tool(
            "goto",
            "Send the robot to a place by name, or to x and y; with `wait_s` the answer says how it"
            " ended. Refused while it is stopped, or driving for another client",
            Goal,
            does=True,
        ),
        Tool("wait", "Wait until the goal that was ordered last has ended, and say how", Waiting),
        Tool("mission", "Order a mission by its name, at the lowest priority", Named, does=True),
        Tool(
            "cancel",
            "Cancel your goal, or a mission by its number; the robot brakes, and is not stopped",
            Numbered,
            does=True,
        ),
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
