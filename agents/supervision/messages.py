"""The messages of monitor and wakeup agents: processes of hosts, and orders to restart them."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from armadico.core.messages import Counter, Message, Name, Text
from armadico.core.services import query, state


class KeptState(StrEnum):
    """The state of a process, as its host reports it."""

    STARTING = "starting"
    UP = "up"
    WAITING = "waiting"  # it has ended, and its host will restart it
    ENDED = "ended"  # on request; it is not restarted


class Kept(Message, frozen=True):
    """One process of a host: its agents and its state."""

    agents: tuple[Name, ...]
    state: KeptState
    pid: Counter = 0  # 0: there is no process now
    lent: bool = False  # started on request, instead of a host that is gone
    why: Text = ""  # why it waits or has ended


class HostShare(Message, frozen=True):
    """The processes that a host keeps running, as its wakeup agent reports them (thesis 3.8.3).

    `needs` are the agents of the whole society that the requested run depends on, those of other
    hosts included. A host that leaves in order reports so: its agents are then not missed. All
    timeouts for a host's agents grow with its `load`.
    """

    instance: Name  # of the wakeup agent
    host: Text
    kept: tuple[Kept, ...]
    can: tuple[Name, ...] = ()  # further agents that it would start on request
    needs: tuple[Name, ...] = ()
    leaving: bool = False
    load: Annotated[float, Meta(ge=0, le=1e6)] = 0.0  # runnable processes per core; 0: unknown


class WakeupOrder(StrEnum):
    """An order to a wakeup agent."""

    START = "start"
    RESTART = "restart"
    END = "end"


class WakeupRequest(Message, frozen=True):
    """Orders a host's wakeup agent to start an agent, to end it, or to kill and restart it.

    `pid` is the process that hangs. If it has been replaced already, nothing is done, and that is
    no refusal. So several orders restart it once.
    """

    order: WakeupOrder
    agent: Name
    pid: Counter = 0  # 0: any process
    why: Text = ""


class WakeupReply(Message, frozen=True):
    """Whether the order is executed, or the reason of its refusal."""

    refusal: Text = ""


state(HostShare, "wakeup/{instance}/share", 1, None, "processes of a host; agents it can start")
query(WakeupRequest, "wakeup/{instance}", WakeupReply, "start, restart or end an agent on a host")
