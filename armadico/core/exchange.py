"""Exchanges of a resource: abrupt, smooth over a fuzzy time window, or by merging (3.10.2).

The winner performs the exchange. It starts from the loser's last commanded action and utility. It
blends in its own action with a weight that grows each cycle. After t_f cycles the action is the
winner's alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol, cast

from armadico.core.fuzzy import Gaussian, Linear, Rule, Shoulder, Sugeno
from armadico.core.messages import Action, Message
from armadico.core.resources import Resource

# A utility up to this counts as 0. The weights of (3.10) are divided by their sum: with very small
# numbers the sum is zero, or the quotient exceeds 1.
NOTHING = 1e-9

LONGEST = 10.0  # largest t_f, cycles (thesis 3.10.2)


@dataclass(frozen=True, slots=True)
class Bid:
    """An agent's proposed action for a resource, with its utility.

    `utility` lies in [0, 1]; 0 offers the resource to any other agent. `action` is in the order of
    the resource's parameters, or a message of its type. `critical`: a collision is imminent.
    `within` limits the duration of the exchange, s. `reason` is for people.
    """

    utility: float
    action: Iterable[float] | Message
    critical: bool = False
    within: float | None = None
    reason: str = ""

    @property
    def packed(self) -> Action:
        """The action as it is sent: of a bid that is checked (`Resource.pack`)."""
        return cast("Action", self.action)


class Handover(Protocol):
    def action(self, t: int, bid: Bid) -> Action:
        """Return the action to command in cycle `t` of the exchange, from 1."""


class Exchange(Protocol):
    """A kind of exchange."""

    def begin(
        self, resource: Resource, loser: Action, loser_utility: float, bid: Bid, period: float
    ) -> Handover:
        """Begin with the loser's commanded action; `period` is the resource's cycle, s."""


class _AtOnce:
    def action(self, t: int, bid: Bid) -> Action:  # noqa: ARG002
        return bid.packed


AT_ONCE: Handover = _AtOnce()


class AbruptExchange:
    """The winner's action immediately: the baseline for the smooth exchange (thesis 5.2.3)."""

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
        """Return the blended action; the winner's alone from t_f on, or with a utility of 0."""
        # By 3.10 a utility of 0 would bring back the loser's action, which is cycles old.
        wanted = bid.packed
        if t >= self.window or bid.utility <= NOTHING or isinstance(wanted, bytes):
            return wanted
        delta_l = self.loser_utility * (self.window - t) / self.window
        delta_w = bid.utility * t / self.window
        total = delta_w + delta_l
        return tuple(
            (delta_w * won + delta_l * lost) / total
            for won, lost in zip(wanted, self.loser, strict=True)
        )


# The sets of figure 3.39 for `diff` and rules 3.15 to 3.18 for t_f. `diff` is the largest
# difference between both actions, each parameter scaled by its maximum. The figure gives no
# numbers: the means and deviations are chosen here. `big` is open to the right, so that every
# difference has a rule.
_RULES = (
    Rule(Gaussian(0.0, 0.05), Linear(0.0)),  # equal: nul
    Rule(Gaussian(0.15, 0.08), Linear(3.0)),  # small: short
    Rule(Gaussian(0.35, 0.10), Linear(5.0)),  # medium: medium
    Rule(Shoulder(0.60, 0.12), Linear(10.0)),  # big: long
)
fuzzy_window: Callable[[float], float] = Sugeno(_RULES)


class SmoothExchange:
    """The fuzzy exchange: t_f by the Sugeno rules, at most `Bid.within`."""

    def begin(
        self, resource: Resource, loser: Action, loser_utility: float, bid: Bid, period: float
    ) -> Handover:
        """Begin with equation 3.13; messages, and a window below one cycle, are not blended."""
        wanted = bid.packed
        if isinstance(loser, bytes) or isinstance(wanted, bytes) or not resource.scale:
            return AT_ONCE
        sizes = zip(wanted, loser, resource.scale, strict=True)
        window = min(fuzzy_window(max(abs(w - o) / s for w, o, s in sizes)), LONGEST)
        if bid.within is not None:
            window = min(window, bid.within / period)
        return Blend(loser, loser_utility, window) if window >= 1.0 else AT_ONCE


EXCHANGES: dict[str, Exchange] = {
    "smooth": SmoothExchange(),
    "abrupt": AbruptExchange(),
}
