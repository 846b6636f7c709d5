"""The kinds of faults, and which promises each of them takes away while it lasts.

A promise that a fault voids is not broken by it: with the robot agent dead none can order a stop,
and the wheels roll until the controller's own watchdog holds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import Final


class Promise(StrEnum):
    """What the checker watches over."""

    ONE_DRIVER = "within an epoch the ballots that are obeyed never go down"
    FRESH = "what answers a cycle long past is refused, however late it comes"
    ONE_HOLDER = "in a whole network no two tenures go on for 5 cycles"
    OBEYED = "in a whole network a command is obeyed within 5 s if anyone bids"
    SILENCE = "a stop is ordered within 0.4 s of the last valid command"
    WATCHDOG = "without the robot agent the controller's watchdog stops the wheels"
    SMOOTH = "speeds change by no more than the ramps allow, and a hand-over stays between both"
    COLLISION = "nothing is touched"
    ODOMETRY = "the odometry moves where it heads, whatever has befallen the line"
    NO_ERROR = "no agent raises an error"
    MOVES = "after healing the robot moves within 2 s (5 s after standing back), or bids say why"
    HANDOVER = "a holder that falls silent is replaced before the stop, if another bids"
    STOP = "once stopped the wheels rest in time, and no agent drives until it is released"
    POSE = "the pose is not wrong and unsaid: its error is what its covariance says"
    ARRIVES = "a mission that no fault befalls for long is reached"


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    `breaks`: whether the network or its processes are not whole while it lasts, so that promises
    about a whole network wait for its end; `excuses`: whether the robot need not move meanwhile.
    `voids` while it lasts, and until the robot has come to rest or driven on for a while: those
    promises count for nothing, `why` being the reason; only if the fault's amount is at least
    `least`. A seed draws the kind with this `weight`.
    """

    name: str
    meaning: str
    breaks: bool = True
    voids: frozenset[Promise] = frozenset()
    why: str = ""
    least: float = 0.0
    blinds: bool = False
    weight: float = 1.0

    @property
    def excuses(self) -> bool:
        """Whether the robot need not move while it lasts."""
        return self.breaks or self.blinds


ROBOT_VOIDS: Final = frozenset({Promise.SILENCE, Promise.COLLISION, Promise.SMOOTH})
"""What is not kept without the robot agent: the wheels roll on blindly, for up to 2 s."""

_LINE: Final = frozenset({Promise.COLLISION, Promise.SMOOTH})
"""With the line to the controller broken a stop is ordered, and may not arrive."""

_BLIND: Final = frozenset({Promise.COLLISION})
"""Readings that are there and wrong look like right ones; those that lack are noticed."""

LOSSY: Final = 0.25
"""A line that loses or spoils less than this share of what is written is no excuse. Each cycle
orders anew: of three orders in a row it loses all with a chance of 1.6 %, so a stop arrives within
0.3 s; and ten in a row, after which the link counts as lost, never. With 0.3 nothing was touched in
24 simulated minutes."""

SLOW_S: Final = 0.015
"""A robot agent that needs less than this for each message is no excuse. In a cycle it takes about
five (a status packet, a command, a claim, one or two more), which is 75 ms of the cycle's 100: it
keeps up, and orders a stop late by one or two messages, for which 0.4 s instead of 0.3 s is
promised. From 20 ms on what waits for it grows for as long as it is slow. With 19.9 ms no promise
was broken in 24 simulated minutes."""

AGAIN_S: Final = 1.0
"""Who may not join while no other of its name is alive is started again after this, s, as by
`armadico up`."""

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
        Kind("hang", "an agent hangs, and wakes at the end to all that waited", weight=2.0),
        Kind("slow", "an agent needs long for each message"),
        Kind("clock-step", "an agent's clock jumps ahead", breaks=False),
        Kind("clock-drift", "an agent's clock runs fast or slow", breaks=False),
        Kind(
            *("serial-garbage", "bytes on the line to the controller are spoilt"),
            voids=_LINE,
            why="serial line",
            least=LOSSY,
        ),
        Kind(
            *("serial-loss", "bytes on the line to the controller are lost"),
            voids=_LINE,
            why="serial line",
            least=LOSSY,
        ),
        Kind("silent-sonar", "no sonar fires", breaks=False, blinds=True),
        Kind(
            *("frozen-sonar", "the sonars repeat their last ranges"),
            breaks=False,
            voids=_BLIND,
            why="sonars repeat themselves",
        ),
        Kind("nan", "an agent's bids are not numbers", breaks=False),
        Kind("flap", "an agent comes and goes, several times a second"),
        Kind("lone-restart", "one behaviour is left, and is started again"),
        Kind("robot-restart", "the robot agent is started again, with old commands under way"),
        Kind("twin", "a second instance of an agent joins, and leaves", breaks=False),
        Kind("stop", "a peer stops the robot, and releases it at the end", breaks=False),
        Kind("interface-restart", "the interface agent is killed in mid-mission, and started"),
        Kind(
            "in-turn",
            "robot, encoder and localization agent are started again in turn, in any order",
        ),
        Kind(
            "stray-state",
            "a robot/state of a cycle that never was, or many that climb, arrives everywhere",
        ),
        Kind("huge-term", "a stranger's claim or ack with an enormous term arrives everywhere"),
        Kind("huge-counter", "the mission or the origin, counted far beyond, arrives everywhere"),
        Kind("flood", "a stranger publishes thousands of claims and commands", weight=0.5),
        Kind(
            *(
                "huge-message",
                "a message that is as large as may be, or larger, arrives everywhere",
            ),
            weight=0.5,
        ),
        Kind(
            "stop-and-release",
            "a peer stops and releases, also by old counters and old stops",
        ),
        Kind(
            "two-robot-agents",
            "a second robot agent with a controller of its own comes and goes",
        ),
    )
}
"""Every kind by its name."""

RESTARTS: Final = frozenset({"crash", "flap", "robot-restart"})
"""Kinds after which another process is there; `in-turn` shows each as a crash of its own."""

DISABLES: Final = RESTARTS | {"hang", "slow"}
"""Kinds that void `ROBOT_VOIDS` if it is the robot agent that they befall."""

CLAIMS: Final = frozenset({"huge-term", "flood"})
"""Kinds by which a stranger claims the wheels, and no watcher is shown it."""

STRANGE_UTILITY: Final = 0.9
"""The utility of a stranger's claims."""

FORGETS: Final = frozenset({"crash", "flap"})
"""Kinds after which the sonar agent has forgotten what its sonars no longer look at: the sides and
the back of the robot, which it may then turn into something that it has passed."""

WEDGED_M: Final = 0.07
"""Nearer to something than this, m, by a fault that voids contacts, contacts stay void until it has
got clear: the sonars' least range is 0.1 m, so on the flank 7 cm looks like touching, and behind
there is no sonar. What was passed while the robot agent hung was not received either."""

WEDGED_S: Final = 15.0
"""But for no longer than this, s: whoever creeps away from a wall at 1 cm/s has got clear."""


def voided(kind: str, whom: tuple[str, ...], amount: float = inf) -> dict[Promise, str]:
    """The promises that a fault takes away, and in a word why."""
    made = KINDS[kind]
    voids = dict.fromkeys(made.voids, made.why) if amount >= made.least else {}
    if kind in FORGETS and "sonar" in whom:
        voids |= dict.fromkeys(_BLIND, "sonar agent restarted")
    if kind in DISABLES and "robot" in whom and (kind != "slow" or amount >= SLOW_S):
        voids |= dict.fromkeys(ROBOT_VOIDS, "robot agent away")
    return voids
