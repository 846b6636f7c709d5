"""Trials on real processes: one fault at a time, and from when to when each figure counts.

A kind of trial is a function that is given a society that drives, makes its fault, waits, and puts
everything back. The society stays up for all trials of a kind, and the phase within a cycle is
drawn anew for each. Times are the onlooker's, on the machine that everything runs on.
"""

from __future__ import annotations

import random
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from armadico.bridge.p2os.commands import Cmd
from armadico.core.resources import WHEELS
from armadico_tools.faults.real_society import RealSociety, TrialError
from armadico_tools.faults.serial_tap import moves
from armadico_tools.testbed import Namespaces

TWIN: Final = "goto-2"
"""A second instance of goto: it bids as the first does, and as good is not better, so it waits."""

CALM_S: Final = 0.6
"""Between two trials everything has been as it should for so long."""

PHASE_S: Final = 0.3
"""The moment of a fault is drawn from so long a time: three cycles."""

LONGER_THAN_A_LEASE_S: Final = 1.5
"""After so long Zenoh has given up the links of who hangs or is cut off (lease 1 s)."""

GONE_S: Final = 3.0
"""How long a host is away."""


@dataclass(frozen=True)
class Figure:
    """A time that a trial measures, from when to when, and what is aimed at, ms (None: nothing)."""

    name: str
    text: str
    median: float | None = None
    worst: float | None = None


@dataclass(frozen=True)
class Trial:
    """One kind of trial. `make` returns its figures by name, ms unless named otherwise."""

    name: str
    text: str
    figures: tuple[Figure, ...]
    make: Callable[[RealSociety, random.Random], dict[str, float]]
    twin: bool = False  # needs a second goto that stands by
    hosts: bool = False  # needs hosts with a network between them, not one machine


def settle(society: RealSociety) -> None:
    """Wait until the robot drives and, if there is a twin, both bid; then for a while."""

    def well() -> bool:
        twins = [label for label in ("goto", TWIN) if label in society.agents]
        return society.account.driving() and (
            len(twins) < 2 or all(society.bidding(label) for label in twins)
        )

    society.until(well, "the robot drives, and all bid that should")
    society.run(CALM_S)
    society.until(well, "the robot drives on")


def phase(society: RealSociety, rng: random.Random) -> None:
    """Let a time pass that is drawn: a fault may come at any moment of a cycle."""
    society.run(rng.uniform(0.0, PHASE_S))


def milliseconds(begin: float, end: float) -> float:
    """From a time to another, both s."""
    return round(1e3 * (end - begin), 1)


def _holder(society: RealSociety) -> str:
    """The goto that holds the wheels at this moment; the other one stands by."""
    account = society.account

    def held() -> str:
        label = society.label_of(account.driver or "")
        return label if label in ("goto", TWIN) else ""

    return society.until(held, "one goto or the other is obeyed")


# The table of docs/results-reliability.md ---------------------------------------------------------


def holder_killed(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGKILL the holder while another contender bids."""
    account = society.account
    phase(society, rng)
    holder = _holder(society)
    gone = society.agents[holder].instance
    with society.fault("crash", holder):
        begun = society.signal(holder, signal.SIGKILL)
        obeyed = society.until(lambda: account.obeyed_after(begun, (gone,)), "the other is obeyed")
        society.restart(holder)
    return {"next obeyed": milliseconds(begun, obeyed)}


def holder_hung(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGSTOP the holder while another contender bids; wake it after its lease has run out."""
    account = society.account
    phase(society, rng)
    holder = _holder(society)
    hung = society.agents[holder].instance
    ballot = account.view.acks[WHEELS.name].obeyed
    assert ballot is not None, "it is obeyed"
    with society.fault("hang", holder):
        begun = society.signal(holder, signal.SIGSTOP)
        try:
            obeyed = society.until(
                lambda: account.obeyed_after(begun, (hung,)), "the other is obeyed"
            )
            society.run(LONGER_THAN_A_LEASE_S)
        finally:
            woken = society.signal(holder, signal.SIGCONT)
        society.run(1.0)
    if any(b.instance == hung and b <= ballot for b in account.obeyed_ballots(woken)):
        raise TrialError(f"{hung} woke up and was obeyed with a ballot of before")
    late = account.late_commands(hung, woken, ballot)
    return {"next obeyed": milliseconds(begun, obeyed), "late commands": float(late)}


def none_left(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGKILL the only one who bids."""
    account = society.account
    phase(society, rng)
    speed = account.view.state.v if account.view.state else 0.0
    with society.fault("crash", "goto"):
        begun = society.signal("goto", signal.SIGKILL)
        stop = society.until(lambda: account.stop_after(begun), "a stop is ordered")
        rest = society.until(lambda: account.rest_after(stop), "the wheels rest")
        society.restart("goto")
    return {
        "stop": milliseconds(begun, stop),
        "rest": milliseconds(stop, rest),
        "speed mm/s": round(1e3 * speed),
    }


def robot_killed(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGKILL the robot agent; when the wheels rest, start it again."""
    account, tap = society.account, society.tap
    phase(society, rng)
    with society.fault("crash", "robot"):
        begun = society.signal("robot", signal.SIGKILL)
        rest = society.until(lambda: account.rest_after(begun), "the watchdog stops the wheels")
        society.run(0.5)
        mark = len(tap.packets)
        again = society.restart("robot")
    there = account.view.alive[society.agents["robot"].instance]
    drives = society.until(lambda: account.moves_after(again), "the wheels are ordered to turn")
    first = [c for c in tap.commands(mark) if c.number in (Cmd.VEL, Cmd.RVEL)][:2]
    if any(map(moves, first)):
        raise TrialError(f"the first speeds of the new robot agent are not zero: {first}")
    lurch = account.fastest(again, drives)
    return {
        "rest": milliseconds(begun, rest),
        "fastest mm/s": round(1e3 * account.fastest(begun, rest), 1),
        "drives": milliseconds(again, drives),
        "drives, from its token": milliseconds(there, drives),
        "fastest before mm/s": round(1e3 * lurch, 1),
    }


# With hosts ---------------------------------------------------------------------------------------


def network_of(society: RealSociety) -> Namespaces:
    """The hosts that the society is on, and the network between them."""
    place = society.place
    assert isinstance(place, Namespaces), "it needs hosts"
    return place


def on_host(society: RealSociety, host: str) -> list[str]:
    """The labels of those on a host."""
    return [agent.label for agent in society.agents.values() if agent.host == host]


@dataclass
class Cut:
    """A host's plug was pulled, put in again, and all its tokens were back, s."""

    begun: float
    healed: float = 0.0
    back: float = 0.0


@contextmanager
def unplugged(society: RealSociety, host: str) -> Iterator[Cut]:
    """Pull a host's plug, and in the end, after 3 s, put it in again."""
    network, alive = network_of(society).network, society.account.view.alive
    every = [society.agents[label].instance for label in on_host(society, host)]
    cut = Cut(society.now())
    network.change(lambda switch: switch.plug(host, False))
    yield cut
    society.until(lambda: alive.keys().isdisjoint(every), "its tokens are gone")
    society.run(max(GONE_S - (society.now() - cut.begun), 0.0))
    cut.healed = society.now()
    network.change(lambda switch: switch.plug(host, True))
    society.until(lambda: alive.keys() >= {*every}, "its tokens are back")
    cut.back = max(alive[who] for who in every)


def holder_cut_off(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """Pull the plug of the holder's host while a contender on another one bids; put it in again."""
    account = society.account
    phase(society, rng)
    holder = society.agents[_holder(society)]
    host, gone = holder.host, holder.instance
    with society.fault("partition", *on_host(society, host)), unplugged(society, host) as cut:
        obeyed = society.until(
            lambda: account.obeyed_after(cut.begun, (gone,)), "the other is obeyed"
        )
    return {
        "next obeyed": milliseconds(cut.begun, obeyed),
        "longest silence": round(1e3 * account.longest_silence(cut.begun), 1),
        "rejoined": milliseconds(cut.healed, cut.back),
    }


def host_lost(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """Pull the plug of the host of all behaviours for 3 s, and put it in again."""
    account, host = society.account, society.agents["goto"].host
    phase(society, rng)
    with society.fault("partition", *on_host(society, host)):
        with unplugged(society, host) as cut:
            stop = society.until(lambda: account.stop_after(cut.begun), "a stop is ordered")
        obeyed = society.until(lambda: account.obeyed_after(cut.healed), "the next command obeyed")
    return {
        "stop": milliseconds(cut.begun, stop),
        "rejoined": milliseconds(cut.healed, cut.back),
        "obeyed again": milliseconds(cut.healed, obeyed),
    }


_NEXT: Final = "from just before the fault to when the next command that is obeyed is published"
_REJOINED: Final = (
    "from putting the plug in to when the last of its agents' tokens is seen elsewhere"
)

TRIALS: Final = {
    trial.name: trial
    for trial in (
        Trial(
            "holder-killed",
            "the holder killed (SIGKILL), another contender alive: a second goto",
            (Figure("next obeyed", _NEXT, 200, 400),),
            holder_killed,
            twin=True,
        ),
        Trial(
            "holder-hung",
            "the holder hung (SIGSTOP), another contender alive: a second goto",
            (
                Figure("next obeyed", _NEXT, 400, 600),
                Figure("late commands", "sent on waking by the ballot of before; none was obeyed"),
            ),
            holder_hung,
            twin=True,
        ),
        Trial(
            "holder-cut-off",
            "the holder's host cut off for 3 s, another contender alive: a second goto",
            (
                Figure("next obeyed", _NEXT, 400, 600),
                Figure("longest silence", "between two orders on the line, until it is back"),
                Figure("rejoined", _REJOINED, None, 2000),
            ),
            holder_cut_off,
            twin=True,
            hosts=True,
        ),
        Trial(
            "nobody-left",
            "the holder killed, no bidder left",
            (
                Figure("stop", "from just before SIGKILL to zero speeds on the line", None, 400),
                Figure("rest", "from those to the first true speed of zero (sent each 100 ms)"),
                Figure("speed mm/s", "what it drove before"),
            ),
            none_left,
        ),
        Trial(
            "robot-killed",
            "the robot agent killed, and started again when the wheels rest",
            (
                Figure("rest", "from just before SIGKILL to the first true speed of zero"),
                Figure("fastest mm/s", "its largest true speed meanwhile"),
                Figure(
                    "drives",
                    "from starting its process to speeds on the line that are not zero",
                    None,
                    2000,
                ),
                Figure("drives, from its token", "the same from its liveliness token"),
                Figure("fastest before mm/s", "the largest true speed until then: no lurch"),
            ),
            robot_killed,
        ),
        Trial(
            "host-lost",
            "the host of all behaviours cut off for 3 s, and back",
            (
                Figure("stop", "from pulling the plug to zero speeds on the line", None, 400),
                Figure("rejoined", _REJOINED, None, 2000),
                Figure("obeyed again", "from putting the plug in to the next command obeyed"),
            ),
            host_lost,
            hosts=True,
        ),
    )
}
"""The lines of the table, by name."""
