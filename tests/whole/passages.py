"""Three robots pass a corridor, by several mechanisms: python -m tests.whole.passages [RUNS].

The robots drive straight on at 0.4 m/s (`tests.fleet.corridor`), so the passing alone is measured,
by the real giveway agents, arbiters and messages. Starts and moments are drawn for each seed and
are the same for all mechanisms.
"""

from __future__ import annotations

import random
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

from armadico.agents.rivals.queues import Mutex, MutexParameters, RightOfWay
from armadico.core.agent import Identity
from tests.fleet.corridor import Fleet, Robot, corridor, lossy

BALLOTS: Final = "ballots"
KINDS: Final = {kind.name: kind for kind in (Mutex, RightOfWay)}

NONE, LOST = "nothing", "messages lost"
ONLY, AGAIN, SPARE = "the only arbiter", "the only arbiter, restarted", "an arbiter of three"
FAILURES: Final = (NONE, LOST, ONLY, AGAIN, SPARE)

LIMIT_S: Final = 180.0
LOST_S: Final = 60.0  # from the start, messages are lost:
LOSS, CUT = 0.5, 0.2  # a share of all messages, and of each link's periods
AGAIN_S: Final = 2.0  # after a kill an arbiter is restarted
FIRST_SEED: Final = 1000


@dataclass(frozen=True)
class Passed:
    """The result of a run."""

    time_s: float | None  # None: not all have arrived
    waited_s: float  # of all robots
    messages: float  # a second, of all robots and arbiters
    most: int  # robots in the corridor at once


def run(mechanism: str, failure: str, seed: int, world: str) -> Passed:
    """Let three robots pass, of which at least one comes from each side."""
    draw = random.Random(f"passages/{seed}")
    by = None if mechanism == BALLOTS else mechanism
    left, right = [draw.uniform(0.5, 4.0)], [draw.uniform(14.0, 17.5)]
    side = draw.choice((left, right))
    side.append(side[0] + (-1.3 if side is left else 1.3))
    goals = {id(left): (15.0, 16.5), id(right): (3.0, 1.5)}
    robots = [
        Robot(f"r{k}", world, x, goal, coordination=by)
        for k, (x, goal) in enumerate(
            (x, goal)
            for xs in (left, right)
            for x, goal in zip(xs, reversed(goals[id(xs)]), strict=False)
        )
    ]
    draw.shuffle(robots)
    count = 3 if failure == SPARE else 1
    arbiters = [_arbiter(by, f"r{k}") for k in range(count)] if by else []
    fleet = Fleet(*robots, arbiters=arbiters)
    kill_at = draw.uniform(4.0, 40.0)
    if failure == LOST:
        fleet.lost = lossy(fleet, draw, LOSS, CUT, LOST_S)
    waited = 0.0
    while fleet.now < LIMIT_S and not fleet.arrived:
        fleet.run(0.1)
        waited += 0.1 * sum(r.speed == (0.0, 0.0) and not r.there for r in robots)
        if failure in (ONLY, AGAIN, SPARE) and fleet.now >= kill_at > 0.0:
            fleet.arbiters.pop(arbiters[0].instance)
            kill_at = -1.0
            back_at = fleet.now + AGAIN_S
        if failure == AGAIN and kill_at == -1.0 and fleet.now >= back_at and by:
            fleet.begin(_arbiter(by, "r0", 2))
            kill_at = -2.0
    time_s = fleet.now if fleet.arrived else None
    return Passed(time_s, waited, fleet.sent / fleet.now, fleet.most)


def _arbiter(name: str, robot: str, start: int = 1) -> Mutex:
    kind = KINDS[name]
    return kind(Identity(f"{name}-{robot}{start}"), MutexParameters(namespace=f"lab/{robot}"))


def main(runs: int) -> None:
    """Write a row of a table for each mechanism and failure."""
    head = ("fails", "mechanism", "all arrived", "time, s", "waited, s", "messages a second")
    _row(*head, "two inside")
    _row(*(["---"] * 7))
    seeds = range(FIRST_SEED, FIRST_SEED + runs)
    with tempfile.TemporaryDirectory() as folder:
        world = corridor(Path(folder))
        for failure in FAILURES:
            for mechanism in (BALLOTS, *KINDS) if failure in (NONE, LOST) else (Mutex.name,):
                found = [run(mechanism, failure, seed, world) for seed in seeds]
                times = [each.time_s for each in found if each.time_s is not None] or [LIMIT_S]
                _row(
                    *(failure, mechanism),
                    f"{sum(each.time_s is not None for each in found)} of {runs}",
                    f"{median(times):.0f} ({min(times):.0f} to {max(times):.0f})",
                    f"{median(each.waited_s for each in found):.0f}",
                    f"{median(each.messages for each in found):.0f}",
                    f"{sum(each.most > 1 for each in found)} of {runs}",
                )


def _row(*cells: str) -> None:
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
