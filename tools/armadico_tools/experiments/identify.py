"""Tables 4.4 to 4.6 and figures 4.8 to 4.10: identification of the simulated robot.

A trial drives the plant's dynamics by voltages, straight ahead or turning, and measures its speeds
with noise. Each seed has its own PRBS, noise and initial angle of the caster. Every trial is
estimated twice: by the thesis's least squares (4.31), and with instruments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import sqrt
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.dynamics import Dynamics, Wheels
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.config.loading import find, load
from armadico_tools.experiments import drawing
from armadico_tools.experiments.runner import Context, Experiment, Part, Table
from armadico_tools.identification import (
    ANGULAR,
    LINEAR,
    METHODS,
    Friction,
    Interval,
    Motion,
    autocorrelation,
    force,
    instrumental,
    physical,
    response,
    truth,
)
from armadico_tools.markdown import table
from armadico_tools.speed_log import Floats, Log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROBOT: Final = "pioneer-2dx"
PLANT_S: Final = 0.005
PERIOD_S: Final = 0.02  # from row to row of a log
DURATION_S: Final = 60.0
HOLD_S: Final = 0.4  # a bit of the PRBS: twice the robot's time constant
STEP_S: Final = 3.0  # between two steps
NOISE_M_S: Final = 0.0367
"""Noise of v, and of a rim when turning: the standard deviation of the thesis's residuals (4.10),
taken as noise of the measurement. It is ten times that of encoders."""


class Trial(Struct, frozen=True):
    """The excitation of the robot, and the form of the equation that is fitted."""

    name: str
    motion: Motion
    signal: str  # PRBS between low_v and high_v; STEP to high_v, low_v, -high_v and -low_v
    low_v: float
    high_v: float
    held: bool = False  # v is held at 0 by the robot's own linear PI loop
    coupled: bool = False  # the couple M x v w is included


STRAIGHT: Final = (
    Trial("4.4-1", LINEAR, "PRBS", 2.0, 6.0),
    Trial("4.4-2", LINEAR, "PRBS", 4.0, 10.0),
    Trial("4.4-3", LINEAR, "STEP", 4.0, 8.0),
)
_TURNS: Final = (("1", "STEP", 3.0, 6.0), ("2", "PRBS", 2.0, 5.0), ("3", "PRBS", 3.0, 8.0))
ARMS: Final = (("printed", False, False), ("held", True, False), ("mended", True, True))
"""4.35 as printed with V2 = -V3; v held at 0; v held at 0 and the coupling subtracted."""

TURNING: Final = tuple(
    Trial(f"4.5-{number} {arm}", ANGULAR, signal, low, high, held, coupled)
    for arm, held, coupled in ARMS
    for number, signal, low, high in _TURNS
)
MENDED: Final = tuple(trial for trial in TURNING if trial.coupled)
VALIDATION: Final = Trial("validation", LINEAR, "STEP", 6.0, 6.0)

THESIS: Final[dict[str, dict[str, float]]] = {
    "4.4-1": {"1/a11": 17.83, "C_v": 0.0441, "C_s": 0.3349},
    "4.4-2": {"1/a11": 16.49, "C_v": 0.0445, "C_s": 0.3287},
    "4.4-3": {"1/a11": 16.89, "C_v": 0.0446, "C_s": 0.2921},
    "4.5-1": {"1/a22": 0.4301, "C_v1": 0.000429, "C_s1": 0.004535},
    "4.5-2": {"1/a22": 0.4127, "C_v1": 0.000389, "C_s1": 0.004532},
    "4.5-3": {"1/a22": 0.4292, "C_v1": 0.000469, "C_s1": 0.004541},
    "4.6": {
        "1/a11": 17.07, "C_v": 0.0444, "C_s": 0.3184,
        "1/a22": 0.424, "C_v1": 0.000429, "C_s1": 0.004536,
    },
}  # fmt: skip


def profile() -> P2osRobot:
    """The identified robot."""
    return load(find("robots", ROBOT), P2osRobot)


# Trials -------------------------------------------------------------------------------------------


def prbs(state: int) -> list[int]:
    """One period, 127 bits, of the maximum-length register x^7 + x^6 + 1."""
    register, bits = state % 127 + 1, []
    for _ in range(127):
        bits.append(register & 1)
        register = register >> 1 | ((register ^ register >> 1) & 1) << 6
    return bits


def signal(trial: Trial, seed: int, rows: int) -> Floats:
    """The voltage of every row, V."""
    if trial.signal == "STEP":
        levels = (trial.high_v, trial.low_v, -trial.high_v, -trial.low_v)
        return np.array(levels)[np.arange(rows) // round(STEP_S / PERIOD_S) % 4]
    bits = np.repeat(prbs(seed), round(HOLD_S / PERIOD_S))
    high = np.resize(bits, rows).astype(np.bool_)
    return np.where(high, trial.high_v, trial.low_v)


def record(
    trial: Trial,
    seed: int,
    robot: P2osRobot,
    seconds: float = DURATION_S,
    noise_m_s: float = NOISE_M_S,
) -> Log:
    """Drive the simulated robot through a trial and measure it."""
    rng = np.random.default_rng([seed, *trial.name.encode()])
    dynamics = Dynamics(robot, PLANT_S)
    dynamics.beta = float(rng.uniform(-0.3, 0.3)) + (0.0 if trial.motion == LINEAR else -1.7)
    hold = SpeedLoops(robot.speed_loop, robot.motor.supply_v)
    rows = round(seconds / PERIOD_S)
    table = np.empty((rows, 4))
    for row, volts in enumerate(signal(trial, seed, rows).tolist()):
        left, right = (volts, volts) if trial.motion == LINEAR else (-volts, volts)
        if trial.held:
            same, _ = hold.voltages(0.0, 0.0, dynamics.v, 0.0, PERIOD_S)
            left, right = left + same, right + same
        table[row] = left, right, dynamics.v, dynamics.w
        for _ in range(round(PERIOD_S / PLANT_S)):
            dynamics.step(left, right)
    noise = rng.normal(size=(2, rows)) * noise_m_s
    t = np.arange(rows, dtype=np.float64) * np.float64(PERIOD_S)
    return Log(
        t,
        *(table[:, 0], table[:, 1]),
        table[:, 2] + noise[0],
        table[:, 3] + noise[1] / robot.body.half_track_m,
    )


class Found(Struct, frozen=True):
    """The estimates of one method in one trial with one seed."""

    trial: str
    seed: int
    method: str
    values: dict[str, Interval]


def measure(case: tuple[Trial, int]) -> list[Found]:
    """One trial with one seed, by both methods. The wheels' friction counts as known."""
    trial, seed = case
    robot = profile()
    log = record(trial, seed, robot)
    estimates = {
        name: method(log, robot, trial.motion, coupled=trial.coupled)
        for name, method in METHODS.items()
    }
    return [
        Found(trial.name, seed, name, physical(estimate, robot))
        for name, estimate in estimates.items()
    ]


def pooled(found: Sequence[Found], trials: Sequence[Trial], seed: int) -> dict[str, Interval]:
    """The mean over a seed's trials with instruments, as in the last rows of tables 4.4 and 4.5."""
    names = {trial.name for trial in trials}
    mine = [
        one.values
        for one in found
        if one.seed == seed and one.method == "instruments" and one.trial in names
    ]
    return {
        name: Interval(
            fmean(values[name].value for values in mine),
            sqrt(sum(values[name].half ** 2 for values in mine)) / len(mine),
        )
        for name in mine[0]
    }


def together(found: Sequence[Found], seed: int, robot: P2osRobot) -> dict[str, Interval]:
    """Table 4.6 of one seed: the caster's friction is the rest after the wheels' friction."""
    straight, turning = pooled(found, STRAIGHT, seed), pooled(found, MENDED, seed)
    known = Friction.known(robot)
    ratio = robot.body.half_track_m / robot.body.wheel_radius_m
    for name, share, wheel, taken in (
        ("C_v1", 2.0 * ratio**2, straight["C_v"], known.viscous),
        ("C_s1", 2.0 * ratio, straight["C_s"], known.coulomb),
    ):
        turning[name] = Interval(
            turning[name].value - share * (wheel.value - taken.value),
            sqrt(turning[name].half ** 2 + (share * wheel.half) ** 2),
        )
    rest = truth(robot)["1/a22"] - robot.inertia.body_kg_m2
    turning["I_0"] = Interval(turning["1/a22"].value - rest, turning["1/a22"].half)
    return straight | turning


# The experiment -----------------------------------------------------------------------------------

SPREAD: Final = ("one log", "mean", "bias", "sd", "95 % half width", "holds the true value")


def _spread(mine: Sequence[Interval], true: float) -> tuple[str, ...]:
    """The cells under `SPREAD`."""
    values = [one.value for one in mine]
    mean, spread = fmean(values), stdev(values) if len(values) > 1 else 0.0
    holding = sum(one.holds(true) for one in mine)
    return (
        *(f"{values[0]:.4g} ± {mine[0].half:.2g}", f"{mean:.4g}", f"{mean - true:+.2g}"),
        *(f"{spread:.2g}", f"{fmean(one.half for one in mine):.2g}", f"{holding} of {len(mine)}"),
    )


def summary(trials: Sequence[Trial], found: Sequence[Found], true: dict[str, float]) -> str:
    """Table 4.4 or 4.5, with the thesis's numbers."""
    rows = []
    for trial in trials:
        printed = THESIS[trial.name.split()[0]]
        for name in trial.motion.gives:
            for method in reversed(METHODS):
                mine = [
                    one.values[name]
                    for one in found
                    if one.trial == trial.name and one.method == method
                ]
                about = (trial.name, trial.signal, name, f"{printed[name]:g}", f"{true[name]:.4g}")
                rows.append((*about, method, *_spread(mine, true[name])))
    return table(("exp.", "input", "parameter", "thesis", "true", "method", *SPREAD), rows)


def conclusion(found: Sequence[Found], seeds: Sequence[int], robot: P2osRobot) -> str:
    """Table 4.6, and how often an interval excludes zero."""
    true = truth(robot) | {"I_0": robot.inertia.body_kg_m2}
    printed = THESIS["4.6"] | {"I_0": 0.3}
    every = [together(found, seed, robot) for seed in seeds]
    rows = []
    for name in (*LINEAR.gives, *ANGULAR.gives, "I_0"):
        mine = [one[name] for one in every]
        apart = f"{sum(not one.holds(0.0) for one in mine)} of {len(mine)}"
        width = f"{fmean(one.half for one in mine) / true[name]:.3g}"
        about = (name, f"{printed[name]:g}", f"{true[name]:.4g}")
        rows.append((*about, *_spread(mine, true[name]), apart, width))
    return table(
        ("parameter", "thesis", "true", *SPREAD, "excludes zero", "half width / true"), rows
    )


def validation(seed: int, robot: P2osRobot) -> tuple[Log, Floats]:
    """A step forward and backward that was not used for estimation, and its prediction."""
    first = record(STRAIGHT[0], seed, robot)
    model = instrumental(first, robot, LINEAR)
    log = record(VALIDATION, seed, robot, 4.0 * STEP_S)
    return log, response(log, robot, model)


def _figures(context: Context) -> Iterator[tuple[str, Figure]]:
    """Figures 4.8 to 4.10."""
    robot = profile()
    log, model = validation(context.first_seed, robot)
    residuals, lags = log.v - model, 50
    inputs = drawing.sheet(3, 1, 7, 5)
    newtons = force(log, robot, LINEAR, coupled=False)
    for axes, values, label in zip(
        inputs.axes, (log.left_v, newtons, log.v), ("V2 = V3 [V]", "F [N]", "v [m/s]"), strict=True
    ):
        axes.plot(log.t, values, linewidth=0.8)
        axes.set(ylabel=label, xlabel="t [s]")
    yield "figure-4.8", inputs
    outputs = drawing.sheet(1, 1, 7, 3)
    (axes,) = outputs.axes
    axes.plot(log.t, log.v, linewidth=0.8, label="robot")
    axes.plot(log.t, model, label="model")
    axes.set(ylabel="v [m/s]", xlabel="t [s]", title="robot and model (figure 4.9)")
    axes.legend()
    yield "figure-4.9", outputs
    checks = drawing.sheet(3, 1, 7, 5)
    over_time, histogram, related = checks.axes
    over_time.plot(log.t, residuals, linewidth=0.8)
    over_time.set(ylabel="residual [m/s]", xlabel="t [s]", title="residuals (figure 4.10)")
    histogram.hist(residuals, bins=25)
    histogram.set(xlabel="residual [m/s]", ylabel="rows")
    related.stem(np.arange(lags + 1) * PERIOD_S, autocorrelation(residuals, lags), markerfmt=".")
    for limit in (1.0, -1.0):
        related.axhline(limit * 1.96 / sqrt(len(residuals)), linestyle="--", linewidth=0.8)
    related.set(xlabel="lag [s]", ylabel="autocorrelation")
    yield "figure-4.10", checks


def remarks(log: Log, model: Floats, robot: P2osRobot) -> str:
    """The numbers of figure 4.10, and what 4.5 cannot determine."""
    residuals = log.v - model
    inside = np.abs(autocorrelation(residuals, 50)[1:]) < 1.96 / sqrt(len(residuals))
    ratio = 2.0 * robot.body.half_track_m / robot.body.wheel_radius_m
    return (
        f"Residuals of the validation: mean {residuals.mean():.2g} m/s (thesis -1.5e-04), standard"
        f" deviation {residuals.std():.4f} m/s (thesis 0.0367), {inside.mean():.0%} of 50"
        " autocorrelations inside the 95 % band of white noise.\n\n"
        f"C_s1 is {robot.inertia.caster_coulomb_nm:g} Nm beside"
        f" {Wheels.of(robot).coulomb_nm * ratio:.3g} Nm of the driving wheels. A rotation about the"
        " axle's middle settles with the caster at rest in the robot (cos beta = -d / l1), where"
        " its pivot has no friction, so C_s1 and C_v1 act in transients only. The thesis's own C_s"
        " (table 4.4: 0.2921 to 0.3349) leaves C_s1 uncertain by"
        f" {ratio * 0.0214:.2g} Nm; its table 4.5 has it to 0.000005 Nm.\n"
    )


def _rows(many: Sequence[Sequence[Found]]) -> Table:
    return ("trial", "seed", "method", "parameter", "value", "half_95"), (
        (one.trial, one.seed, one.method, name, f"{it.value:.9g}", f"{it.half:.9g}")
        for both in many
        for one in both
        for name, it in one.values.items()
    )


def _report(context: Context) -> str:
    found, robot = [one for both in context.found["estimates"] for one in both], profile()
    true = truth(robot)
    return (
        f"## Table 4.4, straight ahead\n\n{summary(STRAIGHT, found, true)}\n\n"
        f"## Table 4.5, turning\n\n{summary(TURNING, found, true)}\n\n"
        f"## Table 4.6\n\n{conclusion(found, context.seeds, robot)}\n\n"
        f"{remarks(*validation(context.first_seed, robot), robot)}"
    )


def _cases(context: Context) -> list[tuple[Trial, int]]:
    return [(trial, seed) for trial in (*STRAIGHT, *TURNING) for seed in context.seeds]


IDENTIFY: Final = Experiment(
    note=(
        "A log of each trial for each seed, 60 s at 50 Hz, noise of 0.0367 m/s on v and on a rim's"
        " speed when turning. Units: kg, kg m2, Nm s, Nm. `one log` is the first seed's, with its"
        " 95 % interval; mean, bias and sd are over the seeds. `printed`: (4.35) as printed, V2 ="
        " -V3; `held`: v held at 0 by the linear PI loop; `mended`: that, and the couple M x v w"
        " subtracted from Gamma. In tables 4.4 and 4.5 each parameter is estimated alone (4.5 takes"
        " the wheels' friction as known); 4.6 computes turning from the friction found straight"
        " ahead."
    ),
    parts=(Part("estimates", measure, _cases, _rows),),
    report=_report,
    figures=_figures,
)
