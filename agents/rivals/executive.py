"""Sequencing of missions: an executive that commits to one method at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from msgspec import Meta

from armadico.agents.rivals.arbiter import Arbiter, Decision, Wish
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.exchange import EXCHANGES, Bid, Handover
from armadico.core.messages import Action, Cycle
from armadico.mobile.messages import Way
from armadico.mobile.resources import TRAJECTORY


class ExecutiveParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the executive."""

    fails_s: Annotated[float, Meta(gt=0, le=3600)] = 60.0  # without progress a method has failed
    again_s: Annotated[float, Meta(gt=0, le=3600)] = 60.0  # until a failed one may be chosen again


class Executive(Arbiter):
    """Runs one method until it has succeeded or failed, and only then chooses the next.

    R. J. Firby, "An investigation into reactive planning in complex domains" (AAAI 1987), whose
    task net sequences; ATLANTIS (Gat, 1992) and 3T (Bonasso et al., 1997) use such an executive. A
    method, here an agent's path, has succeeded when its agent no longer wants the trajectory. It
    has failed if its path does not get shorter for a time (cognizant failure, Gat). A better bid
    does not interrupt it; a critical one does.
    """

    name = "executive"
    competes_for = (TRAJECTORY,)
    critical_for = (TRAJECTORY,)
    parameters = ExecutiveParameters
    p: ExecutiveParameters

    def __init__(self, identity: Identity, parameters: ExecutiveParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._method = ""  # the agent whose path is driven
        self._left: tuple[int, ...] = ()  # of its path: its number, and the waypoints left
        self._since = 0.0  # since when that is so
        self._failed: dict[str, float] = {}  # when each may be chosen again
        self._last: Action = b""
        self._handover: Handover | None = None

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        before, wish = self._method, wishes.get(self._method)
        if wish is not None and not wish.critical and self._stuck(wish.action):
            self._failed[before] = self.now + self.p.again_s
            wish = None
        urgent = [n for n in wishes if wishes[n].critical and not (wish and wish.critical)]
        if wish is None or urgent:
            able = [n for n in wishes if self._failed.get(n, 0.0) <= self.now]
            names = urgent or able or list(wishes)
            self._method = max(names, key=lambda n: (wishes[n].utility, n))
            wish = wishes[self._method]
        bid = Bid(wish.utility, TRAJECTORY.pack(wish.action), wish.critical)
        if self._method != before:
            self._left, self._since = (), self.now
            exchange = EXCHANGES[self.p.social.exchange or TRAJECTORY.exchange]
            period = TRAJECTORY.period_s or 0.0
            self._handover = exchange.begin(TRAJECTORY, self._last, wish.utility, bid, period)
        assert self._handover is not None, "a method has begun"
        self._last = self._handover.action(1, bid)
        return Decision(TRAJECTORY.unpack(self._last), {self._method: 1.0})

    def _stuck(self, way: Way) -> bool:
        """Return whether a path has had as many waypoints left for too long."""
        end = way.waypoints[-1]
        if (end.x, end.y) == (way.start.x, way.start.y):
            return False  # it is to stand there, as in a dock
        left = (way.id, len(way.waypoints) - way.leg)
        if left != self._left:
            self._left, self._since = left, self.now
        return self.now - self._since > self.p.fails_s


EXECUTIVE: Final = Arbitrated(
    Executive.name,
    resource=TRAJECTORY,
    about="the trajectory: one agent's path is driven until that agent has ended it, or it fails",
)
