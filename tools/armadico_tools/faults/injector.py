"""Applies the faults of a plan to a society and removes them: interface and virtual back end.

Several may be active at once on the virtual mesh. So each change sets the mesh to the state with
all active faults: a link with two faults is whole again when the last of them ends.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from math import inf, nan
from typing import Any, Final

from msgspec import structs

from armadico.bridge.simulator.broken import Broken, Readings
from armadico.core.exchange import Bid
from armadico.core.messages import PROTOCOL, Card, Claim, Command, Message
from armadico.launch.virtual import Rehearsal
from armadico.mesh.link_faults import WHOLE, LinkFaults
from armadico.mesh.virtual import Node
from armadico_tools.faults.fault_types import AGAIN_S, SLOWS
from armadico_tools.faults.observations import Faulted
from armadico_tools.faults.plan import BEHAVIOURS, CUTS, NETWORK, Fault, Variation
from armadico_tools.faults.stranger import Stranger

NONSENSE: Final = (
    Bid(nan, (0.2, 0.0)),
    Bid(1.0, (nan, nan)),
    Bid(inf, (0.2, 0.0)),
    Bid(1.0, (0.2,)),
    Bid(1.0, (500.0, -90.0), critical=True),  # valid, but beyond every robot
)
"""Bids of an agent with the fault `nan`."""

BREAKS: Final = {
    "silent": Broken.SILENT,
    "frozen": Broken.FROZEN,
    "repeating": Broken.REPEATING,
    "biased": Broken.BIASED,
}
"""The faults of range sensors by the first word of their kinds; the first active one counts."""

ANOTHER: Final = "999.0"
"""Another version of the package."""

LONE_AWAY_S: Final = 0.3
"""How long the last behaviour is away when it is restarted."""

OLD_S: Final = 0.6
"""Age of the oldest commands and claims under way when the robot agent is restarted."""


Act = Callable[[Fault, bool], None]
"""Applies a fault (True), or removes it (False)."""


class Injector(ABC):
    """Begins and ends faults, and reports both to the record; `acts` has the acts by kind."""

    acts: Mapping[str, Act]

    def __init__(self, show: Callable[[Faulted], object]) -> None:
        self._show = show
        self._on: list[Fault] = []

    @property
    @abstractmethod
    def now(self) -> float:
        """The time of the society, s."""

    def begin(self, fault: Fault, _: object = None) -> None:
        self._note(fault, began=True)
        self._on.append(fault)
        self.acts[fault.kind](fault, True)

    def end(self, fault: Fault, _: object = None) -> None:
        self._on.remove(fault)
        self.acts[fault.kind](fault, False)
        self._note(fault, began=False)

    def _note(self, fault: Fault, *, began: bool) -> None:
        self._show(Faulted(self.now, fault.kind, fault.targets, began, fault.to, fault.amount))


class VirtualInjector(Injector):
    """Applies the faults of a virtual run at their times."""

    def __init__(
        self,
        rehearsal: Rehearsal,
        show: Callable[[Faulted], object],
        variation: Variation,
    ) -> None:
        super().__init__(show)
        self._rehearsal = rehearsal
        self._variation = variation
        self._mesh = rehearsal.mesh
        self._down: Counter[str] = Counter()
        self._twins: Counter[str] = Counter()
        self._away: set[Fault] = set()  # of the kind `flap`
        self._befallen: dict[Fault, list[Node]] = {}
        self._published: list[tuple[float, str, Message]] = []
        self._stranger = Stranger(rehearsal)
        self.skewed: dict[str, Node] = {}  # of another protocol, by instance
        self._skews: dict[Fault, Node] = {}
        self.acts = {
            **dict.fromkeys(NETWORK, self._mend_links),
            **dict.fromkeys(CUTS, self._part),
            **dict.fromkeys(("serial-garbage", "serial-loss"), self._mend_line),
            **dict.fromkeys(("crash", "interface-restart"), self._crash),
            **dict.fromkeys([f"{how}-sonar" for how in BREAKS], self._break_sonars),
            **dict.fromkeys([f"{how}-laser" for how in BREAKS], self._break_laser),
            **dict.fromkeys(("slow", "starved"), self._slow),
            **dict.fromkeys(("clock-step", "host-clock-step"), self._clock_step),
            **dict.fromkeys(("missing-wall", "unmapped-box"), _in_the_world),
            **self._stranger.acts,
            "hang": self._hang,
            "glass": self._glaze,
            "slip": self._slip,
            "blocked-wheels": self._block_wheels,
            "version-skew": self._version_skew,
            "clock-drift": self._clock_drift,
            "nan": self._nan,
            "flap": self._flap,
            "lone-restart": self._lone_restart,
            "robot-restart": self._robot_restart,
            "twin": self._twin,
            "in-turn": self._in_turn,
        }
        self._mesh.watch(self._keep, Command, Claim)
        self._mend_links()

    def schedule(self, faults: tuple[Fault, ...]) -> None:
        """Schedule the begin and end of faults."""
        for fault in faults:
            self._mesh.call_at(fault.at, self.begin, fault)
            self._mesh.call_at(fault.until, self.end, fault)

    @property
    def now(self) -> float:
        return self._mesh.now

    def alive(self, name: str) -> list[Node]:
        """The live processes of an agent, the oldest first."""
        strange = [*self._stranger.nodes, *self._skews.values()]
        ours = (node for node in self._mesh.nodes if node not in strange)
        return [node for node in ours if node.alive and node.name == name]

    def refused(self, node: Node) -> None:
        """Retry later if a process may not join or stay, and none is left."""
        if node not in self._stranger.nodes and node not in self._skews.values():
            self._mesh.call_at(self._mesh.now + AGAIN_S, self._try_again, node.name)

    def _try_again(self, name: str, _: object) -> None:
        if not self.alive(name):
            self._settle(name)

    def begin(self, fault: Fault, _: object = None) -> None:
        self._befallen[fault] = [node for name in fault.targets for node in self.alive(name)]
        super().begin(fault)

    # Links ---------------------------------------------------------------------------------------

    def _mend_links(self, _fault: Fault | None = None, _begins: bool = True) -> None:
        """Set every link to its state in this run, with the active faults."""
        names = sorted({node.name for node in self._mesh.nodes})
        usual = replace(WHOLE, delay=self._variation.delay, jitter=self._variation.jitter)
        wrong = {(source, target): usual for source in names for target in names}
        for fault in self._on:
            if fault.kind in NETWORK:
                for way in product(fault.targets, fault.to):
                    wrong[way] = _worse(wrong.get(way, usual), fault)
        self._put(wrong)

    def _mend_line(self, _fault: Fault, _begins: bool) -> None:
        wrong = {("device", "robot"): WHOLE, ("robot", "device"): WHOLE}
        for fault in self._on:
            for way, one_way in zip(wrong, (1.0, 2.0), strict=True):
                if fault.kind.startswith("serial") and fault.spread in {0.0, one_way}:
                    wrong[way] = _worse(wrong[way], fault)
        self._put(wrong)

    def _put(self, wrong: Mapping[tuple[str, str], LinkFaults]) -> None:
        """Set the faults of links except cuts, which `_part` sets."""
        for way, faults in wrong.items():
            link = self._mesh.link(*way)
            link.faults = replace(faults, cut=not link.up)

    def _part(self, fault: Fault, begins: bool) -> None:
        both = [(fault.targets, fault.to)]  # links-lost: all from all
        if fault.kind == "partition":
            both.append((fault.to, fault.targets))
        for sources, targets in both:
            if begins:
                self._mesh.cut(sources, targets, lease=bool(fault.amount))
            else:
                self._mesh.heal(sources, targets)

    # Processes -----------------------------------------------------------------------------------

    def _settle(self, name: str) -> None:
        """Adjust the number of processes of an agent: one, with twins, or none."""
        wanted = (0 if self._down[name] else 1) + self._twins[name]
        there = self.alive(name)
        while len(there) > wanted:
            there.pop(0).kill()
        for _ in range(wanted - len(there)):
            self._rehearsal.enter(name)

    def _crash(self, fault: Fault, begins: bool) -> None:
        for name in fault.targets:
            self._come_or_go(name, 1 if begins else -1)

    def _in_turn(self, fault: Fault, begins: bool) -> None:
        """Stop and restart one after the other: each may be the only one with the pose."""
        *rest, last = fault.targets
        if not begins:
            self._restart(last, -1)
            return
        now, each = self._mesh.now, fault.lasts / (2 * len(fault.targets) - 1)
        for place, name in enumerate(fault.targets):
            if place:
                self._mesh.call_at(now + 2 * place * each, partial(self._restart, name, 1))
            else:
                self._restart(name, 1)
            if name in rest:
                self._mesh.call_at(now + (2 * place + 1) * each, partial(self._restart, name, -1))

    def _restart(self, name: str, change: int, _a: object = None, _b: object = None) -> None:
        """Stop (1) or start (-1) an agent, reported as a crash."""
        if change > 0:
            self._show(Faulted(self._mesh.now, "crash", (name,), began=True))
        self._come_or_go(name, change)
        if change < 0:
            self._show(Faulted(self._mesh.now, "crash", (name,), began=False))

    def _come_or_go(self, name: str, change: int, _a: object = None, _b: object = None) -> None:
        self._down[name] += change
        self._settle(name)

    def _hang(self, fault: Fault, begins: bool) -> None:
        for node in self._befallen[fault]:
            if begins:
                node.hang()
            elif node.alive and not self._befalls(node, "hang"):
                node.resume()

    def _slow(self, fault: Fault, _begins: bool) -> None:
        for node in self._befallen[fault]:
            works = [f.amount for f in self._on if f.kind in SLOWS and node in self._befallen[f]]
            node.slow_down(max(works, default=0.0))

    def _befalls(self, node: Node, kind: str) -> bool:
        return any(f.kind == kind and node in self._befallen[f] for f in self._on)

    def _clock_step(self, fault: Fault, begins: bool) -> None:
        if begins:
            for node in self._befallen[fault]:
                node.jump(fault.amount)

    def _clock_drift(self, fault: Fault, begins: bool) -> None:
        for node in self._befallen[fault]:
            if node.alive:
                node.drift(fault.amount if begins else 1.0)

    def _nan(self, fault: Fault, begins: bool) -> None:
        for node in self._befallen[fault]:
            if begins:
                bid = NONSENSE[int(fault.amount)]
                vars(node.agent)["bid_for"] = lambda resource, message, bid=bid: bid  # noqa: ARG005
            elif not self._befalls(node, "nan"):
                vars(node.agent).pop("bid_for", None)

    def _twin(self, fault: Fault, begins: bool) -> None:
        for name in fault.targets:
            self._twins[name] += 1 if begins else -1
            there = self.alive(name)
            if not begins and fault.amount and len(there) > 1 and not there[-1].hung:
                there[-1].leave()
            self._settle(name)

    def _flap(self, fault: Fault, begins: bool) -> None:
        if begins:
            self._flip(fault, None)
        elif fault in self._away:
            self._away.remove(fault)
            self._come_or_go(fault.targets[0], -1)

    def _flip(self, fault: Fault, _: object) -> None:
        """Start it if it is away, else stop it."""
        if fault not in self._on:
            return
        (name,) = fault.targets
        away = fault in self._away
        (self._away.remove if away else self._away.add)(fault)
        self._come_or_go(name, -1 if away else 1)
        self._mesh.call_at(self._mesh.now + fault.amount, self._flip, fault)

    def _lone_restart(self, fault: Fault, begins: bool) -> None:
        """Remove the other behaviours, and restart the last one in the middle."""
        (lone,) = fault.targets
        for name in BEHAVIOURS:
            if name != lone:
                self._come_or_go(name, 1 if begins else -1)
        if begins:
            away = min(LONE_AWAY_S, fault.lasts / 3)
            at = self._mesh.now + fault.lasts / 3
            self._mesh.call_at(at, partial(self._come_or_go, lone, 1))
            self._mesh.call_at(at + away, partial(self._come_or_go, lone, -1))

    def _robot_restart(self, fault: Fault, begins: bool) -> None:
        """Deliver earlier commands and claims to the new robot agent, one after another."""
        self._come_or_go("robot", 1 if begins else -1)
        if begins:
            old = [item for item in self._published if item[0] > self._mesh.now - OLD_S]
            for index, item in enumerate(old):
                late = fault.lasts + 0.05 + index * 1.5 / len(old)
                # It arrives without being published now, so watchers do not see it.
                arrives = partial(self._mesh.arrive, item[2], "robot", item[1])
                self._mesh.call_at(self._mesh.now + late, lambda call, _: call(), arrives)

    def _keep(self, key: str, message: Message, now: float) -> None:
        self._published.append((now, key, message))
        if len(self._published) > 256:
            del self._published[:128]

    # The robot -----------------------------------------------------------------------------------

    def _break_sonars(self, _fault: Fault, _begins: bool) -> None:
        self._break(self._rehearsal.robot.plant.sonar_readings, "sonar")

    def _break_laser(self, _fault: Fault, _begins: bool) -> None:
        self._break(self._rehearsal.robot.plant.laser_readings, "laser")

    def _break(self, readings: Readings[Any], sensor: str) -> None:
        """Set a sensor to its state with the active faults."""
        amounts = {fault.kind: fault.amount for fault in self._on}
        for name, how in BREAKS.items():
            if f"{name}-{sensor}" in amounts:
                readings.fail(how, amounts[f"{name}-{sensor}"])
                return
        readings.fail(None)

    def _glaze(self, _fault: Fault, _begins: bool) -> None:
        shares = [fault.amount for fault in self._on if fault.kind == "glass"]
        self._rehearsal.robot.plant.glaze(max(shares, default=0.0))

    def _slip(self, _fault: Fault, _begins: bool) -> None:
        times = [(fault.amount, fault.spread) for fault in self._on if fault.kind == "slip"]
        self._rehearsal.robot.plant.slip(*(times[-1] if times else (1.0, 1.0)))

    def _block_wheels(self, _fault: Fault, _begins: bool) -> None:
        blocked = any(fault.kind == "blocked-wheels" for fault in self._on)
        self._rehearsal.robot.plant.jammed = blocked

    # Versions ------------------------------------------------------------------------------------

    def _version_skew(self, fault: Fault, begins: bool) -> None:
        """Let an agent of another protocol (0) or package (1) join, which leaves at the end."""
        if not begins:
            node = self._skews.pop(fault)
            if node.alive:
                node.leave()
            return
        node = self._skews[fault] = self._rehearsal.enter(fault.targets[0])
        changes = {"version": ANOTHER} if fault.amount else {"protocol": PROTOCOL + 1}
        card = node.agent.kernel.card

        def changed() -> Card:
            return structs.replace(card(), **changes)

        vars(node.agent.kernel)["card"] = changed
        if not fault.amount:
            self.skewed[node.agent.instance] = node


def _in_the_world(_fault: Fault, _begins: bool) -> None:
    """Do nothing: the simulated world has it from the beginning (`variants.scenario_of`)."""


def _worse(faults: LinkFaults, fault: Fault) -> LinkFaults:
    """The faults of a link with one more."""
    kind, amount = fault.kind, fault.amount
    if kind in {"drop", "serial-loss", "silent-links"}:
        return replace(faults, loss=max(faults.loss, amount))
    if kind == "delay":
        delay, jitter = faults.delay + amount, faults.jitter + fault.spread
        return replace(faults, delay=delay, jitter=jitter)
    if kind == "serial-garbage":
        return replace(faults, garble=max(faults.garble, amount))
    share = {kind: max(getattr(faults, kind), amount)}  # duplicate or reorder
    return replace(faults, behind=max(faults.behind, fault.spread), **share)
