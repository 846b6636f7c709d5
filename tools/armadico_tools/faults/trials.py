"""Trials on real processes: one fault at a time, and from when to when each figure counts.

A kind of trial is a row: the fault, the agents that it befalls, and its figures. The society stays
up for all trials of a kind, and the phase within a cycle is drawn anew for each. Times are those of
the observer, on the machine that everything runs on.
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
from armadico.observe.recorder import part
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.live import HEARD_S, ROAD, LiveInjector, RealSociety, TrialError
from armadico_tools.faults.plan import Case, Fault, Outcome
from armadico_tools.faults.record import Record, bounds_of
from armadico_tools.testbed import Namespaces, Place

TWIN: Final = "goto-2"
"""A second instance of goto: it bids as the first does, and as good is not better, so it waits."""

TWIN_HOST: Final = "lab3"
"""Where the second goto stands by, if there are hosts."""

CALM_S: Final = 0.6
"""Between two trials everything has been as it should for so long."""

PHASE_S: Final = 0.3
"""The moment of a fault is drawn from so long a time: three cycles."""

LEASE_OVER_S: Final = 1.5
"""After so long Zenoh has given up the links of a process that hangs (lease 1 s)."""

CUT_S: Final = 3.0
"""How long links are cut."""

BAD_S: Final = 8.0
"""How long links are bad."""

DRIVES_ON: Final = 0.9
"""The share of cycles in which a command must be obeyed where the robot is to drive on."""

AGAIN: Final = 3
"""So many trials of a kind may fail before the rest of them are given up."""


Whom = Callable[[RealSociety], tuple[str, ...]]
"""The agents that a fault befalls, by their labels."""

Check = Callable[["Moment"], str]
"""What is wrong after a trial; nothing, if it went as it should."""


@dataclass
class Moment:
    """One trial as it goes on: what was observed, and when its fault began and ended, s."""

    record: Record
    gone: tuple[str, ...]  # the instances that the fault befalls
    every: tuple[str, ...]  # all instances
    begun: float = 0.0
    ended: float = 0.0
    ballot: Ballot | None = None  # that was obeyed before
    speed: float = 0.0  # measured before, m/s

    @property
    def obeyed(self) -> float | None:
        """When the next command was published that is obeyed, of another instance."""
        return self.record.obeyed_after(self.begun, self.gone)

    @property
    def share(self) -> float:
        """The share of the cycles with an obeyed command while the fault was on, 0 to 1."""
        return self.record.share_obeyed(self.begun + 1.0, self.ended or inf)

    @property
    def stop(self) -> float | None:
        return self.record.stop_after(self.begun)

    @property
    def moves(self) -> float | None:
        return self.record.moves_after(self.ended)

    @property
    def back(self) -> float | None:
        """When the last token came back; its end, if all are still there."""
        return max(self.ended, *(self.record.alive.get(one, self.ended) for one in self.every))


@dataclass(frozen=True)
class Figure:
    """What a trial measures, and what is aimed at, ms (None: nothing).

    `measure` returns None until it is there: before the fault ends, or `after` it.
    """

    name: str
    text: str
    measure: Callable[[Moment], float | None]
    median: float | None = None
    worst: float | None = None
    after: bool = False


@dataclass(frozen=True)
class Trial:
    """One kind of trial: a fault, for as long as it lasts at least, and what is measured.

    The agents that it befalls are chosen in each trial, by `whom`.
    """

    name: str
    text: str
    fault: Fault
    whom: Whom
    figures: tuple[Figure, ...]
    check: Check = lambda _: ""  # what is wrong, at its end
    twin: bool = False  # needs a second goto that stands by
    hosts: bool = False  # needs hosts with a network between them, not one machine

    def make(self, society: RealSociety, rng: random.Random) -> dict[str, float]:
        """Make one trial; its figures by name. Raises TrialError."""
        record, injector = society.record, LiveInjector(society)
        society.run(rng.uniform(0.0, PHASE_S))
        whom = self.whom(society)
        gone = tuple(society.agents[label].instance for label in whom)
        moment = Moment(record, gone, tuple(agent.instance for agent in society.agents.values()))
        moment.ballot, moment.speed = record.obeyed, record.state.v if record.state else 0.0
        fault = structs.replace(self.fault, whom=whom)
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
    """Wait until the robot drives and, if there is a twin, both bid; then for a while."""

    def well() -> bool:
        twins = [a.instance for label, a in society.agents.items() if label in ("goto", TWIN)]
        lacking = len(twins) > 1 and not all(map(society.record.bids_lately, twins))
        return society.record.on_its_way() and not lacking

    society.until(well, "the robot drives, and all bid that should")
    society.run(CALM_S)
    society.until(well, "the robot drives on")


# What a fault befalls -----------------------------------------------------------------------------


def _holder(society: RealSociety) -> tuple[str, ...]:
    """The goto that holds the wheels at this moment; the other one stands by."""

    def held() -> str:
        label = society.label_of(society.record.driver or "")
        return label if label in ("goto", TWIN) else ""

    return (society.until(held, "one goto or the other is obeyed"),)


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


# What is wrong ------------------------------------------------------------------------------------


def _not_with_the_old_ballot(moment: Moment) -> str:
    old = moment.ballot
    assert old is not None, "a holder is obeyed"
    acks = [ack.obeyed for at, ack in moment.record.acks if at >= moment.ended]
    again = [b for b in acks if b is not None and b.instance == old.instance and b <= old]
    return f"{old.instance} woke up and was obeyed with a ballot of before" if again else ""


def _starts_from_rest(moment: Moment) -> str:
    first = next(order for at, order in moment.record.orders if at >= moment.ended)
    moves = first.v or first.w
    return f"the first speeds of the new robot agent are not zero: {first}" if moves else ""


def _drives_on(moment: Moment) -> str:
    slow = moment.share < DRIVES_ON
    return f"commands were obeyed in {moment.share:.0%} of the cycles only" if slow else ""


def _stands(moment: Moment) -> str:
    texts = [log.text for at, log in moment.record.logs if at >= moment.begun]
    why = any("too old" in text or "no valid command" in text for text in texts)
    if why and moment.share <= 1.0 - DRIVES_ON:
        return ""
    return f"obeyed in {moment.share:.0%} of the cycles; its log: {'; '.join(texts)}"


# The figures --------------------------------------------------------------------------------------


def _ms(since: float | None, until: float | None) -> float | None:
    return None if since is None or until is None else 1e3 * (until - since)


def _rest(m: Moment) -> float | None:
    """When the wheels rest, of a robot that no agent stops."""
    return m.record.rest_after(m.begun)


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
    lambda m: _ms(m.stop, m.record.rest_after(m.stop) if m.stop else None),
)
_SPEED: Final = Figure("speed mm/s", "what it drove before", lambda m: 1e3 * m.speed)
_ROLLED: Final = Figure(
    "rest", "from just before it to the first true speed of zero", lambda m: _ms(m.begun, _rest(m))
)
_FASTEST: Final = Figure(
    "fastest mm/s",
    "its largest true speed meanwhile",
    lambda m: 1e3 * m.record.fastest(m.begun, _rest(m) or inf),
)
_FROM_TOKEN: Final = Figure(
    "drives, from its token",
    "the same from its liveliness token",
    lambda m: _ms(max(m.record.alive.values()), m.moves),
    after=True,
)
_LURCH: Final = Figure(
    "fastest before mm/s",
    "the largest true speed until then: no lurch",
    lambda m: 1e3 * m.record.fastest(m.ended, m.moves or inf),
    after=True,
)
_LATE: Final = Figure(
    "late commands",
    "sent on waking by the ballot of before; none was obeyed",
    lambda m: m.record.late_commands(m.ended, m.ballot) if m.ballot else None,
    after=True,
)
_SILENCE: Final = Figure(
    "longest silence",
    "between two orders on the line, until it is back",
    lambda m: 1e3 * m.record.longest_silence(m.begun),
    after=True,
)
_REJOINED: Final = Figure(
    "rejoined",
    "from mending the link to when the last of its agents' tokens is seen elsewhere",
    lambda m: _ms(m.ended, m.back),
    worst=2000,
    after=True,
)
_AGAIN: Final = Figure(
    "obeyed again",
    "from mending the link to the next command obeyed",
    lambda m: _ms(m.ended, m.record.obeyed_after(m.ended)),
    after=True,
)
_SHARE: Final = Figure(
    "obeyed %", "cycles with a recent command obeyed, while it lasted", lambda m: 100.0 * m.share
)
_RESTARTED: Final = "from starting its process to speeds on the line that are not zero"
_ENDED: Final = "from the end of the fault to speeds ordered that are not zero"

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
        check=_not_with_the_old_ballot,
        twin=True,
    ),
    Trial(
        "holder-cut-off",
        "the holder's host cut off for 3 s, another contender alive: a second goto",
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
        "the robot agent killed, and started again when the wheels rest",
        Fault("crash", 0, 0, ()),
        lambda _: ("robot",),
        (_ROLLED, _FASTEST, _drives(_RESTARTED, 2000), _FROM_TOKEN, _LURCH),
        check=_starts_from_rest,
    ),
    Trial(
        "host-lost",
        "the host of all behaviours cut off for 3 s, and back",
        Fault("partition", 0, CUT_S, ()),
        lambda s: s.on_host(s.agents["goto"].host),
        (_STOP, _REJOINED, _AGAIN),
        hosts=True,
    ),
)
"""The lines of the table in docs/results-reliability.md."""


def _beside(name: str, text: str, fault: Fault, whom: Whom, check: Check = lambda _: "") -> Trial:
    """A trial of which only the promises, and until when the robot drives again, are of interest.

    Cuts also have when the tokens are back; bad links, how often a command was obeyed.
    """
    link = {"partition": (_REJOINED,), "delay": (_SHARE,), "drop": (_SHARE,)}.get(fault.kind, ())
    return Trial(name, text, fault, whom, (*link, _drives(_ENDED)), check, hosts=bool(link))


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
        _beside("link-down", "each host's card down for 3 s in turn", _DOWN, _each_host),
        _beside("partition", "two hosts and two apart", Fault("partition", 0, CUT_S, ()), _half),
        _beside("round-trip-100", "100 ms round trip: drives on", _TURN_100, _all, _drives_on),
        _beside("one-way-300", "300 ms one way: stands, logs why", _WAY_300, _all, _stands),
        _beside("loss-20", "20 % loss", Fault("drop", 0, BAD_S, (), (), 0.2), _all),
    )
}
"""Every kind of trial, by its name."""


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
    """Make so many trials of one kind; returns what went wrong with those that could not be made.

    The outcome of each is handed to `done`. All messages are recorded in a file, if it is named.
    The society stays up from trial to trial; after one that failed another is started, which is
    recorded in a file beside the first.
    """
    made, failed = 0, list[str]()
    rng = random.Random(f"{seed} {trial.name}")
    hosts: dict[str, str] = {}
    if trial.hosts and table is not None:
        hosts = {agent: name for name, host in table.hosts.items() for agent in host.agents}
    while made < count and len(failed) < AGAIN:
        checker = Checker(replace(bounds_of(scenario), heard_s=HEARD_S))
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
    """This machine, unless one of them needs hosts. Raises OSError."""
    if any(trial.hosts for trial in trials):
        return Namespaces(table, seed)
    return Place("trials")
