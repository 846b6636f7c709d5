"""Layers with fixed ranks: subsumption's wires, and twist_mux's sources and locks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from msgspec import Meta, Struct

from armadico.agents.rivals.arbiter import REST, Arbiter, Decision, Speeds, Wish
from armadico.agents.rivals.mechanisms import ORDER
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.messages import Cycle
from armadico.core.parameters import AgentName

Seconds = Annotated[float, Meta(ge=0, le=60)]
Share = Annotated[float, Meta(ge=0, le=1)]

ACTIVE: Final = 0.8
"""From this utility on a behaviour counts as active, for mechanisms that know only on and off."""


class Wire(Struct, frozen=True, forbid_unknown_fields=True):
    """A wire from a layer's output to the line of another one."""

    source: AgentName
    target: AgentName
    does: Literal["suppress", "inhibit"] = "suppress"
    for_s: Seconds = 0.3  # after the source's last output


class SubsumptionParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of subsumption: the wheels are on the line of the lowest layer."""

    lowest: AgentName = "goto"
    wires: tuple[Wire, ...] = (
        Wire("gothrough", "goto"),
        Wire("avoid", "gothrough"),
        Wire("avoid", "goto"),
        Wire("relocate", "goto"),
        Wire("teleop", "goto"),
    )  # of several that suppress one line, the last counts
    active: Share = ACTIVE


class Subsumption(Arbiter):
    """Layers whose outputs suppress or inhibit the lines of others, for a time (Brooks 1986).

    A suppressing output replaces what is on a line; an inhibiting one only keeps it off. Both last
    for a time after the last output. Layers have no messages for each other and are always told
    that they drive. What the text cannot give here: the wiring within a layer.
    """

    name = "subsumption"
    parameters = SubsumptionParameters
    p: SubsumptionParameters

    def __init__(self, identity: Identity, parameters: SubsumptionParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._taps: dict[int, tuple[float, str, Speeds]] = {}  # by wire: until when, whose, what

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        p = self.p
        for number, wire in enumerate(p.wires):
            wish = wishes.get(wire.source)
            if wish is not None and (wish.utility >= p.active or wish.critical):
                self._taps[number] = self.now + wire.for_s, wire.source, wish.action
        line: tuple[str, Speeds] | None = None
        if p.lowest in wishes and wishes[p.lowest].utility > 0.0:
            line = p.lowest, wishes[p.lowest].action
        line = self._line(p.lowest, line, ())
        return Decision(REST, {}) if line is None else Decision(line[1], {line[0]: 1.0})

    def _line(
        self, layer: str, own: tuple[str, Speeds] | None, above: tuple[str, ...]
    ) -> tuple[str, Speeds] | None:
        """What is on a layer's line, after what its wires do to it."""
        line = own
        for number, wire in enumerate(self.p.wires):
            until, source, action = self._taps.get(number, (self.now, "", REST))
            if wire.target != layer or source in above or self.now >= until:
                continue
            passed = self._line(source, (source, action), (*above, layer))
            if passed is not None:  # else the source itself is inhibited, and nothing leaves it
                line = passed if wire.does == "suppress" else None
        return line


class Source(Struct, frozen=True, forbid_unknown_fields=True):
    """One source of twists: its timeout, and that of its lock (0: it has none)."""

    name: AgentName
    timeout_s: Seconds = 0.5
    lock_s: Seconds = 0.0


class TwistMuxParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of twist_mux."""

    sources: tuple[Source, ...] = tuple(map(Source, ORDER))  # highest priority first
    active: Share = ACTIVE  # a source publishes from this utility on; the lowest always does


class TwistMux(Arbiter):
    """The source of highest priority that has not timed out, unless a lock masks it (twist_mux).

    ROS's multiplexer of velocity commands: each source has a priority and a timeout, and the newest
    twist counts until then. A lock masks all sources below its own. It is closed while its source's
    bid is critical and, by the package's rule, once its source is silent for the lock's timeout.
    """

    name = "twist-mux"
    parameters = TwistMuxParameters
    p: TwistMuxParameters

    def __init__(self, identity: Identity, parameters: TwistMuxParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._twists: dict[str, tuple[float, Speeds]] = {}  # the newest of each, and its time
        self._alive: dict[str, float] = {}  # when each source of a lock was last heard

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        sources = self.p.sources
        for rank, source in enumerate(sources):
            wish = wishes.get(source.name)
            if wish is None:
                continue
            lowest = rank == len(sources) - 1
            if wish.utility >= self.p.active or wish.critical or (lowest and wish.utility > 0.0):
                self._twists[source.name] = self.now, wish.action
        for source in sources:
            at, action = self._twists.get(source.name, (float("-inf"), REST))
            if self.now - at < source.timeout_s:
                return Decision(action, {source.name: 1.0})
            if source.lock_s and self._locked(source, wishes):
                return Decision(REST, {})
        return Decision(REST, {})

    def _locked(self, source: Source, wishes: Mapping[str, Wish]) -> bool:
        wish = wishes.get(source.name)
        if source.name in self.proposers:
            self._alive[source.name] = self.now
        silent = self.now - self._alive.setdefault(source.name, self.now)
        return silent >= source.lock_s or (wish is not None and wish.critical)


SUBSUMPTION: Final = Arbitrated(
    Subsumption.name,
    told="yes",
    about="active layers suppress or inhibit the lines of others, for a time",
)
TWIST_MUX: Final = Arbitrated(
    TwistMux.name, about="the highest source that has not timed out, unless a lock masks it"
)
