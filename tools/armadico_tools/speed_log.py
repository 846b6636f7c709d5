"""Logs of voltages and speeds, from which the dynamics are identified (thesis 4.5.3).

A log is CSV with a header. Left is the thesis's motor 3, right its motor 2. Sans-IO: text in, text
out.
"""

from __future__ import annotations

import csv
import io
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Floats = NDArray[np.float64]

COLUMNS: Final = ("t", "left_v", "right_v", "v", "w")
"""Columns of a log: s, V, V, m/s, rad/s. A row's voltages are applied until the next row."""

GAP: Final = 1.5
"""A gap is a step longer than this many usual ones."""

LEAST_ROWS: Final = 20


class LogError(ValueError):
    """The log is unusable; the message names the row or column, and the reason."""


class Log(Struct, frozen=True, eq=False):
    """Columns as in `COLUMNS`, of equal length."""

    t: Floats
    left_v: Floats
    right_v: Floats
    v: Floats
    w: Floats


def read_log(text: str) -> Log:
    """Read a log from CSV with a header; other columns are ignored. Raises LogError."""
    rows = list(csv.reader(io.StringIO(text)))
    if not rows:
        raise LogError("the log is empty")
    header = [name.strip() for name in rows[0]]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise LogError(
            f"no column {', '.join(missing)}; needed are {', '.join(COLUMNS)}, found"
            f" {', '.join(header)}"
        )
    places = [header.index(name) for name in COLUMNS]
    table = np.array(
        [_row(number, row, places) for number, row in enumerate(rows[1:], 2) if row],
        dtype=np.float64,
    ).reshape(-1, len(COLUMNS))
    return checked(Log(*table.T))


def write_log(log: Log) -> str:
    """The CSV for `read_log`, to 1e-6."""
    lines = [",".join(COLUMNS)]
    columns = (log.t, log.left_v, log.right_v, log.v, log.w)
    lines += [",".join(f"{x:.6f}" for x in row) for row in zip(*columns, strict=True)]
    return "\n".join(lines) + "\n"


def checked(log: Log) -> Log:
    """Return the log if it has enough rows, no gaps, and only numbers. Raises LogError."""
    if len(log.t) < LEAST_ROWS:
        raise LogError(f"{len(log.t)} rows: at least {LEAST_ROWS} are needed")
    for name in COLUMNS:
        bad = np.flatnonzero(~np.isfinite(getattr(log, name)))
        if len(bad) == len(log.t) and name.endswith("_v"):
            raise LogError(
                f"{name} is empty: without the motors' voltages neither"
                " 1/a11, C_v, C_s nor 1/a22, C_v1, C_s1 can be identified"
            )
        if len(bad):
            raise LogError(f"line {bad[0] + 2}: {name} is not a number ({len(bad)} such rows)")
    steps = np.diff(log.t)
    usual = float(np.median(steps))
    wrong = np.flatnonzero((steps <= 0.0) | (steps > GAP * usual))
    if len(wrong):
        at, step = int(wrong[0]), float(steps[wrong[0]])
        what = "time does not go on" if step <= 0.0 else f"a gap of {step:.3g} s"
        raise LogError(
            f"line {at + 3}: {what} at t = {log.t[at]:.3f} s (the usual step is {usual:.3g} s,"
            f" {len(wrong)} such rows); cut the log there"
        )
    return log


def _row(number: int, row: list[str], places: list[int]) -> list[float]:
    if len(row) <= max(places):
        raise LogError(f"line {number}: {len(row)} columns, fewer than the header")
    try:
        return [float(row[place]) if row[place].strip() else float("nan") for place in places]
    except ValueError as error:
        raise LogError(f"line {number}: {error}") from None
