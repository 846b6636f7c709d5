"""Maps of a ROS map_server: a YAML file and an image. Occupied cells become walls.

Pixels are classified as in Nav2's map_server, in its three modes. A cell's shade is the mean of its
colour channels, and thresholds are inclusive. A cell that is not opaque is unknown, except in
`raw`, which has no alpha. Unknown cells are not walls: they become `World.unseen`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, hypot, isfinite, pi, sin
from pathlib import Path
from typing import Final
from warnings import catch_warnings

import numpy as np
import yaml
from msgspec.structs import replace
from numpy.typing import NDArray
from PIL import Image

from armadico.config.loading import read_text
from armadico.config.unseen import packed
from armadico.config.worlds import Segment, World, hull
from armadico.core.config_errors import ConfigError, ConfigValueError
from armadico.core.errors import hint
from armadico.core.unseen import REFUSE, RULES

Fields = dict[str, yaml.Node]
"""The values of a map's YAML file by key."""

REQUIRED = ("image", "resolution", "origin")
OPTIONAL = {"negate": "0", "occupied_thresh": "0.65", "free_thresh": "0.196", "mode": "trinary"}
UNSEEN: Final = "unseen"
"""A key of this project, `drive` or `refuse`: whether paths may lead through unknown cells."""

SAVED_UNKNOWN: Final = 205
"""The grey that map savers write for unknown cells."""

MODES = ("trinary", "scale", "raw")
YES_OR_NO = {"0": False, "false": False, "no": False, "1": True, "true": True, "yes": True}

LONGEST: Final = 100_000
"""Most bytes of the YAML file, which has ten lines."""

MAX_PIXELS = 89_000_000  # above this Pillow warns, and above twice this it raises

FARTHEST_M: Final = 1e5
"""The largest distance of poses on the mesh from the origin."""

FORMATS: Final = ("PPM", "PNG", "BMP", "GIF", "JPEG", "TIFF", "WEBP")
"""The image formats that are read. Some of Pillow's other formats start programs."""

SUFFIXES: Final = (".pgm", ".png", ".bmp", ".pbm", ".ppm", ".gif", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes of images beside a map that an error may suggest."""

COLOURS: Final = {"LA", "RGB", "RGBA"}
"""Pillow's modes with several channels that are read without conversion."""

MAX_WALLS = 200_000
"""Most borders of occupied cells, in runs. A noisy map of a building of 100 m x 100 m has a tenth
of them; a picture that is not a map has millions, and every agent reads them."""


@dataclass(frozen=True)
class Raster:
    """The cells of an image, bottom row first, and the pose of its lower left corner."""

    occupied: NDArray[np.bool_]
    free: NDArray[np.bool_]
    cell_m: float
    origin: tuple[float, float, float]
    refused: bool = False  # the file forbids paths through unknown cells
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Pixels:
    """The pixels of an image, top row first: black is 0, white is `most`."""

    values: NDArray[np.integer]
    most: int
    opaque: NDArray[np.bool_] | None = None  # None: all pixels are


def read_occupancy(path: Path | str) -> World:
    """The world of a map_server's YAML file and its image. Raises ConfigError."""
    raster = read_raster(path)
    if not raster.occupied.any() and not raster.free.any():
        fault = "all cells are unknown; check occupied_thresh, free_thresh, negate and mode"
        raise ConfigError(fault, path)
    try:
        world = world_of(raster, Path(path).stem)
    except ConfigError as error:
        raise error.at(path) from None
    unknown = ~(raster.occupied | raster.free)
    unseen = packed(unknown, raster.cell_m, raster.origin, refused=raster.refused)
    return replace(world, unseen=unseen, doubts=raster.doubts)


def read_raster(path: Path | str) -> Raster:
    """The cells of a map_server's YAML file and its image. Raises ConfigError."""
    file = Path(path)
    fields = _fields(read_text(file, LONGEST), file)
    (resolution,) = _numbers(fields, "resolution", 1, file)
    if not 1e-4 <= resolution <= 10.0:
        raise _wrong(fields, "resolution", "metres for one pixel, 0.0001 to 10", file)
    x, y, theta = _numbers(fields, "origin", 3, file)
    if abs(theta) > 2.0 * pi:
        raise _wrong(fields, "origin", "a yaw in radians, -6.28 to 6.28", file)
    pixels = _pixels(fields, file)
    occupied, free = _judged(pixels, fields, file)
    if hypot(x, y) + resolution * hypot(*occupied.shape) > FARTHEST_M:
        expected = (
            f"a map within {FARTHEST_M:,.0f} m of 0, 0: subtract a corner from UTM coordinates"
        )
        raise _wrong(fields, "origin", expected, file)
    refused = _word(fields, UNSEEN).lower()
    if refused not in ("", *RULES):
        raise _wrong(fields, UNSEEN, f"one of {', '.join(RULES)}", file)
    doubts = tuple(_unknown_as_free(pixels, free, fields, file))
    cells = np.flipud(occupied), np.flipud(free)
    return Raster(*cells, resolution, (x, y, theta), refused == REFUSE, doubts)


def world_of(raster: Raster, name: str) -> World:
    """A world whose walls are the borders of occupied cells, in runs. Raises ConfigError."""
    count = walls_in(raster.occupied)
    if count > MAX_WALLS:
        raise ConfigError(
            f"its occupied cells have {count:,} borders; expected at most {MAX_WALLS:,}: is it a"
            " map, and is occupied_thresh right?"
        )
    if raster.occupied.all():
        raise ConfigError("all cells are occupied; check occupied_thresh and negate")
    cell_m, origin = raster.cell_m, raster.origin
    walls = tuple(_place(edge, cell_m, origin) for edge in _edges(raster.occupied))
    rows, columns = raster.occupied.shape
    frame = ((0, 0, columns, 0), (columns, 0, columns, rows), (columns, rows, 0, rows))
    bounds = hull(tuple(_place(edge, cell_m, origin) for edge in frame))
    return World(name, walls, bounds, solid=True)


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """YAML as nodes. Aliases of lists and tables are errors: a few may expand to millions."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        alias = self.peek_event() if self.check_event(yaml.AliasEvent) else None
        node: yaml.Node | None = super().compose_node(parent, index)
        if alias is not None and not isinstance(node, yaml.ScalarNode):
            fault = "aliases of lists and tables are not allowed"
            raise yaml.MarkedYAMLError(problem=fault, problem_mark=alias.start_mark)
        return node


def _fields(text: str, file: Path) -> Fields:
    try:  # PyYAML does not read a tab between a key and its value, which YAML allows
        root = _Loader(text.replace("\t", " ")).get_single_node()
    except RecursionError:
        raise ConfigError("not YAML: lists and tables are nested too deeply", file) from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        fault = getattr(error, "problem", None) or getattr(error, "reason", "not readable")
        line = mark.line + 1 if mark is not None else None
        raise ConfigError(f"not YAML: {fault}", file, line) from None
    needs = f"a map needs {', '.join(REQUIRED)}"
    if not isinstance(root, yaml.MappingNode):
        raise ConfigError(f"not a map's YAML: expected keys and values; {needs}", file, 1)
    fields: Fields = {}
    for key, value in root.value:
        name = key.value if isinstance(key, yaml.ScalarNode) else ""
        if name in fields:
            raise ConfigError(f"a second key {name}", file, key.start_mark.line + 1)
        if name in (*REQUIRED, *OPTIONAL, UNSEEN):
            fields[name] = value
    for name in REQUIRED:
        if name not in fields:
            raise ConfigError(f"missing key {name}; {needs}", file, 1)
    return fields


def _word(fields: Fields, key: str) -> str:
    """A value as text; empty for a list, a table and a missing value."""
    node = fields.get(key)
    if node is None:
        return OPTIONAL.get(key, "")
    return str(node.value) if isinstance(node, yaml.ScalarNode) else ""


def _numbers(fields: Fields, key: str, count: int, file: Path) -> list[float]:
    node = fields.get(key)
    nodes = [node] if count == 1 else getattr(node, "value", [])
    try:
        numbers = [_number(_word({key: one}, key)) for one in nodes]
    except ValueError:
        numbers = []
    if len(numbers) != count or isinstance(node, yaml.MappingNode):
        expected = "a number" if count == 1 else "[x, y, yaw] in metres and radians"
        raise _wrong(fields, key, expected, file)
    if not all(map(isfinite, numbers)):
        raise _wrong(fields, key, "finite numbers", file)
    return numbers


def _number(word: str) -> float:
    """A number of YAML. Raises ValueError."""
    sign, dot, name = word.lower().partition(".")
    return float(sign + name if dot and name in ("inf", "nan") else word)


def _share(fields: Fields, key: str, file: Path) -> float:
    if key not in fields:
        return float(OPTIONAL[key])
    (share,) = _numbers(fields, key, 1, file)
    if not 0.0 <= share <= 1.0:
        raise _wrong(fields, key, "0 to 1; 65 % is 0.65", file)
    return share


def _wrong(fields: Fields, key: str, expected: str, file: Path) -> ConfigError:
    """The error for a value, which it quotes as it is written."""
    begin, end = fields[key].start_mark, fields[key].end_mark
    written = " ".join(str(begin.buffer)[begin.pointer : end.pointer].split())
    shown = written if len(written) <= 60 else written[:57] + "..."
    message = f"{key}: {shown}: expected {expected}"
    return ConfigValueError(key, written, expected, file, begin.line + 1, message)


def _pixels(fields: Fields, file: Path) -> _Pixels:
    path = file.parent / _word(fields, "image")
    if not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises for a name that is too long
        folder = path.parent if path.parent.is_dir() else file.parent
        beside = [p.name for p in folder.iterdir() if p.suffix in SUFFIXES]
        near = hint(path.name, beside)
        expected = f"the path of an image, counted from {str(file.parent)!r}"
        expected += f"; {near}" if near else ""
        raise _wrong(fields, "image", expected, file)
    try:
        with catch_warnings(action="ignore"), Image.open(path, formats=FORMATS) as image:
            if image.width * image.height > MAX_PIXELS:
                raise Image.DecompressionBombError
            return _decoded(image)
    except Image.DecompressionBombError:
        raise _wrong(fields, "image", f"at most {MAX_PIXELS:,} pixels", file) from None
    except Exception as error:  # decoders raise various errors for damaged files
        with path.open("rb") as opened:
            pointer = opened.read(7) == b"version"
        why = "a Git LFS pointer; `git lfs pull` fetches the image" if pointer else str(error)
        expected = f"an image that can be read ({', '.join(FORMATS)}): {why}"
        raise _wrong(fields, "image", expected, file) from None


def _decoded(image: Image.Image) -> _Pixels:
    """The pixels in full depth. Raises ValueError or any error of the decoder."""
    image.load()
    clear = image.info.get("transparency")
    if image.mode == "1" and clear is None:
        return _Pixels(np.asarray(image).astype(np.uint8), 1)
    if image.mode.startswith("I"):
        bits = getattr(image, "tag_v2", {}).get(258, (16,))[0]  # Pillow does not scale 12 bits
        most, values = 2 ** min(int(bits), 16) - 1, np.asarray(image)
        if values.min() < 0 or values.max() > most:
            raise ValueError("grey of more than 16 bits")
        return _Pixels(values, most, values != clear if isinstance(clear, int) else None)
    if image.mode == "F":
        raise ValueError("grey in floating point")
    if clear is not None or image.mode in ("PA", "La", "RGBa"):
        image = image.convert("RGBA")
    elif image.mode not in {"L", *COLOURS}:
        image = image.convert("RGB")
    pixels = np.asarray(image)
    if image.mode == "L":
        return _Pixels(pixels, 255)
    channels = {"LA": 1}.get(image.mode, 3)
    opaque = pixels[..., -1] == 255 if pixels.shape[-1] > channels else None
    shades = pixels[..., :channels].sum(axis=2, dtype=np.uint16)
    return _Pixels(shades, 255 * channels, opaque)


def _judged(
    pixels: _Pixels, fields: Fields, file: Path
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(occupied, free) of the pixels."""
    mode, negate = (_word(fields, key).lower() for key in ("mode", "negate"))
    if mode not in MODES:
        raise _wrong(fields, "mode", f"one of {', '.join(MODES)}", file)
    if negate not in YES_OR_NO:
        raise _wrong(fields, "negate", "0 or 1", file)
    levels = np.arange(pixels.most + 1)
    if mode == "raw":  # a grey of 0 to 100, of 255, is the cell's value in per cent
        odds = np.rint(255.0 * levels / pixels.most) / 100.0
        odds[odds > 1.0] = np.nan
    else:
        odds = (levels if YES_OR_NO[negate] else pixels.most - levels) / pixels.most
    occupied = (odds >= _share(fields, "occupied_thresh", file))[pixels.values]
    free = (odds <= _share(fields, "free_thresh", file))[pixels.values] & ~occupied
    if pixels.opaque is not None and mode != "raw":
        occupied &= pixels.opaque
        free &= pixels.opaque
    return occupied, free


def _unknown_as_free(
    pixels: _Pixels, free: NDArray[np.bool_], fields: Fields, file: Path
) -> Iterator[str]:
    """The warning about a threshold that makes free what map savers wrote as unknown."""
    if pixels.most % 255 or _word(fields, "mode").lower() == "raw":
        return
    saved = pixels.values == SAVED_UNKNOWN * (pixels.most // 255)
    count = np.count_nonzero(saved & free)
    if count:
        line = fields["free_thresh"].start_mark.line + 1
        yield (
            f"{file}:{line}: free_thresh: {_word(fields, 'free_thresh')}: makes {count:,} cells of"
            f" grey {SAVED_UNKNOWN} free, which map savers write for unknown; write"
            f" {OPTIONAL['free_thresh']}, unless they are known to be free"
        )


def _edges(occupied: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """The borders of the occupied cells, in cells, in runs."""
    padded = np.pad(occupied, 1)
    across = padded[1:, 1:-1] != padded[:-1, 1:-1]  # between a row and the one below it
    upright = (padded[1:-1, 1:] != padded[1:-1, :-1]).T
    level = [(first, row, last, row) for row, first, last in _runs(across)]
    return level + [(column, first, column, last) for column, first, last in _runs(upright)]


def walls_in(occupied: NDArray[np.bool_]) -> int:
    """The number of walls of the cells."""
    padded = np.pad(occupied, 1)
    across = padded[1:, :] != padded[:-1, :]
    upright = padded[:, 1:] != padded[:, :-1]
    begins = np.count_nonzero(across[:, 1:] & ~across[:, :-1])
    return int(begins + np.count_nonzero(upright[1:] & ~upright[:-1]))


def _runs(edges: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """(line, first, last) of every run of edges; `last` is where the next cell begins."""
    steps = np.diff(np.pad(edges, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    first, last = np.argwhere(steps == 1), np.argwhere(steps == -1)
    both: list[tuple[list[int], list[int]]] = list(zip(first.tolist(), last.tolist(), strict=True))
    return [(start[0], start[1], end[1]) for start, end in both]


def _place(
    edge: tuple[int, int, int, int], resolution: float, origin: tuple[float, float, float]
) -> Segment:
    """An edge, given in cells, in the map's frame, m."""
    c, s = cos(origin[2]), sin(origin[2])
    points: list[float] = []
    for column, row in (edge[:2], edge[2:]):
        x, y = column * resolution, row * resolution
        points += [origin[0] + c * x - s * y, origin[1] + s * x + c * y]
    return points[0], points[1], points[2], points[3]
