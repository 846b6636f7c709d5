"""The map as a PNG: walls, names of places, what is sensed, the path, the robot on it."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from math import cos, sin
from typing import Final

from PIL import Image, ImageDraw

from armadico.config.named import Named
from armadico.config.worlds import Segment, World

LONGEST_PX: Final = 720  # the longer side, so that the picture has few kB
MARGIN_PX: Final = 12
MOST_PX_M: Final = 120.0  # in a small world

PAPER, INK, SOFT = "#ffffff", "#22303c", "#6b7883"
FORBIDDEN, SENSED, WAY, ROBOT, PLACE = "#c0392b", "#d98c1f", "#56b4e9", "#0072b2", "#3b7d23"


def drawn(
    bounds: Segment,
    world: World | None,
    places: Iterable[Named],
    sensed: Iterable[tuple[float, float]],
    way: Sequence[tuple[float, float]],
    robot: tuple[float, float, float, float] | None,
) -> bytes:
    """Return a PNG; x points right, y up. All is in the world: m and rad.

    The `way` leads from the robot to its goal. The robot has x, y, heading and radius.
    """
    x1, y1, x2, y2 = bounds
    wide, high = max(x2 - x1, 0.1), max(y2 - y1, 0.1)
    scale = min((LONGEST_PX - 2 * MARGIN_PX) / max(wide, high), MOST_PX_M)
    size = (round(wide * scale) + 2 * MARGIN_PX, round(high * scale) + 2 * MARGIN_PX)
    image = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(image)

    def at(x: float, y: float) -> tuple[float, float]:
        return MARGIN_PX + (x - x1) * scale, size[1] - MARGIN_PX - (y - y1) * scale

    def dot(x: float, y: float, radius_px: float, colour: str) -> None:
        px, py = at(x, y)
        draw.ellipse((px - radius_px, py - radius_px, px + radius_px, py + radius_px), colour)

    forbidden, walls = ((), ()) if world is None else (world.forbidden, world.outlines)
    for lines, colour, width in ((forbidden, FORBIDDEN, 1), (walls, INK, 3)):
        for ax, ay, bx, by in lines:
            draw.line((at(ax, ay), at(bx, by)), colour, width)
    for x, y in sensed:
        dot(x, y, 2, SENSED)
    if len(way) > 1:
        draw.line([at(x, y) for x, y in way], WAY, 3)
        dot(*way[-1], 6, WAY)
    for place in places:
        dot(place.x, place.y, 3, PLACE)
        px, py = at(place.x, place.y)
        draw.text((px + 5, py - 6), place.name, SOFT)
    if robot is not None:
        x, y, heading, radius = robot
        dot(x, y, max(radius * scale, 6.0), ROBOT)
        nose = max(radius, 6.0 / scale)
        tip = (x + 1.6 * nose * cos(heading), y + 1.6 * nose * sin(heading))
        draw.line((at(x, y), at(*tip)), INK, 3)
    out = io.BytesIO()
    image.quantize(32).save(out, "PNG", optimize=True)
    return out.getvalue()
