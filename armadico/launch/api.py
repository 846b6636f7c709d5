"""A run from Python, for notebooks and tests: `armadico.run` and what it gives back."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from armadico.config.scenarios import Scenario, load_scenario
from armadico.launch.society import Options, prepared
from armadico.mesh.topology import several
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import OccupancyGrid
from armadico.observe.measures import Mark, Result, RunWatch

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from armadico.core.agent import Agent
    from armadico.observe.pictures import Run as Picture


class Holding(NamedTuple):
    """For how long one agent was obeyed without a break, in s since the run began.

    Attributes:
        agent: Who drove.
        start: When it began to.
        end: When another took over, or nobody drove.
    """

    agent: str
    start: float
    end: float


@dataclass(frozen=True)
class Run:
    """One run that is over.

    Attributes:
        scenario: What was driven.
        measures: The measures of thesis 5.1, and whether the goal was reached and what was touched.
        marks: Each cycle: when, where (the true pose if it is known), and who was obeyed.
        waypoints: The trajectory, the goal last: x, y in m and a heading in rad.
        echoes: Where the sonars heard something, m, in the world.
        warnings: What went wrong meanwhile, in lines for people.
        grid: The map made by driving, if a mapping agent took part.
    """

    scenario: Scenario
    measures: Result
    marks: tuple[Mark, ...] = field(repr=False)
    waypoints: tuple[Pose2, ...] = field(repr=False)
    echoes: tuple[tuple[float, float], ...] = field(repr=False)
    warnings: tuple[str, ...] = ()
    grid: OccupancyGrid | None = field(default=None, repr=False)

    @classmethod
    def of(cls, scenario: Scenario, watch: RunWatch, warnings: Sequence[str] = ()) -> Run:
        """What a watch has seen."""
        seen = (tuple(watch.path), watch.waypoints, tuple(watch.echoes))
        return cls(scenario, watch.result(), *seen, tuple(warnings), watch.grid)

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """When each pose of `path` was, in s since the run began."""
        import numpy as np

        return np.array([mark.t - self.marks[0].t for mark in self.marks])

    @cached_property
    def path(self) -> NDArray[np.float64]:
        """The poses, a row each: x and y in m, the heading in rad, in the world."""
        import numpy as np

        return np.array([(m.x, m.y, m.theta) for m in self.marks]).reshape(-1, 3)

    @cached_property
    def holders(self) -> tuple[Holding, ...]:
        """Who drove when, in order; between two holdings nobody may have been obeyed."""
        found: list[Holding] = []
        before: str | None = None
        for mark in self.marks:
            at = mark.t - self.marks[0].t
            if before is not None:
                found[-1] = found[-1]._replace(end=at)
            if mark.holder not in (None, before):
                found.append(Holding(str(mark.holder), at, at))
            before = mark.holder
        return tuple(found)

    def plot(self, file: str | Path) -> Path:
        """Draw the world and the path in it, coloured by who drove, as a PNG; returns its path.

        Raises ImportError without matplotlib (`pip install 'armadico[plot]'`), and OSError.
        """
        self._draw(file)
        return Path(file)

    def animate(self, file: str | Path, *, speed: float | None = None) -> Path:
        """Film the run: the robot drives again, and leaves its path behind it; returns its path.

        Args:
            file: A .gif, or an .mp4 where ffmpeg is on the path.
            speed: How many times as fast as it happened; by default a film takes 12 s.

        Raises:
            ValueError: A file of another kind, or a speed that is none.
            OSError: The file cannot be written; of an .mp4, there is no ffmpeg.
            ImportError: There is no matplotlib (`pip install 'armadico[plot]'`).
        """
        from armadico.config.worlds import load_world
        from armadico.observe.films import film_run

        film_run(load_world(self.scenario.world), self._picture(), file, speed)
        return Path(file)

    def _draw(self, out: str | Path | BinaryIO) -> None:
        from armadico.config.worlds import load_world
        from armadico.observe.pictures import draw_run

        draw_run(load_world(self.scenario.world), self._picture(), out)

    def _picture(self) -> Picture:
        from armadico.config.grid_map import cells_of
        from armadico.config.profile import load_profile
        from armadico.observe.pictures import Run as Picture

        mapped = None
        if self.grid is not None:
            with suppress(ValueError):  # what came on the mesh may be no map
                mapped = cells_of(self.grid)
        goal = self.scenario.goal
        first = self.marks[0] if self.marks else None
        return Picture(
            path=self.marks,
            start=self.scenario.start if first is None else (first.x, first.y, first.theta),
            goal=goal,
            body=load_profile(self.scenario.robot).body,
            waypoints=self.waypoints[:-1] if self.grid is None else (),  # else the last of many
            echoes=self.echoes,
            title=f"{self.scenario.title or self.scenario.name} (seed {self.measures.seed})",
            caption=(self.measures.verdict,),
            mapped=mapped,
        )


def run(
    scenario: str | Path | Scenario,
    *,
    virtual: bool = False,
    seed: int | None = None,
    start: Pose2 | None = None,
    goal: Pose2 | None = None,
    limit: float | None = None,
    without: str | Sequence[str] = (),
    besides: str | Sequence[str] = (),
    sensors: str | None = None,
    redundant: bool = False,
    joins: Sequence[type[Agent]] = (),
    controller: str | None = None,
    exchange: str | None = None,
    parameters: str | None = None,
    profile: str | None = None,
    robot: str | None = None,
    namespace: str | None = None,
    connect: str | Sequence[str] = (),
    progress: Callable[[RunWatch], None] | None = None,
    show: bool = False,
) -> Run:
    """Drive one scenario from start to goal; what `armadico run` does, without a word.

        done = armadico.run("sc4", virtual=True, seed=7)
        done.measures.reached, done.measures.tt_s      # True, and the time it took in s
        done.path                                      # x, y, theta: m, m, rad; a row a cycle
        [(h.agent, h.end - h.start) for h in done.holders]

    Virtual, the whole society is in this process under a virtual clock, and the same seed gives the
    same run. Otherwise simulator, robot agent and every agent are processes of their own on this
    machine; it takes as long as it takes, and however it ends they are taken down.

    A goal that is not reached is no error: `measures.reached` says so.

    Args:
        scenario: A shipped scenario's name, a TOML file, or a `Scenario`.
        virtual: Under a virtual clock, or as processes.
        seed: Of all that is random; by default the scenario's.
        start: Pose to start from (x, y, theta) in m, m, rad; by default the scenario's.
        goal: Pose to drive to, likewise; without any, the robot is sent nowhere.
        limit: How long it may take, s; by default 5 times the way over 0.3 m/s, at least 60 s.
        without: Agents that take no part: a name, or several.
        besides: Agents that take part, too, likewise; installed.
        sensors: How well the simulated robot senses, real or ideal (by default as the scenario
            says). With ideal ones the localization agents take no part.
        redundant: Two of each behaviour, whatever the scenario says.
        joins: Classes of yours that take part too, installed or not; in virtual runs.
        controller: Goto's: fast, precise, collaborative or brisk.
        exchange: How resources change hands: smooth or abrupt.
        parameters: A set of agents' parameters: thesis, brisk, or a TOML file.
        profile: The make of robot: a shipped profile's name, or a TOML file.
        robot: The URL of a robot that is there already, serial:// or tcp://; none: a simulator.
        namespace: The robot's subtree of keys; by default $ARMADICO_NAMESPACE, or robot1.
        connect: Endpoints by which the processes find one another; by default this machine's own.
        progress: Called now and then with what has been seen so far.
        show: Draw it below the cell of a notebook, when it is over.

    Raises:
        ConfigError: The scenario, or something in it, cannot be used; the text has file and line.
            Also a pose that has not three numbers, or whose heading is not in rad.
        UnknownNameError: No such agent is installed.
        AgentFailedError: An agent's own code raised, in a virtual run; with file and line.
        MissionRefusedError: There is no way, or the robot's pose is not known.
        AbsentError: No agent that takes missions is alive.
        RunFailedError: A process did not start, or the robot is silent; with its last log lines.
        MeshError: The mesh cannot be joined.
        TopologyError: A namespace or an endpoint that cannot be one.
        ValueError: A limit that is none; `robot`, `namespace` or `connect` for a virtual run;
            `joins` for another, where an agent is a process, found by its entry point; `show`
            elsewhere than in a notebook.
        ImportError: `show` without matplotlib (`pip install 'armadico[plot]'`).
    """
    if virtual and (robot or namespace or connect):
        raise ValueError("robot, namespace and connect are for what is really there, not virtual")
    if joins and not virtual:
        raise ValueError("joins is for virtual runs; processes are found by their entry points")
    if limit is not None and not 0.0 < limit < inf:
        raise ValueError(f"limit {limit:g}: expected seconds, more than none")
    display = _display() if show else None
    given = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    options = Options(
        seed=given.seed if seed is None else seed,
        controller=controller,
        exchange=exchange,
        parameters=parameters,
        limit=limit,
        without=several(without),
        besides=several(besides),
        sensors=sensors,
        redundant=redundant,
        robot=robot,
    )
    chosen = prepared(
        given,
        options,
        start=start,
        goal=goal,
        profile=profile,
    )
    warnings: list[str] = []
    if virtual:
        from armadico.launch.virtual import Rehearsal

        rehearsal = Rehearsal(chosen, options)
        for kind in joins:
            rehearsal.add(kind)
        rehearsal.run(progress, warnings.append)
        return _shown(Run.of(chosen, rehearsal.watch, warnings), display)
    from armadico.launch.local import Launcher
    from armadico.runtime.client import connect as joined

    joining = [word for endpoint in several(connect) for word in ("--connect", endpoint)]
    with (
        joined(namespace, connect=connect) as guest,
        Launcher(chosen, options, guest.mesh, guest.mesh.namespace, joining=joining) as live,
    ):
        live.run(progress, warnings.append)
    return _shown(Run.of(chosen, live.watch, warnings), display)


def _display() -> Callable[..., Any]:
    """What draws below a notebook's cell; it is asked for before the robot moves.

    Raises ValueError where there is no notebook, and ImportError where nothing can draw.
    """
    # A terminal's IPython has no kernel, and shows no pictures.
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if not hasattr(shell, "kernel"):
        raise ValueError("show draws in a notebook; elsewhere: plot('run.png') of what run returns")
    import matplotlib as _  # noqa: F401 - an extra
    from IPython.display import display

    return display


def _shown(run: Run, display: Callable[..., Any] | None) -> Run:
    if display is not None:
        drawn = BytesIO()
        run._draw(drawn)
        display({"image/png": drawn.getvalue()}, raw=True)
    return run
