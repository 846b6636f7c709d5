"""The monitor agent (thesis 3.8.2): restarts agents that hang and replaces agents that are gone.

It watches liveliness tokens, the cards of agents that publish nothing else, and the rates that the
table of services promises. Tokens alone are not enough. A hung process keeps its token for a while,
and a process whose agent hangs keeps it for ever.

It requests a restart only on evidence that one agent is at fault. An agent is late only with a key
that this instance has published regularly, because some agents publish only sometimes what their
card provides. All limits grow with the load that a host reports. If most processes of a host are
silent at once, the machine is slow or disconnected, and none of them is restarted. Restarts have a
budget per host.

The monitor starts no process. It sends requests to the wakeup agents of the hosts
(`armadico.agents.supervision.wakeup`), which restart agents that end without a request. The monitor
therefore deals only with agents that hang and with hosts that are gone. It does not decide which
agent drives. If the society cannot be completed, it latches the emergency stop.

Several monitors watch each other as they watch other agents. The monitor with the longest tenure
acts. Two that act at once do no harm: a wakeup agent restarts a process once, however many request
it.

Each monitor also judges by all messages whether the society keeps its promises
(`armadico.observe.audit`), and reports those that were broken. It restarts no agent for that.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterator
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
from armadico.core.discovery import AUDITORS, installed
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

PERIOD_S: Final = 0.25
"""Period of the checks."""

REPORT_S: Final = 1.0
"""Period of its report, as in the table of services."""

PROBE_S: Final = 1.0
"""An agent that has been silent for this long is queried for its card."""

MISSED: Final = 5
"""A service is late after this many missed publications plus `late_s`."""

BACKOFF_S: Final = 120.0
"""A restart within this time of the last one doubles the limit of lateness, s. On an overloaded
machine another restart only adds load."""

MAX_DOUBLINGS: Final = 3
"""Maximum number of doublings."""

LATE_WAKE_S: Final = 0.5
"""A monitor woken this late, s, hung itself: what it did not receive meanwhile proves nothing."""

MOVING: Final = 0.01
"""A robot that is faster, m/s or rad/s, is moving."""

MAX_PAUSE_S: Final = 60.0
"""Longest pause in a key's publications that is learnt, s."""

FOLLOW_S: Final = 3.0
"""An agent that falls silent within this time of another may lack the other's output, s."""

MIN_SILENT: Final = 2
"""Minimum number of silent processes for the machine to be at fault."""

WATCHED: Final = tuple(
    service.message
    for service in services()
    if service.kind is Kind.STATE and service.rate_hz and not service.watchers_only
    if "{" not in service.key.replace("{name}", "")
)
"""States published at a fixed rate, by one agent per key."""

AUDITOR: Final[Any] = next((each.load() for each in installed(AUDITORS).values()), None)
"""What judges the messages (`armadico.observe.audit.live.Live`); None without one."""

AUDITED: Final[tuple[type[Message], ...]] = AUDITOR.kinds if AUDITOR else ()


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Timeouts and the budget of restarts."""

    lost_s: Seconds = 2.0  # process up, token gone: it hangs
    hung_s: Seconds = 5.0  # no answer for this long: it hangs
    late_s: Seconds = 3.0  # a service it provides is late by this
    gone_s: Seconds = 3.0  # a needed agent is missing and no host keeps it up: one starts it
    first_s: Seconds = 60.0  # an agent is missing that was never up: its host may be off
    trust_s: Seconds = 10.0  # an agent is missing although its host keeps it up
    again_s: Seconds = 5.0  # until the same request is repeated
    refused_s: Seconds = 30.0  # until a host that refused gets another request
    host_s: Seconds = 5.0  # timeout of a host's share: it gets no requests after that
    whole_s: Seconds = 20.0  # an agent is missing for this long: the robot is stopped
    machine_s: Seconds = 30.0  # how long most processes of a host may be silent at once
    restarts: Annotated[int, Meta(ge=0, le=1000)] = 5  # budget of one host, within
    within_s: Seconds = 60.0


@dataclass
class _Known:
    """An instance whose token is present."""

    name: str
    instance: str
    since: float  # when its token appeared
    answered_at: float  # when its last message or answer was received
    card: Card | None = None
    queried: bool = False  # for its card; no answer yet


@dataclass
class _Habit:
    """Record of the publications on one key."""

    begun: float  # when the present sequence without a gap began
    last: float  # when it was last received
    pause: float = 0.0  # the longest pause that a working instance ended by itself


@dataclass
class _Requests:
    """Requests to hosts and their outcomes."""

    at: dict[tuple[WakeupOrder, str, int], float] = field(default_factory=dict)
    refused: dict[tuple[str, str], tuple[float, str]] = field(default_factory=dict)  # until, why
    restarted: dict[str, tuple[int, float]] = field(default_factory=dict)  # in a row, last at
    spent: dict[str, deque[float]] = field(default_factory=dict)  # by host, restarts

    def admit(
        self, p: Parameters, order: WakeupOrder, name: str, host: str, pid: int, now: float
    ) -> bool:
        """Return whether this was not requested recently, and record it as requested now."""
        self.at = {key: at for key, at in self.at.items() if now - at < p.again_s}
        if (order, name, pid) in self.at:
            return False
        self.at[order, name, pid] = now
        if order is WakeupOrder.RESTART:
            self.restarted[name] = self.restarts_in_a_row(name, now) + 1, now
            self.spent[host].append(now)
        return True

    def has_budget(self, p: Parameters, host: str, now: float) -> bool:
        spent = self.spent.setdefault(host, deque())
        return Budget(p.restarts, p.within_s).left(spent, now) > 0

    def restarts_in_a_row(self, name: str, now: float) -> int:
        """Number of restarts of an agent in a row, each within `BACKOFF_S` of the one before."""
        count, at = self.restarted.get(name, (0, -inf))
        return count if now - at < BACKOFF_S else 0

    def has_refused(self, share: HostShare, name: str, now: float) -> bool:
        return now < self.refused.get((share.host, name), (-inf, ""))[0]


_Process = tuple[str, str, int]
"""An agent in a process of a host: the wakeup agent's instance, the agent's name, the pid."""


class Monitor(Agent):
    """Detects agents that hang or are missing, and requests restarts and starts. Sans-IO."""

    name = "monitor"
    receives: ClassVar[tuple[type[Message], ...]] = tuple(
        dict.fromkeys((*WATCHED, HostShare, MonitorReport, Trajectory, *AUDITED))
    )
    provides: ClassVar[tuple[type[Message], ...]] = (MonitorReport,)
    queries: ClassVar[tuple[type[Message], ...]] = (WakeupRequest,)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._known: dict[str, _Known] = {}
        self._shares: dict[str, tuple[HostShare, float]] = {}  # by wakeup agent; received at
        self._needs: dict[str, tuple[str, ...]] = {}  # by host, also of hosts that are gone
        self._once_up: set[str] = set()  # agents that were once well or kept up
        self._dismissed: set[str] = set()  # agents that were ended in order, or their host was
        # Other monitors by instance: tenure minus own, received at.
        self._others: dict[str, tuple[int, float]] = {}
        self._habits: dict[str, _Habit] = {}  # by key
        self._lost: dict[_Process, float] = {}  # up without a token, since
        self._resumed_at = 0.0  # when the robot's cycles came back
        self._cycle_at = -inf  # of the last one
        self._linked_at = 0.0  # since when this monitor could receive
        self._kills: set[str] = set()  # that hosts report as done by themselves
        # Lateness counts from here, after a change of the society or a hang of this monitor.
        self._late_from = 0.0
        self._missing: dict[str, float] = {}  # needed agents that are not well, since
        self._restart_requests = _Requests()
        self._slow: dict[str, float] = {}  # hosts with most processes silent, since
        self._stopped_for: set[str] = set()
        self._check_at = self._report_at = 0.0
        self._note = ""
        self._reported: tuple[bool, tuple[str, ...], str, tuple[str, ...]] | None = None
        self._auditor: Any = AUDITOR() if AUDITOR else None

    # Inputs --------------------------------------------------------------------------------------

    def on_start(self) -> None:
        self._late_from = self._linked_at = self.now
        self._check_at = self.now + PERIOD_S
        self.wake_at(self._check_at)

    def on_robot_state(self, _state: RobotState) -> None:
        if self.now - self._cycle_at > self.cycles.fresh_cycles * self.cycles.period:
            self._resumed_at = self.now  # the robot was off: its agents had nothing to publish
        self._cycle_at = self.now

    def on_message(self, message: Message) -> None:
        kind = type(message)
        if kind in AUDITED:
            self._audit(message)
        name = message.sensor if isinstance(message, Obstacles) else ""
        if kind in WATCHED:
            self._note_publication(self.key_of(kind, name=name), service_of(kind).rate_hz or 1.0)

    def _audit(self, message: Message | None = None) -> None:
        """Judge a message, or that time has passed; an error there must not end the monitor."""
        if self._auditor is None:
            return
        try:
            self._auditor.update(self.now, message)
        except Exception as error:
            self._auditor = None
            self.log(line(f"the auditor failed, promises are not judged: {error!r}"), ERROR)
            return
        for text in self._auditor.news:
            self.log(text, WARNING)
        self._auditor.news.clear()

    def _note_publication(self, key: str, rate_hz: float) -> None:
        habit = self._habits.setdefault(key, _Habit(self.now, self.now))
        if self.now - habit.last > MISSED / rate_hz:
            cards = ((known.card, known.since) for known in self._known.values())
            there = [since for card, since in cards if card is not None and key in card.provides]
            pause = self.now - max(habit.last, *there, self._resumed_at)
            habit.pause = max(habit.pause, min(pause, MAX_PAUSE_S))
            habit.begun = self.now
        habit.last = self.now

    def on_appeared(self, name: str, instance: str) -> None:
        self._known[instance] = _Known(name, instance, self.now, self.now)
        self._society_changed()

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        for table in (self._known, self._shares, self._others):
            table.pop(instance, None)
        self._society_changed()

    def _society_changed(self) -> None:
        """Count lateness from now on."""
        # Not at every change: an agent that comes and goes must not hide one that hangs.
        if self.now - self._late_from >= 2.0 * self.p.late_s:
            self._late_from = self.now

    def on_card(self, card: Card) -> None:
        known = self._known.get(card.instance)
        if known is not None:
            known.card, known.answered_at = card, self.now
            self._audit(card)

    def on_host_share(self, share: HostShare) -> None:
        self._note_answer(share.instance)
        agents = {name for kept in share.kept for name in kept.agents}
        if share.leaving:
            self._shares.pop(share.instance, None)
            self._needs.pop(share.host, None)
            self._dismissed |= agents
            return
        self._shares[share.instance] = (share, self.now)
        self._needs[share.host] = share.needs
        self._once_up |= agents
        ended = {n for kept in share.kept if kept.state is KeptState.ENDED for n in kept.agents}
        self._dismissed -= agents - ended
        self._dismissed |= ended
        self._note_kills(share)

    def _note_kills(self, share: HostShare) -> None:
        """Pass on why a host killed a process by itself: observers receive only this report."""
        there = {f"{share.host}: {kept.killed}" for kept in share.kept if kept.killed}
        if new := sorted(there - self._kills):
            self._note = line("; ".join(new))
        others = {text for text in self._kills if not text.startswith(f"{share.host}: ")}
        self._kills = others | there

    def on_monitor_report(self, report: MonitorReport) -> None:
        self._note_answer(report.instance)
        self._others[report.instance] = (report.tenure - self._tenure, self.now)

    def _note_answer(self, instance: str) -> None:
        known = self._known.get(instance)
        if known is not None:
            known.answered_at = self.now

    # Actions -------------------------------------------------------------------------------------

    def on_wakeup(self) -> None:
        """Check all agents; request restarts and starts if this monitor is the one that acts."""
        if self.now - self._check_at > LATE_WAKE_S or not self.reachable:
            self._restart_timers()
        self._check_at = self.now + PERIOD_S
        self.wake_at(self._check_at)
        self._audit()
        self._probe()
        lost = self._find_lost_tokens()
        faulty = {known.instance: why for known, why in self._faulty()}
        self._update_missing(faulty)
        if self._acts:
            for instance, why in faulty.items():
                self._restart(self._process_of(self._known[instance]), f"{instance}: {why}")
            for process in lost:
                gone_s = self.now - self._lost[process]
                self._restart(process, f"its token has been gone for {gone_s:.1f} s")
            busy: set[str] = set()  # one start per host and check: the next sees the new loads
            for name, since in self._missing.items():
                self._replace(name, self.now - since, busy)
            self._stop_robot()
        self._report()

    def on_router(self) -> None:
        """Restart all timers: a disconnected monitor receives nothing from healthy agents."""
        self._restart_timers()

    def _restart_timers(self) -> None:
        """Restart all timers, because this monitor could not receive anything."""
        self._late_from = self._linked_at = self.now
        if self._auditor is not None:
            self._auditor.begin()
        for known in self._known.values():
            known.answered_at = self.now
        for habit in self._habits.values():
            habit.last = self.now
        self._slow.clear()
        self._lost.clear()
        self._missing = dict.fromkeys(self._missing, self.now)
        self._shares = {of: (share, self.now) for of, (share, _) in self._shares.items()}
        self._others = {of: (longer, self.now) for of, (longer, _) in self._others.items()}

    @property
    def _acts(self) -> bool:
        """Whether no other monitor has a longer tenure.

        If two tenures are about equal, the smaller instance id wins, as in `membership`, because a
        reported tenure dates from when the report was sent.
        """
        return not any(
            longer > LITTLE or (longer >= -LITTLE and instance < self.instance)
            for instance, (longer, at) in self._others.items()
            if self.now - at <= MISSED * REPORT_S
        )

    @property
    def _tenure(self) -> int:
        return min(self.kernel.tenure, LONGEST_TENURE)

    # Faults --------------------------------------------------------------------------------------

    def _process_of(self, known: _Known) -> _Process | None:
        """The process of an instance, by its card; without a card, the only one left for it."""
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

    def _find_lost_tokens(self) -> list[_Process]:
        """The agents whose host reports their process as up, and whose token is gone."""
        gone = [
            (share.instance, name, kept.pid)
            for share in self._hosts()
            for kept in share.kept
            if kept.state is KeptState.UP
            for name in kept.agents
            if not self._has_token(name, share.host, kept.pid)
        ]
        self._lost = {process: self._lost.get(process, self.now) for process in gone}
        self._find_slow_hosts()
        return [
            (wakeup, name, pid)
            for (wakeup, name, pid), since in self._lost.items()
            if self.now - since >= self.p.lost_s * self._limit_factor(self._shares[wakeup][0].host)
        ]

    def _find_slow_hosts(self) -> None:
        """Detect hosts with most processes silent at once: no single agent is at fault there."""
        half = 0.5 * self.p.hung_s
        quiet = {
            (k.card.host, k.card.pid)
            for k in self._known.values()
            if k.card is not None and self.now - k.answered_at >= half
        }
        quiet |= {(self._shares[wakeup][0].host, pid) for wakeup, _, pid in self._lost}
        slow = dict(self._slow)
        self._slow = {}
        for share in self._hosts():
            up = [k.pid for k in share.kept if k.agents and k.state is KeptState.UP]
            silent = sum((share.host, pid) in quiet for pid in up)
            if silent >= MIN_SILENT and 2 * silent >= len(up):
                self._slow[share.host] = slow.get(share.host, self.now)
                if share.host not in slow:
                    self._note = line(
                        f"{share.host}: {silent} of {len(up)} processes are silent at once:"
                        " the machine is slow or disconnected, none is restarted"
                    )
                    self.log(self._note, WARNING)
        for process in self._lost:  # not all processes of a host come back at once
            host = self._shares[process[0]][0].host
            if host in slow and host not in self._slow:
                self._lost[process] = self.now

    def _limit_factor(self, host: str) -> float:
        """Factor on the limits of a host's agents."""
        if host in self._slow and self.now - self._slow[host] < self.p.machine_s:
            return inf
        loads = [share.load for share, _ in self._shares.values() if share.host == host]
        return slower(max(loads, default=0.0))

    def _has_token(self, name: str, host: str, pid: int) -> bool:
        """Whether a token is present that is, or may be, that of this process's agent."""
        if (host, pid) == (self.identity.host, self.identity.pid):
            return True  # an agent does not see its own token
        return any(
            k.name == name and (k.card is None or (k.card.host, k.card.pid) == (host, pid))
            for k in self._known.values()
        )

    def _hosts(self) -> list[HostShare]:
        """The reports of the hosts that accept requests, sorted by host."""
        fresh = (s for s, at in self._shares.values() if self.now - at <= self.p.host_s)
        return sorted(fresh, key=lambda share: (share.host, share.instance))

    def _probe(self) -> None:
        """Query silent agents for their cards."""
        for key, _, providers in self._watched_keys():
            habit = self._habits.get(key)
            if len(providers) == 1 and habit is not None and self.now - habit.last < PROBE_S:
                providers[0].answered_at = habit.last
        for known in list(self._known.values()):
            silent = self.now - known.answered_at >= PROBE_S or known.card is None
            if silent and not known.queried:
                known.queried = True
                self.query_card(known.name, known.instance, _card_handler(self, known), PROBE_S)

    def _watched_keys(self) -> Iterator[tuple[str, float, list[_Known]]]:
        """Yield each watched key, its rate in Hz, and the live instances that provide it."""
        for service in map(service_of, WATCHED):
            providers: dict[str, list[_Known]] = {}
            for known in self._known.values():
                for key in () if known.card is None else known.card.provides:
                    if matches(service.pattern, key):
                        providers.setdefault(key, []).append(known)
            for key, those in providers.items():
                yield key, service.rate_hz or 1.0, those

    def _faulty(self) -> Iterator[tuple[_Known, str]]:
        """Yield the instances that hang although their token is present, and the evidence."""
        for known in self._known.values():
            silent_s = self.now - known.answered_at
            host = "" if known.card is None else known.card.host
            if silent_s >= self.p.hung_s * self._limit_factor(host):
                yield known, f"it has not answered for {silent_s:.0f} s"
        yield from self._late()

    def _late(self) -> Iterator[tuple[_Known, str]]:
        """Yield the provider of a late key; of several, the first that fell silent.

        The others may only lack the output of the first, and get time to continue with it.
        """
        if not self.cycles.alive(self.now):
            return  # without cycles no agent has anything to publish
        late = [
            (habit.last, known.instance, key, by, self._regular(habit, known, rate_hz))
            for key, rate_hz, providers in self._watched_keys()
            if (habit := self._habits.get(key)) is not None
            for known in providers
            # While the robot was silent no agent had anything to publish.
            if (
                by := self.now
                - max(habit.last, self._late_from, self._resumed_at)
                - MISSED / rate_hz
            )
            > self.p.late_s
        ]
        before = -inf
        for last, instance, key, by, regular in sorted(late):
            if regular and last - before > FOLLOW_S:
                known = self._known[instance]
                limit = max(self._late_limit_s(known), 2.0 * self._habits[key].pause)
                if by > limit and not self._lacking(known, last):
                    heard = ", ".join(self._heard(known)) or "the robot's cycles"
                    yield known, f"{key} has been late for {limit:g} s, while {heard} arrived here"
                return
            before = last

    def _requested(self, known: _Known) -> Iterator[tuple[str, _Habit, float]]:
        """The watched keys that an agent subscribes to, and their rates, Hz."""
        requests = () if known.card is None else known.card.requests
        own = () if known.card is None else known.card.provides
        for key, rate_hz, _ in self._watched_keys():
            habit = self._habits.get(key)
            if habit is None or key in own:
                continue
            if any(matches(pattern, key) for pattern in requests):
                yield key, habit, rate_hz

    def _heard(self, known: _Known) -> list[str]:
        """The inputs of an agent that arrive here."""
        return [
            k for k, habit, hz in self._requested(known) if self.now - habit.last <= MISSED / hz
        ]

    def _lacking(self, known: _Known, last: float) -> bool:
        """Whether an input of an agent fell silent before the agent did, at `last`, and still is.

        Then its provider is the one to ask, not this agent.
        """
        return any(
            0.0 < last - habit.last <= FOLLOW_S and self.now - habit.last > MISSED / hz
            for _, habit, hz in self._requested(known)
        )

    def _regular(self, habit: _Habit, known: _Known, rate_hz: float) -> bool:
        """Whether this instance has published a key for long enough to expect it."""
        lasted_s = habit.last - max(habit.begun, known.since)
        return lasted_s >= max(self.p.late_s, 2.0 / rate_hz)

    def _late_limit_s(self, known: _Known) -> float:
        """Limit of lateness of an agent, s."""
        host = "" if known.card is None else known.card.host
        doubled = 2 ** min(
            self._restart_requests.restarts_in_a_row(known.name, self.now), MAX_DOUBLINGS
        )
        return float(self.p.late_s * doubled * self._limit_factor(host))

    def _update_missing(self, faulty: Container[str]) -> None:
        """Update the needed agents that are absent or not well."""
        well = {known.name for known in self._known.values() if known.instance not in faulty}
        self._once_up |= well
        needed = {name for names in self._needs.values() for name in names} - self._dismissed
        missing = sorted(needed - well)
        self._missing = {name: self._missing.get(name, self.now) for name in missing}
        if not missing:
            self._stopped_for.clear()

    # Requests ------------------------------------------------------------------------------------

    def _restart(self, process: _Process | None, why: str) -> None:
        """Request that a hung process is killed; its host then restarts it."""
        if process is None:
            return  # no host keeps it up
        wakeup, name, pid = process
        share, _ = self._shares[wakeup]
        if self._restart_requests.has_refused(share, name, self.now):
            return
        if self._restart_requests.has_budget(self.p, share.host, self.now):
            evidence = f"{why}; {self._received(name)}"
            self._request(WakeupOrder.RESTART, name, share, evidence, pid)
            return
        p = self.p
        note = f"{share.host}: its {p.restarts} restarts in {p.within_s:g} s are spent"
        if note != self._note:
            self._note = note
            self.log(note, WARNING)

    def _received(self, besides: str) -> str:
        """What this monitor itself received meanwhile: the evidence that it could receive."""
        others = [known for known in self._known.values() if known.name != besides]
        answered = sum(self.now - known.answered_at <= 2.0 * PROBE_S for known in others)
        linked_s = self.now - self._linked_at
        return (
            f"the monitor of {self.identity.host} has been linked for {linked_s:.0f} s, and"
            f" received {answered} of {len(others)} other agents within {2.0 * PROBE_S:g} s"
        )

    def _replace(self, name: str, missed_s: float, busy: set[str]) -> None:
        """Request a start of a missing agent on the least loaded host that can start it."""
        if missed_s < (self.p.gone_s if name in self._once_up else self.p.first_s):
            return
        hosts = self._hosts()
        kept = any(
            name in kept.agents and kept.state is not KeptState.ENDED
            for share in hosts
            for kept in share.kept
            if not self._restart_requests.has_refused(share, name, self.now)
        )
        if kept and missed_s < self.p.trust_s:
            return
        able = [
            share
            for share in hosts
            if name in share.can
            and share.host not in busy
            and not self._restart_requests.has_refused(share, name, self.now)
        ]
        if able:
            idle = min(able, key=lambda share: (_load(share.kept), share.host))
            why = f"no host has run {name} for {missed_s:.0f} s"
            busy.add(idle.host)
            self._request(WakeupOrder.START, name, idle, why)

    def _request(
        self, order: WakeupOrder, name: str, share: HostShare, why: str, pid: int = 0
    ) -> None:
        if not self._restart_requests.admit(self.p, order, name, share.host, pid, self.now):
            return
        if order is WakeupOrder.RESTART:
            self._late_from = self.now
        self._note = line(f"{share.host} is requested to {order} {name}: {why}")
        self.log(self._note, WARNING)

        def on_reply(reply: WakeupReply | None) -> None:
            refusal = f"{share.host} does not answer" if reply is None else reply.refusal
            if refusal:
                self._restart_requests.refused[share.host, name] = (
                    self.now + self.p.refused_s,
                    refusal,
                )
                self._note = line(refusal)
                self.log(self._note, WARNING)

        request = WakeupRequest(order, name, pid, line(why))
        self.query(request, on_reply, instance=share.instance)

    # Emergency stop ------------------------------------------------------------------------------

    def _stop_robot(self) -> None:
        """Latch the stop, once, if agents are missing for too long while the robot is active."""
        missed = [n for n, since in self._missing.items() if self.now - since >= self.p.whole_s]
        if not missed or not self._active or self.stopped is not None:
            return
        if self._stopped_for.issuperset(missed):
            return  # the operator released it, knowing what is missing
        self._stopped_for.update(missed)
        text = f"monitor: no {', '.join(missed)} for {self.p.whole_s:g} s"
        reasons = [why for name in missed if (why := self._why(name))]
        self._note = line("; ".join([text, *reasons]))
        self.log(self._note, ERROR)
        self.latch(line(text)[:LABEL])

    @property
    def _active(self) -> bool:
        """Whether the robot moves or has a path to follow."""
        state, way = self.latest(RobotState), self.memory.newest(Trajectory)
        if state is None or not self.cycles.alive(self.now):
            return False  # no cycles: this monitor may be the disconnected one
        return max(abs(state.v), abs(state.w)) > MOVING or bool(way is not None and way.waypoints)

    def _why(self, name: str) -> str:
        """Why an agent is missing, as its host or the last host that refused it reports."""
        for share in self._hosts():
            for kept in share.kept:
                if name in kept.agents and kept.why:
                    return f"{share.host}: {kept.why}"
        refusals = [
            why for (_, agent), (_, why) in self._restart_requests.refused.items() if agent == name
        ]
        return refusals[-1] if refusals else "" if self._hosts() else "no host accepts requests"

    # Report --------------------------------------------------------------------------------------

    def _report(self) -> None:
        """Publish the report, every second and when it changes."""
        broken = () if self._auditor is None else self._auditor.broken(self.now)
        content = (self._acts, tuple(self._missing), self._note, broken)
        if self.now < self._report_at and content == self._reported:
            return
        if self._reported is not None and not self._missing and self._reported[1]:
            self.log(f"the society is complete again: {', '.join(self._reported[1])}", INFO)
        self._reported, self._report_at = content, self.now + REPORT_S
        self.publish(MonitorReport(self.instance, self._tenure, *content))


def _card_handler(monitor: Monitor, known: _Known) -> Callable[[Card | None], None]:
    def on_card(card: Card | None) -> None:
        known.queried = False
        if card is not None and card.instance == known.instance:
            monitor.on_card(card)

    return on_card


def _load(kept: tuple[Kept, ...]) -> int:
    return sum(len(process.agents) for process in kept)
