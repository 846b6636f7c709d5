"""The store of results: rows of a CSV file, each written as soon as it is known.

Interrupted experiments, faults and trials continue where they were: existing rows are read again,
by their type. An incomplete line is ignored.
"""

from __future__ import annotations

import csv
import fcntl
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from hashlib import sha256
from inspect import getfile
from pathlib import Path
from typing import Generic, TextIO, TypeVar, get_type_hints

import msgspec
from msgspec import Struct

R = TypeVar("R", bound=Struct)
T = TypeVar("T")


class Rows(Generic[R]):
    """The rows of one file, of one type; its fields are the columns."""

    def __init__(self, path: Path, kind: type[R]) -> None:
        """Continue a file, or make its folder. Raises OSError."""
        self.path = path
        self._kind = kind
        path.parent.mkdir(parents=True, exist_ok=True)
        with self._alone():  # or a row that another process is writing would count as incomplete
            if path.is_file() and not (data := path.read_bytes()).endswith(b"\n"):
                os.truncate(path, data.rfind(b"\n") + 1)  # or the next row would continue this one

    def read(self) -> list[R]:
        """The existing rows, in order of writing."""
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

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the folder's lock, so that no other process writes in it."""
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            yield
        finally:
            os.close(folder)  # which releases the lock


class _Result(Struct, frozen=True):
    """The result of a function, under the hash of all that it depends on."""

    key: str
    of: str  # its inputs, for people
    found: str  # as JSON


class Kept(Generic[T]):
    """Stored results of one function for one version of the code.

    A result is stored if decoding it by the function's return annotation gives an equal value.
    Others, such as paths of files, are computed each time.
    """

    def __init__(self, path: Path, function: Callable[..., T], source: str) -> None:
        """Continue a file; `source` is a hash of the code outside the function's module."""
        name = f"{function.__module__}.{function.__qualname__} {source} "
        self._code = sha256(name.encode() + Path(getfile(function)).read_bytes()).hexdigest()
        self._decoder: msgspec.json.Decoder[T] | None = None
        with suppress(TypeError):  # a type without JSON
            kind: type[T] = get_type_hints(function)["return"]
            self._decoder = msgspec.json.Decoder(kind)
        self._rows = Rows(path, _Result)
        self._known = {row.key: row.found for row in self._rows.read()}

    def read(self, of: Sequence[str]) -> dict[int, T]:
        """The stored results, by their index in `of`."""
        if self._decoder is None:
            return {}
        known = {at: self._known.get(self._key(each)) for at, each in enumerate(of)}
        return {at: self._decoder.decode(text) for at, text in known.items() if text is not None}

    def add(self, of: str, found: T) -> None:
        """Store a result, if it can be decoded to an equal value."""
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
    """Write a CSV file whose bytes depend on the numbers only."""
    with path.open("w", newline="", encoding="utf-8") as file:
        _write(file, header, rows)


def _write(file: TextIO, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(plain, row) for row in rows)


def write_json(path: Path, about: object) -> None:
    """Write metadata or a summary of results as indented JSON."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(about), indent=2) + b"\n")


def _cells(row: Struct) -> Iterable[object]:
    return map(plain, msgspec.structs.astuple(row))


def plain(value: object) -> object:
    """A value for a CSV: "" for None, 0 and 1 for booleans, text in one line."""
    if value is None:
        return ""
    if isinstance(value, str):
        return " ".join(value.splitlines())
    return int(value) if isinstance(value, bool) else value
