"""Why the robot stands: the chain of reasons down to an operator, agent, host or device (sans-IO).

`armadico why`, `doctor`, `top`, the page and programs share it. It reads a `View`, which must
receive publications, liveliness tokens, cards and bids; cards and bids are queried once per second.

The search starts with conditions that do not depend on bids: the stop, the motors, the goal. Then
it examines the agent that drives. If there is none, it examines each contender; a behaviour
reports the input that it lacks. The search continues with the agent that provides the input and
with the inputs of that agent. It ends at an agent that is not alive, or that has all its inputs and
publishes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from msgspec import Struct

from armadico.core.agent import WARNING
from armadico.core.cycles import PERIOD
from armadico.core.hands import release
from armadico.core.membership import agent_of
from armadico.core.messages import (
    BALLOTS,
    BidRecord,
    Cycle,
    Description,
    LogEvent,
    RobotState,
    protocols,
)
from armadico.core.resources import WHEELS, differently
from armadico.core.services import QUIET_S, matches, service_at, service_of
from armadico.mobile.behaviour import FOUND_S, LOST_M
from armadico.mobile.messages import MissionState, MissionStatus, Pose, Trajectory
from armadico.mobile.obstacles import Obstacles
from armadico.observe.contention import awards
from armadico.observe.findings import NOTHING, Demand, Finding, Sort, cause
from armadico.observe.view import FRESH_CYCLES, RESTS, View, speed

# A bid older than this many cycles is outdated: bids are queried once per second.
MISSED: Final = 15

# Longest time from rest to motion, cycles and ramps included.
STARTS_S: Final = 1.0

# If an observer receives no message for this long, its own connection is at fault: some agents
# publish at least once per second.
DEAF_S: Final = 2.5

# An observer has received all liveliness tokens after this time.
SEEN_S: Final = 1.0

# An agent younger than this has not failed yet: a controller takes a second to answer. Nor is it
# known to bid in vain, or to find no path, before it has done so for this long.
YOUNG_S: Final = 2.0

LASER: Final = "laser"  # of `Description.sensors`

MEASURE: Final = (
    "if it stays lost, the scanner may be mounted otherwise than the profile says:"
    " `armadico mounting` measures it from a recorded drive"
)

# Age limit of a log line that explains the present state.
RECENT_S: Final = 5.0


class Standing(Struct, frozen=True):
    """Whether the robot stands, and why: from the observation down to the cause."""

    stands: bool
    sentences: tuple[str, ...]
    cause: Finding | None = None  # none: it moves

    @property
    def lines(self) -> list[str]:
        """The sentences, and the cure."""
        todo = "" if self.cause is None else self.cause.todo
        return [*self.sentences, *([f"-> {todo}"] if todo else [])]


def standing(view: View, now: float, demand: Demand = NOTHING) -> Standing:
    """Why the robot of a view stands; `now` is by the view's clock, s."""
    chain = _Chain(view, now, demand)
    found = chain.begin()
    if found is not None:
        chain.close(found)
    return Standing(found is not None, chain.sentences, found)


def unready(view: View, now: float, demand: Demand = NOTHING) -> list[Finding]:
    """What would keep every contender from driving, whatever keeps the robot now.

    A robot without a goal stands for want of one, and nothing else is wrong with it only if agents
    that could drive are alive and receive what they ask for.
    """
    return list(_Chain(view, now, demand).unready())


class _Chain:
    """One chain of reasons under construction."""

    def __init__(self, view: View, now: float, demand: Demand) -> None:
        self.view = view
        self._installed, self._table, self._demand = demand.installed, demand.hosts, demand
        self.now = now
        self._sentences: dict[str, list[str]] = {}
        self._ends: dict[Finding, str] = {}  # with the sentence of each
        self._followed: set[str] = set()  # keys
        self._complaints: set[str] = set()  # keys that contenders lack

    def begin(self) -> Finding | None:
        """Start from the robot's state; None if it moves."""
        view, state = self.view, self.view.state
        key = service_of(RobotState).key
        if view.cut_since is not None:
            return self._unreachable(self.now - view.cut_since)
        if (found := self._no_messages()) is not None:
            return found
        if state is None or self.silent(key):
            since = "" if state is None else f" for {self.silence(key):.1f} s"
            self.add(f"No {key} has been received from the robot{since}.")
            return self.lacking(key, "")
        if max(abs(state.v), abs(state.w)) > RESTS:
            driver = view.driver(WHEELS.name, self.now)
            by = f"{agent_of(driver)} drives" if driver else "no agent drives, it coasts to rest"
            self.add(f"The robot moves at {state.v:.2f} m/s, {state.w:.2f} rad/s: {by}.")
            if (shown := speed(state)) != f"{state.v:.2f} m/s":
                self.add(f"Its speed: {shown}.")
            return None
        self.add("The robot stands.")
        return self._stopped(state) or self._mission() or self._wheels()

    @property
    def sentences(self) -> tuple[str, ...]:
        """The chain; a sentence that holds for several agents appears once, with their names."""
        return tuple(
            f"{', '.join(names)}: {text}" if names else text
            for text, names in self._sentences.items()
        )

    def add(self, text: str, agent: str = "") -> None:
        """Append a sentence about the robot, or about a contender."""
        names = self._sentences.setdefault(text, [])
        if agent and agent not in names:
            names.append(agent)

    def close(self, found: Finding) -> None:
        """Move the cause to the end of the chain."""
        text = self._ends.get(found)
        if text is not None:
            self._sentences[text] = self._sentences.pop(text)

    def _unreachable(self, since: float) -> Finding:
        # The robot agent's process is the router: without it nothing arrives.
        what = f"The robot agent has been unreachable for {since:.1f} s: "
        what += "it has ended, it hangs, or the network to it is interrupted."
        todo = "run `armadico doctor` on the robot's computer; `armadico up` starts the agent"
        return self.end(Sort.UNREACHABLE, self._owner(), what, todo)

    def _no_messages(self) -> Finding | None:
        """The cause if the society has ended or this observer is disconnected."""
        view = self.view
        if view.gone and not view.alive:
            what = "No agent is alive any more."
            return self.end(Sort.ABSENT, "", what, self._start_all())
        last = max((rate.last or 0.0 for rate in view.rates.values()), default=self.now)
        owners = [i for i, card in view.cards.items() if WHEELS.name in card.owns]
        if self.now - last <= DEAF_S or any(owner in view.gone for owner in owners[-1:]):
            return None
        what = f"No message has been received for {self.now - last:.1f} s: "
        what += "this observer is disconnected, or a recording has a gap."
        return self.end(Sort.UNKNOWN, "", what)

    # Conditions that do not depend on bids -------------------------------------------------------

    def _stopped(self, state: RobotState) -> Finding | None:
        if state.stop.stopped:
            missing = [n for r in self.view.reports.values() if r.acts for n in r.missing]
            if missing:
                self.add(f"The monitor reports missing agents: {', '.join(missing)}.")
            by, todo = state.stop.requester, release(state.stop, motors=state.motors)
            return self.end(Sort.STOP, by, f"It is stopped by {by}.", todo)
        if not state.motors:
            todo = release(state.stop, motors=False)
            return self.end(Sort.MOTORS, "", "Its motors are off.", todo)
        return None

    def _mission(self) -> Finding | None:
        """The cause if there is no path to drive."""
        way, mission = self.view.trajectory, self.view.mission
        if way is not None and way.waypoints:
            if not way.waits:
                return None
            note = mission.note if mission is not None else ""
            what = f"No path to the goal is free{f': {note}' if note else ''}."
            return self.end(Sort.NO_WAY, "", what, "clear the path, or set another goal")
        if self.view.state is not None and self.view.state.charging:
            return self.end(Sort.CHARGING, "", "It is charging in its dock and has no goal.")
        state = MissionState.NONE if mission is None else mission.state
        if state is MissionState.PLANNING:
            return self.end(Sort.PLANNING, "", "Its path is being planned.")
        if mission is not None and mission.refused:
            what = f"It has no goal: the last goal was refused, {mission.refused}."
            return self.end(Sort.REFUSED_GOAL, "", what, "set a goal that it can reach")
        if mission is None or state in (MissionState.NONE, MissionState.DRIVING):
            return self.end(Sort.NO_GOAL, "", "It has no goal.", "set one: `armadico goto X Y`")
        if mission.doubt:
            what = f"It is not known whether it is at its goal: {mission.doubt}."
            return self.end(Sort.UNSURE, "", what, "bring it to where the map tells its place")
        if state is MissionState.REACHED:
            return self.end(Sort.REACHED, "", "It has reached its goal.")
        what = f"The mission failed: {mission.note or 'no reason given'}."
        return self.end(Sort.FAILED, "", what, "set another goal")

    # The wheels ----------------------------------------------------------------------------------

    def _wheels(self) -> Finding:
        """Why the driving agent does not move the robot, or why no agent drives."""
        view = self.view
        driver = view.driver(WHEELS.name, self.now)
        if driver is not None:
            return self._driven(driver)
        self.add(f"No agent is obeyed on {WHEELS.name}.")
        contenders = [a for a in view.agents if a.card and WHEELS.name in a.card.resources]
        if not contenders:
            return self._no_contender()
        self._complaints = {
            bid.lacks
            for each in contenders
            if (bid := view.bid(each.instance, WHEELS.name)) and not self._is_old(bid) and bid.lacks
        }
        found = [self._contender(each.instance) for each in contenders]
        causes = [each for each in found if each is not None]
        if causes:
            return min(causes, key=lambda c: (c.sort is Sort.STARTING, _ORDER.index(c.sort)))
        if gone := self._lost_contenders():
            return self.absent(gone)
        return self.end(Sort.UNKNOWN, "", "No contender has reported a missing input.")

    def unready(self) -> Iterator[Finding]:
        """The causes why no contender could drive, by what all of them ask for."""
        view = self.view
        if view.state is None or self.silent(service_of(RobotState).key):
            return
        cards = [a.card for a in view.agents if a.card and WHEELS.name in a.card.resources]
        if not cards:
            yield self._no_contender()
        asked = {each for card in cards for each in card.requests}
        own = [service_of(kind).key for kind in (Description, Pose)]
        wanted = [k for k in (*own, *self._obstacles()) if any(matches(a, k) for a in asked)]
        if service_of(Trajectory).pattern in asked:  # of goals, which an agent has to take
            wanted.append(service_of(MissionStatus).key)
        for key in wanted:
            if not self.silent(key) or key in self._followed:
                continue
            service = service_at(key)
            allowed = SEEN_S if service is None else max(service.deadline_s or 0.0, SEEN_S)
            if view.age(self.now) <= allowed:
                what = f"{key} was not received in {view.age(self.now):.1f} s."
                yield self.end(Sort.STARTING, key, what)
            else:
                yield self.lacking(key, "")

    def _driven(self, driver: str) -> Finding:
        view, name = self.view, agent_of(driver)
        claim = view.claim(WHEELS.name, self.now)
        wanted = () if claim is None or isinstance(claim.wanted, bytes) else claim.wanted
        bid = view.bid(driver, WHEELS.name)
        if any(abs(each) > RESTS for each in wanted):
            return self._held_up(name)
        if (where := self._lost()) is not None:
            return where
        if (stood := self.now - (view.rests_since or self.now)) < STARTS_S:
            what = f"{name} drives; the robot has stood for only {stood:.1f} s."
            return self.end(Sort.STARTING, name, what)
        reason = (bid.reason if bid else "") or "no reason given"
        what = f"{name} drives but finds no free path: {reason}."
        return self.end(Sort.BLOCKED, name, what, "clear the obstacles near the robot")

    def _held_up(self, name: str) -> Finding:
        """The robot is commanded to move, but does not."""
        view, begun = self.view, self.view.held_since(WHEELS.name)
        since = min(self.now - begun, self.now - (view.rests_since or self.now))
        if since < STARTS_S:
            return self.end(Sort.STARTING, name, f"{name} has just started to drive.")
        state = view.state
        stands = state is None or (state.capped and abs(state.admitted.v) <= RESTS)
        if stands and (slowed := self._recent(LogEvent.SLOWED)):
            what = f"{name} drives, but {self._owner()} slows down for an obstacle: {slowed}."
            return self.end(Sort.BLOCKED, name, what, "clear the obstacles near the robot")
        what = f"{name} drives, but the wheels do not turn: "
        what += "they are blocked, or the controller does not execute its commands."
        todo = "check what blocks the robot, and the line to its controller"
        return self.end(Sort.STALLED, self._owner(), what, todo)

    def _owner(self) -> str:
        """The agent that owns the wheels; the resource's name if it is not known."""
        owners = [a.name for a in self.view.agents if a.card and WHEELS.name in a.card.owns]
        return owners[0] if owners else WHEELS.name

    def _no_contender(self) -> Finding:
        """The cause if no live agent competes for the wheels."""
        if gone := self._lost_contenders():
            return self.absent(gone)
        if not self.view.complete or self.view.age(self.now) < SEEN_S:
            what = f"Which agents compete for {WHEELS.name} is not known yet."
            return self.end(Sort.STARTING, WHEELS.name, what)
        what = f"No agent that competes for {WHEELS.name} is alive."
        if away := self._host_down(None):
            self.add(what)
            return away
        return self.end(Sort.ABSENT, WHEELS.name, what, self._start_all())

    def _lost_contenders(self) -> list[str]:
        """Instances that competed for the wheels and are gone, with no successor."""
        names, cards = self.view.names, self.view.cards
        return [
            instance
            for instance in self.view.gone
            if agent_of(instance) not in names
            and instance in cards
            and WHEELS.name in cards[instance].resources
        ]

    def _contender(self, instance: str) -> Finding | None:
        """Why one contender does not drive; None if it has no reason to."""
        view, name = self.view, agent_of(instance)
        bid = view.bid(instance, WHEELS.name)
        if bid is None:
            return None
        if self._is_old(bid):
            return self._no_turn(instance, bid)
        if bid.utility is not None:
            return None if bid.utility <= 0.0 else self._unobeyed(instance, bid)
        self.add(f"no bid ({bid.reason or 'no reason given'}).", name)
        if bid.unsound:
            todo = f"fix {name}; see `armadico logs {name}`"
            return cause(Sort.UNSOUND, name, f"{name}: {bid.reason}", todo)
        if not (key := bid.lacks):
            return None
        known = key == service_of(Pose).key and not self.silent(key)
        if known and (where := self._lost()) is not None:
            return where
        return self._just_received(key, instance) or self.lacking(key, instance)

    def _just_received(self, key: str, instance: str) -> Finding | None:
        """STARTING if the missing input has arrived since the instance was last queried.

        Bids are queried once per second, so a reported reason may be out of date.
        """
        rate, at = self.view.rates.get(key), self.view.answered.get(instance)
        if rate is None or at is None or self.silent(key) or self.stale(key):
            return None
        if at > rate.since + FRESH_CYCLES * self._cycle_s():
            return None
        what = f"{key} has been received for only {self.now - rate.since:.1f} s."
        return self.end(Sort.STARTING, agent_of(instance), what, of=agent_of(instance))

    def _cycle_s(self) -> float:
        return PERIOD if self.view.description is None else self.view.description.cycle_s

    def _is_old(self, bid: BidRecord) -> bool:
        state = self.view.state
        if state is None:
            return False
        newest = state.cycle
        return bid.cycle.epoch != newest.epoch or newest.number - bid.cycle.number > MISSED

    def _no_turn(self, instance: str, bid: BidRecord) -> Finding:
        """The newest bid is old: the inputs do not arrive, or the agent hangs."""
        view, name = self.view, agent_of(instance)
        self.add(f"no bid computed since cycle {bid.cycle.number}.", name)
        needed = self._needed(instance, bid)
        for key in needed:
            if self.silent(key) or self.stale(key):
                return self.lacking(key, instance)
        period = self._cycle_s()
        newest = bid.cycle.number if view.state is None else view.state.cycle.number
        if not self._responds(instance, self.now - period * (newest - bid.cycle.number)):
            return self.quiet(instance)
        lacked = [key for key in needed if key in self._complaints] or needed
        if not lacked:
            return self.quiet(instance)
        return self._just_received(lacked[0], instance) or self.lacking(lacked[0], instance)

    def _needed(self, instance: str, bid: BidRecord) -> list[str]:
        """The keys of its bid's inputs, or of all states that it subscribes to."""
        known = {*self.view.rates, *self._complaints, *self._obstacles()}
        found = sorted(k for k in known if any(matches(each, k) for each in bid.inputs))
        return found or self._inputs(instance)

    def _obstacles(self) -> list[str]:
        """The keys of the obstacles of each sensor of the robot."""
        robot, key = self.view.description, service_of(Obstacles).key
        return [] if robot is None else [key.format(name=sensor) for sensor in robot.sensors]

    def _responds(self, instance: str, since: float) -> bool:
        """Whether an instance answered or logged later than `QUIET_S` after a time."""
        times = [self.view.answered.get(instance, float("-inf"))]
        times += [line.at for line in self.view.logs if line.instance == instance]
        return max(times) > since + QUIET_S

    def _unobeyed(self, instance: str, bid: BidRecord) -> Finding | None:
        """The cause if an agent bids, but is not obeyed; None: an arbiter has the cause."""
        name = agent_of(instance)
        self.add(f"bids {bid.utility:.2f}, but is not obeyed.", name)
        if foreign := self._foreign(instance):
            todo = f"install the same version of armadico for {name}"
            return self.end(Sort.FOREIGN, name, foreign, todo)
        to = self._owner()
        if refused := self._recent(LogEvent.COMMANDS_REFUSED):
            return self.end(Sort.REFUSED, name, f"{to} reports: {refused}.")
        if (bids := self.view.bids_for(instance, WHEELS.name, self.now)) < YOUNG_S:
            what = f"{name} has bid for only {bids:.1f} s."
            return self.end(Sort.STARTING, name, what)
        card = self.view.cards.get(instance)
        decides = (
            BALLOTS if card is None or awards(card, WHEELS.name) else card.mechanism_of(WHEELS.name)
        )
        if decides != BALLOTS:  # it commands nothing itself
            return self._undecided(decides)
        what = f"Commands from {name} do not reach {to}."
        return self.end(Sort.LINK, f"{name} -> {to}", what, "check the network between them")

    def _undecided(self, mechanism: str) -> Finding | None:
        """Why nobody decides about the bids of agents under an arbiter.

        None if an arbiter is alive: it competes, too, and has its own cause.
        """
        view, cards = self.view, self.view.cards
        arbiters = {instance for instance, card in cards.items() if awards(card, WHEELS.name)}
        if arbiters & view.alive.keys():
            return None
        if gone := [instance for instance in view.gone if instance in arbiters]:
            return self.absent(gone)
        what = f"No arbiter is alive that decides by {mechanism} about {WHEELS.name}."
        todo = f"`armadico up --coordination {mechanism}` starts one"
        return self.end(Sort.ABSENT, mechanism, what, todo)

    def _foreign(self, instance: str) -> str:
        """Why the other agents ignore an instance, by their cards; empty if they do not."""
        card = self.view.cards.get(instance)
        if card is None:
            return ""
        if not card.understood():
            return f"{card.name} uses protocol {card.speaks}, the other agents {protocols()}."
        owners = [a.card for a in self.view.agents if a.card and WHEELS.name in a.card.owns]
        for owner in owners:
            if differing := differently(card.declares, owner.declares):
                return f"{card.name} declares {differing[0]}, {owner.name} {differing[1]}."
        return ""

    def _lost(self) -> Finding | None:
        found = lost(self.view, self.now)
        if found is not None:
            self.add(found.what)
            self._ends[found] = found.what
        return found

    # From a missing input to its provider --------------------------------------------------------

    def lacking(self, key: str, instance: str) -> Finding:
        """Why an input of an instance is not fresh; "" stands for this observer."""
        self._followed.add(key)
        alive = [a.instance for a in self.view.agents if a.card and key in a.card.provides]
        alive = alive or self._owners(key)
        if not self.silent(key):
            return self._not_arriving(key, instance, alive)
        if not alive:
            return self._unprovided(key)
        # Without one since this observer began, nothing is known of the time before.
        since = min(self.silence(key), self.view.age(self.now))
        names = ", ".join(map(agent_of, alive))
        what = f"{names} provides {key} and is alive, but none was received for {since:.1f} s"
        self.add(f"{what}{'' if key in self.view.rates else ', since this observation began'}.")
        for needed in self._inputs(alive[0]):
            before = self._last(needed) <= self._last(key)
            if needed not in self._followed and self.silent(needed) and before:
                return self.lacking(needed, alive[0])
        return self.quiet(alive[0], key)

    def _owners(self, key: str) -> list[str]:
        """The instances that own the resource whose ack is published on a key."""
        agents = [a for a in self.view.agents if a.card]
        return [
            a.instance
            for a in agents
            for owned in (a.card.owns if a.card else ())
            if key == f"resource/{owned}/ack"
        ]

    def _inputs(self, instance: str) -> list[str]:
        """The keys of received states that an instance subscribes to, oldest message first."""
        card, rates = self.view.cards.get(instance), self.view.rates
        known = [key for key, rate in rates.items() if rate.deadline_s is not None]
        found = [key for key in known if card and any(matches(r, key) for r in card.requests)]
        own = card.provides if card else ()
        return sorted((k for k in found if k not in own), key=lambda k: (self._last(k), k))

    def _not_arriving(self, key: str, instance: str, alive: list[str]) -> Finding:
        """The cause if an input is published: it is stale, or it does not arrive."""
        name = agent_of(instance)
        if (late := self.stale(key)) and alive:
            provider = agent_of(alive[0])
            what = f"The newest {key} from {provider} is {late} cycles old."
            todo = f"{provider} is slow, or receives the robot's messages late"
            return self.end(Sort.STALE, provider, what, todo)
        by = alive[0] if alive else key
        there, here = self.host(by), self.host(instance)
        todo = "check the network between them"
        if there and here and there != here:
            what = f"{key} is published on {there}, but does not arrive on {here}."
            return self.end(Sort.HOST, there, what, todo, name)
        what = f"{key} is published, but does not arrive."
        return self.end(Sort.LINK, f"{agent_of(by)} -> {name}", what, todo, name)

    def _unprovided(self, key: str) -> Finding:
        gone = [i for i in self.view.gone if self._provided(i, key)]
        if gone:
            return self.absent(gone)
        missing = {n for r in self.view.reports.values() if r.acts for n in r.missing}
        able = tuple(self._installed(key))
        if unknown := [i for i in self.view.alive if i not in self.view.cards]:
            if likely := [i for i in unknown if agent_of(i) in able]:
                return self.quiet(likely[0], key)
            names = ", ".join(sorted({agent_of(i) for i in unknown}))
            what = f"Which agent provides {key} is not known: {names} has not answered."
            return self.end(Sort.STARTING, key, what)
        named = [n for n in able if n in missing] or [n for n in able if n not in self.view.names]
        what = f"No agent that provides {key} is alive."
        if away := self._host_down(able):
            self.add(what)
            return away
        if not named:
            return self.end(Sort.ABSENT, key, what, f"start one that provides {key}")
        what = f"No agent that provides {key} is alive; {' or '.join(named)} would provide it."
        return self.end(Sort.ABSENT, named[0], what, f"`armadico-agent {named[0]}` starts it")

    def _host_down(self, able: Sequence[str] | None) -> Finding | None:
        """The first host of the table that should run one of these agents and has none alive."""
        there = {self.host(instance) for instance in self.view.alive}
        for host, agents in self._table.items():
            wanted = [name for name in agents if able is None or name in able]
            if wanted and host not in there and not self.view.names & set(wanted):
                what = f"{host} should run {', '.join(wanted)}, but no agent on {host} is alive."
                return self.end(
                    Sort.HOST, host, what, f"{_reachable(host)}; {self._demand.starts(host)}"
                )
        return None

    def _start_all(self) -> str:
        """What to do if no agent is alive."""
        if not self._table:
            return "`armadico up` starts a whole society"
        return "; ".join(self._demand.starts(host) for host in self._table if self._table[host])

    def _provided(self, instance: str, key: str) -> bool:
        card = self.view.cards.get(instance)
        owned = () if card is None else tuple(f"resource/{each}/ack" for each in card.owns)
        return card is not None and key in (*card.provides, *owned)

    def absent(self, gone: list[str]) -> Finding:
        """The cause if these instances have ended: an agent, or a whole host."""
        last = max(gone, key=lambda instance: self.view.gone[instance])
        name, host = agent_of(last), self.host(last)
        ago = self.now - self.view.gone[last]
        there = [i for i in self.view.alive if host and self.host(i) == host]
        away = sorted({agent_of(i) for i in self.view.gone if host and self.host(i) == host})
        hosts = len({*self._table, *(card.host for card in self.view.cards.values())})
        if host and not there and len(away) > 1 and hosts > 1:
            what = f"No agent on {host} has been alive for {ago:.1f} s: {', '.join(away)}."
            todo = _reachable(host)
            todo += f"; {self._demand.starts(host)}" if host in self._table else ""
            return self.end(Sort.HOST, host, what, todo)
        names = sorted({agent_of(i) for i in gone})
        at = f" (host {host})" if host else ""
        be, they, were = ("is", "it", "was") if len(names) == 1 else ("are", "they", "were")
        what = f"{', '.join(names)}{at} {be} not alive: "
        what += f"{they} ended or {were} disconnected {ago:.1f} s ago."
        what += self._last_error(last)
        return self.end(Sort.ABSENT, name, what, self._demand.restarts(name, host))

    def quiet(self, instance: str, key: str = "") -> Finding:
        """The cause if an agent has its inputs, but publishes nothing on a key, or does nothing."""
        name, host, card = agent_of(instance), self.host(instance), self.view.cards.get(instance)
        since = self._last(key)
        came = self.view.alive.get(instance, float("-inf"))
        if self.now - came <= YOUNG_S and since <= came and not self._complaint(instance, came):
            # The tokens of a new observer all appear at once, whatever the age of the agents.
            new = came - (self.view.began or 0.0) <= QUIET_S
            what = f"{name} started only {self.now - came:.1f} s ago."
            if new:
                what = f"{name} has been observed for only {self.now - came:.1f} s."
            return self.end(Sort.STARTING, name, what)
        if key and self._responds(instance, since):
            words = self._complaint(instance, since)
            if card is not None and card.owns:
                words = f": {card.fault}" if card.fault else words
                what = f"The device of {name} sends no data{words.rstrip('.?')}."
                todo = "check the robot, its port and its cable"
                if card.fault:
                    todo = "fix this, and restart the society"
                return self.end(Sort.DEVICE, name, what, todo)
            what = f"{name} answers queries, but publishes no {key}{words.rstrip('.?')}."
            return self.end(Sort.SILENT, name, what, f"see `armadico logs {name}`")
        pid = f" (host {host}, pid {card.pid})" if card is not None else ""
        what = f"{name}{pid} hangs or is disconnected: its inputs arrive, but it does not answer."
        return self.end(Sort.SILENT, name, what, f"restart it; see `armadico logs {name}`")

    def _complaint(self, instance: str, since: float) -> str:
        """The newest warning or error of an instance since a time, after a colon; else empty."""
        texts = [
            each.log.text
            for each in self.view.logs
            if each.instance == instance and each.at >= since and each.log.level >= WARNING
        ]
        return f": {texts[-1]}" if texts else ""

    def _last_error(self, instance: str) -> str:
        logs = [s.log for s in self.view.logs if s.instance == instance and s.log.level > WARNING]
        return f" Its last error: {logs[-1].text}" if logs else ""

    # Facts ---------------------------------------------------------------------------------------

    def end(self, sort: Sort, who: str, what: str, todo: str = "", of: str = "") -> Finding:
        """End the chain with a cause; `of` is the contender that `what` is about."""
        self.add(what, of)
        found = cause(sort, who, f"{of}: {what}" if of else what, todo)
        self._ends[found] = what
        return found

    def host(self, instance: str) -> str:
        """The host of an instance; empty if it is not known."""
        card = self.view.cards.get(instance)
        return "" if card is None else card.host

    def _last(self, key: str) -> float:
        rate = self.view.rates.get(key)
        return float("-inf") if rate is None or rate.last is None else rate.last

    def silence(self, key: str) -> float:
        """Time since the last publication on a key, s; infinite if there was none."""
        return self.now - self._last(key)

    def silent(self, key: str) -> bool:
        """Whether the last publication on a key is older than its deadline."""
        rate = self.view.rates.get(key)
        allowed = QUIET_S if rate is None else max(rate.deadline_s or 0.0, QUIET_S)
        return self.silence(key) > allowed

    def stale(self, key: str) -> int:
        """The age of the newest message on a key, cycles; 0 if it is fresh."""
        state, newest = self.view.state, self.view.newest.get(key)
        cycle = getattr(newest, "cycle", None)
        if state is None or not isinstance(cycle, Cycle) or cycle.epoch != state.cycle.epoch:
            return 0
        late = state.cycle.number - cycle.number
        allowed = (self.view.rates[key].deadline_s or 0.0) / self._cycle_s()
        return late if late > max(FRESH_CYCLES, round(allowed)) else 0

    def _recent(self, event: LogEvent) -> str:
        """The text of the newest log line of an event in the last `RECENT_S`; else empty."""
        recent = (line for line in reversed(self.view.logs) if self.now - line.at <= RECENT_S)
        return next((line.log.text for line in recent if line.log.event == event), "")


_ORDER: Final = tuple(Sort)


def lost(view: View, now: float) -> Finding | None:
    """That the pose is too uncertain to drive; None if it is not, or not known."""
    if view.pose is None or view.pose.deviation <= LOST_M:
        return None
    if view.off_map(now):
        todo = "drive it back to what the map shows, or map this place too"
        return Finding(Sort.LOST, "", f"The robot is {view.pose_text(now)}.", todo)
    todo = "wait until an agent has localized it; check that it is within the map"
    since, about = view.lost_since, view.description
    if since is not None and now - since > FOUND_S and about is not None and LASER in about.sensors:
        todo += f"; {MEASURE}"
    return Finding(Sort.LOST, "", f"The robot is lost: {view.pose_text(now)}.", todo)


def _reachable(host: str) -> str:
    return f"check that {host} is switched on and connected to the network"
