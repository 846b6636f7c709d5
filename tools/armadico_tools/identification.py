"""Identification of the robot's dynamics from a log of voltages and speeds (thesis 4.5.3); sans-IO.

Straight ahead (4.34) and turning on the spot (4.35) the equation of motion of a speed eta is

    eta_dot = a F - b eta - c sign(eta)

with F the motors' force (N) or couple (Nm). Its integral over a window (4.30) is linear in
(a, b, c), so least squares (4.31) needs no acceleration. Improvements on the thesis's method:

- Integrals are sums of trapezia. With voltages held between rows they give Tustin's coefficients,
  all three too small by tanh(x) / x with x = b dt / 2, which is corrected exactly.
- The noise of the speeds is also in the regressors and biases `least_squares` (at 10 Hz and
  0.04 m/s C_s by half its interval). `instrumental` uses the model's own response, which has no
  noise, as instruments: it is consistent, and the intervals contain the true values.
- Residuals of neighbouring windows share a sample, so they are correlated (-1/2). The covariance
  includes that correlation.
- A turning robot also drives, because the mass centre is off the axle. The couple M x v w (x is the
  thesis's y_m) has known factors, so `coupled` subtracts it from Gamma and adds no unknown.

Coefficients that the data do not determine are rejected by name (`NotIdentifiableError`).
Voltages: left is the thesis's V3, right its V2. Speeds as REP-103: m/s ahead, rad/s to the left.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atanh, exp, log1p
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.dynamics import Wheels
from armadico_tools.speed_log import Floats, Log

WINDOW_S: Final = 0.4
"""From t_(k-1) to t_k of (4.30)."""

ROUNDS: Final = 2
"""Iterations: each model's response becomes the next instruments."""

MOVING_M_S: Final = 0.1
"""A wheel with a slower rim may be at rest, where the sign of friction is unknown."""

LEAST_WINDOWS: Final = 6
EXCITED: Final = 5.0
"""Least energy of a regressor's own part, as a multiple of what noise alone would give: noise gives
0.4 to 1.6 in 20 windows, the least exciting trial 11."""

CONFIDENCE: Final = 1.959963984540054  # standard deviations on either side, for 95 %


class NotIdentifiableError(ValueError):
    """The log does not excite the motion enough.

    Attributes:
        names: The coefficients, and what would follow from them.
    """

    def __init__(self, motion: Motion, coefficients: tuple[str, ...], reason: str) -> None:
        self.names = tuple(
            f"{coefficient} ({motion.gives[motion.coefficients.index(coefficient)]})"
            for coefficient in coefficients
        )
        super().__init__(f"{motion.name}: cannot identify {', '.join(self.names)}: {reason}")


class Motion(Struct, frozen=True):
    """One degree of freedom."""

    name: str
    coefficients: tuple[str, str, str]  # of force, of speed, of its sign
    gives: tuple[str, str, str]  # what follows from them
    units: tuple[str, str, str]


LINEAR: Final = Motion(
    "linear", ("a11", "a15", "a18"), ("1/a11", "C_v", "C_s"), ("kg", "Nm s", "Nm")
)
ANGULAR: Final = Motion(
    "angular", ("a22", "a26", "a29"), ("1/a22", "C_v1", "C_s1"), ("kg m2", "Nm s", "Nm")
)


class Interval(Struct, frozen=True):
    """A value and half the width of its 95 % confidence interval, in the value's unit."""

    value: float
    half: float

    def holds(self, true: float) -> bool:
        """Whether the interval holds a value."""
        return abs(true - self.value) <= self.half


class Estimate(Struct, frozen=True, eq=False):
    """Coefficients of (4.34) or (4.35) from a log, with their covariance."""

    motion: Motion
    theta: Floats  # a, b, c
    covariance: Floats
    noise: float  # standard deviation of the measured speed, m/s or rad/s
    windows: int
    coupled: bool

    def coefficients(self) -> dict[str, Interval]:
        """a, b, c under the thesis's names."""
        half = CONFIDENCE * np.sqrt(np.diag(self.covariance))
        return {
            name: Interval(float(value), float(wide))
            for name, value, wide in zip(self.motion.coefficients, self.theta, half, strict=True)
        }


# Estimation ---------------------------------------------------------------------------------------


def force(log: Log, profile: P2osRobot, motion: Motion, *, coupled: bool) -> Floats:
    """F of (4.34), N, or Gamma of (4.35), Nm; with the centrifugal couple if `coupled`."""
    per_volt = Wheels.of(profile).gain_nm_v / profile.body.wheel_radius_m
    if motion == LINEAR:
        return per_volt * (log.right_v + log.left_v)
    couple = profile.body.half_track_m * per_volt * (log.right_v - log.left_v)
    if coupled:
        couple = couple - profile.body.mass_kg * profile.inertia.mass_centre_x_m * log.v * log.w
    return couple


def least_squares(
    log: Log, profile: P2osRobot, motion: Motion, *, coupled: bool = False
) -> Estimate:
    """The thesis's estimate (4.31). Raises NotIdentifiableError."""
    problem = _Problem(log, profile, motion, coupled)
    speed = _speed(log, motion)
    return problem.estimate(problem.regressors(speed), problem.choose(speed, MOVING_M_S))


def instrumental(
    log: Log, profile: P2osRobot, motion: Motion, *, coupled: bool = False
) -> Estimate:
    """The same equation, with the model's response as instruments. Raises NotIdentifiableError."""
    problem = _Problem(log, profile, motion, coupled)
    quiet, still = _speed(log, motion), MOVING_M_S
    for _ in range(ROUNDS):
        chosen = problem.choose(quiet, still)
        problem.check(chosen)
        theta = problem.fit(problem.regressors(quiet), chosen)
        quiet, still = _respond(log, profile, motion, theta, coupled), 0.5 * MOVING_M_S
    return problem.estimate(problem.regressors(quiet), problem.choose(quiet, still))


def response(log: Log, profile: P2osRobot, estimate: Estimate) -> Floats:
    """The speeds that an estimate predicts for the log's voltages, from the first or from rest."""
    return _respond(log, profile, estimate.motion, estimate.theta, estimate.coupled)


def _respond(log: Log, profile: P2osRobot, motion: Motion, theta: Floats, coupled: bool) -> Floats:
    a, b, c = (float(x) for x in theta)
    push = a * force(log, profile, motion, coupled=coupled)
    first = float(_speed(log, motion)[0])
    speed = [first if abs(first) > _slow(profile, motion, MOVING_M_S) else 0.0]
    for drive, dt in zip(push[:-1].tolist(), np.diff(log.t).tolist(), strict=True):
        speed.append(_onward(speed[-1], drive, b, c, dt))
    return np.array(speed)


def _onward(speed: float, drive: float, b: float, c: float, dt: float) -> float:
    """Eta after dt of eta_dot = drive - b eta - c sign(eta), exactly, stops included; b > 0."""
    if speed == 0.0:
        if abs(drive) <= c:
            return 0.0
        sign = 1.0 if drive > 0.0 else -1.0
    else:
        sign = 1.0 if speed > 0.0 else -1.0
    settled = (drive - c * sign) / b
    after = settled + (speed - settled) * exp(-b * dt)
    if after * sign >= 0.0:
        return after
    stopped = log1p(-speed / settled) / b  # time until rest
    return _onward(0.0, drive, b, c, dt - stopped)


def _speed(log: Log, motion: Motion) -> Floats:
    return log.v if motion == LINEAR else log.w


def _slow(profile: P2osRobot, motion: Motion, rim_m_s: float) -> float:
    return rim_m_s if motion == LINEAR else rim_m_s / profile.body.half_track_m


class _Problem:
    """The windows of a log and the sums over them: eta(t_k) - eta(t_(k-1)) = integral theta."""

    def __init__(self, log: Log, profile: P2osRobot, motion: Motion, coupled: bool) -> None:
        self.motion, self.coupled, self._profile, self._log = motion, coupled, profile, log
        steps = np.diff(log.t)
        self.dt = float(np.median(steps))
        size = max(1, round(WINDOW_S / self.dt))
        starts = np.arange(0, len(log.t) - size, size)
        self._samples = starts[:, None] + np.arange(size + 1)  # of every window, ends included
        self._held = steps[self._samples[:, :-1]]  # s that each row's voltage is applied
        self._trapezia = np.zeros(self._samples.shape)  # weight of each sample, s
        self._trapezia[:, :-1] += 0.5 * self._held
        self._trapezia[:, 1:] += 0.5 * self._held
        speed = _speed(log, motion)
        change = speed[self._samples[:, -1]] - speed[starts]
        self._measured = (self.regressors(speed), change)

    def regressors(self, speed: Floats) -> Floats:
        """The integral of Psi (4.30) over every window, with this speed."""
        log = self._log
        v, w = (speed, log.w) if self.motion == LINEAR else (log.v, speed)
        used = Log(log.t, log.left_v, log.right_v, v, w)
        push = force(used, self._profile, self.motion, coupled=self.coupled)
        driven = np.sum(self._held * push[self._samples[:, :-1]], axis=1)
        rubbed = np.sum(self._held * np.sign(speed)[self._samples[:, :-1]], axis=1)
        return np.column_stack([driven, -self._integral(speed), -rubbed])

    def _integral(self, values: Floats) -> Floats:
        integral: Floats = np.sum(self._trapezia * values[self._samples], axis=1)
        return integral

    def choose(self, speed: Floats, rim_m_s: float) -> NDArray[np.bool_]:
        """Windows in which the robot moves in one direction, and only in this motion."""
        slow = _slow(self._profile, self.motion, rim_m_s)
        inside = speed[self._samples]
        one_way = (inside >= slow).all(axis=1) | (inside <= -slow).all(axis=1)
        total = self._trapezia.sum(axis=1)
        ahead = np.abs(self._integral(self._log.v)) / total
        rim = self._profile.body.half_track_m * np.abs(self._integral(self._log.w)) / total
        alone = rim < 0.2 * ahead if self.motion == LINEAR else ahead < 0.6 * rim
        chosen: NDArray[np.bool_] = one_way & alone
        return chosen

    def fit(self, instruments: Floats, chosen: NDArray[np.bool_]) -> Floats:
        """Theta = (Z' F)^-1 Z' Y, which is (4.31) when the instruments Z are the regressors F."""
        raw = self._raw(instruments, chosen)
        return raw * self._stretch(raw)

    def _raw(self, instruments: Floats, chosen: NDArray[np.bool_]) -> Floats:
        """Tustin's coefficients."""
        f, z, y = self._measured[0][chosen], instruments[chosen], self._measured[1][chosen]
        scale = np.linalg.norm(f, axis=0)
        theta: Floats = np.linalg.solve(z.T @ f / scale, z.T @ y) / scale
        return theta

    def estimate(self, instruments: Floats, chosen: NDArray[np.bool_]) -> Estimate:
        """Theta and its covariance, including the samples that windows share."""
        self.check(chosen)
        raw = self._raw(instruments, chosen)
        stretch = self._stretch(raw)
        noise, shared = self._noise(raw, chosen)
        f, z = self._measured[0][chosen], instruments[chosen]
        gain = np.linalg.solve(z.T @ f, z.T) * noise * stretch
        one = (gain * np.sum(shared**2, axis=1)) @ gain.T
        # the last sample of a window is the first of the next
        follows = np.diff(np.flatnonzero(chosen)) == 1
        common = np.where(follows, shared[:-1, -1] * shared[1:, 0], 0.0)
        two = (gain[:, :-1] * common) @ gain[:, 1:].T
        covariance = one + two + two.T
        return Estimate(
            self.motion, raw * stretch, covariance, noise, int(chosen.sum()), self.coupled
        )

    def check(self, chosen: NDArray[np.bool_]) -> None:
        """Raise NotIdentifiableError unless each regressor has a part of its own beyond noise."""
        if chosen.sum() < LEAST_WINDOWS:
            raise NotIdentifiableError(
                self.motion,
                self.motion.coefficients,
                f"the robot moves so, and one way, in {chosen.sum()} windows only",
            )
        f, y = self._measured[0][chosen], self._measured[1][chosen]
        f = f / np.maximum(np.linalg.norm(f, axis=0), 1e-12)
        theta = np.linalg.lstsq(self._measured[0][chosen], y, rcond=1e-9)[0]
        noise, _ = self._noise(theta.astype(np.float64), chosen)
        area = float(np.sum((noise * self._trapezia[chosen]) ** 2))
        area /= max(float(np.sum(self._measured[0][chosen][:, 1] ** 2)), 1e-12)
        weak = []
        for column, name in enumerate(self.motion.coefficients):
            rest = np.delete(f, column, axis=1)
            share = np.linalg.lstsq(rest, f[:, column], rcond=1e-9)[0]
            own = float(np.sum((f[:, column] - rest @ share) ** 2))
            of_speed = 1.0 if column == 1 else float(share[0 if column == 0 else 1])
            if own < 1e-8 + EXCITED * area * of_speed**2:
                weak.append(name)
        if weak:
            raise NotIdentifiableError(self.motion, tuple(weak), "voltage and speed hardly change")

    def _noise(self, theta: Floats, chosen: NDArray[np.bool_]) -> tuple[float, Floats]:
        """The speed's noise, and the weights of the samples' noise in each window's residual."""
        f, y = self._measured[0][chosen], self._measured[1][chosen]
        shared = theta[1] * self._trapezia[chosen]
        shared[:, 0] -= 1.0
        shared[:, -1] += 1.0
        return float(np.sqrt(np.sum((y - f @ theta) ** 2) / np.sum(shared**2))), shared

    def _stretch(self, theta: Floats) -> float:
        """The factor from Tustin's coefficients to those of continuous time."""
        x = 0.5 * float(theta[1]) * self.dt
        return atanh(x) / x if 0.0 < x < 1.0 else 1.0


METHODS: Final = {"instruments": instrumental, "least-squares": least_squares}


# Physical parameters ------------------------------------------------------------------------------


class Friction(Struct, frozen=True):
    """C_v (Nm s) and C_s (Nm) of a driving wheel, to be subtracted from the rotation's friction."""

    viscous: Interval
    coulomb: Interval

    @classmethod
    def known(cls, profile: P2osRobot) -> Friction:
        """Those of the profile, without uncertainty."""
        inertia = profile.inertia
        return cls(
            Interval(inertia.wheel_viscous_nms, 0.0), Interval(inertia.wheel_coulomb_nm, 0.0)
        )


def physical(
    estimate: Estimate, profile: P2osRobot, friction: Friction | None = None
) -> dict[str, Interval]:
    """1/a11, C_v and C_s, or 1/a22, C_v1 and C_s1, by the formulas under (4.34) and (4.35).

    Args:
        estimate: Of a log.
        profile: For the known characteristics (tables 4.2 and 4.3).
        friction: Of the driving wheels, from the linear motion; None: the profile's.
    """
    a, b, c = (float(x) for x in estimate.theta)
    wheels, radius, inertia = Wheels.of(profile), profile.body.wheel_radius_m, profile.inertia
    emf = wheels.viscous_nms - inertia.wheel_viscous_nms
    motor = wheels.coulomb_nm - inertia.wheel_coulomb_nm
    slope = np.array([[-1.0 / a**2, 0, 0], [-b / a**2, 1 / a, 0], [-c / a**2, 0, 1 / a]])
    if estimate.motion == LINEAR:
        scale = np.array([1.0, 0.5 * radius**2, 0.5 * radius])
        taken, extra = np.array([0.0, emf, motor]), np.zeros(3)
    else:
        friction = friction or Friction.known(profile)
        track = profile.body.half_track_m
        share = np.array([0.0, 2.0 * track**2 / radius**2, 2.0 * track / radius])
        scale = np.ones(3)
        taken = share * (0.0, emf + friction.viscous.value, motor + friction.coulomb.value)
        extra = share * (0.0, friction.viscous.half, friction.coulomb.half)
    values = scale * (1.0 / a, b / a, c / a) - taken
    variance = np.diag(slope @ estimate.covariance @ slope.T) * scale**2
    half = np.hypot(CONFIDENCE * np.sqrt(variance), extra)
    return {
        name: Interval(float(value), float(wide))
        for name, value, wide in zip(estimate.motion.gives, values, half, strict=True)
    }


def truth(profile: P2osRobot) -> dict[str, float]:
    """The values that `physical` should find for the simulated robot of a profile."""
    body, inertia, wheel = profile.body, profile.inertia, profile.caster
    roll = inertia.wheel_mass_kg + inertia.wheel_roll_kg_m2 / body.wheel_radius_m**2
    caster = wheel.mass_kg + inertia.caster_roll_kg_m2 / wheel.radius_m**2
    centre = inertia.mass_centre_x_m**2 + inertia.mass_centre_y_m**2
    moment = body.mass_kg * centre + inertia.body_kg_m2 + 2.0 * inertia.wheel_yaw_kg_m2
    return {
        "1/a11": body.mass_kg + 2.0 * roll + caster,
        "C_v": inertia.wheel_viscous_nms,
        "C_s": inertia.wheel_coulomb_nm,
        "1/a22": moment + 2.0 * body.half_track_m**2 * roll + caster * wheel.arm_m**2,
        "C_v1": inertia.caster_viscous_nms,
        "C_s1": inertia.caster_coulomb_nm,
    }


def autocorrelation(residuals: Floats, lags: int) -> Floats:
    """Of the residuals at 0 to `lags` (figure 4.10 c); white noise stays within 1.96 / sqrt(n)."""
    centred = residuals - residuals.mean()
    whole: Any = np.correlate(centred, centred, "full")[len(centred) - 1 :]
    return np.asarray(whole[: lags + 1] / max(float(whole[0]), 1e-300), dtype=np.float64)


def report(logs: Sequence[tuple[str, Log]], robot: P2osRobot, method: str) -> list[dict[str, Any]]:
    """Identify named logs; an entry for each motion of each log, for JSON.

    The friction of the wheels is from the first straight log; without one, the profile's.
    """
    friction: Friction | None = None
    entries: list[dict[str, Any]] = []
    for motion in (LINEAR, ANGULAR):
        for name, log in logs:
            about: dict[str, Any] = {"log": name, "motion": motion.name}
            try:
                estimate = METHODS[method](log, robot, motion, coupled=motion == ANGULAR)
            except NotIdentifiableError as error:
                entries.append(about | {"refused": str(error)})
                continue
            found = physical(estimate, robot, friction)
            if motion == LINEAR and friction is None:
                friction = Friction(found["C_v"], found["C_s"])
            entries.append(about | _entry(estimate, found, robot))
    return entries


def _entry(estimate: Estimate, found: dict[str, Interval], robot: P2osRobot) -> dict[str, Any]:
    known = truth(robot)
    return {
        "windows": estimate.windows,
        "noise": estimate.noise,
        "parameters": {
            name: {
                "value": it.value,
                "half_95": it.half,
                "unit": unit,
                "profile": known[name],
                "told_from_zero": not it.holds(0.0),
            }
            for (name, it), unit in zip(found.items(), estimate.motion.units, strict=True)
        },
        "coefficients": {
            name: {"value": it.value, "half_95": it.half}
            for name, it in estimate.coefficients().items()
        },
    }
