"""Fuzzy systems: membership functions and Sugeno rules with linear consequents.

Used for goto's controllers (3.1 to 3.3) and the duration of an exchange (3.14 to 3.18). Plain
floats: a system of four rules takes a few microseconds, and several agents evaluate theirs ten
times a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from msgspec import Struct


class Membership(Protocol):
    """A fuzzy set over one variable."""

    def __call__(self, x: float) -> float:
        """Return the membership of `x`, in [0, 1]."""

    def distance(self, x: float) -> float:
        """Return the distance of `x` from the set's core, where membership is 1."""


class Gaussian(Struct, frozen=True):
    """The bell of figure 3.39: 1 at `mean`, 0.61 one `deviation` away."""

    mean: float
    deviation: float

    def __call__(self, x: float) -> float:
        z = (x - self.mean) / self.deviation
        return math.exp(-0.5 * z * z)

    def distance(self, x: float) -> float:
        return abs(x - self.mean)


class Shoulder(Struct, frozen=True):
    """A bell's rising half, then 1: the outermost set, so that every large value has a rule."""

    mean: float
    deviation: float

    def __call__(self, x: float) -> float:
        if x >= self.mean:
            return 1.0
        z = (x - self.mean) / self.deviation
        return math.exp(-0.5 * z * z)

    def distance(self, x: float) -> float:
        return max(0.0, self.mean - x)


class Near(Struct, frozen=True):
    """Equation 3.2: 1 up to `low`, falling linearly to 0 at `high`."""

    low: float
    high: float

    def __call__(self, x: float) -> float:
        if x <= self.low:
            return 1.0
        return (self.high - x) / (self.high - self.low) if x < self.high else 0.0

    def distance(self, x: float) -> float:
        return max(0.0, x - self.low)


class Far(Struct, frozen=True):
    """The complement of `Near` with the same bounds."""

    low: float
    high: float

    def __call__(self, x: float) -> float:
        if x >= self.high:
            return 1.0
        return (x - self.low) / (self.high - self.low) if x > self.low else 0.0

    def distance(self, x: float) -> float:
        return max(0.0, self.high - x)


class Linear(Struct, frozen=True):
    """A consequent, ``slope * x + offset`` (equation 3.14 with c_1, c_2)."""

    slope: float
    offset: float = 0.0

    def __call__(self, x: float) -> float:
        return self.slope * x + self.offset


class Rule(Struct, frozen=True):
    """IF x IS `when` THEN y = `then`."""

    when: Membership
    then: Linear


def weights(sets: Sequence[Membership], x: float) -> list[float]:
    """Return the memberships of `x`, scaled to sum to 1 (the condition on mu_i of equation 3.1).

    Where all of them underflow, far from every set, the set with the nearest core gets 1.
    """
    raw = [member(x) for member in sets]
    total = sum(raw)
    if total == 0.0:
        nearest = min(range(len(sets)), key=lambda i: sets[i].distance(x))
        return [float(i == nearest) for i in range(len(sets))]
    return [weight / total for weight in raw]


class Sugeno:
    """Rules over one variable, made crisp by the weighted mean (thesis 3.10.2)."""

    def __init__(self, rules: Sequence[Rule]) -> None:
        if not rules:
            raise ValueError("a Sugeno system needs at least one rule")
        self._sets = tuple(rule.when for rule in rules)
        self._consequents = tuple(rule.then for rule in rules)

    def __call__(self, x: float) -> float:
        """Return the mean of the rules' outputs, weighted by the memberships."""
        shares = zip(weights(self._sets, x), self._consequents, strict=True)
        return sum(share * then(x) for share, then in shares if share > 0.0)
