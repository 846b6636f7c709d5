"""Motor schemas: the sum of the behaviours' vectors."""

from __future__ import annotations

from collections.abc import Mapping
from math import atan2, cos, hypot, pi, sin
from typing import Annotated, ClassVar, Final

from msgspec import Meta, field

from armadico.agents.rivals.arbiter import REST, Arbiter, Decision, Wish
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Description, Message
from armadico.core.parameters import AgentName
from armadico.mobile.messages import BatteryLevel

Gain = Annotated[float, Meta(ge=0, le=10)]


class SchemasParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of the sum of schemas."""

    gains: dict[AgentName, Gain] = field(default_factory=lambda: {"avoid": 0.8})  # by agent; else 1
    # Factors with an empty battery, by agent; they come in below `scarce_share` of the charge.
    scarce: dict[AgentName, Gain] = field(default_factory=lambda: {"goto": 1.5, "avoid": 0.75})
    scarce_share: Annotated[float, Meta(gt=0, le=1)] = 0.3
    noise: Gain = 0.05  # of the vectors' lengths together
    noise_s: Annotated[float, Meta(gt=0, le=60)] = 1.0  # for which it keeps its direction
    v: Annotated[float, Meta(gt=0, le=10)] = 0.5  # m/s for a sum of length 1
    turn_gain: Annotated[float, Meta(gt=0, le=10)] = 1.5  # rad/s for one rad
    w: Annotated[float, Meta(gt=0, le=10)] = 0.9  # largest turn rate, rad/s


class Schemas(Arbiter):
    """The sum of the behaviours' vectors by gains: its length is the speed, its angle the turn.

    Arkin (1989), AuRA: every active schema gives a vector. A noise schema leads out of places where
    the sum is zero. Homeostatic control changes the gains with the battery: the emptier it is, the
    stronger is the goal and the nearer the robot may pass obstacles.
    """

    name = "schemas"
    parameters = SchemasParameters
    receives: ClassVar[tuple[type[Message], ...]] = (BatteryLevel,)
    p: SchemasParameters

    def __init__(self, identity: Identity, parameters: SchemasParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._noise, self._until = 0.0, 0.0  # its direction, rad, and until when

    def gain(self, name: str) -> float:
        """Return an agent's gain with the present charge."""
        p, battery = self.p, self.latest(BatteryLevel)
        gain = p.gains.get(name, 1.0)
        if battery is None or battery.share >= p.scarce_share:
            return gain
        return gain * (
            1.0 + (p.scarce.get(name, 1.0) - 1.0) * (1.0 - battery.share / p.scarce_share)
        )

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        p, about = self.p, self.latest(Description)
        gained = {name: self.gain(name) for name in wishes}
        lengths = {name: g * hypot(*wishes[name].vector) for name, g in gained.items()}
        total = sum(lengths.values())
        if total <= 0.0 or about is None:
            return Decision(REST, {})
        if self.now >= self._until:
            self._noise, self._until = self.rng.uniform(-pi, pi), self.now + p.noise_s
        size = p.noise * min(total, 1.0)
        x = size * cos(self._noise) + sum(g * wishes[n].vector[0] for n, g in gained.items())
        y = size * sin(self._noise) + sum(g * wishes[n].vector[1] for n, g in gained.items())
        angle, length = atan2(y, x), min(hypot(x, y), 1.0)
        v = min(p.v, about.v_max) * length * max(cos(angle), 0.0)
        most = min(p.w, about.w_max)
        w = min(max(p.turn_gain * angle, -most), most)
        return Decision((v, w), {name: each / total for name, each in lengths.items()})


SCHEMAS: Final = Arbitrated(
    Schemas.name, needs="vector", about="the sum of all behaviours' vectors, by gains"
)
