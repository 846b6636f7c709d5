"""A virtual society with an observer that receives publications, tokens, cards and bids."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from armadico.config.scenarios import Scenario
from armadico.core.messages import Ask, BidHistory, Log, Message
from armadico.core.services import services
from armadico.launch.society import Options, coordinated
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MissionStatus
from armadico.observe.standing import Standing, standing
from armadico.observe.view import View
from armadico.observe.watching import QUERY_S
from armadico.watch.why import Chronicle
from tests.driven import Driven

LINE = Scenario(
    name="line",
    world="sc1",
    sensors="ideal",
    start=(-1.5, 0.0, 0.0),
    goal=(4.5, 0.0, 0.0),
    plan="direct",
    agents=("encoder", "sonar", "goto", "avoid", "path-planning", "interface"),
)


def reworded(message: Message) -> Message:
    """The same message with other text."""
    match message:
        case Log():
            return replace(message, text="something happened")
        case MissionStatus():
            return replace(message, note=message.note and "other text")
        case BidHistory():
            bids = [replace(bid, reason=bid.reason and "for a reason") for bid in message.bids]
            return replace(message, bids=tuple(bids))
    return message


class Observed(Driven):
    """A running scenario, and a view of it."""

    def __init__(
        self,
        seed: int = 1,
        scenario: Scenario = LINE,
        hosts: Callable[[str], str] = lambda _: "virtual",
        chronicle: Chronicle | None = None,
        coordination: str | None = None,
    ) -> None:
        """Start all agents, without a goal; `hosts` returns the host of an agent by name."""
        options = Options(seed=seed, coordination=coordination)
        super().__init__(Rehearsal(coordinated(scenario, options), options))
        for node in self.mesh.nodes:
            object.__setattr__(node.agent.identity, "host", hosts(node.name))
        self.chronicle = chronicle or Chronicle()
        self.planted = 0.0  # when a fault was injected, s
        self.worded = True  # False: the observer receives all texts reworded
        kinds = dict.fromkeys(each.message for each in services() if each.message is not Ask)
        self.mesh.watch(self._keep, *kinds)
        self._answer_queries()
        self.run.start()

    def drive(self, seconds: float = 4.0) -> Observed:
        """Set the goal, and run."""
        self.run.begin()
        return self.let_pass(seconds)

    def agent(self, name: str) -> Any:
        return self.mesh.node(name).agent

    @property
    def view(self) -> View:
        return self.chronicle.view

    @property
    def standing(self) -> Standing:
        return standing(self.view, self.mesh.now)

    def _keep(self, key: str, message: Message, now: float) -> None:
        self.chronicle.update(key, message if self.worded else reworded(message), now)

    def _answer_queries(self) -> None:
        now = self.mesh.now
        self.view.ask(now)
        for node in self.mesh.nodes:
            agent = node.agent
            self.chronicle.token(agent.instance, there=node.alive, t=now)
            if node.alive and not node.hung:
                for message in (agent.kernel.card(), agent.kernel.history()):
                    self.chronicle.learn(message if self.worded else reworded(message), now)
        self.mesh.call_at(now + QUERY_S, lambda _a, _b: self._answer_queries())
