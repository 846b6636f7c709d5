"""A run of a society that others have started, on whatever machines: nobody is started or ended."""

from __future__ import annotations

from contextlib import suppress
from math import hypot
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final

from armadico.core.hands import release
from armadico.core.messages import RobotState
from armadico.launch.processes import undisturbed
from armadico.launch.run import LiveRun
from armadico.launch.society import ATTACHED, Options, least
from armadico.mesh.topology import MeshError
from armadico.runtime.errors import RunFailedError, SocietyError

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.mesh.base import Mesh

COME_S: Final = 30.0
"""What the agents may take to be there."""

SAY_S: Final = 1.0
"""Agents that are not alive by then are named as waited for."""

STOP_S: Final = 3.0
"""What the robot agent may take to confirm the stop."""

EMPTY: Final = "empty"
"""The world of agents that were launched without any."""

AWAY_M: Final = 0.5
"""A robot farther than this from the scenario's start is reported as elsewhere."""


class AttachedRun(LiveRun):
    """Watches a society that is up. Unless the goal is reached, it leaves the robot stopped.

    A robot that has been sent elsewhere meanwhile drives on.

    A mission of several tasks that is over, cancelled say, leaves the robot to those after it.
    """

    mode = ATTACHED
    come_s: float = COME_S

    def __init__(self, scenario: Scenario, options: Options, mesh: Mesh, **more: float) -> None:
        """Prepare; of a mission those are waited for whom `armadico up MISSION` starts."""
        taking = scenario if scenario.mission is None else least(scenario)
        super().__init__(taking, options, mesh, **more)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the robot, by the latch, if its mission was begun and not ended."""
        watch = self.watch
        if watch.replaced:  # the robot drives for another
            self._warn("the robot drives on: its mission is another one")
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
        if self.scenario.mission is not None:  # on the board, which outlives who ordered it
            self._warn(
                "its mission goes on then, unless it is cancelled: `armadico mission cancel"
                f" {watch.mission}`"
            )

    def start(self) -> None:
        """Wait until all agents are alive. Raises RunFailedError if one does not come."""
        began = self.client.mesh.now()
        if not self.client.wait_for(self._complete, SAY_S):
            self._check_world()  # an agent of another world's scenario is waited for in vain
            self._warn(f"waiting for {self._lacking()}")
        if not self.client.wait_for(self._complete, self.come_s - SAY_S):
            raise RunFailedError(
                f"not there within {self.client.mesh.now() - began:.0f} s: {self._lacking()};"
                " `armadico up` on its machine starts an agent, `armadico ps` lists alive agents"
            )
        self._check_world()
        self._check_robot()

    def _complete(self) -> bool:
        return not self._missing() and self._ready_to_drive()

    def _lacking(self) -> str:
        if missing := self._missing():
            return ", ".join(missing)
        cards = (self.client.card(*who) for who in self._robots())
        faults = [card.fault for card in cards if card is not None and card.fault]
        return f"the robot: {faults[0] if faults else 'its agent is there, and says nothing'}"

    def _check_world(self) -> None:
        """Raise RunFailedError if agents were launched with the map of another world."""
        mine = Path(self.scenario.world).stem
        known = {card.world for card in self.client.cards().values() if card is not None}
        others = sorted(known - {"", EMPTY, mine})
        if others:
            raise RunFailedError(
                f"the society is up in the world {others[0]!r}, and {self.scenario.name} is in"
                f" {mine!r}; drive a scenario of {others[0]!r}, or end the society"
                f" (`armadico down`) and start it anew (`armadico up {self.scenario.name}`)"
            )

    def _check_robot(self) -> None:
        robots = [instance for _, instance in self._robots()]
        if len(robots) > 1:
            raise RunFailedError(
                f"{len(robots)} robot agents are in the namespace: {', '.join(robots)}; end one,"
                " or name another namespace: --namespace NAME"
            )
        state = self.client.latest(RobotState)
        if state is not None and state.stop.stopped:
            how = release(state.stop, motors=state.motors)
            raise RunFailedError(f"the robot is stopped by {state.stop.who}; {how}")
        here = self.watch.here
        if here is None:
            return
        x, y, _ = self.scenario.start
        if hypot(here[0] - x, here[1] - y) > AWAY_M:
            self._warn(
                f"the robot is at ({here[0]:.2f}, {here[1]:.2f}), not at the scenario's start"
                f" ({x:g}, {y:g}): it is measured from there"
            )
