"""Devices on the virtual mesh, behind device agents' ports, whose lines have guards."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from armadico.core.braking import Braking
from armadico.core.outgoing import STEP_S, Write
from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import DEVICE, Device, Network, address


@dataclass
class Port:
    """A device, the node that opened it last, and what its guard does."""

    device: Device
    node: Node
    guard: Braking = field(default_factory=lambda: Braking(STEP_S))
    looks_at: float = inf  # when the next look at the guard is scheduled, s


class Ports:
    """All devices, and the bytes between them and their nodes."""

    def __init__(self, mesh: Network) -> None:
        self._mesh = mesh
        self._ports: list[Port] = []

    def plug(self, device: Device, node: Node) -> None:
        """Open a device for a node."""
        for port in self._ports:
            if port.device is device:
                port.node, port.guard = node, Braking(STEP_S)
                return
        port = Port(device, node)
        self._ports.append(port)
        self._mesh.call_at(self._mesh.now, self._device_due, port)

    def write(self, node: Node, item: Write) -> None:
        """Send a write's bytes to a node's device, and let its guard know."""
        for port in self._of(node):
            port.guard.renew(item.brakes, self._mesh.now + item.holds_s)
            self._watch(port)
        if item.data:
            self._send(node, item.data)

    def closed(self, node: Node) -> None:
        """Process that a node has ended: its guard brakes the device, if it moves."""
        for port in self._of(node):
            port.guard.at_once(self._mesh.now)
            self._brake(port)

    def _of(self, node: Node) -> list[Port]:
        return [port for port in self._ports if port.node is node]

    def _watch(self, port: Port) -> None:
        due = port.guard.due
        if due is not None and due < port.looks_at:
            port.looks_at = due
            self._mesh.call_at(due, self._guard_due, port)

    def _guard_due(self, port: Port, _: object) -> None:
        port.looks_at = inf
        self._brake(port)

    def _brake(self, port: Port) -> None:
        """Write the guard's next step, if it is due."""
        guard, node = port.guard, port.node
        if guard.due is not None and guard.due <= self._mesh.now:
            if not node.alive and guard.is_over:
                return
            data, is_new = guard.step(self._mesh.now)
            self._send(node, data)
            if is_new:
                node.braked()
        self._watch(port)

    def _send(self, node: Node, data: bytes) -> None:
        link = self._mesh.link(node.address, address(node.namespace, DEVICE))
        at = link.arrival(self._mesh.now)
        if at is not None:
            self._mesh.call_at(at, self._device_receives, node, link.spoil(data))

    def _device_receives(self, node: Node, data: bytes) -> None:
        for port in self._ports:
            if port.device is node.device:
                self._from_device(port, port.device.advance(self._mesh.now))
                port.device.receive(data, self._mesh.now)

    def _device_due(self, port: Port, _: object) -> None:
        device = port.device
        self._from_device(port, device.advance(self._mesh.now))
        self._mesh.call_at(max(device.due, self._mesh.now + 1e-6), self._device_due, port)

    def _from_device(self, port: Port, data: bytes) -> None:
        node = port.node
        if data and node.alive:
            link = self._mesh.link(address(node.namespace, DEVICE), node.address)
            at = link.arrival(self._mesh.now)
            if at is not None:
                self._mesh.call_at(at, node.received, link.spoil(data))
