"""A soak: for hours a robot drives, its agents are killed in turn, and certificates are renewed.

The lab is that of `lab.py`, with `goto` on two computers.
"""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import psutil

from armadico.core.messages import Ack, Ask, BidHistory, Card, Command, RobotState
from armadico.core.services import BIDS
from armadico.launch.client import Client
from armadico.mesh.door import VIEWER, person
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico_tools.attacks.lab import DRIVERS, FAR_M, IN_TURN, LAB, LIMIT_S, ROBOT, Lab
from armadico_tools.attacks.pauses import Drive, Kill, Pause, summary
from armadico_tools.markdown import table

EVERY_S: Final = 15.0
"""From one kill to the next."""

DRIVES_S: Final = 2.0
"""An agent is killed once commands were obeyed for so long without a pause."""

DRIVES_WITHIN_S: Final = 60.0
FASTER_M_S: Final = 1.0
"""The robot drives slower: its goal lies so far for each second of the soak, and is not reached."""

ASKS_S: Final = 1.0
"""Period of querying bids. An agent keeps its last 50."""

SETTLES_S: Final = 5.0
"""The society's last state is taken so long after the last kill was recovered from."""

PORTER: Final = "armadico.keys.porter"


@dataclass
class Soak:
    """What a soak found.

    Attributes:
        seconds: How long it lasted.
        kills: How often each agent was killed, by its name and whether it held the wheels.
        back: The longest time until a killed agent was back, s.
        never: Agents that were not back within `LIMIT_S`.
        lost: How often the token of an agent went away that was not killed.
        missing: Agents that were not there at the end.
        gap: The longest time without an acknowledgement of the wheels, s.
        descriptors: Open ones of the robot agent and the porter: first, most and last.
        pauses: Times without a newly obeyed command.
    """

    seconds: float = 0.0
    kills: Counter[tuple[str, bool]] = field(default_factory=Counter)
    back: float = 0.0
    never: list[str] = field(default_factory=list)
    lost: Counter[str] = field(default_factory=Counter)
    missing: list[str] = field(default_factory=list)
    gap: float = 0.0
    descriptors: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    pauses: list[Pause] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        """Whether each killed agent came back, and no link was lost for good."""
        return not (self.never or self.missing)

    @property
    def lines(self) -> list[str]:
        """The result, for people."""
        lost = ", ".join(f"{name} {count}" for name, count in sorted(self.lost.items()))
        kept = ", ".join(
            f"{name} {first} at first, {most} at most, {last} at last"
            for name, (first, most, last) in self.descriptors.items()
        )
        head = ("killed", "kills", "cause of a pause", "pauses", "longest")
        return [
            f"{self.seconds / 60.0:.1f} min, {self.kills.total()} kills;"
            f" back within {self.back:.1f} s; not back: {', '.join(self.never) or 'none'}",
            f"tokens lost of agents that were not killed: {lost or 'none'};"
            f" missing at the end: {', '.join(self.missing) or 'none'}",
            f"longest time between two acknowledgements: {self.gap:.2f} s",
            f"descriptors: {kept}",
            "",
            table(head, summary(self.pauses, self.kills)),
        ]


def soak(
    folder: Path, minutes: float, *, keys: bool, certificate_s: float, report: Callable[[str], None]
) -> Soak:
    """Run a soak. Raises PlaceError without a society, or if the robot drives no more."""
    with ExitStack() as stack:
        lab = stack.enter_context(Lab(folder, DRIVERS if keys else _open(DRIVERS)))
        more = () if keys else ("--open",)
        if keys:
            lab.set_up(certificate_s)
        far = FAR_M + FASTER_M_S * 60.0 * minutes
        lab.up(ROBOT, "--set", f"interface.reach_m={2.0 * far:g}", *more)
        lab.up(LAB, *more)
        if keys:
            lab.wait_for_keys()
        client = stack.enter_context(lab.client(VIEWER))
        run = _Run(lab, client, report)
        return run.all(minutes * 60.0, person() if keys else "", far)


def _open(text: str) -> str:
    """The table of a lab without keys."""
    return text.replace('keys = "keys"\n', "").replace("tls/", "tcp/")


class _Run:
    def __init__(self, lab: Lab, client: Client, report: Callable[[str], None]) -> None:
        self._lab, self._client, self._report = lab, client, report
        self._drive, self.found = Drive(), Soak()
        self._asked = 0.0
        self._cards: dict[str, Card] = {}  # by instance
        client.listen(Ack, RobotState, Command, then=self._drive.update)

    def all(self, seconds: float, driver: str, far: float) -> Soak:
        """Send the robot so far (m) by an identity, and kill agents for so long."""
        client, found = self._client, self.found
        agents = Counter(name for _, name in IN_TURN)
        self._lab.until(
            client, lambda: Counter(n for n, _ in client.alive) >= agents, "the society"
        )
        expected = Counter(n for n, _ in client.alive)
        with self._lab.client(driver) as there:  # a busy computer may have no pose yet
            order = MissionRequest(Waypoint(far, 0.0, 0.0), planned=False)
            there.request_mission(order, again=DRIVES_WITHIN_S)
        self._until_driving()
        self._look_at_cards()
        owner = next(card.pid for card in self._cards.values() if card.name == "robot")
        watched = {"robot agent": owner}
        if (porter := _porter_of(owner)) is not None:
            watched["porter"] = porter
        counts = {name: [_descriptors(pid)] for name, pid in watched.items()}
        began = seen = client.mesh.now()
        number = 0
        while client.mesh.now() < began + seconds:
            host, agent = IN_TURN[number % len(IN_TURN)]
            number += 1
            if agent == "robot":  # the descriptors of its process are counted
                continue
            due = client.mesh.now() + EVERY_S
            self._kill(host, agent)
            for name, pid in watched.items():
                counts[name].append(_descriptors(pid))
            self._wait(lambda due=due: client.mesh.now() >= due, EVERY_S)  # type: ignore[misc]
            self._until_driving()
            now = ", ".join(f"{name} {each[-1]}" for name, each in counts.items())
            self._report(f"  descriptors: {now}; load {os.getloadavg()[0]:.1f}")
            found.pauses += (new := self._drive.pauses(seen, seen := client.mesh.now()))
            for pause in new:
                self._report(f"  {pause.text}")
        self._wait(lambda: False, SETTLES_S)
        for name, pid in watched.items():
            counts[name].append(_descriptors(pid))
            found.descriptors[name] = counts[name][0], max(counts[name]), counts[name][-1]
        found.seconds = client.mesh.now() - began
        found.missing = sorted((expected - Counter(n for n, _ in client.alive)).elements())
        found.pauses += self._drive.pauses(seen, client.mesh.now())
        found.gap = self._drive.gap
        return found

    def _kill(self, host: str, name: str) -> None:
        """Kill an agent of a host, and wait until it is back."""
        client, found = self._client, self.found
        self._look_at_cards()
        there = [c for c in self._cards.values() if (c.name, c.host) == (name, host)]
        if len(there) != 1:
            self._report(f"{len(there)} instances of {name} on {host} showed a card: not killed")
            return
        card, before = there[0], set(client.alive)
        began, held = client.mesh.now(), self._drive.holder == card.instance
        self._drive.kills.append(Kill(began, name, held))
        found.kills[name, held] += 1
        os.kill(card.pid, signal.SIGKILL)
        gone: set[str] = set()

        def back() -> bool:
            gone.update(n for n, i in before - client.alive if i != card.instance)
            return any(n == name for n, _ in client.alive - before)

        if self._wait(back, LIMIT_S):
            found.back = max(found.back, client.mesh.now() - began)
        else:
            found.never.append(f"{name} on {host}")
        found.lost.update(gone)
        self._report(
            f"{name} on {host}{', the holder' if held else ''}: back after"
            f" {client.mesh.now() - began:.1f} s"
        )

    def _until_driving(self) -> None:
        client = self._client
        what = lambda: self._drive.lasts(DRIVES_S, client.mesh.now())  # noqa: E731
        if not self._wait(what, DRIVES_WITHIN_S):
            self.found.pauses += self._drive.pauses(
                self._client.mesh.now() - 300.0, client.mesh.now()
            )
            for line in self.found.lines:
                self._report(line)
            self._lab.until(client, what, "the robot drives")

    def _wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait, and query bids meanwhile."""

        def true() -> bool:
            self._ask()
            return condition()

        return bool(self._client.wait_for(true, timeout))

    def _ask(self) -> None:
        """Query the bids of all agents, if it is time."""
        mesh = self._client.mesh
        if mesh.now() < self._asked + ASKS_S:
            return
        self._asked = mesh.now()

        def arrived(key: str, data: bytes) -> None:  # on Zenoh's thread; the record takes it
            history = mesh.read(BidHistory, key, data)
            if history is not None:
                self._drive.update(history, mesh.now())

        mesh.query(BIDS.key_for(name="*", instance="*"), Ask(), ASKS_S, arrived, lambda: None)

    def _look_at_cards(self) -> None:
        """Query the cards until each live agent has shown one; a busy agent may be late."""

        def shown() -> bool:
            found = self._client.cards()
            self._cards = {i: card for (_, i), card in found.items() if card is not None}
            return len(self._cards) == len(found)

        self._wait(shown, LIMIT_S)
        for card in self._cards.values():
            self._drive.provides[card.name] = card.provides


def _porter_of(pid: int) -> int | None:
    children = psutil.Process(pid).children()
    return next((c.pid for c in children if any(PORTER in w for w in c.cmdline())), None)


def _descriptors(pid: int) -> int:
    """Return how many descriptors a process has open; -1 if it has ended."""
    try:
        return len(list(Path(f"/proc/{pid}/fd").iterdir()))
    except OSError:
        return -1
