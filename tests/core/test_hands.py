"""What to do at the robot before a stop can be released."""

from __future__ import annotations

import pytest

from armadico.core.hands import RESUME, Hand, keeps_motors_off, release, remedy
from armadico.core.messages import Stop, checked


@pytest.mark.parametrize("hand", Hand)
def test_each_can_be_encoded_and_decoded(hand: Hand) -> None:
    assert checked(Stop(1, stopped=True, by=hand, press=1)).by == hand
    assert keeps_motors_off(Stop(1, stopped=True, by=hand)) is (hand in (Hand.MOTORS, Hand.BUTTON))
    assert remedy(Stop(1, stopped=True, by=hand), motors=False)


@pytest.mark.parametrize("by", ["anna", *Hand])
def test_while_the_motors_are_off_a_release_alone_is_never_promised(by: str) -> None:
    stop = Stop(1, stopped=True, by=by)
    assert release(stop, motors=False) != RESUME
    assert release(stop, motors=False).endswith("`armadico resume`")


@pytest.mark.parametrize("by", ["anna", Hand.MOTORS, Hand.BUTTON])
def test_once_they_are_on_a_release_is_enough(by: str) -> None:
    assert release(Stop(1, stopped=True, by=by), motors=True) == RESUME
