"""Trials on real processes: one fault at a time, and the intervals of its figures.

A kind of trial is a row: the fault, its targets, and its figures. The society stays up for all
trials of a kind, and the phase within a cycle is drawn for each. Times are those of the observer,
on the machine that runs everything.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Final

from msgspec import structs

from armadico.config.hosts import HostTable
from armadico.config.scenarios import Scenario
from armadico.core.messages import Ballot
from armadico.watch.recorder import part
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.live import COMMAND_DELAY_S, ROAD, LiveInjector, RealSociety, TrialError
from armadico_tools.faults.plan import Case, Fault, Outcome
from armadico_tools.faults.record import Record, bounds_of
from armadico_tools.testbed import Namespaces, Place

TWIN: Final = "goto-2"
"""A second instance of goto: its bids equal the first one's, which is not better, so it waits."""

TWIN_HOST: Final = "lab2"
"""The host of the second goto, if there are hosts."""

CALM_S: Final = 0.6
"""Least time without disturbance between two trials."""

PHASE_S: Final = 0.3
"""The moment of a fault is drawn from this interval: three cycles."""

LEASE_OVER_S: Final = 1.5
"""Time after which Zenoh has closed the links of a process that hangs (lease 1 s)."""

CUT_S: Final = 3.0
"""Duration of cuts."""

BAD_S: Final = 8.0
"""Duration of bad links."""

DRIVES_ON: Final = 0.9
"""Least share of cycles with an obeyed command, where the robot has to drive on."""

AGAIN: Final = 3
"""After this many failed trials of a kind the rest is skipped."""


Targets = Callable[[RealSociety], tuple[str, ...]]
"""Selects the targets of a fault, by label."""

Check = Callable[["Moment"], str]
"""What is wrong after a trial; "" if nothing."""


@dataclass
class Moment:
    """One trial in progress: what was observed, and when its fault began and ended, s."""

    record: Record
    gone: tuple[str, ...]  # instances of the targets
    every: tuple[str, ...]  # all instances
    begun: float = 0.0
    ended: float = 0.0
    ballot: Ballot | None = None  # obeyed before
    speed: float = 0.0  # measured before, m/s

    @property
    def obeyed(self) -> float | None:
        """When the next command of another instance was published that is obeyed."""
        return self.record.kept.obeyed_after(self.begun, self.gone)

    @property
    def share(self) -> float:
        """The share of the cycles with an obeyed command while the fault was active, 0 to 1."""
        return self.record.kept.share_obeyed(self.begun + 1.0, self.ended or inf)

    @property
    def stop(self) -> float | None:
        return self.record.kept.stop_after(self.begun)

    @property
    def moves(self) -> float | None:
        return self.record.kept.moves_after(self.ended)

    @property
    def back(self) -> float | None:
        """When the last token came back; the end of the fault, if none disappeared."""
        return max(
            self.ended, *(self.record.contest.alive.get(one, self.ended) for one in self.every)
        )


@dataclass(frozen=True)
class Figure:
    """A measurement of a trial, and its aims, ms (None: no aim).

    `measure` returns None until it is known: before the fault ends, or `after` it.
    """

    name: str
    text: str
    measure: Callable[[Moment], float | None]
    median: float | None = None
    worst: float | None = None
    after: bool = False


@dataclass(frozen=True)
class Trial:
    """One kind of trial: a fault with its least duration, and the figures.

    The targets are selected in each trial, by `targets`.
    """

    name: str
    text: str
    fault: Fault
    targets: Targets
    figures: tuple[Figure, ...]
    check: Check = lambda _: ""  # at its end
    twin: bool = False  # needs a second goto
    hosts: bool = False  # needs several hosts

    def make(self, society: RealSociety, rng: random.Random) -> dict[str, float]:
        """Run one trial. Returns its figures by name. Raises TrialError."""
        record, injector = society.record, LiveInjector(society)
        society.run(rng.uniform(0.0, PHASE_S))
        targets = self.targets(society)
        gone = tuple(society.agents[label].instance for label in targets)
        moment = Moment(record, gone, tuple(agent.instance for agent in society.agents.values()))
        moment.ballot, state = record.owner.obeyed, record.owner.state
        moment.speed = state.v if state else 0.0
        fault = structs.replace(self.fault, targets=targets)
        injector.begin(fault)
        moment.begun = injector.acted_at
        self._await(society, moment, after=False)
        society.run(moment.begun + fault.lasts - injector.now)
        found = self._measured(moment, after=False)
        injector.end(fault)
        moment.ended = injector.acted_at
        self._await(society, moment, after=True)
        if wrong := self.check(moment):
            raise TrialError(wrong)
        return found | self._measured(moment, after=True)

    def _await(self, society: RealSociety, moment: Moment, *, after: bool) -> None:
        for figure in self.figures:
            if figure.after is after:
                society.until(lambda f=figure: f.measure(moment) is not None, figure.text)  # type: ignore[misc]

    def _measured(self, moment: Moment, *, after: bool) -> dict[str, float]:
        found = {f.name: f.measure(moment) for f in self.figures if f.after is after}
        return {name: round(value, 1) for name, value in found.items() if value is not None}


def settle(society: RealSociety) -> None:
    """Wait until the robot drives and any twin also bids; then for a while."""

    def well() -> bool:
        twins = [a.instance for label, a in society.agents.items() if label in ("goto", TWIN)]
        lacking = len(twins) > 1 and not all(map(society.record.bids_lately, twins))
        return society.record.on_its_way() and not lacking

    society.until(well, "the robot drives, and each goto bids")
    society.run(CALM_S)
    society.until(well, "the robot drives on")


# Targets ------------------------------------------------------------------------------------------


def _holder(society: RealSociety) -> tuple[str, ...]:
    """The goto that holds the wheels at this moment."""

    def held() -> str:
        label = society.label_of(society.record.driver or "")
        return label if label in ("goto", TWIN) else ""

    return (society.until(held, "a goto is obeyed"),)


def _each(society: RealSociety) -> tuple[str, ...]:
    """Another agent each time."""
    society.count += 1
    return ([*society.agents][(society.count - 1) % len(society.agents)],)


def _each_host(society: RealSociety) -> tuple[str, ...]:
    hosts = society.place.hosts
    society.count += 1
    return society.on_host(hosts[(society.count - 1) % len(hosts)])


def _half(society: RealSociety) -> tuple[str, ...]:
    """The agents on the second half of the hosts."""
    hosts = society.place.hosts
    return society.on_host(*hosts[len(hosts) // 2 :])


# Checks -------------------------------------------------------------------------------------------


def _no_old_ballot(moment: Moment) -> str:
    old = moment.ballot
    assert old is not None, "a holder is obeyed"
    acks = [ack.obeyed for at, ack in moment.record.kept.acks if at >= moment.ended]
    again = [b for b in acks if b is not None and b.instance == old.instance and b <= old]
    return f"{old.instance} resumed and was obeyed with an old ballot" if again else ""


def _starts_from_rest(moment: Moment) -> str:
    first = next(order for at, order in moment.record.kept.orders if at >= moment.ended)
    moves = first.v or first.w
    return f"the first speeds of the new robot agent are not zero: {first}" if moves else ""


def _drives_on(moment: Moment) -> str:
    slow = moment.share < DRIVES_ON
    return f"commands were obeyed in {moment.share:.0%} of the cycles only" if slow else ""


def _stands(moment: Moment) -> str:
    texts = [log.text for at, log in moment.record.kept.logs if at >= moment.begun]
    why = any("too old" in text or "no valid command" in text for text in texts)
    if why and moment.share <= 1.0 - DRIVES_ON:
        return ""
    return f"obeyed in {moment.share:.0%} of the cycles; its log: {'; '.join(texts)}"


# Figures ------------------------------------------------------------------------------------------


def _ms(since: float | None, until: float | None) -> float | None:
    return None if since is None or until is None else 1e3 * (until - since)


def _rest(m: Moment) -> float | None:
    """When the wheels rest, of a robot that no agent stops."""
    return m.record.kept.rest_after(m.begun)


def _next(median: float, worst: float) -> Figure:
    text = "from just before the fault to when the next command that is obeyed is published"
    return Figure("next obeyed", text, lambda m: _ms(m.begun, m.obeyed), median, worst)


def _drives(text: str, worst: float | None = None) -> Figure:
    return Figure("drives", text, lambda m: _ms(m.ended, m.moves), worst=worst, after=True)


_STOP: Final = Figure(
    "stop",
    "from just before it to zero speeds on the line",
    lambda m: _ms(m.begun, m.stop),
    None,
    400,
)
_STOPPED: Final = Figure(
    "rest",
    "from those to the first true speed of zero (sent each 100 ms)",
    lambda m: _ms(m.stop, m.record.kept.rest_after(m.stop) if m.stop else None),
)
_SPEED: Final = Figure("speed mm/s", "speed before the fault", lambda m: 1e3 * m.speed)
_ROLLED: Final = Figure(
    "rest", "from just before it to the first true speed of zero", lambda m: _ms(m.begun, _rest(m))
)
_FASTEST: Final = Figure(
    "fastest mm/s",
    "largest true speed until the rest",
    lambda m: 1e3 * m.record.kept.fastest(m.begun, _rest(m) or inf),
)
_FROM_TOKEN: Final = Figure(
    "drives, from its token",
    "the same from its liveliness token",
    lambda m: _ms(max(m.record.contest.alive.values()), m.moves),
    after=True,
)
_LURCH: Final = Figure(
    "fastest before mm/s",
    "largest true speed until it drives, which shows a lurch",
    lambda m: 1e3 * m.record.kept.fastest(m.ended, m.moves or inf),
    after=True,
)
_LATE: Final = Figure(
    "late commands",
    "commands with the old ballot after resuming; none was obeyed",
    lambda m: m.record.kept.late_commands(m.ended, m.ballot) if m.ballot else None,
    after=True,
)
_SILENCE: Final = Figure(
    "longest silence",
    "between two orders on the line, until it is back",
    lambda m: 1e3 * m.record.kept.longest_silence(m.begun, m.record.now),
    after=True,
)
_REJOINED: Final = Figure(
    "rejoined",
    "from restoring the link until the last of its agents' tokens is received elsewhere",
    lambda m: _ms(m.ended, m.back),
    worst=2000,
    after=True,
)
_AGAIN: Final = Figure(
    "obeyed again",
    "from restoring the link to the next command obeyed",
    lambda m: _ms(m.ended, m.record.kept.obeyed_after(m.ended)),
    after=True,
)
_SHARE: Final = Figure(
    "obeyed %", "cycles with a recent command obeyed, during the fault", lambda m: 100.0 * m.share
)
_RESTARTED: Final = "from starting its process to non-zero speeds on the line"
_ENDED: Final = "from the end of the fault to non-zero speeds ordered"

TABLE: Final = (
    Trial(
        "holder-killed",
        "the holder killed (SIGKILL), another contender alive: a second goto",
        Fault("crash", 0, 0, ()),
        _holder,
        (_next(200, 400),),
        twin=True,
    ),
    Trial(
        "holder-hung",
        "the holder hung (SIGSTOP), another contender alive: a second goto",
        Fault("hang", 0, LEASE_OVER_S, ()),
        _holder,
        (_next(400, 600), _LATE),
        check=_no_old_ballot,
        twin=True,
    ),
    Trial(
        "holder-cut-off",
        "the holder's host disconnected for 3 s, another contender alive: a second goto",
        Fault("partition", 0, CUT_S, ()),
        lambda s: s.on_host(s.agents[_holder(s)[0]].host),
        (_next(400, 600), _SILENCE, _REJOINED),
        twin=True,
        hosts=True,
    ),
    Trial(
        "nobody-left",
        "the holder killed, no bidder left",
        Fault("crash", 0, 0, ()),
        lambda _: ("goto",),
        (_STOP, _STOPPED, _SPEED),
    ),
    Trial(
        "robot-killed",
        "the robot agent killed, and restarted when the wheels rest",
        Fault("crash", 0, 0, ()),
        lambda _: ("robot",),
        (_ROLLED, _FASTEST, _drives(_RESTARTED, 2000), _FROM_TOKEN, _LURCH),
        check=_starts_from_rest,
    ),
    Trial(
        "host-lost",
        "the host of all behaviours disconnected for 3 s, and back",
        Fault("partition", 0, CUT_S, ()),
        lambda s: s.on_host(s.agents["goto"].host),
        (_STOP, _REJOINED, _AGAIN),
        hosts=True,
    ),
)
"""The lines of the table in docs/results-reliability.md."""


def _beside(
    name: str, text: str, fault: Fault, targets: Targets, check: Check = lambda _: ""
) -> Trial:
    """A trial for checking promises, with the time until the robot drives again.

    Cuts also measure when the tokens are back; bad links, how often a command was obeyed.
    """
    link = {"partition": (_REJOINED,), "delay": (_SHARE,), "drop": (_SHARE,)}.get(fault.kind, ())
    return Trial(name, text, fault, targets, (*link, _drives(_ENDED)), check, hosts=bool(link))


def _all(society: RealSociety) -> tuple[str, ...]:
    return tuple(society.agents)


_TURN_100: Final = Fault("delay", 0, BAD_S, (), (), 0.05, 0.01)
_WAY_300: Final = Fault("delay", 0, BAD_S, (), (), 0.3)
_DOWN: Final = Fault("partition", 0, CUT_S, (), (), 1.0)
_GONE: Final = Fault("robot-restart", 0, 1.0, ())

TRIALS: Final = {
    trial.name: trial
    for trial in (
        *TABLE,
        _beside("kill-one", "each agent killed in turn", Fault("crash", 0, 1.0, ()), _each),
        _beside("hang-one", "each agent hung in turn", Fault("hang", 0, LEASE_OVER_S, ()), _each),
        _beside("simulator-gone", "simulator and line gone for 1 s", _GONE, lambda _: ("robot",)),
        _beside("link-down", "each host's device down for 3 s in turn", _DOWN, _each_host),
        _beside("partition", "two hosts and two apart", Fault("partition", 0, CUT_S, ()), _half),
        _beside("round-trip-100", "100 ms round trip: drives on", _TURN_100, _all, _drives_on),
        _beside("one-way-300", "300 ms one way: stands, logs why", _WAY_300, _all, _stands),
        _beside("loss-20", "20 % loss", Fault("drop", 0, BAD_S, (), (), 0.2), _all),
    )
}
"""Every kind of trial, by name."""


def run_trials(
    trial: Trial,
    place: Place,
    count: int,
    done: Callable[[Outcome], None],
    *,
    table: HostTable | None = None,
    scenario: Scenario = ROAD,
    seed: int = 0,
    record: Path | None = None,
) -> list[str]:
    """Run trials of one kind. Returns the errors of those that failed.

    `done` receives the outcome of each. With `record` all messages are recorded in a file. The
    society stays up between trials; after a failed one another is started, which is recorded in a
    file beside the first.
    """
    made, failed = 0, list[str]()
    rng = random.Random(f"{seed} {trial.name}")
    hosts: dict[str, str] = {}
    if trial.hosts and table is not None:
        for name, host in table.hosts.items():  # of an agent on two hosts, the first has it
            hosts = dict.fromkeys(host.agents, name) | hosts
    while made < count and len(failed) < AGAIN:
        checker = Checker(replace(bounds_of(scenario), command_delay_s=COMMAND_DELAY_S))
        path = part(record, len(failed)) if record is not None and failed else record
        known = 0

        def ended(figures: dict[str, float], checker: Checker = checker) -> None:
            nonlocal known
            fresh, known = checker.violations[known:], len(checker.violations)
            if figures or fresh:
                case = Case(seed, scenario.name, trial.fault.lasts or CALM_S, ())
                broken = tuple((v.promise.name, v.at, v.text) for v in fresh)
                counts = {trial.fault.kind: 1} if figures else {}
                done(Outcome(case, counts, broken, kind=trial.name, figures=figures))

        try:
            with RealSociety(
                place, scenario=scenario, hosts=hosts, seed=seed, checker=checker, record=path
            ) as society:
                society.start()
                if trial.twin:
                    society.add(TWIN, "goto", TWIN_HOST if trial.hosts else society.place.hosts[0])
                society.count = made
                while made < count:
                    settle(society)
                    figures = trial.make(society, rng)
                    made += 1
                    ended(figures)
        except TrialError as error:
            failed.append(str(error))
        ended({})
    return failed


def place_for(trials: Sequence[Trial], table: HostTable, seed: int) -> Place:
    """This machine, or hosts if a trial needs them. Raises OSError."""
    if any(trial.hosts for trial in trials):
        return Namespaces(table, seed)
    return Place("trials")
