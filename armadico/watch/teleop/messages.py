"""The messages of the teleop agent."""

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
    """The position of a hand's stick, as shares of the teleop agent's speed limits.

    Published about ten times per second while the hand is on the stick, and once with `held` false
    on release. The cycle is the newest that the hand has received. So a hand without messages from
    the robot cannot drive it, and a late position is stale.
    """

    cycle: Cycle
    hand: Name  # one terminal, page or gamepad, new with each start: `ann@lab-3f9c2a10`
    number: Counter  # increases with each message of the hand
    v: Deflection  # forward positive
    w: Deflection  # left positive
    held: bool = True


class TeleopStatus(ByHand, frozen=True):
    """The teleop agent's report: each cycle while a hand is on the stick, else each second.

    The first of two hands has the stick until it releases it, or is silent for 0.5 s. The other is
    not obeyed meanwhile.
    """

    cycle: Cycle
    hand: Label = ""  # the hand that has the stick; empty: none
    holds: bool = False  # the wheels
    v: Speed = 0.0  # the speed that it commands, m/s
    w: Turn = 0.0  # the turn rate that it commands, rad/s
    v_max: Speed = 0.0  # the speed of a full deflection
    w_max: Turn = 0.0
    waits: Annotated[tuple[Name, ...], Meta(max_length=8)] = ()  # other hands that want it
    note: Text = ""  # why the robot is slower than the stick demands

    @property
    def driven_by(self) -> str:
        """The hand that is on the stick."""
        return self.hand


event(
    Stick,
    "teleop/stick",
    "the position of a hand's stick",
    rate_hz=10,
    fresh_cycles=3,
    several=True,
    sender="hand",
    guests=True,
)
state(TeleopStatus, "teleop/status", 1, 3, "which hand drives; 10 Hz while one does")
