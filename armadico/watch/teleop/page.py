"""The stick on the control page: browsers drive by hand; shows which hand drives (sans-IO)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

from msgspec import Meta
from msgspec.structs import replace

from armadico.core.messages import Cycle, Deflection
from armadico.core.services import requested
from armadico.observe.described import rounded
from armadico.observe.page_part import Desk, Part
from armadico.observe.page_requests import Asked, RequestError
from armadico.watch.teleop.messages import Stick, TeleopStatus

# The shortest time between two messages of one stick: a browser cannot flood the mesh.
STICK_S: Final = 0.05


class Hold(Asked, frozen=True, tag="stick"):
    """The stick's position, in shares; not `held`: the hand has released it.

    `cycle` is the newest that the page has shown, so that a late position is stale.
    """

    v: Deflection
    w: Deflection
    cycle: Annotated[int, Meta(ge=0, le=2**52)]
    held: bool = True


@dataclass
class _Hand:
    """A browser's hand on the stick."""

    number: int = 0  # of the last message
    next_at: float = 0.0
    newest: Stick | None = None  # to be published then


class Hands(Part):
    """Passes the positions of all sticks on to the teleop agent."""

    requests = (Hold,)
    provides = (Stick,)

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._hands: dict[str, _Hand] = {}  # by browser

    def request(self, browser: str, request: Hold, t: float) -> None:
        """Publish the position, with the cycle that the browser has shown."""
        state = self.view.state
        if state is None:
            raise RequestError("no message from the robot")
        cycle = Cycle(state.cycle.epoch, min(request.cycle, state.cycle.number))
        hand = self._hands.setdefault(browser, _Hand())
        hand.newest = Stick(cycle, browser, 0, request.v, request.w, request.held)
        self._publish_if_due(hand, t)

    def on_leave(self, browser: str) -> None:
        """Release the stick at once."""
        hand, state = self._hands.pop(browser, None), self.view.state
        if hand is not None and state is not None:
            self._publish(hand, Stick(state.cycle, browser, 0, 0.0, 0.0, held=False))

    def wake(self, t: float) -> None:
        """Publish the positions that are due."""
        for hand in self._hands.values():
            self._publish_if_due(hand, t)

    def show(self, parts: dict[str, object], t: float) -> None:
        """Show which hand drives; `there`: a teleop agent is alive."""
        there = any(a.card and requested(Stick, a.card) for a in self.view.agents)
        found: dict[str, object] = {"there": there, "hand": "", "holds": False}
        status = self.view.hand(t)
        if isinstance(status, TeleopStatus):
            shown = ("hand", "holds", "v", "w", "v_max", "w_max", "note")
            found |= {name: rounded(getattr(status, name)) for name in shown}
        parts["hand"] = found

    def _publish_if_due(self, hand: _Hand, t: float) -> None:
        if hand.newest is not None and t >= hand.next_at:
            hand.next_at = t + STICK_S
            self._publish(hand, hand.newest)

    def _publish(self, hand: _Hand, stick: Stick) -> None:
        hand.number += 1
        hand.newest = None
        self.desk.publish(replace(stick, number=hand.number))
