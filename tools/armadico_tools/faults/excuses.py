"""Which excuses of the auditor's rules are needed: seeds are judged without each of them, too.

`python -m armadico_tools.faults.excuses [FIRST [SEEDS [MINUTES [JOBS]]]]`. Results are kept in
results/faults, so an interrupted series continues. An excuse that no seed needs goes, unless the
fault bed never shows its occasion.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Final

from armadico.core.judgement import Answer
from armadico.observe.audit.auditor import Auditor
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico_tools.command_options import over
from armadico_tools.faults.checker import Checker, hand
from armadico_tools.faults.observations import Observation
from armadico_tools.faults.record import Bounds, bounds_of
from armadico_tools.faults.series import kept as kept_by_code
from armadico_tools.faults.variants import case_of, scenario_of
from armadico_tools.faults.workload import Workload

FILE: Final = Path("results/faults/excuses.csv")


class Strict(Checker):
    """A checker that also keeps what its auditor was given, to judge it again."""

    def __init__(self, bounds: Bounds) -> None:
        super().__init__(bounds)
        self._given: list[tuple[str, Observation]] = []

    def audit(self, auditor: Auditor, seen: Observation) -> list[Finding]:
        found = super().audit(auditor, seen)
        self._given.append((auditor.scene.disturbed, seen))
        return found

    def needed(self) -> dict[Excuse, Counter[Promise]]:
        """By excuse, the promises of which more would be broken without it."""
        accepted = _broken(self.auditor)
        return {each: self._without(each) - accepted for each in self.auditor.scene.needed}

    def _without(self, excuse: Excuse) -> Counter[Promise]:
        strict = self.auditor.without(excuse)
        for disturbed, seen in self._given:
            strict.disturbed(disturbed)
            hand(strict, seen)
        return _broken(strict)


def _broken(auditor: Auditor) -> Counter[Promise]:
    return Counter(each.promise for each in auditor.findings if each.answer is Answer.NO)


def judge(task: tuple[int, float]) -> dict[str, list[str]]:
    """The names of the promises that a seed of so many minutes breaks without each excuse."""
    seed, minutes = task
    case = case_of(seed, 60.0 * minutes)
    checker = Strict(replace(bounds_of(scenario_of(case)[0]), skew_s=0.0))
    Workload(case, checker).run()
    return {
        excuse.name: sorted(promise.name for promise in broken)
        for excuse, broken in checker.needed().items()
    }


def main(first: int = 1, seeds: int = 20, minutes: float = 2.0, jobs: int = 1) -> int:
    """Returns 1 if an excuse was never needed, 3 if it was interrupted before that is known."""
    tasks = [(seed, minutes) for seed in range(first, first + seeds)]
    kept = kept_by_code(FILE, judge)
    found = {tasks[at]: result for at, result in kept.read(list(map(repr, tasks))).items()}

    def keep(task: tuple[int, float], result: dict[str, list[str]]) -> None:
        kept.add(repr(task), result)
        found[task] = result

    whole = over(judge, [task for task in tasks if task not in found], jobs, "seeds", keep)
    needed = {
        excuse: Counter(name for one in found.values() for name in one.get(excuse.name, ()))
        for excuse in Excuse
    }
    print(f"{len(found)} of {seeds} seeds")
    for excuse, promises in needed.items():
        of = ", ".join(f"{name} in {count}" for name, count in promises.most_common())
        print(f"{excuse.name:10} {of or 'never needed'}")
    return 0 if all(needed.values()) else 1 if whole else 3


if __name__ == "__main__":
    given = sys.argv[1:]
    sys.exit(main(*map(int, given[:2]), *map(float, given[2:3]), *map(int, given[3:4])))
