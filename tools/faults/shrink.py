"""Makes a case that breaks a promise small: fewer faults, shorter ones, an earlier end.

Delta debugging (Zeller's ddmin) over the list of faults: what is left out stays out if the same
promise still breaks. A run is repeatable to the byte, so each answer is final.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from msgspec.structs import replace

from armadico.tools.faults.plan import Case, Fault

TRIES: Final = 200
"""Runs that shrinking may cost."""

AFTER_S: Final = 0.2
"""A case ends so long after its promise broke."""

SHORTER: Final = (0.25, 0.5, 0.75)
"""Shares of its length that each fault is tried with."""

Broken = Callable[[Case], float | None]
"""Runs a case; when the promise broke (s), or None."""


class Shrinker:
    """Shrinks one case; `tries` counts the runs."""

    def __init__(self, broken: Broken, most: int = TRIES) -> None:
        self._broken = broken
        self._most = most
        self.tries = 0

    def shrink(self, case: Case) -> Case:
        """The smallest case that it finds. Raises ValueError if nothing breaks to begin with."""
        found = self._try(case)
        if found is None:
            raise ValueError(f"seed {case.seed} breaks nothing")
        case = self._fewer(found)
        return self._shorter(case)

    def _try(self, case: Case) -> Case | None:
        """The case with its end cut off, if it still breaks."""
        if self.tries >= self._most:
            return None
        self.tries += 1
        at = self._broken(case)
        if at is None:
            return None
        kept = tuple(fault for fault in case.faults if fault.at <= at)
        return replace(case, lasts=min(case.lasts, round(at + AFTER_S, 3)), faults=kept)

    def _fewer(self, case: Case) -> Case:
        parts = 2
        while case.faults:
            for chunk in _chunks(case.faults, parts):
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


def _chunks(faults: Sequence[Fault], parts: int) -> list[Sequence[Fault]]:
    """The list in so many parts, as even as can be."""
    size = -(-len(faults) // parts)
    return [faults[start : start + size] for start in range(0, len(faults), size)]
