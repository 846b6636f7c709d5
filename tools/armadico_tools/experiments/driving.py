"""One run of an experiment: from a cell of its table and a seed to a row.

**Stop rule.** The clock starts with the first cycle after the mission is accepted and stops when
the interface agent reports the goal as reached: its pose within 0.12 m and 4 degrees, wheels at
rest. The fast controller does not turn to the goal's heading. So its runs stop when the robot has
rested for 2 s within 0.15 m of the goal; TT ends at the begin of that rest. Other runs end at their
time limit (5 times the way over 0.3 m/s), when the robot has stayed within 1 m of one place for
60 s, or when a battery that an agent wants charged is empty.
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from math import degrees, hypot, radians
from pathlib import Path
from random import Random
from statistics import median
from typing import Annotated, Any, Final

from msgspec import Meta, Struct, field, structs

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.config.loading import read_text
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario, ideal, load_scenario, society
from armadico.config.shipped import find as find_config
from armadico.config.worlds import load_world
from armadico.core.discovery import agent_class
from armadico.core.errors import UnknownNameError
from armadico.core.judgement import Answer
from armadico.core.mechanisms import coordinations
from armadico.core.membership import agent_of
from armadico.core.messages import Ack, Award, Claim, Command, Cycle, Message, Proposal
from armadico.core.resources import WHEELS
from armadico.launch.society import Options, conditions, names, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose, Truth
from armadico.observe.conditions import Conditions
from armadico.observe.measures import REACHED_M, RunWatch
from armadico.runtime.errors import MissionRefusedError, RunFailedError
from armadico.watch.pictures import Run, draw_run
from armadico_tools.experiments.bidders import PLACE, VISITED_M, Recharge, Visit
from armadico_tools.experiments.made_worlds import MADE
from armadico_tools.experiments.made_worlds import scenario as made

Seconds = Annotated[float, Meta(ge=0, le=1e6)]

DRIVER: Final = "driver"
ANY: Final = "any"
BYSTANDER: Final = "bystander"

UNLIKE: Final = (0.15, radians(12.5))
"""Two agents want unlike motions if their speeds differ by more, m/s or rad/s: a quarter of what
goto drives at most, 0.6 m/s and 50 degrees per second."""

LATE: Final = 1
"""Cycles by which a bid may be older than the newest cycle to count."""

REST_S = 2.0
REST_M_S, REST_RAD_S = 0.01, 0.02
"""True speeds below which the wheels are at rest: the interface agent's own limits."""

STUCK_S, STUCK_M = 60.0, 1.0
"""A robot that has not left a circle of this radius for this time is stuck."""

LOCALIZING = society().ideal.without
"""Agents that take part only if a cell says so: the thesis had no localization."""


class Kill(Struct, frozen=True, forbid_unknown_fields=True):
    """A process that is killed in mid-run.

    `who` is an agent, or `driver`: the process that the robot obeys then (an arbiter, if there is
    one), or `any`: a process of the society, the robot agent and an arbiter included, each as
    likely. Which one, and the time after the mission began, are drawn from the seed.
    """

    who: str = DRIVER
    after_s: tuple[Seconds, Seconds] = (8.0, 20.0)
    back_s: Seconds | None = 2.0  # a new process joins so long after; None: none does


class Cell(Struct, frozen=True, forbid_unknown_fields=True):
    """One cell of a table: a scenario and its changes.

    By default sensors have no error and there is no localization, as in the thesis's tables.
    """

    name: str
    scenario: str = ""  # name of a shipped one, or a file
    world: str = ""  # instead: a generator of `made_worlds`; a world for each seed
    controller: str | None = None
    exchange: str | None = None
    parameters: str | None = None
    sets: tuple[str, ...] = field(default=(), name="set")  # AGENT.KEY=VALUE
    without: tuple[str, ...] = ()
    besides: tuple[str, ...] = field(default=(), name="with")
    sensors: str = "ideal"
    robot: str | None = None
    coordination: str | None = None
    told: str | None = None
    redundant: bool = False
    robots: Annotated[int, Meta(ge=1, le=32)] = 1  # several: the tasks of a fleet's scenario
    kill: Kill | None = None
    bidders: Annotated[int, Meta(ge=0, le=64)] = 0  # least number that compete for the wheels


class Sample(Struct, frozen=True):
    """One run: measures of `observe.measures.Result`, errors of the pose, and a note.

    `arrived` is by the true position alone, within 0.15 m; `reached` requires the heading too. Both
    are whether a mission of several tasks is done.
    `believed_p_percent` is P by the encoders' pose.
    """

    cell: str
    seed: int
    reached: bool
    arrived: bool
    td_m: float
    fo_deg: float | None  # None, and P: without a goal, as in a mission of several tasks
    tt_s: float
    p_percent: float | None
    exchanges: int
    believed_p_percent: float | None = None
    tg_percent: float | None = None
    ta_percent: float | None = None
    tgt_percent: float | None = None
    collisions: int | None = None
    min_clearance_m: float | None = None
    pose_m: float | None = None  # error of the pose, median over the run
    pose_end_m: float | None = None  # at its end
    pose_end_deg: float | None = None
    note: str = ""
    contested_percent: float | None = None  # cycles in which two agents wanted unlike motions
    contended: int | None = None  # cycles in which two bid for what the coordination decides about
    messages_per_cycle: float | None = None  # claims, commands, proposals and awards of the wheels
    undriven_s: float | None = None  # from a kill until the robot obeys another process
    unobeyed_s: float | None = None  # the longest time after a kill without an obeyed command
    killed: str | None = None  # the agent; None: nothing was killed
    visited: bool | None = None  # the place that an agent wants to visit; None: no agent does
    least_charge: float | None = None  # share of the battery; None: no agent wants it charged

    @property
    def clean(self) -> bool:
        """Whether it reached the goal, and the place, and touched nothing.

        With an empty battery a robot stands, though the simulated one would drive on.
        """
        empty = self.least_charge is not None and self.least_charge <= 0.0
        return self.reached and self.collisions == 0 and self.visited is not False and not empty


def counted(count: int | None) -> int:
    """A number of contacts. Raises RunFailedError if it is not known: 0 would be a good result."""
    if count is None:
        raise RunFailedError("contacts are not known: no truth of the robot was received")
    return count


Samples = dict[str, list[Sample]]
"""Runs by the name of their cell, in the order of seeds."""


class Drive:
    """One run on the virtual mesh."""

    def __init__(self, cell: Cell, seed: int, mesh_seed: int | None = None) -> None:
        """`seed` is the run's, and that of a generated world; `mesh_seed` replaces the first."""
        self.cell, self.seed = cell, seed
        self._mesh_seed = seed if mesh_seed is None else mesh_seed
        self.scenario = scenario_of(cell, seed)
        self.rehearsal = Rehearsal(self.scenario, self._options())
        self.contest = Contest(self.rehearsal, cell)
        self.aims = Aims(self.scenario)
        self._taking = names(self.scenario, self._options().without)
        self.ticks: list[tuple[Truth, str | None]] = []  # with the holder, each cycle
        self.pose_errors: list[tuple[float, float]] = []  # m and rad, each cycle of the mission
        self.rehearsal.mesh.watch(lambda _k, message, _t: self._tick(message), Truth)
        self.rehearsal.mesh.watch(lambda _k, message, _t: self._compare(message), Pose)
        self.refused = ""
        self._rests_since: float | None = None
        self._left: Truth | None = None  # begin of the last circle of STUCK_M

    @property
    def watch(self) -> RunWatch:
        """The source of the run's measures."""
        return self.rehearsal.watch

    def go(self) -> Drive:
        mesh = self.rehearsal.mesh
        try:
            self.contest.join()
            self.rehearsal.start()
            self.rehearsal.begin()
        except MissionRefusedError as error:
            self.refused = error.reason
            return self
        self.contest.begin(Random(f"kill/{self.seed}"))
        mesh.run(mesh.now + self.rehearsal.limit, self._over)
        return self

    def _tick(self, truth: Message) -> None:
        assert isinstance(truth, Truth)
        if not self.watch.mission or self.watch.done:
            return
        self.ticks.append((truth, self.watch.holder))
        self.contest.count()
        self.aims.update(truth)
        left = self._left
        if left is None or hypot(truth.x - left.x, truth.y - left.y) > STUCK_M:
            self._left = truth
        if abs(truth.v) > REST_M_S or abs(truth.w) > REST_RAD_S:
            self._rests_since = None
        elif self._rests_since is None:
            self._rests_since = truth.t

    def _compare(self, pose: Message) -> None:
        """Record the error of the pose, before the goal is reached."""
        truth = self.watch.view.truth
        if isinstance(pose, Pose) and truth and self.watch.mission and not self.watch.done:
            off = hypot(pose.x - truth.x, pose.y - truth.y)
            self.pose_errors.append((off, abs(wrap(pose.theta - truth.theta))))

    def sample(self) -> Sample:
        """The row of this run."""
        self.rehearsal.read_bids()
        result = structs.asdict(self.watch.result())
        shares: dict[str, float] = dict(result["shares"])
        row = {
            field: value
            for field, value in result.items()
            if field in Sample.__struct_fields__ and field not in ("seed", "arrived")
        }
        done = result["reached"] if self.watch.goal is not None else result["done"]
        row["reached"] = done is True  # unknown does not count; the note has why
        resting = self._parked()
        if resting and self._rests_since is not None:
            row["tt_s"] = round(self._rests_since - self.ticks[0][0].t, 3)
            holders = [holder for truth, holder in self.ticks if truth.t <= self._rests_since]
            shares = {name: share(name, holders) for name in SHARES.values()}
        row |= {field: shares.get(n, 0.0) for field, n in SHARES.items() if n in self._taking}
        return Sample(
            cell=self.cell.name,
            seed=self.seed,
            arrived=self._arrived(resting, done=row["reached"]),
            believed_p_percent=self._believed(),
            note=self._note(resting),
            **self._pose_errors(),
            **self.contest.measures(len(self.ticks)),
            **self.aims.measures(),
            **row,
        )

    def _arrived(self, resting: bool, *, done: bool) -> bool:
        if self.watch.goal is None:
            return done
        return ((self.watch.done and not self.watch.failed) or resting) and self._at_goal()

    def _pose_errors(self) -> dict[str, Any]:
        if not self.pose_errors:
            return {}
        end_m, end_rad = self.pose_errors[-1]
        return {
            "pose_m": round(median(way for way, _ in self.pose_errors), 4),
            "pose_end_m": round(end_m, 4),
            "pose_end_deg": round(degrees(end_rad), 2),
        }

    def _note(self, resting: bool) -> str:
        if self.refused:
            return f"refused: {self.refused}"
        if self.watch.failed:
            return f"failed: {self.watch.failed}"
        judgement = self.watch.judge()
        if judgement.answer is Answer.UNKNOWN:
            return f"unknown: {judgement.reason}"
        if self.watch.done or resting:
            return self.contest.note
        if self.aims.empty:
            return "the battery is empty"
        return "stuck" if self._stuck() else "time limit"

    def _believed(self) -> float | None:
        pose, start, goal = self.watch.view.pose, self.watch.start, self.watch.goal
        if pose is None or start is None or goal is None:
            return None
        straight = hypot(goal[0] - start[0], goal[1] - start[1])
        off = hypot(goal[0] - pose.x, goal[1] - pose.y)
        return round(100.0 * (1.0 - off / straight), 3) if straight else None

    def _over(self) -> bool:
        return self.watch.done or self._parked() or self._stuck() or self.aims.empty

    def _stuck(self) -> bool:
        return self._left is not None and self.ticks[-1][0].t - self._left.t > STUCK_S

    def _parked(self) -> bool:
        """Whether the fast controller has come to rest at the goal."""
        if self.cell.controller != "fast" or self._rests_since is None:
            return False
        return self.ticks[-1][0].t - self._rests_since >= REST_S and self._at_goal()

    def _at_goal(self) -> bool:
        here, goal = self.watch.here, self.watch.goal
        if here is None or goal is None:
            return False
        return hypot(goal[0] - here[0], goal[1] - here[1]) <= REACHED_M

    def _options(self) -> Options:
        return replace(options_of(self.cell), seed=self._mesh_seed)


class Aims:
    """What agents want beside the mission's goal, by the true pose and charge."""

    def __init__(self, scenario: Scenario) -> None:
        agents = {*scenario.agents}
        goals = load_world(scenario.world).goals if Visit.name in agents else {}
        self._place, self._visited = goals.get(PLACE), False
        self._drains, self._least = Recharge.name in agents, 1.0

    def update(self, truth: Truth) -> None:
        self._least = min(self._least, truth.charge)
        if self._place is not None:
            x, y, _ = self._place
            self._visited |= hypot(x - truth.x, y - truth.y) <= VISITED_M

    @property
    def empty(self) -> bool:
        return self._drains and self._least <= 0.0

    def measures(self) -> dict[str, Any]:
        """The measures of the whole run; none of aims that no agent has."""
        found: dict[str, Any] = {}
        if self._place is not None:
            found["visited"] = self._visited
        if self._drains:
            found["least_charge"] = round(self._least, 4)
        return found


class Contest:
    """How the agents of a run compete for the wheels, and the fault that is made there."""

    def __init__(self, rehearsal: Rehearsal, cell: Cell) -> None:
        self._run, self._cell = rehearsal, cell
        known = coordinations(cell.coordination)
        arbiters = {each.arbiter for each in known.values()}
        proposing = {*rehearsal.names} - arbiters
        self._rivals = {n for n in proposing if WHEELS in agent_class(n).competes_for}
        self._unlike = self._messages = 0
        self._counts = False
        self._killed: tuple[str, float] | None = None
        self._undriven: float | None = None
        self._unobeyed = 0.0
        self._obeyed: tuple[Cycle | None, float] = (None, 0.0)  # of the newest one; when it was new
        self._rng = Random()
        rehearsal.mesh.watch(self._on_message, Claim, Command, Proposal, Award)
        if cell.kill is not None:
            rehearsal.mesh.watch(self._on_ack, Ack)

    def join(self) -> None:
        """Let further bidders join, up to the number of the cell."""
        here = sum(name in self._rivals for name in self._run.names)
        for _ in range(self._cell.bidders - here):
            self._run.enter(BYSTANDER)

    def begin(self, rng: Random) -> None:
        """The mission has begun."""
        self._counts, self._rng = True, rng
        kill, mesh = self._cell.kill, self._run.mesh
        if kill is not None:
            mesh.call_at(mesh.now + rng.uniform(*kill.after_s), self._kill)

    def count(self) -> None:
        """Count a cycle in which two agents want unlike motions."""
        wanted = []
        for node in self._run.mesh.nodes:
            if node.alive and node.name in self._rivals and (bids := node.agent.kernel.bids):
                bid, newest = bids[-1], node.agent.cycles.newest
                late = newest is None or newest.number - bid.cycle.number > LATE
                if bid.utility and not late:
                    wanted.append(WHEELS.unpack(bid.wanted))
        pairs = zip(zip(*wanted, strict=True), UNLIKE, strict=False)
        self._unlike += any(max(each) - min(each) > most for each, most in pairs)

    def measures(self, cycles: int) -> dict[str, Any]:
        """The measures of the whole run."""
        if not cycles:
            return {}
        found: dict[str, Any] = {
            "contested_percent": round(100.0 * self._unlike / cycles, 2),
            "messages_per_cycle": round(self._messages / cycles, 3),
        }
        if self._killed is not None:
            never = self._run.mesh.now - self._killed[1]
            found["undriven_s"] = round(never if self._undriven is None else self._undriven, 3)
            last = 0.0 if self._run.watch.done else self._run.mesh.now - self._obeyed[1]
            found["unobeyed_s"] = round(max(self._unobeyed, last), 3)
            found["killed"] = agent_of(self._killed[0])
        return found

    @property
    def note(self) -> str:
        """Says that the run was over before anything was killed."""
        spared = self._cell.kill is not None and self._killed is None
        return "nothing was killed" * spared

    def _on_message(self, _key: str, message: Message, _now: float) -> None:
        resource = getattr(message, "resource", "")
        self._messages += self._counts and not self._run.watch.done and resource == WHEELS.name

    def _on_ack(self, _key: str, ack: Message, now: float) -> None:
        assert isinstance(ack, Ack)
        if ack.resource != WHEELS.name or self._run.watch.done:
            return
        if ack.obeyed_cycle != self._obeyed[0]:
            if self._killed is not None:
                since = max(self._obeyed[1], self._killed[1])
                self._unobeyed = max(self._unobeyed, now - since)
            self._obeyed = ack.obeyed_cycle, now
        if self._killed is None or self._undriven is not None:
            return
        if ack.obeyed is not None and ack.obeyed.instance != self._killed[0]:
            self._undriven = now - self._killed[1]

    def _kill(self, _a: object, _b: object) -> None:
        """Kill the process; if nobody drives now, in the next cycle."""
        kill, mesh = self._cell.kill, self._run.mesh
        assert kill is not None, "it is called for nothing else"
        who = kill.who
        driver = self._run.watch.view.driver(WHEELS.name, mesh.now) if who == DRIVER else None
        alive = [node for node in mesh.nodes if node.alive and node.name in self._run.names]
        nodes = [
            node
            for node in alive
            if who == ANY or (node.agent.instance == driver if who == DRIVER else node.name == who)
        ]
        if self._run.watch.done:
            return
        if not nodes:
            mesh.call_at(mesh.now + 0.1, self._kill)
            return
        node = self._rng.choice(nodes) if who == ANY else nodes[0]
        self._killed = node.agent.instance, mesh.now
        node.kill()
        if kill.back_s is not None:
            mesh.call_at(mesh.now + kill.back_s, self._return, node.name)

    def _return(self, name: object, _: object) -> None:
        self._run.enter(str(name))


SHARES = {"tg_percent": "goto", "ta_percent": "avoid", "tgt_percent": "gothrough"}


def share(name: str, holders: list[str | None]) -> float:
    """The percentage of cycles of one holder among those with a holder."""
    held = [holder for holder in holders if holder is not None]
    return round(100.0 * held.count(name) / len(held), 2) if held else 0.0


def scenario_of(cell: Cell, seed: int = 0) -> Scenario:
    """The cell's scenario, with its changes; `seed` is that of a generated world.

    Raises ConfigError or UnknownNameError.
    """
    if cell.world and cell.world not in MADE:
        raise UnknownNameError("world", cell.world, MADE)
    scenario = ideal(made(cell.world, seed) if cell.world else load_scenario(cell.scenario))
    agents = (*scenario.agents, *cell.besides)
    taking = {*agents} - {*cell.without}
    competing = sum(WHEELS in agent_class(name).competes_for for name in taking)
    if cell.bidders > competing:  # the first of them; `Contest.join` adds the others
        agents += (BYSTANDER,)
    scenario = structs.replace(scenario, sensors=cell.sensors, agents=agents)
    if cell.robot is not None:
        scenario = structs.replace(scenario, robot=cell.robot)
    return prepared(scenario, options_of(cell))


def options_of(cell: Cell) -> Options:
    """The cell as options of the command line."""
    return Options(
        controller=cell.controller,
        exchange=cell.exchange,
        parameters=cell.parameters,
        sets=cell.sets,
        without=cell.without,
        coordination=cell.coordination,
        told=cell.told,
        redundant=cell.redundant,
    )


def conditions_of(cell: Cell) -> Conditions:
    """The conditions of the cell's runs; of a generated world those of seed 0."""
    found = conditions(scenario_of(cell), options_of(cell), "virtual")
    if not cell.world:
        return found
    return structs.replace(found, scenario=found.scenario | {"world": f"{cell.world} of each seed"})


def drive(task: tuple[Cell, int]) -> Sample:
    """One run, for a worker process."""
    cell, seed = task
    return Drive(cell, seed).go().sample() if cell.robots == 1 else _fleet(cell, seed)


def _fleet(cell: Cell, seed: int) -> Sample:
    """One run of several robots that share the tasks of a scenario."""
    options = replace(options_of(cell), seed=seed)
    result = FleetRehearsal(scenario_of(cell, seed), options, cell.robots).run()
    touched = [row.collisions for row in result.robots]
    clear = [row.min_clearance_m for row in result.robots if row.min_clearance_m is not None]
    done = result.done == result.tasks
    return Sample(
        cell=cell.name,
        seed=seed,
        reached=done,
        arrived=done,
        td_m=round(sum(row.way_m for row in result.robots), 3),
        fo_deg=0.0,
        tt_s=result.limit_s or 0.0 if result.makespan_s is None else round(result.makespan_s, 3),
        p_percent=round(100.0 * result.done / result.tasks, 3) if result.tasks else 0.0,
        exchanges=0,
        collisions=None if None in touched else sum(filter(None, touched)),
        min_clearance_m=min(clear, default=None),
        note="" if result.passed else result.verdict,
        contended=result.contended,
    )


def key_of(cell: Cell) -> str:
    """A hash of all that a run depends on besides seed and code: the cell and its files."""
    text = [repr(structs.replace(cell, scenario="", robot=None, parameters=None))]
    files = [("robots", cell.robot), ("parameters", cell.parameters)]
    if not cell.world:
        scenario = load_scenario(cell.scenario)
        text.append(repr(structs.replace(scenario, world="")))
        files.append(("worlds", scenario.world))
    text += [read_text(find_config(kind, name)) for kind, name in files if name is not None]
    return sha256("\0".join(text).encode()).hexdigest()[:12]


def picture(run: Drive, path: Path, caption: str) -> None:
    """Draw a run that has ended, as `armadico run` does."""
    watch, scenario = run.watch, run.scenario
    draw_run(
        load_world(scenario.world),
        Run(
            path=watch.path,
            start=watch.start or scenario.start,
            goal=watch.goal,
            body=load_profile(scenario.robot).body,
            waypoints=watch.waypoints[:-1],
            echoes=watch.echoes,
            title=f"{run.cell.name}, seed {run.seed}",
            caption=(caption,),
        ),
        path,
    )
