"""Faults as data: a list that is drawn from a seed, stored as JSON, and can be shortened."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from random import Random
from typing import Annotated, Final

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from armadico.core import discovery
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import installed
from armadico.mesh.virtual import LEASE
from armadico_tools.faults.fault_types import KINDS

BEHAVIOURS: Final = ("goto", "avoid", "gothrough")
DRIVERS: Final = (*BEHAVIOURS, "relocate")
PLACERS: Final = ("robot", "encoder", "localization")
"""Agents that know where the robot is."""

AGENTS: Final = (
    *("robot", "encoder", "sonar", "localization"),
    *BEHAVIOURS,
    *("relocate", "path-planning", "interface"),
)
LAYOUTS: Final[tuple[tuple[tuple[str, ...], ...], ...]] = (
    (("robot", "encoder"), ("sonar",), DRIVERS, ("path-planning", "interface", "localization")),
    (("robot",), ("encoder", "sonar", "localization"), DRIVERS, ("path-planning", "interface")),
    (
        ("robot", "goto"),
        ("encoder", "avoid"),
        ("sonar", "gothrough", "relocate"),
        ("interface", "localization"),
    ),
    (
        ("robot", "encoder", "sonar", "localization", "avoid"),
        ("goto", "gothrough", "relocate", "interface", "path-planning"),
    ),
)
"""Which agents share a machine: a cut is between machines."""

BEGIN_S: Final = 4.0
"""There are no faults before this time, for the handshake and the start of the drive."""

NETWORK: Final = frozenset({"drop", "delay", "duplicate", "reorder", "silent-links"})
CUTS: Final = frozenset({"one-way", "partition", "links-lost"})
HOSTS: Final = frozenset({"starved", "host-clock-step"})
"""Kinds that befall all agents of a host."""

EVERYWHERE: Final = frozenset({"stray-state", "huge-term", "huge-counter", "flood", "huge-message"})
"""Kinds in which a stranger's messages reach all agents."""

VICTIMS: Final = {
    **dict.fromkeys(("nan", "lone-restart", "version-skew"), BEHAVIOURS),
    **dict.fromkeys(("serial-garbage", "serial-loss", "robot-restart"), ("robot",)),
    **dict.fromkeys((name for name, kind in KINDS.items() if kind.only), ("robot",)),
    **dict.fromkeys(("slip", "blocked-wheels"), ("robot",)),
    **dict.fromkeys(("stop", "stop-and-release", "two-robot-agents"), ("robot",)),
    "interface-restart": ("interface",),
}
"""Possible targets of a kind, if not all agents: others would be a different fault."""

PACES: Final[tuple[tuple[float, float], ...]] = ((2.5, 4.0), (5.5, 9.0), (5.5, 9.0), (12.0, 25.0))
"""Pauses between faults, s: mostly long enough for every promise about recovery to be due."""

LEAST_S: Final = {
    "in-turn": 2.5,
    "two-robot-agents": 2.5,
    "stop": 1.0,
    "version-skew": 1.0,
    "missing-wall": 30.0,
    "unmapped-box": 30.0,  # the robot has to get there
}
"""Least durations of such faults, s; shorter ones have no effect."""

MOST_S: Final = {"starved": 2.0, "links-lost": 2.0, "blocked-wheels": 3.0}
"""Such faults last a moment, s."""

TOGETHER: Final = (0.0, 0.3, 0.3, 0.7)
"""Share of the faults that begin while another is active."""

LONGEST_S: Final = 6.0
LENGTHS: Final = ((0.05, 0.6), (0.4, 2.5), (2.0, LONGEST_S))
"""Durations of a fault, s, of one of these ranges."""

CALM_END: Final = 0.2
"""Share of the longer runs whose faults end early, so that the mission must be reached."""

LONG_RUN_S: Final = 60.0
QUIET_SHARE: Final = 0.25
"""Other runs of at least the first, in s, are free from faults for the second, a share, at their
end: what is wrong then is wrong for good."""

CALM_END_S: Final = 95.0
"""Length of the calm end of such a run, s."""

PAUSE_S: Final = 6.0
"""In a quarter of the seeds the robot has no mission for so long after each, s."""

SWARM: Final = 0.5
"""The probability that a kind takes part in a seed. Runs with all kinds hide what only many of a
few show (Groce et al., Swarm testing, 2012)."""

Seconds = Annotated[float, Meta(ge=0, le=86_400)]


class Fault(Struct, frozen=True, array_like=True):
    """One fault: kind, begin and duration (s), targets and amount.

    `to` are the receivers, for faults of the network. `amount` is a share, seconds, a rate or a
    variant, as `DRAWS` draws it for the kind; `spread` is a second number.
    """

    kind: str
    at: Seconds
    lasts: Seconds
    targets: tuple[str, ...]
    to: tuple[str, ...] = ()
    amount: float = 0.0
    spread: float = 0.0

    @property
    def until(self) -> float:
        """When it ends, s."""
        return self.at + self.lasts


class Variation(Struct, frozen=True, omit_defaults=True):
    """Differences between societies.

    `delay` and `jitter`, s, are added to the delay that the virtual mesh draws for each message;
    `lease` is that of tokens, s. With `ties` simultaneous events run in random order. `margin` is
    that of all agents (`social.margin`); None: the resource's own. `pause`, s, is the time from the
    end of a mission to the next.
    """

    delay: Annotated[float, Meta(ge=0, le=1)] = 0.0
    jitter: Annotated[float, Meta(ge=0, le=1)] = 0.0
    lease: Annotated[float, Meta(gt=0, le=60)] = LEASE
    ties: bool = False
    margin: Annotated[float, Meta(ge=0, le=1)] | None = None
    pause: Annotated[float, Meta(ge=0, le=60)] = 0.0


class Walker(Struct, frozen=True, array_like=True):
    """A person in the robot's world: the place (m) at the beginning, speed (m/s), heed."""

    x: float
    y: float
    speed: float = 1.0
    heeds: bool = True


class Case(Struct, frozen=True, omit_defaults=True):
    """A run that can be repeated exactly: seed, scenario, duration (s), faults.

    The seed is that of all noise. `variation` describes the network, `sensors` the simulated
    robot's sensors. `variant` is the society's task (`variants.VARIANTS`), `robot` the profile (by
    default the scenario's), `people` are there besides the scenario's, and `charge` is the
    battery's at the beginning, as a share. `planted` is a defect of `planted.DEFECTS`.
    `coordination` is the mechanism, if it is not ballots.
    """

    seed: int
    scenario: str
    lasts: Annotated[float, Meta(gt=0, le=86_400)]
    faults: tuple[Fault, ...]
    variation: Variation = Variation()
    sensors: str = "real"
    variant: str = "sonar"
    robot: str = ""
    people: tuple[Walker, ...] = ()
    charge: Annotated[float, Meta(ge=0, le=1)] = 1.0
    planted: str = ""
    coordination: str = ""

    def dumps(self) -> str:
        """The case as one line of JSON."""
        return msgspec.json.encode(self).decode()


class Outcome(Struct, frozen=True):
    """The result of one case, or of one trial on real processes.

    `faults` counts them by kind, `violations` are (promise, at, text), `longest_s` is the longest
    time from healing to moving again, and `missions` the number of goals reached. `contacts` and
    `moving_s` (s) are by the reason that voided COLLISION then, "" for none. `sights` counts
    situations, and `overconfident_s` is the longest time of moving with a pose wrong beyond its
    covariance. `ends` counts the missions by how they ended (`workload.End`). `needed` are the
    promises of which more would be broken without an excuse, by its name. `kind` is that of a
    trial, and `figures` are its measurements.
    """

    case: Case
    faults: dict[str, int]
    violations: tuple[tuple[str, float, str], ...]
    longest_s: float | None = None
    missions: int = 0
    driven_m: float = 0.0
    contacts: dict[str, int] = {}
    moving_s: dict[str, float] = {}
    sights: dict[str, int] = {}
    overconfident_s: float = 0.0
    ends: dict[str, int] = {}
    needed: dict[str, tuple[str, ...]] = {}
    kind: str = ""
    figures: dict[str, float] = {}


def loads(text: str | bytes) -> Case:
    """A case from its JSON. Raises ConfigError."""
    try:
        case = msgspec.json.decode(text, type=Case)
    except msgspec.DecodeError as error:
        raise ConfigError(f"not a case of faults: {error}") from None
    for fault in case.faults:
        if fault.kind not in KINDS:
            raise ConfigError(f"no kind of fault is called {fault.kind!r}: {', '.join(KINDS)}")
        strangers = {*fault.targets, *fault.to} - {*AGENTS, *installed(discovery.AGENTS)}
        if strangers:
            raise ConfigError(f"{fault.kind}: no agent is called {', '.join(sorted(strangers))}")
    return case


class Swarm(Struct, frozen=True):
    """The parameters of a seed's faults: kinds, durations, pauses."""

    kinds: tuple[str, ...]
    weights: tuple[float, ...]
    lengths: tuple[float, ...]  # weights of LENGTHS
    calm: tuple[float, float]  # s
    together: float


def swarm(rng: Random, kinds: Sequence[str] = (), able: Sequence[str] = tuple(KINDS)) -> Swarm:
    """Draw one; all given kinds take part, else a random choice of those that are `able` to."""
    taking = tuple(kinds) or tuple(kind for kind in able if rng.random() < SWARM)
    taking = taking or (rng.choice([*able]),)
    weights = tuple(KINDS[kind].weight * rng.choice((1.0, 1.0, 3.0)) for kind in taking)
    lengths = tuple(rng.choice((0.2, 1.0, 1.0)) for _ in LENGTHS)
    return Swarm(taking, weights, lengths, rng.choice(PACES), rng.choice(TOGETHER))


def vary(rng: Random) -> Variation:
    """Draw a network; half of them are as fast as the measured one."""
    delay, jitter = rng.choice(((0.0, 0.0), (0.0, 0.0), (0.002, 0.004), (0.005, 0.0)))
    lease = rng.choice((LEASE, LEASE, 0.6, 2.0))
    ties = rng.random() < 0.5
    margin = rng.choice((None, None, 0.0, 0.1))
    return Variation(delay, jitter, lease, ties, margin, rng.choice((0.0, 0.0, 0.0, PAUSE_S)))


def draw(
    rng: Random,
    until: float,
    kinds: Sequence[str] = (),
    able: Sequence[str] = tuple(KINDS),
    agents: Sequence[str] = AGENTS,
) -> tuple[Fault, ...]:
    """Draw the faults for a run of so many seconds, in order of their begins.

    They are of `kinds`, else of some of those that the robot is `able` to have. `agents` are those
    of the society.
    """
    drawn = swarm(rng, kinds, able)
    if until > CALM_END_S + 2 * BEGIN_S and rng.random() < CALM_END:
        until = max(until - CALM_END_S, 3 * BEGIN_S)
    elif until >= LONG_RUN_S:
        until -= QUIET_SHARE * until
    faults: list[Fault] = []
    at = BEGIN_S
    while True:
        if faults and rng.random() < drawn.together:
            last = faults[-1]
            at = rng.uniform(last.at, last.at + min(last.lasts, LONGEST_S))
        elif faults:
            ends = [fault.until for fault in faults if fault.kind not in LONG]
            at = max([faults[-1].at, *ends]) + rng.uniform(*drawn.calm)
        fault = _draw_one(rng, drawn, round(at, 3), agents)
        if fault.kind in LONG and fault.until > until:
            fault = replace(fault, lasts=round(max(until - fault.at, 0.0), 3))
        if fault.until > until or not fault.lasts:
            return tuple(sorted(faults, key=lambda f: f.at))
        faults.append(fault)


LONG: Final = frozenset({"missing-wall", "unmapped-box"})
"""Kinds that are shortened to fit in a run."""


def _draw_one(rng: Random, drawn: Swarm, at: float, agents: Sequence[str]) -> Fault:
    (kind,) = rng.choices(drawn.kinds, drawn.weights)
    (between,) = rng.choices(LENGTHS, drawn.lengths)
    lasts = min(max(rng.uniform(*between), LEAST_S.get(kind, 0.0)), MOST_S.get(kind, inf))
    targets, to = _targets(rng, kind, tuple(agents))
    amount, spread = DRAWS[kind](rng) if kind in DRAWS else (0.0, 0.0)
    return Fault(kind, at, round(lasts, 3), targets, to, round(amount, 4), round(spread, 4))


def _targets(
    rng: Random, kind: str, agents: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The targets of a fault, and the receivers."""
    if (kind in NETWORK and rng.random() < 0.4) or kind == "links-lost":
        return agents, agents
    if kind in NETWORK or kind in CUTS:
        return _sides(rng, agents)
    if kind in HOSTS:
        return rng.choice(_machines(rng, agents)), ()
    if kind == "in-turn":
        return tuple(rng.sample(PLACERS, len(PLACERS))), ()
    if kind in EVERYWHERE:
        return agents, ()
    victims = VICTIMS.get(kind)
    if kind in ("flap", "twin"):
        victims = tuple(name for name in agents if name != "robot")
    return (rng.choice(victims or agents),), ()


def _machines(rng: Random, agents: Sequence[str]) -> list[tuple[str, ...]]:
    """A society's agents by machine; those that no layout has share its last machine."""
    layout = rng.choice(LAYOUTS)
    placed = {name for machine in layout for name in machine}
    ranger = next((name for name in agents if name == "laser"), "sonar")
    more = tuple(name for name in agents if name not in placed and name != ranger)
    machines = [
        tuple(ranger if name == "sonar" else name for name in machine) for machine in layout
    ]
    machines[-1] += more
    kept = [tuple(name for name in machine if name in agents) for machine in machines]
    return [machine for machine in kept if machine]


def _sides(rng: Random, agents: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Some machines, and some of the others."""
    layout = _machines(rng, agents)
    rng.shuffle(layout)
    here = rng.randint(1, len(layout) - 1)
    there = rng.randint(here + 1, len(layout))
    return _names(layout[:here]), _names(layout[here:there])


def _names(machines: Sequence[Sequence[str]]) -> tuple[str, ...]:
    return tuple(name for machine in machines for name in machine)


def _bias(rng: Random) -> tuple[float, float]:
    """A bias of ranges, m: too long or too short."""
    return rng.choice((-1.0, 1.0)) * rng.uniform(0.02, 0.3), 0.0


def _either(rng: Random) -> float:
    return float(rng.random() < 0.5)


DRAWS: Final[dict[str, Callable[[Random], tuple[float, float]]]] = {
    "drop": lambda rng: (rng.uniform(0.05, 0.7), 0.0),  # share
    "delay": lambda rng: (rng.uniform(0.02, 0.4), rng.choice((0.0, 0.05, 0.2))),  # s, and jitter
    "duplicate": lambda rng: (rng.uniform(0.05, 0.5), rng.uniform(0.0, 0.4)),  # share, s behind
    "reorder": lambda rng: (rng.uniform(0.05, 0.5), rng.uniform(0.0, 0.4)),
    "one-way": lambda rng: (_either(rng), 0.0),  # 1: a lease runs out
    "partition": lambda rng: (_either(rng), 0.0),
    "twin": lambda rng: (_either(rng), 0.0),  # 1: it leaves in order
    "slow": lambda rng: (rng.choice((0.005, 0.01, rng.uniform(0.02, 0.08))), 0.0),  # s each
    "starved": lambda rng: (rng.uniform(0.01, 0.1), 0.0),  # s each
    "silent-links": lambda rng: (1.0, 0.0),  # noqa: ARG005 - share
    "links-lost": lambda rng: (_either(rng), 0.0),  # 1: a lease runs out
    "host-clock-step": lambda rng: (rng.choice((rng.uniform(0.05, 3.0), 3600.0)), 0.0),  # s
    "biased-sonar": _bias,
    "biased-laser": _bias,
    "glass": lambda rng: (rng.choice((0.3, 1.0)), 0.0),  # share of the walls
    "slip": lambda rng: (rng.uniform(0.5, 2.0), rng.choice((1.0, rng.uniform(0.5, 2.0)))),  # times
    "missing-wall": lambda rng: (rng.random(), 0.0),  # which, as a share of all
    "unmapped-box": lambda rng: (rng.random(), rng.uniform(0.1, 0.6)),  # where, and its side, m
    "version-skew": lambda rng: (_either(rng), 0.0),  # 1: another package, of the same protocol
    "clock-step": lambda rng: (rng.choice((rng.uniform(0.05, 3.0), 3600.0)), 0.0),  # s
    "clock-drift": lambda rng: (rng.uniform(0.95, 1.05), 0.0),  # times as fast
    "serial-garbage": lambda rng: (rng.uniform(0.05, 1.0), float(rng.randrange(3))),  # share, and
    "serial-loss": lambda rng: (rng.uniform(0.05, 1.0), float(rng.randrange(3))),  # both, in, out
    "stray-state": lambda rng: (float(rng.randrange(3)), 0.0),  # which
    "huge-counter": lambda rng: (
        float(rng.randrange(2)),
        float(rng.randrange(3)),
    ),  # which, how far
    "huge-term": lambda rng: (float(rng.randrange(3)), 0.0),  # which
    "huge-message": lambda rng: (float(rng.randrange(3)), 0.0),  # which
    "two-robot-agents": lambda rng: (_either(rng), 0.0),  # 1: it is present before admission
    "flood": lambda rng: (float(rng.randrange(2)), 0.0),  # 1: with ever larger ballots
    "stop-and-release": lambda rng: (float(rng.randrange(5)), 0.0),  # which
    "nan": lambda rng: (float(rng.randrange(5)), 0.0),  # which nonsense
    "flap": lambda rng: (rng.uniform(0.1, 0.8), 0.0),  # s, there and away
}
"""The `amount` and `spread` of each kind, and how they are drawn."""
