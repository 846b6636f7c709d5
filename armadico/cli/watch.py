"""`armadico run --watch`: a virtual run again, whenever a file that it has read changes.

Each run is a process of its own, which loads the code as it is then, and says in the end which
files it has read: the scenario, its world, sets of parameters, profiles, missions, and the modules
of every agent. What Python and installed packages brought is left out: nobody edits that.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from stat import S_ISREG
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from armadico.cli import options
from armadico.cli.measures import columns

if TYPE_CHECKING:
    from armadico.observe.measures import Result

LOOK_S: Final = 0.3
"""How often files are looked at, s: a run begins when none has changed since the last look."""

NAMED: Final = 5
"""So many files that have changed are named."""

Stamp = tuple[int, int, int]
"""When a file was written, its size, and its number: editors put a new one in the old one's place.
"""


class Outcome(NamedTuple):
    """What one run came to; no result: it said why on standard error."""

    code: int
    result: Result | None
    read: frozenset[Path]


class Watched:
    """The files that runs have read, as they were when the last run began."""

    def __init__(self) -> None:
        self._stamps: dict[Path, Stamp | None] = {}

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, read: Iterable[Path], since_ns: int) -> None:
        """Watch these too; what was written since then has changed already."""
        for path in read:
            if path not in self._stamps:
                stamp = _stamp(path)
                self._stamps[path] = None if stamp and stamp[0] >= since_ns else stamp

    def changed(self) -> list[Path]:
        """What has changed since it was asked for last; what is gone has not, until it is back."""
        found = []
        for path, before in self._stamps.items():
            stamp = _stamp(path)
            if stamp != before and stamp is not None:
                found.append(path)
            self._stamps[path] = stamp
        return found

    def wait(self, pause: Callable[[], None]) -> list[Path]:
        """What has changed, once something has and no more does."""
        found: dict[Path, None] = {}
        while True:
            new = self.changed()
            if found and not new:
                return list(found)
            found |= dict.fromkeys(new)
            pause()


def _stamp(path: Path) -> Stamp | None:
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_mtime_ns, about.st_size, about.st_ino


def main(words: Sequence[str], pause: Callable[[], None] | None = None) -> int:
    """Run with these words of `armadico run` until Ctrl-C; `pause` passes the time between looks.

    Ends with the exit code of the first run if that was called wrongly: there is nothing to watch.
    """
    pause = pause or (lambda: time.sleep(LOOK_S))
    watched = Watched()
    first: Result | None = None
    last: Result | None = None
    try:
        while True:
            began = time.time_ns()
            outcome = drive(words)
            if outcome.code == options.USAGE and not watched:
                return outcome.code
            new = not watched
            watched.add(outcome.read, began)
            if outcome.result is not None:
                _tell(outcome.result, last, first)
                last = outcome.result
                first = first or last
            if new:
                _say("it runs again when a file that it has read changes; Ctrl-C ends it")
            changed = watched.wait(pause)
            _say(f"changed: {_names(changed)}")
    except KeyboardInterrupt:
        return 0  # how a live view ends


def _tell(result: Result, last: Result | None, first: Result | None) -> None:
    _say(f"{result.scenario} seed {result.seed}: {options.shown(result.verdict)}")
    if last is not None and first is not None:
        for line in moved(first, last, result) or ("nothing moved",):
            _say(f"  {line}")


def moved(first: Result, last: Result, now: Result) -> list[str]:
    """A line for each measure that is not what it was in the last run."""
    lines = []
    for column in columns((first, last, now)):
        at_first, before, after = column.values
        if _value(before) != _value(after):  # what cannot be seen has not moved
            change = _change(before, after)
            since = f", {_change(at_first, after)} since the first run" if first != last else ""
            values = f"{_value(before)} -> {_value(after)}"
            title = column.title or column.words
            lines.append(f"{title:12} {values:>18}  {change}{since}")
    return lines


def _value(value: float | None) -> str:
    return "-" if value is None else f"{value:d}" if isinstance(value, int) else f"{value:.2f}"


def _change(before: float | None, after: float | None) -> str:
    if before is None or after is None:
        return ""
    change = after - before
    return f"{change:+d}" if isinstance(change, int) else f"{change:+.2f}"


def _names(paths: Sequence[Path]) -> str:
    here = Path.cwd()
    shown = [str(p.relative_to(here) if p.is_relative_to(here) else p) for p in paths[:NAMED]]
    more = f" and {len(paths) - NAMED} more" if len(paths) > NAMED else ""
    return options.shown(", ".join(shown)) + more


def _say(text: str) -> None:
    print(text, flush=True)


# One run, in a process of its own -----------------------------------------------------------------


def drive(words: Sequence[str]) -> Outcome:
    """One run, and what it has read."""
    import msgspec  # noqa: PLC0415 - not for --help

    from armadico.observe.measures import Result  # noqa: PLC0415 - heavy

    with tempfile.TemporaryDirectory() as folder:
        told, report = Path(folder, "told"), Path(folder, "read")
        command = [sys.executable, "-P", "-m", __name__, str(report), *words, "--json"]
        with told.open("wb") as out, subprocess.Popen(command, stdout=out) as process:
            try:
                code = process.wait()
            except BaseException:
                process.kill()
                raise
        read = report.read_text(encoding="utf-8").split("\0") if report.exists() else []
        result = None
        with suppress(msgspec.DecodeError):  # it has said why there is none
            result = msgspec.json.decode(told.read_bytes(), type=Result)
    return Outcome(code, result, frozenset(Path(name) for name in read if name))


def child(report: str, *words: str) -> int:
    """Run, and write the files that it has read into one; returns the exit code."""
    opened: set[str] = set()

    def heard(event: str, about: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(about[0], str | bytes | os.PathLike):
            written = about[2] & (os.O_WRONLY | os.O_RDWR)
            opened.update(() if written else (os.fsdecode(about[0]),))

    sys.addaudithook(heard)
    from armadico import cli  # noqa: PLC0415 - from here on it is heard

    try:
        return cli.main(["run", *words])
    finally:
        modules = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
        ours = edited({*opened, *filter(None, modules)})
        Path(report).write_text("\0".join(ours), encoding="utf-8")


def edited(paths: Iterable[str]) -> list[str]:
    """Of these files those that a person may change: neither Python's, nor installed, nor kept."""
    from armadico.config import kept  # noqa: PLC0415 - numpy

    installed = ("stdlib", "platstdlib", "purelib", "platlib")
    apart = [Path(sysconfig.get_path(name)).resolve() for name in installed]
    apart += [kept.folder().parent.resolve(), *map(Path, ("/proc", "/sys", "/dev", "/etc"))]
    found = []
    for path in sorted({Path(path).resolve() for path in paths}):
        if path.suffix == ".pyc" or any(path.is_relative_to(folder) for folder in apart):
            continue
        with suppress(OSError):
            if S_ISREG(path.stat().st_mode):
                found.append(str(path))
    return found


if __name__ == "__main__":
    sys.exit(child(*sys.argv[1:]))
