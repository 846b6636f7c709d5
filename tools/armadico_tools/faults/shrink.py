"""Makes a case that breaks a promise small: fewer faults, shorter ones, an earlier end.

Delta debugging (Zeller's ddmin) over the list of faults: what is left out stays out if the same
promise still breaks. A run is repeatable to the byte, but whatever is left out changes all noise
after it: so each case is tried with a few seeds of noise, and breaking under any of them will do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from msgspec.structs import replace

from armadico_tools.faults.plan import Case

TRIES: Final = 200
"""Runs that shrinking may cost."""

AFTER_S: Final = 0.2
"""A case ends so long after its promise broke."""

SHORTER: Final = (0.25, 0.5, 0.75)
"""Shares of its length that each fault is tried with."""

NOISES: Final = 4
"""So many seeds of noise each case is tried with."""

NOISE: Final = 1_000_003
"""What lies between one of them and the next."""

Broken = Callable[[Case], float | None]
"""Runs a case; when the promise broke (s), or None."""


class Shrinker:
    """Shrinks one case; `tries` counts the runs, and `step` is called after each.

    `noises` is how many seeds of noise a case is tried with, its own first. What it finds has the
    seed with which it broke.
    """

    def __init__(
        self,
        broken: Broken,
        most: int = TRIES,
        noises: int = NOISES,
        step: Callable[[], None] = lambda: None,
    ) -> None:
        self._broken = broken
        self._most = most
        self._noises = noises
        self._step = step
        self.tries = 0

    def shrink(self, case: Case) -> Case:
        """The smallest case that it finds. Raises ValueError if nothing breaks to begin with."""
        found = self._try(case)
        if found is None:
            raise ValueError(f"seed {case.seed} breaks nothing")
        case = self._fewer(found)
        return self._shorter(case)

    def _try(self, case: Case) -> Case | None:
        """The case with its end cut off, if it still breaks with any of the seeds."""
        for noise in range(self._noises):
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
            size = -(-len(case.faults) // parts)  # as even as can be
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
