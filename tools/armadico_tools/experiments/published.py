"""The numbers of the thesis: tables 5.1 to 5.5, mean and standard deviation of five runs.

FO is the error against the goal's heading, degrees. Tables 5.4 and 5.5 print the final heading of
one run, without a deviation; the error is its distance from 180.
"""

from __future__ import annotations

from typing import Final

Value = tuple[float, float | None]
"""Mean and standard deviation; None: one run."""

Numbers = dict[str, Value]
FIELDS: Final = ("td_m", "fo_deg", "tt_s", "p_percent", "tg_percent", "ta_percent", "tgt_percent")

TABLES: Final = """\
5.1 fast sc1 5.55±0.43 7.58±4.71 14.28±1.29 99.46±0.56 100±0 0±0
5.1 fast sc2 13.37±0.4 49.18±44.56 27.78±3.8 99.36±0.25 90.19±2.82 9.81±2.82
5.1 fast sc3 6.1±1.38 25.96±29.76 28.2±6.67 97.83±0.49 50.07±5.23 49.93±5.23
5.1 fast sc4 15.71±2.85 56.75±67.98 64.66±13.5 94.4±5.78 50.22±4.89 49.78±4.89
5.1 precise sc1 5.17±0.05 1.37±1.13 34.5±6.25 99.81±0.16 100±0 0±0
5.1 precise sc2 17.92±2.84 1.77±2.93 164.4±20.91 99.85±0.07 80.82±5.06 19.18±5.06
5.1 precise sc3 5.78±0.38 2.58±0.9 40.62±4.48 99.83±0.1 81.95±3.2 18.05±3.2
5.1 precise sc4 12.26±0.1 2.97±2.93 79±2.77 99.79±0.11 85.99±1.53 14.01±1.53
5.1 collaborative sc1 5.11±0.01 1.95±0.71 16.56±0.44 99.41±0.22 100±0 0±0
5.1 collaborative sc2 12.46±0.66 1.76±0.84 27.76±1.22 99.67±0.06 88.4±2.29 11.6±2.29
5.1 collaborative sc3 5.08±0.3 1.97±1.01 27.9±1.35 99.55±0.16 58.68±4.27 41.32±4.27
5.1 collaborative sc4 12.55±0.44 1.77±1.63 66.06±8.79 99.78±0.13 66.79±2.31 33.21±2.31
5.2 abrupt 11.96±0.103 2.14±0.47 69.37±2.43 99.648±0.08 73.86±3.23 26.14±3.23
5.2 smooth 11.99±0.17 2.16±0.85 64.39±1.24 99.82±0.05 51.25±5.41 48.75±5.41
5.3 rooms-a GA 11.64±0.14 2.57±0.6 71.84±6.85 99.37±0.12 68.64±3.14 31.36±3.14
5.3 rooms-a GAT 11.84±0.1 1.56±0.9 60.17±3.45 99.31±0.21 53.34±2.13 19.11±1.74 26.93±2.65
5.3 rooms-b GA 11.42±0.22 1.76±1.08 60.88±5.21 99.33±0.27 73.16±2.32 26.83±2.32
5.3 rooms-b GAT 11.55±0.05 1.93±0.05 51.14±0.94 99.26±0.2 65.82±1.73 13.43±0.29 20.16±1.81
5.4 simulated 8.84 0.97 64.8 99.89 78.43 8.78 12.79
5.4 real 10.11 0.88 65 99.84 67.59 12.59 19.66
5.5 simulated 51 1.05 152.71 99.94 83.24 7.72 9.03
5.5 real 41.67 103.27 142.8 68.86 59.55 31.49 8.96
"""
"""A table, its column or row, and the values of `FIELDS`."""


def _value(text: str) -> Value:
    mean, _, deviation = text.partition("±")
    return float(mean), float(deviation) if deviation else None


def published(table: str, *names: str) -> Numbers:
    """The numbers of a table for one arm. Raises KeyError for unknown names."""
    for line in TABLES.splitlines():
        words = line.split()
        count = 1 + len(names)
        if words[:count] == [table, *names]:
            return dict(zip(FIELDS, map(_value, words[count:]), strict=False))
    raise KeyError((table, *names))
