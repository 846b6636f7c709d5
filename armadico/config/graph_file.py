"""The file of a SLAM graph: what is needed to go on with a map.

A NumPy archive (`.npz`) beside the map's `.yaml` and `.pgm`, without pickle:

| array | content |
| --- | --- |
| `version` | of this format |
| `poses`, `way`, `part` | of the n key scans: m, m, rad; m driven; the part of the map |
| `session` | of each key scan, from 0, the oldest; without this array there is one session |
| `edge_ends`, `edge_pose`, `edge_information` | of the pose graph; upper triangle by rows |
| `edge_loop`, `edge_weight` | 1: a loop; weight after the newest optimisation |
| `weak` | key scans that fitted badly |
| `scan_of`, `scan_offset` | of the m scans: the key scan of each, its pose in the frame of that |
| `scan_key` | 1: it is that key scan |
| `scan_frame`, `scan_rays` | x, y, bearing of the first ray, step, reach; number of rays |
| `ranges_low`, `ranges_high` | bytes of the differences from ray to ray, 5 mm, modulo 65536 |
| `body` | front, rear and half the width of the robot, m; 0: unknown |

Ranges are those of a scan's message, rounded to 5 mm: a tenth of a cell of the map, and less than
the noise of a laser. Differences from ray to ray take less space than ranges.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.config.grid_map import Cells, Mapper, new_mapper
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle
from armadico.mobile.geometry import Pose2, compose
from armadico.mobile.messages import RAYS, REACH_M, Pose, Scan
from armadico.mobile.scans import FINEST_RAD, FREE, INVALID

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

VERSION: Final = 1
SUFFIX: Final = ".graph.npz"

MOST_BYTES: Final = 1 << 28
"""Of all arrays: 50,000 scans of 2048 rays take 205 MB."""

FARTHEST_M: Final = 1e5
"""The largest coordinate."""

STEP_MM: Final = 5
"""Of ranges; a divisor of 65535, which means that a ray has met nothing."""

TRIANGLE: Final = np.triu_indices(3)

_Array = NDArray[Any]  # of its type in `ARRAYS`

ARRAYS: Final[Mapping[str, tuple[str, int | None]]] = {
    "version": ("<u4", 0),
    "poses": ("<f8", 3),
    "way": ("<f8", None),
    "part": ("<u4", None),
    "session": ("<u4", None),
    "edge_ends": ("<u4", 2),
    "edge_pose": ("<f8", 3),
    "edge_information": ("<f4", 6),
    "edge_loop": ("u1", None),
    "edge_weight": ("<f4", None),
    "weak": ("<u4", 0),
    "scan_of": ("<u4", None),
    "scan_offset": ("<f4", 3),
    "scan_key": ("u1", None),
    "scan_frame": ("<f4", 5),
    "scan_rays": ("<u2", None),
    "ranges_low": ("u1", None),
    "ranges_high": ("u1", None),
    "body": ("<f4", None),
}
"""Type and columns of each array; 0: a number, None: one dimension."""

NEWER: Final = {"session": "part"}
"""Arrays that older files lack, which are zeros then, as many as another one has numbers."""


Footprint = tuple[float, float, float]
"""Of the robot: to the front, to the rear and to a side, m."""


class DrawnScan(NamedTuple):
    """A scan of the map."""

    key: int  # the newest key scan at its time
    offset: Floats  # the robot's pose in the frame of that key scan
    scan: Scan
    is_key: bool  # it is that key scan


@dataclass(frozen=True)
class SavedGraph:
    """A map of key scans, without what is computed from it."""

    poses: Floats  # (n, 3) of the key scans
    way: Floats  # (n,) m
    part: Indices  # (n,) parts have no known place to each other
    ends: Indices  # (e, 2) the key scans of each edge
    steps: Floats  # (e, 3) the pose of the second one in the frame of the first
    information: Floats  # (e, 3, 3) in that frame
    loops: NDArray[np.bool_]  # (e,)
    weights: Floats  # (e,) after the newest optimisation
    weak: int
    scans: list[DrawnScan]
    body: Footprint | None
    session: Indices  # (n,) from 0, the oldest

    @property
    def main(self) -> NDArray[np.bool_]:
        """(n,) which key scans are of the oldest session's largest part: of equal ones, the oldest.

        A later part is of the same building only if it was joined to that one: without that proof
        it is not the map, however large it is.
        """
        oldest = self.part[self.session == self.session[0]]
        return np.asarray(self.part == np.argmax(np.bincount(oldest)))

    def drawn(
        self, step: Callable[[], None] = lambda: None, which: NDArray[np.bool_] | None = None
    ) -> Cells:
        """The grid of the main part, by the installed mapper.

        What a later session saw often enough replaces what was there before. `step` is called for
        each scan; `which` (n,) are the key scans that are drawn instead.
        """
        mapper, main = new_mapper(), self.main if which is None else which
        session = self.session[0]
        for one in self.scans:
            if main[one.key]:
                if self.session[one.key] != session:
                    session = self.session[one.key]
                    mapper.settle()
                x, y, theta = self.poses[one.key].tolist()
                at = compose((x, y, theta), tuple(one.offset.tolist()))
                draw(mapper, at, one.scan, self.body)
            step()
        return mapper.cells()


def draw(mapper: Mapper, at: Pose2, scan: Scan, body: Footprint | None) -> None:
    """Add a scan of a robot at a pose, and its footprint as free."""
    pose = Pose(scan.cycle, *at)
    mapper.see(pose, scan)
    if body is not None:
        front, rear, side = body
        mapper.stand(pose, ((front, side), (-rear, side), (-rear, -side), (front, -side)))


def beside(path: Path) -> Path:
    """The graph's file of a map."""
    return path.with_name(path.stem + SUFFIX)


def encode(graph: SavedGraph, *, compressed: bool = True) -> bytes:
    """The bytes of the file: the same for the same graph. Without compression it takes no time."""
    scans = graph.scans
    ranges = _rounded(np.frombuffer(b"".join(one.scan.packed for one in scans), dtype="<u2"))
    rays = np.array([one.scan.rays for one in scans], dtype="<u2")
    frames = [(s.x, s.y, s.bearing, s.step, s.reach) for s in (one.scan for one in scans)]
    differences = ranges - np.concatenate([[np.uint16(0)], ranges[:-1]]).astype("<u2")
    arrays = {
        "version": VERSION,
        "poses": graph.poses,
        "way": graph.way,
        "part": graph.part,
        "session": graph.session,
        "edge_ends": graph.ends,
        "edge_pose": graph.steps,
        "edge_information": graph.information[:, TRIANGLE[0], TRIANGLE[1]],
        "edge_loop": graph.loops,
        "edge_weight": graph.weights,
        "weak": graph.weak,
        "scan_of": [one.key for one in scans],
        "scan_offset": [one.offset for one in scans],
        "scan_key": [one.is_key for one in scans],
        "scan_frame": frames,
        "scan_rays": rays,
        "ranges_low": differences & 0xFF,
        "ranges_high": differences >> 8,
        "body": graph.body or (0.0, 0.0, 0.0),
    }
    shaped = {name: _shaped(name, value) for name, value in arrays.items()}
    file = BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, allow_pickle=False, **shaped)
    return file.getvalue()


def _rounded(ranges: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Ranges in mm as multiples of the step; none becomes invalid or free by it."""
    steps = np.clip(np.rint(ranges / STEP_MM), 1, FREE // STEP_MM - 1)
    steps[ranges == INVALID], steps[ranges == FREE] = INVALID, FREE // STEP_MM
    return steps.astype("<u2")


def _shaped(name: str, value: object) -> _Array:
    kind, columns = ARRAYS[name]
    found = np.asarray(value, dtype=kind)
    return found.reshape(-1, columns) if columns else found


def read(path: Path) -> SavedGraph:
    """The graph of a file. Raises ConfigError with the file's name."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(
            "there is no such file: the map was saved without SLAM, or copied without its graph",
            path,
        ) from None
    except OSError as error:
        raise ConfigError(f"cannot read it: {error.strerror or error}", path) from None
    return decode(data, path)


def of_map(file: Path) -> SavedGraph:
    """The graph beside a map's .yaml. Raises ConfigError with a file's name."""
    if file.suffix not in (".yaml", ".yml"):
        raise ConfigError(
            f"expected the .yaml of a saved map, got {file.suffix or 'no ending'}", file
        )
    if not file.exists():
        raise ConfigError("there is no such file", file)
    return read(beside(file))


def decode(data: bytes, file: Path | str) -> SavedGraph:
    """The graph of the bytes of a file. Raises ConfigError with a file's name."""
    try:
        return _graph(_arrays(data))
    except ConfigError as error:
        raise error.at(file) from None


def _arrays(data: bytes) -> dict[str, _Array]:
    """Raises ConfigError for what is no such archive."""
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            size = sum(one.file_size for one in archive.infolist())
        if size > MOST_BYTES:
            raise ConfigError(f"{size:,} bytes of arrays; expected at most {MOST_BYTES:,}")
        with np.load(BytesIO(data), allow_pickle=False) as archive:
            if "version" not in archive or "poses" not in archive:
                raise ConfigError("not the graph of a map; `armadico map save` writes one")
            version = archive["version"]
            if version.shape or int(version) != VERSION:
                text = np.array2string(version, threshold=4)
                raise ConfigError(f"version {text}; this release reads version {VERSION}")
            return {name: _checked(name, archive) for name in ARRAYS}
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ConfigError(f"not the graph of a map, or damaged: {error}") from None
    except (ValueError, TypeError, OSError, NotImplementedError) as error:
        raise ConfigError(f"damaged: {error}") from None


def _checked(name: str, archive: Mapping[str, _Array]) -> _Array:
    kind, columns = ARRAYS[name]
    if name not in archive and name in NEWER:
        return np.zeros(len(archive[NEWER[name]]), dtype=kind)
    if name not in archive:
        raise ConfigError(f"damaged: no array {name!r}")
    found = archive[name]
    dimensions, width = (0 if columns == 0 else 2 if columns else 1), (columns,) if columns else ()
    if found.dtype != np.dtype(kind) or found.ndim != dimensions or found.shape[1:] != width:
        raise ConfigError(f"damaged: array {name!r} is {found.dtype} of {found.shape}")
    if found.dtype.kind == "f" and not (np.abs(found) < np.float64(1e15)).all():  # False for NaN
        raise ConfigError(f"damaged: array {name!r} has numbers that are not finite")
    return found


def _graph(arrays: Mapping[str, _Array]) -> SavedGraph:
    """Raises ConfigError for arrays that do not fit each other."""
    poses, ends = arrays["poses"], arrays["edge_ends"]
    count, edges = len(poses), len(ends)
    _expect(count > 0, "no key scans")
    for name in ("way", "part", "session"):
        _expect(len(arrays[name]) == count, f"{name}: expected {count} numbers")
    for name in ("edge_pose", "edge_information", "edge_loop", "edge_weight"):
        _expect(len(arrays[name]) == edges, f"{name}: expected {edges} rows")
    _expect(bool((np.abs(poses) < FARTHEST_M).all()), "poses: too far away")
    _expect(bool((np.diff(arrays["way"]) >= 0.0).all()), "way: it decreases")
    _expect(bool((arrays["part"] < count).all()), "part: too large")
    _expect(int(arrays["part"][0]) == 0, "part: expected 0 first")
    _expect(bool((np.diff(arrays["session"].astype(np.intp)) >= 0).all()), "session: it decreases")
    _expect(bool((ends < count).all()), f"edge_ends: expected numbers below {count}")
    _expect(bool((ends[:, 0] != ends[:, 1]).all()), "edge_ends: an edge from a pose to itself")
    joined = np.unique(ends.max(axis=1)) if edges else np.zeros(0)
    _expect(len(joined) == count - 1, "edges: the graph is not connected")
    information = np.zeros((edges, 3, 3))
    information[:, TRIANGLE[0], TRIANGLE[1]] = arrays["edge_information"]
    information[:, TRIANGLE[1], TRIANGLE[0]] = arrays["edge_information"]
    if edges:
        least = float(np.linalg.eigvalsh(information).min())
        _expect(least > 0.0, "edge_information: expected positive definite matrices")
    body = tuple(arrays["body"].tolist())
    _expect(len(body) == 3 and min(body) >= 0.0, "body: expected 3 lengths")
    return SavedGraph(
        poses.astype(np.float64),
        arrays["way"].astype(np.float64),
        arrays["part"].astype(np.intp),
        ends.astype(np.intp),
        arrays["edge_pose"].astype(np.float64),
        information,
        arrays["edge_loop"] == 1,
        arrays["edge_weight"].astype(np.float64),
        int(arrays["weak"]),
        _scans(arrays, count),
        (body[0], body[1], body[2]) if any(body) else None,
        arrays["session"].astype(np.intp),
    )


def _scans(arrays: Mapping[str, _Array], count: int) -> list[DrawnScan]:
    """The scans of a number of key scans. Raises ConfigError."""
    scan_of = arrays["scan_of"]
    scans = len(scan_of)
    for name in ("scan_offset", "scan_key", "scan_frame", "scan_rays"):
        _expect(len(arrays[name]) == scans, f"{name}: expected {scans} rows")
    _expect(bool((scan_of < count).all()), f"scan_of: expected numbers below {count}")
    _expect(bool((np.abs(arrays["scan_offset"]) < 100.0).all()), "scan_offset: too far away")
    owners = scan_of[arrays["scan_key"] == 1]
    _expect(np.array_equal(owners, np.arange(count)), "scan_key: expected one scan of each pose")
    step, reach = np.abs(arrays["scan_frame"][:, 3]), arrays["scan_frame"][:, 4]
    fits = (step >= FINEST_RAD) & (step <= 1.0) & (reach > 0.0) & (reach <= np.float32(REACH_M))
    _expect(bool(fits.all()), "scan_frame: a step or reach out of range")
    _expect(bool((arrays["scan_rays"] <= RAYS).all()), f"scan_rays: expected at most {RAYS}")
    lengths = np.cumsum(arrays["scan_rays"], dtype=np.int64)
    low, high = arrays["ranges_low"].astype("<u2"), arrays["ranges_high"].astype("<u2")
    total = int(lengths[-1]) if scans else 0
    _expect(len(low) == len(high) == total, f"ranges: expected {total}")
    steps = np.cumsum(low | (high << 8), dtype="<u2")
    _expect(bool((steps <= FREE // STEP_MM).all()), "ranges: too long")
    packed = (STEP_MM * steps).astype("<u2").tobytes()
    drawn = []
    begins = np.concatenate([[0], lengths[:-1]]).tolist()
    rows = zip(
        scan_of.tolist(),
        arrays["scan_offset"].astype(np.float64),
        arrays["scan_key"].tolist(),
        arrays["scan_frame"].tolist(),
        begins,
        lengths.tolist(),
        strict=True,
    )
    for number, (key, offset, is_key, frame, begin, end) in enumerate(rows):
        x, y, bearing, turn, far = frame
        scan = Scan(
            Cycle(1, number), x, y, bearing, turn, min(far, REACH_M), packed[2 * begin : 2 * end]
        )
        drawn.append(DrawnScan(key, offset, scan, bool(is_key)))
    return drawn


def _expect(fits: bool, otherwise: str) -> None:
    """Raises ConfigError if something is not as expected."""
    if not fits:
        raise ConfigError(f"damaged: {otherwise}")
