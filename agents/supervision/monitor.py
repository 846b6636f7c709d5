"""The monitor agent (thesis 3.8.2): has who hangs restarted, who is gone started elsewhere.

It watches three things: liveliness tokens; the cards of those who say nothing else; and what each
agent promises by the table of services, for a process that hangs keeps its token for a while, and
one whose agent hangs keeps it for good.

It asks for a restart only on evidence that one agent is at fault. An agent is late only with a key
that this instance has published regularly, because some agents publish only sometimes what their
card provides. All limits grow with the load that a host reports. If most processes of a host are
silent at once, the machine is slow or disconnected, and none of them is restarted. Restarts have a
budget per host.

It starts no process: it asks the wakeup agents of hosts (`armadico.agents.supervision.wakeup`),
which restart an agent that has ended without being asked. So what one of them
looks after is left to it, and a monitor has nothing to do but with who hangs, and whose host is
gone. It decides nothing about who drives; when the society cannot be whole it latches the stop.

Several monitors watch each other as they watch everybody. The one that has been at work for longest
acts. Two that both believe so do no harm: a wakeup agent restarts a process once, whoever asks.
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

LOOK_S: Final = 0.25
"""How often it looks."""

REPORT_S: Final = 1.0
"""How often it publishes what it sees, as the table of services has it."""

PROBE_S: Final = 1.0
"""Who has said nothing for so long is asked for its card."""

FEW: Final = 5
"""So many publications are missed before a service is late, and `late_s` besides."""

PATIENT_S: Final = 120.0
"""Who was restarted so lately, s, may be late for twice as long, and twice again: where a machine
has too much to do, a restart is more of it."""

PATIENT: Final = 3
"""Doublings at the most."""

SLEPT_S: Final = 0.5
"""Who is woken so much too late has hung itself, and judges nobody by what it has not heard."""

MOVES: Final = 0.01
"""m/s or rad/s: a robot that is faster is not at rest."""

PAUSE_MOST_S: Final = 60.0
"""A longer pause in what a key provides teaches no more than this."""

FOLLOWS_S: Final = 3.0
"""Who falls silent so soon after another may lack what that one provided."""

SEVERAL: Final = 2
"""With fewer silent processes than this, it is not the machine."""

WATCHED: Final = tuple(
    service.message
    for service in services()
    if service.kind is Kind.STATE and service.rate_hz and not service.watchers_only
    if "{" not in service.key.replace("{name}", "")
)
"""What is promised so many times a second, by one agent on a key."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How long is waited for what."""

    lost_s: Seconds = 2.0  # its token is gone and its process is not: it hangs
    hung_s: Seconds = 5.0  # it has answered nothing for so long
    late_s: Seconds = 3.0  # a service it provides is late by this
    gone_s: Seconds = 3.0  # nobody looks after an agent that is needed: another host is asked
    first_s: Seconds = 60.0  # the same, and nobody ever has: its host may yet be switched on
    trust_s: Seconds = 10.0  # somebody does, and it is not back: another host is asked, too
    again_s: Seconds = 5.0  # until the same is asked for again
    refused_s: Seconds = 30.0  # until a host that has refused is asked again
    host_s: Seconds = 5.0  # a host's wakeup agent has said nothing: nothing is asked of it
    whole_s: Seconds = 20.0  # then the robot is stopped
    machine_s: Seconds = 30.0  # how long most processes of a host may be silent at once
    restarts: Annotated[int, Meta(ge=0, le=1000)] = 5  # of one host's agents at most, within
    within_s: Seconds = 60.0


@dataclass
class _Known:
    """One instance whose token is there."""

    name: str
    instance: str
    since: float  # when its token was first seen,
    answered_at: float  # and when it last said anything
    card: Card | None = None
    asked: bool = False


@dataclass
class _Habit:
    """How regularly one key is published."""

    begun: float  # when the present sequence without a gap began
    last: float  # when it was last received
    pause: float = 0.0  # the longest silence that a working instance ended by itself


@dataclass
class _Asked:
    """What was asked of hosts, when, and what came of it."""

    at: dict[tuple[WakeupOrder, str, int], float] = field(default_factory=dict)
    refused: dict[tuple[str, str], tuple[float, str]] = field(default_factory=dict)  # until, why
    restarted: dict[str, tuple[int, float]] = field(default_factory=dict)  # on end, and last when
    spent: dict[str, deque[float]] = field(default_factory=dict)  # by host, restarts

    def may(
        self, p: Parameters, order: WakeupOrder, name: str, host: str, pid: int, now: float
    ) -> bool:
        """Whether it was not asked lately; it is now."""
        self.at = {key: at for key, at in self.at.items() if now - at < p.again_s}
        if (order, name, pid) in self.at:
            return False
        self.at[order, name, pid] = now
        if order is WakeupOrder.RESTART:
            self.restarted[name] = self.often(name, now) + 1, now
            self.spent[host].append(now)
        return True

    def affords(self, p: Parameters, host: str, now: float) -> bool:
        """Whether a host's budget has one more restart."""
        spent = self.spent.setdefault(host, deque())
        return Budget(p.restarts, p.within_s).left(spent, now) > 0

    def often(self, name: str, now: float) -> int:
        """How often an agent was restarted, each time soon after the time before."""
        often, at = self.restarted.get(name, (0, -inf))
        return often if now - at < PATIENT_S else 0

    def has_refused(self, share: HostShare, name: str, now: float) -> bool:
        """Whether a host has refused an agent, and is not to be asked for it again yet."""
        return now < self.refused.get((share.host, name), (-inf, ""))[0]


_Process = tuple[str, str, int]
"""An agent of a host's process: the wakeup agent's instance, the agent's name, and the pid."""


class Monitor(Agent):
    """Looks after the society; sans-IO, as everybody."""

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
        self._had: set[str] = set()  # who was well once, or looked after
        self._dismissed: set[str] = set()  # kept by a host that has left in order
        self._others: dict[str, tuple[int, float]] = {}  # monitors: longer at work by, heard when
        self._habits: dict[str, _Habit] = {}  # by key
        self._unseen: dict[_Process, float] = {}  # up, and without a token, since when
        self._resumed_at = 0.0  # when the robot's cycles came after a time without any
        self._floor = 0.0  # nothing is late before this: the society has changed, or it has slept
        self._lacking: dict[str, float] = {}  # who is needed and not well, since when
        self._orders = _Asked()
        self._slow: dict[str, float] = {}  # hosts with most processes silent, since when
        self._stopped_for: set[str] = set()
        self._look_at = self._report_at = 0.0
        self._note = ""
        self._said: tuple[bool, tuple[str, ...], str] | None = None

    # What it hears -------------------------------------------------------------------------------

    def on_start(self) -> None:
        """Begin to look."""
        self._floor = self.now
        self._look_at = self.now + LOOK_S
        self.wake_at(self._look_at)

    def receive(self, message: Message, now: float) -> None:
        """Take one, and note when it came if it may be acted upon."""
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
        """Somebody has joined, or has come back."""
        self._known[instance] = _Known(name, instance, self.now, self.now)
        self._has_changed()

    def on_disappeared(self, name: str, instance: str) -> None:  # noqa: ARG002
        """A token has gone: it has ended, or it hangs, or cannot be heard."""
        for about in (self._known, self._shares, self._others):
            about.pop(instance, None)
        self._has_changed()

    def _has_changed(self) -> None:
        """Have nothing be late before now, but not because of one token that flaps all the time."""
        if self.now - self._floor >= 2.0 * self.p.late_s:
            self._floor = self.now

    def on_met(self, card: Card) -> None:
        """Somebody has given its card."""
        known = self._known.get(card.instance)
        if known is not None:
            known.card, known.answered_at = card, self.now

    def on_host_share(self, share: HostShare) -> None:
        """What a host keeps up: who is looked after there need not be missed, or is no more."""
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
        """Another monitor is at work."""
        self._vouch(report.instance)
        self._others[report.instance] = (report.tenure - self._tenure, self.now)

    def _vouch(self, instance: str) -> None:
        known = self._known.get(instance)
        if known is not None:
            known.answered_at = self.now

    # What it does --------------------------------------------------------------------------------

    def on_wakeup(self) -> None:
        """Look at everybody, and do something about it if it is the one that acts."""
        if self.now - self._look_at > SLEPT_S or not self.reachable:
            self._slept()
        self._look_at = self.now + LOOK_S
        self.wake_at(self._look_at)
        self._probe()
        unseen = self._look_for_tokens()
        unwell = {known.instance: why for known, why in self._unwell()}
        self._miss(unwell)
        if self._acts:
            for instance, why in unwell.items():
                self._restart(self._process_of(self._known[instance]), f"{instance}: {why}")
            for process in unseen:
                self._restart(process, f"its token has been gone for {self.p.lost_s:g} s")
            busy: set[str] = set()  # asked at this look; the next one sees what they have by then
            for name, since in self._lacking.items():
                self._replace(name, self.now - since, busy)
            self._stop()
        self._report()

    def on_router(self) -> None:
        """Cut off, it hears nobody: that is no fault of theirs."""
        self._slept()

    def _slept(self) -> None:
        """Whatever was not heard meanwhile is no fault of the others."""
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

    # Who is well ---------------------------------------------------------------------------------

    def _process_of(self, known: _Known) -> _Process | None:
        """Which process an instance is, by its card; without one, the only one that it can be."""
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
        """The agents whose process is up by the word of its host, and whose token is gone."""
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
        """Note the hosts most of whose processes are silent at once: that is no agent's fault."""
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
        for process in self._unseen:  # the last of a host come back a little after the first
            host = self._shares[process[0]][0].host
            if host in slow and host not in self._slow:
                self._unseen[process] = self.now

    def _patience(self, host: str) -> float:
        """By how much the limits of a host's agents are multiplied."""
        if host in self._slow and self.now - self._slow[host] < self.p.machine_s:
            return inf
        loads = [share.load for share, _ in self._shares.values() if share.host == host]
        return slower(max(loads, default=0.0))

    def _sees(self, name: str, host: str, pid: int) -> bool:
        """Whether the token of a process's agent is there, or one that may be it."""
        if (host, pid) == (self.identity.host, self.identity.pid):
            return True  # nobody sees one's own
        return any(
            k.name == name and (k.card is None or (k.card.host, k.card.pid) == (host, pid))
            for k in self._known.values()
        )

    def _hosts(self) -> list[HostShare]:
        """The hosts that can be asked, by name."""
        heard = (s for s, at in self._shares.values() if self.now - at <= self.p.host_s)
        return sorted(heard, key=lambda share: (share.host, share.instance))

    def _probe(self) -> None:
        """Ask those for their cards who have said nothing for a while."""
        for key, _, providers in self._promised():
            habit = self._habits.get(key)
            if len(providers) == 1 and habit is not None and self.now - habit.last < PROBE_S:
                providers[0].answered_at = habit.last
        for known in list(self._known.values()):
            silent = self.now - known.answered_at >= PROBE_S or known.card is None
            if silent and not known.asked:
                known.asked = True
                self.ask_card(known.name, known.instance, _answered(self, known), PROBE_S)

    def _promised(self) -> Iterator[tuple[str, float, list[_Known]]]:
        """The keys on which something is promised, how often, and who of those alive does so."""
        for service in map(service_of, WATCHED):
            providers: dict[str, list[_Known]] = {}
            for known in self._known.values():
                for key in () if known.card is None else known.card.provides:
                    if matches(service.pattern, key):
                        providers.setdefault(key, []).append(known)
            for key, those in providers.items():
                yield key, service.rate_hz or 1.0, those

    def _unwell(self) -> Iterator[tuple[_Known, str]]:
        """Whose token is there, and who hangs, and how that shows."""
        for known in self._known.values():
            silent_s = self.now - known.answered_at
            host = "" if known.card is None else known.card.host
            if silent_s >= self.p.hung_s * self._patience(host):
                yield known, f"it has answered nothing for {silent_s:.0f} s"
        yield from self._late()

    def _late(self) -> Iterator[tuple[_Known, str]]:
        """Who provides what is late; of several that are, who fell silent first.

        The others may only lack what that one provides, and get the time to go on with it.
        """
        if not self.cycles.alive(self.now):
            return  # then nobody has anything to say
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
        """Whether this instance has published a key long enough to expect it from it."""
        lasted_s = habit.last - max(habit.begun, known.since)
        return lasted_s >= max(self.p.late_s, 2.0 / rate_hz)

    def _late_s(self, known: _Known) -> float:
        """How late an agent may be."""
        host = "" if known.card is None else known.card.host
        doubled = 2 ** min(self._orders.often(known.name, self.now), PATIENT)
        return float(self.p.late_s * doubled * self._patience(host))

    def _miss(self, unwell: Container[str]) -> None:
        """Note who is needed, and not there or not well."""
        well = {known.name for known in self._known.values() if known.instance not in unwell}
        self._had |= well
        needed = {name for names in self._needs.values() for name in names} - self._dismissed
        missing = sorted(needed - well)
        self._lacking = {name: self._lacking.get(name, self.now) for name in missing}
        if not missing:
            self._stopped_for.clear()

    # What it asks for ----------------------------------------------------------------------------

    def _restart(self, process: _Process | None, why: str) -> None:
        """Have who hangs killed; it is started again as whoever ends."""
        if process is None:
            return  # nobody looks after it
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
        """Have somebody who is needed started where it can be, if nobody looks after it."""
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

    # When it cannot be whole ---------------------------------------------------------------------

    def _stop(self) -> None:
        """Latch the stop, once, if somebody is missed for too long while the robot is at it."""
        missed = [n for n, since in self._lacking.items() if self.now - since >= self.p.whole_s]
        if not missed or not self._at_it or self.stopped is not None:
            return
        if self._stopped_for.issuperset(missed):
            return  # people have released it, and know
        self._stopped_for.update(missed)
        text = f"monitor: no {', '.join(missed)} for {self.p.whole_s:g} s"
        reasons = [why for name in missed if (why := self._why(name))]
        self._note = line("; ".join([text, *reasons]))
        self.log(self._note, ERROR)
        self.latch(line(text)[:LABEL])

    @property
    def _at_it(self) -> bool:
        """Whether the robot moves, or is to."""
        state, way = self.latest(RobotState), self.memory.newest(Trajectory)
        if state is None or not self.cycles.alive(self.now):
            return False  # nothing is heard of it: it may be this one that is cut off
        return max(abs(state.v), abs(state.w)) > MOVES or bool(way is not None and way.waypoints)

    def _why(self, name: str) -> str:
        """Why it is not there, by the word of hosts."""
        for share in self._hosts():
            for kept in share.kept:
                if name in kept.agents and kept.why:
                    return f"{share.host}: {kept.why}"
        told = [why for (_, who), (_, why) in self._orders.refused.items() if who == name]
        return told[-1] if told else "" if self._hosts() else "no host can be asked"

    # Telling -------------------------------------------------------------------------------------

    def _report(self) -> None:
        """Publish what it sees, now and then and when that changes."""
        said = (self._acts, tuple(self._lacking), self._note)
        if self.now < self._report_at and said == self._said:
            return
        if self._said is not None and not self._lacking and self._said[1]:
            self.log(f"the society is whole again: {', '.join(self._said[1])}", INFO)
        self._said, self._report_at = said, self.now + REPORT_S
        acts, missing, note = said
        self.publish(MonitorReport(self.instance, self._tenure, acts, missing, note))


def _answered(monitor: Monitor, known: _Known) -> Any:
    """What takes the answer to a query for a card."""

    def answered(card: Card | None) -> None:
        known.asked = False
        if card is not None and card.instance == known.instance:
            monitor.on_met(card)

    return answered


def _load(kept: tuple[Kept, ...]) -> int:
    """How many agents a host has."""
    return sum(len(process.agents) for process in kept)
