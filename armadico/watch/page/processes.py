"""The supervision part of the control page: processes of hosts, restarts, starts. Sans-IO."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Annotated, Final, NamedTuple

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
from armadico.observe.page_part import Desk, Part
from armadico.observe.page_requests import Asked, RequestError, Start
from armadico.watch.pictures import colour

SHARE_S: Final = 5.0
"""Timeout of a host's report, s."""


class Restart(Asked, frozen=True, tag="restart"):
    """Kill and restart the process of an agent."""

    agent: Name
    pid: Annotated[int, Meta(ge=0, le=2**52)] = 0


class _KeptAgent(NamedTuple):
    """An agent that a host keeps up."""

    agent: str
    process: Kept
    share: HostShare


class Processes(Part):
    """Reports of the wakeup agents, and orders to them: only they may end processes."""

    requests = (Restart,)
    queries = (WakeupRequest,)

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self._shares: dict[str, tuple[HostShare, float]] = {}

    def request(self, browser: str, request: Restart, t: float) -> None:
        agent = request.agent
        kept = (each for each in self._kept(t) if each.agent == agent)
        chosen = next((each for each in kept if each.process.pid == request.pid), None)
        if chosen is None:
            raise RequestError(
                f"cannot restart {agent}: no host keeps it up; start it with `armadico up`"
            )
        why = f"requested by {browser}"
        order = WakeupRequest(WakeupOrder.RESTART, agent, chosen.process.pid, why)
        key = _key(chosen.share.instance)
        self.desk.query(browser, request.id, order, lambda _: f"{agent} is restarted", key=key)

    def receive(self, key: str, message: Message, t: float) -> None:
        """Store a host's report."""
        if not isinstance(message, HostShare):
            return
        # The host is queried by the instance in the report, so it must match the key.
        if key == service_of(HostShare).key_for(instance=message.instance):
            self._shares[message.instance] = (message, t)

    def on_token(self, instance: str, *, there: bool) -> None:
        if not there:
            self._shares.pop(instance, None)

    def startable(self, t: float) -> Collection[str]:
        return {name for share in self._fresh(t) for name in share.can}

    def start(self, browser: str, request: Start, t: float) -> None:
        """Send the order to the last host that reported that it can start the agent."""
        agent = request.agent
        share = [share for share in self._fresh(t) if agent in share.can][-1]
        order = WakeupRequest(WakeupOrder.START, agent, 0, f"requested by {browser}")
        key = _key(share.instance)
        self.desk.query(browser, request.id, order, lambda _: f"{agent} is started", key=key)

    def show(self, parts: dict[str, object], t: float) -> None:
        """Mark agents that a host keeps up; add rows for those that are not alive."""
        kept = {(each.agent, each.process.pid): each for each in self._kept(t)}
        rows = parts["agents"]
        assert isinstance(rows, list), "the page adds this part first"
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
        """Yield the agents that hosts keep up, alive or not."""
        for share in self._fresh(t):
            for process in share.kept:
                if process.state is not KeptState.ENDED:
                    yield from (_KeptAgent(name, process, share) for name in process.agents)


def _key(wakeup: str) -> str:
    return service_of(WakeupRequest).key_for(instance=wakeup)
