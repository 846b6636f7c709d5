"""Tests of two arms that drove the same seeds. SciPy is imported late: it is slow.

A pair is a seed: the same world, start and noise. Shares are compared by McNemar's exact test and
Newcombe's interval of the difference, numbers by Wilcoxon's signed ranks and Hodges and Lehmann's
estimate with its interval. Holm's correction is over all comparisons of one family.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from math import exp, inf, log, log1p, sqrt
from typing import Final

from msgspec import Struct

Pairs = Sequence[tuple[float, float]]
"""An arm's values, each with the value of the arm that it is compared with."""

LEAST: Final = 6
"""Fewer pairs have no 95 % interval of the signed ranks: 2 / 2^5 is more than 5 %."""

EXACT: Final = 50
"""Up to so many pairs the interval of the signed ranks is exact."""

Z95: Final = 1.959963984540054


class Shares(Struct, frozen=True):
    """Two shares of the same seeds: how often only one of both succeeded."""

    n: int
    only_first: int
    only_second: int
    difference: float  # first less second
    low: float  # of its 95 % interval
    high: float
    p: float  # two-sided


class Shift(Struct, frozen=True):
    """By how much an arm's numbers differ from another's, or their ratio."""

    n: int
    difference: float  # or the ratio
    low: float  # of the 95 % interval
    high: float
    p: float  # two-sided


def shares(pairs: Sequence[tuple[bool, bool]]) -> Shares | None:
    """McNemar's exact test, and Newcombe's interval (1998, method 10); None without a pair."""
    n = len(pairs)
    if not n:
        return None
    from scipy.stats import binomtest

    both = sum(a and b for a, b in pairs)
    first = sum(a and not b for a, b in pairs)
    second = sum(b and not a for a, b in pairs)
    neither = n - both - first - second
    p = float(binomtest(first, first + second).pvalue) if first + second else 1.0
    difference = (first - second) / n
    (a, a_low, a_high), (b, b_low, b_high) = _wilson(both + first, n), _wilson(both + second, n)
    sides = (both + first) * (second + neither) * (both + second) * (first + neither)
    phi = 0.0
    if sides:
        numerator = float(both * neither - first * second)
        if numerator > 0.0:  # corrected for continuity
            numerator = max(numerator - n / 2, 0.0)
        phi = numerator / sqrt(sides)
    down = (a - a_low) ** 2 - 2 * phi * (a - a_low) * (b_high - b) + (b_high - b) ** 2
    up = (a_high - a) ** 2 - 2 * phi * (a_high - a) * (b - b_low) + (b - b_low) ** 2
    low, high = difference - sqrt(max(down, 0.0)), difference + sqrt(max(up, 0.0))
    return Shares(n, first, second, difference, low, high, p)


def _wilson(successes: int, n: int) -> tuple[float, float, float]:
    """A share with the ends of Wilson's 95 % interval."""
    from scipy.stats import binomtest

    ends = binomtest(successes, n).proportion_ci(method="wilson")
    return successes / n, float(ends.low), float(ends.high)


def shift(pairs: Pairs) -> Shift | None:
    """The difference, first less second, by Hodges and Lehmann; None without a pair."""
    return _walsh([a - b for a, b in pairs])


def ratio(pairs: Pairs) -> Shift | None:
    """The ratio of first to second, by the logarithms of positive numbers."""
    found = _walsh([log(a / b) for a, b in pairs])
    if found is None:
        return None
    return Shift(found.n, exp(found.difference), exp(found.low), exp(found.high), found.p)


def _walsh(differences: Sequence[float]) -> Shift | None:
    """The median of all means of two differences, with the interval of the signed ranks."""
    n = len(differences)
    if not n:
        return None
    import numpy as np

    values = np.asarray(differences, dtype=np.float64)
    rows, columns = np.triu_indices(n)
    means = np.sort((values[rows] + values[columns]) / 2.0)
    low, high = -inf, inf  # so few pairs bound nothing
    if n >= LEAST:
        out = left_out(n)
        low, high = float(means[out]), float(means[len(means) - 1 - out])
    return Shift(n, float(np.median(means)), low, high, _wilcoxon(differences, "two-sided"))


def left_out(n: int) -> int:
    """How many of the means of n differences are below their 95 % interval, as many as above.

    That is the largest sum of the ranks with a probability of at most 2.5 %, counted over all 2^n
    signs. Above 50 the sum is nearly normal.
    """
    if n > EXACT:
        return int(n * (n + 1) / 4 - Z95 * sqrt(n * (n + 1) * (2 * n + 1) / 24))
    ways = [1]  # by the sum of ranks
    for rank in range(1, n + 1):
        longer = [0] * rank
        ways = [a + b for a, b in zip(ways + longer, longer + ways, strict=True)]
    most = 2**n // 40
    return next(total for total, upto in enumerate(accumulate(ways)) if upto > most) - 1


def _wilcoxon(differences: Sequence[float], alternative: str) -> float:
    """The p value of the signed ranks; 1 if all differences are 0."""
    from scipy.stats import wilcoxon

    if not any(differences):
        return 1.0
    return float(wilcoxon(differences, alternative=alternative, zero_method="pratt").pvalue)


def sameness(pairs: Pairs, margin: float) -> float:
    """The p value of two one-sided tests that the ratio is beyond the margin; 1 without a pair."""
    if not pairs:
        return 1.0
    logs, bound = [log(a / b) for a, b in pairs], log1p(margin)
    above = _wilcoxon([x + bound for x in logs], "greater")
    below = _wilcoxon([x - bound for x in logs], "less")
    return max(above, below)


def holm(ps: Sequence[float]) -> list[float]:
    """The p values, corrected for so many comparisons (Holm 1979), in their order."""
    order = sorted(range(len(ps)), key=lambda at: ps[at])
    found, largest = [1.0] * len(ps), 0.0
    for rank, at in enumerate(order):
        largest = max(largest, min(1.0, (len(ps) - rank) * ps[at]))
        found[at] = largest
    return found
