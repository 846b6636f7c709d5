"""The wakeup agent (thesis 3.8.3): starts a host's agents, and restarts them if they end or hang.

Sans-IO: its device is the machine. Orders go out by a port, and events of processes come in, one
line of JSON each. So the same agent works on real processes
(`armadico.agents.supervision.supervisor`) and on the virtual mesh (`armadico.launch.virtual`).

Only the wakeup agent of a host starts its processes. A process that ends is restarted within a
budget. A monitor detects a process that hangs, and orders a restart: a SIGKILL, followed by the
same steps. The wakeup agent does not decide which agent drives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from math import inf
from statistics import median
from typing import Annotated, Any, ClassVar, Final

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
from armadico.core.messages import LABEL, Card, Message, MonitorReport, line
from armadico.core.restart_policy import MISUSED, Budget, slower

CARD_S: Final = 0.5  # the timeout of a query for a card, before it is repeated

# A process that is not seen on the mesh for this time after its start hangs, and is killed.
START_S: Final = 30.0

# A monitor of this host that is silent for this time hangs, and is killed. Other monitors, if there
# are any, are faster; a process that they had killed is another one by then.
MONITOR_S: Final = 10.0

# A robot agent of this host that accepts no links for this time hangs, and is killed. No other
# agent can detect that, because all are connected through it.
ROUTER_S: Final = 10.0

# A machine is overloaded if it typically wakes this agent later than this, one cycle of a robot: a
# bid that is later answers a cycle that is over.
LATE_S: Final = 0.1

LATE_OF: Final = 8  # wake-ups in a row that are judged; there is at least one per second

# Processes are held back for at least this time, doubled each time: starting them is load, too.
HOLD_S: Final = 60.0

HELD: Final = "it is held back: the machine cannot keep up"

PATIENT: Final = 4  # factor on the timeout of a start on an overloaded machine

# The pause before a restart, by the number of starts within the budget's window.
PAUSES_S: Final = (0.0, 0.1, 0.2, 0.5)

# The pause if another process is in the way, by the number of times in a row. That is not the
# process's fault, and is not taken from the budget.
IN_THE_WAY_S: Final = (1.0, 2.0, 5.0)

# A process that leaves this soon was a newcomer itself: it was started beside another one, or at
# the same time. People must resolve that.
NEWCOMER_S: Final = 3.0

HEARD_S: Final = 1.5  # the time until the shares of all other hosts have been received

SHARE_S: Final = 1.0  # the period of the share in the table of services

Names = tuple[Annotated[str, Meta(min_length=1, max_length=LABEL)], ...]


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The processes of this host, and the agents that it could start besides."""

    host: str
    # By label, the agents of the process; a simulator has none.
    processes: dict[str, Names] = msgspec.field(default_factory=dict)
    can: Names = ()
    needs: Names = ()
    router: str = ""  # the robot agent, if it runs on this host
    restarts: int = 5
    within_s: float = 30.0


class Do(StrEnum):
    """The kinds of orders to the machine."""

    START = "start"
    END = "end"  # SIGTERM, and SIGKILL if that is not enough
    KILL = "kill"
    SAY = "say"  # a line for people
    READY = "ready"  # all agents have been seen on the mesh
    GIVE_UP = "give up"


class Order(Struct, frozen=True):
    """One order to the machine."""

    do: Do
    label: str = ""
    text: str = ""


class Event(Struct, frozen=True, tag=True):
    """A process has begun, or ended."""

    label: str
    pid: int = 0
    ending: str = ""  # how it ended; empty: it has begun
    code: int = 0
    words: str = ""  # its last output


class Load(Struct, frozen=True, tag=True):
    """The load of the machine."""

    per_core: float  # runnable processes, on average over the last minute


def lines(what: Struct) -> bytes:
    """Encode an order or an event for the port."""
    return msgspec.json.encode(what) + b"\n"


def orders(data: bytes) -> Iterator[Order]:
    """Decode orders."""
    return (msgspec.json.decode(text, type=Order) for text in data.splitlines())


@dataclass
class _Process:
    """One process of this host."""

    agents: tuple[str, ...]
    state: KeptState = KeptState.STARTING
    pid: int = 0
    lent: bool = False
    held: bool = False  # held back, because the machine is overloaded
    why: str = ""
    began_at: float | None = None  # when it was started, until it is seen
    back_at: float = inf  # when the own host of a lent process had it again
    reported_at: float | None = None  # the last report of a monitor in it
    due_at: float | None = None  # when it is restarted
    since: float | None = None  # when it was first seen at work
    in_the_way: int = 0  # how often in a row another process was in its way
    requested: bool = False  # killed on request, and not restarted yet

    def works(self, now: float) -> None:
        """Note that it is seen at work."""
        self.began_at = None
        self.since = now if self.since is None else self.since
        self.in_the_way = 0


@dataclass
class _Pace:
    """Detects an overloaded machine by how late it wakes this agent."""

    late: deque[float] = field(default_factory=lambda: deque(maxlen=LATE_OF))  # s
    slow: bool = False
    until: float = 0.0  # the machine counts as slow at least until then
    times: int = 0

    def woken(self, late: float, now: float) -> bool:
        """Add a delay, s; return whether the judgement of the machine changes."""
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
    """Keeps a host's processes running within a budget, and executes orders of other agents."""

    name = "wakeup"
    hears: ClassVar[tuple[type[Message], ...]] = (HostShare, MonitorReport)
    provides: ClassVar[tuple[type[Message], ...]] = (HostShare,)
    answers: ClassVar[tuple[type[Message], ...]] = (WakeupRequest,)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.gave_up = False
        self.budget = Budget(self.p.restarts, self.p.within_s)
        # All restarts that may count: when, which process, and whether it was requested.
        self._restarts: deque[tuple[float, str, bool]] = deque()
        self._kept = {label: _Process(names) for label, names in self.p.processes.items()}
        # The agents with a token, by instance: the name, and the card once received.
        self._there: dict[str, tuple[str, Card | None]] = {}
        self._shares: dict[str, HostShare] = {}  # of other hosts, by their wakeup agent
        self._half = b""  # of an incomplete line
        self._load = 0.0
        self._ready = False
        self._share_at = self._heard_at = self._due_at = 0.0
        self._pace = _Pace()
        self._cut_at = inf  # since when the robot's router is unreachable
        self._early: list[Event] = []  # processes with another one in the way, to be reported

    # Other agents --------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Publish at once what runs here."""
        self._heard_at = self.now + HEARD_S
        self._cut_at = inf if self.reachable else self.now
        self._publish_share()

    def on_appeared(self, name: str, instance: str) -> None:
        """Query the card of a new agent, which may be of this host."""
        self._there[instance] = (name, None)
        self._ask(name, instance)

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        self._there.pop(instance, None)
        self._shares.pop(instance, None)

    def on_met(self, card: Card) -> None:
        """Store a card, and update the processes that are starting."""
        if card.instance in self._there:
            self._there[card.instance] = (card.name, card)
            self._update_starting()

    def on_router(self) -> None:
        """Restart timers: agents and shares can be seen only from now on."""
        self._cut_at = inf if self.reachable else self.now
        if self.reachable:
            self._heard_at = self.now + HEARD_S
            for process in self._kept.values():
                if process.began_at is not None:
                    process.began_at = self.now

    def on_host_share(self, share: HostShare) -> None:
        """Process the share of another host."""
        self._shares[share.instance] = share
        self._end_lent()

    def _end_lent(self) -> None:
        """End a lent process once its own host has run it for long enough to keep it.

        Not earlier: if one of the two must be alone in the namespace, the newcomer leaves.
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
                self._drop(label, f"{back[process.agents[0]]} has one of its own again")

    def on_monitor_report(self, report: MonitorReport) -> None:
        """Note the report of a monitor, if it is one of this host."""
        _, card = self._there.get(report.instance, ("", None))
        for process in self._kept.values():
            if card is not None and (card.host, card.pid) == (self.p.host, process.pid):
                process.reported_at = self.now

    def _ask(self, name: str, instance: str) -> None:
        """Query a card until it is received; a hung agent delays no other."""
        if self._there.get(instance) != (name, None):
            return
        if not any(name in p.agents for p in self._kept.values() if p.state is KeptState.STARTING):
            return

        def answered(card: Card | None) -> None:
            if card is not None and card.instance == instance:
                self.on_met(card)
            else:
                self._ask(name, instance)

        self.ask_card(name, instance, answered, CARD_S)

    def _update_starting(self) -> None:
        """Detect which of the starting processes are on the mesh."""
        cards = [card for _, card in self._there.values() if card is not None]
        here = {(card.name, card.pid) for card in cards if card.host == self.p.host}
        for label, process in self._kept.items():
            starting = process.state is KeptState.STARTING and process.pid
            if starting and all((name, process.pid) in here for name in process.agents):
                process.works(self.now)
                self._became(label, KeptState.UP)
        self._report_ready()

    def _report_ready(self) -> None:
        """Report once that all agents are on the mesh, here or on another host."""
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
        self._became(event.label, KeptState.STARTING if process.agents else KeptState.UP)
        if not process.agents:
            process.works(self.now)
        for instance, (name, _) in sorted(self._there.items()):
            self._ask(name, instance)
        self._update_starting()

    def _ended(self, event: Event) -> None:
        label, process = event.label, self._kept.get(event.label)
        if process is None:
            return
        if event.code == MISUSED and self.now < self._heard_at:
            self._early.append(event)
            self._look_again()
            return
        process.pid, process.began_at, process.reported_at = 0, None, None
        if process.held:
            self._became(label, KeptState.WAITING, HELD)
            self._report_ready()
            return
        if process.state is KeptState.ENDED:  # on request
            self._publish_share()
            return
        if (
            process.lent and event.code == MISUSED
        ):  # as after a partition: its own host has one, too
            self._drop(label, "somebody is in its way")
            return
        replaced = any(self._replaced(name) for name in process.agents)
        why = self._plan_restart(label, event.code, replaced=replaced)
        if why and process.lent:  # that is no reason to end what is this host's own
            self._drop(label, f"{label} ended with {event.ending}, {why}")
            return
        if why:
            self.gave_up = True
            self._order(
                Do.GIVE_UP,
                text=f"{label} ended with {event.ending}, and is not started again: {why}."
                f" Its last words:\n{event.words}",
            )
            return
        if process.in_the_way:
            said = (
                f"{label} left: somebody is in its way; the others go on, and it is tried again"
                " now and then"
            )
        else:
            said = f"{label} ended with {event.ending}; it is started again"
        self._order(Do.SAY, text=said)
        self._became(label, KeptState.WAITING, f"it ended with {event.ending}: {event.words}")
        self._report_ready()

    def _plan_restart(self, label: str, code: int, *, replaced: bool) -> str:
        """Schedule the restart of a process that ended with a code; else return why there is none.

        `replaced`: another host has started one in its place, so that another one in its way is no
        fault of people's, however soon it found that out.
        """
        process = self._kept[label]
        worked = 0.0 if process.since is None else self.now - process.since
        if code == MISUSED and not replaced and worked < NEWCOMER_S:
            return "it says that it was configured wrongly or is in the way, and would say so again"
        if code == MISUSED:
            pause = IN_THE_WAY_S[min(process.in_the_way, len(IN_THE_WAY_S) - 1)]
            process.in_the_way += 1
        else:
            process.in_the_way = 0
            if not process.requested and (why := self._spent(requested=False)):
                return why
            often = sum(1 for _, who, _ in self._restarts if who == label)
            pause = PAUSES_S[min(often, len(PAUSES_S) - 1)]
        process.due_at = self.now + pause
        return ""

    def _spent(self, *, requested: bool = True) -> str:
        """Return why one more restart is refused now; "" if it is not.

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
            self._plan_restart(label, MISUSED, replaced=True)  # it would leave again
            return
        self._became(label, KeptState.STARTING)
        self._order(Do.START, label)

    def _replaced(self, name: str) -> bool:
        """Return whether another host has started a lent agent of this name."""
        shares = self._shares.values()
        return any(kept.lent and name in kept.agents for share in shares for kept in share.kept)

    def _order(self, do: Do, label: str = "", text: str = "") -> None:
        self.write(lines(Order(do, label, text)))

    # Requests ------------------------------------------------------------------------------------

    def on_wakeup_request(self, question: Question) -> WakeupReply:
        """Start, restart or end an agent."""
        request = question.request
        assert isinstance(request, WakeupRequest)
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
            return ""  # it is kept running already
        if not found and request.agent not in self.p.can:
            able = ", ".join(self.p.can) or "nobody"
            return f"it cannot start {request.agent}; it could start {able}"
        if refusal := self._spent():
            return refusal
        for label in found or [request.agent]:
            lent = not found
            process = self._kept.setdefault(label, _Process((request.agent,), lent=lent))
            process.state = KeptState.STARTING
            self._order(Do.SAY, text=f"{label} is started: {_asked(request)}")
            self._order(Do.START, label)
        self._publish_share()
        return ""

    def _restart(self, request: WakeupRequest, found: list[str]) -> str:
        if not found:
            return f"{request.agent} is none of its agents"
        if any(self._kept[label].held for label in found):
            return HELD
        for label in found:
            process = self._kept[label]
            meant = request.pid in (0, process.pid)
            if process.state is KeptState.ENDED or not (process.pid and meant):
                continue  # it has been replaced, or is about to be
            if refusal := self._spent():
                return refusal
            process.requested = True
            self._kill(label, _asked(request))
        return ""

    def _kill(self, label: str, why: str) -> None:
        self._order(Do.SAY, text=f"{label} is killed: {why}")
        self._order(Do.KILL, label)

    def _end(self, request: WakeupRequest, found: list[str]) -> str:
        if not found:
            return f"{request.agent} is none of its agents"
        for label in found:
            if self._kept[label].state is KeptState.ENDED:
                continue
            self._order(Do.SAY, text=f"{label} is ended: {_asked(request)}")
            if self._kept[label].pid:
                self._order(Do.END, label)
            self._drop(label, _asked(request))
        return ""

    def _drop(self, label: str, why: str) -> None:
        """Stop keeping a process: a lent one is removed, an own one is reported as ended."""
        process = self._kept[label]
        process.due_at, process.since, process.in_the_way = None, None, 0
        process.requested = process.held = False
        if process.lent:
            del self._kept[label]
            self._order(Do.SAY, text=f"{label} is this host's no more: {why}")
            self._publish_share()
        else:
            self._became(label, KeptState.ENDED, why)

    # Reports -------------------------------------------------------------------------------------

    def on_wakeup(self) -> None:
        """Start processes that are due, kill those that hang, and publish the share."""
        if self._pace.woken(self.now - self._due_at, self.now):
            if self._pace.slow:
                self._hold_back()
            else:
                self._hold_no_more()
        if self.now >= self._heard_at:
            early, self._early = self._early, []
            for event in early:
                self._ended(event)
        for label, process in self._kept.items():
            if process.due_at is not None and process.due_at <= self.now:
                self._restart_due(label, process)
        self._kill_hung()
        if self.now >= self._share_at:
            self._publish_share()
        self._look_again()

    def _kill_hung(self) -> None:
        times = slower(self._load)
        start_s = START_S * times * (PATIENT if self._pace.slow else 1)
        for label, process in self._kept.items():
            up = process.state is KeptState.UP and process.pid
            if self._is_router(process) and up and self.now - self._cut_at >= ROUTER_S * times:
                self._cut_at = self.now
                self._kill(label, f"it accepts no links, for {ROUTER_S * times:.0f} s")
            elif not self.reachable and not self._is_router(process):
                continue  # no agent can be seen
            elif process.began_at is not None and self.now - process.began_at >= start_s:
                process.began_at = None
                self._kill(label, f"it cannot be seen on the mesh after {start_s:.0f} s")
            elif (
                process.reported_at is not None
                and self.now - process.reported_at >= MONITOR_S * times
            ):
                process.reported_at = None
                self._kill(label, f"it watches, and has said nothing for {MONITOR_S * times:.0f} s")

    def _is_router(self, process: _Process) -> bool:
        return self.p.router in process.agents

    def _hold_back(self) -> None:
        """End agents that the robot does not need while this machine is overloaded."""
        needed = set(self.p.needs)
        for label, process in self._kept.items():
            without = needed and process.agents and not needed & set(process.agents)
            if without and process.state is not KeptState.ENDED:
                process.held = True
                if process.pid:
                    self._order(Do.END, label)
                self._became(label, KeptState.WAITING, HELD)
        labels = ", ".join(self._held())
        held = f"; held back: {labels}" if labels else ""
        text = (
            f"{self.p.host} cannot keep up: processes run {median(self._pace.late):.2f} s late, a"
            f" cycle is {LATE_S:g} s (load {self._load:.1f} for each core){held}. End other"
            " programs, use another host for some agents (--hosts), or do --without some"
        )
        self._order(Do.SAY, text=text)

    def _hold_no_more(self) -> None:
        held = self._held()
        again = f"; started again: {', '.join(held)}" if held else ""
        self._order(Do.SAY, text=f"{self.p.host} keeps up again{again}")
        for label in held:
            self._kept[label].held = False
            self._became(label, KeptState.STARTING)
            self._order(Do.START, label)

    def _held(self) -> list[str]:
        return [label for label, process in self._kept.items() if process.held]

    def _look_again(self) -> None:
        """Schedule the next start, share, or check of processes that hang at their start."""
        due = [p.due_at for p in self._kept.values() if p.due_at is not None]
        early = [self._heard_at] if self._early else []
        self._due_at = min([self._share_at, *early, *due])
        self.wake_at(self._due_at)

    def _became(self, label: str, state: KeptState, why: str = "") -> None:
        process = self._kept[label]
        process.state, process.why = state, why
        self._publish_share()

    def _publish_share(self, *, leaving: bool = False) -> None:
        kept = tuple(
            Kept(p.agents, p.state, p.pid, p.lent, line(p.why)) for p in self._kept.values()
        )
        can = tuple(name for name in self.p.can if not any(name in k.agents for k in kept))
        needs = () if leaving else self.p.needs
        self.publish(HostShare(self.instance, self.p.host, kept, can, needs, leaving, self._load))
        self._share_at = self.now + SHARE_S
        self._look_again()

    def stop(self, now: float) -> None:
        """Leave in order, so that the agents of this host are not missed, unless it gave up."""
        super().stop(now)
        if not self.gave_up:
            self._publish_share(leaving=True)


def _asked(request: WakeupRequest) -> str:
    """Why something is done, for people."""
    return request.why or "somebody asked for it"
