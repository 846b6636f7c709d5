"""One sample of a rehearsal: the virtual society drives, and what happened is written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace as alike
from math import ceil
from random import Random
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from armadico.bridge.simulator.broken import Broken
from armadico.config.profile import ModelledRobot, load_profile
from armadico.core.cycles import PERIOD
from armadico.core.judgement import Answer
from armadico.core.messages import Ballot, Command, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.launch.society import necessary
from armadico.launch.virtual import Rehearsal
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Pose, Stretch, Trajectory, Truth
from armadico.observe.measures import RunWatch
from armadico.observe.slowness import Slowness, Spot
from armadico.rehearsal.fork import Fork, draw, drawn_wheels
from armadico.rehearsal.present import LASER, SONAR
from armadico.rehearsal.sight import place
from armadico.runtime.errors import AgentFailedError, MissionRefusedError, SocietyError

PATH_S: Final = 0.4
"""Period of the points of a path, s."""

ARRIVED, FAILED, REFUSED, UNENDED = "arrived", "failed", "refused", "unended"
"""How a sample ends; `UNENDED`: it had not ended within its time, so nobody knows."""

BROKEN: Final = "broken"
"""An agent's own code raised, so nobody knows either: the real one is another process."""


PRESENT: Final = "present"
"""The publisher of the command in force when a sample begins."""

RAMP_S: Final = 1.5
"""Longest time for ramps before it: a base that stands at commands for longer counts as deaf."""


class Sample(Struct, frozen=True, kw_only=True):
    """What happened in one sample. Lengths are m, times s."""

    seed: int  # its seed
    end: str  # as `ARRIVED`
    why: str = ""  # why it did not arrive
    time_s: float = 0.0  # the time until it ended
    way_m: float = 0.0  # the length of its path
    # The least distance to an obstacle, and where the robot was; None: none was near.
    clearance: tuple[float, float, float] | None = None
    collisions: int = 0  # contacts that the robot caused
    path: tuple[tuple[float, float, float], ...] = ()  # points of its true path: time, x, y
    shares: dict[str, int] = {}  # how many cycles each agent drove
    spots: tuple[Spot, ...] = ()  # where it was slow or unsure
    # The share left at the end; None: not known, or it was not at the beginning.
    battery: float | None = None
    unseen: tuple[Stretch, ...] = ()  # the parts of its paths where nobody has seen the map
    hidden_m: float = 0.0  # how much of its path was out of sight when it began
    puts: bool = False  # whether something was to be put on its way, out of sight
    put: tuple[float, float] | None = None  # where it was put; None: nothing was

    @property
    def holds(self) -> bool:
        """Whether the map holds in it. One that has not ended might have met something yet."""
        return self.put is None and not (self.puts and self.end == UNENDED)


def sample(
    of: Fork,
    seed: int,
    over: Callable[[], bool] = lambda: False,
    *,
    patience_s: float | None = None,
) -> Sample:
    """Drive one sample of a fork; it ends early, unended, once `over` returns True.

    With `patience_s` something that no map has stands on its way, if a part of that is out of
    sight. The sample fails if it has not ended after so long: a robot may try for minutes.
    """
    puts = patience_s is not None
    if over():
        return Sample(seed=seed, end=UNENDED, why="there was no time to begin it", puts=puts)
    run = None
    try:
        run = Forked(of, seed, over, patience_s=patience_s)
        witness = Witness(run)
        run.run()
    except AgentFailedError as error:
        first, *_, last = str(error).splitlines()  # its name, and what it raised
        end, why = BROKEN, f"{first} {last.strip()}"
    except MissionRefusedError as error:
        end, why = REFUSED, error.reason
    except SocietyError as error:  # such as no agent that accepts missions: no one refuses
        end, why = FAILED, str(error)
    else:
        return replace(_told(run, witness, seed), puts=puts)
    return Sample(seed=seed, end=end, why=why, puts=puts, put=_put(run))


class Forked(Rehearsal):
    """The virtual run of a fork. The robot truly begins at a drawn pose."""

    def __init__(
        self, of: Fork, seed: int, over: Callable[[], bool], *, patience_s: float | None = None
    ) -> None:
        drawn = draw(of, seed)
        scenario = of.scenario
        if drawn.people:
            scenario = replace(scenario, moving=drawn.people)
        super().__init__(scenario, alike(of.options, seed=seed))
        self.robot.plant.set_pose(*drawn.start)
        self.robot.plant.add_walls(drawn.walls)
        plant, wheels = self.robot.plant, self.robot.plant.wheels
        for sensor in of.silent:
            readings = {SONAR: plant.sonar_readings, LASER: plant.laser_readings}
            readings[sensor].fail(Broken.SILENT)
        if of.wheels:
            wheels.miscalibrate(*drawn_wheels(of, wheels.usual, seed))
        self.cut_short = False
        self.charged = of.charged
        self.sight = of.sight
        self.put: tuple[float, float] | None = None
        self.not_past = False
        self._over, self._patience_s = over, patience_s
        if patience_s is not None:
            self._rng = Random(f"rehearsal/put/{seed}")
            self._keep_m = load_profile(scenario.robot).body.goal_room_m
            self.mesh.watch(self._on_way, Trajectory, namespace=self.namespace)
        self._kills = sorted(of.kills, key=lambda kill: kill[1])
        self._speeds = of.speeds

    def begin(self) -> float:
        """See `Run`. The robot moves already, as the present one."""
        if any(self._speeds):
            self._set_off()
        return super().begin()

    def _set_off(self) -> None:
        """Let the robot move, with a command in force: without one its agent would order rest.

        A command comes between two reports, since the next report of wheels that turn without one
        is answered by rest. It offers the wheels to any bid, and expires as every command does. The
        agent of a base that receives speeds sends it ramps that begin at rest. So this base is held
        until they are through.
        """
        profile, plant = load_profile(self.scenario.robot), self.robot.plant
        (v, w), limits, cycle_s = self._speeds, profile.limits, profile.cycle_s
        plant.jammed = isinstance(profile, ModelledRobot)
        ramp_s = max(abs(v) / limits.v_accel, abs(w) / limits.w_accel) if plant.jammed else 0.0
        # As measured they may exceed the limits, and the command would be refused.
        v, w = max(-limits.v_max, min(v, limits.v_max)), max(-limits.w_max, min(w, limits.w_max))
        ballot = Ballot(1, 0.0, critical=False, instance=PRESENT)
        for held in reversed(range(1 + ceil(min(ramp_s, RAMP_S) / cycle_s))):
            self._next_report(2.0 * cycle_s)
            if not held:
                plant.jammed = False
                self.robot.set_speeds(*self._speeds)
            self.mesh.run(self.mesh.now + 0.5 * cycle_s)
            state = self.watch.view.state
            if state is not None:
                self._publish(Command(WHEELS.name, state.cycle, ballot, (v, w)))

    def _next_report(self, within_s: float) -> None:
        before = self.watch.view.state
        self.mesh.run(self.mesh.now + within_s, lambda: self.watch.view.state is not before)

    def _on_way(self, _key: str, way: Message, _now: float) -> None:
        """Put something on the first way that is planned."""
        if self.put is not None or not isinstance(way, Trajectory) or not way.waypoints:
            return
        points = [self.robot.plant.pose[:2], *((each.x, each.y) for each in way.waypoints)]
        found = place(points, self.sight, self._keep_m, self._rng)
        if found is not None:
            self.put, walls = found
            self.robot.plant.add_walls(walls)

    def goes_on(self, elapsed: float) -> bool:
        """See `Run`. Kills what is to be killed by then."""
        while self._kills and self._kills[0][1] <= elapsed:
            name, _ = self._kills.pop(0)
            for node in self.mesh.nodes:
                if node.name == name and node.alive:
                    node.kill()
        most = self._patience_s
        self.not_past = self.put is not None and most is not None and elapsed > most
        self.cut_short = self._over()
        return super().goes_on(elapsed) and not (self.cut_short or self.not_past)


class Witness:
    """Watches a sample: its path, its clearance, and where it was slow or unsure."""

    def __init__(self, run: Forked) -> None:
        self._watch: RunWatch = run.watch
        self._goal = run.scenario.goal
        self._here: Pose2 | None = None
        self._start: Pose2 | None = None
        self._deviation = 0.0
        self.path: list[tuple[float, float, float]] = []
        self.clearance: tuple[float, float, float] | None = None
        self.slow = Slowness()
        run.mesh.watch(self._on_message, Truth, RobotState, Pose, namespace=run.namespace)

    def _on_message(self, _key: str, message: Message, _now: float) -> None:
        if not self._watch.begun or self._watch.done:
            return
        match message:
            case Truth():
                self._on_truth(message)
            case Pose():
                self._deviation = message.deviation
            case RobotState():
                self._on_state(message)

    def _on_truth(self, truth: Truth) -> None:
        self._here = truth.x, truth.y, truth.theta
        self._start = self._start or self._here
        if not self.path or truth.t - self.path[-1][0] >= PATH_S - 1e-6:
            self.path.append((truth.t, truth.x, truth.y))
        if truth.clearance is not None and (
            self.clearance is None or truth.clearance < self.clearance[0]
        ):
            self.clearance = truth.clearance, truth.x, truth.y

    def _on_state(self, state: RobotState) -> None:
        here, view = self._here, self._watch.view
        if here is None:
            return
        ends = [end[:2] for end in (self._start, self._goal) if end is not None]
        cycle = PERIOD if view.description is None else view.description.cycle_s
        self.slow.update(
            here[:2], ends, state, view.mission, deviation=self._deviation, cycle_s=cycle
        )


def _told(run: Forked, witness: Witness, seed: int) -> Sample:
    watch, result = run.watch, run.watch.result()
    end, why = ARRIVED, ""
    if run.not_past and not watch.done:
        end, why = FAILED, "not past it"
    elif run.cut_short and not watch.done:
        end, why = UNENDED, f"not ended after {result.tt_s:.0f} s of its own time"
    elif result.judgement.answer is Answer.UNKNOWN:
        end, why = UNENDED, result.judgement.reason
    elif not result.passed:
        missing = [name for name in necessary(run.scenario) if name not in run.names]
        without = f" without {', '.join(missing)}, which the task needs" if missing else ""
        end, why = FAILED, f"{result.judgement.reason}{without}"
    began = witness.path[0][0] if witness.path else 0.0
    level = watch.view.level
    return Sample(
        seed=seed,
        end=end,
        why=why,
        time_s=result.tt_s,
        way_m=result.td_m,
        clearance=_rounded(witness.clearance),
        collisions=result.collisions or 0,
        path=tuple((round(t - began, 1), round(x, 2), round(y, 2)) for t, x, y in witness.path),
        shares={name: n for name, n in watch.holders.cycles.items() if name != PRESENT},
        spots=witness.slow.spots,
        battery=None if level is None or not run.charged else level.share,
        unseen=tuple(watch.unseen),
        hidden_m=round(run.sight.hidden([(x, y) for _, x, y in witness.path]), 2),
        put=_put(run),
    )


def _put(run: Forked | None) -> tuple[float, float] | None:
    if run is None or run.put is None:
        return None
    return round(run.put[0], 2), round(run.put[1], 2)


def _rounded(at: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    return at and (round(at[0], 3), round(at[1], 2), round(at[2], 2))
