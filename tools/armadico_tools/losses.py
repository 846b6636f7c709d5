"""Agents that die or hang while a scenario is driven, under monitors: who is back, when, how often.

`python -m armadico_tools.losses SCENARIO [--seeds FROM TO] [--last S] [--jobs N]`

Each seed draws an agent, a moment and how it fails. The society is on two hosts, with a wakeup
agent and a monitor each, on the virtual mesh. It counts what must not be: a mission that does not
end, an agent that is not back, one that is started twice, one that is restarted without a reason.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Final

from armadico.cli import pool
from armadico.config.hosts import Host, HostTable
from armadico.config.scenarios import load_scenario, on_mission, society
from armadico.core.messages import Message, Stop
from armadico.launch.society import Options, names
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node

FAULTS: Final[dict[str, Callable[[Node], None]]] = {
    "killed": Node.kill,
    "hung": Node.hang,  # SIGSTOP: its token goes when the lease is over
    "deaf": lambda node: node.slow_down(1e9),  # its token stays
}

FIRST_S: Final = 2.0
LAST_S: Final = 20.0
"""When it happens, drawn evenly; the latter unless something else is said."""

LOOK_S: Final = 0.05
AFTER_S: Final = 15.0
"""So long after it the society is looked at, if it arrives sooner."""


@dataclass(frozen=True)
class Loss:
    """What came of one seed."""

    seed: int
    agent: str
    fault: str
    at_s: float
    back_s: float | None  # until another instance was at work
    ended: bool  # as asked, and nothing touched
    more: dict[str, int]  # starts besides the first, by name
    stopped: bool
    said: tuple[str, ...]

    @property
    def wrong(self) -> bool:
        """Whether anything is not as it must be."""
        return not self.ended or self.stopped or self.more != {self.agent: 1}


def hosts(agents: Sequence[str]) -> HostTable:
    """Two hosts: the robot's with what perceives, and one with the rest; a monitor on each."""
    robot, *others = agents
    first, rest = others[:3], others[3:]
    watch = society().watch
    return HostTable({"a": Host(agents=(robot, *first, *watch)), "b": Host(agents=(*rest, *watch))})


def lose(scenario: str, last_s: float, seed: int) -> Loss:
    """Drive a scenario in which one agent fails."""
    known = on_mission(load_scenario(scenario))
    rng = random.Random(f"losses/{seed}")
    agent = rng.choice((*names(known), *society().watch))
    fault, at = rng.choice(sorted(FAULTS)), rng.uniform(FIRST_S, last_s)
    options = Options(seed=seed)
    run = Rehearsal(known, options, hosts=hosts(names(known)))
    mesh = run.mesh
    begun = Counter(node.name for node in mesh.nodes)
    back: list[float] = []
    stops: list[Message] = []
    mesh.watch(lambda _key, message, _now: stops.append(message), Stop)

    def look(failed: Node, _: object) -> None:
        now = mesh.node(agent)
        if now is not failed and now.driver.started:
            back.append(mesh.now - at)
        else:
            mesh.call_at(mesh.now + LOOK_S, look, failed)

    def fail(*_: object) -> None:
        node = mesh.node(agent)
        FAULTS[fault](node)
        look(node, None)

    mesh.call_at(at, fail)
    ended = run.run().passed
    mesh.run(max(mesh.now, at + AFTER_S))
    more = Counter(node.name for node in mesh.nodes) - begun
    said = tuple(text for host in run.hosts.values() for text in host.notes)
    return Loss(
        seed,
        agent,
        fault,
        at,
        back[0] if back else None,
        ended,
        dict(more),
        bool(stops),
        said,
    )


def main(arguments: Sequence[str]) -> int:
    """Drive the seeds, and say what came of them; 1 if anything was not as it must be."""
    made = argparse.ArgumentParser(prog="python -m armadico_tools.losses")
    made.add_argument("scenario")
    made.add_argument("--seeds", nargs=2, type=int, default=(0, 20), metavar=("FROM", "TO"))
    made.add_argument("--last", type=float, default=LAST_S, metavar="S")
    made.add_argument("--jobs", type=int, default=1)
    args = made.parse_args(arguments)
    seeds = range(args.seeds[0], args.seeds[1] + 1)
    found = pool.over(
        partial(lose, args.scenario, args.last), seeds, args.jobs, "losses", _complain
    )
    for fault in FAULTS:
        losses = [loss for loss in found if loss.fault == fault]
        times = [loss.back_s for loss in losses if loss.back_s is not None]
        if losses:
            print(
                f"{fault}: {len(losses)} seeds, back in {len(times)}: median {median(times):.1f} s,"
                f" at most {max(times):.1f} s"
                if times
                else f"{fault}: {len(losses)} seeds, back in none"
            )
    wrong = [loss for loss in found if loss.wrong]
    print(f"{len(found)} seeds of {args.scenario}, {len(wrong)} in which something was wrong")
    return 1 if wrong else 0


def _complain(_seed: int, loss: Loss) -> None:
    if loss.wrong:
        print(loss, flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
