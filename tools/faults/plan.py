"""Faults as data: a list that a seed draws, that JSON carries, and that can be shortened."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random
from typing import Annotated, Final

import msgspec
from msgspec import Meta, Struct

from armadico.config.errors import ConfigError
from armadico.tools.faults.kinds import KINDS

BEHAVIOURS: Final = ("goto", "avoid", "gothrough")
EVERYBODY: Final = (
    *("robot", "encoder", "sonar"),
    *BEHAVIOURS,
    *("path-planning", "interface"),
)
LAYOUTS: Final[tuple[tuple[tuple[str, ...], ...], ...]] = (
    (("robot", "encoder"), ("sonar",), BEHAVIOURS, ("path-planning", "interface")),
    (("robot",), ("encoder", "sonar"), BEHAVIOURS, ("path-planning", "interface")),
    (("robot", "goto"), ("encoder", "avoid"), ("sonar", "gothrough"), ("interface",)),
    (("robot", "encoder", "sonar", "avoid"), ("goto", "gothrough", "interface", "path-planning")),
)
"""Which agents share a machine: a cut goes between machines, never through one."""

BEGIN_S: Final = 4.0
"""Before this nothing goes wrong: the handshake, and the robot on its way."""

NETWORK: Final = frozenset({"drop", "delay", "duplicate", "reorder"})
CUTS: Final = frozenset({"one-way", "partition"})

VICTIMS: Final = {
    **dict.fromkeys(("nan", "lone-restart"), BEHAVIOURS),
    **dict.fromkeys(("serial-garbage", "serial-loss", "robot-restart"), ("robot",)),
    **dict.fromkeys(("silent-sonar", "frozen-sonar"), ("robot",)),
    **dict.fromkeys(("flap", "twin"), EVERYBODY[1:]),
}
"""Whom a kind may befall, if not everybody: there is one robot agent, or it is another matter."""

CALM_S: Final = (5.5, 9.0)
"""Between most faults: long enough for every promise about afterwards to be due."""

TOGETHER: Final = 0.3  # share of the faults that begin while another is on

Seconds = Annotated[float, Meta(ge=0, le=86_400)]


class Fault(Struct, frozen=True, array_like=True):
    """One fault: what, when and for how long (s), whom it befalls, and how much.

    `to` is whom messages go to, for faults of the network; `amount` is the kind's own number: a
    share, seconds, a rate or a variant, as `DRAWS` draws it; `spread` is a second one.
    """

    kind: str
    at: Seconds
    lasts: Seconds
    whom: tuple[str, ...]
    to: tuple[str, ...] = ()
    amount: float = 0.0
    spread: float = 0.0

    @property
    def until(self) -> float:
        """When it ends, s."""
        return self.at + self.lasts


class Case(Struct, frozen=True):
    """A run that can be repeated to the byte: the seed, the scenario, how long (s), the faults."""

    seed: int
    scenario: str
    lasts: Annotated[float, Meta(gt=0, le=86_400)]
    faults: tuple[Fault, ...]

    def dumps(self) -> str:
        """As one line of JSON."""
        return msgspec.json.encode(self).decode()


def loads(text: str | bytes) -> Case:
    """A case from its JSON. Raises ConfigError saying what is wrong."""
    try:
        case = msgspec.json.decode(text, type=Case)
    except msgspec.DecodeError as error:
        raise ConfigError(f"not a case of faults: {error}") from None
    for fault in case.faults:
        if fault.kind not in KINDS:
            raise ConfigError(f"no kind of fault is called {fault.kind!r}: {', '.join(KINDS)}")
        strangers = {*fault.whom, *fault.to} - {*EVERYBODY}
        if strangers:
            raise ConfigError(f"{fault.kind}: no agent is called {', '.join(sorted(strangers))}")
    return case


def draw(rng: Random, until: float, kinds: Sequence[str]) -> tuple[Fault, ...]:
    """Faults for a run of so many seconds, in the order of their beginnings."""
    faults: list[Fault] = []
    at = BEGIN_S
    while True:
        if faults and rng.random() < TOGETHER:
            at = rng.uniform(faults[-1].at, faults[-1].until)
        elif faults:
            at = max(fault.until for fault in faults) + rng.uniform(*CALM_S)
        fault = _draw_one(rng, rng.choice(kinds), round(at, 3))
        if fault.until > until:
            return tuple(sorted(faults, key=lambda f: f.at))
        faults.append(fault)


def _draw_one(rng: Random, kind: str, at: float) -> Fault:
    lasts = rng.choice((rng.uniform(0.05, 0.6), rng.uniform(0.4, 2.5), rng.uniform(2.0, 6.0)))
    whom, to = _whom(rng, kind)
    amount, spread = _amounts(rng, kind)
    return Fault(kind, at, round(lasts, 3), whom, to, round(amount, 4), round(spread, 4))


def _whom(rng: Random, kind: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Whom a fault befalls, and on the way to whom."""
    if kind in NETWORK and rng.random() < 0.4:
        return EVERYBODY, EVERYBODY
    if kind in NETWORK or kind in CUTS:
        return _sides(rng)
    return (rng.choice(VICTIMS.get(kind, EVERYBODY)),), ()


def _sides(rng: Random) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Some machines, and some of the others."""
    layout = list(rng.choice(LAYOUTS))
    rng.shuffle(layout)
    here = rng.randint(1, len(layout) - 1)
    there = rng.randint(here + 1, len(layout))
    return _names(layout[:here]), _names(layout[here:there])


def _names(machines: Sequence[Sequence[str]]) -> tuple[str, ...]:
    return tuple(name for machine in machines for name in machine)


def _amounts(rng: Random, kind: str) -> tuple[float, float]:
    """The kind's own numbers."""
    drawn = DRAWS.get(kind)
    return drawn(rng) if drawn is not None else (0.0, 0.0)


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
    "slow": lambda rng: (rng.choice((0.005, 0.02, rng.uniform(0.02, 0.08))), 0.0),  # s each
    "clock-step": lambda rng: (rng.choice((rng.uniform(0.05, 3.0), 3600.0)), 0.0),  # s
    "clock-drift": lambda rng: (rng.uniform(0.95, 1.05), 0.0),  # times as fast
    "serial-garbage": lambda rng: (rng.uniform(0.05, 1.0), float(rng.randrange(3))),  # share, and
    "serial-loss": lambda rng: (rng.uniform(0.05, 1.0), float(rng.randrange(3))),  # both, in, out
    "nan": lambda rng: (float(rng.randrange(5)), 0.0),  # which nonsense
    "flap": lambda rng: (rng.uniform(0.1, 0.8), 0.0),  # s, there and away
}
"""What a kind's `amount` and `spread` are, and how they are drawn."""
