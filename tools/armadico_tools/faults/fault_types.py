"""The kinds of faults, and the promises that each voids while it lasts.

A fault does not break a promise that it voids: with a broken line to the controller a stop may not
arrive. Without the robot agent the guard of its line brakes, so its absence voids nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, Final

from armadico.observe.audit.promises import Promise as Promise  # noqa: PLC0414 (exported)


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    `breaks`: the network or its processes are not whole while it lasts, so promises about a whole
    network wait for its end. `excuses`: the robot need not move meanwhile. `voids`: promises that
    do not count while it lasts, and until the robot has come to rest or driven on for a while, if
    the fault's amount is at least `least`; `why` is the reason. `weight`: of the kind in a draw.
    `only`: what a robot or world must have: `sonar`, `laser`, a `serial` line, inner `walls`, or
    free `places`.
    """

    name: str
    meaning: str
    breaks: bool = True
    voids: frozenset[Promise] = frozenset()
    why: str = ""
    least: float = 0.0
    blinds: bool = False
    weight: float = 1.0
    only: str = ""

    @property
    def excuses(self) -> bool:
        """Whether the robot need not move while it lasts."""
        return self.breaks or self.blinds


_LINE: Final = frozenset({Promise.COLLISION, Promise.SMOOTH})
"""With the line to the controller broken a stop is ordered, but may not arrive."""

_BLIND: Final = frozenset({Promise.SENSORS})
"""Wrong readings look like right ones; missing readings are noticed."""

LOSSY: Final = 0.25
"""A line that loses or corrupts less than this share of what is written voids nothing. Each cycle
orders anew. It loses three orders in a row with a probability of 1.6 %, so a stop arrives within
0.3 s; it practically never loses ten, after which the link counts as lost. With 0.3 there was no
contact in 24 simulated minutes."""

AGAIN_S: Final = 1.0
"""A process that may not join while no other of its name is alive is restarted after this, s, as by
`armadico up`."""

_GLASS: Final[dict[str, Any]] = {
    "breaks": False,
    "voids": _BLIND,
    "why": "glass",
    "only": "laser",
}
_JUMPS: Final[dict[str, Any]] = {
    "breaks": False,
    # By its clock the robot agent was silent for long, so the base may rest already.
    "voids": frozenset({Promise.SMOOTH}),
    "why": "clock jumped",
}
_HELD: Final[dict[str, Any]] = {
    "breaks": False,
    "blinds": True,
    "voids": frozenset({Promise.SMOOTH}),
    "why": "wheels blocked",
}

UNNOTICED_M: Final = 0.05
"""Ranges that are too long by less than this void nothing (a choice): the robot keeps more than
this distance from what it detects."""


def _ranges(name: str, sensors: str) -> tuple[Kind, ...]:
    """The faults of range sensors."""
    repeats: dict[str, Any] = {
        "breaks": False,
        "voids": _BLIND,
        "only": name,
        "why": f"{sensors} repeat readings",
    }
    biased: dict[str, Any] = {**repeats, "why": f"{sensors} biased", "least": UNNOTICED_M}
    return (
        Kind(
            f"silent-{name}", f"the {sensors} report nothing", breaks=False, blinds=True, only=name
        ),
        Kind(
            *(f"frozen-{name}", f"the {sensors} repeat their last ranges"),
            blinds=name == "laser",  # as a laser has noise, the robot notices, and stands
            **repeats,
        ),
        Kind(f"repeating-{name}", f"the {sensors} repeat their last five readings", **repeats),
        Kind(f"biased-{name}", f"the {sensors} report ranges too long or too short", **biased),
    )


KINDS: Final = {
    kind.name: kind
    for kind in (
        Kind("drop", "messages between some of the agents are lost"),
        Kind("delay", "messages between some of the agents take longer"),
        Kind("duplicate", "messages between some of the agents come twice"),
        Kind("reorder", "messages between some of the agents overtake one another"),
        Kind("one-way", "some hosts no longer reach others, which still reach them"),
        Kind("partition", "some hosts and the others no longer reach each other"),
        Kind("crash", "an agent is killed, and started again at the end", weight=2.0),
        Kind("hang", "an agent hangs, then resumes with all that waited", weight=2.0),
        Kind("slow", "an agent takes long for each message"),
        Kind("starved", "all agents of a host take long for each message, for lack of processor"),
        Kind("links-lost", "no agent reaches another, and all connections end or their lease does"),
        Kind("silent-links", "connections stay up, but nothing flows between some hosts"),
        Kind("clock-step", "an agent's clock jumps ahead", **_JUMPS),
        Kind("host-clock-step", "the clock of a host, for all its agents, jumps ahead", **_JUMPS),
        Kind("clock-drift", "an agent's clock runs fast or slow", breaks=False),
        Kind(
            *("serial-garbage", "bytes on the line to the controller are corrupted"),
            voids=_LINE,
            why="serial line",
            least=LOSSY,
            only="serial",
        ),
        Kind(
            *("serial-loss", "bytes on the line to the controller are lost"),
            voids=_LINE,
            why="serial line",
            least=LOSSY,
            only="serial",
        ),
        *_ranges("sonar", "sonars"),
        *_ranges("laser", "laser"),
        Kind(
            "glass", "some walls turn to glass, which the laser sees from the front only", **_GLASS
        ),
        Kind(
            *("slip", "one or both wheels turn more, or less, than they roll"),
            breaks=False,
            voids=frozenset({Promise.SMOOTH}),
            why="wheels slip",
        ),
        Kind("blocked-wheels", "the wheels are blocked", **_HELD),
        Kind("missing-wall", "a wall of the map is not there", breaks=False, only="walls"),
        Kind("unmapped-box", "a box is there that is not on the map", breaks=False, only="places"),
        Kind("version-skew", "an agent of another protocol or package version joins", breaks=False),
        Kind("nan", "an agent's bids are not numbers", breaks=False),
        Kind("flap", "an agent comes and goes, several times a second"),
        Kind("lone-restart", "only one behaviour is left, and is restarted"),
        Kind("robot-restart", "the robot agent is restarted, with old commands under way"),
        Kind("twin", "a second instance of an agent joins, and leaves", breaks=False),
        Kind("stop", "a peer stops the robot, and releases it at the end", breaks=False),
        Kind("interface-restart", "the interface agent is killed in mid-mission, and restarted"),
        Kind(
            "in-turn",
            "robot, encoder and localization agent are restarted one after another, in any order",
        ),
        Kind(
            "stray-state",
            "a robot/state of a cycle that never existed, or a rising series, arrives everywhere",
        ),
        Kind("huge-term", "a stranger's claim or ack with an enormous term arrives everywhere"),
        Kind("huge-counter", "the mission or the origin, with a huge counter, arrives everywhere"),
        Kind("flood", "a stranger publishes thousands of claims and commands", weight=0.5),
        Kind(
            *(
                "huge-message",
                "a message of maximum size, or larger, arrives everywhere",
            ),
            weight=0.5,
        ),
        Kind(
            "stop-and-release",
            "a peer stops and releases, also with old counters and old stops",
        ),
        Kind(
            "two-robot-agents",
            "a second robot agent with a controller of its own comes and goes",
        ),
    )
}
"""Every kind by its name."""

TOLERATED: Final = frozenset({"duplicate", "reorder", "version-skew", "stop"})
"""Kinds under which a robot drives on: they excuse it from no outcome."""

LOSES, LATE_S = 0.3, 0.1
"""A network that loses a smaller share, or is late by less, s, excuses from no outcome."""


def hinders(kind: str, amount: float = inf) -> bool:
    """Whether a fault may keep a robot from driving, or make its readings wrong."""
    if kind in TOLERATED:
        return False
    made = KINDS[kind]
    serial = kind.startswith("serial")  # a wrong reading now and then halts the robot
    least = {"drop": LOSES, "delay": LATE_S}.get(kind, 0.0 if serial else made.least)
    return (made.excuses or bool(made.voids)) and abs(amount) >= least


RESTARTS: Final = frozenset({"crash", "flap", "robot-restart"})
"""Kinds that replace a process; `in-turn` shows each as a crash."""

SLOWS: Final = frozenset({"slow", "starved"})

CLAIMS: Final = frozenset({"huge-term", "flood"})
"""Kinds in which a stranger claims the wheels, unseen by watchers."""

STRANGE_UTILITY: Final = 0.9
"""The utility of a stranger's claims."""


def voided(kind: str, amount: float = inf) -> dict[Promise, str]:
    """The promises that a fault voids, with the reasons."""
    made = KINDS[kind]
    return dict.fromkeys(made.voids, made.why) if amount >= made.least else {}
