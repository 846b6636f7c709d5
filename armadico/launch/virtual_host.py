"""A host on the virtual mesh: its wakeup agent and the processes that it starts."""

from __future__ import annotations

from collections.abc import Callable

from armadico.agents.supervision.wakeup import Do, Event, Parameters, Wakeup, lines, orders
from armadico.core.restart_policy import MISUSED
from armadico.launch.virtual import Rehearsal, Share
from armadico.mesh.virtual import Node

START_S = 0.8
"""Time from a restart until the process joins the mesh, s."""

POLL_S = 0.05
"""Polling period for ended processes, s, as in `supervisor`."""

KILLED = -9
"""Exit code of a killed process."""


class VirtualHost:
    """A machine on the virtual mesh: the device of its wakeup agent, with the processes."""

    def __init__(self, run: Rehearsal, share: Share) -> None:
        """Start all processes of `share` in `run`."""
        name, groups = share.host, share.processes
        self.groups = groups
        self.notes: list[str] = []  # log lines of the wakeup agent
        self.due = run.mesh.now
        self._run = run
        self._name = name
        self._nodes: dict[str, list[Node]] = {}
        self._starts: dict[str, float] = {}  # by label: when its process joins, s
        self._events: list[Event] = []
        for label in groups:
            self._begin(label)
        parameters = Parameters(
            host=name,
            processes={label: tuple(m.name for m in g) for label, g in groups.items()},
            can=share.can,
            needs=share.needs,
            router=share.router,
        )
        # It starts the robot agent, so it does not wait for it.
        self.wakeup = run.add(Wakeup, parameters, host=name, device=self, waits=False)

    def receive(self, data: bytes, now: float) -> None:
        for order in orders(data):
            match order.do:
                case Do.START:
                    self._starts[order.label] = now + START_S
                case Do.KILL:
                    self._end(order.label, Node.kill)
                case Do.END:
                    self._end(order.label, Node.leave)
                case Do.GIVE_UP:
                    self.notes.append(order.text)
                    self.lose()
                case Do.SAY:
                    self.notes.append(order.text)

    def advance(self, now: float) -> bytes:
        """See `Device`: return the starts and ends of processes."""
        self.due = now + POLL_S
        for label in [label for label, at in self._starts.items() if at <= now]:
            del self._starts[label]
            if self.wakeup.alive:  # its processes end with it
                self._begin(label)
        for label, nodes in list(self._nodes.items()):
            gone = next((node for node in nodes if not node.alive), None)
            if gone is None:
                continue
            del self._nodes[label]
            for node in nodes:
                if node.alive:
                    node.kill()
            refusal = gone.driver.refusal
            code, how = (MISUSED, "status 2") if refusal else (KILLED, "signal SIGKILL")
            self._events.append(Event(label, 0, how, code, refusal))
        events, self._events = self._events, []
        return b"".join(map(lines, events))

    def lose(self) -> None:
        """Kill all processes and the wakeup agent at once."""
        self._starts.clear()
        for node in (*(node for nodes in self._nodes.values() for node in nodes), self.wakeup):
            if node.alive:
                node.kill()

    def leave(self) -> None:
        """Leave in order, as on `armadico down`."""
        self.wakeup.leave()
        for label in self._nodes:
            self._end(label, Node.leave)

    def _begin(self, label: str) -> None:
        names = [member.name for member in self.groups.get(label, ())] or [label]
        self._nodes[label] = nodes = [self._run.enter(name, host=self._name) for name in names]
        self._events.append(Event(label, nodes[0].agent.identity.pid))

    def _end(self, label: str, how: Callable[[Node], None]) -> None:
        for node in self._nodes.get(label, ()):
            if node.alive:
                how(node)
