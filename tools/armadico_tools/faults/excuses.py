"""Which excuses of the auditor's rules are needed: a run is judged again without each of them.

An excuse that no seed needs goes, unless the fault bed never shows its occasion.
"""

from __future__ import annotations

from collections import Counter

from armadico.core.judgement import Answer
from armadico.observe.audit.auditor import Auditor
from armadico.observe.audit.promises import Excuse, Finding, Promise
from armadico_tools.faults.checker import Checker, hand
from armadico_tools.faults.observations import Observation
from armadico_tools.faults.record import Bounds


class Strict(Checker):
    """A checker that also keeps what its auditor was given, to judge it again."""

    def __init__(self, bounds: Bounds | None = None) -> None:
        super().__init__(bounds)
        self._given: list[tuple[str, Observation]] = []

    def audit(self, auditor: Auditor, seen: Observation) -> list[Finding]:
        found = super().audit(auditor, seen)
        self._given.append((auditor.scene.disturbed, seen))
        return found

    def needed(self) -> dict[str, tuple[str, ...]]:
        accepted = _broken(self.auditor)
        more = {each: self._without(each) - accepted for each in self.auditor.scene.needed}
        return {
            excuse.name: tuple(sorted(promise.name for promise in broken))
            for excuse, broken in sorted(more.items(), key=lambda one: one[0].name)
            if broken
        }

    def _without(self, excuse: Excuse) -> Counter[Promise]:
        strict = self.auditor.without(excuse)
        for disturbed, seen in self._given:
            strict.disturbed(disturbed)
            hand(strict, seen)
        return _broken(strict)


def _broken(auditor: Auditor) -> Counter[Promise]:
    return Counter(each.promise for each in auditor.findings if each.answer is Answer.NO)
