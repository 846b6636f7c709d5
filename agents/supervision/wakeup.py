"""The wakeup agent (thesis 3.8.3): starts a host's agents, and restarts those that end or hang.

Sans-IO: its device is the machine, a port that takes orders and returns events of the processes, a
line of JSON each. The same agent runs with real processes
(`armadico.launch.supervisor`) and on the virtual mesh (`armadico.launch.virtual`).

Only the wakeup agent of a host starts its processes. A process that ends is restarted within a
budget. A process that hangs does not end: a monitor detects that and requests a restart, which is a
SIGKILL followed by a normal restart. The wakeup agent does not decide which agent drives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf
from statistics import median
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta, Struct

from armadico.agents.supervision.messages import (
    HostShare,
    Kept,
    KeptState,
    WakeupOrder,
    WakeupReply,
    WakeupRequest,
)
from armadico.core import agent
from armadico.core.agent import DeviceAgent, Question
from armadico.core.mechanisms import mixed, mixture
from armadico.core.membership import agent_of
from armadico.core.messages import LABEL, Card, Message, MonitorReport, line
from armadico.core.restart_policy import MISUSED, Budget, slower

CARD_S: Final = 0.5
"""Timeout of a query for a card, s, before it is repeated."""

KILLED_S: Final = 60.0
"""How long the share has the reason of a kill, s."""

INQUIRY_S: Final = 1.5
"""Timeout of a query to a process before it is killed, s, times `slower`."""

START_S: Final = 30.0
"""A process that is not on the mesh this long after its start, s, hangs and is killed."""

MONITOR_S: Final = 10.0
"""A monitor of this host that has not reported for this long, s, hangs and is killed. Other
monitors watch it too, if there are any, and are faster. A process restarted in between is new."""

ROUTER_S: Final = 10.0
"""A robot agent of this host to which this process has had no link for this long, s, hangs and is
killed. Monitors cannot detect that, because all agents communicate through its router. It is up to
25 s on a loaded machine (`slower`)."""

LATE_S: Final = 0.1
"""A machine whose median wake-up is later than this, s, is overloaded. This is one cycle of a
robot: a bid that is later answers a cycle that is over."""

LATE_OF: Final = 8
"""Number of wake-ups in the median; there is at least one per second."""

HOLD_S: Final = 60.0
"""Minimum time for which processes are held back, s, doubled each time, because starting them is
load, too."""

HELD: Final = "it is held back: the machine is overloaded"

SLOW_START: Final = 4
"""Factor on `START_S` on an overloaded machine."""

PAUSES_S: Final = (0.0, 0.1, 0.2, 0.5)
"""Delay of a restart, s, by the number of restarts within the budget's window."""

IN_THE_WAY_S: Final = (1.0, 2.0, 5.0)
"""Delay of a restart if another instance is in the way, s, by how often in a row. It is not the
process's fault and does not count against the budget."""

NEWCOMER_S: Final = 3.0
"""A process refused within this time, s, was itself the newcomer: another instance was there first,
or started at the same time. The operator has to correct that."""

SHARES_S: Final = 1.5
"""Time from the start until the shares of all other hosts have been received, s."""

SHARE_S: Final = 1.0
"""Period of the share, s, as in the table of services."""

Names = tuple[Annotated[str, Meta(min_length=1, max_length=LABEL)], ...]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Processes of this host, and agents that it can start on request."""

    host: str
    processes: dict[str, Names] = msgspec.field(default_factory=dict)
    """Agents of each process, by its label; a simulator has none."""
    can: Names = ()
    needs: Names = ()
    router: str = ""
    """Name of the robot agent, if it belongs to this host."""
    restarts: int = 5
    within_s: float = 30.0


class Do(StrEnum):
    """Kind of an order to the machine."""

    START = "start"
    END = "end"  # SIGTERM, and SIGKILL if that is not enough
    KILL = "kill"
    SAY = "say"  # log a line
    READY = "ready"  # all agents are on the mesh
    GIVE_UP = "give up"


class Order(Struct, frozen=True):
    """An order to the machine."""

    do: Do
    label: str = ""
    text: str = ""


class Event(Struct, frozen=True, tag=True):
    """A process started or ended."""

    label: str
    pid: int = 0
    ending: str = ""  # how it ended, as text; empty: it started
    code: int = 0
    words: str = ""  # its last output


class Load(Struct, frozen=True, tag=True):
    """Load of the machine."""

    per_core: float  # runnable processes, averaged over the last minute


def lines(what: Struct) -> bytes:
    """Encode an order or an event for the port."""
    return msgspec.json.encode(what) + b"\n"


def orders(data: bytes) -> Iterator[Order]:
    """Decode orders."""
    return (msgspec.json.decode(text, type=Order) for text in data.splitlines())


@dataclass
class _Process:
    """A process of this host."""

    agents: tuple[str, ...]
    state: KeptState = KeptState.STARTING
    pid: int = 0
    lent: bool = False
    held: bool = False  # back, because the machine is overloaded
    why: str = ""
    killed: tuple[float, str] = (-inf, "")  # by this agent, not on request: when and why
    began_at: float | None = None  # started at, until it is on the mesh
    back_at: float = inf  # lent: since when its own host has it again
    reported_at: float | None = None  # last report of a monitor in it
    reporter: str = ""  # that monitor's instance
    due_at: float | None = None  # time of its next start
    since: float | None = None  # on the mesh since
    in_the_way: int = 0  # refusals in a row because of another instance
    requested: bool = False  # killed on request, not restarted yet

    def restart_timeouts(self, now: float) -> None:
        if self.began_at is not None:
            self.began_at = now
        if self.reported_at is not None:
            self.reported_at = now
        if self.back_at != inf:
            self.back_at = now

    def mark_up(self, now: float) -> None:
        self.began_at = None
        self.since = now if self.since is None else self.since
        self.in_the_way = 0


@dataclass
class _Pace:
    """Whether the machine is overloaded, judged by how late it wakes this agent."""

    late: deque[float] = field(default_factory=lambda: deque(maxlen=LATE_OF))  # s
    slow: bool = False
    until: float = 0.0  # earliest end of `slow`
    times: int = 0

    def woken(self, late: float, now: float) -> bool:
        """Record a lateness in s. Return whether `slow` changed."""
        self.late.append(late)
        typical = median(self.late)
        if not self.slow and len(self.late) == LATE_OF and typical > LATE_S:
            self.slow, self.until = True, now + HOLD_S * 2**self.times
            self.times += 1
            return True
        if self.slow and typical < LATE_S / 2 and now >= self.until:
            self.slow = False
            return True
        return False


class Wakeup(DeviceAgent):
    """Keeps a host's processes up within a budget, and answers requests."""

    name = "wakeup"
    receives: ClassVar[tuple[type[Message], ...]] = (HostShare, MonitorReport)
    provides: ClassVar[tuple[type[Message], ...]] = (HostShare,)
    answers: ClassVar[tuple[type[Message], ...]] = (WakeupRequest,)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.gave_up = False
        self.budget = Budget(self.p.restarts, self.p.within_s)
        # Restarts in the window: time, label, whether requested.
        self._restarts: deque[tuple[float, str, bool]] = deque()
        self._kept = {label: _Process(names) for label, names in self.p.processes.items()}
        # Instances whose token is present: name, and the card once it is received.
        self._present: dict[str, tuple[str, Card | None]] = {}
        self._other_tables: set[str] = set()  # digests of host tables that were reported
        # Of those that compete for something or own it, also before they appear here.
        self._contending: dict[str, Card] = {}
        self._mixed: dict[str, set[str]] = {}  # by resource: mechanisms that were reported
        self._shares: dict[str, HostShare] = {}  # of other hosts, by their wakeup agent
        self._half = b""  # incomplete last line
        self._load = 0.0
        self._ready = False
        self._share_at = self._shares_at = self._due_at = 0.0
        self._pace = _Pace()
        self._cut_at = inf  # the robot's router is unreachable since
        self._linked_at = 0.0  # reachable since, if it is
        self._early: list[Event] = []  # refusals, kept until other hosts' shares are received

    # Other agents --------------------------------------------------------------------------------

    def on_start(self) -> None:
        # That an instance ended before the start was not reported to this agent.
        for gone in self._contending.keys() - self.kernel.living:
            del self._contending[gone]
        self._shares_at = self.now + SHARES_S
        self._cut_at = inf if self.reachable else self.now
        self._linked_at = self.now
        self._publish_share()

    def on_appeared(self, name: str, instance: str) -> None:
        self._present[instance] = (name, None)
        self._query_card(name, instance)
        self._compare_mechanisms()

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        self._present.pop(instance, None)
        self._shares.pop(instance, None)
        self._contending.pop(instance, None)

    def on_card(self, card: Card) -> None:
        if card.instance in self._present:
            self._present[card.instance] = (card.name, card)
            self._check_started()
        own = self.identity.table
        if own and card.table and card.table != own and card.table not in self._other_tables:
            self._other_tables.add(card.table)
            what = f"{card.host} has another host table ({card.table}) than {self.p.host} ({own})"
            self.log(f"{what}: copy one to all hosts, and start their agents again", agent.WARNING)
        if card.resources or card.owns:
            self._contending[card.instance] = card
            self._compare_mechanisms()

    def _compare_mechanisms(self) -> None:
        """Say that agents of several hosts compete by different mechanisms.

        Each host's command knows its own alone. On the owner's host the owner says it.
        """
        cards = [card for card in self._contending.values() if card.instance in self._present]
        owned = {name for card in cards if card.host == self.p.host for name in card.owns}
        hosts = {card.instance: card.host for card in cards}
        for name, by in mixed(cards).items():
            if name in owned or self._mixed.setdefault(name, set()).issuperset(by):
                continue
            self._mixed[name] |= by.keys()
            sides = {each: [f"{one} on {hosts[one]}" for one in by[each]] for each in by}
            self._order(Do.SAY, text=f"{mixture(name, sides)}; choose the same on each host")

    def on_router(self) -> None:
        """Restart every timeout that counts what other processes publish.

        What was not received while the router was away is nobody's fault.
        """
        self._cut_at = inf if self.reachable else self.now
        if self.reachable:
            self._linked_at = self.now
            self._shares_at = self.now + SHARES_S
            for process in self._kept.values():
                process.restart_timeouts(self.now)

    def on_host_share(self, share: HostShare) -> None:
        self._shares[share.instance] = share
        self._end_returned()

    def _end_returned(self) -> None:
        """End a lent process once its own host has kept the agent for `NEWCOMER_S`.

        Not before: if only one instance is allowed, the newcomer leaves by itself.
        """
        back = {
            name: share.host
            for share in self._shares.values()
            for kept in share.kept
            if kept.state is KeptState.UP and not kept.lent
            for name in kept.agents
        }
        for label, process in list(self._kept.items()):
            if not process.lent or not back.keys() >= set(process.agents):
                process.back_at = inf
                continue
            process.back_at = min(process.back_at, self.now)
            if self.now - process.back_at >= NEWCOMER_S:
                if process.pid:
                    self._order(Do.END, label)
                self._drop(label, f"{back[process.agents[0]]} runs it again")

    def on_monitor_report(self, report: MonitorReport) -> None:
        _, card = self._present.get(report.instance, ("", None))
        for process in self._kept.values():
            if card is not None and (card.host, card.pid) == (self.p.host, process.pid):
                process.reported_at, process.reporter = self.now, report.instance

    def _query_card(self, name: str, instance: str) -> None:
        """Query for a card until it is received, in parallel to other queries."""
        if self._present.get(instance) != (name, None):
            return
        if not any(name in p.agents for p in self._kept.values() if p.state is KeptState.STARTING):
            return

        def on_card(card: Card | None) -> None:
            if card is not None and card.instance == instance:
                self.on_card(card)
            else:
                self._query_card(name, instance)

        self.query_card(name, instance, on_card, CARD_S)

    def _check_started(self) -> None:
        """Mark the starting processes whose agents are all on the mesh as up."""
        cards = [card for _, card in self._present.values() if card is not None]
        here = {(card.name, card.pid) for card in cards if card.host == self.p.host}
        for label, process in self._kept.items():
            starting = process.state is KeptState.STARTING and process.pid
            if starting and all((name, process.pid) in here for name in process.agents):
                process.mark_up(self.now)
                self._set_state(label, KeptState.UP)
        self._check_ready()

    def _check_ready(self) -> None:
        """Report once that all agents are on the mesh, here or on a host that replaces this one."""
        if not self._ready and all(
            process.state is KeptState.UP
            or process.held
            or (process.state is KeptState.WAITING and all(map(self._replaced, process.agents)))
            for process in self._kept.values()
        ):
            self._ready = True
            self._order(Do.READY)

    # The machine ---------------------------------------------------------------------------------

    def on_bytes(self, data: bytes) -> None:
        *whole, self._half = (self._half + data).split(b"\n")
        for text in whole:
            event = msgspec.json.decode(text, type=Event | Load)
            if isinstance(event, Load):
                self._load = event.per_core
            elif event.ending:
                self._ended(event)
            else:
                self._began(event)

    def _began(self, event: Event) -> None:
        process = self._kept.get(event.label)
        if process is None:
            return
        process.pid = event.pid
        process.began_at = self.now if process.agents else None
        self._set_state(event.label, KeptState.STARTING if process.agents else KeptState.UP)
        if not process.agents:
            process.mark_up(self.now)
        for instance, (name, _) in sorted(self._present.items()):
            self._query_card(name, instance)
        self._check_started()

    def _ended(self, event: Event) -> None:
        label, process = event.label, self._kept.get(event.label)
        if process is None:
            return
        if event.code == MISUSED and self.now < self._shares_at:
            self._early.append(event)
            self._schedule()
            return
        process.pid, process.began_at, process.reported_at = 0, None, None
        if process.held:
            self._set_state(label, KeptState.WAITING, HELD)
            self._check_ready()
            return
        if process.state is KeptState.ENDED:  # on request
            self._publish_share()
            return
        if process.lent and event.code == MISUSED:  # its own host has one too, as after a partition
            self._drop(label, "another instance is in its way")
            return
        replaced = any(self._replaced(name) for name in process.agents)
        why = self._plan_restart(label, event.code, replaced=replaced)
        if why and process.lent:  # a lent agent must not end this host's own
            self._drop(label, f"{label} ended with {event.ending}, {why}")
            return
        if why:
            self.gave_up = True
            self._order(
                Do.GIVE_UP,
                text=f"{label} ended with {event.ending}, and is not started again: {why}."
                f" Its last output:\n{event.words}",
            )
            return
        if process.in_the_way:
            text = (
                f"{label} left: another instance is in its way; the other agents continue,"
                " and it is retried"
            )
        else:
            text = f"{label} ended with {event.ending}; it is started again"
        self._order(Do.SAY, text=text)
        self._set_state(label, KeptState.WAITING, f"it ended with {event.ending}: {event.words}")
        self._check_ready()

    def _plan_restart(self, label: str, code: int, *, replaced: bool) -> str:
        """Schedule the restart of a process that ended with `code`. Return why not, or "".

        `replaced`: another host started the agent in its place. A refusal is then not an error of
        the configuration, however early it comes.
        """
        process = self._kept[label]
        worked = 0.0 if process.since is None else self.now - process.since
        if code == MISUSED and not replaced and worked < NEWCOMER_S:
            return "its configuration is wrong or another instance runs; a restart would not help"
        if code == MISUSED:
            pause = IN_THE_WAY_S[min(process.in_the_way, len(IN_THE_WAY_S) - 1)]
            process.in_the_way += 1
        else:
            process.in_the_way = 0
            if not process.requested and (why := self._spent(requested=False)):
                return why
            count = sum(1 for _, other, _ in self._restarts if other == label)
            pause = PAUSES_S[min(count, len(PAUSES_S) - 1)]
        process.due_at = self.now + pause
        return ""

    def _spent(self, *, requested: bool = True) -> str:
        """Return why no more restarts are allowed now, or "".

        Restarts on request do not count towards those of processes that failed, because a request
        must not be what ends a host. Requests are refused once both together have spent the budget.
        """
        while self._restarts and self._restarts[0][0] <= self.now - self.budget.within_s:
            self._restarts.popleft()
        planned = [p for p in self._kept.values() if p.due_at is not None and not p.in_the_way]
        spent = [was for *_, was in self._restarts] + [p.requested for p in planned]
        if len(spent) - (0 if requested else sum(spent)) < self.budget.restarts:
            return ""
        most, within = self.budget.restarts, self.budget.within_s
        return f"the budget of {most} restarts in {within:g} s is spent"

    def _restart_due(self, label: str, process: _Process) -> None:
        process.due_at = None
        if not process.in_the_way:
            self._restarts.append((self.now, label, process.requested))
        process.requested = False
        if process.held:
            return
        if process.in_the_way and any(map(self._replaced, process.agents)):
            self._plan_restart(label, MISUSED, replaced=True)  # it would be refused again
            return
        self._set_state(label, KeptState.STARTING)
        self._order(Do.START, label)

    def _replaced(self, name: str) -> bool:
        """Whether another host runs a lent agent of this name."""
        shares = self._shares.values()
        return any(kept.lent and name in kept.agents for share in shares for kept in share.kept)

    def _order(self, do: Do, label: str = "", text: str = "") -> None:
        self.write(lines(Order(do, label, text)))

    # Requests ------------------------------------------------------------------------------------

    def on_wakeup_request(self, request: WakeupRequest, _question: Question) -> WakeupReply:
        found = [label for label, p in self._kept.items() if request.agent in p.agents]
        do = {
            WakeupOrder.START: self._start,
            WakeupOrder.RESTART: self._restart,
            WakeupOrder.END: self._end,
        }[request.order]
        refusal = do(request, found)
        if refusal:
            refusal = f"{self.p.host}: {refusal}"
            self.log(f"{request.order} {request.agent}: refused: {refusal}", agent.WARNING)
        return WakeupReply(line(refusal))

    def _start(self, request: WakeupRequest, found: list[str]) -> str:
        if any(self._kept[label].held for label in found):
            return HELD
        if any(self._kept[label].state is not KeptState.ENDED for label in found):
            return ""  # it is kept up already
        if not found and request.agent not in self.p.can:
            able = ", ".join(self.p.can) or "none"
            return f"it cannot start {request.agent}; it can start: {able}"
        if refusal := self._spent():
            return refusal
        for label in found or [request.agent]:
            lent = not found
            process = self._kept.setdefault(label, _Process((request.agent,), lent=lent))
            process.state = KeptState.STARTING
            self._order(Do.SAY, text=f"{label} is started: {_reason(request)}")
            self._order(Do.START, label)
        self._publish_share()
        return ""

    def _restart(self, request: WakeupRequest, found: list[str]) -> str:
        if not found:
            return f"{request.agent} is not an agent of this host"
        if any(self._kept[label].held for label in found):
            return HELD
        for label in found:
            process = self._kept[label]
            meant = request.pid in (0, process.pid)
            if process.state is KeptState.ENDED or not (process.pid and meant):
                continue  # another process has replaced it, or will
            if refusal := self._spent():
                return refusal
            process.requested = True
            self._kill(label, _reason(request), requested=True)
        return ""

    def _kill(self, label: str, why: str, *, requested: bool = False) -> None:
        """Kill a process, with the evidence for the log and for observers."""
        text = f"{label} is killed: {why}"
        if not requested:  # the evidence of a request is that of the monitor, which reports it
            self._kept[label].killed = self.now, text
        self._order(Do.SAY, text=text)
        self._order(Do.KILL, label)
        self._publish_share()

    def _end(self, request: WakeupRequest, found: list[str]) -> str:
        if not found:
            return f"{request.agent} is not an agent of this host"
        for label in found:
            if self._kept[label].state is KeptState.ENDED:
                continue
            self._order(Do.SAY, text=f"{label} is ended: {_reason(request)}")
            if self._kept[label].pid:
                self._order(Do.END, label)
            self._drop(label, _reason(request))
        return ""

    def _drop(self, label: str, why: str) -> None:
        """Do not restart it: forget a lent process, mark an own one as ended."""
        process = self._kept[label]
        process.due_at, process.since, process.in_the_way = None, None, 0
        process.requested = process.held = False
        if process.lent:
            del self._kept[label]
            self._order(Do.SAY, text=f"{label} is no longer kept up by this host: {why}")
            self._publish_share()
        else:
            self._set_state(label, KeptState.ENDED, why)

    # Timers --------------------------------------------------------------------------------------

    def on_wakeup(self) -> None:
        """Start due processes, kill hung ones, and publish the share."""
        if self._pace.woken(self.now - self._due_at, self.now):
            if self._pace.slow:
                self._hold_back()
            else:
                self._release_held()
        if self.now >= self._shares_at:
            early, self._early = self._early, []
            for event in early:
                self._ended(event)
        for label, process in self._kept.items():
            if process.due_at is not None and process.due_at <= self.now:
                self._restart_due(label, process)
        self._kill_hung()
        if self.now >= self._share_at:
            self._publish_share()
        self._schedule()

    def _kill_hung(self) -> None:
        times = slower(self._load)
        start_s = START_S * times * (SLOW_START if self._pace.slow else 1)
        for label, process in self._kept.items():
            up = process.state is KeptState.UP and process.pid
            if self._is_router(process) and up and self.now - self._cut_at >= ROUTER_S * times:
                cut_s, self._cut_at = self.now - self._cut_at, self.now
                self._kill(
                    label,
                    f"this process ({self.instance}) has had no link to its router for"
                    f" {cut_s:.0f} s, and the router accepts none",
                )
            elif not self.reachable and not self._is_router(process):
                continue  # no agent can be seen
            elif process.began_at is not None and self.now - process.began_at >= start_s:
                process.began_at = None
                self._kill(
                    label, f"it cannot be seen on the mesh after {start_s:.0f} s; {self._received}"
                )
            elif (
                process.reported_at is not None
                and self.now - process.reported_at >= MONITOR_S * times
            ):
                self._inquire(label, process)

    def _inquire(self, label: str, process: _Process) -> None:
        """Query the card of a process's silent monitor; kill the process if there is no reply.

        Its reports may be lost on the way, as to an agent that was not linked meanwhile.
        """
        silent_s, pid = self.now - (process.reported_at or 0.0), process.pid
        process.reported_at = self.now  # one query at a time

        def on_card(found: Card | None) -> None:
            if found is not None or process.pid != pid or not self.reachable:
                return
            process.reported_at = None
            self._kill(
                label,
                f"its monitor has not reported for {silent_s:.0f} s and does not answer;"
                f" {self._received}",
            )

        name = agent_of(process.reporter)
        self.query_card(name, process.reporter, on_card, INQUIRY_S * slower(self._load))

    @property
    def _received(self) -> str:
        """What this process itself receives: the evidence that it could."""
        return (
            f"this process ({self.instance}) has been linked to the router for"
            f" {self.now - self._linked_at:.0f} s and sees {len(self._present)} agents"
        )

    def _is_router(self, process: _Process) -> bool:
        return self.p.router in process.agents

    def _hold_back(self) -> None:
        """End the processes that are not needed while this machine is overloaded."""
        needed = set(self.p.needs)
        for label, process in self._kept.items():
            without = needed and process.agents and not needed & set(process.agents)
            if without and process.state is not KeptState.ENDED:
                process.held = True
                if process.pid:
                    self._order(Do.END, label)
                self._set_state(label, KeptState.WAITING, HELD)
        labels = ", ".join(self._held())
        held = f"; held back: {labels}" if labels else ""
        text = (
            f"{self.p.host} cannot keep up: processes run {median(self._pace.late):.2f} s late, a"
            f" cycle is {LATE_S:g} s (load {self._load:.1f} per core){held}. End other"
            " programs, use another host for some agents (--hosts), or leave some out (--without)"
        )
        self._order(Do.SAY, text=text)

    def _release_held(self) -> None:
        held = self._held()
        again = f"; started again: {', '.join(held)}" if held else ""
        self._order(Do.SAY, text=f"{self.p.host} keeps up again{again}")
        for label in held:
            self._kept[label].held = False
            self._set_state(label, KeptState.STARTING)
            self._order(Do.START, label)

    def _held(self) -> list[str]:
        return [label for label, process in self._kept.items() if process.held]

    def _schedule(self) -> None:
        """Schedule the next wake-up: the next start or share. Hung starts are detected then."""
        due = [p.due_at for p in self._kept.values() if p.due_at is not None]
        early = [self._shares_at] if self._early else []
        self._due_at = min([self._share_at, *early, *due])
        self.wake_at(self._due_at)

    def _set_state(self, label: str, state: KeptState, why: str = "") -> None:
        process = self._kept[label]
        process.state, process.why = state, why
        self._publish_share()

    def _publish_share(self, *, leaving: bool = False) -> None:
        kept = tuple(
            Kept(p.agents, p.state, p.pid, p.lent, line(p.why), self._killed(p))
            for p in self._kept.values()
        )
        can = tuple(name for name in self.p.can if not any(name in k.agents for k in kept))
        needs = () if leaving else self.p.needs
        self.publish(HostShare(self.instance, self.p.host, kept, can, needs, leaving, self._load))
        self._share_at = self.now + SHARE_S
        self._schedule()

    def _killed(self, process: _Process) -> str:
        at, why = process.killed
        return line(why) if self.now - at <= KILLED_S else ""

    def on_leave(self) -> None:
        """Leave in order: no other host replaces these agents, unless this host gave up."""
        if not self.gave_up:
            self._publish_share(leaving=True)


def _reason(request: WakeupRequest) -> str:
    return request.why or "requested"
