"""The thesis's building with its whole society on a virtual mesh, for tests."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from armadico.agents.interface.messages import MissionCancel, MissionOrder
from armadico.agents.missions.messages import (
    Alarm,
    Board,
    BoardMission,
    ChargeStatus,
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
    """A mission of these steps as TOML; `above` is put before them and `more` after."""
    return "\n".join([above, "steps = [", *(f"  {{ {row} }}," for row in rows), "]", more])


class Building:
    """The society of `surveillance` without missions; with `ideal` sensors by default."""

    def __init__(
        self,
        seed: int = 1,
        *,
        battery: Battery | None = None,
        without: tuple[str, ...] = (),
        sensors: str = "ideal",
    ) -> None:
        """Start the society; on return all agents have joined, and the robot is in the hall."""
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
        held = claim.resource, claim.ballot.instance.rpartition("-")[0]
        if claim.utility is None:
            return
        last = next((each for each in self.holders[::-1] if each[0] == held[0]), None)
        if last != held:
            self.holders.append(held)

    def run(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def until(self, done: Callable[[], object], seconds: float = 120.0) -> None:
        """Advance until `done` is true. Fails after so many seconds."""
        self.mesh.run(self.mesh.now + seconds, lambda: bool(done()))
        assert done(), (self.board, self.logs[-12:])

    # Requests -------------------------------------------------------------------------------------

    def order(
        self, what: str = SURVEY, priority: float | None = None, name: str = "m"
    ) -> MissionReply:
        packed = zlib.compress(what.encode())
        reply = self.rehearsal.client.query(MissionOrder(name, packed, priority, "a test"), 20.0)
        assert isinstance(reply, MissionReply)
        return reply

    def taken(self, what: str = SURVEY, priority: float | None = None, name: str = "m") -> int:
        """Order a mission that must be accepted. Returns its number."""
        reply = self.order(what, priority, name)
        assert reply.refusal == ""
        return reply.mission

    def cancel(self, number: int) -> str:
        """Cancel a mission. Returns the reason of a refusal, or ""."""
        reply = self.rehearsal.client.query(MissionCancel(number, "a test"), 20.0)
        assert isinstance(reply, MissionReply)
        return reply.refusal

    def exploring(self, kind: type[Agent]) -> tuple[Node, int]:
        """Have an explore agent of a kind join, and a mission explore for 5 s. Its number, too."""
        node = self.joins(kind)
        self.run(1.0)
        number = self.taken(text('do = "explore"'))
        self.run(5.0)
        return node, number

    def rings(self, room: str, *, on: bool = True) -> None:
        """Publish the begin or end of an alarm in a room."""
        self.rehearsal.client.publish(Alarm(room, on))
        self.run(1.0)

    # Observations ---------------------------------------------------------------------------------

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
        """The present step of a mission."""
        return self.mission(number).doing

    def ended(self, number: int) -> bool:
        return self.mission(number).over

    def ends(self, number: int, seconds: float) -> BoardMission:
        """Advance until a mission is over, for so many seconds at most."""
        self.until(lambda: self.ended(number), seconds)
        return self.mission(number)

    def steps(self, number: int) -> list[str]:
        """The completed steps of a mission, in order."""
        results = self.mission(number).course.results
        return [r.step for r in results if r.end.value == "done"]

    def who_had(self, resource: str) -> list[str]:
        """The holders of a resource, in order."""
        return [name for held, name in self.holders if held == resource]

    def agent(self, name: str) -> Any:
        """The newest agent with a name."""
        return self.node(name).agent

    def node(self, name: str) -> Node:
        """The process of that agent."""
        return next(node for node in self.mesh.nodes[::-1] if node.name == name)

    def pose(self) -> Pose:
        """The estimated pose of the robot."""
        pose = self.agent("mission-planning").latest(Pose)
        assert isinstance(pose, Pose)
        return pose

    def joins(self, kind: type[Agent]) -> Node:
        return self.rehearsal.add(kind)
