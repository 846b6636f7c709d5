"""A liar, which bids high and drives on whatever is ahead, is named by all that people look at."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from armadico.config.scenarios import load_scenario
from armadico.core.discovery import agent_class
from armadico.core.membership import agent_of
from armadico.core.messages import Message, MonitorReport, RobotState
from armadico.observe.diagnosis import diagnose
from armadico.observe.findings import Finding
from armadico_tools.faults import planted
from tests.watch.observed import Observed

ROW_S = 0.3
"""Capped commands farther apart are not in a row."""

SOON_S = 2.0
LONG_S = 60.0


class Liar(Observed):
    """A society with a liar and a monitor, and when each named it, s from the first command."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed, load_scenario("sc4"))
        self.run.add(agent_class("monitor"))
        planted.plant("lies", self.agent("goto"))
        self.row_at = self.capped_at = 0.0  # since when it commands what is forbidden; the newest
        self.named: dict[str, float] = {}
        self.touched = 0
        self.mesh.watch(self._look, RobotState, MonitorReport)
        self.run.begin()
        self.mesh.run(LONG_S, lambda: len(self.named) == 2)

    def _look(self, _key: str, message: Message, now: float) -> None:
        if isinstance(message, RobotState):
            if message.capped and agent_of(message.driver) == "goto":
                self.row_at = now if now - self.capped_at > ROW_S else self.row_at
                self.capped_at = now
        elif isinstance(message, MonitorReport):
            named = {"report": message.broken, "shown": [str(f) for f in self._findings(now)]}
            for by, texts in named.items():
                if any("HONEST: goto" in text for text in texts):
                    self.named.setdefault(by, now - self.row_at)

    def _findings(self, now: float) -> Sequence[Finding]:
        """What `top`, `why --live`, `doctor` and the page show then."""
        return diagnose(self.view, now=now)


@pytest.mark.long(but=("1",))
@pytest.mark.parametrize("seed", [1, 4, 9])
def test_a_liar_is_named_within_two_seconds(seed: int) -> None:
    liar = Liar(seed)
    assert set(liar.named) == {"report", "shown"}
    assert max(liar.named.values()) <= SOON_S
    truth = liar.run.watch.view.truth
    assert truth is None or truth.collisions == 0
