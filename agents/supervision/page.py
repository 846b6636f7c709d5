"""Supervision on the control page: processes that hosts keep up, restarts and starts (sans-IO)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Annotated, Any, Final, NamedTuple

from msgspec import Meta

from armadico.agents.supervision.messages import (
    HostShare,
    Kept,
    KeptState,
    WakeupOrder,
    WakeupRequest,
)
from armadico.core.messages import Message, Name
from armadico.core.services import service_of
from armadico.gateways.page.part import Desk, Part
from armadico.gateways.page.requests import Asked, RequestError, Start
from armadico.observe.pictures import colour

SHARE_S: Final = 5.0
"""A host whose report is older than this keeps no process up."""


class Restart(Asked, frozen=True, tag="restart"):
    """Kill the process of an agent, and start it again."""

    agent: Name
    pid: Annotated[int, Meta(ge=0, le=2**52)] = 0


class _KeptAgent(NamedTuple):
    """An agent that a host keeps up."""

    agent: str
    process: Kept
    share: HostShare


class Processes(Part):
    """What the wakeup agents report, and orders to them: no other agent may end a process."""

    requests = (Restart,)

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._shares: dict[str, tuple[HostShare, float]] = {}

    def request(self, browser: str, request: Restart, t: float) -> None:
        """Restart an agent."""
        agent = request.agent
        kept = (each for each in self._kept(t) if each.agent == agent)
        chosen = next((each for each in kept if each.process.pid == request.pid), None)
        if chosen is None:
            raise RequestError(
                f"nobody keeps {agent} up, so nobody would start it again: that is done by"
                " `armadico up`"
            )
        why = f"asked by {browser}"
        order = WakeupRequest(WakeupOrder.RESTART, agent, chosen.process.pid, why)
        key = _key(chosen.share.instance)
        self.desk.query(browser, request.id, order, lambda _: f"{agent} is restarted", key=key)

    def receive(self, key: str, message: Message, t: float) -> None:
        """A host's report; a host is queried by the name in it, so that must be its key's."""
        if not isinstance(message, HostShare):
            return
        if key == service_of(HostShare).key_for(instance=message.instance):
            self._shares[message.instance] = (message, t)

    def on_token(self, instance: str, *, there: bool) -> None:
        """Forget a wakeup agent that has ended."""
        if not there:
            self._shares.pop(instance, None)

    def startable(self, t: float) -> Collection[str]:
        """The agents that a host would start."""
        return {name for share in self._fresh(t) for name in share.can}

    def start(self, browser: str, request: Start, t: float) -> None:
        """Ask the last host that reported it."""
        agent = request.agent
        share = [share for share in self._fresh(t) if agent in share.can][-1]
        order = WakeupRequest(WakeupOrder.START, agent, 0, f"asked by {browser}")
        key = _key(share.instance)
        self.desk.query(browser, request.id, order, lambda _: f"{agent} is started", key=key)

    def show(self, parts: dict[str, Any], t: float) -> None:
        """Mark the agents that a host keeps up, and add those of them that are not alive."""
        kept = {(each.agent, each.process.pid): each for each in self._kept(t)}
        rows = parts["agents"]
        for row in rows:
            row["kept"] = kept.pop((row["name"], row["pid"]), None) is not None
        for name, process, share in kept.values():
            if name not in self.view.names:
                row = {"name": name, "instance": "", "colour": colour(name)}
                row |= {"alive": False, "pid": 0, "kept": True, "host": share.host}
                rows.append(row | {"state": process.state.value, "why": process.why})
        rows.sort(key=lambda row: (row["name"], row["instance"]))

    def _fresh(self, t: float) -> Iterator[HostShare]:
        for share, at in self._shares.values():
            if t - at <= SHARE_S and not share.leaving:
                yield share

    def _kept(self, t: float) -> Iterator[_KeptAgent]:
        """The agents that hosts keep up, alive or not."""
        for share in self._fresh(t):
            for process in share.kept:
                if process.state is not KeptState.ENDED:
                    yield from (_KeptAgent(name, process, share) for name in process.agents)


def _key(wakeup: str) -> str:
    return service_of(WakeupRequest).key_for(instance=wakeup)
