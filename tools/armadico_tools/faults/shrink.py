"""Makes a case that breaks a promise small: fewer faults, shorter ones, an earlier end.

Delta debugging (Zeller's ddmin) over the list of faults: a fault is removed if the same promise
still breaks without it. A run is exactly repeatable, but removing a fault changes all noise after
it. So each case is tried with several seeds of noise, and may break with any of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from msgspec.structs import replace

from armadico_tools.faults.plan import Case

TRIES: Final = 200
"""Most runs of a shrinking."""

AFTER_S: Final = 0.2
"""A case ends this long after its promise broke."""

SHORTER: Final = (0.25, 0.5, 0.75)
"""Shares of its length that are tried for each fault."""

NOISES: Final = 4
"""Seeds of noise that are tried for each case."""

NOISE: Final = 1_000_003
"""Difference between two of these seeds."""

Broken = Callable[[Case], float | None]
"""Runs a case. Returns when the promise broke (s), or None."""


class Shrinker:
    """Shrinks one case; `tries` counts the runs, and `step` is called after each.

    A case is tried with `NOISES` seeds of noise, its own first. The result has the seed with which
    it broke.
    """

    def __init__(
        self,
        broken: Broken,
        most: int = TRIES,
        step: Callable[[], None] = lambda: None,
    ) -> None:
        self._broken = broken
        self._most = most
        self._step = step
        self.tries = 0

    def shrink(self, case: Case) -> Case:
        """The smallest case found. Raises ValueError if the case breaks nothing."""
        found = self._try(case)
        if found is None:
            raise ValueError(f"seed {case.seed} breaks nothing")
        case = self._fewer(found)
        return self._shorter(case)

    def _try(self, case: Case) -> Case | None:
        """The case without its end, if it breaks with any of the seeds."""
        for noise in range(NOISES):
            if self.tries >= self._most:
                return None
            self.tries += 1
            tried = replace(case, seed=case.seed + noise * NOISE)
            at = self._broken(tried)
            self._step()
            if at is not None:
                kept = tuple(fault for fault in case.faults if fault.at <= at)
                lasts = min(case.lasts, round(at + AFTER_S, 3))
                return replace(tried, lasts=lasts, faults=kept)
        return None

    def _fewer(self, case: Case) -> Case:
        parts = 2
        while case.faults:
            size = -(-len(case.faults) // parts)  # rounded up
            for start in range(0, len(case.faults), size):
                chunk = case.faults[start : start + size]
                rest = tuple(fault for fault in case.faults if fault not in chunk)
                found = self._try(replace(case, faults=rest))
                if found is not None:
                    case, parts = found, max(parts - 1, 2)
                    break
            else:
                if parts >= len(case.faults):
                    return case
                parts = min(2 * parts, len(case.faults))
        return case

    def _shorter(self, case: Case) -> Case:
        for index in range(len(case.faults)):
            for share in SHORTER:
                if index >= len(case.faults):
                    break
                fault = case.faults[index]
                less = replace(fault, lasts=round(fault.lasts * share, 3))
                found = self._try(
                    replace(case, faults=(*case.faults[:index], less, *case.faults[index + 1 :]))
                )
                if found is not None:
                    case = found
                    break
        return case
