"""The dashboard's colours. Agents have the colours of the pictures; nothing else uses those.

Rerun draws on black, so walls and footprints are light.
"""

from __future__ import annotations

from typing import Final

from armadico.watch.dashboard.canvas import Colour, rgba
from armadico.watch.pictures import colour

NO_AGENT: Final = "no agent"

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
PLAN: Final = rgba("#b9a7e0")
GOAL: Final = rgba("#ff5fa8")
DOCK: Final = rgba("#7bd389")

KEY_SCAN: Final = rgba("#8fb8ff")
LOOP: Final = rgba("#56c98b", 190)
LOOP_OFF: Final = rgba("#ff4f55")

# Cells of the map made by driving: unknown, free, occupied.
MAPPED: Final = (rgba("#000000", 0), rgba("#233440"), rgba("#e8b04b"))

ZONES: Final[dict[str, Colour]] = {
    "stop": rgba("#e5484d"),
    "danger": rgba("#ef8e3c"),
    "caution": rgba("#d9c23c"),
}


def agent(name: str) -> Colour:
    """The colour of an agent, or of `NO_AGENT`."""
    return rgba(colour(None if name == NO_AGENT else name))
