"""The thesis's building with its whole society on a virtual mesh, and everything that is said."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from armadico.agents.missions.messages import (
    Alarm,
    Board,
    BoardMission,
    ChargeStatus,
    MissionCancel,
    MissionOrder,
    Photo,
    Subplan,
    SubplanRequest,
)
from armadico.config.scenarios import Battery, load_scenario
from armadico.config.shipped import find
from armadico.core.agent import Agent
from armadico.core.messages import Claim, Log
from armadico.launch.society import Options, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node
from armadico.mobile.messages import MissionReply, Planned, Pose

SURVEY = find("missions", "surveillance").read_text()


def text(*rows: str, more: str = "", above: str = "") -> str:
    """A mission of these steps, as TOML; `above` and `more` stand before and after them."""
    return "\n".join([above, "steps = [", *(f"  {{ {row} }}," for row in rows), "]", more])


class Building:
    """Nobody is sent anywhere until somebody orders something; sensors without error."""

    def __init__(
        self,
        seed: int = 1,
        *,
        battery: Battery | None = None,
        without: tuple[str, ...] = (),
        sensors: str = "ideal",
    ) -> None:
        """Everybody has joined, and the robot stands in the hall."""
        options = Options(seed=seed, sensors=sensors, without=without)
        scenario = replace(
            load_scenario("surveillance"), battery=battery or Battery(), start=(2.0, 5.0, 0.0)
        )
        self.rehearsal = Rehearsal(prepared(scenario, options), options)
        self.mesh = self.rehearsal.mesh
        self.said: list[tuple[float, Any]] = []
        self.logs: list[str] = []
        self.holders: list[tuple[str, str]] = []
        self.mesh.watch(
            lambda _k, m, t: self.said.append((t, m)),
            *(Photo, Subplan, SubplanRequest, Board, ChargeStatus, Planned),
        )
        self.mesh.watch(self._logged, Log)
        self.mesh.watch(self._claimed, Claim)
        self.rehearsal.start()
        self.run(2.0)

    def _logged(self, _key: str, line: Any, _now: float) -> None:
        self.logs.append(line.text)

    def _claimed(self, _key: str, claim: Any, _now: float) -> None:
        who = claim.resource, claim.ballot.instance.rpartition("-")[0]
        if claim.utility is None:
            return
        if not self.holders or next((h for h in self.holders[::-1] if h[0] == who[0]), None) != who:
            self.holders.append(who)

    def run(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def until(self, done: Callable[[], object], seconds: float = 120.0) -> None:
        """Let time pass until something is so; it must be, in so many seconds."""
        self.mesh.run(self.mesh.now + seconds, lambda: bool(done()))
        assert done(), (self.board, self.logs[-12:])

    # What is asked for ----------------------------------------------------------------------------

    def order(
        self, what: str = SURVEY, priority: float | None = None, name: str = "m"
    ) -> MissionReply:
        packed = zlib.compress(what.encode())
        reply = self.rehearsal.client.ask(MissionOrder(name, packed, priority, "a test"), 20.0)
        assert isinstance(reply, MissionReply)
        return reply

    def taken(self, what: str = SURVEY, priority: float | None = None, name: str = "m") -> int:
        """Order a mission that is taken on; its number."""
        reply = self.order(what, priority, name)
        assert reply.refusal == ""
        return reply.mission

    def cancel(self, number: int) -> str:
        """Cancel a mission; why that is refused."""
        reply = self.rehearsal.client.ask(MissionCancel(number, "a test"), 20.0)
        assert isinstance(reply, MissionReply)
        return reply.refusal

    def rings(self, room: str, *, on: bool = True) -> None:
        """An alarm begins in a room, or ends."""
        self.rehearsal.client.publish(Alarm(room, on))
        self.run(1.0)

    # What is seen ---------------------------------------------------------------------------------

    def heard(self, kind: type[Any]) -> list[Any]:
        """All messages of a kind so far."""
        return [message for _, message in self.said if type(message) is kind]

    @property
    def board(self) -> Board | None:
        found = self.heard(Board)
        return found[-1] if found else None

    def mission(self, number: int) -> BoardMission:
        assert self.board is not None
        return next(m for m in self.board.missions if m.mission == number)

    def doing(self, number: int) -> str:
        """What step a mission is in."""
        return self.mission(number).doing

    def ended(self, number: int) -> bool:
        """Whether a mission is over."""
        return self.mission(number).over

    def steps(self, number: int) -> list[str]:
        """What was done, in order."""
        results = self.mission(number).course.results
        return [r.step for r in results if r.end.value == "done"]

    def who_had(self, resource: str) -> list[str]:
        """Who held a resource, in order."""
        return [name for held, name in self.holders if held == resource]

    def agent(self, name: str) -> Any:
        """The newest agent of a name."""
        return self.node(name).agent

    def node(self, name: str) -> Node:
        """The process that it runs in."""
        return next(node for node in self.mesh.nodes[::-1] if node.name == name)

    def pose(self) -> Pose:
        """Where the robot believes to be."""
        pose = self.agent("mission-planning").latest(Pose)
        assert isinstance(pose, Pose)
        return pose

    def joins(self, kind: type[Agent]) -> Node:
        return self.rehearsal.add(kind)
