"""The kinds of faults, and which promises each of them takes away while it lasts.

A promise that a fault voids is not broken by it: with the robot agent dead nobody can order a stop,
and the wheels roll until the controller's own watchdog holds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final


class Promise(StrEnum):
    """What the checker watches over."""

    ONE_DRIVER = "within an epoch the ballots that are obeyed never go down"
    FRESH = "what answers a cycle long past is refused, however late it comes"
    ONE_HOLDER = "in a whole network no two tenures go on for 5 cycles"
    OBEYED = "in a whole network somebody is obeyed within 5 s if anyone bids"
    SILENCE = "a stop is ordered within 0.4 s of the last valid command"
    WATCHDOG = "without the robot agent the controller's watchdog stops the wheels"
    SMOOTH = "speeds change by no more than the ramps allow, and a hand-over stays between both"
    COLLISION = "nothing is touched"
    ODOMETRY = "the odometry moves where it heads, whatever has befallen the line"
    NO_ERROR = "no agent raises an error"
    MOVES = "after healing the robot moves within 2 s (5 s after standing back), or bids say why"


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    `breaks`: whether the network or its processes are not whole while it lasts, so that promises
    about a whole network wait for its end. `voids` while it lasts, and until the robot has come to
    rest or driven on for a while: those promises count for nothing.
    """

    name: str
    meaning: str
    breaks: bool = True
    voids: frozenset[Promise] = frozenset()


ROBOT_VOIDS: Final = frozenset({Promise.SILENCE, Promise.COLLISION, Promise.SMOOTH})
"""What nobody keeps without the robot agent: the wheels roll on blindly, for up to 2 s."""

_LINE: Final = frozenset({Promise.COLLISION, Promise.SMOOTH})
"""With the line to the controller broken a stop is ordered, and may not arrive."""

_BLIND: Final = frozenset({Promise.COLLISION})
"""Readings that are there and wrong cannot be told from right ones; those that lack can."""

KINDS: Final = {
    kind.name: kind
    for kind in (
        Kind("drop", "messages between some of the agents are lost"),
        Kind("delay", "messages between some of the agents take longer"),
        Kind("duplicate", "messages between some of the agents come twice"),
        Kind("reorder", "messages between some of the agents overtake one another"),
        Kind("one-way", "some hosts no longer reach others, which still reach them"),
        Kind("partition", "some hosts and the others no longer reach each other"),
        Kind("crash", "an agent is killed, and started again at the end"),
        Kind("hang", "an agent hangs, and wakes at the end to all that waited"),
        Kind("slow", "an agent needs long for each message"),
        Kind("clock-step", "an agent's clock jumps ahead", breaks=False),
        Kind("clock-drift", "an agent's clock runs fast or slow", breaks=False),
        Kind("serial-garbage", "bytes on the line to the controller are spoilt", voids=_LINE),
        Kind("serial-loss", "bytes on the line to the controller are lost", voids=_LINE),
        Kind("silent-sonar", "no sonar fires", breaks=False),
        Kind("frozen-sonar", "the sonars repeat what they heard", breaks=False, voids=_BLIND),
        Kind("nan", "an agent's bids are not numbers", breaks=False),
        Kind("flap", "an agent comes and goes, several times a second"),
        Kind("lone-restart", "one behaviour is left, and is started again"),
        Kind("robot-restart", "the robot agent is started again, with old commands under way"),
        Kind("twin", "a second instance of an agent joins, and leaves", breaks=False),
    )
}
"""Every kind by its name."""

DISABLES: Final = frozenset({"crash", "hang", "slow", "flap", "robot-restart"})
"""Kinds that void `ROBOT_VOIDS` if it is the robot agent that they befall."""


FORGETS: Final = frozenset({"crash", "flap"})
"""Kinds after which the sonar agent has forgotten what its sonars no longer look at: the sides and
the back of the robot, which it may then turn into something that it has passed."""

WEDGED_M: Final = 0.07
"""Nearer to something than this, m, by a fault that voids contacts, contacts stay void until it has
got clear: the sonars' least range is 0.1 m, so on the flank nobody can tell 7 cm from touching, and
behind nobody hears at all. What was passed while the robot agent hung was not heard either."""


def voided(kind: str, whom: tuple[str, ...]) -> frozenset[Promise]:
    """The promises that a fault takes away."""
    voids = KINDS[kind].voids
    if kind in FORGETS and "sonar" in whom:
        voids |= _BLIND
    return voids | ROBOT_VOIDS if kind in DISABLES and "robot" in whom else voids
