"""Liveliness on the virtual mesh: tokens, leases, hangs and cuts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any, Final

from armadico.mesh.virtual_network import Way
from armadico.mesh.virtual_node import LOOK_AGAIN, Node
from armadico.mesh.virtual_place import Network, Place

LIVELINESS: Final = 0.003
"""How long after a process is killed the others hear of it, s: the socket closes at once."""


class Liveliness:
    """Who is alive, as each sees it: tokens, leases, cuts and hangs, as Zenoh has them.

    A process that is killed is missed at once: its socket closes. One that is cut off or hangs is
    missed when its lease runs out; to itself it is cut off from then on. Some time after the cut
    has healed, or it has woken, it is linked again.
    """

    def __init__(self, mesh: Network, lease: float, reconnect: tuple[float, float]) -> None:
        self._mesh = mesh
        self._lease = lease
        self._reconnects = reconnect
        self._rng = mesh.stream("presence")
        self._cuts: Counter[Way] = Counter()
        self._parted: set[frozenset[str]] = set()  # names whose connection's lease ran out

    def introduce(self, place: Place) -> None:
        """A process has joined: it is told who is alive."""
        for other in self._mesh.others(place):
            if not other.lost:
                self._announce(other, place)

    def join(self, place: Place, name: str, instance: str) -> None:
        """A process declares its token: the others are told."""
        for other in self._mesh.others(place):
            if not other.lost:
                self._tell_of(place, other, name, instance)

    def killed(self, place: Place) -> None:
        """A process is gone: who reached it sees its socket close, the others its lease end."""
        star = self._mesh.star
        router = star.router(place.namespace)
        if router is place:
            star.troubled = True
            self._mesh.call_at(self._mesh.now + LIVELINESS, star.lose, place)
            return
        for other in self._mesh.others(place):
            by = other if router is None else router
            reached = self._mesh.link(place.address, by.address).up and not place.lost
            at = self._mesh.now + (LIVELINESS if reached else self._lease)
            self._mesh.call_at(at, self._missed, other, place)

    # Hangs ---------------------------------------------------------------------------------------

    def hung(self, node: Node) -> None:
        """A node hangs from now on."""
        node.hangs += 1
        self._mesh.star.troubled = True
        self._mesh.call_at(self._mesh.now + self._lease, self._hung_for_long, node, node.hangs)

    def woken(self, node: Node) -> None:
        """It is back, and has dealt with what waited for it; tell it what it has lost meanwhile."""
        if not node.lost:
            return
        router = self._mesh.star.router(node.namespace)
        if router is None or router is node:
            for other in self._mesh.others(node):
                self.gone(node, other)
        else:
            self._mesh.star.cut_off(node)
        if router is None:
            at = self._mesh.now + self._rng.uniform(*self._reconnects)
            self._mesh.call_at(at, self._found, node, node.hangs)
        else:
            node.lost = False

    def _hung_for_long(self, node: Node, hang: int) -> None:
        if node.alive and node.hung and node.hangs == hang:
            node.lost = True
            if self._mesh.star.router(node.namespace) is node:
                self._mesh.star.lose(node)
                return
            for other in self._mesh.others(node):
                self._missed(other, node)

    def _found(self, node: Node, hang: int) -> None:
        """It is linked again, where there is no router."""
        if node.alive and not node.hung and node.hangs == hang:
            node.lost = False
            self.introduce(node)
            for name, instance in node.tokens:
                self.join(node, name, instance)

    # Cuts ----------------------------------------------------------------------------------------

    def cut(self, sources: Iterable[str], targets: Iterable[str], *, lease: bool) -> None:
        """What sources publish no longer reaches targets, by names.

        With a `lease` the connection ends both ways when it runs out, as TCP's does; without,
        nobody ever notices but by the silence. A cut between two that have no link, because a
        router is between them, does nothing.
        """
        self._mesh.star.troubled = True
        for way in _ways(sources, targets):
            self._cuts[way] += 1
            if self._mesh.star.is_link(way):
                self._mesh.link(*way).up = False
            if lease:
                at = self._mesh.now + self._lease
                self._mesh.call_at(at, self._cut_for_long, way, self._cuts[way])

    def heal(self, sources: Iterable[str], targets: Iterable[str]) -> None:
        wait = self._rng.uniform(*self._reconnects)
        for way in _ways(sources, targets):
            self._cuts[way] -= 1
            if self._cuts[way]:
                continue
            if frozenset(way) in self._parted:
                self._mesh.call_at(self._mesh.now + wait, self._reconnect, way)
            else:
                self._mesh.link(*way).up = True
                for place, other in self._pairs(frozenset(way)):
                    self._catch_up(place, other)

    def _catch_up(self, place: Place, other: Place) -> None:
        """A link was cut for less than the lease: tokens that came meanwhile come now."""
        router = self._mesh.star.router(place.namespace)
        if router is None and not (place.lost or other.lost):
            self._announce(other, place)
        elif other is router and place.uplink is router:
            self.introduce(place)
            for name, instance in place.tokens:
                self.join(place, name, instance)

    def _cut_for_long(self, way: Way, _: Any) -> None:
        """Part them, if they are still cut; one that was cut anew meanwhile is parted early."""
        pair = frozenset(way)
        if not self._cuts[way] or pair in self._parted:
            return
        self._parted.add(pair)
        if self._mesh.star.is_link(way):
            self._both_ways(way, up=False)
        for place, other in self._pairs(pair):
            router = self._mesh.star.router(place.namespace)
            if router is None:
                self.gone(place, other)
            elif other is router and place.uplink is router:
                self._mesh.star.cut_off(place)
                # Those that are cut off at this instant, too, do not miss each other.
                self._mesh.call_at(self._mesh.now + LIVELINESS, self._parted_from, place)

    def _parted_from(self, place: Place, _: Any) -> None:
        """A place is cut off: those that are still linked to the router miss it."""
        for other in self._mesh.others(place):
            self._missed(other, place)

    def _reconnect(self, way: Way, _: Any) -> None:
        pair = frozenset(way)
        if self._cuts[way] or self._cuts[way[1], way[0]] or pair not in self._parted:
            return
        self._parted.remove(pair)
        self._both_ways(way, up=True)
        for place, other in self._pairs(pair):
            router = self._mesh.star.router(place.namespace)
            if router is None and other.alive and not (place.lost or other.lost):
                self._announce(other, place)
            elif other is router:
                self._mesh.star.reach(place)

    def _pairs(self, pair: frozenset[str]) -> Iterator[tuple[Place, Place]]:
        """Places that are alive and others, by the addresses of both, either way round."""
        for place in self._mesh.places:
            for other in self._mesh.places:
                if place.alive and place is not other and {place.address, other.address} == pair:
                    yield place, other

    def _both_ways(self, way: Way, *, up: bool) -> None:
        self._mesh.link(way[0], way[1]).up = self._mesh.link(way[1], way[0]).up = up

    # Telling -------------------------------------------------------------------------------------

    def _announce(self, place: Place, other: Place) -> None:
        """One's tokens come to another; those of another robot's nobody looks for."""
        if place.namespace != other.namespace:
            return
        for name, instance in place.tokens:
            self._tell_of(place, other, name, instance)

    def _tell_of(self, place: Place, other: Place, name: str, instance: str) -> None:
        self._mesh.later(place, other, self._appear, other, (name, instance))

    def _appear(self, place: Place, what: tuple[str, str]) -> None:
        if place.alive:
            place.see(*what, True)

    def _missed(self, place: Place, other: Place) -> None:
        """The tokens of another go; a router that hangs between the two reports it afterwards."""
        if self._mesh.star.delays(other, place):
            self._mesh.call_at(self._mesh.now + LOOK_AGAIN, self._missed, place, other)
        else:
            self.gone(place, other)

    def gone(self, place: Place, other: Place) -> None:
        """One sees the tokens of another go."""
        if place.namespace != other.namespace:
            return
        for name, instance in other.tokens:
            place.see(name, instance, False)


def _ways(sources: Iterable[str], targets: Iterable[str]) -> list[Way]:
    there = tuple(targets)
    return [(source, target) for source in sources for target in there if source != target]
