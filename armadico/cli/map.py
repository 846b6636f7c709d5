"""Save the map that the robot has made by driving."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options

if TYPE_CHECKING:
    from armadico.runtime.client import Client

ANSWER_S: Final = 5.0
"""What the mapping agent may take."""

FIND_S: Final = 3.0
"""How long it is looked for."""

EXAMPLES: Final = """\
  armadico map save house.yaml     as a ROS map_server's: house.yaml and house.pgm
  armadico map save house.map      as an ARIA map: the borders of what is occupied
  armadico map save house.yaml --namespace robot2
"""


def main(argv: Sequence[str]) -> int:
    args = parser().parse_args(argv)
    from armadico.config.grid_map import check_suffix  # noqa: PLC0415 - heavy

    check_suffix(args.file)
    from armadico.runtime.client import Client  # noqa: PLC0415 - heavy

    with options.joined(args) as mesh:
        print(save(Client(mesh), args.file))
    return 0


def parser() -> argparse.ArgumentParser:
    made = options.parser(
        "armadico map",
        "Ask the mapping agent for its map and save it. `armadico explore --resume` goes on with a"
        " .yaml; `armadico run --world` drives in either.",
        EXAMPLES,
    )
    made.add_argument("what", choices=("save",), help="what to do with the map")
    made.add_argument("file", metavar="FILE", type=Path, help="its name ends in .yaml or .map")
    options.add_mesh_options(made)
    return made


def save(client: Client, file: Path) -> str:
    """Write the map to a file; a line about it. Raises AbsentError, FailedError or ConfigError."""
    from armadico.config import grid_map  # noqa: PLC0415 - heavy
    from armadico.mobile.messages import MapRequest, OccupancyGrid  # noqa: PLC0415 - heavy
    from armadico.runtime.errors import AbsentError  # noqa: PLC0415 - not for --help

    grid = client.ask(MapRequest(), ANSWER_S, patience=FIND_S)
    if not isinstance(grid, OccupancyGrid):
        raise AbsentError("no agent that makes a map is alive", client.mesh.namespace)
    try:
        cells = grid_map.cells_of(grid)
        if not cells.states.size:
            raise options.FailedError("nothing is mapped yet: the robot has not pinged anything")
        files = grid_map.save(cells, file)
    except ValueError as error:
        raise options.FailedError(f"the map that came is none: {error}") from None
    except OSError as error:
        raise options.FailedError(f"cannot write {file}: {error.strerror}") from None
    rows, columns = cells.states.shape
    written = " and ".join(map(str, files))
    free = cells.area(grid_map.FREE)
    return f"{written}: {columns} x {rows} cells of {cells.cell_m:g} m, {free:.1f} m^2 of it free"
