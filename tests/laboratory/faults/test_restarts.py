"""The agents that know the robot's pose, restarted in any order, twice, while it drives."""

from __future__ import annotations

from itertools import permutations

import pytest

from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.plan import PLACERS, Case, Fault
from armadico_tools.faults.record import MOVING_M_S
from armadico_tools.faults.workload import Workload
from tests.laboratory.faults.test_planted import promises


@pytest.mark.long(but=("localization robot encoder",))
@pytest.mark.parametrize("order", [*permutations(PLACERS)], ids=" ".join)
def test_restarted_in_any_order_the_pose_is_right_or_reported_lost(order: tuple[str, ...]) -> None:
    turns = tuple(Fault("in-turn", at, 5.0, order) for at in (6.0, 14.0))
    workload = Workload(Case(1, "sc4", 30.0, turns))
    outcome = workload.run()
    assert Promise.POSE.name not in promises(outcome)
    assert outcome.overconfident_s < 1.0
    assert outcome.driven_m > 30.0 * MOVING_M_S
    again = [node.name for node in workload.mesh.nodes]
    assert [again.count(name) for name in PLACERS] == [3, 3, 3]
