"""Devices on the virtual mesh, behind device agents' ports."""

from __future__ import annotations

from dataclasses import dataclass

from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import DEVICE, Device, Network, address


@dataclass
class Port:
    """A device and the node that opened it last."""

    device: Device
    node: Node


class Ports:
    """All devices, and the bytes between them and their nodes."""

    def __init__(self, mesh: Network) -> None:
        self._mesh = mesh
        self._ports: list[Port] = []

    def plug(self, device: Device, node: Node) -> None:
        """Open a device for a node."""
        for port in self._ports:
            if port.device is device:
                port.node = node
                return
        port = Port(device, node)
        self._ports.append(port)
        self._mesh.call_at(self._mesh.now, self._device_due, port)

    def write(self, node: Node, data: bytes) -> None:
        """Send bytes to a node's device."""
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
