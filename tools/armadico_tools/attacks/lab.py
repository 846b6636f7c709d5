"""A lab of three computers as network namespaces, set up by the commands of docs/security.md.

They are the robot's computer, one with the driving agents, and a desk. A fourth is a stranger's.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from armadico.config.endpoints import endpoints
from armadico.config.hosts import load_hosts
from armadico.core.messages import Ack, Card
from armadico.launch.client import Client
from armadico.launch.processes import kill_trees
from armadico.mesh import sockets
from armadico.mesh.door import VIEWER, person
from armadico_tools.attacks.pauses import Drive
from armadico_tools.testbed import SOON_S, WATCHER, Namespaces, PlaceError, sockets_in

ROBOT, LAB, DESK, STRANGER = "robot", "lab2", "desk", WATCHER
ADDRESS: Final = "10.77.5.1"
PORT: Final = 7447
TABLE: Final = f"""\
keys = "keys"

[robot]
router = "tls/{ADDRESS}:{PORT}"
agents = ["robot", "encoder", "sonar", "interface", "path-planning", "avoid"]

[lab2]
address = "10.77.5.2"
agents = ["goto", "gothrough"]

[desk]
address = "10.77.5.3"
"""
SCENARIO: Final = """\
world = "empty"
sensors = "ideal"
start = [0, 0, 0]
goal = [9, 0, 0]
plan = "direct"
"""


class Lab(Namespaces):
    """Each host has a folder of its own, with the table and its keys; a context manager."""

    def __init__(self, folder: Path, table: str = TABLE) -> None:
        """Make the hosts, without keys. Raises OSError."""
        self.folder = folder
        for host in (ROBOT, LAB, DESK):
            (folder / host).mkdir()
            (folder / host / "lab.toml").write_text(table)
            (folder / host / "road.toml").write_text(SCENARIO)
        super().__init__(load_hosts(folder / ROBOT / "lab.toml"))

    def call(self, host: str, *words: str, **options: Any) -> str:
        """Run a command of the page in the host's folder, as `Place.call`."""
        joins = ("--hosts", "lab.toml", "--host", host) if words[0] == "armadico" else ()
        return super().call(host, *words, *joins, cwd=self.folder / host, **options)

    def set_up(self, certificate_s: float | None = None) -> None:
        """Make the keys of all hosts, and bring them there.

        `certificate_s` is how long the certificates of other computers are valid, s.
        """
        hours = () if certificate_s is None else ("--hours", f"{certificate_s / 3600.0:.9f}")
        self.call(ROBOT, "armadico", "keys", "init")
        for host in (LAB, DESK):
            self.call(ROBOT, "armadico", "keys", "host", host, *hours)
            self.call(ROBOT, "mv", f"{host}-keys.tar", f"../{host}")  # scp between computers
            self.call(host, "tar", "-xf", f"{host}-keys.tar")

    def up(self, host: str, *more: str) -> subprocess.Popen[bytes]:
        """Start a host's share of the society."""
        folder = self.folder / host
        words = ("up", str(folder / "road.toml"), "--hosts", str(folder / "lab.toml"), *more)
        return self.start(host, host, [*words, "--host", host, "--restarts", "100"])

    @contextmanager
    def client(self, name: str) -> Iterator[Client]:
        """A guest on the robot's computer, with the key of an identity."""
        with (
            sockets_in(self.sockets_of(ROBOT)),
            endpoints(self.namespace).mesh(name, starts=True) as mesh,
        ):
            yield Client(mesh)

    def wait_for_keys(self) -> None:
        """Wait until the robot agent listens, whose socket leads to the keys."""
        end = time.monotonic() + SOON_S
        with sockets_in(self.sockets_of(ROBOT)):
            while sockets.keys_here(self.namespace) is None:
                if time.monotonic() > end:
                    raise PlaceError("\n".join(self.last_lines(ROBOT, 15)))
                time.sleep(0.1)


# Floods -------------------------------------------------------------------------------------------


class Flood(NamedTuple):
    """Connections of a stranger to the robot's port."""

    name: str
    kind: str  # "silent", "bare" or "tls"
    rate: float  # per second


FLOODS: Final = (
    Flood("none", "", 0.0),
    Flood("bare connections, 20 per second", "bare", 20.0),
    Flood("bare connections, 100 per second", "bare", 100.0),
    Flood("silent connections, 200 per second", "silent", 200.0),
    Flood("failed TLS handshakes, 20 per second", "tls", 20.0),
    Flood("failed TLS handshakes, 100 per second", "tls", 100.0),
    Flood("failed TLS handshakes, as many as it can", "tls", 10_000.0),
)


class Killed(NamedTuple):
    """What followed when an agent was killed (SIGKILL), s.

    Attributes:
        flood: What the stranger did meanwhile.
        host: Where the agent ran.
        held: Whether its process held the wheels.
        paused: The longest time without a newly obeyed command, until the robot drove on.
        back: Until a new process of it had its token; None: not within `LIMIT_S`.
    """

    flood: str
    host: str
    agent: str
    held: bool
    paused: float
    back: float | None


LIMIT_S: Final = 20.0
SETTLES_S: Final = 3.0
"""How long a flood lasts before an agent is killed."""

AFTER_S: Final = 2.0
"""How long the drive is watched at least once an agent is back: its messages may come later."""

DRIVES_S: Final = 1.0
"""The robot drives again when commands were obeyed for so long."""

FAR_M: Final = 2_000.0
DRIVERS: Final = TABLE.replace('"avoid"]', '"avoid", "goto"]')
"""The table with `goto` on two computers: one takes over when the other is killed."""

IN_TURN: Final = (
    *((LAB, "goto"), (ROBOT, "goto"), (LAB, "gothrough"), (ROBOT, "avoid"), (ROBOT, "encoder")),
    *((ROBOT, "sonar"), (ROBOT, "interface"), (ROBOT, "path-planning"), (ROBOT, "robot")),
)
"""Host and agent, in the order in which they are killed."""


def recoveries(folder: Path) -> Iterator[Killed]:
    """Kill each agent in turn while the robot drives and a stranger floods the port."""
    with ExitStack() as stack:
        lab = stack.enter_context(Lab(folder, DRIVERS))
        lab.set_up()
        lab.up(ROBOT, "--set", f"interface.reach_m={5 * FAR_M:g}")
        lab.up(LAB)
        lab.wait_for_keys()
        client = stack.enter_context(lab.client(VIEWER))
        drive = Drive()
        client.listen(Ack, then=drive.update)
        agents = Counter(name for _, name in IN_TURN)
        lab.until(client, lambda: Counter(n for n, _ in client.alive) >= agents, "the society")
        client.settle()
        with lab.client(person()) as driver:
            driver.goto(FAR_M, 0.0, 0.0, direct=True)

        def drives() -> bool:
            return drive.lasts(DRIVES_S, client.mesh.now())

        for flood in FLOODS:
            with flooding(lab, flood):
                client.wait_for(lambda: False, SETTLES_S)
                for host, name in IN_TURN:
                    lab.until(client, drives, "the robot drives")
                    yield killed(client, drive, flood.name, host, name)


def killed(client: Client, drive: Drive, flood: str, host: str, name: str) -> Killed:
    """Kill an agent of a host, and watch. Raises PlaceError if it is not there."""
    deadline = client.mesh.now() + LIMIT_S
    while len(there := _instances(client, host, name)) != 1:  # a card may be late under a flood
        if client.mesh.now() > deadline:
            raise PlaceError(f"{len(there)} instances of {name} on {host} showed a card")
    before, held = set(client.alive), drive.holder == there[0].instance
    began = client.mesh.now()
    os.kill(there[0].pid, signal.SIGKILL)
    new = client.wait_for(lambda: [i for n, i in client.alive - before if n == name], LIMIT_S)
    back = client.mesh.now() - began if new else None
    if drive.holder:
        client.wait_for(lambda: False, AFTER_S)
        client.wait_for(lambda: drive.lasts(DRIVES_S, client.mesh.now()), LIMIT_S)
    return Killed(flood, host, name, held, drive.paused(began, client.mesh.now()), back)


def _instances(client: Client, host: str, name: str) -> list[Card]:
    """Return the cards of an agent's live instances on a host."""
    cards = [card for card in client.cards().values() if card is not None]
    return [card for card in cards if (card.name, card.host) == (name, host)]


@contextmanager
def flooding(lab: Lab, flood: Flood) -> Iterator[None]:
    """A stranger's computer connects to the robot's port inside the `with` block."""
    if not flood.kind:
        yield
        return
    script = Path(__file__).with_name("flooding.py")
    words = (sys.executable, str(script), ADDRESS, str(PORT), str(flood.rate), flood.kind)
    process = lab.popen(STRANGER, words)
    try:
        yield
    finally:
        kill_trees(process)
