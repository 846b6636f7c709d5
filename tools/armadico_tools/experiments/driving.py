"""One run of an experiment: from a cell of its table and a seed to a row.

**Stop rule.** The clock starts with the first cycle after the mission is accepted and stops when
the interface agent reports the goal as reached: its pose within 0.12 m and 4 degrees, wheels at
rest. The fast controller does not turn to the goal's heading. So its runs stop when the robot has
rested for 2 s within 0.15 m of the goal; TT ends at the begin of that rest. Other runs end at their
time limit (5 times the way over 0.3 m/s), or when the robot has stayed within 1 m of one place for
60 s.
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from math import degrees, hypot
from pathlib import Path
from statistics import median
from typing import Any

from msgspec import Struct, structs

from armadico.config.loading import read_text
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario, ideal, load_scenario, society
from armadico.config.shipped import find as find_config
from armadico.config.worlds import load_world
from armadico.core.judgement import Answer
from armadico.core.messages import Message
from armadico.launch.society import Options, conditions, names
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose, Truth
from armadico.observe.conditions import Conditions
from armadico.observe.measures import REACHED_M, RunWatch
from armadico.runtime.errors import MissionRefusedError, RunFailedError
from armadico.watch.pictures import Run, draw_run

REST_S = 2.0
REST_M_S, REST_RAD_S = 0.01, 0.02
"""True speeds below which the wheels are at rest: the interface agent's own limits."""

STUCK_S, STUCK_M = 60.0, 1.0
"""A robot that has not left a circle of this radius for this time is stuck."""

LOCALIZING = society().ideal.without
"""Agents that take part only if a cell says so: the thesis had no localization."""


class Cell(Struct, frozen=True, forbid_unknown_fields=True):
    """One cell of a table: a scenario and its changes.

    By default sensors have no error and there is no localization, as in the thesis's tables.
    """

    name: str
    scenario: str  # name of a shipped one, or a file
    controller: str | None = None
    exchange: str | None = None
    parameters: str | None = None
    without: tuple[str, ...] = ()
    besides: tuple[str, ...] = ()
    sensors: str = "ideal"
    robot: str | None = None


class Sample(Struct, frozen=True):
    """One run: measures of `observe.measures.Result`, errors of the pose, and a note.

    `arrived` is by the true position alone, within 0.15 m; `reached` requires the heading too.
    `believed_p_percent` is P by the encoders' pose.
    """

    cell: str
    seed: int
    reached: bool
    arrived: bool
    td_m: float
    fo_deg: float
    tt_s: float
    p_percent: float
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


def counted(count: int | None) -> int:
    """A number of contacts. Raises RunFailedError if it is not known: 0 would be a good result."""
    if count is None:
        raise RunFailedError("contacts are not known: no truth of the robot was received")
    return count


Samples = dict[str, list[Sample]]
"""Runs by the name of their cell, in the order of seeds."""


class Drive:
    """One run on the virtual mesh."""

    def __init__(self, cell: Cell, seed: int) -> None:
        self.cell, self.seed = cell, seed
        self.scenario = scenario_of(cell)
        self.rehearsal = Rehearsal(self.scenario, self._options())
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
            self.rehearsal.start()
            self.rehearsal.begin()
        except MissionRefusedError as error:
            self.refused = error.reason
            return self
        mesh.run(mesh.now + self.rehearsal.limit, self._over)
        return self

    def _tick(self, truth: Message) -> None:
        assert isinstance(truth, Truth)
        if not self.watch.mission or self.watch.done:
            return
        self.ticks.append((truth, self.watch.holder))
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
        result = structs.asdict(self.watch.result())
        shares: dict[str, float] = dict(result["shares"])
        row = {
            field: value
            for field, value in result.items()
            if field in Sample.__struct_fields__ and field not in ("seed", "arrived")
        }
        row["reached"] = result["reached"] is True  # unknown does not count; the note has why
        resting = self._parked()
        if resting and self._rests_since is not None:
            row["tt_s"] = round(self._rests_since - self.ticks[0][0].t, 3)
            holders = [holder for truth, holder in self.ticks if truth.t <= self._rests_since]
            shares = {name: share(name, holders) for name in SHARES.values()}
        row |= {field: shares.get(n, 0.0) for field, n in SHARES.items() if n in self._taking}
        return Sample(
            cell=self.cell.name,
            seed=self.seed,
            arrived=((self.watch.done and not self.watch.failed) or resting) and self._at_goal(),
            believed_p_percent=self._believed(),
            note=self._note(resting),
            **self._pose_errors(),
            **row,
        )

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
            return ""
        return "stuck" if self._stuck() else "time limit"

    def _believed(self) -> float | None:
        pose, start, goal = self.watch.view.pose, self.watch.start, self.watch.goal
        if pose is None or start is None or goal is None:
            return None
        straight = hypot(goal[0] - start[0], goal[1] - start[1])
        off = hypot(goal[0] - pose.x, goal[1] - pose.y)
        return round(100.0 * (1.0 - off / straight), 3) if straight else None

    def _over(self) -> bool:
        return self.watch.done or self._parked() or self._stuck()

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
        return replace(options_of(self.cell), seed=self.seed)


SHARES = {"tg_percent": "goto", "ta_percent": "avoid", "tgt_percent": "gothrough"}


def share(name: str, holders: list[str | None]) -> float:
    """The percentage of cycles of one holder among those with a holder."""
    held = [holder for holder in holders if holder is not None]
    return round(100.0 * held.count(name) / len(held), 2) if held else 0.0


def scenario_of(cell: Cell) -> Scenario:
    """The cell's scenario, with its changes."""
    scenario = ideal(load_scenario(cell.scenario))
    agents = (*scenario.agents, *cell.besides)
    scenario = structs.replace(scenario, sensors=cell.sensors, agents=agents)
    if cell.robot is not None:
        scenario = structs.replace(scenario, robot=cell.robot)
    return scenario


def options_of(cell: Cell) -> Options:
    """The cell as options of the command line."""
    return Options(
        controller=cell.controller,
        exchange=cell.exchange,
        parameters=cell.parameters,
        without=cell.without,
    )


def conditions_of(cell: Cell) -> Conditions:
    """The conditions of the cell's runs."""
    return conditions(scenario_of(cell), options_of(cell), "virtual")


def drive(task: tuple[Cell, int]) -> Sample:
    """One run, for a worker process."""
    cell, seed = task
    return Drive(cell, seed).go().sample()


def key_of(cell: Cell) -> str:
    """A hash of all that a run depends on besides seed and code: the cell and its files."""
    scenario = load_scenario(cell.scenario)
    text = [repr(structs.replace(cell, scenario="", robot=None, parameters=None))]
    text.append(repr(structs.replace(scenario, world="")))
    files = (("worlds", scenario.world), ("robots", cell.robot), ("parameters", cell.parameters))
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
