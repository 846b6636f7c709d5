"""A recording of a run: `--record`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from armadico.cli.additions import Addition, Start
from armadico.cli.options import need
from armadico.cli.parsing import RECORDING, option

if TYPE_CHECKING:
    from armadico.launch.society import Options


@dataclass(frozen=True, kw_only=True)
class Record(Addition):
    title = "to watch, draw and record"
    fleets = True

    record: Path | None = option(
        "record all messages as armadico record does, and what armadico replay needs",
        metavar="FILE.mcap",
        must=RECORDING,
    )

    def check(self, start: Start) -> None:  # noqa: ARG002
        if self.record is not None:
            need("mcap", "record")

    def changed(self, options: Options) -> Options:
        """Live agents publish their inputs and outputs; those of a virtual mesh are read there."""
        return options if self.record is None else replace(options, journal=True)

    @contextmanager
    def beside(self, start: Start) -> Iterator[None]:
        if self.record is None:
            yield
            return
        from armadico.watch.commands.record import recorded, recorder

        path = start.of_run(self.record)
        with recorder(start, path) if start.on is None else recorded(start, start.on, path):
            yield
