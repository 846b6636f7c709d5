"""The present of a society on the virtual mesh, by what a guest on it would receive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from armadico.config.scenarios import scenario_from
from armadico.core.messages import Message, ParametersRequest
from armadico.launch.options import Options
from armadico.launch.society import prepared, profile_of
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import Pose2
from armadico.rehearsal.present import Account, Present, kinds, present

STANDS_S: Final = 2.0
"""So long it stands before, and sees what is around it."""


def standing(
    world: str, start: Pose2, profile: str | None = None, besides: Sequence[str] = ()
) -> Present:
    """The present of the default society, whose robot stands at a pose (m, m, rad) in a world.

    `besides` are further agents. Raises ConfigError if the robot cannot stand there.
    """
    options = Options(besides=tuple(besides))
    scenario = prepared(scenario_from(world, start, robot=profile_of(profile)), options)
    run = Rehearsal(scenario, options)
    attended = Attended(run)
    run.start()
    run.mesh.run(run.mesh.now + STANDS_S)
    return attended.now()


class Attended:
    """Receives what a virtual run publishes, but for the truth, which agents do not know."""

    def __init__(self, run: Rehearsal) -> None:
        self.run, self.account = run, Account()
        run.mesh.watch(self._on_message, *kinds(), namespace=run.namespace)

    def _on_message(self, key: str, message: Message, now: float) -> None:
        self.account.update(key, message, now)

    def now(self) -> Present:
        """The present, with the cards and parameters that the agents would tell now."""
        now, account = self.run.mesh.now, self.account
        there = [each for each in self.run.mesh.nodes if each.alive and each.begun]
        names = {each.agent.instance for each in there}
        for gone in [each for each in account.view.alive if each not in names]:
            account.token(gone, there=False, t=now)
        for node in there:
            kernel = node.agent.kernel
            account.token(node.agent.instance, there=True, t=now)
            account.learn(kernel.card(), now)
            account.learn(kernel.tune(ParametersRequest(), now), now)
        return present(account, now)
