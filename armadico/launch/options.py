"""The options of a run, declared once for the command line and for Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import radians
from typing import Any, Final

from armadico.config.declared import (
    POSE,
    BadValueError,
    between,
    flag,
    more_than,
    option,
    several,
)
from armadico.core.config_errors import ConfigError
from armadico.core.unseen import RULES, Rule
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.topology import several as listed
from armadico.mobile.geometry import Pose2


def in_rad(pose: Pose2) -> Pose2:
    """A pose whose heading was in degrees."""
    return (pose[0], pose[1], radians(pose[2]))


X_Y_DEG: Final[dict[str, Any]] = {"metavar": ("X", "Y", "DEG"), "must": POSE, "turned": in_rad}
"""Of an option for a pose; in degrees on the command line, in rad in Python."""


def set_option() -> tuple[str, ...]:
    """The field of the parameters that are set one by one."""
    help_ = "set one parameter of one agent; may be repeated"
    return several(help_, "--set", metavar="AGENT.KEY=VALUE")


def unseen_option(default: str) -> Rule | None:
    """The field of the rule for paths through what nobody has seen; None: not given."""
    return option(
        "drive or refuse paths through what nobody has seen, where no other leads to the goal; or a"
        f" file of Nav2's parameters, whose allow_unknown decides (default: {default})",
        read=_unseen_rule,
        metavar="RULE",
    )


def _unseen_rule(text: str) -> Rule:
    """Raises BadValueError."""
    for rule in RULES:
        if text == rule:
            return rule
    if not text.endswith((".yaml", ".yml")):
        raise BadValueError(f"{text!r}: expected {', '.join(RULES)} or a .yaml of Nav2")
    from armadico.config.nav2 import unseen_rule

    try:
        return unseen_rule(text)
    except ConfigError as error:
        raise BadValueError(str(error)) from None


DECIDES: Final = (
    "the mechanism that decides which agent drives: auction, damn, aura, ...; several, for several"
    " resources, with commas or repeated; list: show them (default: ballots)"
)


def coordination_option(help_: str = DECIDES) -> str | None:
    """The field of the mechanism that decides who drives; several are joined by commas."""
    return option(help_, metavar="NAME", action="append", turned=",".join)


def told_option() -> str | None:
    """The field of what agents are told of their share."""
    return option(
        "with an arbiter: what an agent is told of its share (default: the mechanism's, mostly"
        " award)",
        choices=("award", "yes", "no"),
    )


def _group(text: str) -> tuple[str, ...]:
    return tuple(text.split("+"))


@dataclass(frozen=True, kw_only=True)
class Choices:
    """What a user chooses for a run; None: as the scenario has it.

    A field without an option belongs to commands of its own, which declare it.
    """

    goal: Pose2 | None = None
    start: Pose2 | None = option(
        "start at this pose: m, m, degrees (default: the scenario's)", **X_Y_DEG
    )
    limit: float | None = option(
        "time limit (default: from the path's length; without a goal: 60 s)",
        "--for",
        metavar="S",
        must=more_than(0, "expected a number of seconds, more than 0 and finite"),
    )
    virtual: bool = flag("run in one process under a virtual clock")
    seed: int | None = option(
        "seed of random numbers (default: 0)",
        metavar="N",
        must=between(0, 2**63 - 1, "expected 0 to 2^63 - 1"),
    )
    controller: str | None = option(
        "controller of agents that have several: fast, precise, ... (default: the agent's)",
        metavar="NAME",
    )
    parameters: str | None = option(
        "a set of agents' parameters: thesis, brisk, swift, or a TOML file (default: none)",
        metavar="SET",
    )
    sets: Sequence[str] = set_option()
    exchange: str | None = option(
        "how resources change hands (default: smooth)", choices=("abrupt", "smooth")
    )
    coordination: str | None = coordination_option()
    told: str | None = told_option()
    without: Sequence[str] = several("leave out an agent; may be repeated", metavar="AGENT")
    besides: Sequence[str] = several("add an agent; may be repeated", "--with", metavar="AGENT")
    sensors: str | None = option(
        "sensors of the simulated robot: real; glass: a laser sees through some walls; ideal:"
        " almost no errors, and no localization agent (default: the scenario's)",
        metavar="NAME",
    )
    unseen: Rule | None = unseen_option("the scenario's, else the map file's, else drive")
    redundant: bool = flag("run two of each behaviour, so that any one may fail")
    together: tuple[tuple[str, ...], ...] = several(
        "live: run these agents in one process; may be repeated", read=_group, metavar="A+B"
    )
    robot: str | None = option(
        "drive the robot at this address (default: start a simulator)", metavar="URL"
    )
    simulator: str = option(
        "the id that the simulator at --robot prints, whose truth is then this robot's (default:"
        " the name of the robot's controller)",
        default="",
        metavar="ID",
    )
    profile: str | None = option(
        "the robot's profile: a shipped name, or a file (default: the scenario's)", metavar="NAME"
    )
    resume: str | None = None  # a saved map with which the mapping agent continues
    priority: float | None = None  # of a mission of several tasks; None: its own

    def __post_init__(self) -> None:
        """Take a single name for a list of one."""
        for name in ("sets", "without", "besides"):
            object.__setattr__(self, name, listed(getattr(self, name)))


@dataclass(frozen=True, kw_only=True)
class Options(Choices):
    """The options of one run."""

    seed: int = 0
    sets: tuple[str, ...] = ()  # single parameters, as AGENT.KEY=VALUE
    without: tuple[str, ...] = ()
    besides: tuple[str, ...] = ()
    namespace: str = DEFAULT_NAMESPACE  # the robot's
    journal: bool = False  # live: the agents publish their inputs and outputs
    margin: float | None = None  # by which a bid must be better; None: the resource's own

    @classmethod
    def of(cls, choices: Choices, seed: int) -> Options:
        """The options of a run with this seed."""
        given = {each.name: getattr(choices, each.name) for each in fields(Choices)}
        return cls(**given | {"seed": seed})
