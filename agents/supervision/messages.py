"""Messages of the wakeup agents: the processes of a host, and requests to start or end them."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.core.messages import Counter, Message, Name, Text
from armadico.core.services import query, state


class KeptState(StrEnum):
    """State of a process, as reported by its wakeup agent."""

    STARTING = "starting"
    UP = "up"
    WAITING = "waiting"  # it has ended; its host restarts it
    ENDED = "ended"  # on request; it is not restarted


class Kept(Message, frozen=True):
    """A process of a host: its agents and its state."""

    agents: tuple[Name, ...]
    state: KeptState
    pid: Counter = 0  # 0: none now
    lent: bool = False  # started on request, in place of a host that is gone
    why: Text = ""  # reason, if waiting or ended
    killed: Text = ""  # why its host killed it within the last minute, not on request

    appended: ClassVar[int] = 1


class HostShare(Message, frozen=True):
    """The processes that a host keeps up, and the agents that it could start (thesis 3.8.3).

    `needs` are the agents that the scenario cannot do without, on this host or another. A host that
    leaves in order sets `leaving`: the monitor then does not report its agents as missing. `load`
    lengthens the timeouts of the host's agents.
    """

    instance: Name  # of the wakeup agent
    host: Text
    kept: tuple[Kept, ...]
    can: tuple[Name, ...] = ()  # agents that it starts on request
    needs: tuple[Name, ...] = ()
    leaving: bool = False
    load: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    """Runnable processes per core, averaged over the last minute; 0: unknown."""


class WakeupOrder(StrEnum):
    """An order to a wakeup agent."""

    START = "start"
    RESTART = "restart"
    END = "end"


class WakeupRequest(Message, frozen=True):
    """Request to a wakeup agent: start an agent, end it, or kill and restart it.

    `pid` is the process that hangs. If another process has replaced it, the request does nothing
    and is not refused. Several requests therefore restart it once.
    """

    order: WakeupOrder
    agent: Name
    pid: Counter = 0  # 0: any
    why: Text = ""


class WakeupReply(Message, frozen=True):
    """Reply to a request; `refusal` is empty if it was accepted."""

    refusal: Text = ""


state(
    HostShare, "wakeup/{instance}/share", 1, None, "processes of a host, and agents it could start"
)
query(WakeupRequest, "wakeup/{instance}", WakeupReply, "start, restart or end an agent on a host")
