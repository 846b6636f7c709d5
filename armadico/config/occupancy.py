"""Maps of a ROS map_server: a small YAML file and an image. Occupied cells become walls.

The YAML is flat, `key: value`, so a few lines read it and no YAML library is needed. Pixels are
judged as map_server does in its trinary mode; unknown cells are not walls.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import cos, isfinite, sin
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from armadico.config.errors import ConfigError, advice
from armadico.config.loading import read_text
from armadico.config.worlds import Segment, World, hull

Fields = dict[str, tuple[str, int]]
"""What a key says, and in which line."""

REQUIRED = ("image", "resolution", "origin")
OPTIONAL = {"negate": "0", "occupied_thresh": "0.65", "free_thresh": "0.196", "mode": "trinary"}
MAX_PIXELS = 89_000_000  # Pillow warns of more, and refuses twice as many

MAX_WALLS = 200_000
"""Borders of occupied cells, in runs: a building of 100 m x 100 m that was mapped with noise has a
tenth of them. Of a picture that is no map there are millions, and every agent would read them."""

_PLAIN = re.compile(r"[\w.][\w .()+-]*")
_QUOTED: tuple[tuple[re.Pattern[str], Callable[[str], str]], ...] = (
    (re.compile(r'("(?:[^"\\]|\\.)*")\s*(?:#.*)?'), json.loads),
    (re.compile(r"('(?:[^']|'')*')\s*(?:#.*)?"), lambda text: text[1:-1].replace("''", "'")),
)
"""A value in quotes, with a comment behind it, if any; and what it says."""


@dataclass(frozen=True)
class Raster:
    """An image's cells, the bottom row first, and the pose of its lower left corner."""

    occupied: NDArray[np.bool_]
    free: NDArray[np.bool_]
    cell_m: float
    origin: tuple[float, float, float]


def read_occupancy(path: Path | str) -> World:
    """The world in a map_server's YAML file and its image. Raises ConfigError with the line."""
    raster = read_raster(path)
    try:
        return world_of(raster, Path(path).stem)
    except ConfigError as error:
        raise ConfigError(error.message, path) from None


def read_raster(path: Path | str) -> Raster:
    """The cells in a map_server's YAML file and its image. Raises ConfigError with the line."""
    file = Path(path)
    fields = _fields(read_text(file), file)
    resolution = _numbers(fields, "resolution", 1, file)[0]
    if not 1e-4 <= resolution <= 10.0:
        raise _wrong(fields, "resolution", "metres for one pixel, 0.0001 to 10", file)
    x, y, theta = _numbers(fields, "origin", 3, file)
    dark = _dark(_image(fields, file), fields, file)
    occupied = dark > _numbers(fields, "occupied_thresh", 1, file)[0]
    free = dark < _numbers(fields, "free_thresh", 1, file)[0]
    return Raster(np.asarray(occupied), np.asarray(free), resolution, (x, y, theta))


def world_of(raster: Raster, name: str) -> World:
    """Occupied cells as walls: their borders, in runs as long as they go. Raises ConfigError."""
    count = walls_in(raster.occupied)
    if count > MAX_WALLS:
        raise ConfigError(
            f"its occupied cells have {count:,} borders, at most {MAX_WALLS:,} are read: is it a"
            " map, and is occupied_thresh right?"
        )
    if raster.occupied.all():
        raise ConfigError(
            "all of its cells are occupied, a robot can be nowhere: are occupied_thresh and negate"
            " right?"
        )
    cell_m, origin = raster.cell_m, raster.origin
    walls = tuple(_place(edge, cell_m, origin) for edge in _edges(raster.occupied))
    rows, columns = raster.occupied.shape
    frame = ((0, 0, columns, 0), (columns, 0, columns, rows), (columns, rows, 0, rows))
    bounds = hull(tuple(_place(edge, cell_m, origin) for edge in frame))
    return World(name, walls, bounds, solid=True)


def quoted(text: str) -> str:
    """A string as a YAML value: as it is if YAML takes it for that, else in quotes."""
    if _PLAIN.fullmatch(text) and text.strip() == text:
        return text
    said = json.dumps(text, ensure_ascii=False)
    return re.sub("[\x7f\x85\u2028\u2029]", lambda found: f"\\u{ord(found[0]):04x}", said)


def _unquoted(value: str) -> str:
    """What a YAML value says."""
    for pattern, plain in _QUOTED:
        found = pattern.fullmatch(value)
        if found is not None:
            with suppress(ValueError):
                return plain(found[1])
    return value.split(" #", maxsplit=1)[0].strip()


def _fields(text: str, file: Path) -> Fields:
    fields: Fields = {}
    for number, line in enumerate(text.split("\n"), start=1):
        content = line.strip()
        if not content or content.startswith(("#", "---")):
            continue
        key, colon, value = content.partition(":")
        if not colon:
            raise ConfigError(f"{content!r}: expected `key: value`", file, number)
        if key.strip() in (*REQUIRED, *OPTIONAL):
            fields[key.strip()] = _unquoted(value.strip()), number
    for key in REQUIRED:
        if key not in fields:
            raise ConfigError(f"missing key {key}; a map needs {', '.join(REQUIRED)}", file, 1)
    return {key: (value, 1) for key, value in OPTIONAL.items()} | fields


def _numbers(fields: Fields, key: str, count: int, file: Path) -> list[float]:
    words = fields[key][0].strip("[]").split(",")
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(isfinite, numbers)):
        expected = "a number" if count == 1 else "[x, y, yaw] in metres and radians"
        raise _wrong(fields, key, expected, file)
    return numbers


def _wrong(fields: Fields, key: str, expected: str, file: Path) -> ConfigError:
    value, line = fields[key]
    return ConfigError(f"{key}: {value}: expected {expected}", file, line)


def _image(fields: Fields, file: Path) -> NDArray[np.uint8]:
    """The pixels, grey, the bottom row first."""
    path = file.parent / fields["image"][0]
    if not path.is_file():
        beside = [p.name for p in file.parent.iterdir() if p.suffix in (".pgm", ".png")]
        raise _wrong(fields, "image", f"an image here; {advice(path.name, beside)}", file)
    try:
        with (
            catch_warnings(action="ignore", category=Image.DecompressionBombWarning),
            Image.open(path) as image,
        ):
            if image.width * image.height > MAX_PIXELS:
                raise Image.DecompressionBombError
            return np.flipud(np.asarray(image.convert("L")))
    except Image.DecompressionBombError:
        raise _wrong(fields, "image", f"at most {MAX_PIXELS} pixels", file) from None
    except (OSError, SyntaxError, ValueError):
        raise _wrong(fields, "image", "a PGM or PNG image that can be read", file) from None


def _dark(pixels: NDArray[np.uint8], fields: Fields, file: Path) -> NDArray[np.floating[Any]]:
    """How likely each cell is occupied, by its grey."""
    if fields["mode"][0] not in ("trinary", "scale"):
        raise _wrong(fields, "mode", "trinary or scale", file)
    if fields["negate"][0] not in ("0", "1", "false", "true"):
        raise _wrong(fields, "negate", "0 or 1", file)
    share = pixels / 255.0
    return 1.0 - share if fields["negate"][0] in ("0", "false") else share


def _edges(occupied: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """The border of the occupied cells, in cells, in runs as long as they go."""
    padded = np.pad(occupied, 1)
    across = padded[1:, 1:-1] != padded[:-1, 1:-1]  # between a row and the one below it
    upright = (padded[1:-1, 1:] != padded[1:-1, :-1]).T
    level = [(first, row, last, row) for row, first, last in _runs(across)]
    return level + [(column, first, column, last) for column, first, last in _runs(upright)]


def walls_in(occupied: NDArray[np.bool_]) -> int:
    """How many walls the cells become."""
    padded = np.pad(occupied, 1)
    across = padded[1:, :] != padded[:-1, :]
    upright = padded[:, 1:] != padded[:, :-1]
    begins = np.count_nonzero(across[:, 1:] & ~across[:, :-1])
    return int(begins + np.count_nonzero(upright[1:] & ~upright[:-1]))


def _runs(edges: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """(line, first, last) of every run of edges; `last` is where the next cell begins."""
    steps = np.diff(np.pad(edges, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    first, last = np.argwhere(steps == 1), np.argwhere(steps == -1)
    both: list[Any] = list(zip(first.tolist(), last.tolist(), strict=True))
    return [(start[0], start[1], end[1]) for start, end in both]


def _place(
    edge: tuple[int, int, int, int], resolution: float, origin: tuple[float, float, float]
) -> Segment:
    """An edge in cells, in the map's frame."""
    c, s = cos(origin[2]), sin(origin[2])
    points: list[float] = []
    for column, row in (edge[:2], edge[2:]):
        x, y = column * resolution, row * resolution
        points += [origin[0] + c * x - s * y, origin[1] + s * x + c * y]
    return points[0], points[1], points[2], points[3]
