"""The nearest admissible command: one rule for behaviours and for the owner of the wheels.

A command is admissible if the whole motion that it may cause (`motion`) touches nothing that was
sensed, and stays within what was seen to be free. Unseen is not free: through it a robot may only
creep, so slowly that its sensors show what comes before it is reached, if they face that way. The
robot agent admits only what leaves rest admissible in its next cycle, too; otherwise it would admit
and refuse a command by turns.

The robot agent applies the rule to every command, with its own newest readings and the shortest
delays (`bridge/reflex.py`). Behaviours apply it with the points of the mesh, wider margins and the
time that a bid may wait (`safety`), so they are stricter, and the robot agent seldom intervenes.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, hypot, inf
from typing import NamedTuple

from armadico.mobile.motion import Body, Floats, Speeds, ramped, touches_at

CREEP_M_S = 0.2
"""Speed of the axle's middle, and of a corner that turns, through what nobody has seen. At 0 a
robot with sensors on one side would never turn round. Chosen on floor plans: with 0.1 they took 4 %
more time, since many begin with a turn."""

TOUCH_M = 0.02
"""Least distance left to what was sensed."""

HALVINGS = 4
"""Steps of the search for the fastest admissible speed: to 1/16 of the commanded one."""

TURNS = (1.0, 0.6, 0.3, 0.0)
"""Shares of the wanted turn rate that are tried. Where a corner of the footprint would hit an
obstacle, the robot turns less and drives on."""

REST: Speeds = (0.0, 0.0)

OBSTACLE, UNSEEN, TOO_LATE = "an obstacle is in the way", "not seen to be free", "it brakes"


class View(NamedTuple):
    """What the sensors have shown, in the body frame, m."""

    points: Floats  # (n, 2): where something was sensed
    unseen: Floats  # (m, 2): the middles of cells where no sensor has looked lately
    apart_m: float  # from such a middle to the cell's edge
    noise_m: float = 0.0  # by which a point may be nearer


class Admitted(NamedTuple):
    """Speeds to obey, m/s and rad/s, and why they are not the commanded ones; "": they are."""

    v: float
    w: float
    why: str


def admit(
    body: Body,
    measured: Speeds,
    command: Speeds,
    view: View,
    waited: float = 0.0,
    also: Speeds | None = None,
) -> Admitted:
    """Return the admissible command nearest to one.

    Args:
        body: The robot, and the bounds of the delays: `dead_s`, and `silence_s` until the command
            is checked again.
        measured: (v, w) by the wheels, m/s and rad/s.
        command: (v, w), m/s and rad/s.
        view: What the newest readings show.
        waited: The age of the readings, s.
        also: Other speeds that it may have, m/s and rad/s: a turn that has not begun yet bends no
            path away from a wall.
    """
    starts = [measured] if also is None or also == measured else [measured, also]
    corner = hypot(max(body.outline.front, body.outline.rear), body.outline.half_width)

    def clear(points: Floats, wanted: Speeds, margin: float) -> bool:
        return not len(points) or all(
            touches_at(body, start, wanted, points, margin, waited=waited) == inf
            for start in starts
        )

    margin = TOUCH_M + view.noise_m

    def unseen_stops(wanted: Speeds) -> bool:
        creeps = abs(wanted[0]) + corner * abs(wanted[1]) <= CREEP_M_S
        return not (creeps or clear(view.unseen, wanted, view.apart_m))

    going = starts[-1]

    def can_still_rest(wanted: Speeds) -> bool:
        """Whether rest will be admissible in the next cycle, when the ramps are on their way."""
        begun = ramped(body, going, wanted, body.cycle_s)
        if abs(begun[0]) <= abs(going[0]) and abs(begun[1]) <= abs(going[1]):
            return True
        later = waited + body.cycle_s
        return touches_at(body, begun, REST, view.points, margin, waited=later) == inf

    def admissible(wanted: Speeds) -> bool:
        if not clear(view.points, wanted, margin) or unseen_stops(wanted):
            return False
        return not len(view.points) or can_still_rest(wanted)

    found = nearest(command, admissible, CREEP_M_S)
    if found == command:
        return Admitted(*command, "")
    if found is None:
        return Admitted(0.0, 0.0, TOO_LATE if any(command) else "")
    why = UNSEEN if clear(view.points, command, margin) else OBSTACLE
    return Admitted(*found, why)


def nearest(
    wanted: Speeds, admissible: Callable[[Speeds], bool], slow: float = 0.0
) -> Speeds | None:
    """Return the admissible speeds nearest to the wanted ones, m/s and rad/s; None: none are.

    First v is reduced and w kept: the robot turns more tightly near an obstacle, away from it or
    along it. Where a corner of the footprint would still hit an obstacle, w is reduced. Up to the
    speed `slow`, m/s, more is admissible: a search from zero may miss it.
    """
    v, w = wanted
    if admissible(wanted):
        return wanted
    for share in TURNS:
        turn = share * w
        if admissible((0.0, turn)):
            return _fastest(v, turn, admissible, slow), turn
        if w == 0.0:
            break
    return None


def _fastest(v: float, w: float, admissible: Callable[[Speeds], bool], slow: float) -> float:
    """Return the fastest admissible speed up to v with this turn, m/s; 0 is admissible."""
    least, most = 0.0, v
    if 0.0 < slow < abs(v) and admissible((copysign(slow, v), w)):
        least = copysign(slow, v)
    for _ in range(HALVINGS):
        middle = 0.5 * (least + most)
        if admissible((middle, w)):
            least = middle
        else:
            most = middle
    return least
