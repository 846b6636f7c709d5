"""A robot in the house under the virtual clock, the assistant agent with a policy, and clients."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from msgspec.structs import replace

from armadico.config.scenarios import Scenario
from armadico.core.messages import Log, RobotState, Stop
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import MissionStatus, Trajectory, Truth
from armadico.watch.assistant.assistant import Assistant
from armadico.watch.assistant.keeper import Parameters
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.messages import Approvals
from tests.driven import Driven

HOUSE = Scenario(
    name="house-with-a-client",
    world="house",
    sensors="ideal",
    start=(2.3, 2.0, 0.0),
    goal=None,
    agents=("encoder", "sonar", "goto", "avoid", "gothrough", "path-planning", "interface"),
)
NOON = datetime(2026, 11, 30, 12, 0)  # a Monday


@dataclass
class Asked:
    """A request, and the replies so far."""

    replies: list[AssistantReply | None] = field(default_factory=list)

    @property
    def reply(self) -> AssistantReply:
        found = self.replies[-1]
        assert found is not None, "no reply"
        return found


class House(Driven):
    """Clients ask; the truth of the robot is kept."""

    def __init__(
        self, policy: str = "", folder: Path | None = None, seed: int = 1, **scenario: object
    ) -> None:
        """Start; `policy` is the text of one, which lies in `folder` with the log."""
        super().__init__(
            Rehearsal(replace(HOUSE, **scenario), Options(seed=seed)),
            *(Truth, MissionStatus, Trajectory, RobotState, Stop, Approvals, Log),
        )
        self.settings = {}
        if folder is not None:
            (path := folder / "policy.toml").write_text(policy)
            self.settings = {"policy": str(path), "log": str(folder / "requests.jsonl")}
        self.time = NOON
        self.assistant = self.join()
        self.run.start()

    def join(self) -> Assistant:
        """The assistant agent joins, again if needed."""
        parameters = Parameters(world="house", **self.settings)  # type: ignore[arg-type]
        agent = self.run.add(Assistant, parameters).agent
        assert isinstance(agent, Assistant)
        agent.clock = lambda: self.time
        return agent

    def ask(self, tool: str, by: str = "model", text: str | None = None, **args: object) -> Asked:
        asked = Asked()
        request = AssistantRequest(tool, json.dumps(args) if text is None else text, by)
        self.mesh.query(request, asked.replies.append, 40.0)  # type: ignore[arg-type]
        return asked

    def asks(self, tool: str, by: str = "model", **args: object) -> AssistantReply:
        """Ask, and wait for the first reply."""
        asked = self.ask(tool, by, **args)
        self.until(lambda: bool(asked.replies), 45.0)
        return asked.reply

    def places(self, since: float = 0.0) -> list[tuple[float, float]]:
        return [(t.x, t.y) for t in self.of(Truth, since)]

    def speeds(self, since: float = 0.0) -> list[float]:
        return [abs(t.v) for t in self.of(Truth, since)]

    def ended(self, limit: float = 120.0) -> MissionStatus:
        """Go on until the mission has ended, and the robot rests."""

        def over() -> bool:
            return bool(self.of(MissionStatus)) and self.last(MissionStatus).state.value in (
                "reached",
                "failed",
            )

        self.let_pass(1.0)  # the status of the mission before is over, too
        self.until(over, limit)
        self.let_pass(2.0)
        return self.last(MissionStatus)
