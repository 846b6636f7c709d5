"""A run with a society that is already running, on any machines; it starts and ends no agent."""

from __future__ import annotations

from contextlib import suppress
from math import hypot
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final

from armadico.config.worlds import EMPTY, is_map, load_world
from armadico.core.hands import release
from armadico.core.messages import RobotState
from armadico.launch.processes import undisturbed
from armadico.launch.run import LiveRun
from armadico.launch.society import ATTACHED, Options, least
from armadico.mesh.topology import MeshError
from armadico.observe.contention import Contention
from armadico.observe.measures import Phase
from armadico.runtime.errors import RunFailedError, SocietyError

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.mesh.base import Mesh

COME_S: Final = 30.0
"""Time for all agents to be alive."""

REPORT_S: Final = 1.0
"""After this time missing agents are reported."""

STOP_S: Final = 3.0
"""Time for the robot agent to confirm the stop."""

AWAY_M: Final = 0.5
"""Distance from the scenario's start above which a warning is printed."""


class AttachedRun(LiveRun):
    """Drives with a running society. Unless the goal is reached, it leaves the robot stopped.

    It does not stop the robot if another mission has replaced its own, or if a mission of several
    tasks has ended, for example because it was cancelled.
    """

    mode = ATTACHED
    come_s: float = COME_S

    def __init__(self, scenario: Scenario, options: Options, mesh: Mesh) -> None:
        """A mission needs only the agents that `armadico up MISSION` starts."""
        taking = scenario if scenario.mission is None else least(scenario)
        super().__init__(taking, options, mesh)
        self.watch.contention = Contention()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the robot by the latched stop, if its mission has begun and not ended."""
        watch = self.watch
        if watch.phase is Phase.REPLACED:
            self._warn("the robot continues: another mission has replaced this one")
            return
        if not watch.mission or (watch.done and (not watch.failed or watch.tasks is not None)):
            return
        with undisturbed(), suppress(MeshError):
            try:
                self.client.stop(STOP_S, by="armadico run")
            except SocietyError as failure:
                self._warn(f"{failure}; `armadico stop` tries again")
            else:
                self._warn("the robot is stopped; `armadico resume` releases it")
        if self.scenario.mission is not None:  # it stays on the board
            self._warn(
                "its mission continues then, unless you cancel it: `armadico mission cancel"
                f" {watch.mission}`"
            )

    def start(self) -> None:
        """Wait until all agents are alive. Raises RunFailedError at the timeout."""
        began = self.client.mesh.now()
        if not self.client.wait_for(self._complete, REPORT_S):
            self._check_world()  # in the society of another world some agents will never come
            self._warn(f"waiting for {self._lacking()}")
        if not self.client.wait_for(self._complete, self.come_s - REPORT_S):
            raise RunFailedError(
                f"missing after {self.client.mesh.now() - began:.0f} s: {self._lacking()};"
                " `armadico up` on its machine starts an agent, `armadico ps` lists alive agents"
            )
        self._check_world()
        self._check_robot()
        self.read_bids()

    def read_bids(self) -> None:
        """See `RobotRun`. Which mechanisms decide is on the cards, also of agents that end."""
        found = self.client.cards().values()
        self.watch.contention.cards |= {card.instance: card for card in found if card is not None}

    def _complete(self) -> bool:
        return not self._missing() and self._ready_to_drive()

    def _lacking(self) -> str:
        if missing := self._missing():
            return ", ".join(missing)
        cards = (self.client.card(*robot) for robot in self._robots())
        faults = [card.fault for card in cards if card is not None and card.fault]
        return f"the robot: {faults[0] if faults else 'its agent is alive but publishes nothing'}"

    def _check_world(self) -> None:
        """Raises RunFailedError if agents were launched with the map of another world."""
        mine = Path(self.scenario.world).stem
        cards = [card for card in self.client.cards().values() if card is not None]
        known = {card.world for card in cards}
        others = sorted(known - {"", EMPTY, mine})
        if others:
            raise RunFailedError(
                f"the society runs in the world {others[0]!r}, but {self.scenario.name} is in"
                f" {mine!r}; drive a scenario of {others[0]!r}, or end the society"
                f" (`armadico down`) and start it again (`armadico up {self.scenario.name}`)"
            )
        world = load_world(self.scenario.world)
        other = sorted(c.name for c in cards if c.world == mine and not is_map(world, c.map))
        if other:
            raise RunFailedError(
                f"{', '.join(other)} of the society has another map {mine!r} than"
                f" {self.scenario.name}; copy one map to all hosts, and start the society again"
            )

    def _check_robot(self) -> None:
        robots = [instance for _, instance in self._robots()]
        if len(robots) > 1:
            raise RunFailedError(
                f"{len(robots)} robot agents in the namespace: {', '.join(robots)}; end one, or"
                " use --namespace NAME"
            )
        state = self.client.latest(RobotState)
        if state is not None and state.stop.stopped:
            how = release(state.stop, motors=state.motors)
            raise RunFailedError(f"the robot is stopped by {state.stop.requester}; {how}")
        here = self.watch.here
        if here is None:
            return
        x, y, _ = self.scenario.start
        if hypot(here[0] - x, here[1] - y) > AWAY_M:
            self._warn(
                f"the robot is at ({here[0]:.2f}, {here[1]:.2f}), not at the scenario's start"
                f" ({x:g}, {y:g}); the measures begin there"
            )
