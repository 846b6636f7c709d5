"""Faults on real processes that no figure of the table is about: the checker of promises looks on.

Each trial makes one fault, lets it last, takes it away, and waits until the robot drives again.
"""

from __future__ import annotations

import random
import signal
from collections.abc import Callable
from typing import Final

from armadico.mesh.link_faults import LinkFaults
from armadico_tools.faults.real_society import RealSociety, TrialError
from armadico_tools.faults.real_trials import (
    LONGER_THAN_A_LEASE_S,
    Figure,
    Trial,
    milliseconds,
    network_of,
    on_host,
    phase,
)
from armadico_tools.testbed import WATCHER

LASTS_S: Final = 3.0
"""How long links are out."""

BAD_S: Final = 8.0
"""How long links are bad."""

DRIVES_ON: Final = 0.9
"""The share of cycles in which a command must be obeyed where the robot is to drive on."""


def _drives(society: RealSociety, since: float) -> float:
    """Wait until the robot is driven again; ms since then."""
    account = society.account
    moves = society.until(lambda: account.moves_after(since), "speeds are ordered again")
    society.until(account.driving, "the robot is on its way again")
    return milliseconds(since, moves)


def kill_one(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGKILL an agent, a different one each time, and start it again 1 s later."""
    label = society.next_agent()
    phase(society, rng)
    with society.fault("crash", label):
        society.signal(label, signal.SIGKILL)
        society.run(1.0)
        again = society.restart(label)
    return {"drives": _drives(society, again)}


def hang_one(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGSTOP an agent, a different one each time, for longer than its lease."""
    label = society.next_agent()
    phase(society, rng)
    with society.fault("hang", label):
        society.signal(label, signal.SIGSTOP)
        try:
            society.run(LONGER_THAN_A_LEASE_S)
        finally:
            woken = society.signal(label, signal.SIGCONT)
    return {"drives": _drives(society, woken)}


def simulator_gone(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """SIGKILL the simulator, and with it its TCP line; start it again 1 s later."""
    phase(society, rng)
    # Of the kinds that the checker knows, the one that takes away the same promises: with no line
    # nothing can be ordered, and a simulator that comes back stands still.
    with society.fault("robot-restart", "robot"):
        society.kill_simulator()
        society.run(1.0)
        begun = society.now()
        society.start_simulator()
        return {"drives": _drives(society, begun)}


def link_down(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """Put the card of a host down, a different one each time, for 3 s."""
    hosts = society.place.hosts
    host = hosts[society.count % len(hosts)]
    society.count += 1
    card = network_of(society).network.hosts[host]
    phase(society, rng)
    with society.fault("partition", *on_host(society, host)):
        card.carrier(False)
        society.run(LASTS_S)
        card.carrier(True)
        return _after_a_cut(society, society.now())


def partition(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """Let the first half of the hosts and the others not reach each other for 3 s."""
    network = network_of(society).network
    hosts = society.place.hosts
    here, there = hosts[: len(hosts) // 2], hosts[len(hosts) // 2 :]
    phase(society, rng)
    with society.fault("partition", *(who for host in there for who in on_host(society, host))):
        network.change(lambda switch: switch.partition((*here, WATCHER), there))
        society.run(LASTS_S)
        network.change(lambda switch: switch.heal())
        return _after_a_cut(society, society.now())


def _after_a_cut(society: RealSociety, healed: float) -> dict[str, float]:
    account = society.account
    alive = account.view.alive
    every = [agent.instance for agent in society.agents.values()]
    society.until(lambda: alive.keys() >= {*every}, "all tokens are back")
    back = max(healed, *(alive[who] for who in every))
    return {"rejoined": milliseconds(healed, back), "drives": _drives(society, healed)}


def _bad_links(
    society: RealSociety,
    rng: random.Random,
    kind: str,
    faults: LinkFaults,
    check: Callable[[float, float], None] = lambda _begun, _share: None,
) -> dict[str, float]:
    """Have all links between hosts bad for a while; `check` is given since when, and the share.

    That is of the cycles with an obeyed command. The watcher's own links stay whole.
    """
    phase(society, rng)
    network, account = network_of(society).network, society.account
    links = [link for link in network.switch.links() if WATCHER not in link]
    with society.fault(kind, *society.agents):
        begun = society.now()
        network.change(lambda switch: switch.set(links, faults))
        society.run(BAD_S)
        share = account.share_obeyed(begun + 1.0)
        network.change(lambda switch: switch.heal())
        check(begun, share)
        drives = _drives(society, society.now())
        society.run(1.0)
    return {"obeyed %": round(100 * share, 1), "drives": drives}


def round_trip_100(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """100 ms there and back, give or take 20: the robot drives on."""

    def drives_on(_: float, share: float) -> None:
        if share < DRIVES_ON:
            raise TrialError(f"commands were obeyed in {share:.0%} of the cycles only")

    return _bad_links(society, rng, "delay", LinkFaults(delay=0.05, jitter=0.01), drives_on)


def one_way_300(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """300 ms each way: the robot stands, and its agent logs why."""

    def stands(begun: float, share: float) -> None:
        texts = [log.text for at, log in society.account.logs if at >= begun]
        why = [text for text in texts if "too old" in text or "no valid command" in text]
        if share > 1.0 - DRIVES_ON or not why:
            raise TrialError(f"obeyed in {share:.0%} of the cycles; its log: {'; '.join(texts)}")

    return _bad_links(society, rng, "delay", LinkFaults(delay=0.3), stands)


def loss_20(society: RealSociety, rng: random.Random) -> dict[str, float]:
    """A fifth of all frames on the wire lost; TCP sends them again, and everything comes late."""
    return _bad_links(society, rng, "drop", LinkFaults(loss=0.2))


_DRIVES: Final = Figure("drives", "from the end of the fault to speeds ordered that are not zero")
_SHARE: Final = Figure("obeyed %", "cycles in which a command was obeyed of late, while it lasted")
_BACK: Final = Figure("rejoined", "from its end until all tokens are seen", None, 2000)

FAULTS: Final = {
    trial.name: trial
    for trial in (
        Trial("kill-one", "each agent killed in turn, and started again", (_DRIVES,), kill_one),
        Trial("hang-one", "each agent hung for 1.5 s in turn", (_DRIVES,), hang_one),
        Trial("simulator-gone", "simulator and line gone for 1 s", (_DRIVES,), simulator_gone),
        Trial(
            "link-down",
            "each host's card down for 3 s in turn",
            (_BACK, _DRIVES),
            link_down,
            hosts=True,
        ),
        Trial(
            "partition", "two hosts and two apart for 3 s", (_BACK, _DRIVES), partition, hosts=True
        ),
        Trial(
            "round-trip-100",
            "100 ms round trip with jitter: drives on",
            (_SHARE, _DRIVES),
            round_trip_100,
            hosts=True,
        ),
        Trial(
            "one-way-300",
            "300 ms one way: stands, and logs why",
            (_SHARE, _DRIVES),
            one_way_300,
            hosts=True,
        ),
        Trial("loss-20", "20 % loss", (_SHARE, _DRIVES), loss_20, hosts=True),
    )
}
"""What is done to real processes besides the table, by name."""
