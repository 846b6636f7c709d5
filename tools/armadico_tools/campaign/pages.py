"""Folders of results: how far they are, and one static page of all of them."""

from __future__ import annotations

import time
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from html import escape
from os.path import relpath
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from armadico.core.config_errors import ConfigError
from armadico.core.judgement import Judgement, no, unknown, yes
from armadico_tools.experiments.runner import ABOUT, FOUND, PROGRESS, About, Progress
from armadico_tools.falsify.search import preventable
from armadico_tools.falsify.series import FILE, Row
from armadico_tools.faults.series import OUTCOMES, SEEDS, TRIALS, Ran, Summary, lines
from armadico_tools.faults.trials import TRIALS as KINDS
from armadico_tools.results import Result, rows_of

R = TypeVar("R", Ran, Row)

STYLE: Final = """
body { font: 15px/1.5 sans-serif; max-width: 75em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
td, th { border: 1px solid #bbb; padding: .2em .5em; text-align: left; }
img { max-width: 100%; }
"""


@dataclass(frozen=True)
class Series:
    """The state of one series."""

    name: str
    folder: Path
    results: int  # that are kept
    commit: str = ""
    part: str = ""  # that is run now, or was when it was interrupted
    runs: int | None = None  # of that part
    done: int | None = None
    left_s: float | None = None  # by its pace
    finished: bool | None = None  # None: not known
    lost: int = 0  # results that it had when it was finished
    lacking: tuple[str, ...] = ()  # what its results cannot show
    failed: str = ""  # what of it failed; "": nothing that is known

    @property
    def judgement(self) -> Judgement:
        """No if something failed, yes if it is complete and lacks nothing; else unknown."""
        if self.failed:
            return no(f"{self.name}: {self.failed}")
        if self.finished and not self.lacking and self.results:
            return yes()
        return unknown(f"{self}{''.join(f'; {each}' for each in self.lacking)}")

    def __str__(self) -> str:
        text = f"{self.name}: {self.results} results"
        if self.lost:
            text += f", {self.lost} of what it had are lost: the same command makes them again"
        elif self.finished and not self.results:
            text += ", finished, so it shows nothing"
        elif self.finished:
            text += ", finished"
        elif self.finished is None:
            text += ", whether that is all is not known"
        elif self.runs is None:
            text += ", not finished: the same command continues"
        else:
            text += f", {self.part}: {self.done} of {self.runs}"
            if self.left_s is not None:
                text += f", {self.left_s:.0f} s left at this pace"
        if self.failed:
            text += f"; failed: {self.failed}"
        return f"{text}{f', commit {self.commit}' if self.commit else ''}"

    def plain(self) -> dict[str, object]:
        """The state and its judgement, for JSON."""
        judgement = msgspec.to_builtins(self.judgement)
        return asdict(self) | {"folder": str(self.folder), "judgement": judgement}


def series_in(folder: Path) -> list[Series]:
    """The series in a folder and the folders in it, by name. Raises ConfigError."""
    files = (path for name in (ABOUT, FOUND, *OTHERS) for path in folder.rglob(name))
    places = sorted({path.parent for path in files})
    return [one for place in places for one in _series(place)]


def _series(folder: Path) -> Iterator[Series]:
    try:
        about = msgspec.json.decode((folder / ABOUT).read_bytes(), type=About)
    except FileNotFoundError:
        if (folder / FOUND).is_file():  # of learning, or of an experiment that has lost its file
            count = _rows(folder / FOUND, Result)
            yield Series(f"{folder.name}, runs without {ABOUT}", folder, count)
    except (OSError, msgspec.DecodeError) as error:
        why = f"{error}: what this series is cannot be known; move it away"
        raise ConfigError(why, folder / ABOUT) from error
    else:
        yield _experiment(folder, about)
    for name, (what, kind, failures) in OTHERS.items():
        if (folder / name).is_file():
            count = _rows(folder / name, kind)
            yield Series(
                *(f"{folder.name}, {what}", folder, count),
                lacking=_unmeasured(folder) if name == TRIALS else (),
                failed=failures(folder / name),
            )


def _experiment(folder: Path, about: About) -> Series:
    kept = _rows(folder / FOUND, Result)
    name, commit = folder.name, about.software.commit
    try:
        now = msgspec.json.decode((folder / PROGRESS).read_bytes(), type=Progress)
    except (OSError, msgspec.DecodeError):
        table = (folder / "table.md").is_file() and not (folder / PROGRESS).exists()
        if about.results is None:  # of an earlier version, if there is a table
            return Series(name, folder, kept, commit, finished=None if table and kept else False)
        # A table alone says nothing: its results may be lost, or some of them.
        lost = max(about.results - kept, 0)
        return Series(
            *(name, folder, kept, commit),
            finished=table and not lost,
            lost=lost,
            lacking=about.lacking,
        )
    made = kept - now.kept
    left, elapsed = now.runs - now.known - made, time.time() - now.began
    left_s = round(elapsed / made * left, 1) if made > 0 else None
    done = min(now.known + made, now.runs)
    return Series(name, folder, kept, commit, now.part, now.runs, done, left_s, finished=False)


def _rows(path: Path, kind: type[msgspec.Struct]) -> int:
    """The number of results in a file. Raises ConfigError for a damaged line."""
    return sum(1 for _ in rows_of(path, kind))


def _newest(path: Path, kind: type[R]) -> list[R]:
    """The results of the commit that ran last: those of others are no news of it."""
    rows = [row for _, row in rows_of(path, kind)]
    return [row for row in rows if row.commit == rows[-1].commit]


def _seeds_failed(path: Path) -> str:
    """What broke a promise; a planted defect is meant to, and is not among the seeds."""
    return _broken(_newest(path.with_name(SEEDS), Ran), "seeds")


def _trials_failed(path: Path) -> str:
    rows, summary = _newest(path, Ran), Summary()
    for row in rows:
        numbers = {name: x for name, x in _figures(row).items() if isinstance(x, int | float)}
        summary.figures.setdefault(row.kinds, []).append(numbers)
    missed = [f"{x.kind} {x.figure}" for x in lines(summary, KINDS.values()) if not x.kept]
    broken = _broken(rows, "trials")
    aims = f"aims missed: {', '.join(missed)}" if missed else ""
    return "; ".join(filter(None, [broken, aims]))


def _unmeasured(folder: Path) -> tuple[str, ...]:
    """The figures of trials that have no number: what is infinite or none is kept as null."""
    found = Counter(
        f"{row.kinds} {figure.name}"
        for row in _newest(folder / TRIALS, Ran)
        if (kind := KINDS.get(row.kinds)) is not None
        for figure in kind.figures
        if not isinstance(_figures(row).get(figure.name, 0.0), int | float)
    )
    return tuple(f"no number in {count} trials: {name}" for name, count in found.items())


def _figures(row: Ran) -> dict[str, object]:
    return msgspec.json.decode(row.figures or "{}", type=dict[str, object])


def _broken(rows: Sequence[Ran], what: str) -> str:
    broken = [row for row in rows if row.violations]
    return f"{len(broken)} of {len(rows)} {what} broke a promise" if broken else ""


def _contacts(path: Path) -> str:
    count = sum(preventable(row.by_cause) for row in _newest(path, Row))
    return f"{count} contacts that the sensors could have prevented" if count else ""


OTHERS: Final[dict[str, tuple[str, type[msgspec.Struct], Callable[[Path], str]]]] = {
    OUTCOMES: ("seeds of faults", Result, _seeds_failed),
    TRIALS: ("trials of faults", Ran, _trials_failed),
    FILE: ("seeds of the falsifier", Row, _contacts),
}
"""Files of series that are no experiments: all their rows are results, and nothing there says how
many were wanted. Each with what its rows are, and what of them failed."""


# The page -----------------------------------------------------------------------------------------


def write(path: Path, found: Sequence[Series]) -> None:
    """Write the page of these series, with their pictures in it. Raises OSError."""
    sections = []
    for one in found:
        table = one.folder / "table.md"
        text = (
            table.read_text(encoding="utf-8")
            if table.is_file() and one.finished is not False
            else ""
        )
        files = sorted(one.folder.glob("*.csv"))
        links = (
            f'<a href="{escape(relpath(file, path.parent))}">{escape(file.name)}</a>'
            for file in files
        )
        body = "\n".join(html_of(text, one.folder))
        sections.append(
            f"<section><h1>{escape(one.name)}</h1><p>{escape(str(one))}</p>\n{body}\n"
            f"<p>For pandas: {', '.join(links) or 'nothing'}</p></section>"
        )
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Results</title>'
        f"<style>{STYLE}</style></head><body>\n" + "\n<hr>\n".join(sections) + "\n</body></html>\n"
    )
    path.write_text(page, encoding="utf-8")


def html_of(text: str, folder: Path) -> Iterator[str]:
    """The Markdown that experiments write: headings, tables, pictures and paragraphs."""
    for block in text.split("\n\n"):
        lines = block.strip().splitlines()
        if not lines:
            continue
        first = lines[0]
        if first.startswith("#"):
            level = min(len(first) - len(first.lstrip("#")) + 1, 6)
            yield f"<h{level}>{escape(first.lstrip('# '))}</h{level}>"
            lines = lines[1:]
        if lines and lines[0].startswith("|"):
            yield _table(lines)
        elif lines and lines[0].startswith("!["):
            yield _picture(lines[0], folder)
        elif lines:
            yield f"<p>{escape(' '.join(lines))}</p>"


def _table(lines: Sequence[str]) -> str:
    rows = [[cell.strip() for cell in line.strip().strip("|").split(" | ")] for line in lines]
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[2:]
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def _picture(line: str, folder: Path) -> str:
    title, _, name = line.removeprefix("![").rstrip(")").partition("](")
    try:
        data = b64encode((folder / name).read_bytes()).decode()
    except OSError:
        return f"<p>{escape(name)} is not there</p>"
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
