"""The one store of results: rows of a CSV file, each written as soon as it is known.

Experiments, faults and trials are interrupted and go on where they were: what is there is
read again, by the kind of its rows. A line that was cut off does not count.
"""

from __future__ import annotations

import csv
import fcntl
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from hashlib import sha256
from inspect import getfile
from io import StringIO
from pathlib import Path
from typing import Any, Generic, TextIO, TypeVar, get_type_hints

import msgspec
from msgspec import Struct

from armadico.config.writing import write_files

R = TypeVar("R", bound=Struct)
T = TypeVar("T")


class Rows(Generic[R]):
    """The rows of one file, of one kind; its fields are the columns."""

    def __init__(self, path: Path, kind: type[R]) -> None:
        """Go on with a file, or make its folder. Raises OSError."""
        self.path = path
        self._kind = kind
        path.parent.mkdir(parents=True, exist_ok=True)
        with self._alone():  # or a row that another process is writing is taken for cut off
            if path.is_file() and not (data := path.read_bytes()).endswith(b"\n"):
                os.truncate(path, data.rfind(b"\n") + 1)  # the next row is not to end this one

    def read(self) -> list[R]:
        """What is there, in the order in which it was written."""
        if not self.path.is_file():
            return []
        found = []
        with self.path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                if None in row or None in row.values():
                    continue
                given = {name: text for name, text in row.items() if text != ""}
                try:
                    found.append(msgspec.convert(given, self._kind, strict=False))
                except msgspec.ValidationError:
                    continue
        return found

    def add(self, *rows: R) -> None:
        with self._alone():
            if not self.path.is_file():
                write_csv(self.path, self._kind.__struct_fields__, ())
            with self.path.open("a", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows(map(_cells, rows))

    def rewrite(self, rows: Iterable[R]) -> None:
        """Have these instead of what is there; an interruption leaves one or the other."""
        text = StringIO(newline="")
        _write(text, self._kind.__struct_fields__, map(_cells, rows))
        with self._alone():
            write_files({self.path: text.getvalue().encode()})

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the folder's lock, so that no other process writes rows in it."""
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            yield
        finally:
            os.close(folder)  # which releases the lock


class _Result(Struct, frozen=True):
    """What a function returned, under the hash of all that it depends on."""

    key: str
    of: str  # what it depends on besides the code, for people
    found: str  # as JSON


class Kept(Generic[T]):
    """Results of one function by one version of the code, which need not be computed again.

    A result is kept if it reads back as it was, by the type that the function is annotated with.
    All others, for example paths of files, are computed again each time.
    """

    def __init__(self, path: Path, function: Callable[..., T], source: str) -> None:
        """Go on with a file; `source` is a hash of the code outside of the function's module."""
        name = f"{function.__module__}.{function.__qualname__} {source} "
        self._code = sha256(name.encode() + Path(getfile(function)).read_bytes()).hexdigest()
        self._decoder: msgspec.json.Decoder[T] | None = None
        with suppress(TypeError):  # a type that JSON does not have
            kind: Any = get_type_hints(function)["return"]
            self._decoder = msgspec.json.Decoder(kind)
        self._rows = Rows(path, _Result)
        self._known = {row.key: row.found for row in self._rows.read()}

    def read(self, of: Sequence[str]) -> dict[int, T]:
        """The results that are there, by their place in `of`."""
        if self._decoder is None:
            return {}
        known = {at: self._known.get(self._key(each)) for at, each in enumerate(of)}
        return {at: self._decoder.decode(text) for at, text in known.items() if text is not None}

    def add(self, of: str, found: T) -> None:
        """Keep a result, now, if it reads back as it is."""
        if self._decoder is None:
            return
        try:
            text = msgspec.json.encode(found).decode()
            if self._decoder.decode(text) != found or len(text) > csv.field_size_limit():
                return
        except (TypeError, msgspec.DecodeError):
            return
        self._rows.add(_Result(self._key(of), of, text))

    def _key(self, of: str) -> str:
        return sha256(f"{self._code} {of}".encode()).hexdigest()[:16]


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """A CSV file whose bytes depend on the numbers only."""
    with path.open("w", newline="", encoding="utf-8") as file:
        _write(file, header, rows)


def _write(file: TextIO, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(plain, row) for row in rows)


def write_json(path: Path, about: object) -> None:
    """What a folder of results holds, or came to, for programs and people."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(about), indent=2) + b"\n")


def _cells(row: Struct) -> Iterable[object]:
    return map(plain, msgspec.structs.astuple(row))


def plain(value: object) -> object:
    """A value as it stands in a CSV: nothing for None, 0 and 1 for truth values, text in a line."""
    if value is None:
        return ""
    if isinstance(value, str):
        return " ".join(value.splitlines())
    return int(value) if isinstance(value, bool) else value
