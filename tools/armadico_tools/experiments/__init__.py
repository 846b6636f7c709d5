"""The list of experiments: modules of this package, and files of `cells/`.

`docs/results/README.md` lists removed experiments, with their results and the last commit that has
them.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.parsing import Must, option, several

MODULES: Final = {
    "random-rooms": (
        "Random rooms: generated floor plans with furniture",
        "foreign_worlds:RANDOM_ROOMS",
    ),
    "floors": (
        "Floors: generated floor plans with people, real sensors",
        "foreign_worlds:FLOORS",
    ),
    "gate": (
        "The price of the gate: floor plans with and without it, by sonars and by laser",
        "foreign_worlds:GATE",
    ),
    "other-maps": (
        "Maps of other formats: goals between free places",
        "foreign_worlds:OTHER_MAPS",
    ),
    "barn": ("The BARN challenge: fields of cylinders, no map", "barn:BARN"),
    "exploration": (
        "Explorations by SLAM: shipped worlds and floor plans, real sensors",
        "exploration:EXPLORATION",
    ),
    "lifted": (
        "Lifted robots: put down elsewhere in mid-run, by sonars and by laser",
        "lifted:LIFTED",
    ),
    "logs": (
        "Logs of real robots: the localization agent beside a plain filter",
        "logs:LOGS",
    ),
}
"""The title of each, and where its `Experiment` is; a module is imported only to run it."""

CELLS: Final = {path.stem: path for path in sorted(Path(__file__).parent.glob("cells/*.toml"))}

RUNS: Final = 30
FIRST_SEED: Final = 1000
"""Seeds below this one were used to choose parameters; results are reported from it on."""


def titles() -> dict[str, str]:
    """The titles of all experiments, by name."""
    read = {name: tomllib.loads(path.read_text("utf-8"))["title"] for name, path in CELLS.items()}
    return read | {name: title for name, (title, _) in MODULES.items()}


@dataclass(frozen=True, kw_only=True)
class Barn:
    """The choices for the BARN challenge; by default all."""

    worlds: tuple[int, ...] = several("run world N (default: all)", metavar="N")
    robots: tuple[str, ...] = several("run PROFILE, a row each", "--robot", metavar="PROFILE")
    v_max: float | None = option(
        "limit the speed (default: none)",
        metavar="M/S",
        must=Must(lambda speed: 0.0 < speed <= 10.0, "expected more than 0, and at most 10"),
    )
    data: Path | None = option("read worlds from a barn.txt or JSON file", metavar="FILE")
