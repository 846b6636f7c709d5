"""Figure 4.15: the speed loops' response to set-points, and what scaling the voltages is good for.

The robot stands on a free floor and gets each set-point at once, without the controller's ramps.
It settles when v and w stay within 5 % of what was asked of them for good; overshoot is of the
component that was asked for and exceeds it most.

S- and T-approximation (scaling and truncating) can stand in two places: at the motors' voltages,
where the thesis has them, and at the set-points, where the rims' speeds are kept to what the robot
can do. Both are tried on `runs` random set-points that the outer rim cannot reach, as pairs. The
heading error is the angle between the heading reached and that of the circle asked for, after the
same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, degrees, inf, sin
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.dynamics import Dynamics
from armadico.bridge.simulator.speed_loops import (
    Approximation,
    SpeedLoops,
    scaled,
    truncated,
)
from armadico.config.loading import find, load

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Figure 4.15: the speed controllers, and S- against T-approximation"

ROBOT: Final = "pioneer-2dx"
STEP_S: Final = 0.005
SECONDS: Final = 4.0
BAND: Final = 0.05
SUPPLY_SHARE: Final = 0.98
"""A voltage above this share of the supply counts as saturated."""

Speeds = tuple[float, float]

KINDS: Final[dict[str, tuple[Speeds, ...]]] = {
    "linear": ((0.3, 0.0), (0.6, 0.0), (1.0, 0.0), (1.4, 0.0)),
    "angular": ((0.0, 0.5), (0.0, 1.0), (0.0, 2.0), (0.0, 4.0)),
    "coupled": ((0.3, 0.5), (0.5, 1.0), (1.0, 1.0), (1.0, 2.0), (1.4, 2.0)),
}
"""The thesis does not print its set-points: these go to 90 % of what the supply can hold."""

WAY_M: Final = 3.0
"""The heading error is read after this way."""

TAIL: Final = 60
"""Steps at the end, 0.3 s, from which the growth of the heading error is read."""

PLACES: Final = ("voltages", "set-points")


class Rig:
    """Dynamics and speed loops on a free floor; pose in m, m, rad, speeds in m/s and rad/s."""

    def __init__(
        self,
        robot: P2osRobot,
        pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        approximation: Approximation = "S",
    ) -> None:
        self.x, self.y, self.theta = pose
        self.dynamics = Dynamics(robot, STEP_S)
        self.loops = SpeedLoops(robot.speed_loop, robot.motor.supply_v, approximation)

    def step(self, v_set: float, w_set: float) -> tuple[float, float]:
        """`STEP_S` with this set-point; the motors' voltages."""
        dynamics = self.dynamics
        v, w = dynamics.v, dynamics.w
        volts = self.loops.voltages(v_set, w_set, v, w, STEP_S)
        dynamics.step(*volts)
        v, w = 0.5 * (v + dynamics.v), 0.5 * (w + dynamics.w)
        heading = self.theta + 0.5 * STEP_S * w
        self.x += STEP_S * v * cos(heading)
        self.y += STEP_S * v * sin(heading)
        self.theta += STEP_S * w
        return volts


class Response(Struct, frozen=True):
    """What came of one set-point."""

    v_set: float
    w_set: float
    approximation: Approximation  # of the voltages
    t: list[float]
    v: list[float]
    w: list[float]
    way: list[float]  # m, along the path
    theta: list[float]  # rad
    saturated_s: float

    def settling(self) -> float:
        """When v and w are in their bands for good, s; inf if never."""
        return max(_settling(self.t, self.v, self.v_set), _settling(self.t, self.w, self.w_set))

    def overshoot(self) -> float:
        """How far v or w exceeds its set-point, as a share of it."""
        over = [
            max(x / asked for x in series) - 1.0
            for series, asked in ((self.v, self.v_set), (self.w, self.w_set))
            if asked
        ]
        return max(0.0, *over)

    def astray(self) -> float:
        """The most that the other speed is off, where only one was asked for, m/s or rad/s."""
        other = self.w if self.v_set else self.v
        return 0.0 if self.v_set and self.w_set else max(map(abs, other))

    def heading_errors(self, bend: float) -> list[float]:
        """Heading less that of a circle of a curvature (1/m), rad, over the way."""
        return [theta - bend * way for theta, way in zip(self.theta, self.way, strict=True)]

    def heading_error(self, bend: float) -> float:
        """Its magnitude after `WAY_M`, degrees."""
        return degrees(abs(float(np.interp(WAY_M, self.way, self.heading_errors(bend)))))

    def growth(self, bend: float) -> float:
        """What each further metre adds to it in the end, degrees per m."""
        errors = self.heading_errors(bend)
        way = self.way[-1] - self.way[-TAIL]
        return degrees(abs(errors[-1] - errors[-TAIL]) / way)


def _settling(t: Sequence[float], series: Sequence[float], asked: float) -> float:
    if not asked:
        return 0.0
    out = [at for at, x in zip(t, series, strict=True) if abs(x - asked) > BAND * abs(asked)]
    last = out[-1] if out else 0.0
    return inf if last >= t[-1] else last


def respond(case: tuple[float, float, Approximation]) -> Response:
    """From rest to a set-point."""
    v_set, w_set, approximation = case
    robot = load(find("robots", ROBOT), P2osRobot)
    rig = Rig(robot, approximation=approximation)
    t, v, w, ways, theta, way, saturated = [0.0], [0.0], [0.0], [0.0], [0.0], 0.0, 0
    for step in range(round(SECONDS / STEP_S)):
        volts = rig.step(v_set, w_set)
        saturated += max(map(abs, volts)) > SUPPLY_SHARE * robot.motor.supply_v
        way += STEP_S * 0.5 * (v[-1] + rig.dynamics.v)
        t.append((step + 1) * STEP_S)
        v.append(rig.dynamics.v)
        w.append(rig.dynamics.w)
        ways.append(way)
        theta.append(rig.theta)
    return Response(v_set, w_set, approximation, t, v, w, ways, theta, saturated * STEP_S)


def random_setpoints(first_seed: int, runs: int) -> list[Speeds]:
    """Coupled set-points, one a seed, whose outer rim would have to do 1.8 to 2.4 m/s."""
    track = load(find("robots", ROBOT), P2osRobot).body.half_track_m
    chosen = []
    for seed in range(first_seed, first_seed + runs):
        rng = np.random.default_rng(seed)
        v, rim = float(rng.uniform(1.0, 1.6)), float(rng.uniform(1.8, 2.4))
        chosen.append((v, (rim - v) / track * (1.0 if rng.random() < 0.5 else -1.0)))
    return chosen


class Pair(Struct, frozen=True):
    """One set-point by S and by T, in one of the two places."""

    v_set: float
    w_set: float
    place: str
    s: Response
    t: Response

    @property
    def bend(self) -> float:
        """The curvature asked for, 1/m."""
        return self.w_set / self.v_set


def compare(case: tuple[float, float, str]) -> Pair:
    """S and T for a set-point that the robot cannot hold."""
    v_set, w_set, place = case
    if place == "voltages":
        s, t = respond((v_set, w_set, "S")), respond((v_set, w_set, "T"))
        return Pair(v_set, w_set, place, s, t)
    robot = load(find("robots", ROBOT), P2osRobot)
    track, most = robot.body.half_track_m, robot.limits.v_max
    rims = v_set - track * w_set, v_set + track * w_set
    answers = []
    for limited in (scaled, truncated):
        left, right = limited(*rims, most)
        answers.append(respond((0.5 * (left + right), 0.5 * (right - left) / track, "S")))
    return Pair(v_set, w_set, place, *answers)


# Tables and figures -------------------------------------------------------------------------------


def responses_table(found: dict[str, list[Response]]) -> str:
    """Settling and overshoot of every set-point."""
    lines = [
        f"| {kind} | {one.v_set:g} | {one.w_set:g} | {one.settling():.2f} |"
        f" {one.overshoot():.1%} | {_other(one)} | {one.saturated_s:.2f} |"
        for kind, many in found.items()
        for one in many
    ]
    every = [one for many in found.values() for one in many]
    slow = sum(one.settling() >= 2.0 for one in every)
    over = [one for one in every if one.overshoot() >= 0.1]
    return (
        "| set-point | v [m/s] | w [rad/s] | settles [s] | overshoot | the other speed astray |"
        " at the supply's limit [s] |\n| --- | ---: | ---: | ---: | ---: | ---: | ---: |\n"
        + "\n".join(lines)
        + f"\n\nThe thesis: under 2 s, under 10 % in the worst case. Here {len(every) - slow} of"
        f" {len(every)} settle under 2 s and {len(every) - len(over)} stay under 10 %; "
        + (
            "over are " + ", ".join(f"({one.v_set:g}, {one.w_set:g})" for one in over)
            if over
            else "none is over"
        )
        + ".\n"
    )


def _other(one: Response) -> str:
    if one.v_set and one.w_set:
        return "-"
    return f"{one.astray():.3f} {'rad/s' if one.v_set else 'm/s'}"


def comparison_table(pairs: Sequence[Pair]) -> str:
    """S against T, as pairs."""
    from scipy.stats import wilcoxon  # noqa: PLC0415 - an extra, and slow

    lines = []
    for place in PLACES:
        mine = [pair for pair in pairs if pair.place == place]
        for name, measure in (
            (f"heading error after {WAY_M:g} m [deg]", Response.heading_error),
            ("added by each further metre [deg]", Response.growth),
        ):
            s = [measure(pair.s, pair.bend) for pair in mine]
            t = [measure(pair.t, pair.bend) for pair in mine]
            p = f"{wilcoxon(s, t).pvalue:.2g}" if len(mine) > 1 else "-"
            fewer = sum(a < b for a, b in zip(s, t, strict=True))
            lines.append(
                f"| {place} | {name} | {_spread(s)} | {_spread(t)} | {fewer} of {len(mine)} | {p} |"
            )
    return (
        "| limited at the | | S | T | S is less | p |\n"
        "| --- | --- | ---: | ---: | ---: | ---: |\n" + "\n".join(lines) + "\n"
    )


def _spread(values: Sequence[float]) -> str:
    return f"{fmean(values):.1f} ± {stdev(values) if len(values) > 1 else 0.0:.1f}"


def figure_415(found: dict[str, list[Response]]) -> Any:
    """Speeds over time, a column for each kind of set-point."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, and slow

    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots(2, len(found), sharex=True)
    for column, (kind, many) in enumerate(found.items()):
        for one in many:
            (line,) = axes[0, column].plot(one.t, one.v, label=f"({one.v_set:g}, {one.w_set:g})")
            axes[1, column].plot(one.t, one.w, color=line.get_color())
            for row, asked in ((0, one.v_set), (1, one.w_set)):
                axes[row, column].axhline(asked, color=line.get_color(), linewidth=0.5, ls="--")
        axes[0, column].set(title=kind, ylabel="v [m/s]")
        axes[1, column].set(xlabel="t [s]", ylabel="w [rad/s]")
        axes[0, column].legend(fontsize=7)
    return figure


def figure_st(pairs: Sequence[Pair]) -> Any:
    """Heading error over the way by S and T, and the speeds, in both places."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, and slow

    figure = Figure(figsize=(11, 4), layout="constrained")
    errors, speeds = figure.subplots(1, 2)
    for pair in pairs:
        for one, style in ((pair.s, "-"), (pair.t, "--")):
            label = f"{'S' if one is pair.s else 'T'} at the {pair.place}"
            headings = np.degrees(one.heading_errors(pair.bend))
            errors.plot(one.way, headings, style, label=label)
            speeds.plot(one.v, one.w, style, label=label)
    v, w = pairs[0].v_set, pairs[0].w_set
    speeds.plot([0.0, v], [0.0, w], "k:", label="the direction asked for")
    errors.set(xlabel="way [m]", ylabel="heading error [deg]")
    errors.set_title(f"set-point ({v:g} m/s, {w:g} rad/s)")
    speeds.set(xlabel="v [m/s]", ylabel="w [rad/s]")
    errors.legend()
    speeds.legend()
    return figure


def run(context: Context) -> None:
    """Every set-point of `KINDS` by S, and random ones by S and T in both places."""
    cases: list[tuple[float, float, Approximation]] = [
        (v, w, "S") for many in KINDS.values() for v, w in many
    ]
    answers = iter(context.map(respond, cases, "set-points"))
    found = {kind: [next(answers) for _ in many] for kind, many in KINDS.items()}
    setpoints = random_setpoints(context.first_seed, context.runs)
    pairs = context.map(
        compare, [(v, w, place) for place in PLACES for v, w in setpoints], "S against T"
    )
    context.rows(
        "responses",
        ("v_set", "w_set", "settling_s", "overshoot", "astray", "saturated_s"),
        (
            tuple(
                f"{x:.6g}"
                for x in (
                    *(one.v_set, one.w_set, one.settling()),
                    *(one.overshoot(), one.astray(), one.saturated_s),
                )
            )
            for many in found.values()
            for one in many
        ),
    )
    context.rows(
        "s-against-t",
        ("seed", "v_set", "w_set", "limited_at", "s_heading_deg", "t_heading_deg"),
        (
            (
                context.first_seed + n % context.runs,
                *(f"{pair.v_set:.6g}", f"{pair.w_set:.6g}", pair.place),
                *(f"{one.heading_error(pair.bend):.6g}" for one in (pair.s, pair.t)),
            )
            for n, pair in enumerate(pairs)
        ),
    )
    context.table(
        f"# {TITLE}\n\n{responses_table(found)}\n## S against T\n\n{context.runs} random"
        " set-points from rest, v from 1 to 1.6 m/s, the outer rim at 1.8 to 2.4 m/s (the robot"
        f" can do 1.6).\n\n{comparison_table(pairs)}"
    )
    context.figure(figure_415(found), "figure-4.15")
    context.figure(figure_st([compare((1.4, 4.0, place)) for place in PLACES]), "s-against-t")
