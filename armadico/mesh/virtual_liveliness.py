"""Liveliness on the virtual mesh: tokens, leases, hangs and cuts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final

from armadico.mesh.virtual_network import Way
from armadico.mesh.virtual_node import RETRY_S, Node
from armadico.mesh.virtual_place import Network, Place

# After a process is killed its socket closes immediately. Others detect it after this time, s.
LIVELINESS: Final = 0.003


class Liveliness:
    """Tokens, leases, cuts and hangs, as in Zenoh: which processes each process sees as alive.

    A killed process disappears at once, as its socket closes. A disconnected or hanging process
    disappears when its lease expires; to itself it is disconnected from then on. Some time after
    the cut has healed, or the process continues, it is linked again.
    """

    def __init__(self, mesh: Network, lease: float, reconnect: tuple[float, float]) -> None:
        self._mesh = mesh
        self._lease = lease
        self._reconnects = reconnect
        self._rng = mesh.stream("presence")
        self._cuts: Counter[Way] = Counter()
        self._parted: set[frozenset[str]] = set()  # names whose connection's lease ran out

    def introduce(self, place: Place) -> None:
        """Send the tokens of all live processes to a process that has joined."""
        for other in self._mesh.others(place):
            if not other.lost:
                self._announce(other, place)

    def join(self, place: Place, name: str, instance: str) -> None:
        """Send a process's new token to all others."""
        for other in self._mesh.others(place):
            if not other.lost:
                self._send_token(place, other, name, instance)

    def reintroduce(self, place: Place) -> None:
        """Send all tokens in both directions between a process and the others."""
        self.introduce(place)
        for name, instance in place.tokens:
            self.join(place, name, instance)

    def killed(self, place: Place) -> None:
        """Report a killed process: at once where it was reachable, else after its lease."""
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
        """Note that a node hangs from now on."""
        node.hangs += 1
        self._mesh.star.troubled = True
        self._mesh.call_at(self._mesh.now + self._lease, self._hung_for_long, node, node.hangs)

    def woken(self, node: Node) -> None:
        """Report to a node what it lost during a hang, after its mailbox is empty."""
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
        """Link a node again, in a namespace without a router."""
        if node.alive and not node.hung and node.hangs == hang:
            node.lost = False
            self.reintroduce(node)

    # Cuts ----------------------------------------------------------------------------------------

    def cut(self, sources: Iterable[str], targets: Iterable[str], *, lease: bool) -> None:
        """Cut the links from sources to targets, by name.

        With `lease` the connection ends in both directions when the lease expires, as TCP's does.
        Without, the cut is noticed by missing messages only. A cut between two processes without a
        link, because a router is between them, has no effect.
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
        """Send the tokens of the time of a cut that was shorter than the lease."""
        router = self._mesh.star.router(place.namespace)
        if router is None and not (place.lost or other.lost):
            self._announce(other, place)
        elif other is router and place.uplink is router:
            self.reintroduce(place)

    def _cut_for_long(self, way: Way, _: object) -> None:
        """Part two processes that are still cut; one that was cut again is parted early."""
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
                # Processes that are disconnected at this same time do not see each other go.
                self._mesh.call_at(self._mesh.now + LIVELINESS, self._parted_from, place)

    def _parted_from(self, place: Place, _: object) -> None:
        """Report a disconnected place to the places that are still linked to the router."""
        for other in self._mesh.others(place):
            self._missed(other, place)

    def _reconnect(self, way: Way, _: object) -> None:
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
        """Yield all (live place, other place) with these two addresses, in either order."""
        for place in self._mesh.places:
            for other in self._mesh.places:
                if place.alive and place is not other and {place.address, other.address} == pair:
                    yield place, other

    def _both_ways(self, way: Way, *, up: bool) -> None:
        self._mesh.link(way[0], way[1]).up = self._mesh.link(way[1], way[0]).up = up

    # Reporting -----------------------------------------------------------------------------------

    def _announce(self, place: Place, other: Place) -> None:
        """Send a place's tokens to another place of its namespace."""
        if place.namespace != other.namespace:
            return
        for name, instance in place.tokens:
            self._send_token(place, other, name, instance)

    def _send_token(self, place: Place, other: Place, name: str, instance: str) -> None:
        self._mesh.later(place, other, self._appear, other, (name, instance), reliable=True)

    def _appear(self, place: Place, what: tuple[str, str]) -> None:
        if place.alive:
            place.update_token(*what, True)

    def _missed(self, place: Place, other: Place) -> None:
        """Report another place as gone; later if a router between the two hangs."""
        if self._mesh.star.delays(other, place):
            self._mesh.call_at(self._mesh.now + RETRY_S, self._missed, place, other)
        else:
            self.gone(place, other)

    def gone(self, place: Place, other: Place) -> None:
        """Report all tokens of another place as gone."""
        if place.namespace != other.namespace:
            return
        for name, instance in other.tokens:
            place.update_token(name, instance, False)


def _ways(sources: Iterable[str], targets: Iterable[str]) -> list[Way]:
    there = tuple(targets)
    return [(source, target) for source in sources for target in there if source != target]
