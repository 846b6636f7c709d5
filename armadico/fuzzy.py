"""Fuzzy sets and Sugeno systems of one input (thesis 3.5.1, 3.10.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp

Membership = Callable[[float], float]
"""How far a value belongs to a set, in [0, 1]."""


@dataclass(frozen=True, slots=True)
class Gaussian:
    """A bell: 1 at the mean, 0.61 one deviation away."""

    mean: float
    deviation: float

    def __call__(self, x: float) -> float:
        """How far x belongs."""
        z = (x - self.mean) / self.deviation
        return exp(-0.5 * z * z)


@dataclass(frozen=True, slots=True)
class Shoulder:
    """A bell that stays 1 beyond its mean: the outermost set, so that no value is in none."""

    mean: float
    deviation: float

    def __call__(self, x: float) -> float:
        """How far x belongs."""
        if x >= self.mean:
            return 1.0
        z = (x - self.mean) / self.deviation
        return exp(-0.5 * z * z)


@dataclass(frozen=True, slots=True)
class Near:
    """The fuzzy set of equation 3.2: 1 up to `low`, falling to 0 at `high`."""

    low: float
    high: float

    def __call__(self, x: float) -> float:
        """How far x belongs; `far` is the rest to 1."""
        if x <= self.low:
            return 1.0
        if x >= self.high:
            return 0.0
        return (self.high - x) / (self.high - self.low)


@dataclass(frozen=True, slots=True)
class Linear:
    """A Sugeno conclusion: slope times the input, plus a constant (3.3, 3.14)."""

    slope: float
    constant: float = 0.0

    def __call__(self, x: float) -> float:
        """The conclusion for this input."""
        return self.slope * x + self.constant


@dataclass(frozen=True, slots=True)
class Rule:
    """If the input is in the set, then the output is the conclusion."""

    condition: Membership
    conclusion: Callable[[float], float]


class Sugeno:
    """The weighted mean of the conclusions, each by how far its condition holds."""

    def __init__(self, rules: Sequence[Rule]) -> None:
        self._rules = tuple(rules)

    def __call__(self, x: float) -> float:
        """The output for this input. Raises ValueError where no rule holds at all."""
        total = weighted = 0.0
        for rule in self._rules:
            weight = rule.condition(x)
            total += weight
            weighted += weight * rule.conclusion(x)
        if total <= 0.0:
            raise ValueError(f"no rule covers {x}")
        return weighted / total
