"""Runs from Python, for notebooks and tests: `armadico.run` and its result."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from math import inf
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, TypeGuard

from armadico.config.scenarios import Scenario, load_scenario
from armadico.core.agent import Agent
from armadico.launch.society import Options, prepared
from armadico.mesh.topology import several
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import OccupancyGrid
from armadico.observe.measures import Mark, Result, RunWatch

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from armadico.watch.pictures import Run as Picture


SEEDS: Final = 2**63
"""Seeds are smaller than this."""


class Holding(NamedTuple):
    """An interval in which one agent drove, s since the run began.

    Attributes:
        agent: The name of the agent.
        start: The first command that was obeyed.
        end: The first moment when another agent or no agent drove.
    """

    agent: str
    start: float
    end: float


@dataclass(frozen=True)
class Run:
    """One finished run.

    Attributes:
        scenario: The scenario.
        measures: The measures of thesis 5.1, whether the goal was reached, and collisions.
        marks: For each cycle the time, the pose (the true one if known) and the obeyed agent.
        waypoints: The trajectory, the goal last: x, y in m and a heading in rad.
        echoes: The points of sonar echoes in the world, m.
        warnings: Warnings of the run, one line each.
        grid: The map of the mapping agent, if it took part.
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
        watched = (tuple(watch.path), watch.waypoints, tuple(watch.echoes))
        return cls(scenario, watch.result(), *watched, tuple(warnings), watch.grid)

    @cached_property
    def times(self) -> NDArray[np.float64]:
        """The time of each pose of `path`, s since the run began."""
        import numpy as np

        return np.array([mark.t - self.marks[0].t for mark in self.marks])

    @cached_property
    def path(self) -> NDArray[np.float64]:
        """The poses in the world, (n, 3): x and y in m, the heading in rad."""
        import numpy as np

        return np.array([(m.x, m.y, m.theta) for m in self.marks]).reshape(-1, 3)

    @cached_property
    def holders(self) -> tuple[Holding, ...]:
        """The driving agents in order; between two holdings there may be a gap."""
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
        """Draw the world and the path, coloured by driving agent, as a PNG; returns the file.

        Raises ImportError without matplotlib (`pip install 'armadico[plot]'`), and OSError.
        """
        self._draw(file)
        return Path(file)

    def animate(self, file: str | Path, *, speed: float | None = None) -> Path:
        """Write a film of the robot and its path; returns the file.

        Args:
            file: A .gif, or an .mp4 if ffmpeg is on the path.
            speed: Factor to real time; by default the film takes 12 s.

        Raises:
            ValueError: A file of another kind, or an invalid speed.
            OSError: The file cannot be written, or ffmpeg is missing.
            ImportError: matplotlib is missing (`pip install 'armadico[plot]'`).
        """
        from armadico.config.worlds import load_world
        from armadico.watch.films import film_run

        film_run(load_world(self.scenario.world), self._picture(), file, speed)
        return Path(file)

    def _draw(self, out: str | Path | BinaryIO) -> None:
        from armadico.config.worlds import load_world
        from armadico.watch.pictures import draw_run

        draw_run(load_world(self.scenario.world), self._picture(), out)

    def _picture(self) -> Picture:
        from armadico.config.grid_map import cells_of
        from armadico.config.profile import load_profile
        from armadico.watch.pictures import Run as Picture

        mapped = None
        if self.grid is not None:
            with suppress(ValueError):  # the published map may be invalid
                mapped = cells_of(self.grid)
        goal = self.scenario.goal
        first = self.marks[0] if self.marks else None
        return Picture(
            path=self.marks,
            start=self.scenario.start if first is None else (first.x, first.y, first.theta),
            goal=goal,
            body=load_profile(self.scenario.robot).body,
            waypoints=self.waypoints[:-1] if self.grid is None else (),  # exploring has many
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
    simulator: str = "",
    namespace: str | None = None,
    connect: str | Sequence[str] = (),
    progress: Callable[[RunWatch], None] | None = None,
    show: bool = False,
) -> Run:
    """Drive one scenario from start to goal, as `armadico run` does, without output.

        done = armadico.run("sc4", virtual=True, seed=7)
        done.measures.reached, done.measures.tt_s      # True, and the time it took in s
        done.path                                      # x, y, theta: m, m, rad; a row a cycle
        [(h.agent, h.end - h.start) for h in done.holders]

    A virtual run has the whole society in this process under a virtual clock, and the same seed
    gives the same run. Otherwise the simulator and every agent are processes on this machine. They
    are ended at the end of the run, also after an error.

    A goal that is not reached is not an error: `measures.reached` is False. It is None if nobody
    knows, as on a real robot. `measures.judgement` is yes, no or unknown, with the reason.

    Args:
        scenario: A shipped scenario's name, a TOML file, or a `Scenario`.
        virtual: Under a virtual clock, or as processes.
        seed: Seed of random numbers; by default the scenario's.
        start: Start pose (x, y, theta) in m, m, rad; by default the scenario's.
        goal: Goal pose, likewise.
        limit: Time limit, s; by default 5 times the path length at 0.3 m/s, at least 60 s.
        without: Agents to leave out: a name, or several.
        besides: Installed agents to add, likewise.
        sensors: Sensors of the simulated robot, real or ideal; by default the scenario's. With
            ideal sensors the localization agents are left out.
        redundant: Two of each behaviour.
        joins: Agent classes that take part in a virtual run, installed or not.
        controller: Goto's: fast, precise, collaborative or brisk.
        exchange: How resources change hands: smooth or abrupt.
        parameters: A set of agents' parameters: thesis, brisk, or a TOML file.
        profile: The robot's profile: a shipped name, or a TOML file.
        robot: The address of a real robot, serial:// or tcp://; None: a simulator.
        simulator: The id of a simulator that is at this address; "": there is none.
        namespace: The robot's subtree of keys; by default $ARMADICO_NAMESPACE, or robot1.
        connect: Endpoints by which the processes connect; by default this machine's own.
        progress: Called regularly with the state of the run.
        show: Draw the run below the cell of a notebook at the end.

    Raises:
        ConfigError: The scenario cannot be used, with file and line; or a pose is invalid, or its
            heading is not in rad.
        UnknownNameError: An agent is not installed.
        AgentFailedError: An agent's own code raised in a virtual run; with file and line.
        MissionRefusedError: There is no path, or the robot's pose is not known.
        AbsentError: No agent that accepts missions is alive.
        RunFailedError: A process did not start, or the robot is silent; with its last log lines.
        MeshError: The mesh cannot be joined.
        TopologyError: An invalid namespace or endpoint.
        TypeError: A seed, limit, pose or agent class of another type.
        ValueError: An invalid seed or limit; `robot`, `namespace` or `connect` in a virtual run;
            `joins` in another one; `show` outside a notebook.
        ImportError: `show` without matplotlib (`pip install 'armadico[plot]'`).
    """
    if virtual and (robot or namespace or connect):
        raise ValueError("robot, namespace and connect are for live runs; leave out virtual=True")
    if joins and not virtual:
        raise ValueError("joins is for virtual runs; processes are found by their entry points")
    _check_types(seed=seed, limit=limit, start=start, goal=goal, joins=joins)
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
        simulator=simulator,
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
    from armadico.launch.client import connect as joined
    from armadico.launch.local import Launcher

    joining = [word for endpoint in several(connect) for word in ("--connect", endpoint)]
    with (
        joined(namespace, connect=connect) as guest,
        Launcher(chosen, options, guest.mesh, guest.mesh.namespace, joining=joining) as live,
    ):
        live.run(progress, warnings.append)
    return _shown(Run.of(chosen, live.watch, warnings), display)


def _check_types(
    *, seed: object, limit: object, start: object, goal: object, joins: object
) -> None:
    """Raises TypeError or ValueError that names the argument, its value and what is right."""
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, Integral)):
        raise TypeError(f"seed={seed!r}: expected an integer, such as 7")
    if isinstance(seed, Integral) and not 0 <= int(seed) < SEEDS:
        raise ValueError(f"seed={seed!r}: expected 0 to 2^63 - 1")
    if limit is not None:
        if not _is_number(limit):
            raise TypeError(f"limit={limit!r}: expected a number of seconds, such as 60")
        if not 0.0 < limit < inf:
            raise ValueError(f"limit={limit!r}: expected more than 0 seconds, and finite")
    for name, pose in (("start", start), ("goal", goal)):
        if pose is None:
            continue
        parts = () if isinstance(pose, str) or not isinstance(pose, Iterable) else tuple(pose)
        if parts == () or not all(map(_is_number, parts)):
            raise TypeError(
                f"{name}={pose!r}: expected three numbers (x, y, theta) in m, m, rad, such as"
                " (1.0, 2.0, 0.0)"
            )
    kinds = joins if isinstance(joins, Iterable) and not isinstance(joins, str) else (joins,)
    for kind in kinds:
        if not (isinstance(kind, type) and issubclass(kind, Agent)):
            raise TypeError(
                f"joins={joins!r}: expected agent classes, such as [Wanderer], not {kind!r}; an"
                " installed agent is added by its name with besides"
            )


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, Real) and not isinstance(value, bool)


def _display() -> Callable[..., Any]:
    """IPython's function that displays below a cell; checked before the robot moves.

    Raises ValueError outside a notebook, and ImportError without matplotlib.
    """
    # IPython in a terminal has no kernel and shows no pictures.
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if not hasattr(shell, "kernel"):
        raise ValueError("show needs a notebook; elsewhere call plot('run.png') of the result")
    import matplotlib as _  # noqa: F401 - an extra
    from IPython.display import display

    return display


def _shown(run: Run, display: Callable[..., Any] | None) -> Run:
    if display is not None:
        drawn = BytesIO()
        run._draw(drawn)
        display({"image/png": drawn.getvalue()}, raw=True)
    return run
