"""The monitor agent (thesis 3.8.2): has hung agents restarted, and lost ones started elsewhere.

It observes three things: liveliness tokens, the cards of agents that are otherwise silent, and the
publications that the table of services promises. The last is needed because a hung process keeps
its token for a while, and one whose agent hangs keeps it for good.

It orders a restart only on evidence that one agent is at fault. An agent is late only with a key
that this instance has published regularly, because some agents publish only sometimes what their
card provides. All limits grow with the load that a host reports. If most processes of a host are
silent at once, the machine is slow or disconnected, and none of them is restarted. Restarts have a
budget per host.

It starts no process itself. The wakeup agents of hosts (`armadico.agents.supervision.wakeup`)
execute its orders, and restart ended agents without an order. So the monitor handles only hung
agents and lost hosts. It does not decide which agent drives. If the society cannot be completed, it
latches the stop.

Several monitors observe each other like all agents. The one with the longest tenure acts. Two that
act at the same time do no harm: a wakeup agent restarts a process once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from math import inf
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.supervision.messages import (
    HostShare,
    Kept,
    KeptState,
    WakeupOrder,
    WakeupReply,
    WakeupRequest,
)
from armadico.core import agent
from armadico.core.agent import ERROR, INFO, WARNING, Agent
from armadico.core.membership import LITTLE
from armadico.core.messages import (
    LABEL,
    LONGEST_TENURE,
    Card,
    Message,
    MonitorReport,
    RobotState,
    line,
)
from armadico.core.restart_policy import Budget, slower
from armadico.core.services import Kind, matches, service_of, services
from armadico.mobile.messages import Trajectory
from armadico.mobile.obstacles import Obstacles

Seconds = Annotated[float, Meta(gt=0, le=3600)]

CHECK_S: Final = 0.25  # the period of checks

REPORT_S: Final = 1.0  # the period of its report in the table of services

PROBE_S: Final = 1.0  # an agent that is silent for longer is queried for its card

FEW: Final = 5  # a service is late after this number of missed publications plus `late_s`

# For this time after a restart an agent's limit is doubled, and doubled again at the next restart:
# a restart adds to the load of a slow machine.
PATIENT_S: Final = 120.0

PATIENT: Final = 3  # doublings at most

# A monitor that wakes up later than this has hung itself, and judges no agent by the missing
# messages.
SLEPT_S: Final = 0.5

MOVES: Final = 0.01  # m/s or rad/s: a faster robot is not at rest

PAUSE_MOST_S: Final = 60.0  # the longest pause of a key that counts as its habit

# An agent that falls silent this soon after another may lack that one's messages.
FOLLOWS_S: Final = 3.0

SEVERAL: Final = 2  # with fewer silent processes the machine is not at fault

# The state messages that one agent publishes at a promised rate on a key.
WATCHED: Final = tuple(
    service.message
    for service in services()
    if service.kind is Kind.STATE and service.rate_hz and not service.watchers_only
    if "{" not in service.key.replace("{name}", "")
)


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Timeouts, and the budget of restarts."""

    lost_s: Seconds = 2.0  # a process without a token hangs after this time
    hung_s: Seconds = 5.0  # an agent without any answer hangs after this time
    late_s: Seconds = 3.0  # an agent whose service is late by more hangs
    gone_s: Seconds = 3.0  # until another host is ordered to start a needed agent without a host
    first_s: Seconds = 60.0  # the same if it was never there: its host may still be off
    trust_s: Seconds = 10.0  # the same if its host keeps it running, but it does not return
    again_s: Seconds = 5.0  # until an order is repeated
    refused_s: Seconds = 30.0  # until an order is repeated to a host that has refused it
    host_s: Seconds = 5.0  # a host whose wakeup agent is silent for longer gets no orders
    whole_s: Seconds = 20.0  # the robot is stopped if the society is incomplete for longer
    machine_s: Seconds = 30.0  # how long most processes of a host may be silent at once
    restarts: Annotated[int, Meta(ge=0, le=1000)] = 5  # of one host's agents within `within_s`
    within_s: Seconds = 60.0


@dataclass
class _Known:
    """One instance with a token."""

    name: str
    instance: str
    since: float  # when its token was first seen
    answered_at: float  # when a message or answer was last received
    card: Card | None = None
    queried: bool = False


@dataclass
class _Habit:
    """The regularity of one key's publications."""

    begun: float  # when the present sequence without a gap began
    last: float  # when it was last received
    pause: float = 0.0  # the longest silence that a working instance ended by itself


@dataclass
class _Orders:
    """The orders to hosts, and their results."""

    at: dict[tuple[WakeupOrder, str, int], float] = field(default_factory=dict)
    refused: dict[tuple[str, str], tuple[float, str]] = field(default_factory=dict)  # until, why
    restarted: dict[str, tuple[int, float]] = field(default_factory=dict)  # count in a row, last
    spent: dict[str, deque[float]] = field(default_factory=dict)  # by host, restarts

    def may(
        self, p: Parameters, order: WakeupOrder, name: str, host: str, pid: int, now: float
    ) -> bool:
        """Return whether an order was not given lately, and record it."""
        self.at = {key: at for key, at in self.at.items() if now - at < p.again_s}
        if (order, name, pid) in self.at:
            return False
        self.at[order, name, pid] = now
        if order is WakeupOrder.RESTART:
            self.restarted[name] = self.often(name, now) + 1, now
            self.spent[host].append(now)
        return True

    def affords(self, p: Parameters, host: str, now: float) -> bool:
        """Return whether a host's budget has one more restart."""
        spent = self.spent.setdefault(host, deque())
        return Budget(p.restarts, p.within_s).left(spent, now) > 0

    def often(self, name: str, now: float) -> int:
        """Return the number of an agent's restarts in quick succession."""
        often, at = self.restarted.get(name, (0, -inf))
        return often if now - at < PATIENT_S else 0

    def has_refused(self, share: HostShare, name: str, now: float) -> bool:
        """Return whether a host has refused an agent, and is not yet to be queried again."""
        return now < self.refused.get((share.host, name), (-inf, ""))[0]


_Process = tuple[str, str, int]  # the wakeup agent's instance, the agent's name, the pid


class Monitor(Agent):
    """Observes the society, and orders restarts; sans-IO."""

    name = "monitor"
    hears: ClassVar[tuple[type[Message], ...]] = (*WATCHED, HostShare, MonitorReport, Trajectory)
    provides: ClassVar[tuple[type[Message], ...]] = (MonitorReport,)
    asks: ClassVar[tuple[type[Message], ...]] = (WakeupRequest,)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._known: dict[str, _Known] = {}
        self._shares: dict[str, tuple[HostShare, float]] = {}  # by wakeup agent, and when it came
        self._needs: dict[str, tuple[str, ...]] = {}  # by host, also of those that are gone
        self._had: set[str] = set()  # agents that once were alive or kept running by a host
        self._dismissed: set[str] = set()  # agents of hosts that have left in order
        self._others: dict[str, tuple[int, float]] = {}  # other monitors: more tenure, received
        self._habits: dict[str, _Habit] = {}  # by key
        self._unseen: dict[_Process, float] = {}  # up, but without a token, since when
        self._resumed_at = 0.0  # when the robot's cycles came after a time without any
        self._floor = 0.0  # nothing is late before this: the society has changed, or it has slept
        self._lacking: dict[str, float] = {}  # needed agents that are missing or hung, since when
        self._orders = _Orders()
        self._slow: dict[str, float] = {}  # hosts with most processes silent, since when
        self._stopped_for: set[str] = set()
        self._check_at = self._report_at = 0.0
        self._note = ""
        self._reported: tuple[bool, tuple[str, ...], str] | None = None

    # Inputs --------------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Begin to check."""
        self._floor = self.now
        self._check_at = self.now + CHECK_S
        self.wake_at(self._check_at)

    def receive(self, message: Message, now: float) -> None:
        """Receive a message, and record its time if it is valid."""
        if isinstance(message, RobotState) and not self.cycles.alive(now):
            self._resumed_at = now  # the robot was off: its agents had nothing to publish
        super().receive(message, now)
        kind = type(message)
        name = message.sensor if isinstance(message, Obstacles) else ""
        if kind in WATCHED and self.accepted(message):
            self._publishes(self.key_of(kind, name=name), service_of(kind).rate_hz or 1.0)

    def _publishes(self, key: str, rate_hz: float) -> None:
        habit = self._habits.setdefault(key, _Habit(self.now, self.now))
        if self.now - habit.last > FEW / rate_hz:
            cards = ((known.card, known.since) for known in self._known.values())
            there = [since for card, since in cards if card is not None and key in card.provides]
            pause = self.now - max(habit.last, *there, self._resumed_at)
            habit.pause = max(habit.pause, min(pause, PAUSE_MOST_S))
            habit.begun = self.now
        habit.last = self.now

    def on_appeared(self, name: str, instance: str) -> None:
        """Add an agent that has joined or returned."""
        self._known[instance] = _Known(name, instance, self.now, self.now)
        self._has_changed()

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        """Remove an agent whose token is gone: it has ended, hangs, or is disconnected."""
        for about in (self._known, self._shares, self._others):
            about.pop(instance, None)
        self._has_changed()

    def _has_changed(self) -> None:
        """Restart the timers of late services, but not for one token that flaps all the time."""
        if self.now - self._floor >= 2.0 * self.p.late_s:
            self._floor = self.now

    def on_met(self, card: Card) -> None:
        """Store an agent's card."""
        known = self._known.get(card.instance)
        if known is not None:
            known.card, known.answered_at = card, self.now

    def on_host_share(self, share: HostShare) -> None:
        """Process a host's report: which agents it keeps running, needs, or has dismissed."""
        self._vouch(share.instance)
        agents = {name for kept in share.kept for name in kept.agents}
        if share.leaving:
            self._shares.pop(share.instance, None)
            self._needs.pop(share.host, None)
            self._dismissed |= agents
            return
        self._shares[share.instance] = (share, self.now)
        self._needs[share.host] = share.needs
        self._had |= agents
        ended = {n for kept in share.kept if kept.state is KeptState.ENDED for n in kept.agents}
        self._dismissed -= agents - ended
        self._dismissed |= ended

    def on_monitor_report(self, report: MonitorReport) -> None:
        """Update the tenure of another monitor."""
        self._vouch(report.instance)
        self._others[report.instance] = (report.tenure - self._tenure, self.now)

    def _vouch(self, instance: str) -> None:
        known = self._known.get(instance)
        if known is not None:
            known.answered_at = self.now

    # Checks --------------------------------------------------------------------------------------

    def on_wakeup(self) -> None:
        """Check all agents, and order restarts if this monitor is the one that acts."""
        if self.now - self._check_at > SLEPT_S or not self.reachable:
            self._slept()
        self._check_at = self.now + CHECK_S
        self.wake_at(self._check_at)
        self._probe()
        unseen = self._look_for_tokens()
        unwell = {known.instance: why for known, why in self._unwell()}
        self._miss(unwell)
        if self._acts:
            for instance, why in unwell.items():
                self._restart(self._process_of(self._known[instance]), f"{instance}: {why}")
            for process in unseen:
                self._restart(process, f"its token has been gone for {self.p.lost_s:g} s")
            busy: set[str] = set()  # hosts with an order in this check
            for name, since in self._lacking.items():
                self._replace(name, self.now - since, busy)
            self._stop()
        self._report()

    def on_router(self) -> None:
        """Restart all timers after a disconnection: missing messages were no agent's fault."""
        self._slept()

    def _slept(self) -> None:
        """Restart all timers: missing messages were no agent's fault."""
        self._floor = self.now
        for known in self._known.values():
            known.answered_at = self.now
        for habit in self._habits.values():
            habit.last = self.now
        self._slow.clear()
        self._unseen.clear()
        self._lacking = dict.fromkeys(self._lacking, self.now)
        self._shares = {of: (share, self.now) for of, (share, _) in self._shares.items()}
        self._others = {of: (longer, self.now) for of, (longer, _) in self._others.items()}

    @property
    def _acts(self) -> bool:
        """Whether no other monitor has been at work for longer.

        Of two that have been for about as long it is the one with the smaller id, as in
        `membership`: what a report says was true when it was sent.
        """
        return not any(
            longer > LITTLE or (longer >= -LITTLE and instance < self.instance)
            for instance, (longer, at) in self._others.items()
            if self.now - at <= FEW * REPORT_S
        )

    @property
    def _tenure(self) -> int:
        return min(self.tenure, LONGEST_TENURE)

    # Health --------------------------------------------------------------------------------------

    def _process_of(self, known: _Known) -> _Process | None:
        """Return the process of an instance by its card; without one, the only possible one."""
        cards = {(k.card.host, k.card.pid) for k in self._known.values() if k.card is not None}
        card = known.card
        found = [
            (share.instance, known.name, kept.pid)
            for share in self._hosts()
            for kept in share.kept
            if known.name in kept.agents and kept.pid
            if (
                (share.host, kept.pid) not in cards
                if card is None
                else (share.host, kept.pid) == (card.host, card.pid)
            )
        ]
        return found[0] if len(found) == 1 else None

    def _look_for_tokens(self) -> list[_Process]:
        """Return the agents whose process is up as its host reports, but whose token is gone."""
        gone = [
            (share.instance, name, kept.pid)
            for share in self._hosts()
            for kept in share.kept
            if kept.state is KeptState.UP
            for name in kept.agents
            if not self._sees(name, share.host, kept.pid)
        ]
        self._unseen = {process: self._unseen.get(process, self.now) for process in gone}
        self._judge_hosts()
        return [
            (keeper, name, pid)
            for (keeper, name, pid), since in self._unseen.items()
            if self.now - since >= self.p.lost_s * self._patience(self._shares[keeper][0].host)
        ]

    def _judge_hosts(self) -> None:
        """Detect hosts with most processes silent at once: that is no agent's fault."""
        half = 0.5 * self.p.hung_s
        quiet = {
            (k.card.host, k.card.pid)
            for k in self._known.values()
            if k.card is not None and self.now - k.answered_at >= half
        }
        quiet |= {(self._shares[keeper][0].host, pid) for keeper, _, pid in self._unseen}
        slow = dict(self._slow)
        self._slow = {}
        for share in self._hosts():
            up = [k.pid for k in share.kept if k.agents and k.state is KeptState.UP]
            silent = sum((share.host, pid) in quiet for pid in up)
            if silent >= SEVERAL and 2 * silent >= len(up):
                self._slow[share.host] = slow.get(share.host, self.now)
                if share.host not in slow:
                    self._note = line(
                        f"{share.host}: {silent} of {len(up)} processes are silent at once:"
                        " the machine is slow or disconnected, none is restarted"
                    )
                    self.log(self._note, WARNING)
        for process in self._unseen:  # the last agents of a host return a little after the first
            host = self._shares[process[0]][0].host
            if host in slow and host not in self._slow:
                self._unseen[process] = self.now

    def _patience(self, host: str) -> float:
        """Return the factor on the limits of a host's agents."""
        if host in self._slow and self.now - self._slow[host] < self.p.machine_s:
            return inf
        loads = [share.load for share, _ in self._shares.values() if share.host == host]
        return slower(max(loads, default=0.0))

    def _sees(self, name: str, host: str, pid: int) -> bool:
        """Return whether the token of a process's agent is there, or one that may be its."""
        if (host, pid) == (self.identity.host, self.identity.pid):
            return True  # an agent does not see its own token
        return any(
            k.name == name and (k.card is None or (k.card.host, k.card.pid) == (host, pid))
            for k in self._known.values()
        )

    def _hosts(self) -> list[HostShare]:
        """Return the hosts that can be queried, by name."""
        heard = (s for s, at in self._shares.values() if self.now - at <= self.p.host_s)
        return sorted(heard, key=lambda share: (share.host, share.instance))

    def _probe(self) -> None:
        """Query agents that have been silent for a while for their cards."""
        for key, _, providers in self._promised():
            habit = self._habits.get(key)
            if len(providers) == 1 and habit is not None and self.now - habit.last < PROBE_S:
                providers[0].answered_at = habit.last
        for known in list(self._known.values()):
            silent = self.now - known.answered_at >= PROBE_S or known.card is None
            if silent and not known.queried:
                known.queried = True
                self.ask_card(known.name, known.instance, _on_card(self, known), PROBE_S)

    def _promised(self) -> Iterator[tuple[str, float, list[_Known]]]:
        """Yield the keys with a promised rate, the rate, and the agents that provide them."""
        for service in map(service_of, WATCHED):
            providers: dict[str, list[_Known]] = {}
            for known in self._known.values():
                for key in () if known.card is None else known.card.provides:
                    if matches(service.pattern, key):
                        providers.setdefault(key, []).append(known)
            for key, those in providers.items():
                yield key, service.rate_hz or 1.0, those

    def _unwell(self) -> Iterator[tuple[_Known, str]]:
        """Yield the agents with a token that hang, and the evidence."""
        for known in self._known.values():
            silent_s = self.now - known.answered_at
            host = "" if known.card is None else known.card.host
            if silent_s >= self.p.hung_s * self._patience(host):
                yield known, f"it has answered nothing for {silent_s:.0f} s"
        yield from self._late()

    def _late(self) -> Iterator[tuple[_Known, str]]:
        """Yield the agent whose service is late; of several, the one that fell silent first.

        The others may only lack its messages, and get time to resume.
        """
        if not self.cycles.alive(self.now):
            return  # without the robot's cycles no agent has anything to publish
        late = [
            (habit.last, known.instance, key, by, self._regular(habit, known, rate_hz))
            for key, rate_hz, providers in self._promised()
            if (habit := self._habits.get(key)) is not None
            for known in providers
            if (by := self.now - max(habit.last, self._floor) - FEW / rate_hz) > self.p.late_s
        ]
        before = -inf
        for last, instance, key, by, regular in sorted(late):
            if regular and last - before > FOLLOWS_S:
                known = self._known[instance]
                limit = max(self._late_s(known), 2.0 * self._habits[key].pause)
                if by > limit:
                    yield known, f"{key} has been late for {limit:g} s"
                return
            before = last

    def _regular(self, habit: _Habit, known: _Known, rate_hz: float) -> bool:
        """Return whether this instance has published a key long enough to expect it."""
        lasted_s = habit.last - max(habit.begun, known.since)
        return lasted_s >= max(self.p.late_s, 2.0 / rate_hz)

    def _late_s(self, known: _Known) -> float:
        """Return how late an agent may be, s."""
        host = "" if known.card is None else known.card.host
        doubled = 2 ** min(self._orders.often(known.name, self.now), PATIENT)
        return float(self.p.late_s * doubled * self._patience(host))

    def _miss(self, unwell: Container[str]) -> None:
        """Update the needed agents that are missing or hung."""
        well = {known.name for known in self._known.values() if known.instance not in unwell}
        self._had |= well
        needed = {name for names in self._needs.values() for name in names} - self._dismissed
        missing = sorted(needed - well)
        self._lacking = {name: self._lacking.get(name, self.now) for name in missing}
        if not missing:
            self._stopped_for.clear()

    # Orders --------------------------------------------------------------------------------------

    def _restart(self, process: _Process | None, why: str) -> None:
        """Order that a hung process is killed; its host restarts it."""
        if process is None:
            return  # no host keeps it running
        keeper, name, pid = process
        share, _ = self._shares[keeper]
        if self._orders.has_refused(share, name, self.now):
            return
        if self._orders.affords(self.p, share.host, self.now):
            self._request(WakeupOrder.RESTART, name, share, why, pid)
            return
        p = self.p
        note = f"{share.host}: its {p.restarts} restarts in {p.within_s:g} s are spent"
        if note != self._note:
            self._note = note
            self.log(note, WARNING)

    def _replace(self, name: str, missed_s: float, busy: set[str]) -> None:
        """Order the start of a needed agent on another host, if no host keeps it running."""
        if missed_s < (self.p.gone_s if name in self._had else self.p.first_s):
            return
        hosts = self._hosts()
        kept = any(
            name in kept.agents and kept.state is not KeptState.ENDED
            for share in hosts
            for kept in share.kept
            if not self._orders.has_refused(share, name, self.now)
        )
        if kept and missed_s < self.p.trust_s:
            return
        able = [
            share
            for share in hosts
            if name in share.can
            and share.host not in busy
            and not self._orders.has_refused(share, name, self.now)
        ]
        if able:
            idle = min(able, key=lambda share: (_load(share.kept), share.host))
            why = f"nobody has had {name} for {missed_s:.0f} s"
            busy.add(idle.host)
            self._request(WakeupOrder.START, name, idle, why)

    def _request(
        self, order: WakeupOrder, name: str, share: HostShare, why: str, pid: int = 0
    ) -> None:
        if not self._orders.may(self.p, order, name, share.host, pid, self.now):
            return
        if order is WakeupOrder.RESTART:
            self._floor = self.now
        self._note = line(f"{share.host} is asked to {order} {name}: {why}")
        self.log(self._note, WARNING)

        def answered(reply: WakeupReply | None) -> None:
            refusal = f"{share.host} does not answer" if reply is None else reply.refusal
            if refusal:
                self._orders.refused[share.host, name] = (self.now + self.p.refused_s, refusal)
                self._note = line(refusal)
                self.log(self._note, WARNING)

        request = WakeupRequest(order, name, pid, line(why))
        self.ask(request, answered, instance=share.instance)

    # The stop ------------------------------------------------------------------------------------

    def _stop(self) -> None:
        """Latch the stop once if a needed agent is missing for too long while the robot drives."""
        missed = [n for n, since in self._lacking.items() if self.now - since >= self.p.whole_s]
        if not missed or not self._driving or self.stopped is not None:
            return
        if self._stopped_for.issuperset(missed):
            return  # people have released the stop in spite of it
        self._stopped_for.update(missed)
        text = f"monitor: no {', '.join(missed)} for {self.p.whole_s:g} s"
        reasons = [why for name in missed if (why := self._why(name))]
        self._note = line("; ".join([text, *reasons]))
        self.log(self._note, ERROR)
        self.latch(line(text)[:LABEL])

    @property
    def _driving(self) -> bool:
        """Whether the robot moves, or has a trajectory."""
        state, way = self.latest(RobotState), self.memory.newest(Trajectory)
        if state is None or not self.cycles.alive(self.now):
            return False  # without its cycles, this monitor may be the disconnected one
        return max(abs(state.v), abs(state.w)) > MOVES or bool(way is not None and way.waypoints)

    def _why(self, name: str) -> str:
        """Return why an agent is missing, as hosts report it."""
        for share in self._hosts():
            for kept in share.kept:
                if name in kept.agents and kept.why:
                    return f"{share.host}: {kept.why}"
        refusals = [why for (_, n), (_, why) in self._orders.refused.items() if n == name]
        return refusals[-1] if refusals else "" if self._hosts() else "no host can be asked"

    # Reports -------------------------------------------------------------------------------------

    def _report(self) -> None:
        """Publish the state regularly and on changes."""
        report = (self._acts, tuple(self._lacking), self._note)
        if self.now < self._report_at and report == self._reported:
            return
        if self._reported is not None and not self._lacking and self._reported[1]:
            self.log(f"the society is whole again: {', '.join(self._reported[1])}", INFO)
        self._reported, self._report_at = report, self.now + REPORT_S
        acts, missing, note = report
        self.publish(MonitorReport(self.instance, self._tenure, acts, missing, note))


def _on_card(monitor: Monitor, known: _Known) -> Any:
    """Return the callback of a query for a card."""

    def answered(card: Card | None) -> None:
        known.queried = False
        if card is not None and card.instance == known.instance:
            monitor.on_met(card)

    return answered


def _load(kept: tuple[Kept, ...]) -> int:
    """Return the number of a host's agents."""
    return sum(len(process.agents) for process in kept)
