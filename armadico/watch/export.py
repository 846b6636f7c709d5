"""Export of recordings: CSV tables, formats of translators, Rerun recordings."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, TextIO

from armadico.observe.jsons import Json, JsonObject
from armadico.observe.translators import translator
from armadico.observe.watching import json_schema
from armadico.watch.recorder import McapFile
from armadico.watch.recordings import RecordingError, Row, Warn, kinds, rows

if TYPE_CHECKING:
    from _csv import Writer

    from armadico.config.worlds import World
    from armadico.watch.dashboard.local_map import Zones

# Tables -------------------------------------------------------------------------------------------


class Tables:
    """One CSV file per topic: `t` in s from the recording's first message, then the fields.

    Nested fields are columns such as `cycle.number`. A list is JSON in one cell, a missing value an
    empty cell.
    """

    def __init__(self, folder: Path) -> None:
        """Write into a folder, which gets the files at the end of the `with` block.

        After an error it gets none: half a table looks like a whole one.
        """
        self.folder = folder
        self._new: Path | None = None  # where files are until they are whole
        self._made = False  # whether the folder was
        self.rows = 0
        self._first: int | None = None
        self._stack = ExitStack()
        self._files: dict[str, tuple[Writer, list[str]]] = {}

    def __enter__(self) -> Tables:
        return self

    def __exit__(self, error: object, *_: object) -> None:
        try:
            self._stack.close()  # writes the last rows, unless the disk is full
            if error is None and self._new is not None:
                for file in self._new.iterdir():
                    file.replace(self.folder / file.name)
        finally:
            if self._new is not None:
                rmtree(self._new, ignore_errors=True)
            if self._made:
                with suppress(OSError):  # it has tables
                    self.folder.rmdir()

    @property
    def topics(self) -> list[str]:
        return sorted(self._files)

    def write(self, row: Row) -> None:
        """Write one row; unknown payloads are ignored."""
        if not row.schema:
            return
        if self._first is None:
            self._first = row.t
        if row.topic not in self._files:
            self._files[row.topic] = self._begin(row)
        writer, columns = self._files[row.topic]
        cells = dict(_flat(row.fields))
        t = f"{(row.t - self._first) / 1e9:.6f}"
        writer.writerow([t, *(cells.get(column, "") for column in columns)])
        self.rows += 1

    def _begin(self, row: Row) -> tuple[Writer, list[str]]:
        name = row.topic.strip("/").replace("/", "_") + ".csv"
        if self._new is None:
            self._made = not self.folder.exists()
            self.folder.mkdir(parents=True, exist_ok=True)
            self._new = Path(mkdtemp(prefix=".unfinished-", dir=self.folder))
        stream: TextIO = self._stack.enter_context(
            (self._new / name).open("w", newline="", encoding="utf-8")
        )
        writer = csv.writer(stream)
        kind = kinds().get(row.schema)
        columns = (
            list(_columns(json_schema(kind))) if kind else [name for name, _ in _flat(row.fields)]
        )
        writer.writerow(["t", *columns])
        return writer, columns


def _columns(schema: dict[str, Any], before: str = "") -> Iterator[str]:
    for name, field in schema["properties"].items():
        if field["type"] == "object":
            yield from _columns(field, f"{before}{name}.")
        else:
            yield before + name


def _flat(fields: JsonObject, before: str = "") -> Iterator[tuple[str, Json]]:
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, json.dumps(value) if isinstance(value, list) else value


# Other formats ------------------------------------------------------------------------------------


def translated(
    path: Path,
    out: Path,
    name: str,
    namespace: str | None,
    warn: Warn,
    world: World | None = None,
) -> int:
    """Write only a translator's samples of a recording; returns their number.

    The result suits tools that reject files with several encodings. The recording may have been
    made without the translator. Raises RecordingError, UnknownNameError, ImportError and OSError.
    """
    found = sorted({row.namespace for row in rows(path, lambda _: None)})
    chosen = found if namespace is None else [namespace]
    made = translator(name, chosen, world)
    others = [each for several in made.values() for each in several]
    if not others:
        return 0
    file, count = McapFile(out, others[0].about, others[0].profile), 0
    try:
        for row in rows(path, warn):
            if (message := row.received) is None:
                continue
            for each in made.get(row.namespace, ()):
                for sample in each.translate(row.key, message, row.t):
                    file.add_sample(sample, row.t)
                    count += 1
    finally:
        file.close()
    return count


# Rerun --------------------------------------------------------------------------------------------


def to_rrd(
    path: Path, out: Path, namespace: str | None, world: World | None, zones: Zones, warn: Warn
) -> int:
    """Draw a recording as the dashboard does; returns the number of messages.

    Raises RecordingError if it has several robots and `namespace` is None, ImportError without
    rerun, and OSError.
    """
    from armadico.watch.dashboard.scene import Scene
    from armadico.watch.dashboard.server import finish, keep

    chosen = namespace or _only_namespace(path)
    recording = keep({chosen: world}, out)
    scene = Scene(recording, world, chosen, zones)
    count, first = 0, None
    for row in rows(path, warn):
        first = row.t if first is None else first
        if row.namespace == chosen and (message := row.received) is not None:
            scene.update(message, (row.t - first) / 1e9)
            count += 1
    finish(recording, out)
    return count


def _only_namespace(path: Path) -> str:
    found = sorted({row.namespace for row in rows(path, lambda _: None)})
    if len(found) != 1:
        names = ", ".join(found) or "no messages"
        raise RecordingError(f"{path} holds {names}; name one robot: --namespace NS")
    return found[0]
