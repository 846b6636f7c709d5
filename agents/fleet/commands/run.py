"""A run of several robots: a society each, one world, and a list of tasks for all of them.

It decides nothing: it gives the list to one robot, which shares it with the others. The robots
distribute the tasks among themselves. `FleetRehearsal` runs on one virtual mesh; `local_fleet` runs
processes on this machine, and `attached_fleet` uses robots that are already running.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from msgspec.structs import replace as replaced

from armadico.agents.fleet.commands.view import FLEET_WATCHED, FleetResult, FleetWatch
from armadico.agents.fleet.messages import FleetClaims, FleetReply, FleetRequest, FleetTask
from armadico.config.scenarios import Scenario, ScenarioPose
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Message
from armadico.launch.client import Client
from armadico.launch.run import Run
from armadico.launch.society import Options, mechanisms, members
from armadico.launch.virtual import SETTLE_S, Rehearsal
from armadico.mesh.virtual import VirtualMesh
from armadico.mobile.messages import FleetAwards, FleetPose, FleetProposals, Waypoint
from armadico.observe.contention import Contention
from armadico.runtime.blame import attributed
from armadico.runtime.errors import AbsentError, MissionRefusedError

FLEET: str = "fleet1"  # the default name of a fleet

TAKE_S = 10.0  # the timeout for accepting the list

HEAR_S = 1.5  # each robot of a live fleet publishes within this time

SLOW_M_S = 0.1  # a lower bound for a robot's mean speed between tasks

# The watched messages that all robots publish beside their namespaces.
SHARED = (FleetClaims, FleetPose, FleetProposals, FleetAwards)


def robots_of(scenario: Scenario, count: int | None) -> list[Scenario]:
    """Return a scenario for each robot: `count` of them, or as many as there are starts.

    Raises ConfigError for an impossible number, or a scenario without tasks.
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
    """Return a scenario's list of tasks for a fleet."""
    return tuple(FleetTask(Waypoint(*pose), scenario.look_s) for pose in scenario.tasks)


def names_of(fleet: str, count: int) -> list[str]:
    """Return the namespaces of a fleet's robots."""
    return [f"{fleet}/r{k + 1}" for k in range(count)]


def short(name: str) -> str:
    """Return a robot's name within its fleet, by its namespace."""
    return name.rpartition("/")[2]


def time_limit(scenario: Scenario, robots: int, options: Options) -> float:
    """Return the time limit of a run, s: the chosen one, or that of a very slow fleet."""
    if options.limit is not None:
        return options.limit
    places = [scenario.start, *scenario.tasks]
    spread = max(abs(a[0] - b[0]) + abs(a[1] - b[1]) for a in places for b in places)
    return 60.0 + len(scenario.tasks) / robots * (scenario.look_s + 0.5 * spread / SLOW_M_S)


def give(client: Client, tasks: Sequence[FleetTask], *, replace: bool = False) -> int:
    """Give a robot the list, with `replace` also instead of a present one; return its id.

    Raises MissionRefusedError with the reason, or AbsentError if there is no reply.
    """
    reply = client.query(FleetRequest(tuple(tasks), replace), TAKE_S)
    if not isinstance(reply, FleetReply):
        raise AbsentError("no fleet agent takes the list of tasks", client.mesh.namespace)
    if reply.refusal:
        raise MissionRefusedError(f"the list of tasks was not taken on: {reply.refusal}")
    return reply.list


class FleetRun(Run[FleetWatch, FleetResult]):
    """A run of several robots; subclasses differ in their societies."""

    step_s = 0.5

    def __init__(self, scenario: Scenario, options: Options, fleet: str) -> None:
        super().__init__(scenario, options)
        self.fleet = fleet  # its name: the robots' namespaces are in it
        self.clients: dict[str, Client] = {}  # the client in each robot's namespace, by namespace
        self.watch = FleetWatch(scenario.name, (), len(scenario.tasks), options.seed)
        sets = {member.name: member.sets for member in members(scenario, options, "")}
        self.watch.contention = Contention(mechanisms(sets))

    @property
    def names(self) -> list[str]:
        """The namespaces of the participating robots."""
        return list(self.clients)

    @property
    def over(self) -> bool:
        return self.watch.over

    def now(self) -> float:
        return next(iter(self.clients.values())).mesh.now()

    def begin(self) -> float:
        self.watch.begin(self.request_mission(), self.now())
        self.limit = time_limit(self.scenario, len(self.clients), self.options)
        return self.now()

    def request_mission(self) -> int:
        """Give the list to one robot; return its id.

        Raises MissionRefusedError, or AbsentError if there is no reply.
        """
        return give(next(iter(self.clients.values())), tasks_of(self.scenario))

    def wait(self, seconds: float) -> None:
        self.wait_until(lambda: self.over, seconds)

    def wait_until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Process received messages of each client until the condition holds."""
        for client in self.clients.values():
            client.wait_for(condition, seconds / len(self.clients))

    def meet(self, name: str, client: Client) -> None:
        """Watch what a robot publishes; shared messages count only from the robot itself."""
        robot = short(name)
        self.clients[name] = client
        self.watch.names += (robot,)

        def show(message: Message, now: float) -> None:
            if not isinstance(message, SHARED) or message.robot == robot:
                self.watch.update(robot, message, now)

        client.listen(*FLEET_WATCHED, then=show)


class FleetRehearsal(FleetRun):
    """Several societies on one virtual mesh, their robots in one world."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        robots: int | None = None,
        fleet: str = FLEET,
    ) -> None:
        """Start all processes. Raises ConfigError for an impossible number of robots."""
        super().__init__(scenario, options, fleet)
        self.mesh = VirtualMesh(options.seed)
        ones = robots_of(scenario, robots)
        self.robots: dict[str, Rehearsal] = {}
        for name, one in zip(names_of(fleet, len(ones)), ones, strict=True):
            one_run = Rehearsal(one, replace(options, namespace=name), mesh=self.mesh)
            one_run.watch.contention = self.watch.contention
            self.robots[name] = one_run
            self.meet(name, self.robots[name].client)
        first, *others = (rehearsal.robot for rehearsal in self.robots.values())
        try:
            first.meet(*others)
        except ValueError as error:
            raise ConfigError(f"{scenario.name}: {error}") from None

    def report_to(self, warn: Callable[[str], None]) -> None:
        for rehearsal in self.robots.values():
            rehearsal.report_to(warn)

    def start(self) -> None:
        self.mesh.run(self.mesh.now + SETTLE_S)

    def begin(self) -> float:
        began = self.mesh.now  # before the list is handed over: the tables in docs count from here
        super().begin()
        self.watch.began = began
        return began

    def run(
        self,
        progress: Callable[[FleetWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> FleetResult:
        """See `Run`. Raises AgentFailedError if an agent's own code raises."""
        with attributed():
            super().run(progress, warn)
        for rehearsal in self.robots.values():
            rehearsal.read_bids()
        return self.watch.result()

    def wait_until(self, condition: Callable[[], bool], seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds, condition)

    def goes_on(self, elapsed: float) -> bool:  # noqa: ARG002
        return True

    def meet(self, name: str, client: Client) -> None:
        """See `FleetRun`. Messages are watched at their publication, without delays."""
        robot = short(name)
        self.clients[name] = client
        self.watch.names += (robot,)
        self.mesh.watch(
            lambda _, message, now: self.watch.update(robot, message, now),
            *FLEET_WATCHED,
            namespace=name,
        )

    def alive(self, name: str) -> bool:
        """Return whether any process of a robot's society is alive."""
        return any(node.namespace == name and node.alive for node in self.mesh.nodes)

    def kill(self, name: str) -> None:
        """Kill every process of a robot's society; its body stays where it is."""
        for node in self.mesh.nodes:
            if node.namespace == name and node.alive:
                node.kill()
