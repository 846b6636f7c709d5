"""Localize a robot over a log of range readings and odometry, and measure the error."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite, nan, radians
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from armadico.agents.slam.commands import log_file
from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import POSE, Command, Must, flag, option, several

if TYPE_CHECKING:
    from armadico.agents.slam.logs.localizing import Chosen, Summary, Track
    from armadico.agents.slam.logs.logs import Log


PROFILE: Final = "jackal"
"""The robot of a log that names none. Only its width and its laser matter; the scanner's angles and
reach are the log's."""

TIME: Final = Must(isfinite, "expected seconds of the log")

EVENTS: Final = 12
"""Most events that are printed."""

EXAMPLES: Final = """\
  armadico localize intel.npz                                on a map of the log's own scans
  armadico localize intel.npz --map-from first --over second
  armadico localize intel.log.gz --world office.yaml --start 1.5 2 90 --picture path.png
  armadico localize run.mcap --json                          in the world that it was recorded in
  armadico localize intel.npz --anywhere --from 600 --to 700
  armadico localize freiburg.npz --noise 0.15 --seed 2       errors added to a corrected path
"""


@dataclass(frozen=True, kw_only=True)
class Options(log_file.LogOptions):
    world: str | None = option(
        "the map (default: the one that a recording names, else one made from the log)",
        metavar="MAP",
    )
    map_from: str | None = option(
        "make the map from this part of the log's scans, at the reference poses (default: all)",
        choices=log_file.PARTS,
    )
    save_map: Path | None = option("save that map as .yaml or .map", metavar="FILE")
    begin: float | None = option(
        "begin at this time (default: the first reading)", "--from", metavar="S", must=TIME
    )
    end: float | None = option(
        "end at this time (default: the last reading)", "--to", metavar="S", must=TIME
    )
    start: tuple[float, float, float] | None = option(
        "the robot's pose at the first reading: m, m, degrees (default: the reference)",
        either="start",
        metavar=("X", "Y", "DEG"),
        must=POSE,
    )
    anywhere: bool = flag("start with an unknown pose", either="start")
    profile: str | None = option(
        f"the robot (default: the one that a recording names, else {PROFILE}); the scanner's"
        " angles are the log's",
        metavar="PROFILE",
    )
    agent: str | None = option(
        "the agent that corrects the pose (default: the only one installed)", metavar="NAME"
    )
    parameters: str | None = option("a set of agents' parameters (default: none)", metavar="SET")
    sets: tuple[str, ...] = several(
        "set a parameter of that agent; may be repeated", "--set", metavar="KEY=VALUE"
    )
    picture: Path | None = option("draw the paths on the map, and the error", metavar="FILE.png")


def run(args: Options) -> int:
    _check(args)
    from armadico.agents.slam.logs import localizing
    from armadico.cli.pool import progress

    say = options.reporter("armadico localize")
    log, noise = log_file.opened(args, say)
    chosen = _chosen(args, log)
    with TemporaryDirectory(prefix="armadico-") as folder:
        world, named = _world(args, log, Path(folder) / "map.yaml")
        _check_start(args, world)
        chosen = replace(chosen, world=world)
        run = localizing.Run(log, chosen, time.process_time)
        with progress("localize", len(chosen.readings)) as step:
            track = run.go(step)
        found = localizing.summary(track)
        if args.picture is not None:
            _draw(args.picture, log, world, track, found)
            say(f"picture: {args.picture}")
    judged = localizing.judgement(log, found)
    more: dict[str, object] = {
        "noise": noise,
        "map": named,
        "agent": chosen.agent,
        "sets": chosen.sets,
        "profile": chosen.profile,
        "anywhere": chosen.anywhere,
    }
    log_file.report(args, log, judged, found, _rows(found), noise, f"; map {named}", **more)
    if not args.json:
        _show_events(found)
    return log_file.conclude(judged, "the robot was localized, and never wrong and sure", say)


def _check(args: Options) -> None:
    """Raises UsageError, ConfigError or FailedError."""
    if args.world is not None and (args.map_from is not None or args.save_map is not None):
        raise UsageError("--world names a map; leave out --map-from and --save-map")
    if args.save_map is not None:
        options.check_map(args.save_map)
    if args.picture is not None:
        options.need("matplotlib", "plot")


def _world(args: Options, log: Log, path: Path) -> tuple[str, str]:
    """The agent's map, and its description. Raises ConfigError, LogError, OSError."""
    making = args.map_from is not None or args.save_map is not None
    named = args.world or (None if making else log.world)
    if named is not None:
        return named, named
    from armadico.agents.slam.logs import localizing
    from armadico.cli.pool import progress
    from armadico.config import grid_map
    from armadico.config.profile import load_profile

    of = args.map_from or log_file.PARTS[0]
    count = len(localizing.mapping(log, of))
    with progress("map", count) as step:
        cells = localizing.mapped(log, of, load_profile(_profile(args, log)), step)
    if args.save_map is not None:
        grid_map.save(cells, args.save_map)
    grid_map.save(cells, path)
    return str(path), f"made from {count} scans ({of})"


def _check_start(args: Options, world: str) -> None:
    """Raises UsageError if the start is not on the map, ConfigError if the map cannot be read."""
    from armadico.config.worlds import load_world

    if args.start is None:
        return
    (x, y, _), (west, south, east, north) = args.start, load_world(world).bounds
    if not (west <= x <= east and south <= y <= north):
        on_map = f"x from {west:g} to {east:g} m and y from {south:g} to {north:g} m"
        raise UsageError(f"--start {x:g} {y:g}: not on the map; expected {on_map}")


def _profile(args: Options, log: Log) -> str:
    from armadico.launch.society import profile_of

    return profile_of(args.profile) or log.profile or PROFILE


def _agent(args: Options) -> tuple[str, tuple[str, ...]]:
    """The agent that corrects the pose, and its settings. Raises UsageError, ConfigError."""
    from armadico.agents.slam.logs.localizing import correctors
    from armadico.config.loading import load_parameters
    from armadico.config.parameters import load_set
    from armadico.core.discovery import agent_class

    agents = correctors()
    name = args.agent or (agents[0] if len(agents) == 1 else "")
    if name not in agents:
        known = ", ".join(agents) or "none"
        raise UsageError(f"--agent {name}: expected an agent that corrects the pose: {known}")
    given = load_set(args.parameters) if args.parameters else {}
    sets = (*given.get(name, ()), *args.sets)
    load_parameters(agent_class(name).parameters, None, sets)
    return name, sets


def _chosen(args: Options, log: Log) -> Chosen:
    """What the options select, without the map. Raises UsageError, ConfigError."""
    from armadico.agents.slam.logs import localizing

    name, sets = _agent(args)
    begin = float("-inf") if args.begin is None else args.begin
    end = float("inf") if args.end is None else args.end
    every = log.part(args.over)
    readings = [i for i in every if begin <= log.time(i) <= end]
    if not readings:
        last = log.time(len(log) - 1)
        raise UsageError(f"--from, --to: no reading between them; the log ends at {last:.1f} s")
    start = None
    if args.start is not None:
        start = (args.start[0], args.start[1], radians(args.start[2]))
    return localizing.Chosen(
        world="",
        profile=_profile(args, log),
        readings=readings,
        agent=name,
        start=start,
        anywhere=args.anywhere,
        seed=args.seed,
        sets=sets,
    )


# Results ------------------------------------------------------------------------------------------


def _show_events(found: Summary) -> None:
    """Print when the robot was lost and found."""
    for event in found.events[:EVENTS]:
        off = "" if event.off_m is None else f", {event.off_m:.2f} m off"
        print(f"{event.t:8.1f} s  {event.event} at ({event.x:.2f}, {event.y:.2f}){off}")
    if len(found.events) > EVENTS:
        print(f"... and {len(found.events) - EVENTS} more")


def _rows(found: Summary) -> Iterator[tuple[str, str]]:
    yield "readings, seconds, metres", f"{found.scans}  {found.seconds:.0f}  {found.metres:.0f}"
    if found.error_median_m is not None:
        three = (found.error_median_m, found.error_95_m, found.error_most_m)
        yield "error: median, 95 %, most, m", log_file.each(three, 3)
        two = (found.heading_median_deg, found.heading_95_deg)
        yield "heading: median, 95 %, degrees", log_file.each(two, 2)
        yield "error over 0.3 m", _percent(found.off_share)
        way = f"{found.off_longest_s or 0.0:.0f} s, {found.off_longest_m or 0.0:.0f} m"
        yield "  longest", way
        yield "error over 0.5 m", _percent(found.far_share)
        yield "wrong and sure", _percent(found.wrong_sure_share)
        yield "  longest", f"{found.wrong_sure_longest_s or 0.0:.0f} s"
        two = (found.published_median_m, found.published_95_m)
        yield "published pose, error: median, 95 %, m", log_file.each(two, 3)
        yield "odometry alone, error: most, m", f"{found.odometry_most_m or 0.0:.1f}"
    else:
        yield "error", "the log has no reference"
    yield "reported lost", _percent(found.lost_share)
    yield "reported off the map", _percent(found.off_map_share)
    if found.found_s is not None:
        off = "" if found.found_off_m is None else f", {found.found_off_m:.2f} m off"
        yield "first found after", f"{found.found_s:.0f} s{off}"
    if found.deviation_median_m is not None:
        yield "deviation while not lost: median, m", f"{found.deviation_median_m:.3f}"
    spent = (found.scan_median_ms, found.scan_95_ms, found.most_ms)
    yield "processor: median, 95 %, most, ms", log_file.each(spent, 1)


def _percent(share: float | None) -> str:
    return f"{100.0 * (share or 0.0):.1f} %"


def _draw(picture: Path, log: Log, world: str, track: Track, found: Summary) -> None:
    """Draw the paths on the map, and the error over time."""
    from armadico.agents.slam.logs.localizing import errors
    from armadico.config.worlds import load_world
    from armadico.core.discovery import PICTURES, find

    moments = track.moments
    known = [one.reference or (nan, nan, nan) for one in moments]
    estimate = [(nan, nan) if one.lost else one.estimate[:2] for one in moments]
    paths: list[tuple[str, list[tuple[float, float]]]] = [("estimate", estimate)]
    if found.compared:
        paths.insert(0, ("reference", [at[:2] for at in known]))
    off, _ = errors(moments, "estimate")
    off_at = list(zip((one.t for one in moments), off.tolist(), strict=True))
    lost = [(a.t, b.t) for a, b in pairwise(moments) if a.lost]
    caption = f"reported lost at {_percent(found.lost_share)} of {found.scans} readings"
    if found.error_median_m is not None:
        caption = (
            f"error {found.error_median_m:.3f} m in the median, {found.error_95_m or 0.0:.3f} m"
            f" at 95 %, over 0.3 m at {_percent(found.off_share)}; {caption}"
        )
    title = f"{log.name}: {found.metres:.0f} m in {found.seconds:.0f} s"
    draw = find(PICTURES, "localized").load()
    draw(load_world(world), paths, off_at, lost, (title, caption), picture)


main: Final = Command(
    "armadico localize",
    Options,
    run,
    "Run the localization agent over a log and compare its pose with the log's reference. A log"
    " is an .npz file, a CARMEN log (also .gz), a recording of `armadico record` or a ROS bag. The"
    " same log, options and seed give the same numbers.",
    EXAMPLES,
)
