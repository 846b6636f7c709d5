"""Save the map that the robot has made by driving."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, argument, group

if TYPE_CHECKING:
    from armadico.runtime.client import Client

ANSWER_S: Final = 5.0
"""Timeout of the mapping agent's answer."""

FIND_S: Final = 3.0
"""Time to find a mapping agent."""

EXAMPLES: Final = """\
  armadico map save house.yaml     as a ROS map_server's: house.yaml and house.pgm
  armadico map save house.map      as an ARIA map: the borders of what is occupied
  armadico map save house.yaml --namespace robot2
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("the action", choices=("save",))
    file: Path = argument("the file to write; its name ends in .yaml or .map", metavar="FILE")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    from armadico.config.grid_map import check_suffix

    check_suffix(args.file)
    with args.mesh.client() as client:
        print(save(client, args.file))
    return 0


def save(client: Client, file: Path) -> str:
    """Save the map; returns a summary. Raises AbsentError, FailedError or ConfigError."""
    from armadico.config import grid_map
    from armadico.mobile.messages import MapRequest, OccupancyGrid
    from armadico.runtime.errors import AbsentError

    grid = client.query(MapRequest(), ANSWER_S, patience=FIND_S)
    if not isinstance(grid, OccupancyGrid):
        raise AbsentError("no agent that makes a map is alive", client.mesh.namespace)
    try:
        cells = grid_map.cells_of(grid)
        if not cells.states.size:
            raise options.FailedError("the map is empty: no sensor has measured anything yet")
        files = grid_map.save(cells, file)
    except ValueError as error:
        raise options.FailedError(f"the mapping agent's map is invalid: {error}") from None
    except OSError as error:
        raise options.FailedError(f"cannot write {file}: {error.strerror}") from None
    rows, columns = cells.states.shape
    written = " and ".join(map(str, files))
    free = cells.area(grid_map.FREE)
    return f"{written}: {columns} x {rows} cells of {cells.cell_m:g} m, {free:.1f} m^2 of it free"


main: Final = Command(
    "armadico map",
    Options,
    run,
    "Save the mapping agent's map. `armadico explore --resume` continues from a .yaml; `armadico"
    " run --world` drives in either.",
    EXAMPLES,
)
