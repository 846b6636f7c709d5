"""Experiments that are a table of cells in a TOML file: rows and arms.

    title = "Three controllers"
    [[rows]]                    # a table each
    scenario = "sc1"
    [[arms]]                    # its columns
    name = "fast"
    controller = "fast"

A cell has the fields of its row and of its arm, which are those of `driving.Cell`. The name of a
row is its scenario if it has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from armadico.config.loading import convert, load
from armadico_tools.experiments.driving import Cell
from armadico_tools.experiments.runner import Context, Experiment, driven
from armadico_tools.experiments.tables import RULES, compare, failures

Changes = Annotated[tuple[dict[str, object], ...], Meta(min_length=1)]


class File(Struct, frozen=True, forbid_unknown_fields=True):
    """The contents of a file."""

    title: str
    rows: Changes
    arms: Changes
    note: str = ""


def read(path: Path) -> tuple[str, Experiment]:
    """The title and the experiment of a file. Raises ConfigError."""
    found = load(path, File)
    tables = {
        _name(row): {_name(arm): _cell(row, arm, path) for arm in found.arms} for row in found.rows
    }
    cells = [cell for arms in tables.values() for cell in arms.values()]

    def report(context: Context) -> str:
        samples, parts = context.samples, [RULES]
        for row, arms in tables.items():
            shown = compare({name: samples[cell.name] for name, cell in arms.items()})
            parts.append(f"## {row}\n\n{shown}")
        return "\n\n".join([*parts, failures(context.found["runs"])])

    return found.title, Experiment((driven(lambda _: cells),), report, found.note)


def _name(change: Mapping[str, object]) -> str:
    return str(change.get("name", change.get("scenario", "")))


def _cell(row: Mapping[str, object], arm: Mapping[str, object], path: Path) -> Cell:
    fields = {**row, **arm, "name": f"{_name(row)} {_name(arm)}"}
    return convert(fields, Cell, path, "")
