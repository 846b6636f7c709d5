"""The dashboard's colours: an agent's are those of the pictures, everything else stays out of them.

Rerun draws on black, so walls and outlines are light here.
"""

from __future__ import annotations

from typing import Final

from armadico.observe.dashboard.canvas import Colour, rgba
from armadico.observe.pictures import colour
from armadico.observe.view import agent_of

NOBODY: Final = "nobody"

BACKGROUND: Final = rgba("#0d1116")
WALL: Final = rgba("#c9d3da")
FORBIDDEN: Final = rgba("#e5484d", 170)
ROOM: Final = rgba("#7d8a94")
GRID: Final = rgba("#2c353c")
AXIS: Final = rgba("#56646e")
BODY: Final = rgba("#ffffff")
TRUTH: Final = rgba("#9be15d")
ECHO: Final = rgba("#8796a3", 150)
CONE: Final = rgba("#5d6b76", 170)
POINT: Final = rgba("#f0e442")
PARTICLE: Final = rgba("#3fd0c9", 150)
UNSURE: Final = rgba("#ffffff", 170)
"""What the pose's covariance covers."""

FRAME: Final = (rgba("#e5484d"), rgba("#7bd389"))
"""The axes of a frame of reference, x and y."""

PLAN: Final = rgba("#b9a7e0")
GOAL: Final = rgba("#ff5fa8")

MAPPED: Final = (rgba("#000000", 0), rgba("#233440"), rgba("#e8b04b"))
"""Cells of the map made by driving: unknown, free, occupied."""

ZONES: Final[dict[str, Colour]] = {
    "stop": rgba("#e5484d"),
    "danger": rgba("#ef8e3c"),
    "caution": rgba("#d9c23c"),
}

SPEEDS: Final[dict[str, Colour]] = {
    "measured": rgba("#f4f6f8"),
    "commanded": rgba("#56b4e9"),
    "wanted": rgba("#e6c84f"),
}
"""Of the wheels: what the controller measured, what was sent after blending, what was bid."""

DOCK: Final = rgba("#7bd389")
BATTERY: Final = rgba("#7bd389")
RESTED: Final = rgba("#e6c84f")


def agent(name: str | None) -> Colour:
    """An agent's colour, or that of nobody."""
    return rgba(colour(None if name == NOBODY else name))


def name_of(instance: str | None) -> str:
    """The agent of an instance, or nobody."""
    return NOBODY if instance is None else agent_of(instance)
