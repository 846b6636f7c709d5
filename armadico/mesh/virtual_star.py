"""The routers of the virtual mesh, and their loss."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeGuard

from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual_clock import Step
from armadico.mesh.virtual_network import Way
from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import DEVICE, Network, Place


class Star:
    """The routers, and which processes are linked to them; messages between two processes pass one.

    The router is the process of the newest robot agent whose predecessor is gone. While it hangs,
    messages wait in it. When it is gone, the others are disconnected, from each other too, and try
    again and again to link to the next one.
    """

    def __init__(self, mesh: Network, reconnect: tuple[float, float]) -> None:
        self.troubled = False  # whether there was a fault; before, all places reach each other
        self._mesh = mesh
        self._reconnects = reconnect
        self._rng = mesh.stream("star")
        self._routers: dict[str, Node] = {}  # by namespace
        self._held: dict[Node, list[tuple[Place, Place, tuple[Step, object, object]]]] = {}
        self._seeking: set[Place] = set()  # places that will try to link

    def router(self, namespace: str) -> Node | None:
        """Return the router of a namespace, alive or not; None if there never was one."""
        return self._routers.get(namespace)

    def has_router(self, place: Place) -> bool:
        """Return whether a place is linked to a router, is one, or needs none."""
        return place.uplink is not place or self._routers.get(place.namespace) is place

    def knows(self, place: Place | None, other: Place) -> bool:
        """Return whether a place sees another of its namespace by their routers.

        None: a client outside the society, of the router of the other place.
        """
        uplink = self._routers.get(other.namespace) if place is None else place.uplink
        return not self.troubled or uplink is other.uplink

    def serves(self, place: Place, *, back: bool = False) -> bool:
        """Return whether a client of its router reaches a place, or `back` the place the client."""
        router = self._routers.get(place.namespace)
        if not self.troubled or router is None or router is place:
            return True
        way = (place, router) if back else (router, place)
        linked = router.alive and place.uplink is router
        return linked and self._mesh.link(way[0].address, way[1].address).up

    def is_link(self, way: Way) -> bool:
        """Return whether two addresses are linked directly, and not only by routers."""
        if any(each.rpartition("/")[2] == DEVICE for each in way):
            return True
        ends = [self._routers.get(_namespace(each)) for each in way]
        if ends[0] is ends[1]:
            return ends[0] is None or ends[0].address in way
        return all(end is None or end.address == each for end, each in zip(ends, way, strict=True))

    def join(self, place: Place) -> None:
        """Link a starting place to its router, or make it one."""
        router = self._routers.get(place.namespace)
        if _can_route(place) and (router is None or not router.alive):
            self._lead(place)
        elif router is None:
            pass  # all places reach each other
        elif self._reaches(place, router):
            place.uplink = router
        else:
            self.cut_off(place)

    # Passing messages ----------------------------------------------------------------------------

    def passes(self, source: Place, target: Place, what: tuple[Step, object, object]) -> bool:
        """Return whether a delivery passes now; it waits if a router between the two hangs."""
        if not self.troubled:
            return True
        routers = self._between(source, target)
        hung = next((router for router in routers or () if router.hung), None)
        if hung is not None:
            self._held.setdefault(hung, []).append((source, target, what))
        return routers is not None and hung is None

    def delays(self, source: Place, target: Place) -> bool:
        """Return whether a router between the two hangs, which delays the report of an end."""
        return any(router.hung for router in self._between(source, target) or ())

    def _between(self, source: Place, target: Place) -> list[Node] | None:
        """Return the routers by which one place reaches another; None if it does not."""
        if source.namespace == target.namespace:
            router = source.uplink
            if router is not target.uplink:
                return None
            if not isinstance(router, Node) or router is source or router is target:
                return []
            routers = [router]
        else:
            routers = []
            for place in (source, target):
                router = self._routers.get(place.namespace)
                if router is not None and place.uplink is not router:
                    return None
                routers += [] if router is None else [router]
        way = [source, *routers, target]
        for one, other in pairwise(way):
            if one is not other and not self._mesh.link(one.address, other.address).up:
                return None
        between = [router for router in routers if router is not source and router is not target]
        return between if all(router.alive for router in between) else None

    # Losing and finding a router -----------------------------------------------------------------

    def lose(self, router: Node, _: object = None) -> None:
        """Disconnect all places of a router that is gone, or hangs for longer than the lease."""
        self.troubled = True
        self._held.pop(router, None)
        others = self._mesh.others(router)
        for place in others:
            if place.uplink is router:
                self.cut_off(place)
        if router.alive:
            return
        for place in others:
            self._mesh.liveliness.gone(place, router)
        if self._routers[router.namespace] is router:
            second = next((place for place in others if _can_route(place)), None)
            if second is not None:  # in reality its process could not start, and is restarted
                self._lead(second)

    def cut_off(self, place: Place) -> None:
        """Disconnect a place that has no router, or has lost it."""
        self.troubled = True
        place.uplink = place
        place.presence.link(False, self._mesh.now)
        self._seek(place)

    def woken(self, node: Node) -> None:
        """Release the messages that waited in a continued router; its lost places link again."""
        router = self._routers.get(node.namespace)
        if router is not node:
            if router is not None and node.uplink is not router:
                self._seek(node)
            return
        for source, target, what in self._held.pop(node, ()):
            self._mesh.later(source, target, *what, reliable=True)  # tokens are among them
        for place in self._mesh.others(node):
            if place.uplink is not node:
                self._seek(place)

    def reach(self, place: Place) -> None:
        """Link a place to its router again, now if possible."""
        router = self._routers.get(place.namespace)
        if router is None or place.uplink is router or not place.alive:
            return
        if self._reaches(place, router):
            self._link(place, router)
        else:
            self._seek(place)

    def _lead(self, router: Node) -> None:
        """Make a process the router of its namespace."""
        self._routers[router.namespace] = router.uplink = router
        for place in self._mesh.others(router):
            if place.uplink is None:
                place.uplink = router
            else:
                self._seek(place)

    def _seek(self, place: Place) -> None:
        """Try to reach the router some time later."""
        if place not in self._seeking:
            self._seeking.add(place)
            at = self._mesh.now + self._rng.uniform(*self._reconnects)
            self._mesh.call_at(at, self._try, place)

    def _try(self, place: Place, _: object) -> None:
        self._seeking.discard(place)
        if self._works(self._routers[place.namespace]) and not place.hung:
            self.reach(place)  # else the router is woken, or replaced

    def _link(self, place: Place, router: Node) -> None:
        place.uplink = router
        place.presence.link(True, self._mesh.now)
        place.schedule_poll()
        self._mesh.liveliness.reintroduce(place)
        if isinstance(place, Node):
            self._mesh.start(place)

    def _reaches(self, place: Place, router: Node) -> bool:
        ready = self._works(router) and not place.hung and not place.lost
        return ready and not self._is_cut(place, router)

    def _works(self, router: Node) -> bool:
        return router.alive and not router.hung and not router.lost

    def _is_cut(self, place: Place, router: Node) -> bool:
        there, back = (place.address, router.address), (router.address, place.address)
        return not (self._mesh.link(*there).up and self._mesh.link(*back).up)


def _can_route(place: Place) -> TypeGuard[Node]:
    return isinstance(place, Node) and place.is_router


def _namespace(address: str) -> str:
    return address.rpartition("/")[0] or DEFAULT_NAMESPACE
