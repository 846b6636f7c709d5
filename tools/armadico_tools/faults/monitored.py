"""What the auditor finds as it runs within a society: without the truth, and told of no faults."""

from __future__ import annotations

from armadico.observe.audit.auditor import Auditor
from armadico.observe.audit.live import Live
from armadico_tools.faults.checker import Checker, Violation
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.observations import Observation, Published
from armadico_tools.faults.record import Bounds


class Monitored(Checker):
    """A checker whose violations are the findings of the monitor's auditor alone."""

    def __init__(self, bounds: Bounds | None = None) -> None:
        super().__init__(bounds)
        auditor, about = Auditor(), self.record.bounds
        auditor.chart(about.walls, about.world)  # which an agent's card names
        self._live = Live(auditor)

    def update(self, seen: Observation) -> list[Violation]:
        if not isinstance(seen, Published):
            self._live.update(seen.at, None)
        elif isinstance(seen.message, Live.kinds):
            self._live.update(seen.at, seen.message)
        kept = len(self.violations)
        super().update(seen)
        news, self._live.news = self._live.news, []
        split = (each.partition(": ") for each in news)
        found = [Violation(Promise[name], seen.at, what) for name, _, what in split]
        self.violations[kept:] = found
        return found
