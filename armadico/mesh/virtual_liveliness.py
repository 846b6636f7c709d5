"""Who is there on the virtual mesh, for whom: tokens, leases, cuts and hangs, as Zenoh has them.

A process that is killed is missed at once: its socket closes. One that is cut off or hangs is
missed when its lease runs out; the connection is then gone both ways, and both sides are told so,
the hung one on waking. Some time after the cut has healed, or it has woken, they connect again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from armadico.mesh.virtual import VirtualMesh
    from armadico.mesh.virtual_node import Node

LIVELINESS = 0.003
"""How long after a process is killed the others hear of it, s: the socket closes at once."""

LEASE = 1.0
"""Who cannot be heard for so long, s, by a cut or a hang, is taken for gone."""

RECONNECT = (0.2, 0.5)
"""How long it then takes to find each other again, s: the pauses between attempts."""

Way = tuple[str, str]
"""From one agent's name to another's."""


class Presence:
    """Tells each node who comes and goes."""

    def __init__(self, mesh: VirtualMesh, lease: float, reconnect: tuple[float, float]) -> None:
        self._mesh = mesh
        self._lease = lease
        self._reconnects = reconnect
        self._rng = mesh.stream("presence")
        self._cuts: Counter[Way] = Counter()
        self._parted: set[frozenset[str]] = set()  # names whose connection's lease ran out

    def look(self, node: Node) -> None:
        """A node has started: it is told who is alive."""
        for other in self._others(node):
            if other.announced and not other.lost:
                self._mesh.later(other.name, node, self._appear, other)

    def join(self, node: Node) -> None:
        """A node shows its token: the others are told of it."""
        for other in self._others(node):
            if not other.lost:
                self._mesh.later(node.name, other, self._appear, node)

    def killed(self, node: Node) -> None:
        """A node is gone: whoever reached it sees its socket close, the others its lease end."""
        for other in self._others(node):
            reached = self._mesh.link(node.name, other.name).up and not node.lost
            self._mesh.call_at(
                self._mesh.now + (LIVELINESS if reached else self._lease), self._gone, other, node
            )

    # Hangs ---------------------------------------------------------------------------------------

    def hung(self, node: Node) -> None:
        """A node hangs from now on."""
        node.hangs += 1
        self._mesh.call_at(self._mesh.now + self._lease, self._hung_for_long, node, node.hangs)

    def woken(self, node: Node) -> None:
        """It is back, and has dealt with what waited for it; tell it what it has lost meanwhile."""
        if not node.lost:
            return
        for other in self._others(node):
            self._gone(node, other)
        at = self._mesh.now + self._rng.uniform(*self._reconnects)
        self._mesh.call_at(at, self._found, node, node.hangs)

    def _hung_for_long(self, node: Node, hang: int) -> None:
        if node.alive and node.hung and node.hangs == hang:
            node.lost = True
            for other in self._others(node):
                self._gone(other, node)

    def _found(self, node: Node, hang: int) -> None:
        if node.alive and not node.hung and node.hangs == hang:
            node.lost = False
            self.look(node)
            if node.announced:
                self.join(node)

    # Cuts ----------------------------------------------------------------------------------------

    def cut(self, sources: Iterable[str], targets: Iterable[str], *, lease: bool) -> None:
        """What sources say no longer reaches targets, by names.

        With a `lease` the connection ends both ways when it runs out, as TCP's does; without,
        nobody ever notices but by the silence.
        """
        for way in _ways(sources, targets):
            self._cuts[way] += 1
            self._mesh.link(*way).up = False
            if lease:
                at = self._mesh.now + self._lease
                self._mesh.call_at(at, self._cut_for_long, way, self._cuts[way])

    def heal(self, sources: Iterable[str], targets: Iterable[str]) -> None:
        """Undo a cut."""
        for way in _ways(sources, targets):
            self._cuts[way] -= 1
            if self._cuts[way]:
                continue
            if frozenset(way) in self._parted:
                at = self._mesh.now + self._rng.uniform(*self._reconnects)
                self._mesh.call_at(at, self._reconnect, way)
            else:
                self._mesh.link(*way).up = True

    def _cut_for_long(self, way: Way, _: Any) -> None:
        """Part them, if they are still cut; one that was cut anew meanwhile is parted early."""
        pair = frozenset(way)
        if not self._cuts[way] or pair in self._parted:
            return
        self._parted.add(pair)
        mesh = self._mesh
        mesh.link(*way).up = mesh.link(*reversed(way)).up = False
        for node in mesh.nodes:
            for other in mesh.nodes:
                if node.alive and node is not other and {node.name, other.name} == pair:
                    self._gone(node, other)

    def _reconnect(self, way: Way, _: Any) -> None:
        pair = frozenset(way)
        back = (way[1], way[0])
        if self._cuts[way] or self._cuts[back] or pair not in self._parted:
            return
        self._parted.remove(pair)
        mesh = self._mesh
        mesh.link(*way).up = mesh.link(*back).up = True
        for node in mesh.nodes:
            for other in mesh.nodes:
                here = node.alive and other.alive and not (node.lost or other.lost)
                if here and (node.name, other.name) == way:
                    self._meet(node, other)

    # Telling -------------------------------------------------------------------------------------

    def _others(self, node: Node) -> list[Node]:
        return [other for other in self._mesh.nodes if other.alive and other is not node]

    def _meet(self, node: Node, other: Node) -> None:
        for each, token in ((other, node), (node, other)):
            if token.announced:
                self._mesh.later(token.name, each, self._appear, token)

    def _appear(self, node: Node, other: Node) -> None:
        if other.alive:
            self._tell(node, other, alive=True)

    def _gone(self, node: Node, other: Node) -> None:
        self._tell(node, other, alive=False)

    def _tell(self, node: Node, other: Node, *, alive: bool) -> None:
        name, instance = other.name, other.agent.instance
        self._mesh.hand(
            node,
            lambda: node.driver.token(name, instance, alive, node.time),
            f"token/{instance}",
            keep=1,
        )


def _ways(sources: Iterable[str], targets: Iterable[str]) -> list[Way]:
    there = tuple(targets)
    return [(source, target) for source in sources for target in there if source != target]
