"""The messages of a joystick's agent."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from armadico.core.messages import (
    Counter,
    Cycle,
    Deflection,
    Label,
    Message,
    Name,
    Speed,
    Text,
    Turn,
)
from armadico.core.services import event, state
from armadico.mobile.messages import ByHand


class Stick(Message, frozen=True):
    """Where a hand has the stick: shares of the most that the teleop agent may drive.

    Said about ten times a second for as long as the hand is on it, and once more with `held` false
    when it lets go. The cycle is the newest that the hand has heard of the robot: who does not hear
    where the robot is does not drive it, and a stick that comes late is stale like anything else.
    """

    cycle: Cycle
    hand: Name  # one a terminal, page or gamepad, new with each start: `ann@lab-3f9c2a10`
    number: Counter  # grows with each of this hand's
    v: Deflection  # forward positive,
    w: Deflection  # and left
    held: bool = True


class TeleopStatus(ByHand, frozen=True):
    """The teleop agent's report: of each cycle while a hand is on the stick, else each second.

    Of two hands the first has it until it lets go, or is silent for 0.5 s: who reads another's name
    here is not obeyed.
    """

    cycle: Cycle
    hand: Label = ""  # whose; empty: nobody's
    holds: bool = False  # the wheels
    v: Speed = 0.0  # what it would have the robot do now, m/s
    w: Turn = 0.0  # and rad/s
    v_max: Speed = 0.0  # what a whole deflection stands for
    w_max: Turn = 0.0
    waits: Annotated[tuple[Name, ...], Meta(max_length=8)] = ()  # hands that want it, too
    note: Text = ""  # why the robot does less than the stick says

    @property
    def driven_by(self) -> str:
        """The hand that is on the stick."""
        return self.hand


event(Stick, "teleop/stick", "where a hand has the stick", rate_hz=10, fresh_cycles=3)
state(TeleopStatus, "teleop/status", 1, 3, "whose hand drives; 10 Hz while one does")
