"""Logs of real robots: the localization agent beside a plain filter, on own and on half maps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from msgspec import Struct

from armadico.agents.slam.logs import localizing, logs
from armadico.agents.slam.logs.localizing import Chosen, Summary
from armadico.agents.slam.logs.logs import Log, LogError, Scans
from armadico.config import grid_map
from armadico.config.profile import load_profile
from armadico.core.config_errors import ConfigError
from armadico_tools.experiments.likelihood_filter import LikelihoodFilter, filtered, points
from armadico_tools.experiments.runner import Context, Experiment, Part, Table
from armadico_tools.markdown import table

SUFFIXES: Final = (".npz", ".log", ".gz", ".clf", ".mcap")
NOISES: Final = (0.05, 0.15)
"""Errors that are added to an odometry that is a corrected path."""

MAPS: Final = {"all": "all", "first": "second", "second": "first"}
"""The part of a log that the map is made of, and the part for the run."""

AGENT: Final = "localization"
PLAIN: Final = "plain filter"
PROFILE: Final = "jackal"
PLACES: Final = 10
FOUND_S: Final = 60.0
SCANS_MOST: Final = 200
"""Most scans for computing the share of rays that the map explains."""

NOTE: Final = (
    "The map is made of the log's own scans at its reference poses, by the mapper of the mapping"
    " agent. *all*: the map is of all scans, and so is the run; *first to second*: the map is of"
    " the first half, by time, and the run of the second. If the odometry is a corrected path,"
    " errors are added that the seed draws: *errors* is their share of ways and turns. *plain"
    " filter*: 3,000 particles on a likelihood field, with the same scans, odometry and map; it"
    " never reports that it is lost. *on the map*: the share of a scan's rays that end within"
    " 0.15 m of a wall of the map if the robot is at the reference pose, in the median. *over"
    " 0.3 m*, *lost*, *wrong and sure* are shares of the readings; wrong and sure is an estimate"
    " that is more than 0.5 m off, reports a deviation of less than 0.5 m and is not lost. *ms*:"
    " processor time of a cycle with a scan, median and 95 %, and the most of any cycle. A cell"
    " shows the least and the most of the seeds."
)
FOUND_NOTE: Final = (
    f"The agent starts at {PLACES} places evenly spread over each log, on the map of all its scans,"
    f" without knowing where it is, and has {FOUND_S:g} s of the log. *wrong*: wrong and sure,"
    " as above, at any time."
)


class Task(Struct, frozen=True):
    """One run; its text is the key of its stored result."""

    log: str
    content: str  # a hash of the file
    noise: float
    map_of: str  # the file that the map is made of
    part: str  # the part of that file
    over: str
    seed: int
    by: str
    place: int = -1  # index of an unknown start; -1: the start is known
    folder: str = ""  # of maps


class Row(Struct, frozen=True):
    """The result of one run."""

    log: str
    noise: float
    part: str
    over: str
    seed: int
    by: str
    place: int
    found: Summary | None  # None: the run was impossible, see `why`
    why: str = ""


class Explained(Struct, frozen=True):
    """The share of a log's scans that a map explains."""

    log: str
    part: str
    over: str
    share: float


def files(folder: Path | None) -> Iterator[Path]:
    """The logs of a folder, or one log. Raises LogError."""
    if folder is None:
        raise LogError("name the folder of logs: armadico experiment logs FOLDER")
    if folder.is_file():
        yield folder
        return
    found = sorted(path for path in folder.glob("*") if path.suffix in SUFFIXES)
    if not found:
        raise LogError(f"has no logs ({', '.join(SUFFIXES)})", folder)
    yield from found


def tasks_of(
    path: Path, every: Sequence[Path], seeds: Sequence[int], folder: Path
) -> Iterator[Task]:
    """The runs of one log; none if it is unreadable, or has no scans or no reference."""
    try:
        log = logs.read(path)
    except LogError:
        return
    if not log.known.any() or not isinstance(log.readings, Scans):
        return
    content = sha256(path.read_bytes()).hexdigest()[:12]
    # Half maps of a log with few references are made from its twin, if it has one.
    twin = next((other for other in every if path.stem == f"{other.stem}-dense"), path)
    noises = (0.0,) if log.real else NOISES
    for noise in noises:
        for part, over in MAPS.items():
            map_of = path if part == "all" else twin
            for seed in seeds:
                for by in (AGENT, PLAIN):
                    yield Task(
                        *(str(path), content, noise, str(map_of), part, over, seed, by),
                        folder=str(folder),
                    )
    for place in range(PLACES):
        yield Task(
            *(str(path), content, noises[0], str(path), "all", "all", seeds[0], AGENT),
            place=place,
            folder=str(folder),
        )


def _without_seed(task: Task) -> Task:
    """The task without the fields that do not change the share of rays on the map."""
    return msgspec.structs.replace(task, noise=0.0, seed=0, by="")


def make(item: tuple[str, str, str]) -> str:
    """Make the map of a part of a log, unless it exists. Returns its file."""
    log, part, folder = item
    path = Path(folder) / f"{Path(log).stem}-{part}.yaml"
    if not path.is_file():
        try:
            cells = localizing.mapped(logs.read(Path(log)), part, load_profile(PROFILE))
        except LogError:
            return ""  # each run of it reports why
        grid_map.save(cells, path)
    return str(path)


def explain(task: Task) -> Explained:
    """The share of a log's scans that its map explains, at the reference poses."""
    log, path = logs.read(Path(task.log)), make((task.map_of, task.part, task.folder))
    name = Path(task.log).stem
    chosen = [i for i in log.part(task.over) if log.where(i) is not None]
    if not chosen or not path:
        return Explained(name, task.part, task.over, 0.0)
    plain = LikelihoodFilter(grid_map.read(path), np.random.default_rng(0))
    some = chosen[:: max(1, len(chosen) // SCANS_MOST)]
    shares = [plain.explained(points(log, i), at) for i in some if (at := log.where(i)) is not None]
    return Explained(name, task.part, task.over, round(float(np.median(shares)), 3))


def drive(task: Task) -> Row:
    """One run, for a worker process."""
    about = (Path(task.log).stem, task.noise, task.part, task.over, task.seed, task.by, task.place)
    try:
        return Row(*about, _localize(task))
    except ConfigError as error:
        return Row(*about, None, str(error))


def _localize(task: Task) -> Summary:
    log = logs.read(Path(task.log))
    if task.noise:
        log = logs.with_errors(log, task.noise, task.seed)
    path = make((task.map_of, task.part, task.folder))
    if not path:
        localizing.mapped(logs.read(Path(task.map_of)), task.part, load_profile(PROFILE))
    readings = log.part(task.over)
    if task.by == PLAIN:
        cells = grid_map.read(path)
        return localizing.summary(filtered(log, cells, readings, task.seed, time.process_time))
    chosen = Chosen(path, PROFILE, readings, AGENT, seed=task.seed)
    if task.place >= 0:
        chosen = replace(chosen, readings=_from(log, readings, task.place), anywhere=True)
    return localizing.summary(localizing.Run(log, chosen, time.process_time).go())


def _from(log: Log, readings: Sequence[int], place: int) -> list[int]:
    """The readings for a run with an unknown start."""
    known = [i for i in readings if log.where(i) is not None]
    first = known[place * len(known) // PLACES]
    end = log.time(first) + FOUND_S
    return [i for i in readings if i >= first and log.time(i) <= end]


# Tables -------------------------------------------------------------------------------------------


def _rows(found: Sequence[Row]) -> Table:
    """A row for each run that was possible."""
    about = ("log", "noise", "part", "over", "seed", "by", "place")
    measures = [name for name in Summary.__struct_fields__ if name != "events"]
    return (*about, *measures, "lost_at"), [
        (
            *(getattr(row, name) for name in about),
            *(getattr(row.found, name) for name in measures),
            " ".join(f"{one.event}@{one.t:g}" for one in row.found.events),
        )
        for row in found
        if row.found is not None
    ]


def tracked(rows: Sequence[Row], shares: dict[tuple[str, str, str], float]) -> str:
    """A row for each log, errors and map, for the agent and the plain filter."""
    head = (
        *("log", "errors", "map", "on the map", "by", "median m", "95 % m", "heading deg"),
        *("over 0.3 m", "longest", "lost", "wrong and sure", "ms"),
    )
    cells = []
    for key in dict.fromkeys((row.log, row.noise, row.part, row.over) for row in rows):
        for by in (AGENT, PLAIN):
            found = [
                row.found
                for row in rows
                if (row.log, row.noise, row.part, row.over, row.by) == (*key, by) and row.found
            ]
            if found:
                log, noise, part, over = key
                way = part if part == over else f"{part} to {over}"
                share = f"{100.0 * shares.get((log, part, over), 0.0):.0f} %"
                errors = f"{noise:g}" if noise else "real"
                cells.append((log, errors, way, share, by, *_measures(found)))
    return table(head, cells)


def _measures(found: Sequence[Summary]) -> Iterator[str]:
    def span(of: Callable[[Summary], float | None], form: str, unit: str = "") -> str:
        values = [value for one in found if (value := of(one)) is not None]
        if not values:
            return "-"
        texts = list(dict.fromkeys(f"{value:{form}}" for value in (min(values), max(values))))
        return " to ".join(texts) + unit

    def percent(share: float | None) -> float | None:
        return None if share is None else 100.0 * share

    yield span(lambda one: one.error_median_m, ".3f")
    yield span(lambda one: one.error_95_m, ".3f")
    yield span(lambda one: one.heading_median_deg, ".2f")
    yield span(lambda one: percent(one.off_share), ".1f", " %")
    yield span(lambda one: one.off_longest_s, ".0f", " s")
    yield span(lambda one: percent(one.lost_share), ".1f", " %")
    yield span(lambda one: percent(one.wrong_sure_share), ".1f", " %")
    spent = ("scan_median_ms", "scan_95_ms", "most_ms")
    yield "; ".join(f"{np.median([getattr(one, name) for one in found]):.1f}" for name in spent)


def globally(rows: Sequence[Row]) -> str:
    """A row for each log: the number of places that were found."""
    head = ("log", "errors", f"found in {FOUND_S:g} s", "wrong", "median s", "most s", "off m")
    cells = []
    for key in dict.fromkeys((row.log, row.noise) for row in rows):
        some = [row.found for row in rows if (row.log, row.noise) == key and row.found]
        if not some:
            continue
        found = [one for one in some if one.found_s is not None]
        times = [one.found_s for one in found if one.found_s is not None]
        off = [one.found_off_m for one in found if one.found_off_m is not None]
        wrong = sum((one.wrong_sure_share or 0.0) > 0.0 for one in some)
        middle = f"{np.median(times):.0f}" if times else "-"
        log, noise = key
        cells.append(
            (
                *(log, f"{noise:g}" if noise else "real", f"{len(found)} of {len(some)}", wrong),
                *(middle, f"{max(times):.0f}" if times else "-"),
                f"{np.median(off):.2f}" if off else "-",
            )
        )
    return table(head, cells)


# The experiment -----------------------------------------------------------------------------------


def _tasks(context: Context) -> list[Task]:
    found, folder = list(files(context.logs)), context.out / "maps"
    folder.mkdir(exist_ok=True)
    return [task for path in found for task in tasks_of(path, found, context.seeds, folder)]


def _maps(context: Context) -> list[tuple[str, str, str]]:
    return list(dict.fromkeys((t.map_of, t.part, t.folder) for t in _tasks(context)))


def _explained(context: Context) -> list[Task]:
    return list(dict.fromkeys(_without_seed(t) for t in _tasks(context) if t.place < 0))


def _report(context: Context) -> str:
    """A table of the runs with a known start, and one of those without."""
    rows = context.found["logs"]
    context.summary = {
        f"{row.log} {row.noise:g} {row.part} {row.over} {row.seed} {row.by} {row.place}": (
            row.why if row.found is None else msgspec.to_builtins(row.found)
        )
        for row in rows
    }
    known = [row for row in rows if row.place < 0]
    unknown = [row for row in rows if row.place >= 0]
    shares = {(one.log, one.part, one.over): one.share for one in context.found["scans on maps"]}
    why = "\n".join(dict.fromkeys(f"- {row.log}: {row.why}." for row in rows if row.why))
    return (
        f"{tracked(known, shares)}\n\n# Without knowing the start\n\n"
        f"{FOUND_NOTE}\n\n{globally(unknown)}\n\n{why}"
    )


LOGS: Final = Experiment(
    note=NOTE,
    parts=(
        Part("maps", make, _maps, None),
        Part("scans on maps", explain, _explained, None),
        Part("logs", drive, _tasks, _rows, repeatable=False),
    ),
    report=_report,
    runs=3,
    first_seed=1,
)
