"""The diagnosis of a society: what should be alive, what is, and what does not work (sans-IO).

`doctor`, `why`, `goto`, `ps`, `top`, the page and the MCP server show these findings. Each check
reads a `View` and a `Demand` and yields findings; a check that could not be made yields one with
the answer unknown. Silence counts as evidence only once it has been observed for long enough.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Final

from armadico.core.judgement import Answer
from armadico.core.mechanisms import deciding, mixed, mixture
from armadico.core.membership import agent_of
from armadico.core.messages import BALLOTS, PROTOCOL, Card, MonitorReport, RobotState
from armadico.core.resources import WHEELS
from armadico.core.services import QUIET_S, Kind, matches, service_at, service_of
from armadico.core.shared import is_shared
from armadico.mobile.messages import MissionState, PlanRequest, Pose
from armadico.observe.findings import (
    NOTHING,
    UP,
    Demand,
    Finding,
    Sort,
    fine,
    open_question,
)
from armadico.observe.standing import SEEN_S, lost, standing, unready
from armadico.observe.view import WINDOW_S, View

SKEW_S: Final = 2.0
"""Larger clock offsets are reported; it includes the delay of a reply."""

ANSWER_S: Final = 2.5
"""An agent that has shown no sign of life for this long hangs: it was queried at least twice."""

ONE_WAY_S: Final = 4.0
"""An agent that publishes and has not answered for this long cannot be reached by queries."""

LOW_SHARE: Final = 0.2
"""Below this share the battery needs a charger."""

SLOW: Final = 0.5
"""An agent is slow if it publishes less than this share of what it promises, and the robot does
not. A busy machine slows all of them alike."""

FAST_HZ: Final = 5.0
"""Rates below this are not compared within an observer's few seconds."""


EXPLORES: Final = "explore/status"
"""The key of an agent that plans its own paths on the map it makes."""

LONGER: Final = "observe the society for longer"


def diagnose(view: View, demand: Demand = NOTHING, now: float = 0.0) -> tuple[Finding, ...]:
    """All findings, at most one for each code and subject; those of the first checks come first.

    Cards and bids are queried once per second. `now` is by the view's clock, s.
    """
    case = _Case(view, demand, now)
    found: dict[tuple[Sort, str], Finding] = {}
    for check in ROOTS:
        for each in check(case):
            found.setdefault((each.sort, each.who), each)
    # Behind a root the other checks would only name consequences.
    for check in (_simulators, _open, _keys, _expiry) if found else CHECKS:
        for each in check(case):
            found.setdefault((each.sort, each.who), each)
    return tuple(found.values())


OF_HOSTS: Final = frozenset({Sort.ABSENT, Sort.HOST, Sort.SILENT})
"""The codes on which a `HostState` depends."""


@dataclass(frozen=True)
class HostState:
    """A host: its live agents, and those that it should run and that are not alive there."""

    name: str
    agents: tuple[str, ...]
    lacks: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()  # of `agents`, those that show no sign of life
    clock_s: float | None = None  # its clock minus this machine's; None: not known

    @property
    def state(self) -> str:
        if self.lacks and not self.agents:
            return "no agent is alive"
        if self.agents and len(self.silent) == len(self.agents):
            return "no agent answers"
        words = [f"missing: {', '.join(self.lacks)}"] if self.lacks else []
        words += [f"not answering: {', '.join(self.silent)}"] if self.silent else []
        return "; ".join(words) or ("up" if self.agents else "no agent is configured")

    @property
    def skew(self) -> str:
        """The clock offset as text; empty if it is small or not known."""
        if self.clock_s is None or abs(self.clock_s) <= SKEW_S:
            return ""
        word = "ahead of" if self.clock_s > 0 else "behind"
        return f"clock {abs(self.clock_s):.0f} s {word} this machine's"


def hosts_of(view: View, demand: Demand, now: float) -> list[HostState]:
    """The state of every known host, those of the demand first."""
    return _Case(view, demand, now).hosts


class _Case:
    """One diagnosis: the view, and what several checks use."""

    def __init__(self, view: View, demand: Demand, now: float) -> None:
        self.view, self.demand, self.now = view, demand, now
        self.cards: list[Card] = [seen.card for seen in view.agents if seen.card is not None]
        self.age_s = view.age(now)
        self._doubled = view.doubled
        self.silent = {each for each in view.alive if self.quiet_s(each) > ANSWER_S}
        self.hosts = [self._host(name) for name in self._host_names()]

    def quiet_s(self, instance: str) -> float:
        """How long an instance has been queried and has shown no sign of life, s."""
        view, card = self.view, self.view.cards.get(instance)
        times = [each.at for each in view.logs if each.instance == instance]
        for key in () if card is None else card.provides:
            rate = view.rates.get(key)
            if rate is not None and rate.last is not None and key not in self._doubled:
                times.append(rate.last)
        published_s = self.now - max(times, default=float("-inf"))
        return min(view.unanswered_s(instance, self.now), published_s)

    def host_of(self, instance: str) -> str:
        """The host of an instance: by its card, else where the demand has its name."""
        card = self.view.cards.get(instance)
        return self.demand.host_of(agent_of(instance)) if card is None else card.host

    def _host_names(self) -> Iterable[str]:
        return dict.fromkeys((*self.demand.hosts, *sorted({card.host for card in self.cards})))

    def _host(self, name: str) -> HostState:
        there = sorted(each for each in self.view.alive if self.host_of(each) == name)
        agents = Counter(map(agent_of, there))
        wanted = Counter(self.demand.hosts.get(name, ()))
        offsets = [self.view.ahead[each] for each in there if each in self.view.ahead]
        silent = tuple(agent_of(each) for each in there if each in self.silent)
        lacks = tuple(agent for agent in wanted if wanted[agent] > agents[agent])
        clock = median(offsets) if offsets else None
        return HostState(name, tuple(sorted(agents.elements())), lacks, silent, clock)

    @property
    def owners(self) -> list[Card]:
        """The cards of the robot agents."""
        return [card for card in self.cards if WHEELS.name in card.owns]

    @property
    def lacks_pose(self) -> bool:
        """Whether no fresh pose was received."""
        at = self.view.pose_at
        return at is None or self.now - at > max(service_of(Pose).stale_after_s, QUIET_S)


def _asks(card: Card, key: str) -> bool:
    """Whether an agent receives a key from other agents."""
    return key not in card.provides and any(matches(each, key) for each in card.requests)


# Roots: if one of these is found, nothing else can be checked -------------------------------------


def _router(case: _Case) -> Iterator[Finding]:
    if case.view.cut_since is not None:
        found = standing(case.view, case.now, case.demand).cause
        if found is not None:
            yield found


def _nobody(case: _Case) -> Iterator[Finding]:
    if case.view.alive:
        return
    if case.age_s < SEEN_S:
        yield _young(Sort.ABSENT, "", case)
    elif case.demand.hosts or case.view.gone:
        todo = "; ".join(map(case.demand.starts, case.demand.hosts)) or UP
        yield Finding(Sort.ABSENT, "", "No agent is alive.", todo)
    else:
        yield open_question(Sort.ABSENT, "", "No agent is alive, so nothing can be checked.", UP)


def _deaf(case: _Case) -> Iterator[Finding]:
    """An observer that receives nothing from anyone may be at fault itself."""
    if len(case.silent) == len(case.view.alive) > 1:
        last = max((rate.last or 0.0 for rate in case.view.rates.values()), default=0.0)
        if case.now - last > ANSWER_S:
            what = f"No agent answers, and nothing has been received for {ANSWER_S:g} s: all hosts"
            what += " hang, or this observer is disconnected."
            yield open_question(Sort.UNREACHABLE, "", what, "check the network of this machine")


# Checks -------------------------------------------------------------------------------------------


def _hosts(case: _Case) -> Iterator[Finding]:
    """Hosts by the network: the agents that are alive and answer there."""
    for host in case.hosts:
        wanted = case.demand.hosts.get(host.name, ())
        switched = f"check that {host.name} is switched on, not paused, and connected"
        if host.lacks and not host.agents:
            away = sorted(case.view.names & set(wanted))
            what = f"No agent on {host.name} is alive; it should run {', '.join(wanted)}"
            what += f" ({', '.join(away)} runs elsewhere)." if away else "."
            finding = Finding(
                Sort.HOST, host.name, what, f"{switched}; {case.demand.starts(host.name)}"
            )
            yield finding if case.age_s >= SEEN_S else _young(Sort.HOST, host.name, case)
        elif len(host.silent) == len(host.agents) > 1:
            what = f"No agent on {host.name} answers ({', '.join(host.agents)}): it is paused,"
            what += " overloaded or disconnected."
            yield Finding(Sort.HOST, host.name, what, switched)


def _young(sort: Sort, who: str, case: _Case) -> Finding:
    what = f"{who or 'the society'} has been observed for only {case.age_s:.1f} s."
    return open_question(sort, who, what, LONGER)


def _agents(case: _Case) -> Iterator[Finding]:
    """Agents that should be alive and are not, and those that do not answer."""
    view, down = case.view, {h.name for h in case.hosts if h.lacks and not h.agents}
    paused = {h.name for h in case.hosts if len(h.silent) == len(h.agents) > 1}
    missing: dict[str, str] = {}  # the host of each
    for host in case.hosts:
        if host.name not in down:
            missing |= dict.fromkeys(host.lacks, host.name)
    for report in view.reports.values():
        if report.acts:
            missing |= {name: "" for name in report.missing if name not in missing}
    for name, on in missing.items():
        if case.demand.host_of(name) in down and not on:
            continue
        at = f" on {on}" if on else ""
        what = f"{name} should be alive{at} and is not.{_last_words(case, name)}"
        finding = Finding(Sort.ABSENT, name, what, f"see `armadico logs {name}`")
        yield finding if case.age_s >= SEEN_S else _young(Sort.ABSENT, name, case)
    for instance in sorted(case.view.alive):
        if case.host_of(instance) not in paused:
            yield from _answers(case, instance)
    if not case.demand.hosts and not view.reports:
        for instance in _gone(case):
            ago = case.now - view.gone[instance]
            name = agent_of(instance)
            what = f"{name} ended or was disconnected {ago:.0f} s ago; whether it is needed is"
            what += " not known."
            todo = case.demand.restarts(name, case.host_of(instance))
            yield open_question(Sort.ABSENT, name, what, todo)
        what = "Which agents should be alive is not known: there is no host table and no monitor"
        what += " here."
        todo = "--hosts TABLE names them; so does `armadico up`"
        yield open_question(Sort.AGENTS, "", what, todo)
    elif not missing:
        agents = f"{len(view.alive)} agents are alive"
        yield fine(Sort.AGENTS, "", f"{agents}; none is missing.")


def _gone(case: _Case) -> list[str]:
    """Instances that are gone without a successor."""
    return [each for each in case.view.gone if agent_of(each) not in case.view.names]


def _last_words(case: _Case, name: str) -> str:
    words = [each.log.text for each in case.view.logs if agent_of(each.instance) == name]
    return f" Its last log line: {words[-1]}" if words else ""


def _answers(case: _Case, instance: str) -> Iterator[Finding]:
    name, asked_s = agent_of(instance), case.view.unanswered_s(instance, case.now)
    card = case.view.cards.get(instance)
    at = f" (host {card.host}, pid {card.pid})" if card is not None else ""
    if instance in case.silent:
        what = f"{name}{at} is alive, but has not answered for {asked_s:.1f} s: it hangs, or is"
        what += " disconnected."
        todo = f"restart it; see `armadico logs {name}`; check the network"
        yield Finding(Sort.SILENT, name, what, todo)
    elif asked_s > ONE_WAY_S:
        what = f"{name}{at} publishes, but has not answered for {asked_s:.1f} s: the network"
        what += " passes messages in one direction only."
        yield Finding(Sort.LINK, name, what, "check the cable, the switch and the firewall there")
    elif card is None and asked_s > 0.0:
        what = f"{name} has not answered yet, after {asked_s:.1f} s."
        yield open_question(Sort.SILENT, name, what, LONGER)


def _versions(case: _Case) -> Iterator[Finding]:
    usual = Counter(card.version for card in case.cards if card.ours).most_common(1)
    for card in case.cards:
        todo = f"install the same armadico on {card.host} as on the other hosts"
        if card.speaks != PROTOCOL:
            what = f"{card.name} on {card.host} uses protocol {card.speaks}, this machine"
            yield Finding(Sort.VERSION, card.name, f"{what} {PROTOCOL}.", todo)
        elif card.ours and card.version != usual[0][0]:
            what = f"{card.name} on {card.host} has version {card.version}, others {usual[0][0]}."
            yield Finding(Sort.VERSION, card.name, what, todo)


def _tables(case: _Case) -> Iterator[Finding]:
    """Host tables by their digests: those of the agents' cards, and this observer's."""
    of: dict[str, set[str]] = {}
    for card in case.cards:
        if card.table:
            of.setdefault(card.table, set()).add(card.host)
    if case.demand.table:
        of.setdefault(case.demand.table, set()).add("this observer")
    if len(of) > 1:
        tables = "; ".join(f"{', '.join(sorted(of[digest]))}: {digest}" for digest in sorted(of))
        todo = "copy one table to all hosts, and start their agents again"
        yield Finding(Sort.TABLE, "", f"Hosts have different host tables ({tables}).", todo)
    elif case.demand.table and not any(card.table for card in case.cards):
        what = "Whether the hosts have this host table is not known: no agent has named one."
        todo = "start the agents by `armadico up --hosts TABLE`" if case.view.complete else LONGER
        yield open_question(Sort.TABLE, "", what, todo)
    elif of:
        yield fine(Sort.TABLE, "", f"All have the same host table ({next(iter(of))}).")


def _twice(case: _Case) -> Iterator[Finding]:
    """Two robot agents, or two publishers of a state."""
    robots = case.owners
    todo = "end one, or give each robot its own --namespace"
    if len(robots) > 1:
        where = " and ".join(f"{card.instance} on {card.host}" for card in robots)
        yield Finding(Sort.TWICE, WHEELS.name, f"There are two robot agents: {where}.", todo)
    for key, publishers in case.view.doubled.items():
        if not {card.instance for card in robots}.issuperset(publishers):
            what = f"{key} is published by {' and '.join(publishers)}: subscribers receive both."
            yield Finding(Sort.TWICE, key, what, todo)


def _mechanisms(case: _Case) -> Iterator[Finding]:
    """Resources for which agents compete by different coordination mechanisms."""
    todo = "start all of them with the same --coordination"
    for resource, by in mixed(case.cards).items():
        what = mixture(resource, by)
        yield Finding(Sort.MIXED, resource, f"{what[0].upper()}{what[1:]}.", todo)
    decides = deciding(case.cards)
    if len(decides) == 1 and BALLOTS not in decides:
        yield fine(Sort.MIXED, WHEELS.name, f"The mechanism {decides[0]} decides who drives.")


def _simulators(case: _Case) -> Iterator[Finding]:
    if names := case.view.strangers(case.now):
        what = f"{', '.join(names)}: a second simulator in this namespace."
        yield Finding(Sort.TWICE, "sim/truth", what, "end it, or give it its own --namespace")


def _open(case: _Case) -> Iterator[Finding]:
    if case.demand.open:
        what = f"Any program that reaches {case.demand.open} can drive the robot."
        yield fine(Sort.OPEN, case.demand.open, what, "`armadico keys init --help` closes it")


def _keys(case: _Case) -> Iterator[Finding]:
    yield from of_keys(case.demand)


def of_keys(demand: Demand) -> Iterator[Finding]:
    """The files of keys on this computer that cannot be read, with or without a society."""
    for what in demand.unread():
        file, _, _ = what.partition(": ")
        yield Finding(Sort.KEYS, file, what, "`armadico keys check` checks this computer's keys")


def _expiry(case: _Case) -> Iterator[Finding]:
    for name, left in case.demand.ending().items():
        when = f"expires in {left / 60:.0f} min" if left > 0 else "has expired"
        what = f"The certificate of {name} {when}: then its link is closed, and it is not renewed."
        todo = "on its computer, `armadico keys renew` renews it and `armadico keys check` says why"
        yield Finding(Sort.EXPIRY, name, what, todo)


def _faults(case: _Case) -> Iterator[Finding]:
    """What agents report of themselves."""
    for card in case.cards:
        if card.fault:
            todo = "repair that, and restart the society"
            yield Finding(Sort.FAULT, card.name, f"{card.name}: {card.fault}", todo)
        elif card.doubts:
            what = f"{card.name}: {card.doubts}"
            yield open_question(Sort.FAULT, card.name, what, "is it the right profile?")
        elif card.learnt:
            yield fine(Sort.FAULT, card.name, f"{card.name}: {card.learnt}")
    worlds = sorted({card.world for card in case.cards if card.world})
    if len(worlds) > 1:
        of = {w: ", ".join(c.name for c in case.cards if c.world == w) for w in worlds}
        what = "; ".join(f"{of[world]}: {world}" for world in worlds)
        todo = "start all agents with the same map"
        yield Finding(Sort.MAP, "", f"Agents have different maps ({what}).", todo)
    for world in worlds:
        has: dict[str, list[str]] = {}
        for card in case.cards:
            if card.world == world and card.map:
                has.setdefault(card.map, []).append(f"{card.name} on {card.host}")
        if len(has) > 1:
            where = "; ".join(f"{', '.join(has[digest])}: {digest}" for digest in sorted(has))
            what = f"Agents have different maps named {world} ({where})."
            todo = "copy one map to all hosts, and start their agents again"
            yield Finding(Sort.MAP, world, what, todo)
    graph = case.view.graph(case.now)
    if graph is not None and graph.uncertain:
        what = f"The map may be wrong: {graph.uncertain}."
        todo = "look at the map, and drive its doubtful places again"
        yield open_question(Sort.MAP, "graph", what, todo)


def _standing(case: _Case) -> Iterator[Finding]:
    """Why the robot stands, or that it moves."""
    found = standing(case.view, case.now, case.demand)
    if found.cause is None:
        yield fine(Sort.MOVES, "", " ".join(found.sentences))
    else:
        yield found.cause


def _ready(case: _Case) -> Iterator[Finding]:
    """What would keep a robot from driving that stands for another cause, such as no goal."""
    yield from unready(case.view, case.now, case.demand)
    asked = {key for card in case.cards for key in card.requests}
    offered = {key for card in case.cards for key in card.provides}
    key = service_of(PlanRequest).key
    # An exploration finds its ways by itself.
    if key in asked - offered and EXPLORES not in offered and case.view.complete:
        what = f"No agent that provides {key} is alive: goals are reached in a straight line only."
        yield fine(Sort.ABSENT, key, what, "start `path-planning`, or use `armadico goto --direct`")


def _late(case: _Case) -> Iterator[Finding]:
    mission = case.view.mission
    if mission is not None and mission.late and mission.state is MissionState.DRIVING:
        yield Finding(
            Sort.LATE, "", mission.delay, "`armadico why --live` shows what each agent bids"
        )


def _by_hand(case: _Case) -> Iterator[Finding]:
    hand = case.view.hand(case.now)
    if hand is not None and hand.driven_by:
        what = f"{hand.driven_by} drives the robot by hand."
        yield Finding(Sort.HAND, hand.driven_by, what, "goals are driven after the hand lets go")


def _robot(case: _Case) -> Iterator[Finding]:
    """Its battery and its line; without a fresh state they are not known."""
    view = case.view
    state, level = view.state, view.level
    if state is None or not view.state_is_fresh(case.now):
        if case.owners:
            what = "Battery, line and motion are not known: no fresh state of the robot."
            yield open_question(Sort.BATTERY, "", what, "check the robot agent and its controller")
        return
    if level is not None and level.share < LOW_SHARE and not state.charging:
        todo = "drive it into a dock, or plug a charger in"
        yield Finding(Sort.BATTERY, "", f"The battery is nearly empty: {view.battery}.", todo)
    else:
        yield fine(Sort.BATTERY, "", f"The battery: {view.battery}.")
    if state.line.summary:
        todo = "check cable, plugs, baud rate and batteries"
        yield fine(Sort.LINE, "", f"From the controller: {state.line.summary}.", todo)
    else:
        yield fine(Sort.LINE, "", "No errors in the data from the controller.")


def _pose(case: _Case) -> Iterator[Finding]:
    pose, at, key = case.view.pose, case.view.pose_at, service_of(Pose).key
    if pose is None or case.lacks_pose:
        if not case.owners:
            return
        since = "was received" if at is None else f"for {case.now - at:.1f} s"
        what = f"The pose is not known: no {key} {since}."
        asking = [card for card in case.cards if _asks(card, key)]
        if at is None:  # some agents use a pose if there is one
            asking = [card for card in asking if not _works(case, card)]
        if asking or not case.view.complete:
            todo = "start an agent that provides it, or see its log"
            yield open_question(Sort.POSE, "", what, todo)
        elif not any(key in card.provides for card in case.cards):
            what = f"No agent needs the pose ({key}), and none provides it."
            yield fine(Sort.POSE, "", what)
    elif not pose.covariance:
        todo = "an agent that localizes on a map makes it known"
        yield fine(Sort.POSE, "", "The pose is from odometry alone; its error grows.", todo)
    elif (where := lost(case.view, case.now)) is not None:
        yield where
    elif case.view.uncorrected_s(case.now) is not None:
        what = "Nothing corrects the pose, so its error grows as the robot drives:"
        what += f" {case.view.pose_text(case.now)}."
        todo = "restart the agent that localizes, or see `armadico logs localization`"
        yield open_question(Sort.POSE, "", what, todo)
    else:
        yield fine(Sort.POSE, "", f"The pose is known: {case.view.pose_text(case.now)}.")


def _rates(case: _Case) -> Iterator[Finding]:
    """Agents that publish too seldom while the robot's cycles are regular."""
    view, key = case.view, service_of(RobotState).key
    if not view.state_is_fresh(case.now):
        return
    if case.age_s < WINDOW_S / 2:
        what = f"Rates are not known after {case.age_s:.1f} s."
        yield open_question(Sort.SLOW, "", what, LONGER)
        return
    robot = _share(case, key)
    if robot is not None and robot < SLOW:
        owner = next((card.name for card in case.owners), WHEELS.name)
        what = f"{owner} publishes {100 * robot:.0f} % of its cycles: it is slow, or its line is."
        yield Finding(Sort.SLOW, owner, what, "check the load of its machine, and its line")
        return
    quiet = _quiet(case)
    for card in case.cards:
        follows = _follows(case, card, quiet)
        for each in card.provides:
            if follows and (_is_mute(case, each) or _stopped(case, each)):
                continue
            if _is_mute(case, each):
                since = max(view.alive.get(card.instance, case.now), view.rates[key].since)
                mute_s = min(case.now - since, case.age_s)
                what = f"{card.name} is alive, and has published no {each} in {mute_s:.1f} s."
                if mute_s < WINDOW_S / 2:  # it has just started, or the robot has
                    yield open_question(Sort.STARTING, card.name, what, LONGER)
                    continue
                todo = f"see `armadico logs {card.name}`; check the network of {card.host}"
                yield Finding(Sort.SILENT, card.name, what, todo)
                continue
            share = _share(case, each)
            if share is not None and share < SLOW and each not in view.doubled and each != key:
                if _stopped(case, each):
                    silent_s = case.now - (view.rates[each].last or 0.0)
                    what = f"{card.name} stopped publishing {each} {silent_s:.1f} s ago."
                    todo = f"see `armadico logs {card.name}`; check the network of {card.host}"
                    yield Finding(Sort.SILENT, card.name, what, todo)
                else:
                    what = f"{card.name} publishes {each} at {100 * share:.0f} % of its rate."
                    todo = f"check the load of {card.host}"
                    yield Finding(Sort.SLOW, card.name, what, todo)


def _quiet(case: _Case) -> list[tuple[str, Card]]:
    """The fast keys on which nothing is published, with the agents that promise it."""
    return [
        (key, card)
        for card in case.cards
        for key in card.provides
        if _is_mute(case, key) or _stopped(case, key)
    ]


def _follows(case: _Case, card: Card, quiet: Sequence[tuple[str, Card]]) -> bool:
    """Whether an input of an agent is silent or absent, so that its own silence is no fault.

    Of agents that wait for each other none follows the others, or no finding would be left.
    """
    if case.lacks_pose and _asks(card, service_of(Pose).key):
        return True
    before = _before(card, quiet)
    return any(card.instance not in _before(each, quiet) for each in before.values())


def _before(card: Card, quiet: Sequence[tuple[str, Card]]) -> dict[str, Card]:
    """The agents, by instance, for whose silent keys an agent waits, directly or through others."""
    found: dict[str, Card] = {}
    left = [card]
    while left:
        asking = left.pop()
        for key, by in quiet:
            if by.instance not in found and _asks(asking, key):
                found[by.instance] = by
                left.append(by)
    return found


def _share(case: _Case, key: str) -> float | None:
    """The rate on a key over the promised one; None if it is not fast, or not known yet."""
    rate, promised = case.view.rates.get(key), _promised_hz(key)
    if rate is None or promised is None or rate.count < FAST_HZ:
        return None
    hz = rate.hz(case.now)
    return None if hz is None else hz / promised


def _is_mute(case: _Case, key: str) -> bool:
    """Whether nothing was published on a key that promises a fast rate."""
    if "*" in key or is_shared(key):  # keys that robots share are not observed
        return False
    return _promised_hz(key) is not None and key not in case.view.rates


def _works(case: _Case, card: Card) -> bool:
    """Whether an agent promises fast keys and publishes all of them."""
    fast = [key for key in card.provides if _promised_hz(key) is not None]
    seen = case.view.rates.keys() & fast
    return bool(fast) and len(seen) == len(fast) and not any(_stopped(case, key) for key in fast)


def _stopped(case: _Case, key: str) -> bool:
    """Whether a fast key was published, and is no longer."""
    share = _share(case, key)
    if share is None or share >= SLOW or key in case.view.doubled:
        return False
    return case.now - (case.view.rates[key].last or 0.0) > QUIET_S


def _promised_hz(key: str) -> float | None:
    """The rate that the publisher of a state promises; None if it is not fast or not regular."""
    service = service_at(key)
    if service is None or service.kind is not Kind.STATE or service.watchers_only:
        return None
    return service.rate_hz if (service.rate_hz or 0.0) >= FAST_HZ else None


def _monitors(case: _Case) -> Iterator[Finding]:
    """The active monitor and its last action; the others stand by."""
    reports = [r for r in case.view.reports.values() if r.instance in case.view.alive]
    acting = [report for report in reports if report.acts]
    heard = {report.instance for report in reports}
    for card in case.cards:
        key = service_of(MonitorReport).key_for(instance=card.instance)
        if key in card.provides and card.instance not in heard:
            what = f"{card.name} has not reported yet which agents are missing."
            yield open_question(Sort.MONITOR, card.instance, what, LONGER)
    if reports and not acting:
        what = f"{len(reports)} monitors stand by, and none is active: no agent is restarted."
        yield open_question(Sort.MONITOR, "", what, "wait a second; then read their logs")
    for report in acting:
        if report.note:
            what = f"Last action of {report.instance}: {report.note.rstrip('.')}."
            yield fine(Sort.ACTION, report.instance, what)
        lacks = f"missing: {', '.join(report.missing)}" if report.missing else "none is missing"
        spare = len(reports) - len(acting)
        others = f"; {spare} stand by" if spare else ""
        yield fine(Sort.MONITOR, report.instance, f"{report.instance}: {lacks}{others}.")


def _promises(case: _Case) -> Iterator[Finding]:
    """What the monitors' auditors found; several find the same."""
    reports = (r for r in case.view.reports.values() if r.instance in case.view.alive)
    for text in dict.fromkeys(text for report in reports for text in report.broken):
        what = f"Within the last minute a promise was broken: {text}."
        yield Finding(Sort.PROMISE, text, what, "record a run, and `armadico audit` the recording")


def _clocks(case: _Case) -> Iterator[Finding]:
    off = [host for host in case.hosts if host.skew]
    known = [host for host in case.hosts if host.clock_s is not None]
    cards = case.view.cards
    ours = {case.host_of(i) for i in case.view.alive if i not in cards or cards[i].ours}
    quiet = [host.name for host in case.hosts if known and host.agents and host not in known]
    unread = [name for name in quiet if name in ours]
    for host in off:
        what = f"{host.name}: {host.skew}. Driving does not depend on it; the order of log lines"
        what += " of several machines does."
        todo = "run `timedatectl` or `chronyc tracking` on each machine"
        yield Finding(Sort.CLOCK, host.name, what, todo)
    if unread:
        what = f"The clock of {', '.join(unread)} is not known: no card from there has it."
        yield open_question(Sort.CLOCK, "", what, "run `timedatectl` there, and here")
    elif known and not off:
        without = f"; {', '.join(quiet)} gives none" if quiet else ""
        yield fine(Sort.CLOCK, "", f"Clocks are within {SKEW_S:g} s of this machine's{without}.")


Check = Callable[[_Case], Iterator[Finding]]

ROOTS: Final[tuple[Check, ...]] = (_router, _nobody, _deaf)

CHECKS: Final[tuple[Check, ...]] = (
    *(_hosts, _agents, _versions, _tables, _twice, _mechanisms, _simulators, _open, _keys),
    *(_expiry, _faults),
    *(_standing, _ready, _late, _by_hand, _robot, _pose, _rates, _promises, _monitors, _clocks),
)


def settled(findings: Iterable[Finding], of: Container[Sort] | None = None) -> bool:
    """Whether longer observation turns no finding of the codes `of` (None: all) to yes or no."""
    return not any(
        f.answer is Answer.UNKNOWN and (f.sort in (Sort.STARTING, Sort.UNKNOWN) or f.todo == LONGER)
        for f in findings
        if of is None or f.sort in of
    )
