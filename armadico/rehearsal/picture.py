"""The paths of a rehearsal's samples on the map, as an SVG."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from math import cos, sin
from typing import Final

from armadico.config.worlds import World, load_world
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.sample import ARRIVED, UNENDED, Sample

LONG_PX: Final = 900.0
"""The longer side of a picture."""

MARGIN_M: Final = 0.5
INK, PAPER, SLOW, GOAL = "#22303c", "#ffffff", "#e69f00", "#b01e68"
COLOURS: Final = {ARRIVED: "#0072b2", UNENDED: "#8a8f94"}
"""Of a path by its end; of others `WRONG`. By Okabe and Ito, for any colour vision."""

WRONG: Final = "#d55e00"


def drawn(of: Rehearsed) -> str:
    """The picture of an answer with samples. Raises ConfigError if the map is gone."""
    world = load_world(of.world)
    x1, y1, x2, y2 = _bounds(of, world)
    scale = LONG_PX / max(x2 - x1, y2 - y1)
    size = f'width="{(x2 - x1) * scale:.0f}" height="{(y2 - y1) * scale:.0f}"'
    frame = f'viewBox="{x1:.2f} {-y2:.2f} {x2 - x1:.2f} {y2 - y1:.2f}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {frame}>',
        f"<title>{escape(of.says)}</title>",
        f'<rect x="{x1:.2f}" y="{-y2:.2f}" width="100%" height="100%" fill="{PAPER}"/>',
        f'<path d="{_walls(world)}" stroke="{INK}" stroke-width="0.06" fill="none"/>',
        *_paths(of),
        *_marks(of),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _bounds(of: Rehearsed, world: World) -> tuple[float, float, float, float]:
    xs = [x for run in of.runs for _, x, _ in run.path]
    ys = [y for run in of.runs for _, _, y in run.path]
    if world.outlines:
        xs += world.bounds[::2]
        ys += world.bounds[1::2]
    if of.goal is not None:
        xs.append(of.goal[0])
        ys.append(of.goal[1])
    xs, ys = xs or [0.0], ys or [0.0]
    m = MARGIN_M
    return min(xs) - m, min(ys) - m, max(xs) + m, max(ys) + m


def _walls(world: World) -> str:
    return " ".join(f"M{a:.2f} {-b:.2f}L{c:.2f} {-d:.2f}" for a, b, c, d in world.outlines)


def _paths(of: Rehearsed) -> Iterator[str]:
    for run in of.runs:
        if len(run.path) > 1:
            points = " ".join(f"{x:.2f},{-y:.2f}" for _, x, y in run.path)
            yield (
                f'<polyline points="{points}" fill="none" stroke="{_colour(run)}"'
                f' stroke-width="0.05" stroke-opacity="0.7"><title>{escape(_says(run))}</title>'
                "</polyline>"
            )


def _colour(run: Sample) -> str:
    return COLOURS.get(run.end, WRONG)


def _says(run: Sample) -> str:
    why = f": {run.why}" if run.why else ""
    return f"sample {run.seed}: {run.end} after {run.time_s:.0f} s{why}"


def _marks(of: Rehearsed) -> Iterator[str]:
    for spot in of.slow:
        at = f'cx="{spot.x:.2f}" cy="{-spot.y:.2f}"'
        said = escape(f"slow for {spot.seconds:.0f} s: {spot.why}")
        how = f'r="0.5" fill="{SLOW}" fill-opacity="0.25"'
        yield f"<circle {at} {how}><title>{said}</title></circle>"
    for run in of.runs:
        if run.path and run.end != ARRIVED:
            _, x, y = run.path[-1]
            cross = f"M{x - 0.12:.2f} {-y - 0.12:.2f}l.24 .24m0 -.24l-.24 .24"
            yield f'<path d="{cross}" stroke="{_colour(run)}" stroke-width="0.06"/>'
        if run.put is not None:
            x, y = run.put
            box = f'x="{x - 0.15:.2f}" y="{-y - 0.15:.2f}" width="0.3" height="0.3"'
            told = f"put on the way of sample {run.seed}: no map has it"
            how = f'fill="none" stroke="{_colour(run)}" stroke-width="0.05"'
            yield f"<rect {box} {how}><title>{told}</title></rect>"
    if of.goal is not None:
        x, y, theta = of.goal
        nose = f"{x + 0.4 * cos(theta):.2f} {-y - 0.4 * sin(theta):.2f}"
        yield f'<circle cx="{x:.2f}" cy="{-y:.2f}" r="0.15" fill="{GOAL}"/>'
        yield f'<path d="M{x:.2f} {-y:.2f}L{nose}" stroke="{GOAL}" stroke-width="0.06"/>'
