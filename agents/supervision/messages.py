"""The messages of monitor and wakeup agents: which agents are alive, and who restarts which."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from armadico.core.messages import Counter, Message, Name, Text
from armadico.core.services import query, state


class KeptState(StrEnum):
    """What a process is doing, by the word of the one who started it."""

    STARTING = "starting"
    UP = "up"
    WAITING = "waiting"  # it has ended, and is started again by its host
    ENDED = "ended"  # as somebody asked, and is not started again


class Kept(Message, frozen=True):
    """One process of a host: the agents that live in it, and how it is."""

    agents: tuple[Name, ...]
    state: KeptState
    pid: Counter = 0  # 0: there is none now
    lent: bool = False  # started on request, in place of a host that is gone
    why: Text = ""  # it waits or has ended


class HostShare(Message, frozen=True):
    """What a host keeps up, and what it could: its wakeup agent's word (thesis 3.8.3).

    `needs` are the agents of the whole society that what was asked for cannot do without, those of
    other hosts too. A host that leaves in order says so: what it kept up is then missed by nobody.
    `load` tells whoever waits for its agents how much longer everything takes there.
    """

    instance: Name  # of the wakeup agent
    host: Text
    kept: tuple[Kept, ...]
    can: tuple[Name, ...] = ()  # agents that it would start besides, if asked to
    needs: tuple[Name, ...] = ()
    leaving: bool = False
    load: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    """Runnable processes per core, on average over the last minute; 0: not known."""


class WakeupOrder(StrEnum):
    """What a wakeup agent can be asked for."""

    START = "start"
    RESTART = "restart"
    END = "end"


class WakeupRequest(Message, frozen=True):
    """Asks a host's wakeup agent to start an agent, to end it, or to kill and start it again.

    `pid` is the process that hangs: if another is there by now, nothing is done, and that is no
    refusal. So however many ask, it is restarted once.
    """

    order: WakeupOrder
    agent: Name
    pid: Counter = 0  # 0: whichever it is
    why: Text = ""


class WakeupReply(Message, frozen=True):
    """Whether it is done, or why not."""

    refusal: Text = ""


state(HostShare, "wakeup/{instance}/share", 1, None, "what a host keeps up, and could")
query(WakeupRequest, "wakeup/{instance}", WakeupReply, "start, restart or end an agent on a host")
