"""Why a router does not let a process in, as far as the process can find out."""

from __future__ import annotations

from typing import Final

from armadico.mesh import sockets
from armadico.mesh.sockets import answers
from armadico.mesh.topology import Topology

AGAIN_S: Final = 0.1  # how often a client checks whether its router is there, s
PROBE_S: Final = 1.0  # timeout of finding out whether a port is closed
LATER_S: Final = 1.0  # the longest pause after refusals, s: each attempt costs a handshake


class Refusals:
    """The refusals of a client's routers."""

    def __init__(self, namespace: str, where: Topology) -> None:
        self.pause = AGAIN_S  # how long to wait before the next attempt, s
        self._namespace, self._where = namespace, where
        self._why: dict[str, str] = {}  # by endpoint; "": it accepted the handshake alone
        self._accepted: set[str] = set()  # endpoints that did not object to the identity either

    def answers(self, endpoint: str, within: float) -> bool:
        """Return whether a router's port can be joined now, with a timeout in s."""
        door = self._where.door
        if door is None or not endpoint.startswith("tls/"):
            return answers(endpoint, within)
        from armadico.mesh.handshake import refusal  # slow, and seldom needed

        # A router's objection takes a while. Of several routers those of other robots object.
        waits = endpoint in self._why or len(self._where.connect) > 1
        why = refusal(endpoint, door, within, waits=waits)
        (self._accepted.add if waits and why == "" else self._accepted.discard)(endpoint)
        if why is None:
            self._why.pop(endpoint, None)
        elif why:
            self.failed(endpoint, why)
        elif endpoint in self._why:  # what it objected to before is over
            self._why[endpoint] = ""
        return why == ""

    def failed(self, endpoint: str, why: str = "") -> None:
        """Note a failed attempt; the next one is made later."""
        self._why[endpoint] = why or self._why.get(endpoint, "")
        if endpoint.startswith("tls/"):
            self.pause = min(2 * self.pause, LATER_S)

    def joined(self) -> None:
        self.pause = AGAIN_S
        self._why.clear()
        self._accepted.clear()

    def why(self, joining: str = "") -> str:
        """Why a router, named `joining`, lets this process not in; "" if that is not known."""
        path = sockets.socket_of(self._namespace) if self._where.socket else None
        here = path is not None and sockets.holder(path) is not None
        door, folder = self._where.door, sockets.keys_here(self._namespace) if here else None
        if door is None:
            return self._of_closed(folder)
        if here and folder is None:
            return (
                f"the society at {path} is open, and this process has keys: end it (`armadico"
                " down`) and start it again with the host table that names the keys"
            )
        if not (here or joining or self._why):
            return ""
        # The files tell more than the handshake.
        known = door.faults(here) or [*filter(None, self._why.values())]
        place = str(path) if here else joining or " or ".join(self._why)
        if known:
            return f"{place} does not let {door.name} in: {'; '.join(known)}"
        if joining in self._accepted:
            return (
                f"{place} does not let {door.name} in: its port accepts this key, and the robot"
                " agent does not answer: it hangs, starts, or is overloaded"
            )
        if joining and not here:  # it makes the handshake, and refuses the identity or hangs
            return (
                f"{place} does not let {door.name} in: the key was revoked or made anew (`armadico"
                " keys list` on the robot's computer), or the robot agent hangs"
            )
        return ""

    def _of_closed(self, folder: object) -> str:
        """Return why a process without keys gets no link; "" if the society may be open."""
        todo = 'this process has no keys: use a host table with keys = "FOLDER" (`armadico keys`)'
        if folder is not None:
            return f"the society here is closed, with the keys in {folder}, and {todo}"
        for endpoint in self._where.connect:
            if endpoint.startswith("tcp/") and answers(endpoint, PROBE_S):
                from armadico.mesh.handshake import speaks_tls

                if speaks_tls(endpoint, PROBE_S):
                    return f"the society at {endpoint} is closed, and {todo}"
        return ""
