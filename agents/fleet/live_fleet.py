"""A run of a fleet over a real mesh: a list of tasks is given to one robot, and watched to its end.

Who starts the societies is `launch.local_fleet` (processes on this machine) or
`launch.attached_fleet` (somebody else). It decides nothing: kill it and the fleet goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from armadico.agents.fleet.messages import FleetClaims
from armadico.agents.fleet.run import STEP_S, give, tasks_of, time_limit
from armadico.agents.fleet.view import FLEET_WATCHED, FleetResult, FleetWatch
from armadico.core.messages import Message
from armadico.mobile.messages import FleetPose
from armadico.runtime.client import Client

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.launch.society import Options
    from armadico.mesh.base import Mesh

HEAR_S: Final = 1.5
"""A fleet that is there is heard of within this: each robot speaks once a second."""

SHARED: Final = (FleetClaims, FleetPose)
"""Of what is watched, what all robots publish beside their namespaces."""


class LiveFleet:
    """The life of a run; a context manager, since whoever leaves it has something to leave.

    Attributes:
        names: The namespaces of the robots that take part.
        clients: A guest in each of these namespaces.
        watch: What has come of the list.
    """

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        fleet: str,
        join: Callable[[str], Mesh],
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare.

        Args:
            scenario: The world and the tasks.
            options: What else was chosen.
            fleet: Its name: the robots' namespaces are in it.
            join: Joins the mesh in a namespace; what it gives is closed at the end.
            warn: Told who is gone and what goes wrong.
        """
        self.scenario, self.options, self.fleet = scenario, options, fleet
        self.names: list[str] = []
        self.clients: list[Client] = []
        self.watch = FleetWatch(scenario.name, (), len(scenario.tasks), options.seed)
        self._join, self._warn = join, warn
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def start(self) -> None:
        """See that all robots are there. Raises RunFailedError if they are not."""
        raise NotImplementedError

    def hand_over(self) -> int:
        """Give the list to one of them; its id.

        Raises MissionRefusedError, or AbsentError if nobody takes it.
        """
        return give(self.clients[0], tasks_of(self.scenario))

    def look(self) -> None:
        """Called now and then. A robot that is gone is no reason to end: the others have its tasks.

        Raises RunFailedError if none is left.
        """
        raise NotImplementedError

    def run(self, progress: Callable[[FleetWatch], None] | None = None) -> FleetResult:
        """Start, and drive until all tasks are done, or time is up.

        Raises RunFailedError if it cannot go on, or what `hand_over` does.
        """
        self.start()
        now = self.clients[0].mesh.now
        self.watch.begin(self.hand_over(), now())
        end = now() + (limit := time_limit(self.scenario, len(self.names), self.options))
        while not self.watch.over and now() < end:
            self.wait(lambda: self.watch.over)
            if progress is not None:
                progress(self.watch)
            self.look()
        if not self.watch.over:
            self.watch.limit = limit
        return self.watch.result()

    def wait(self, over: Callable[[], bool]) -> None:
        """Let each guest take what has come to it, until something is so, `STEP_S` in all."""
        for client in self.clients:
            client.wait_for(over, STEP_S / len(self.clients))

    # Inside --------------------------------------------------------------------------------------

    def _joined(self, namespace: str) -> Mesh:
        mesh = self._join(namespace)
        self._stack.callback(mesh.close)
        return mesh

    def _listen(self, name: str, client: Client) -> None:
        """Watch what a robot publishes; what all robots share, by each robot's own router."""
        robot = short(name)
        if robot not in self.watch.names:
            self.watch.names += (robot,)

        def show(message: Message, now: float) -> None:
            if not isinstance(message, SHARED) or message.robot == robot:
                self.watch.show(robot, message, now)

        client.listen(*FLEET_WATCHED, then=show)


def short(name: str) -> str:
    """What the fleet calls the robot of a namespace."""
    return name.rpartition("/")[2]
