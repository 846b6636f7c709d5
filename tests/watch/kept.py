"""Messages to draw, and recordings read back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

from armadico.config.worlds import World
from armadico.core import messages as m
from armadico.watch.commands.dashboard import zones
from armadico.watch.dashboard.scene import Scene
from armadico.watch.dashboard.server import close, keep

NAMESPACE = "p"
GOTO, AVOID = "goto-1", "avoid-2"

Row = tuple[float, dict[str, Any]]


def cycle(number: int) -> m.Cycle:
    return m.Cycle(7, number)


def ballot(instance: str, term: int = 1) -> m.Ballot:
    return m.Ballot(term, 0.5, False, instance)


def state(number: int, **more: Any) -> m.RobotState:
    return m.RobotState(cycle(number), 0.0, 0.0, 0.0, 0.2, 0.1, 12.5, True, False, **more)


def ack(number: int, driver: str | None, resource: str = "wheels") -> m.Ack:
    """An ack that the owner obeyed an instance's command of this cycle."""
    by = None if driver is None else ballot(driver)
    return m.Ack(resource, cycle(number), by, by, None if by is None else cycle(number))


def record(number: int, utility: float | None) -> m.BidRecord:
    return m.BidRecord(cycle(number), "wheels", utility, False, (), "why")


class Kept:
    """A recording, read back."""

    def __init__(self, path: Path) -> None:
        self.rows: dict[str, list[Row]] = {}
        self.fixed: dict[str, dict[str, Any]] = {}
        for chunk in RrdReader(path).stream().to_chunks():
            batch = chunk.to_record_batch()
            names = [name for name in batch.schema.names if ":" in name]
            values = {name: batch.column(name).to_pylist() for name in names}
            for row in range(chunk.num_rows):
                parts = {name.partition(":")[2]: values[name][row] for name in names}
                if chunk.is_static:
                    self.fixed.setdefault(chunk.entity_path, {}).update(parts)
                else:
                    t = batch.column("t")[row].value / 1e9
                    self.rows.setdefault(chunk.entity_path, []).append((t, parts))
        for rows in self.rows.values():
            rows.sort(key=lambda row: row[0])

    def values(self, path: str, component: str) -> list[tuple[float, Any]]:
        """(t, value) of a component that has one value a row."""
        return [(round(t, 3), parts[component][0]) for t, parts in self.rows.get(path, [])]


@contextmanager
def drawn(path: Path, world: World | None = None) -> Iterator[Scene]:
    recording = keep({NAMESPACE: world}, path)
    yield Scene(recording, world, NAMESPACE, zones())
    close(recording)
