"""Robots whose controller speaks P2OS: the section [p2os] of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from armadico.bridge.kind import RobotKind
from armadico.bridge.p2os.profile import P2osRobot, profiles_for
from armadico.bridge.session import Session, Unfit
from armadico.bridge.simulator.traps import UNKIND

if TYPE_CHECKING:
    from armadico.bridge.simulator.robots import Stage
    from armadico.bridge.simulator.simulated import SimulatedRobot


def _session(profile: P2osRobot, now: float, near: tuple[float, float]) -> Session:
    from armadico.bridge.p2os import session

    return session.Session(profile, now, near)


def _simulated(profile: P2osRobot, stage: Stage) -> SimulatedRobot:
    from armadico.bridge.simulator.pioneer import Pioneer

    return Pioneer(profile, stage)


def _unfit(profile: P2osRobot, unfit: Unfit) -> str:
    fitting = profiles_for(unfit.class_name, unfit.subclass)
    if fitting:
        cure = f"use the profile {' or '.join(fitting)}: --profile {fitting[0]}, or"
        cure += f' robot = "{fitting[0]}" in the scenario'
    else:
        cure = "no shipped profile fits it: write one with its factors ([p2os], docs/robots.md)"
    units = profile.p2os
    return f"the profile {profile.name} is for {units.class_name} {units.subclass}; {cure}"


P2OS: Final = RobotKind(P2osRobot, _session, _simulated, unfit=_unfit, unkind=UNKIND)
