"""A lab of three computers as network namespaces, set up by the commands of docs/security.md.

They are the robot's computer, one with the driving agents, and a desk. A fourth is a stranger's.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, NamedTuple, Self

import psutil

from armadico.config.endpoints import endpoints
from armadico.config.hosts import load_hosts
from armadico.launch.client import Client
from armadico.launch.processes import kill_trees
from armadico.mesh import sockets
from armadico.mesh.door import VIEWER
from armadico_tools.testbed import WATCHER, Namespaces, sockets_in

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
NAMESPACE: Final = "robot1"
SOON_S: Final = 60.0


class LabError(RuntimeError):
    """A command failed, or an event did not come."""


class Lab:
    """Each host has a folder of its own, with the table and its keys; a context manager."""

    def __init__(self, folder: Path, table: str = TABLE) -> None:
        """Make the hosts, without keys. Raises OSError."""
        self.folder = folder
        for host in (ROBOT, LAB, DESK):
            (folder / host).mkdir()
            (folder / host / "lab.toml").write_text(table)
            (folder / host / "road.toml").write_text(SCENARIO)
        self.bed = Namespaces(load_hosts(folder / ROBOT / "lab.toml"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.bed.__exit__(*error)

    def popen(self, host: str, *words: str) -> subprocess.Popen[str]:
        """Run a program in the host's folder."""
        return self.bed.popen(
            host,
            words,
            cwd=self.folder / host,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def call(self, host: str, *words: str) -> str:
        """Run a command of the page to its end; return what it prints.

        Raises LabError if it fails.
        """
        joins = ("--hosts", "lab.toml", "--host", host) if words[0] == "armadico" else ()
        process = self.popen(host, *words, *joins)
        out = process.communicate(timeout=SOON_S)[0]
        if process.returncode:
            raise LabError(f"{host}: {' '.join(words)}: exit {process.returncode}: {out}")
        return out

    def set_up(self) -> None:
        """Make the keys of all hosts, and bring them there."""
        self.call(ROBOT, "armadico", "keys", "init")
        for host in (LAB, DESK):
            self.call(ROBOT, "armadico", "keys", "host", host)
            self.call(ROBOT, "mv", f"{host}-keys.tar", f"../{host}")  # scp between computers
            self.call(host, "tar", "-xf", f"{host}-keys.tar")

    def up(self, host: str) -> subprocess.Popen[bytes]:
        """Start a host's share of the society."""
        folder = self.folder / host
        words = ("up", str(folder / "road.toml"), "--hosts", str(folder / "lab.toml"))
        return self.bed.start(host, host, [*words, "--host", host, "--restarts", "100"])

    @contextmanager
    def viewer(self) -> Iterator[Client]:
        """A guest on the robot's computer, which only looks."""
        with (
            sockets_in(self.bed.sockets_of(ROBOT)),
            endpoints(NAMESPACE).mesh(VIEWER, starts=True) as mesh,
        ):
            yield Client(mesh)

    def wait_for_keys(self) -> None:
        """Wait until the robot agent listens, whose socket leads to the keys."""
        end = time.monotonic() + SOON_S
        with sockets_in(self.bed.sockets_of(ROBOT)):
            while sockets.keys_here(NAMESPACE) is None:
                if time.monotonic() > end:
                    raise LabError("\n".join(self.bed.last_lines(ROBOT, 15)))
                time.sleep(0.1)

    def until(self, client: Client, condition: Callable[[], object], what: str) -> None:
        """Wait for something to be so. Raises LabError if it does not come."""
        if not client.wait_for(condition, SOON_S):
            there = ", ".join(sorted(name for name, _ in client.alive))
            logs = "\n".join(line for h in (ROBOT, LAB) for line in self.bed.last_lines(h, 15))
            raise LabError(f"not within {SOON_S:.0f} s: {what}; alive: {there}\n{logs}")


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


class Recovery(NamedTuple):
    """Times from SIGKILL until a new process of the agent has its token, s.

    None: not within `LIMIT_S`. The society waits 1 to 2 s before it restarts an agent.

    Attributes:
        here: Of an agent on the robot's computer.
        there: Of an agent on another computer of the table.
    """

    flood: str
    here: float | None
    there: float | None


LIMIT_S: Final = 20.0
SETTLES_S: Final = 3.0
"""How long a flood lasts before an agent is killed."""


def recoveries(folder: Path, floods: tuple[Flood, ...] = FLOODS) -> Iterator[Recovery]:
    """Kill an agent here and one there while a stranger floods the port; yield the times."""
    with ExitStack() as stack:
        lab = stack.enter_context(Lab(folder))
        lab.set_up()
        ups = {host: lab.up(host) for host in (ROBOT, LAB)}
        lab.wait_for_keys()
        client = stack.enter_context(lab.viewer())
        names = {"robot", "encoder", "goto", "avoid", "interface"}
        lab.until(client, lambda: {n for n, _ in client.alive} >= names, "the society")
        for flood in floods:
            with flooding(lab, flood):
                client.wait_for(lambda: False, SETTLES_S)
                here = restarted(client, ups[ROBOT], "encoder")
                there = restarted(client, ups[LAB], "goto")
            yield Recovery(flood.name, here, there)
            client.wait_for(lambda: False, SETTLES_S)


def restarted(client: Client, up: subprocess.Popen[bytes], name: str) -> float | None:
    """Kill an agent of a host; return when a new process of it has its token, s."""
    before = {i for n, i in client.alive if n == name}
    victims = [
        p for p in psutil.Process(up.pid).children(recursive=True) if name in p.cmdline()[1:]
    ]
    began = time.monotonic()
    for process in victims:
        process.kill()
    new = client.wait_for(
        lambda: [i for n, i in client.alive if n == name and i not in before], LIMIT_S
    )
    return time.monotonic() - began if new else None


@contextmanager
def flooding(lab: Lab, flood: Flood) -> Iterator[None]:
    """A stranger's computer connects to the robot's port inside the `with` block."""
    if not flood.kind:
        yield
        return
    script = Path(__file__).with_name("flooding.py")
    words = (sys.executable, str(script), ADDRESS, str(PORT), str(flood.rate), flood.kind)
    process = lab.bed.popen(STRANGER, words)
    try:
        yield
    finally:
        kill_trees(process)
