"""Save the map that the robot has made by driving, or have it continue a saved one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, group, option

if TYPE_CHECKING:
    from armadico.config.graph_file import SavedGraph
    from armadico.launch.client import Client
    from armadico.mobile.messages import MapGraphPart, MapGraphRequest

ANSWER_S: Final = 5.0
"""Timeout of the agent's answer."""

FIND_S: Final = 3.0
"""Time to find an agent that makes a map."""

EXAMPLES: Final = """\
  armadico map save house.yaml     as a ROS map_server's: house.yaml and house.pgm
  armadico map save house.map      as an ARIA map: the borders of what is occupied
  armadico map save house.yaml --namespace robot2
  armadico map load house.yaml     the agent slam finds the robot on it and goes on with it
  armadico set slam mapping=false  localize on the map and add nothing to it
  armadico map join monday.yaml tuesday.yaml -o house.yaml --picture changes.png
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("the action", choices=("save", "load", "join"))
    files: tuple[Path, ...] = argument(
        "the file; its name ends in .yaml or, to save, .map. To join: two maps, the earlier first",
        nargs="+",
        metavar="FILE",
    )
    output: Path | None = option(
        "write the map that two were joined to", "-o", "--output", metavar="FILE"
    )
    picture: Path | None = option("draw what is new and what is gone on it", metavar="FILE.png")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    from armadico.config import graph_file
    from armadico.config.grid_map import check_suffix

    if args.what == "join":
        return _join(args)
    if len(args.files) != 1 or args.output is not None or args.picture is not None:
        raise UsageError(f"{args.what}: expected one file, without -o and --picture")
    (file,) = args.files
    check_suffix(file)
    if args.what == "load":
        graph = graph_file.of_map(file)
    with args.mesh.client() as client:
        print(save(client, file) if args.what == "save" else load(client, graph, file))
    return 0


def _join(args: Options) -> int:
    """Join two maps by the installed package that can; the exit code."""
    from armadico.core.discovery import MAPS, find

    if len(args.files) != 2 or args.output is None:
        raise UsageError("join: expected two maps and -o FILE, as in A.yaml B.yaml -o BOTH.yaml")
    join: Callable[[Path, Path, Path, Path | None], int] = find(MAPS, "join").load()
    return join(*args.files, args.output, args.picture)


def save(client: Client, file: Path) -> str:
    """Save the map; returns a summary. Raises AbsentError, FailedError or ConfigError.

    The agent slam also has a graph, to go on with the map. Its file is written beside the map,
    which is drawn of it: both are of the same revision.
    """
    from armadico.config import graph_file, grid_map
    from armadico.mobile.messages import MapRequest, OccupancyGrid
    from armadico.runtime.errors import AbsentError

    grid = client.query(MapRequest(), ANSWER_S, patience=FIND_S)
    if not isinstance(grid, OccupancyGrid):
        raise AbsentError("no agent that makes a map is alive", client.mesh.namespace)
    graph = _graph(client) if grid.revision else None
    beside = graph_file.beside(file)
    try:
        cells = grid_map.cells_of(grid) if graph is None else graph.drawn()
        if not cells.states.size:
            raise options.FailedError(
                "the map is empty: no sensor has measured anything yet, or nothing that agrees with"
                " the map that was to be continued"
            )
        more, apart = {}, 0 if graph is None else int((~graph.main).sum())
        replaced = file.suffix != ".map" and beside.exists()
        if apart and replaced:
            kept, file = file, options.apart(file)
            beside = graph_file.beside(file)
        if graph is not None and file.suffix != ".map":
            more[beside] = graph_file.encode(graph)
        files = grid_map.save(cells, file, more)
        if replaced and beside not in files:
            beside.unlink(missing_ok=True)
    except ValueError as error:
        raise options.FailedError(f"the mapping agent's map is invalid: {error}") from None
    except OSError as error:
        raise options.FailedError(f"cannot write {file}: {error.strerror}") from None
    rows, columns = cells.states.shape
    *others, last = map(str, files)
    free = cells.area(grid_map.FREE)
    text = (
        f"{', '.join(others)} and {last}: " if others else f"{last}: "
    ) + f"{columns} x {rows} cells of {cells.cell_m:g} m, {free:.1f} m^2 of it free"
    if apart:
        text += f"; {apart} key scans whose place on it is unknown are only in the graph"
    if apart and replaced:
        text += f"; {kept} is kept, since the robot may not have found its place on it"
    elif replaced and graph is None:
        text += f"; {beside} is removed, since it belongs to the map before"
    return text


def _graph(client: Client) -> SavedGraph | None:
    """The graph of the agent slam; None if nothing is mapped. Raises FailedError, ConfigError."""
    from armadico.config import graph_file, graph_parts
    from armadico.mobile.messages import MapGraphPart

    def ask(request: MapGraphRequest) -> MapGraphPart | None:
        reply = client.query(request, ANSWER_S)
        return reply if isinstance(reply, MapGraphPart) else None

    data = graph_parts.read(ask)
    if data is None:
        raise options.FailedError(f"the agent slam did not send its graph within {ANSWER_S:g} s")
    return graph_file.decode(data, "the graph of the agent slam") if data else None


def load(client: Client, graph: SavedGraph, file: Path) -> str:
    """Have the agent slam continue a map; returns a summary. Raises AbsentError, FailedError."""
    from armadico.config import graph_file, graph_parts
    from armadico.mobile.messages import MapLoadReply
    from armadico.runtime.errors import AbsentError

    for request in graph_parts.parts_of(graph_file.encode(graph, compressed=False)):
        reply = client.query(request, ANSWER_S, patience=FIND_S)
        if not isinstance(reply, MapLoadReply):
            names = dict(sorted(client.alive))
            if (instance := names.get("localization")) is not None:
                raise options.FailedError(
                    f"{instance} localizes on the world that it was started with; to drive on this"
                    f" map, start it with --world {file}"
                )
            if (instance := names.get("mapping")) is not None:
                raise options.FailedError(
                    f"{instance} maps at the pose of the odometry and cannot find the robot on a"
                    f" map; start it with `armadico explore --resume {file}`"
                )
            raise AbsentError("no agent slam is alive", client.mesh.namespace)
        if reply.refusal:
            raise options.FailedError(f"{file}: refused: {reply.refusal}")
    return (
        f"{file}: {len(graph.poses)} key scans loaded; the robot finds its place on the map while"
        " it drives or turns"
    )


main: Final = Command(
    "armadico map",
    Options,
    run,
    "Save the map that the robot makes, have the agent slam continue a saved one, or join two maps"
    " of one building, if they are proved to be. `armadico"
    " explore --resume` continues from a .yaml; `armadico run --world` drives in either. A map by"
    " SLAM has a third file, FILE.graph.npz, with its scans; to continue, it must be there.",
    EXAMPLES,
)
