"""The store of results: rows of a CSV file, each written as soon as it is known.

Interrupted experiments, faults and trials continue where they were: existing rows are read again,
by their type. An incomplete last line is ignored: its process was killed while it wrote. Any other
line that cannot be read is an error that names it, since results that do not count are not seen.
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
from typing import Generic, TypeVar, get_type_hints

import msgspec
from msgspec import Struct

from armadico.core.config_errors import ConfigError

R = TypeVar("R", bound=Struct)
T = TypeVar("T")


class Rows(Generic[R]):
    """The rows of one file, of one type; its fields are the columns."""

    def __init__(self, path: Path, kind: type[R]) -> None:
        """Continue a file, or make its folder. Raises OSError, and ConfigError for another file."""
        self.path = path
        self._kind = kind
        path.parent.mkdir(parents=True, exist_ok=True)
        with self._alone():  # or a row that another process is writing would count as incomplete
            self._cut()

    def _cut(self) -> None:
        """Remove an incomplete line, or the next row would continue it."""
        if self.path.is_file() and not (data := self.path.read_bytes()).endswith(b"\n"):
            os.truncate(self.path, len(_whole(data, self.path, self._kind)))

    def read(self) -> list[R]:
        """The existing rows, in order of writing. Raises ConfigError for a damaged one."""
        return [row for _, row in rows_of(self.path, self._kind)]

    def add(self, *rows: R) -> None:
        with self._alone():
            if not self.path.is_file() or not self.path.stat().st_size:
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


def rows_of(path: Path, kind: type[R]) -> Iterator[tuple[int, R]]:
    """Yield the rows of a file, if there is one, each after the number of its line.

    Raises ConfigError for a line that is no such row.
    """
    if not path.is_file():
        return
    data = _whole(path.read_bytes(), path, kind)
    columns = kind.__struct_fields__
    # No value has a line break, so each line can be read alone, whatever the others have.
    for number, line in enumerate(data.split(b"\n")[:-1], start=1):
        try:
            cells = next(csv.reader([line.decode()], strict=True), [])
            if number == 1:
                if tuple(cells) != columns:
                    raise ValueError(f"expected the columns {', '.join(columns)}")
                continue
            if len(cells) != len(columns):
                raise ValueError(f"expected {len(columns)} values, not {len(cells)}")
            given = {name: text for name, text in zip(columns, cells, strict=True) if text != ""}
            yield number, msgspec.convert(given, kind, strict=False)
        except (ValueError, csv.Error) as error:  # of its encoding and of msgspec, too
            raise _damaged(path, number, error) from None


def _whole(data: bytes, path: Path, kind: type[Struct]) -> bytes:
    """The complete lines of a file. Raises ConfigError if it is none of these files at all."""
    whole = data[: data.rfind(b"\n") + 1]
    head = ",".join(kind.__struct_fields__).encode()
    if not whole and not head.startswith(data):
        raise _damaged(path, 1, f"expected the columns {head.decode()}")
    return whole


def _damaged(path: Path, line: int, why: object) -> ConfigError:
    todo = "move the file away" if line == 1 else "remove the line, and its run is made again"
    return ConfigError(f"not a result: {why}; {todo}", path, line)


class Result(Struct, frozen=True):
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
        """Continue a file; `source` is a hash of the code outside the function's module.

        Raises OSError, and ConfigError for a damaged line.
        """
        name = f"{function.__module__}.{function.__qualname__} {source} "
        self._code = sha256(name.encode() + Path(getfile(function)).read_bytes()).hexdigest()
        self._decoder: msgspec.json.Decoder[T] | None = None
        with suppress(TypeError):  # a type without JSON
            kind: type[T] = get_type_hints(function)["return"]
            self._decoder = msgspec.json.Decoder(kind)
        self._rows = Rows(path, Result)
        self._known = {row.key: (line, row.found) for line, row in rows_of(path, Result)}

    @property
    def count(self) -> int:
        """The number of results when the file was opened, of any function."""
        return len(self._known)

    def read(self, of: Sequence[str]) -> dict[int, T]:
        """The stored results, by their index in `of`. Raises ConfigError for a damaged one."""
        found: dict[int, T] = {}
        for at, each in enumerate(of):
            known = self._known.get(self._key(each))
            if self._decoder is None or known is None:
                continue
            line, text = known
            try:
                found[at] = self._decoder.decode(text)
            except msgspec.DecodeError as error:
                raise _damaged(self._rows.path, line, error) from None
        return found

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
        self._rows.add(Result(self._key(of), of, text))

    def _key(self, of: str) -> str:
        return sha256(f"{self._code} {of}".encode()).hexdigest()[:16]


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a CSV file whose bytes depend on the numbers only."""
    with path.open("w", newline="", encoding="utf-8") as file:
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
