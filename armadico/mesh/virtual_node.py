"""A process on the virtual mesh, as the mesh and the makers of faults have it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from armadico.core.agent import Agent
from armadico.core.driver import Driver
from armadico.core.mailbox import Mailbox
from armadico.mesh.virtual_network import Clock

if TYPE_CHECKING:
    from armadico.mesh.virtual import VirtualMesh


class Device(Protocol):
    """What stands behind a device agent's port in memory: bytes and the time in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the agent."""

    def advance(self, now: float) -> bytes:
        """Live up to this time; what it says meanwhile."""

    @property
    def due(self) -> float:
        """When it next has something to say, s."""


class Node:
    """One agent's process on the virtual mesh.

    Without a clock of its own it takes the mesh's time for its own.
    """

    def __init__(
        self, agent: Agent, mesh: VirtualMesh, clock: Clock | None = None, *, admit: bool = True
    ) -> None:
        self.agent = agent
        self.name = agent.name
        self.mailbox: Mailbox[Callable[[], None]] = Mailbox()
        self.announced = False  # its token can be seen
        self.alive = True
        self.hung = False
        self.hangs = 0
        self.lost = False  # hung for longer than the lease, and not found again yet
        self.work_s = 0.0  # for each delivery: what else it would have been through at once
        self.busy = False
        self.worked = 0  # deliveries since its last wake-up, or since nothing waited
        self.wake_due: float | None = None
        self.device: Device | None = None
        self.clock = clock
        self._mesh = mesh
        self.driver = Driver(agent, self.time, admit=admit)

    @property
    def time(self) -> float:
        """What it takes for the time, s."""
        now = self._mesh.now
        return now if self.clock is None else self.clock.read(now)

    def when(self, time: float) -> float:
        """The mesh's time at which it takes it for `time`, s."""
        return time if self.clock is None else self.clock.when(time)

    def kill(self) -> None:
        """SIGKILL: it says nothing more, and its token goes."""
        self._mesh.kill(self)

    def leave(self) -> None:
        """SIGTERM: it lets go of what it holds, and ends."""
        self._mesh.leave(self)

    def hang(self) -> None:
        """SIGSTOP: what arrives waits, its token stays for the lease."""
        self._mesh.hang(self)

    def resume(self) -> None:
        """SIGCONT: everything that waited arrives in a burst."""
        self._mesh.resume(self)

    def jump(self, ahead: float) -> None:
        """Its clock shows so much more at once, s."""
        self._own_clock().jump(ahead)
        self._mesh.mind_wakeup(self, anew=True)

    def drift(self, rate: float) -> None:
        """Its clock runs so many times as fast as it should from now on."""
        self._own_clock().drift(self._mesh.now, rate)
        self._mesh.mind_wakeup(self, anew=True)

    def _own_clock(self) -> Clock:
        if self.clock is None:
            self.clock = Clock()
        return self.clock


class Port:
    """A device, and the node that has it open: the newest one that came with it."""

    def __init__(self, device: Device, node: Node) -> None:
        self.device = device
        self.node = node
