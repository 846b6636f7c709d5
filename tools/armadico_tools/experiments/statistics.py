"""Means, intervals and p values. SciPy is imported late, because it is slow to import."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan, sqrt
from statistics import fmean, stdev

from msgspec import Struct

PUBLISHED_RUNS = 5
"""Number of runs of each case in the thesis."""


class Spread(Struct, frozen=True):
    """A sample's mean, standard deviation, and the 95 % interval of the mean (Student's t)."""

    n: int
    mean: float
    sd: float
    low: float
    high: float


def spread(values: Sequence[float]) -> Spread | None:
    """Mean, deviation and interval of a sample; None if it is empty. One value has deviation 0."""
    if not values:
        return None
    n, mean = len(values), fmean(values)
    if n == 1:
        return Spread(1, mean, 0.0, mean, mean)
    from scipy.stats import t

    sd = stdev(values)
    half = float(t.ppf(0.975, n - 1)) * sd / sqrt(n)
    return Spread(n, mean, sd, mean - half, mean + half)


def against(ours: Spread, mean: float, sd: float, n: int = PUBLISHED_RUNS) -> float | None:
    """Welch's p for equal means of ours and the thesis; None without variation or with n = 1."""
    if ours.n < 2 or (ours.sd == 0.0 and sd == 0.0):
        return None
    from scipy.stats import ttest_ind_from_stats

    found = ttest_ind_from_stats(ours.mean, ours.sd, ours.n, mean, sd, n, equal_var=False)
    return _p(found.pvalue)


def paired(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Wilcoxon's signed-rank p for two arms with the same seeds; None if they never differ."""
    if len(a) < 2 or all(x == y for x, y in zip(a, b, strict=True)):
        return None
    from scipy.stats import wilcoxon

    return _p(wilcoxon(a, b).pvalue)


def at_least(reached: int, n: int) -> float:
    """The lower end of the one-sided 95 % interval of a share (Clopper and Pearson)."""
    from scipy.stats import beta

    return 0.0 if reached == 0 else float(beta.ppf(0.05, reached, n - reached + 1))


def _p(value: float) -> float | None:
    return None if isnan(value) else float(value)
