"""The list of experiments: modules of this package, and files of `cells/`.

`docs/results/README.md` lists removed experiments, with their results and the last commit that has
them.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.parsing import Must, flag, option, several
from armadico.core.installed import entries, package

MODULES: Final = {
    "gate": (
        "The price of the gate: floor plans with and without it, by sonars and by laser",
        "gate:GATE",
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
    "foretold": (
        "Foretold drives: each rehearsed from what the robot knows, then driven",
        "foretold:FORETOLD",
    ),
    "allocation": (
        "Tasks between robots by ballots, contract net, ALLIANCE, and a central allocator",
        "allocation:ALLOCATION",
    ),
    "logs": (
        "Logs of real robots: the localization agent beside a plain filter",
        "logs:LOGS",
    ),
    "rivals": (
        "Rivals: coordination mechanisms where agents' wishes conflict, as docs/rivals-plan.md",
        "rivals:RIVALS",
    ),
}
"""The title of each, and where its `Experiment` is; a module is imported only to run it."""

CELLS: Final = {path.stem: path for path in sorted(Path(__file__).parent.glob("cells/*.toml"))}

RUNS: Final = 30
FIRST_SEED: Final = 1000
"""Seeds below this one were used to choose parameters; results are reported from it on."""


SITUATIONS: Final = (
    *("slalom", "clutter", "furniture", "blind-end", "people", "liar"),
    *("two-goals", "battery"),
)
BEHAVIOURS: Final = {"default": None, "thesis": "thesis"}
"""Sets of parameters by their names in the rivals study."""

YARDSTICKS: Final = ("pure-pursuit", "dwa")
"""Agents that drive the rivals study's worlds alone, outside the comparison."""


OTHERS: Final = "armadico.experiments"
"""Entry points of other packages: objects of `runner.Experiment`."""


def titles() -> dict[str, str]:
    """The titles of all experiments, by name; those of other packages are not imported."""
    others = {point.name: f"Of the package {package(point)}" for point in entries(OTHERS)}
    read = {name: tomllib.loads(path.read_text("utf-8"))["title"] for name, path in CELLS.items()}
    return others | read | {name: title for name, (title, _) in MODULES.items()}


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


@dataclass(frozen=True, kw_only=True)
class Rivals:
    """The choices for the rivals study; by default all. `--runs` is its number of worlds."""

    mechanism: tuple[str, ...] = several(
        "compare NAME of --coordination with ballots (default: each installed one)", metavar="NAME"
    )
    situation: tuple[str, ...] = several(
        f"drive in these worlds: {', '.join(SITUATIONS)} (default: all)",
        metavar="NAME",
        choices=SITUATIONS,
    )
    behaviours: tuple[str, ...] = several(
        f"with these sets of parameters: {', '.join(BEHAVIOURS)} (default: all)",
        metavar="NAME",
        choices=tuple(BEHAVIOURS),
    )
    told: tuple[str, ...] = several(
        "what agents are told under an arbiter: award, yes, no (default: the mechanism's own)",
        metavar="WHAT",
        choices=("award", "yes", "no"),
    )
    yardstick: tuple[str, ...] = several(
        f"also let one controller drive alone, outside the comparison: {', '.join(YARDSTICKS)}",
        metavar="NAME",
        choices=YARDSTICKS,
    )
    pilot: bool = flag("drive other worlds than the study's, which stay unseen")
