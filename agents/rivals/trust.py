"""An auction in which utilities count by the trust that their agents have earned."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.agents.rivals.arbiter import Decision, Wish
from armadico.agents.rivals.mechanisms import Auction, AuctionParameters
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Message
from armadico.mobile.messages import Pose, Trajectory
from armadico.mobile.route import Route


class TrustParameters(AuctionParameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of trust."""

    judged: Annotated[int, Meta(ge=1, le=1000)] = 40  # cycles that an agent led, over which
    pace: Annotated[float, Meta(gt=0, le=10)] = 0.08  # m/s to the goal, promised by a utility of 1
    learns: Annotated[float, Meta(gt=0, le=1)] = 0.05  # of the gap to what was kept, per cycle led
    forgives_s: Annotated[float, Meta(gt=0, le=1e6)] = 3000.0  # to full trust without leading
    least: Annotated[float, Meta(ge=0, le=1)] = 0.1  # of the trust


class Trust(Auction):
    """The auction, with each utility times the trust that its agent has earned.

    A utility promises progress along the trajectory. Over the last cycles in which an agent led,
    however spread, the progress is compared with the promise, and trust moves towards the share
    that was kept. So an agent that bids 0.99 and leads nowhere loses the wheels after some seconds.
    A critical bid counts in full: who may be critical is declared. Own design, after the reputation
    of promises kept in open systems (Huynh, Jennings and Shadbolt 2006).
    """

    name = "trust"
    parameters = TrustParameters
    receives: ClassVar[tuple[type[Message], ...]] = (Pose, Trajectory)
    p: TrustParameters

    def __init__(self, identity: Identity, parameters: TrustParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.trust: dict[str, float] = {}
        self._route = Route()
        self._led: dict[str, deque[tuple[float, float]]] = {}  # progress and promise, m
        self._before: tuple[float, str, float, float] | None = None  # when, who, utility, to go

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Begin anew: the rest of another trajectory is no measure of progress."""
        self._route, self._before = Route.of(trajectory), None

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:
        to_go = self._to_go()
        self._judge(to_go)
        counted = {
            name: wish
            if wish.critical
            else replace(wish, utility=wish.utility * self.trust.get(name, 1.0))
            for name, wish in wishes.items()
        }
        decision = super().decide(counted, cycle)
        lead = max(decision.shares, key=lambda name: decision.shares[name])
        self._before = None if to_go is None else (self.now, lead, wishes[lead].utility, to_go)
        return decision

    def _to_go(self) -> float | None:
        pose = self.latest(Pose)
        if pose is None or not self._route.waypoints:
            return None
        self._route.advance(pose.x, pose.y)
        return self._route.to_go(pose.x, pose.y)

    def _judge(self, to_go: float | None) -> None:
        """Compare the last leader's progress with its promises, and forgive with the time."""
        if to_go is None or self._before is None:
            return
        p, (at, name, utility, before) = self.p, self._before
        past = self.now - at
        self.trust = {n: min(t + past / p.forgives_s, 1.0) for n, t in self.trust.items()}
        led = self._led.setdefault(name, deque(maxlen=p.judged))
        led.append((before - to_go, p.pace * utility * past))
        promised = sum(each for _, each in led)
        if len(led) < p.judged or promised <= 0.0:
            return
        kept = min(max(sum(each for each, _ in led) / promised, 0.0), 1.0)
        known = self.trust.get(name, 1.0)
        self.trust[name] = max(known + p.learns * (kept - known), p.least)


TRUST: Final = Arbitrated(
    Trust.name, about="the auction, each utility times the trust that its agent has earned"
)
