"""Runs from Python, for notebooks and tests: `armadico.run` and its result."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, update_wrapper
from inspect import Parameter, Signature, signature
from io import BytesIO
from math import inf
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Concatenate, Final, NamedTuple, ParamSpec, TypeGuard

from armadico.config.scenarios import Scenario, load_scenario
from armadico.core.agent import Agent
from armadico.core.discovery import PICTURES, installed
from armadico.launch.options import Choices, Options
from armadico.launch.society import prepared
from armadico.mesh.topology import several
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import OccupancyGrid
from armadico.observe.measures import Mark, Result, RunWatch

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

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
        _drawing()(self, file)
        return Path(file)


@dataclass(frozen=True, kw_only=True)
class Call(Choices):
    """The keyword arguments of `run`: the options of a run, and those that only Python has."""

    joins: Sequence[type[Agent]] = ()
    namespace: str | None = None
    connect: str | Sequence[str] = ()
    progress: Callable[[RunWatch], None] | None = None
    show: bool = False


P = ParamSpec("P")
Given = str | Path | Scenario


def _keywords(
    made: Callable[P, Call],
) -> Callable[[Callable[[Given, Call], Run]], Callable[Concatenate[Given, P], Run]]:
    """Give a function the fields of `Call` as keyword arguments, for type checkers as well."""

    def decorate(run: Callable[[Given, Call], Run]) -> Callable[Concatenate[Given, P], Run]:
        def called(scenario: Given, *args: P.args, **options: P.kwargs) -> Run:
            return run(scenario, made(*args, **options))

        update_wrapper(called, run)
        first = Parameter("scenario", Parameter.POSITIONAL_OR_KEYWORD, annotation=Given)
        fields = signature(made).parameters.values()
        called.__signature__ = Signature((first, *fields))  # type: ignore[attr-defined]
        return called  # type: ignore[return-value] # `scenario` can also be a keyword

    return decorate


@_keywords(Call)
def run(scenario: Given, call: Call) -> Run:
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

    `scenario` is a shipped scenario's name, a TOML file, or a `Scenario`. The fields of `Call` are
    keyword arguments:

    Options:
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
        coordination: The mechanism that decides which agent drives; by default ballots.
        told: With an arbiter, what an agent is told of its share: award, yes or no.
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
    if call.virtual and (call.robot or call.namespace or call.connect):
        raise ValueError("robot, namespace and connect are for live runs; leave out virtual=True")
    if call.joins and not call.virtual:
        raise ValueError("joins is for virtual runs; processes are found by their entry points")
    _check_types(
        **{name: getattr(call, name) for name in ("seed", "limit", "start", "goal", "joins")}
    )
    display = _display() if call.show else None
    given = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    options = Options.of(call, given.seed if call.seed is None else call.seed)
    chosen = prepared(given, options, start=call.start, goal=call.goal, profile=call.profile)
    warnings: list[str] = []
    if call.virtual:
        from armadico.launch.virtual import Rehearsal

        rehearsal = Rehearsal(chosen, options)
        for kind in call.joins:
            rehearsal.add(kind)
        rehearsal.run(call.progress, warnings.append)
        return _shown(Run.of(chosen, rehearsal.watch, warnings), display)
    from armadico.launch.client import connect
    from armadico.launch.local import Launcher

    joining = [word for endpoint in several(call.connect) for word in ("--connect", endpoint)]
    with (
        connect(call.namespace, connect=call.connect) as guest,
        Launcher(chosen, options, guest.mesh, guest.mesh.namespace, joining=joining) as live,
    ):
        live.run(call.progress, warnings.append)
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


def _drawing() -> Callable[..., None]:
    """What draws a run. Raises ImportError if it is not installed."""
    found = installed(PICTURES).get("run")
    if found is None:
        raise ImportError(f"no installed package draws a run ({PICTURES})")
    draw: Callable[..., None] = found.load()
    return draw


def _display() -> Callable[..., object]:
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


def _shown(run: Run, display: Callable[..., object] | None) -> Run:
    if display is not None:
        drawn = BytesIO()
        _drawing()(run, drawn)
        display({"image/png": drawn.getvalue()}, raw=True)
    return run
