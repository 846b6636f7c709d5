"""The utility function that all behaviours share (thesis 3.4 to 3.7)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.agents.methods.utility import MISSION, of_mission, ramp_down
from armadico.agents.missions import battery_charger, mission_planning

metres = st.floats(0.0, 5.0)


@pytest.mark.parametrize("d", [0.15, 0.2, 0.3, 0.45, 0.5])
def test_goto_as_printed_in_3_6(d: float) -> None:
    assert ramp_down(d, 0.15, 0.5, 1.0, 0.6) == pytest.approx(-1.14 * d + 1.1714, abs=2e-3)


@pytest.mark.parametrize("d", [0.5, 0.7, 1.0, 1.2])
def test_gothrough_as_printed_in_3_7(d: float) -> None:
    assert ramp_down(d, 0.5, 1.2) == pytest.approx(-1.43 * d + 1.7143, abs=2e-3)


def test_outside_the_thresholds_it_is_flat() -> None:
    assert ramp_down(0.0, 0.15, 0.5, 1.0, 0.6) == ramp_down(0.1499, 0.15, 0.5, 1.0, 0.6) == 1.0
    assert ramp_down(0.5001, 0.15, 0.5, 1.0, 0.6) == ramp_down(9.0, 0.15, 0.5, 1.0, 0.6) == 0.6


def test_thresholds_that_meet_make_a_step() -> None:
    assert (ramp_down(0.4, 0.4, 0.4), ramp_down(0.41, 0.4, 0.4)) == (1.0, 0.0)


@given(metres, metres, metres, metres)
def test_it_falls_and_stays_within_its_bounds(a: float, b: float, c: float, d: float) -> None:
    low, high = sorted((a, b))
    near, far = (ramp_down(x, low, high, 0.9, 0.2) for x in sorted((c, d)))
    assert 0.9 >= near >= far >= 0.2 - 1e-12


def test_what_a_mission_bids_is_what_the_charger_counts_it_as_worth() -> None:
    """One function, and no parameter of either: they could be set apart."""
    assert (of_mission(0.0), of_mission(1.0)) == MISSION
    assert of_mission(0.5) == pytest.approx(sum(MISSION) / 2)
    for parameters in (battery_charger.Parameters, mission_planning.Parameters):
        assert not {name for name in parameters.__struct_fields__ if "highest" in name}
