"""Tasks between robots by several mechanisms, also with a robot or an arbiter killed.

In the first part each robot is a puppet, which drives straight at one speed: what is measured is
the sharing alone, in many situations. The second part has whole societies, as
`armadico run fleet --robots 3 --virtual --coordination NAME --seed N`. Whatever a seed draws is the
same for all mechanisms: places, starts, the moment of a kill and the robot.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from statistics import mean, median
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.agents.fleet.fleet import Fleet, Parameters
from armadico.agents.fleet.messages import FleetClaims, FleetRequest, FleetTask
from armadico.config.scenarios import load_scenario
from armadico.core.discovery import agent_class
from armadico.core.mechanisms import coordinations
from armadico.core.messages import Message
from armadico.core.parameters import Social
from armadico.launch.society import Options, prepared
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mobile.messages import FleetAwards, FleetProposals, Waypoint
from armadico.runtime.errors import SocietyError
from armadico.testing.puppet import Puppet, PuppetParameters
from armadico_tools.experiments.driving import counted
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.markdown import table

MECHANISMS: Final = ("ballots", "contract-net", "alliance", "central")

NONE, ROBOT, ARBITER = "none", "a robot", "the only arbiter"
BOTH: Final = "the only arbiter, then a robot"
SPARE: Final = "an arbiter of three"
KILLS: Final = (NONE, ROBOT, ARBITER, BOTH, SPARE)
AFTER_S: Final = 5.0
"""From the arbiter's kill to the robot's, s."""

ROBOTS: Final = 3

COUNT: Final = 12
HALL_M: Final = 12.0
LOOK_S: Final = 5.0
PUPPETS_S: Final = 600.0
KILLED_S: Final = (5.0, 60.0)
"""Of puppets: between these times after the list was given, s."""

EVERY: Final = 2
"""Of whole societies: each second task of the scenario."""

SOCIETIES_S: Final = 180.0
SOON_S: Final = (8.0, 45.0)

SETTLED_S: Final = 2.0

NOTE: Final = (
    "*puppets*: 3 robots that drive straight at 0.4 m/s, 12 tasks of 5 s at random in 12 by 12 m,"
    " limit 600 s; kills at 5 to 60 s. *societies*: scenario `fleet` with each second task, 3"
    " robots, ideal sensors, limit 180 s; kills at 8 to 45 s; seeds change little there. *all"
    " done*: runs in which all tasks were done. *tasks*: mean of those done. *time*: median (least"
    " to most) over the runs in which all were done. *paired*: median of the time over that of"
    " ballots in the same situation. *way*: mean of the sum of all robots. *messages*: for sharing"
    " the list, per task of the list, until its end. *twice*: tasks that two robots did. A killed"
    " robot loses all processes. The only arbiter: each other robot's was ended at the start."
    " Nothing is restarted."
)


class Task(Struct, frozen=True):
    """One run; its text is the key of its stored result."""

    mechanism: str
    killed: str
    seed: int


class Allocated(Struct, frozen=True):
    """The result of one run."""

    mechanism: str
    killed: str
    seed: int
    killed_at: float  # s after the list was given; 0: not
    done: int
    tasks: int
    twice: int
    time_s: float | None  # None: not all were done
    way_m: float
    messages: float
    collisions: int = 0
    note: str = ""


def chosen(task: Task) -> tuple[str | None, list[str]]:
    """The coordination of a run, and the names of its arbiters."""
    name = None if task.mechanism == MECHANISMS[0] else task.mechanism
    return name, [each.arbiter for each in coordinations(name).values() if each.arbiter]


# Puppets ------------------------------------------------------------------------------------------


class Puppets:
    """Robots on one virtual mesh, each with a fleet agent, and an arbiter if there is one."""

    def __init__(self, task: Task) -> None:
        self.task, draw = task, random.Random(f"allocation/{task.seed}")

        def place() -> tuple[float, float]:
            return draw.uniform(0.0, HALL_M), draw.uniform(0.0, HALL_M)

        self.places = [place() for _ in range(COUNT)]
        starts = [place() for _ in range(ROBOTS)]
        self.killed, self.at = draw.randrange(ROBOTS), draw.uniform(*KILLED_S)
        self.mesh = VirtualMesh(task.seed)
        self.robots: list[list[Node]] = []
        self.arbiters: list[Node] = []
        self.done: dict[int, set[str]] = {}
        self.messages, self.time_s = 0, 0.0
        self._began = 0.0
        coordination, arbiters = chosen(task)
        for k, start in enumerate(starts):
            name, social = f"f/r{k + 1}", Social(coordination=coordination)
            puppet = Puppet(
                self.mesh.identity("puppet", 0, name), PuppetParameters(x=start[0], y=start[1])
            )
            identity = self.mesh.identity("fleet", 0, name)
            fleet = Fleet(identity, Parameters(namespace=name, social=social))
            nodes = [self.mesh.add(each, namespace=name) for each in (puppet, fleet)]
            for arbiter in arbiters:
                kind = agent_class(arbiter)
                parameters = kind.parameters(namespace=name)  # type: ignore[call-arg]
                made = kind(self.mesh.identity(arbiter, 0, name), parameters)
                nodes.append(self.mesh.add(made, namespace=name))
                self.arbiters.append(nodes[-1])
            self.robots.append(nodes)
            self.mesh.watch(self._note, FleetClaims, FleetProposals, FleetAwards, namespace=name)

    def run(self) -> Allocated:
        """Give the list to the first robot, and run to its end or the limit."""
        mesh, task = self.mesh, self.task
        mesh.run(SETTLED_S)
        if task.killed in (ARBITER, BOTH):
            for node in self.arbiters[1:]:
                node.kill()
        if task.killed in (ARBITER, BOTH, SPARE):
            mesh.call_at(mesh.now + self.at, lambda *_: self.arbiters[0].kill(), None)
        if task.killed in (ROBOT, BOTH):
            after = self.at + (AFTER_S if task.killed == BOTH else 0.0)
            mesh.call_at(mesh.now + after, lambda *_: self._kill(), None)
        self._began = mesh.now
        goals = tuple(FleetTask(Waypoint(x, y, 0.0), LOOK_S) for x, y in self.places)
        mesh.query(FleetRequest(goals), lambda _reply: None, namespace="f/r1")
        mesh.run(mesh.now + PUPPETS_S, lambda: len(self.done) == COUNT)
        puppets = [nodes[0].agent for nodes in self.robots]
        return Allocated(
            *(task.mechanism, task.killed, task.seed),
            killed_at=0.0 if task.killed == NONE else round(self.at, 1),
            done=len(self.done),
            tasks=COUNT,
            twice=sum(len(by) > 1 for by in self.done.values()),
            time_s=round(self.time_s, 1) if len(self.done) == COUNT else None,
            way_m=round(sum(each.way_m for each in puppets if isinstance(each, Puppet)), 2),
            messages=round(self.messages / COUNT, 1),
        )

    def _kill(self) -> None:
        for node in self.robots[self.killed]:
            if node.alive:
                node.kill()

    def _note(self, _key: str, message: Message, now: float) -> None:
        self.messages += getattr(message, "cycle").epoch != 0  # noqa: B009 - all three have one
        for each in message.done if isinstance(message, FleetClaims) else ():
            self.done.setdefault(each.task, set()).add(each.by)
            self.time_s = now - self._began


def share(task: Task) -> Allocated:
    """One run with puppets, for a worker process."""
    return Puppets(task).run()


# Whole societies ----------------------------------------------------------------------------------


def allocate(task: Task) -> Allocated:
    """One run with societies, for a worker process."""
    mechanism, arbiters = chosen(task)
    options = Options(seed=task.seed, coordination=mechanism, limit=SOCIETIES_S)
    scenario = load_scenario("fleet")
    scenario = replace(scenario, tasks=scenario.tasks[::EVERY])
    fleet = FleetRehearsal(prepared(scenario, options), options, ROBOTS)
    mesh, draw = fleet.mesh, random.Random(task.seed)
    name, at = draw.choice(fleet.names), draw.uniform(*SOON_S)
    deciding = [node for node in mesh.nodes if node.name in arbiters]
    fleet.start()
    if task.killed == ARBITER:
        for node in deciding[1:]:
            node.kill()
        mesh.call_at(mesh.now + at, lambda *_: deciding[0].kill(), None)
    elif task.killed == ROBOT:
        mesh.call_at(mesh.now + at, lambda *_: fleet.kill(name), None)
    note = ""
    try:
        fleet.run()
    except SocietyError as error:
        note = str(error)
    found = fleet.watch.result()
    return Allocated(
        *(task.mechanism, task.killed, task.seed, round(at, 1) if task.killed != NONE else 0.0),
        *(found.done, found.tasks, len(found.twice), found.makespan_s),
        way_m=round(sum(robot.way_m for robot in found.robots), 2),
        messages=found.messages,
        collisions=sum(counted(robot.collisions) for robot in found.robots),
        note=note or found.note,
    )


# The experiment -----------------------------------------------------------------------------------


def tasks(seeds: Sequence[int], kills: Sequence[str]) -> list[Task]:
    """All runs, those of the first seed first."""
    found = [Task(name, kill, seed) for seed in seeds for kill in kills for name in MECHANISMS]
    return [each for each in found if each.killed in (NONE, ROBOT) or chosen(each)[1]]


def report(context: Context) -> str:
    """A row for each mechanism and kind of kill, of either part."""
    return "\n\n".join(f"## {part}\n\n{_part(context, part)}" for part in ("puppets", "societies"))


def _part(context: Context, part: str) -> str:
    runs: list[Allocated] = context.found[part]
    ballots = {(r.seed, r.killed): r.time_s for r in runs if r.mechanism == MECHANISMS[0]}
    rows = []
    for killed, mechanism in dict.fromkeys((run.killed, run.mechanism) for run in runs):
        own = [run for run in runs if (run.killed, run.mechanism) == (killed, mechanism)]
        pairs = [(run.time_s, ballots.get((run.seed, killed))) for run in own]
        ratios = [time / other for time, other in pairs if time and other]
        paired = f"{median(ratios):.2f}" if ratios and mechanism != MECHANISMS[0] else "-"
        rows.append((killed, mechanism, *_row(own, paired)))
        context.summary[f"{part}, {killed}, {mechanism}"] = sum(map(_all_done, own))
    head = (
        *("killed", "mechanism", "all done", "tasks", "time, s", "paired", "way, m"),
        *("messages a task", "twice", "touched"),
    )
    return table(head, rows)


def _all_done(run: Allocated) -> bool:
    return run.done == run.tasks


def _row(runs: Sequence[Allocated], paired: str) -> tuple[object, ...]:
    times = [run.time_s for run in runs if run.time_s is not None]
    return (
        f"{sum(map(_all_done, runs))} of {len(runs)}",
        f"{mean(run.done for run in runs):.1f}",
        f"{median(times):.0f} ({min(times):.0f} to {max(times):.0f})" if times else "-",
        paired,
        f"{mean(run.way_m for run in runs):.0f}",
        f"{mean(run.messages for run in runs):.0f}",
        sum(run.twice for run in runs),
        sum(bool(run.collisions) for run in runs),
    )


def _few(context: Context) -> list[Task]:
    return tasks(context.seeds[: max(1, context.runs // 10)], KILLS[:3])


ALLOCATION: Final = Experiment(
    note=NOTE,
    parts=(
        Part("puppets", share, lambda context: tasks(context.seeds, KILLS)),
        Part("societies", allocate, _few),
    ),
    report=report,
    runs=100,
    first_seed=1000,
)
