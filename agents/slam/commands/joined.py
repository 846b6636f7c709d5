"""Two sessions in one building, by `armadico slam --onto` and `armadico map join`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from armadico.agents.methods.poses import compose, relative
from armadico.agents.slam.commands import log_file, view
from armadico.agents.slam.commands.run import Mapped, graph_of, path_of
from armadico.agents.slam.joining import Found, Joined, joined, steps
from armadico.agents.slam.logs.logs import Log
from armadico.agents.slam.slam import SlamParameters
from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.pool import progress
from armadico.config import graph_file, grid_map
from armadico.config.graph_file import SavedGraph
from armadico.config.grid_map import Cells
from armadico.config.writing import held
from armadico.core.judgement import Judgement, unknown, yes

CURE: Final = (
    "check that both are of one building and that none is mirrored; drive 10 m or more through"
    " places that the map shows"
)


def opened(maps: Sequence[Path], outputs: Sequence[Path]) -> list[SavedGraph]:
    """The graphs of maps. They are locked only while they are read: a robot may save one later.

    Raises UsageError if an output would replace one of them, ConfigError with a file's name for
    what is no map or is being written.
    """
    for output in outputs:
        if any(_files(output) & _files(one) for one in maps):
            raise UsageError(f"-o: {output}: that map is read, and it is kept: name another one")
    return [_read(one) for one in maps]


def _files(path: Path) -> set[Path]:
    """The files of a map, each behind its links, which writing follows."""
    return {one.resolve() for one in (path, path.with_suffix(".pgm"), graph_file.beside(path))}


def _read(path: Path) -> SavedGraph:
    with held(path, alone=False):
        return graph_file.of_map(path)


# The search ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Merged:
    """A log and the map that it continues."""

    both: Joined | None  # None: nothing is merged
    found: Mapped  # the log's, on the map if it is merged
    figures: dict[str, object]
    judgement: Judgement

    @property
    def rows(self) -> Iterator[tuple[str, str]]:
        """For people."""
        f = self.figures
        yield (
            "on the map: searches, places, that agree",
            "  ".join(str(f[name]) for name in ("searches", "places", "agree")),
        )
        if self.both is not None:
            yield "  loops with the map", str(f["loops"])
            yield (
                "  way that fits it, that contradicts it, m",
                log_file.each((float(str(f["fits_m"])), float(str(f["contradicts_m"]))), 1),
            )


def merged(
    earlier: SavedGraph, log: Log, found: Mapped, parameters: SlamParameters, name: str
) -> Merged:
    """Join a log's map to an earlier map of this name, if it is proved to be of its building."""
    both = _sought(earlier, graph_of(log, found.slam), parameters)
    judged = judgement(both, log.name, name)
    if not isinstance(both, Joined):
        return Merged(None, found, figures(both), judged)
    return Merged(both, _moved(log, found, both), figures(both.parts), judged)


def _sought(
    earlier: SavedGraph, later: SavedGraph, parameters: SlamParameters
) -> Joined | tuple[Found, ...]:
    with progress("join", steps(later)) as step:
        return joined(earlier, later, parameters, step)


def _moved(log: Log, found: Mapped, both: Joined) -> Mapped:
    """A log's map and path where they lie on the map that it was joined to."""
    scans, evidence = found.slam.map, found.slam.evidence
    after = both.graph.poses[both.first :]
    shift = compose(after[0], relative(scans.poses[0], np.zeros(3)))
    evidence.contradictions = [one.moved(shift) for one in evidence.contradictions]
    scans.poses = after
    online = compose(shift, found.online)
    return replace(found, path=path_of(log, found.slam), online=online)


def judgement(found: Joined | tuple[Found, ...], later: str, earlier: str) -> Judgement:
    """Whether a later map lies on an earlier one, by their names; what speaks against it."""
    parts = found.parts if isinstance(found, Joined) else found
    apart = [one for one in parts if one.refusal]
    if not isinstance(found, Joined):
        first = parts[0]
        return unknown(
            f"nothing is merged: it is not proved that {later} is of the building of {earlier}:"
            f" {first.refusal} ({first.searches} places searched, {first.places} found,"
            f" {first.agree} agree)",
            CURE,
        )
    if apart:
        which = f"{len(apart)} of {len(parts)} parts of {later}"
        return unknown(f"the places of {which} on {earlier} are not known", CURE)
    return yes()


def figures(parts: Sequence[Found]) -> dict[str, object]:
    """What was found, of all parts together."""
    overlaps = [one.overlap for one in parts if one.overlap is not None]
    return {
        "merged": any(not one.refusal for one in parts),
        "searches": sum(one.searches for one in parts),
        "places": sum(one.places for one in parts),
        "agree": sum(one.agree for one in parts),
        "loops": sum(one.loops for one in parts),
        "fits_m": sum(one.fits for one in overlaps),
        "contradicts_m": sum(one.contradicts for one in overlaps),
    }


# Files --------------------------------------------------------------------------------------------


def draw(both: Joined, every: Cells, picture: Path) -> str:
    """Draw what is new and what is gone on the joined grid; a line about it. Raises OSError."""
    graph = both.graph
    later = np.arange(len(graph.poses)) >= both.first
    before, after = (graph.drawn(which=graph.main & one) for one in (~later, later))
    shown = view.changed(before, after, every)
    shown.image.save(picture, format="PNG")
    return (
        f"picture of what has changed: {picture}: new {shown.new:.1f} m^2, gone {shown.gone:.1f}"
        f" m^2, seen for the first time {shown.first:.1f} m^2"
    )


def join(earlier: Path, later: Path, output: Path, picture: Path | None) -> int:
    """`armadico map join`: join two maps of one building; the exit code."""
    say = options.reporter("armadico map")
    options.check_map(output)
    view.check(picture)
    one, other = opened([earlier, later], [output])
    found = _sought(one, other, SlamParameters())
    if isinstance(found, Joined):
        for line in _write(found, output, picture):
            say(line)
    judged = judgement(found, str(later), str(earlier))
    return log_file.conclude(judged, "both maps are one, as far as they show", say)


def _write(both: Joined, output: Path, picture: Path | None) -> Iterator[str]:
    """Write a joined map; a line about each file. Raises FailedError, ConfigError."""
    cells, at = both.graph.drawn(), output
    more = {graph_file.beside(output): graph_file.encode(both.graph)}
    try:
        written = grid_map.save(cells, output, {} if output.suffix == ".map" else more)
        yield "map: " + ", ".join(map(str, written))
        if picture is not None:
            at = picture
            yield draw(both, cells, picture)
    except OSError as error:
        raise FailedError(f"cannot write {at}: {error.strerror or error}") from None
