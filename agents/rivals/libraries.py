"""Mechanisms of other projects' libraries, which the extra `rivals` installs."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any, Final

from msgspec import Meta

from armadico.agents.rivals.arbiter import REST, Arbiter, Decision, Speeds, Wish
from armadico.agents.rivals.grid import actions
from armadico.agents.rivals.layers import ACTIVE
from armadico.agents.rivals.mechanisms import ORDER
from armadico.agents.rivals.proposer import Arbitrated
from armadico.core import parameters
from armadico.core.agent import Identity
from armadico.core.messages import Cycle, Description
from armadico.core.parameters import AgentName
from armadico.mobile.motion import Body

Share = Annotated[float, Meta(ge=0, le=1)]


class LibraryParameters(parameters.Parameters, frozen=True, forbid_unknown_fields=True):
    """Parameters of both: an option runs from one utility on until another one."""

    order: tuple[AgentName, ...] = ORDER  # highest priority first; the last needs no condition
    begins: Share = ACTIVE
    ends: Share = 0.4


class _Ordered(Arbiter, hooks=("decide", "wishes")):
    """Options in an order, each with a condition to begin and one to go on."""

    parameters = LibraryParameters
    p: LibraryParameters

    def __init__(self, identity: Identity, parameters: LibraryParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.wishes: Mapping[str, Wish] = {}

    def applies(self, name: str, *, running: bool) -> bool:
        """Return whether an option may begin, or while it runs, go on."""
        wish = self.wishes.get(name)
        if wish is None or wish.utility <= 0.0:
            return False
        least = self.p.ends if running else self.p.begins
        return name == self.p.order[-1] or wish.critical or wish.utility >= least


class BehaviourTree(_Ordered):
    """A behaviour tree: a fallback over the behaviours, ticked each cycle (py_trees).

    Colledanchise and Oegren (2018): a node that is ticked returns failure, running or success, and
    a child further left takes over at once, which interrupts the running one.
    """

    name = "behaviour-tree"

    def __init__(self, identity: Identity, parameters: LibraryParameters | None = None) -> None:
        super().__init__(identity, parameters)
        trees: Any = import_module("py_trees")
        running, fails = trees.common.Status.RUNNING, trees.common.Status.FAILURE

        def update(node: Any) -> Any:
            on = node.status == running
            return running if self.applies(node.name, running=on) else fails

        leaf = type("Behaving", (trees.behaviour.Behaviour,), {"update": update})
        children = [leaf(name=name) for name in self.p.order]
        self.root = trees.composites.Selector(name="drive", memory=False, children=children)

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        self.wishes = wishes
        self.root.tick_once()
        tip = self.root.current_child
        if tip is None or not self.applies(tip.name, running=True):
            return Decision(REST, {})
        return Decision(wishes[tip.name].action, {tip.name: 1.0})


class ArbitrationGraph(_Ordered):
    """A priority arbitrator with a verifier for each command (arbitration_graphs).

    Spieker, Le Large and Lauer (2024): options have a condition to be invoked and one to commit;
    a command that does not pass the verifier is dropped, and the next option is taken. The verifier
    here: no behaviour forbids the action. The last option is the fallback, which is not verified.
    """

    name = "arbitration-graph"

    def __init__(self, identity: Identity, parameters: LibraryParameters | None = None) -> None:
        super().__init__(identity, parameters)
        graphs: Any = import_module("arbitration_graphs")
        arbiter = self

        def initialise(node: Any, name: str) -> None:
            graphs.Behavior.__init__(node, name)
            node.option = name

        methods = {
            "__init__": initialise,
            "check_invocation_condition": lambda n, *_: arbiter.applies(n.option, running=False),
            "check_commitment_condition": lambda n, *_: arbiter.applies(n.option, running=True),
            "get_command": lambda n, *_: (n.option, arbiter.wishes[n.option].action),
        }
        verification: Any = import_module("arbitration_graphs.verification")
        verifier = type(
            "Verifier",
            (verification.Verifier,),
            {"analyze": lambda _, _t, _e, c: verification.SimpleResult(arbiter.admits(*c))},
        )
        option = type("Option", (graphs.Behavior,), methods)
        self._kept = verifier(), [option(name) for name in self.p.order]
        self._error = graphs.NoApplicableOptionPassedVerificationError
        self.root = graphs.PriorityArbitrator("drive", self._kept[0])
        flags = graphs.PriorityArbitrator.Option.Flags
        for node in self._kept[1]:
            last = node is self._kept[1][-1]
            fallback = int(flags.FALLBACK) if last else 0
            self.root.add_option(node, int(flags.INTERRUPTABLE) | fallback)
        self._active = False

    def admits(self, name: str, action: Speeds) -> bool:
        """Return whether no other behaviour forbids the action of the grid nearest to this."""
        about = self.latest(Description)
        if about is None:
            return True
        grid = actions(Body.of(about))
        (v, w), scale = action, max(about.w_max, 1e-6)
        nearest = min(
            range(len(grid)),
            key=lambda i: abs(grid[i][0] - v) / about.v_max + abs(grid[i][1] - w) / scale,
        )
        others = (wish.votes for other, wish in self.wishes.items() if other != name)
        rated = [votes for votes in others if len(votes) == len(grid)]
        return all(votes[nearest] > -1.0 for votes in rated)

    def decide(self, wishes: Mapping[str, Wish], cycle: Cycle) -> Decision:  # noqa: ARG002
        self.wishes = wishes
        now, root = self.now, self.root
        if self._active and not root.check_commitment_condition(now, None):
            root.lose_control(now, None)
            self._active = False
        if not self._active:
            if not root.check_invocation_condition(now, None):
                return Decision(REST, {})
            root.gain_control(now, None)
            self._active = True
        try:
            name, action = root.get_command(now, None)
        except self._error:
            return Decision(REST, {})
        return Decision(action, {name: 1.0})


BEHAVIOUR_TREE: Final = Arbitrated(
    BehaviourTree.name,
    library="py_trees",
    about="a behaviour tree: a fallback over the behaviours (py_trees)",
)
ARBITRATION_GRAPH: Final = Arbitrated(
    ArbitrationGraph.name,
    needs="rate",
    library="arbitration_graphs",
    about="options in an order, each command verified (arbitration_graphs)",
)
