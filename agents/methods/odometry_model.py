"""How far odometry errs on this robot, learned from the steps that scan matching is sure of.

A robot's odometry errs in a systematic part (the scale of ways and turns, a drift per metre) and a
random one. Both are estimated while mapping: the systematic part by recursive least squares with
forgetting, the random one as a factor on the standard deviations that are assumed at first.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import Final

import numpy as np
from msgspec import Struct

from armadico.agents.methods.parameters import Positive
from armadico.agents.methods.poses import Floats, wrapped
from armadico.agents.methods.scan_matching import Prior

BIAS_VARIANCE: Final = (0.1**2, 0.06**2)
"""Of the systematic error of a heading at first: (rad/rad)^2 and (rad/m)^2."""

SCALE_VARIANCE: Final = 0.06**2
"""Of the systematic error of a way at first."""

BIAS_MOST, SCALE_MOST = 0.2, 0.1
CLEAR: Final = 4.0
"""A larger squared error, in standard deviations, is a wrong match and teaches nothing."""


class OdometryParameters(Struct, frozen=True, kw_only=True):
    """Standard deviations of a step, and how they are adapted."""

    translation_noise: Positive = 0.05  # m, of any step,
    translation_from_translation: Positive = 0.25  # of the way,
    translation_from_rotation: Positive = 0.05  # m/rad
    rotation_noise: Positive = 0.03  # rad,
    rotation_from_rotation: Positive = 0.25  # of the turn,
    rotation_from_translation: Positive = 0.08  # rad/m
    memory: Positive = 40.0  # steps that the estimate goes back
    least_factor: Positive = 0.3  # of the standard deviations
    most_factor: Positive = 1.0
    margin: Positive = 1.5  # on the measured deviation


class OdometryModel:
    """Corrects a step of the odometry and tells how far it may be off."""

    def __init__(self, parameters: OdometryParameters) -> None:
        """Begin with the assumed deviations and no systematic error."""
        self.parameters = parameters
        self._bias = np.zeros(2)  # rad of error for each rad of turn, and for each m of way
        self._bias_covariance = np.diag(BIAS_VARIANCE)
        self._scale, self._scale_variance = 0.0, SCALE_VARIANCE  # of ways
        self._squares = np.array([1.0, 1.0]) / self.parameters.margin**2

    @property
    def systematic(self) -> tuple[float, float, float]:
        """What the odometry counts too little: turn (rad/rad), drift (rad/m), way (m/m)."""
        turning, drift = self._bias.tolist()
        return turning, drift, self._scale

    @property
    def deviations(self) -> tuple[float, float, float]:
        """The standard deviations of these three."""
        turning, drift = np.sqrt(np.diag(self._bias_covariance)).tolist()
        return turning, drift, sqrt(self._scale_variance)

    @property
    def factors(self) -> tuple[float, float]:
        """Of the assumed deviations of position and of heading."""
        p = self.parameters
        position, heading = np.clip(
            p.margin * np.sqrt(self._squares), p.least_factor, p.most_factor
        ).tolist()
        return position, heading

    def corrected(self, step: Floats) -> Floats:
        """A step without the systematic error that is known so far."""
        way = hypot(step[0], step[1])
        turn = step[2] + self._bias @ np.array([step[2], way])
        half = 0.5 * (turn - step[2])  # a drift bends the whole step
        c, s, longer = np.cos(half), np.sin(half), 1.0 + self._scale
        x, y = longer * step[0], longer * step[1]
        return np.array([c * x - s * y, s * x + c * y, wrapped(turn)])

    def prior(self, step: Floats, *, factors: tuple[float, float] | None = None) -> Prior:
        """The standard deviations of a step: as adapted, or with given factors."""
        p = self.parameters
        position, heading = self.factors if factors is None else factors
        way, turn = hypot(step[0], step[1]), abs(float(step[2]))
        return Prior(
            position
            * (
                p.translation_noise
                + p.translation_from_translation * way
                + p.translation_from_rotation * turn
            ),
            heading
            * (
                p.rotation_noise
                + p.rotation_from_rotation * turn
                + p.rotation_from_translation * way
            ),
        )

    def learn(self, step: Floats, measured: Floats, *, position: bool = True) -> None:
        """Take a step whose true motion scan matching has measured.

        The odometry's step is not corrected. `position`: the match tells the position, too, and not
        the heading alone.
        """
        p = self.parameters
        assumed = self.prior(step, factors=(1.0, 1.0))
        predicted = self.corrected(step)
        off = np.array([*(measured[:2] - predicted[:2]), wrapped(measured[2] - predicted[2])])
        squares = np.array(
            [
                0.5 * (off[0] ** 2 + off[1] ** 2) / assumed.position**2,
                off[2] ** 2 / assumed.heading**2,
            ]
        )
        more = (np.minimum(squares, CLEAR) - self._squares) / p.memory
        self._squares += more if position else more * (0.0, 1.0)
        way = hypot(step[0], step[1])
        if squares[1] < CLEAR:
            self._learn_bias(np.array([step[2], way]), float(off[2]), assumed.heading)
        if position and way > 0.05 and squares[0] < CLEAR:
            along = float(off[:2] @ predicted[:2]) / max(1e-9, float(np.hypot(*predicted[:2])))
            self._learn_scale(way, along, assumed.position)

    def _learn_bias(self, at: Floats, off: float, deviation: float) -> None:
        keep = 1.0 - 1.0 / self.parameters.memory
        covariance = self._bias_covariance
        if (covariance.diagonal() / keep < BIAS_VARIANCE).all():
            covariance = covariance / keep  # forget; never beyond what was assumed at first
        gain = covariance @ at / (at @ covariance @ at + (0.5 * deviation) ** 2)
        self._bias = np.clip(self._bias + gain * off, -BIAS_MOST, BIAS_MOST)
        self._bias_covariance = covariance - np.outer(gain, at) @ covariance

    def _learn_scale(self, way: float, along: float, deviation: float) -> None:
        keep = 1.0 - 1.0 / self.parameters.memory
        variance = min(self._scale_variance / keep, SCALE_VARIANCE)
        gain = variance * way / (way**2 * variance + (0.5 * deviation) ** 2)
        self._scale = min(SCALE_MOST, max(-SCALE_MOST, self._scale + gain * along))
        self._scale_variance = variance * (1.0 - gain * way)
