"""What was rehearsed, kept for `why`: the newest answers, one file for each robot.

The entry point `told` of the group `armadico.rehearsals` is how `why` finds what was told before a
drive. It takes and returns plain values.
"""

from __future__ import annotations

import time
from contextlib import suppress
from math import dist
from pathlib import Path, PurePath
from typing import Final
from urllib.parse import quote

import msgspec
from msgspec import Struct

from armadico.config.named import data_folder
from armadico.config.writing import locked, write_files
from armadico.observe.journeys import BEGUN_M
from armadico.observe.jsons import JsonObject
from armadico.observe.slowness import Spot
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.fork import Errand

MOST: Final = 100
"""Answers that are kept for a robot; the oldest ones are dropped."""

ROBOTS: Final = 100
"""Robots of which answers are kept; of others the oldest are dropped."""

FRESH_S: Final = 600.0
"""A drive that begins later after a rehearsal is not the one that was rehearsed."""

SAME_M: Final = 0.3
"""Nor is one to a goal that is farther from the rehearsed one."""


class Noted(Struct, frozen=True):
    """An answer: when (s since 1970), from where, on which map, to which goal, and what was told.

    Times are s, lengths m.
    """

    at: float
    start: tuple[float, float]
    world: str
    goal: tuple[float, float]
    answer: str
    arrives: int
    samples: int
    time_s: tuple[float, ...]
    way_m: float
    slow: tuple[Spot, ...]


def _file(namespace: str) -> Path:
    return data_folder() / "rehearsals" / f"{quote(namespace, safe='')}.jsonl"


def note(
    namespace: str,
    errand: Errand,
    found: Rehearsed,
    now: float | None = None,
    *,
    named: str | None = None,
) -> None:
    """Keep an answer, if it is of a drive that may follow: to a goal, and nothing is changed.

    `named` is the map that was given in place of the society's own: then it is another drive.
    A disk that is full or read-only changes no answer.
    """
    changed = errand != Errand(goal=errand.goal) or named is not None
    if errand.goal is None or not found.samples or changed:
        return
    noted = noted_of(found, time.time() if now is None else now)
    with suppress(OSError, RuntimeError):  # also a user without a home
        file = _file(namespace)
        folder = file.parent
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)  # where somebody is sent is nobody else's business
        with locked(folder):
            file.touch(0o600)
            lines = [*_lines(file), msgspec.json.encode(noted)][-MOST:]
            write_files({file: b"\n".join(lines) + b"\n"})
            for old in sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime)[:-ROBOTS]:
                old.unlink()


def noted_of(found: Rehearsed, now: float) -> Noted:
    """What is kept of an answer with a goal, told at a time, s since 1970."""
    assert found.goal is not None, "the caller has looked"
    assert found.start is not None, "it was driven"
    return Noted(
        now,
        found.start,
        PurePath(found.world).stem,  # as on the agents' cards
        found.goal[:2],
        str(found.judgement.answer),
        found.arrives,
        found.samples,
        found.time_s,
        found.way_m,
        found.slow,
    )


def _lines(file: Path) -> list[bytes]:
    try:
        return file.read_bytes().splitlines()
    except FileNotFoundError:
        return []


def told(
    namespace: str,
    start: tuple[float, float],
    goal: tuple[float, float],
    world: str,
    began: float,
) -> JsonObject | None:
    """What was told of a drive (m) that began at a time (s since 1970); None: nothing.

    `world` is the map's name, as on cards; "": not known.

    The fields of `Noted`, of the newest rehearsal before it that is its own.
    """
    lines: list[bytes] = []
    with suppress(OSError, RuntimeError):
        lines = _lines(_file(namespace))
    for line in reversed(lines):
        with suppress(msgspec.DecodeError):  # a line of another version
            noted = msgspec.json.decode(line, type=Noted)
            near = dist(noted.goal, goal) <= SAME_M and dist(noted.start, start) <= BEGUN_M
            same = world in ("", noted.world)
            if near and same and 0.0 <= began - noted.at <= FRESH_S:
                found: JsonObject = msgspec.to_builtins(noted)
                return found
    return None
