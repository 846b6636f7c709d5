"""A run of several robots: a society each, one world, and a list of tasks for all of them.

It decides nothing: the list is given to one robot, which tells the others, and who does what they
settle among themselves. `FleetRehearsal` is all of that on one virtual mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from msgspec.structs import replace as replaced

from armadico.agents.fleet.messages import FleetReply, FleetRequest, FleetTask
from armadico.agents.fleet.view import FLEET_WATCHED, FleetResult, FleetWatch
from armadico.config.errors import ConfigError
from armadico.config.scenarios import Scenario, ScenarioPose
from armadico.core.messages import Message
from armadico.launch.society import Options
from armadico.launch.virtual import SETTLE_S, Rehearsal
from armadico.mesh.virtual import VirtualMesh
from armadico.mobile.messages import Waypoint
from armadico.runtime.blame import blaming
from armadico.runtime.client import Client
from armadico.runtime.errors import AbsentError, MissionRefusedError

FLEET: str = "fleet1"
"""What a fleet is called that nobody has named."""

TAKE_S = 10.0
"""What the list may take to be taken on."""

SLOW_M_S = 0.1
"""No fleet is slower on its way than this: a robot's share of the tasks, from one to the next."""

STEP_S = 0.5


def robots_of(scenario: Scenario, count: int | None) -> list[Scenario]:
    """A robot's own scenario for each of a fleet; so many, or all that there is a start for.

    Raises ConfigError for a number that cannot be, or a scenario without tasks.
    """
    starts: list[ScenarioPose] = [scenario.start, *scenario.others]
    count = len(starts) if count is None else count
    if not scenario.tasks:
        raise ConfigError(
            f"{scenario.name} has no tasks for a fleet: tasks = [[x, y, degrees], ...]"
        )
    if not 1 <= count <= len(starts):
        raise ConfigError(
            f"{count} robots: {scenario.name} has starts for 1 to {len(starts)}; others = [[x, y,"
            " degrees], ...] has those of all but the first"
        )
    return [replaced(scenario, start=start, goal=None) for start in starts[:count]]


def tasks_of(scenario: Scenario) -> tuple[FleetTask, ...]:
    """The list that a scenario has for a fleet."""
    return tuple(FleetTask(Waypoint(*pose), scenario.look_s) for pose in scenario.tasks)


def names_of(fleet: str, count: int) -> list[str]:
    """The namespaces of a fleet's robots."""
    return [f"{fleet}/r{k + 1}" for k in range(count)]


def time_limit(scenario: Scenario, robots: int, options: Options) -> float:
    """Seconds that a run may take: as asked for, or what a very slow fleet would."""
    if options.limit is not None:
        return options.limit
    places = [scenario.start, *scenario.tasks]
    spread = max(abs(a[0] - b[0]) + abs(a[1] - b[1]) for a in places for b in places)
    return 60.0 + len(scenario.tasks) / robots * (scenario.look_s + 0.5 * spread / SLOW_M_S)


def give(client: Client, tasks: Sequence[FleetTask], *, replace: bool = False) -> int:
    """Give a robot the list, also instead of one that the fleet works on (`replace`); its id.

    Raises MissionRefusedError saying why it is not taken on, AbsentError if nobody answers.
    """
    reply = client.ask(FleetRequest(tuple(tasks), replace), TAKE_S)
    if not isinstance(reply, FleetReply):
        raise AbsentError("no fleet agent takes the list of tasks", client.mesh.namespace)
    if reply.refusal:
        raise MissionRefusedError(f"the list of tasks was not taken on: {reply.refusal}")
    return reply.list


class FleetRehearsal:
    """Several societies on one virtual mesh, their robots in one world."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        robots: int | None = None,
        fleet: str = FLEET,
        mesh: VirtualMesh | None = None,
    ) -> None:
        """Everybody starts. Raises ConfigError for robots that cannot be."""
        self.mesh = VirtualMesh(options.seed) if mesh is None else mesh
        self.scenario, self.options = scenario, options
        ones = robots_of(scenario, robots)
        self.names = names_of(fleet, len(ones))
        self.robots: dict[str, Rehearsal] = {}
        tasks = tasks_of(scenario)
        short = tuple(name.rpartition("/")[2] for name in self.names)
        self.watch = FleetWatch(scenario.name, short, len(tasks), options.seed)
        for name, one in zip(self.names, ones, strict=True):
            chosen = replace(options, namespace=name)
            self.robots[name] = Rehearsal(one, chosen, mesh=self.mesh)
            self.mesh.watch(self._shower(name), *FLEET_WATCHED, namespace=name)
        first, *others = (rehearsal.robot for rehearsal in self.robots.values())
        try:
            first.meet(*others)
        except ValueError as error:
            raise ConfigError(f"{scenario.name}: {error}") from None

    def run(
        self,
        progress: Callable[[FleetWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> FleetResult:
        """Drive until all tasks are done, or time is up, or `stop` says so.

        Raises AgentFailedError if an agent's own code raises.
        """
        for rehearsal in self.robots.values():
            rehearsal.tell(warn or (lambda _: None))
        with blaming():
            self.mesh.run(self.mesh.now + SETTLE_S)
            first = self.robots[self.names[0]]
            began = self.mesh.now
            self.watch.begin(give(first.client, tasks_of(self.scenario)), began)
            limit = time_limit(self.scenario, len(self.names), self.options)
            while not self.watch.over and self.mesh.now < began + limit:
                self.mesh.run(min(self.mesh.now + STEP_S, began + limit), lambda: self.watch.over)
                if progress is not None:
                    progress(self.watch)
                if stop is not None and stop():
                    break
            else:
                self.watch.limit = limit
        return self.watch.result()

    def alive(self, name: str) -> bool:
        """Whether anybody of a robot's society is."""
        return any(node.namespace == name and node.alive for node in self.mesh.nodes)

    def kill(self, name: str) -> None:
        """A robot dies: every process of its society; its body stays where it is."""
        for node in self.mesh.nodes:
            if node.namespace == name and node.alive:
                node.kill()

    def _shower(self, namespace: str) -> Callable[[str, Message, float], None]:
        robot = namespace.rpartition("/")[2]
        return lambda _key, message, now: self.watch.show(robot, message, now)
