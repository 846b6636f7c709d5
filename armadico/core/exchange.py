"""How a resource changes hands: at once, smoothly over a fuzzy time window, or by merging (3.10.2).

The winner performs the exchange. It starts from a snapshot of the loser, its last commanded action
and its utility, and mixes in its own action with a weight that grows each cycle until, after t_f
cycles, the action is the winner's alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from armadico.core.fuzzy import Gaussian, Linear, Rule, Shoulder, Sugeno
from armadico.core.messages import Action
from armadico.core.resources import Resource

NOTHING = 1e-9
"""A utility up to this weighs nothing: the weights of (3.10) are divided by their sum, and the
smallest numbers that there are make that zero, or the quotient more than 1."""

LONGEST = 10.0
"""t_f lies in [0, 10] cycles (thesis 3.10.2)."""


@dataclass(frozen=True, slots=True)
class Bid:
    """What an agent would do with a resource, and how much that helps.

    `utility` lies in [0, 1]; 0 offers: anybody rather than me. `action` is in the order of the
    resource's parameters, or a message of its type. `critical`: about to collide. `within` bounds
    the hand-over in seconds, for a situation that cannot wait. `reason` is for people.
    """

    utility: float
    action: Any  # until it is packed (`Resource.pack`): an `Action` from then on
    critical: bool = False
    within: float | None = None
    reason: str = ""


class Handover(Protocol):
    def action(self, t: int, bid: Bid) -> Action:
        """The action to command `t` cycles after the exchange began (t is 1 in its first)."""


class Exchange(Protocol):
    """A way for a resource to change hands: a bumpless transfer, or none."""

    def begin(
        self, resource: Resource, loser: Action, loser_utility: float, bid: Bid, period: float
    ) -> Handover:
        """Start from the loser's commanded action; `period` is the resource's cycle, s."""


class _AtOnce:
    def action(self, t: int, bid: Bid) -> Action:  # noqa: ARG002
        wanted: Action = bid.action
        return wanted


AT_ONCE: Handover = _AtOnce()


class AbruptExchange:
    """The winner's action at once: what the smooth exchange is compared with (thesis 5.2.3)."""

    def begin(
        self,
        resource: Resource,  # noqa: ARG002
        loser: Action,  # noqa: ARG002
        loser_utility: float,  # noqa: ARG002
        bid: Bid,  # noqa: ARG002
        period: float,  # noqa: ARG002
    ) -> Handover:
        return AT_ONCE


@dataclass(frozen=True, slots=True)
class Blend:
    """Equation 3.10: the mean of both actions, weighted by delta_w and delta_l (3.11, 3.12)."""

    loser: tuple[float, ...]
    loser_utility: float
    window: float  # t_f, cycles

    def action(self, t: int, bid: Bid) -> Action:
        """The mixed action; the winner's alone from t_f on, or if it weighs nothing.

        That is an offer (utility 0) while the exchange goes on, or weights that sum to zero. By
        3.10 an offer would bring the loser's action back, of cycles ago.
        """
        wanted: Action = bid.action
        if t >= self.window or bid.utility <= NOTHING or isinstance(wanted, bytes):
            return wanted
        delta_l = self.loser_utility * (self.window - t) / self.window
        delta_w = bid.utility * t / self.window
        total = delta_w + delta_l
        return tuple(
            (delta_w * won + delta_l * lost) / total
            for won, lost in zip(wanted, self.loser, strict=True)
        )


# Figure 3.39's sets for `diff`, over the largest difference between both actions with each
# parameter scaled by its maximum, and rules 3.15 to 3.18 for t_f. The figure gives no numbers; the
# means and deviations are chosen, `big` is open to the right so that no difference is without a
# rule.
_RULES = (
    Rule(Gaussian(0.0, 0.05), Linear(0.0)),  # equal: nul
    Rule(Gaussian(0.15, 0.08), Linear(3.0)),  # small: short
    Rule(Gaussian(0.35, 0.10), Linear(5.0)),  # medium: medium
    Rule(Shoulder(0.60, 0.12), Linear(10.0)),  # big: long
)
fuzzy_window: Callable[[float], float] = Sugeno(_RULES)


class SmoothExchange:
    """The fuzzy exchange. t_f from the Sugeno rules, or what a critical situation leaves."""

    def begin(
        self, resource: Resource, loser: Action, loser_utility: float, bid: Bid, period: float
    ) -> Handover:
        """Equation 3.13 over the scaled parameters; a window under one cycle is none.

        Messages are not mixed.
        """
        if isinstance(loser, bytes) or isinstance(bid.action, bytes) or not resource.scale:
            return AT_ONCE
        sizes = zip(bid.action, loser, resource.scale, strict=True)
        window = min(fuzzy_window(max(abs(w - o) / s for w, o, s in sizes)), LONGEST)
        if bid.within is not None:
            window = min(window, bid.within / period)
        return Blend(loser, loser_utility, window) if window >= 1.0 else AT_ONCE


EXCHANGES: dict[str, Exchange] = {
    "smooth": SmoothExchange(),
    "abrupt": AbruptExchange(),
}
