"""Which excuses of the auditor's rules are needed: seeds are judged without each of them, too.

`python -m armadico_tools.faults.excuses [FIRST [SEEDS [MINUTES]]]`. An excuse that no seed needs
goes, unless the fault bed never shows its occasion.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace

from armadico.config.scenarios import load_scenario
from armadico.core.judgement import Answer
from armadico.observe.audit.auditor import Auditor
from armadico.observe.audit.promises import Excuse, Promise
from armadico_tools.faults.checker import Checker, Violation
from armadico_tools.faults.observations import Observation
from armadico_tools.faults.record import Bounds, bounds_of
from armadico_tools.faults.workload import Workload, case_of


class Strict(Checker):
    """A checker with one more auditor for each excuse, which does not accept that one."""

    def __init__(self, bounds: Bounds) -> None:
        super().__init__(bounds)
        self.without = {excuse: self.auditor.without(excuse) for excuse in Excuse}

    def update(self, seen: Observation) -> list[Violation]:
        found = super().update(seen)
        for auditor in self.without.values():
            self.audit(auditor, seen)
        return found

    def needed(self) -> dict[Excuse, Counter[Promise]]:
        """By excuse, the promises of which more would be broken without it."""
        accepted = _broken(self.auditor)
        return {excuse: _broken(strict) - accepted for excuse, strict in self.without.items()}


def _broken(auditor: Auditor) -> Counter[Promise]:
    return Counter(each.promise for each in auditor.findings if each.answer is not Answer.YES)


def main(first: int = 1, seeds: int = 20, minutes: float = 2.0) -> int:
    """Returns 1 if an excuse was never needed."""
    needed: dict[Excuse, Counter[str]] = {excuse: Counter() for excuse in Excuse}
    for seed in range(first, first + seeds):
        case = case_of(seed, 60.0 * minutes)
        checker = Strict(replace(bounds_of(load_scenario(case.scenario)), skew_s=0.0))
        Workload(case, checker).run()
        for excuse, promises in checker.needed().items():
            needed[excuse].update(promise.name for promise in promises)
    for excuse, promises in needed.items():
        of = ", ".join(f"{name} in {count}" for name, count in promises.most_common())
        print(f"{excuse.name:10} {of or 'never needed'}")
    return 0 if all(needed.values()) else 1


if __name__ == "__main__":
    given = sys.argv[1:]
    sys.exit(main(*map(int, given[:2]), *map(float, given[2:3])))
