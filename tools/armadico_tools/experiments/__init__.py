"""The experiments of chapters 4 and 5 of the thesis, and what they leave open.

An experiment is a module here with `TITLE: str` and `run(context: Context) -> None`. It may set
`RUNS` and `FIRST_SEED` where 30 seeds a cell from 1000 on are not what it wants.
"""

from __future__ import annotations

from typing import Final

EXPERIMENTS: Final = {
    "identify": "identify",
    "speed": "speed",
    "controllers": "controllers",
    "table-5.1": "table_5_1",
    "utility": "utility",
    "table-5.2": "table_5_2",
    "table-5.3": "table_5_3",
    "intelligences": "intelligences",
    "table-5.4": "table_5_4",
    "table-5.5": "table_5_5",
    "localization": "localization",
    "logs": "logs",
    "parameters": "parameter_sets",
    "random-rooms": "random_rooms",
    "floors": "floors",
    "time": "driving_time",
    "other-maps": "other_maps",
    "explore": "explore",
    "fleet": "fleet",
    "narrow": "narrow",
    "surveillance": "surveillance",
    "use-cases": "use_cases",
    "energy": "energy",
    "docking": "docking",
    "barn": "barn",
    "live-vs-virtual": "live_vs_virtual",
}
"""What an experiment is called, and its module; in this order they are all run."""

ON_REQUEST: Final = ("live-vs-virtual", "logs")
"""Not among all of them unless asked for: one takes real time, the other a folder of logs."""

RUNS: Final = 30
FIRST_SEED: Final = 1000
"""Seeds below this one chose parameters; those from it on are reported."""


def module(name: str) -> str:
    """The module of an experiment, not imported."""
    return f"{__name__}.{EXPERIMENTS[name]}"
