"""Figures 4.16 to 4.19: the fast, precise and collaborative controllers of goto, alone on a floor.

The robot is the simulated one with its dynamics and speed loops; a controller knows the true pose
and is asked every 100 ms. The gains are chapter 4's, which are about three times as fast as those
of chapter 5. The thesis's chapter 4 has heading 0 along +y: its cases are turned by -90 degrees.

A run ends when the controller has parked by its stop rule and the wheels rest. Reached means: the
true pose within 0.15 m and 5 degrees of the goal.

Figure 4.19 claims that a state is reached by the collaborative controller only. Our precise
controller turns in place at the goal, so it reaches every state. The claim can hold only for one
that does not, and then hangs on its gains. So it is tried with the linear polar law

    w = kap alpha - kbp beta, alpha = direction of the goal - heading, beta = goal's heading -
    direction of the goal

over a grid of gains, and at one pair of gains from starts scattered about the thesis's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from math import cos, degrees, hypot, pi, radians
from statistics import fmean
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from armadico.agents.methods.controllers import (
    CHAPTER_4,
    Controller,
    Mode,
    Speeds,
    fast,
    mix,
)
from armadico.agents.methods.geometry import clip, direction, distance
from armadico.bridge.p2os.profile import P2osRobot
from armadico.config.loading import find, load
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Waypoint
from armadico_tools.experiments.speed import ROBOT, STEP_S, Rig

if TYPE_CHECKING:
    from armadico_tools.experiments.base import Context

TITLE: Final = "Figures 4.16 to 4.19: fast, precise and collaborative control"

PERIOD_S: Final = 0.1
LIMIT_S: Final = 40.0
REACHED_M, REACHED_RAD = 0.15, radians(5)
REST_M_S, REST_RAD_S = 0.005, 0.01

Pose = tuple[float, float, float]


class Case(Struct, frozen=True):
    """A start and a goal in REP-103: m, m, rad."""

    name: str
    start: Pose
    goal: Pose


CASE_A: Final = Case("figures 4.16 to 4.18", (0.0, 0.0, 0.0), (5.0, 1.0, 0.0))
CASE_B: Final = Case("figure 4.19", (0.0, 0.0, -3 * pi / 8), (3.0, 2.0, -pi / 2))
"""In the thesis (-1, 5, 0) and (-2, 3, -pi/2); turned by -90 degrees, (x, y) is (y, -x)."""

THESIS_S: Final = {"fast": "5", "precise": "over 10", "collaborative": "between"}

GAINS: Final = (2.2, 1.7)
"""The pair of (kap, kbp) that figure 4.19 is drawn for: one of the four, of the map's 120, with
which the claim holds."""

KAP: Final = tuple(round(0.4 + 0.3 * n, 1) for n in range(12))
KBP: Final = tuple(round(0.1 + 0.2 * n, 1) for n in range(10))
CLASSES: Final = ("only collaborative", "both", "only precise", "neither")
START_SD: Final = (0.05, 0.05, radians(3))


class Drive(Struct, frozen=True):
    """One run: where the robot was (t, x, y, theta, v, w; SI), and how it ended."""

    case: str
    controller: str
    path: list[tuple[float, float, float, float, float, float]]
    off_m: float
    off_rad: float
    ended: bool  # parked and at rest before `LIMIT_S`

    @property
    def seconds(self) -> float:
        """Until it rested, or until `LIMIT_S`."""
        return self.path[-1][0]

    @property
    def reached(self) -> bool:
        """Within 0.15 m and 5 degrees of the goal in the end."""
        return self.off_m <= REACHED_M and self.off_rad <= REACHED_RAD

    @property
    def metres(self) -> float:
        points = [(x, y) for _, x, y, *_ in self.path]
        return sum(hypot(c - a, d - b) for (a, b), (c, d) in pairwise(points))


Steer = Callable[[Waypoint, Waypoint], Speeds | None]
"""Speeds for a pose and a goal; None once parked."""


def as_shipped(mode: Mode) -> Steer:
    """One of goto's controllers with chapter 4's gains."""
    controller = Controller(CHAPTER_4, mode)

    def steer(pose: Waypoint, goal: Waypoint) -> Speeds | None:
        speeds = controller.wanted(pose, (goal,))
        return None if controller.parked else speeds

    return steer


def polar(kap: float, kbp: float, *, collaborative: bool) -> Steer:
    """The linear polar law, alone or mixed with fast; it stops where precise stops."""
    settings = CHAPTER_4
    law = settings.precise

    def steer(pose: Waypoint, goal: Waypoint) -> Speeds | None:
        rho = distance(pose, goal)
        if rho <= settings.stop_m:
            return None
        bearing = direction(pose, goal)
        alpha, beta = wrap(bearing - pose.theta), wrap(goal.theta - bearing)
        v = clip(law.gain * rho * cos(alpha), 0.0, law.v)
        near = v, clip(kap * alpha - kbp * beta, -law.w, law.w)
        if not collaborative:
            return near
        return mix(settings, rho, fast(settings.fast, settings, rho, alpha), near)

    return steer


def drive(case: Case, name: str, steer: Steer) -> Drive:
    """Drive until it has parked and rests, or `LIMIT_S` are over."""
    rig = Rig(load(find("robots", ROBOT), P2osRobot), case.start)
    goal, path, ended = Waypoint(*case.goal), [], False
    for cycle in range(round(LIMIT_S / PERIOD_S) + 1):
        v, w = rig.dynamics.v, rig.dynamics.w
        path.append((cycle * PERIOD_S, rig.x, rig.y, rig.theta, v, w))
        speeds = steer(Waypoint(rig.x, rig.y, wrap(rig.theta)), goal)
        ended = speeds is None and abs(v) < REST_M_S and abs(w) < REST_RAD_S
        if ended:
            break
        v_set, w_set = speeds or (0.0, 0.0)
        for _ in range(round(PERIOD_S / STEP_S)):
            rig.step(v_set, w_set)
    off = hypot(rig.x - goal.x, rig.y - goal.y)
    return Drive(case.name, name, path, off, abs(wrap(rig.theta - goal.theta)), ended)


def shipped(case: Case) -> list[Drive]:
    """The three controllers on one case."""
    return [drive(case, mode.value, as_shipped(mode)) for mode in Mode]


def pair(job: tuple[Case, float, float]) -> tuple[Drive, Drive]:
    """The polar law alone and in collaboration, with one pair of gains."""
    case, kap, kbp = job
    return (
        drive(case, "precise", polar(kap, kbp, collaborative=False)),
        drive(case, "collaborative", polar(kap, kbp, collaborative=True)),
    )


def kind(precise: Drive, collaborative: Drive, most_rad: float = REACHED_RAD) -> str:
    """Who reaches the state, of `CLASSES`; `most_rad` is the heading's tolerance."""
    alone, together = (
        one.off_m <= REACHED_M and one.off_rad <= most_rad for one in (precise, collaborative)
    )
    if together:
        return "both" if alone else "only collaborative"
    return "only precise" if alone else "neither"


def scattered(first_seed: int, runs: int) -> list[Case]:
    """Case B from starts about the thesis's, one a seed."""
    cases = []
    for seed in range(first_seed, first_seed + runs):
        noise = np.random.default_rng(seed).normal(size=3) * START_SD
        x, y, theta = (a + float(b) for a, b in zip(CASE_B.start, noise, strict=True))
        cases.append(Case(CASE_B.name, (x, y, theta), CASE_B.goal))
    return cases


# Tables and figures -------------------------------------------------------------------------------


def drives_table(drives: Sequence[Drive]) -> str:
    """How far each controller came, and when."""
    lines = [
        f"| {one.case} | {one.controller} | {_thesis(one)} |"
        f" {one.seconds:.1f} | {one.metres:.2f} | {one.off_m:.3f} | {degrees(one.off_rad):.1f} |"
        f" {'yes' if one.reached else 'no'} |"
        for one in drives
    ]
    return (
        "| case | controller | thesis [s] | time [s] | way [m] | off [m] | off [deg] | reached |\n"
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | --- |\n" + "\n".join(lines) + "\n"
    )


def _thesis(one: Drive) -> str:
    return THESIS_S[one.controller] if one.case == CASE_A.name else "-"


def counts_table(pairs: Sequence[tuple[Drive, Drive]], what: str) -> str:
    """How many of each class, with the heading's tolerance and others."""
    lines = []
    for tolerance in (2.5, 5.0, 10.0):
        count = Counter(kind(*both, most_rad=radians(tolerance)) for both in pairs)
        cells = " | ".join(str(count[name]) for name in CLASSES)
        lines.append(f"| {what} | {tolerance:g} | {cells} |")
    return "\n".join(lines) + "\n"


def figure_case(drives: Sequence[Drive], case: Case) -> Any:
    """Path, x, y, heading and speeds of each controller on one case."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, and slow

    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.subplots(2, 3)
    labels = ("x [m]", "y [m]", "heading [deg]", "v [m/s]", "w [rad/s]")
    for one in drives:
        columns = np.array(one.path).T
        columns[3] = np.degrees(columns[3])
        axes[0, 0].plot(columns[1], columns[2], label=one.controller)
        for n, label in enumerate(labels, 1):
            axes.flat[n].plot(columns[0], columns[n])
            axes.flat[n].set(xlabel="t [s]", ylabel=label)
    x, y, theta = case.goal
    axes[0, 0].quiver(x, y, cos(theta), cos(theta - pi / 2), width=0.012, zorder=5)
    axes[0, 0].set(xlabel="x [m]", ylabel="y [m]", title=case.name, aspect="equal")
    axes[0, 0].set_box_aspect(1.0)
    axes[0, 0].legend(fontsize=8)
    return figure


def figure_419(at_gains: Sequence[Drive], pairs: Sequence[tuple[Drive, Drive]]) -> Any:
    """The thesis's case for one pair of gains, with the whole map beside it."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, and slow

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    paths, chart = figure.subplots(1, 2)
    for one in at_gains:
        columns = np.array(one.path).T
        verdict = "reached" if one.reached else f"off {degrees(one.off_rad):.0f} deg"
        paths.plot(columns[1], columns[2], label=f"{one.controller}: {verdict}")
    x, y, theta = CASE_B.goal
    paths.quiver(x, y, cos(theta), cos(theta - pi / 2), width=0.012, zorder=5)
    paths.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    paths.set_title(f"figure 4.19 for kap {GAINS[0]:g}, kbp {GAINS[1]:g}")
    paths.legend(fontsize=8)
    where: dict[str, tuple[list[float], list[float]]] = {name: ([], []) for name in CLASSES}
    for (kap, kbp), both in zip(grid(), pairs, strict=True):
        xs, ys = where[kind(*both)]
        xs.append(kap)
        ys.append(kbp)
    for name, mark, ink in zip(CLASSES, "osDx", ("#009e73", "#0072b2", "#d55e00", "#9a9a9a"),
                               strict=True):  # fmt: skip
        xs, ys = where[name]
        chart.scatter(xs, ys, marker=mark, color=ink, label=f"{name}: {len(xs)}")
    chart.scatter(*GAINS, s=160, facecolors="none", edgecolors="k", label="drawn beside")
    chart.set(xlabel="kap [1/s]", ylabel="kbp [1/s]", title="who reaches the state")
    chart.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def grid() -> list[tuple[float, float]]:
    """Every pair of gains of the map."""
    return [(kap, kbp) for kap in KAP for kbp in KBP]


def run(context: Context) -> None:
    """Both cases with the shipped controllers; the map; scattered starts."""
    cases = (CASE_A, CASE_B)
    drives = context.map(shipped, cases, "figures 4.16 to 4.19")
    pairs = context.map(pair, [(CASE_B, *gains) for gains in grid()], "gain pairs")
    about = scattered(context.first_seed, context.runs)
    starts = context.map(pair, [(case, *GAINS) for case in about], "scattered starts")
    at_gains = [drive(CASE_B, "fast", as_shipped(Mode.FAST)), *pair((CASE_B, *GAINS))]
    context.rows(
        "runs",
        ("case", "controller", "kap", "kbp", "seed", "time_s", "off_m", "off_deg", "reached"),
        (
            *(_row(one, "", "", "") for many in drives for one in many),
            *(_row(one, *gains, "") for gains, both in zip(grid(), pairs, strict=True)
              for one in both),
            *(_row(one, *GAINS, context.first_seed + n) for n, both in enumerate(starts)
              for one in both),
        ),
    )  # fmt: skip
    collaborative = [both[1].off_rad for both in starts]
    context.table(
        f"# {TITLE}\n\n{drives_table([one for many in drives for one in many])}\n"
        "## The state of figure 4.19 by the linear polar law\n\n"
        f"For kap {GAINS[0]:g}, kbp {GAINS[1]:g}:\n\n{drives_table(at_gains)}\n"
        "Who reaches it (fast never does, its heading being what it is), by the tolerance of the"
        " heading:\n\n"
        f"| over | tolerance [deg] | {' | '.join(CLASSES)} |\n| --- | ---: |{' ---: |' * 4}\n"
        f"{counts_table(pairs, f'{len(pairs)} pairs of gains')}"
        f"{counts_table(starts, f'{len(starts)} starts, {GAINS[0]:g} and {GAINS[1]:g}')}\n"
        f"Starts are scattered by 5 cm and 3 degrees (standard deviation); the collaborative"
        f" controller is {degrees(fmean(collaborative)):.1f} degrees off on average.\n"
    )
    for number, one in zip(("4.16", "4.17", "4.18"), drives[0], strict=True):
        context.figure(figure_case([one], CASE_A), f"figure-{number}")
    context.figure(figure_case(drives[0], CASE_A), "figures-4.16-to-4.18")
    context.figure(figure_419(at_gains, pairs), "figure-4.19")


def _row(one: Drive, kap: object, kbp: object, seed: object) -> tuple[object, ...]:
    return (
        *(one.case, one.controller, kap, kbp, seed, f"{one.seconds:.1f}"),
        *(f"{one.off_m:.6g}", f"{degrees(one.off_rad):.6g}", int(one.reached)),
    )
