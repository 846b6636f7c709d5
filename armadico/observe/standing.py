"""Why the robot stands: the chain of reasons, down to the person, agent, host or device (sans-IO).

One for everybody: `armadico why`, doctor, top, the page, programs. It goes by what a `View` has
been shown, so whoever asks shows it what is published, tokens, cards and bids, and asks for the
last two about once a second. It begins with what holds whatever anybody bids (the stop, motors, no
goal), goes on with who drives, and if nobody does, with why each contender does not: a behaviour
says itself which input it lacks. From there it follows who provides that, and what that one lacks,
until somebody is found who has all and publishes nothing, or is not there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from msgspec import Struct

from armadico.core.agent import WARNING
from armadico.core.cycles import PERIOD
from armadico.core.hands import release
from armadico.core.messages import PROTOCOL, BidRecord, Cycle, LogEvent, RobotState
from armadico.core.resources import WHEELS, differently
from armadico.core.services import QUIET_S, matches, service_of
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.messages import MissionState, Pose
from armadico.mobile.obstacles import Obstacles
from armadico.observe.view import FRESH_CYCLES, RESTS, View, agent_of

MISSED: Final = 15
"""Cycles: bids are asked for once a second, so an older one is not the newest that there is."""

STARTS_S: Final = 1.0
"""From rest to motion it takes no longer, cycles and ramps included."""

DEAF_S: Final = 2.5
"""Who hears nobody at all for so long has itself to blame: some say something each second."""

YOUNG_S: Final = 2.0
"""Who is there for no longer has not failed yet: a controller takes a second to answer."""

LATELY_S: Final = 5.0
"""A log line that explains what is now came within this."""


class Sort(StrEnum):
    """What sort of cause it is."""

    STOP = "stop"  # somebody latched it
    MOTORS = "motors"  # are off
    STARTING = "starting"  # who drives has just begun, or has just got what it needs
    STALLED = "stalled"  # something holds the wheels, or they are not driven
    CHARGING = "charging"
    NO_GOAL = "no goal"
    REFUSED_GOAL = "refused goal"  # the last one that was asked for
    PLANNING = "planning"
    REACHED = "reached"
    FAILED = "failed"  # the mission was given up
    NO_WAY = "no way"  # it waits for one to become free
    LOST = "lost"  # nobody drives by such a pose
    BLOCKED = "blocked"  # who drives sees no free way
    ABSENT = "absent"  # an agent is not alive
    SILENT = "silent"  # an agent is alive, has what it needs, and publishes nothing
    UNREACHABLE = "unreachable"  # the robot's router, and with it everybody
    HOST = "host"  # all agents of a host are gone, or it is cut off
    LINK = "link"  # what is published does not arrive
    STALE = "stale"  # an agent publishes what answers old cycles
    DEVICE = "device"  # the controller, its line or its port
    UNSOUND = "unsound"  # an agent bids what is no bid
    REFUSED = "refused"  # the owner refuses the holder's commands
    FOREIGN = "foreign"  # it speaks another protocol, or means something else by a resource
    OUTBID = "outbid"  # another one's bid is better
    RELEASED = "released"  # whoever held it let go
    BUMPED = "bumped"  # somebody walked into the robot
    UNSEEN = "unseen"  # no sensor knew of what it touched
    DRIVEN = "driven"  # one did, and it was driven there all the same
    UNKNOWN = "unknown"  # as far as anybody was heard


AS_ASKED: Final = frozenset(
    {
        Sort.NO_GOAL,
        Sort.STARTING,
        Sort.PLANNING,
        Sort.REACHED,
        Sort.CHARGING,
        Sort.OUTBID,
        Sort.RELEASED,
    }
)
"""Nothing is amiss."""

AT_FAULT: Final = frozenset(
    {
        *(Sort.UNREACHABLE, Sort.ABSENT, Sort.SILENT, Sort.HOST, Sort.LINK, Sort.STALE),
        *(Sort.DEVICE, Sort.UNSOUND, Sort.REFUSED, Sort.FOREIGN, Sort.DRIVEN, Sort.UNSEEN),
    }
)
"""Something of the society, its machines or its robot has to be mended."""


class Cause(Struct, frozen=True):
    """Where a chain of reasons ends: of what sort, who or what it is, in words, and what to do.

    `who` is an agent's name, a host, a key that nobody provides, a link (`a -> b`), or by whom it
    was stopped; empty where it is nobody.
    """

    sort: Sort
    who: str
    what: str
    todo: str = ""


class Standing(Struct, frozen=True):
    """Whether the robot stands, and why: from what is seen down to the cause."""

    stands: bool
    sentences: tuple[str, ...]
    cause: Cause | None = None  # none: it moves


Installed = Callable[[str], Iterable[str]]
"""The names of installed agents that provide what is published on a key."""


Hosts = Mapping[str, Sequence[str]]
"""The agents that each host of a host table runs."""

NO_TABLE: Final[Hosts] = MappingProxyType({})


def standing(
    view: View, now: float, installed: Installed = lambda _: (), hosts: Hosts = NO_TABLE
) -> Standing:
    """Why the robot of a view stands; `now` is by the clock of whoever showed it things, s.

    A watcher that has just begun does not know the agents that were gone before: `installed` names
    those that it may be, and `hosts` where they are to run.
    """
    chain = _Chain(view, now, installed, hosts)
    cause = chain.begin()
    if cause is not None:
        chain.close(cause)
    return Standing(cause is not None, chain.sentences, cause)


class _Chain:
    """One chain of reasons, as it is followed."""

    def __init__(self, view: View, now: float, installed: Installed, hosts: Hosts) -> None:
        self.view = view
        self._installed = installed
        self._table = hosts
        self.now = now
        self._said: dict[str, list[str]] = {}
        self._ends: dict[Cause, str] = {}  # and what was said of it
        self._asked: set[str] = set()  # keys that were followed
        self._complaints: set[str] = set()  # keys that contenders lack

    def begin(self) -> Cause | None:
        """From what is seen of the robot."""
        view, state = self.view, self.view.state
        key = service_of(RobotState).key
        if view.cut_since is not None:
            return self._unreachable(self.now - view.cut_since)
        if (nobody := self._nobody_is_heard()) is not None:
            return nobody
        if state is None or self.silent(key):
            since = "" if state is None else f" for {self.silence(key):.1f} s"
            self.say(f"Nothing is heard of the robot{since}: no {key}.")
            return self.lacking(key, "")
        if max(abs(state.v), abs(state.w)) > RESTS:
            who = view.driver(WHEELS.name, self.now)
            by = "nobody is obeyed, and it rolls out" if who is None else f"{agent_of(who)} drives"
            self.say(f"The robot moves at {state.v:.2f} m/s, {state.w:.2f} rad/s: {by}.")
            return None
        self.say("The robot stands.")
        return self._hands(state) or self._mission() or self._wheels()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was said; what several agents have in common once, with all of them."""
        return tuple(
            f"{', '.join(who)}: {text}" if who else text for text, who in self._said.items()
        )

    def say(self, text: str, who: str = "") -> None:
        """One more link of the chain; `who` is the contender that it is said of."""
        known = self._said.setdefault(text, [])
        if who and who not in known:
            known.append(who)

    def close(self, cause: Cause) -> None:
        """The cause comes last, whatever else was followed."""
        text = self._ends.get(cause)
        if text is not None:
            self._said[text] = self._said.pop(text)

    def _unreachable(self, since: float) -> Cause:
        """The robot agent's process is the router: without it nothing arrives."""
        what = f"The robot agent has not been reachable for {since:.1f} s: it has ended or hangs,"
        what += " or the network to it is cut."
        todo = "`armadico doctor`, on the robot's computer, says which; `armadico up` starts it"
        return self.end(Sort.UNREACHABLE, self._owner(), what, todo)

    def _nobody_is_heard(self) -> Cause | None:
        """Of a society that has ended, or where whoever listens is cut off, nothing is known."""
        view = self.view
        if view.gone and not view.alive:
            what = "No agent is alive any more."
            return self.end(Sort.ABSENT, "", what, self._start_all())
        last = max((rate.last or 0.0 for rate in view.rates.values()), default=self.now)
        owners = [i for i, card in view.cards.items() if WHEELS.name in card.owns]
        if self.now - last <= DEAF_S or any(owner in view.gone for owner in owners[-1:]):
            return None
        what = (
            f"Nothing is heard of anybody for {self.now - last:.1f} s: whoever listens is cut off,"
        )
        return self.end(Sort.UNKNOWN, "", f"{what} or a recording has a gap.")

    # What holds whatever anybody bids ------------------------------------------------------------

    def _hands(self, state: RobotState) -> Cause | None:
        if state.stop.stopped:
            missing = [n for r in self.view.reports.values() if r.acts for n in r.missing]
            if missing:
                self.say(f"The society lacks {', '.join(missing)}.")
            by, todo = state.stop.who, release(state.stop, motors=state.motors)
            return self.end(Sort.STOP, by, f"It is stopped by {by}.", todo)
        if not state.motors:
            todo = release(state.stop, motors=False)
            return self.end(Sort.MOTORS, "", "Its motors are off.", todo)
        return None

    def _mission(self) -> Cause | None:
        """Whether there is somewhere to drive to."""
        way, mission = self.view.trajectory, self.view.mission
        if way is not None and way.waypoints:
            if not way.waits:
                return None
            note = mission.note if mission is not None else ""
            what = f"No way to the goal is free{f': {note}' if note else ''}."
            return self.end(Sort.NO_WAY, "", what, "clear the way, or give it another goal")
        if self.view.state is not None and self.view.state.charging:
            return self.end(Sort.CHARGING, "", "It stands in its dock and charges, with no goal.")
        state = MissionState.NONE if mission is None else mission.state
        if state is MissionState.PLANNING:
            return self.end(Sort.PLANNING, "", "Its way is being planned.")
        if mission is not None and mission.refused:
            what = f"It has no goal: the last one was refused, {mission.refused}."
            return self.end(Sort.REFUSED_GOAL, "", what, "give it a goal that it can reach")
        if mission is None or state in (MissionState.NONE, MissionState.DRIVING):
            todo = "give it one: `armadico goto X Y`"
            return self.end(Sort.NO_GOAL, "", "It has no goal.", todo)
        if state is MissionState.REACHED:
            return self.end(Sort.REACHED, "", "It has reached its goal.")
        what = f"The mission was given up: {mission.note or 'nobody said why'}."
        return self.end(Sort.FAILED, "", what, "give it another goal")

    # Who drives ----------------------------------------------------------------------------------

    def _wheels(self) -> Cause:
        """Who is obeyed and does not move it, or why nobody is."""
        view = self.view
        driver = view.driver(WHEELS.name, self.now)
        if driver is not None:
            return self._driven(driver)
        self.say(f"No agent is obeyed on {WHEELS.name}.")
        contenders = [a for a in view.agents if a.card and WHEELS.name in a.card.resources]
        if not contenders:
            return self._nobody()
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
        return self.end(Sort.UNKNOWN, "", "None of them has said what it lacks.")

    def _driven(self, driver: str) -> Cause:
        view, name = self.view, agent_of(driver)
        claim = view.claim(WHEELS.name, self.now)
        wanted = () if claim is None or isinstance(claim.wanted, bytes) else claim.wanted
        reason = self._reason(driver)
        if any(abs(each) > RESTS for each in wanted):
            return self._held_up(name)
        if view.pose is not None and view.pose.deviation > LOST_M:
            return self._lost()
        what = f"{name} drives and sees no free way: {reason or 'it does not say why'}."
        return self.end(Sort.BLOCKED, name, what, "clear what is near it")

    def _held_up(self, name: str) -> Cause:
        """It is commanded to move, and does not."""
        view, begun = self.view, self.view.held_since(WHEELS.name)
        since = min(self.now - begun, self.now - (view.rests_since or self.now))
        if since < STARTS_S:
            return self.end(Sort.STARTING, name, f"{name} has just begun to drive.")
        if slowed := self._lately(LogEvent.SLOWED):
            what = f"{name} drives, and the robot heeds what is ahead: {slowed}."
            return self.end(Sort.BLOCKED, name, what, "clear what is near it")
        what = f"{name} drives, and the wheels do not turn: something holds them,"
        what += " or the controller does not do as it is told."
        todo = "look what it stands against, and at its line"
        return self.end(Sort.STALLED, self._owner(), what, todo)

    def _owner(self) -> str:
        """The agent that owns the wheels, or those."""
        owners = [a.name for a in self.view.agents if a.card and WHEELS.name in a.card.owns]
        return owners[0] if owners else WHEELS.name

    def _reason(self, instance: str) -> str:
        bid = self.view.bid(instance, WHEELS.name)
        return "" if bid is None else bid.reason

    def _nobody(self) -> Cause:
        """Nobody competes for the wheels: who did?"""
        if gone := self._lost_contenders():
            return self.absent(gone)
        what = f"No agent that competes for {WHEELS.name} is alive."
        if away := self._away(None):
            self.say(what)
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

    def _contender(self, instance: str) -> Cause | None:
        """Why one contender does not drive; None: it has nothing to do, and need not."""
        view, name = self.view, agent_of(instance)
        bid = view.bid(instance, WHEELS.name)
        if bid is None:
            return None
        if self._is_old(bid):
            return self._turns_no_more(instance, bid)
        if bid.utility is not None:
            return None if bid.utility <= 0.0 else self._unobeyed(instance, bid)
        self.say(f"no bid ({bid.reason or 'it does not say why'}).", name)
        if bid.unsound:
            todo = f"mend {name}; `armadico logs {name}` has its last words"
            return Cause(Sort.UNSOUND, name, f"{name}: {bid.reason}", todo)
        if not (key := bid.lacks):
            return None
        if key == service_of(Pose).key and self._is_lost() and not self.silent(key):
            return self._lost()
        return self._came_since(key, instance) or self.lacking(key, instance)

    def _came_since(self, key: str, instance: str) -> Cause | None:
        """What somebody lacked when it was asked has come, first or again, since then.

        Bids are asked for once a second: they tell of so long ago.
        """
        rate, asked = self.view.rates.get(key), self.view.answered.get(instance)
        if rate is None or asked is None or self.silent(key) or self.stale(key):
            return None
        if asked > rate.since + FRESH_CYCLES * self._cycle_s():
            return None
        what = f"{key} has come for {self.now - rate.since:.1f} s only."
        return self.end(Sort.STARTING, agent_of(instance), what, of=agent_of(instance))

    def _cycle_s(self) -> float:
        return PERIOD if self.view.description is None else self.view.description.cycle_s

    def _is_old(self, bid: BidRecord) -> bool:
        state = self.view.state
        return state is not None and not _within(bid.cycle, state.cycle, MISSED)

    def _turns_no_more(self, instance: str, bid: BidRecord) -> Cause:
        """Its newest bid is old: what starts its turns does not come, or it hangs."""
        view, name = self.view, agent_of(instance)
        self.say(f"no turn since cycle {bid.cycle.number}.", name)
        needed = self._needed(instance, bid)
        for key in needed:
            if self.silent(key) or self.stale(key):
                return self.lacking(key, instance)
        period = self._cycle_s()
        newest = bid.cycle.number if view.state is None else view.state.cycle.number
        if not self._lives(instance, self.now - period * (newest - bid.cycle.number)):
            return self.quiet(instance)
        lacked = [key for key in needed if key in self._complaints] or needed
        if not lacked:
            return self.quiet(instance)
        return self._came_since(lacked[0], instance) or self.lacking(lacked[0], instance)

    def _needed(self, instance: str, bid: BidRecord) -> list[str]:
        """The keys of what its bids are made of, or of all that it listens to."""
        known = {*self.view.rates, *self._complaints, *self._obstacles()}
        found = sorted(k for k in known if any(matches(each, k) for each in bid.inputs))
        return found or self._inputs(instance)

    def _obstacles(self) -> list[str]:
        """The keys of obstacles by the sensors that the robot has."""
        said, key = self.view.description, service_of(Obstacles).key
        return [] if said is None else [key.format(name=sensor) for sensor in said.sensors]

    def _lives(self, instance: str, since: float) -> bool:
        """Whether an instance answered, or said a word, after something that it does no more."""
        heard = [self.view.answered.get(instance, float("-inf"))]
        heard += [said.at for said in self.view.logs if said.instance == instance]
        return max(heard) > since + QUIET_S

    def _unobeyed(self, instance: str, bid: BidRecord) -> Cause:
        """It bids, and is not obeyed."""
        name = agent_of(instance)
        self.say(f"bids {bid.utility:.2f}, and is not obeyed.", name)
        foreign = self._foreign(instance)
        if foreign:
            return self.end(Sort.FOREIGN, name, foreign, f"install the same armadico for {name}")
        if refused := self._lately(LogEvent.COMMANDS_REFUSED):
            return self.end(Sort.REFUSED, name, f"By {self._owner()}, {refused}.")
        to = self._owner()
        what = f"What {name} commands does not reach {to}."
        return self.end(Sort.LINK, f"{name} -> {to}", what, "look at the network between them")

    def _foreign(self, instance: str) -> str:
        """Why others do not listen to an instance, by their cards; empty: they do."""
        card = self.view.cards.get(instance)
        if card is None:
            return ""
        if card.protocol != PROTOCOL:
            return f"{card.name} speaks protocol {card.protocol}, the others {PROTOCOL}."
        owners = [a.card for a in self.view.agents if a.card and WHEELS.name in a.card.owns]
        for owner in owners:
            if differing := differently(card.declares, owner.declares):
                return f"{card.name} means {differing[0]}, {owner.name} {differing[1]}."
        return ""

    def _is_lost(self) -> bool:
        pose = self.view.pose
        return pose is not None and pose.deviation > LOST_M

    def _lost(self) -> Cause:
        where = self.view.whereabouts(self.now)
        todo = "an agent that looks for where it is drives it meanwhile; is it on the map at all?"
        return self.end(Sort.LOST, "", f"It does not know where it is: {where}.", todo)

    # Down to who is missing ----------------------------------------------------------------------

    def lacking(self, key: str, instance: str) -> Cause:
        """Why something that an instance needs is not fresh there; "" for whoever watches."""
        self._asked.add(key)
        alive = [a.instance for a in self.view.agents if a.card and key in a.card.provides]
        alive = alive or self._owners(key)
        if not self.silent(key):
            return self._not_arriving(key, instance, alive)
        if not alive:
            return self._unprovided(key)
        since = f"for {self.silence(key):.1f} s" if key in self.view.rates else "so far"
        names = ", ".join(map(agent_of, alive))
        self.say(f"{names} provides {key}, is alive, and has published none {since}.")
        for needed in self._inputs(alive[0]):
            before = self._last(needed) <= self._last(key)
            if needed not in self._asked and self.silent(needed) and before:
                return self.lacking(needed, alive[0])
        return self.quiet(alive[0], key)

    def _owners(self, key: str) -> list[str]:
        """Who owns the resource whose ack a key is, or nobody."""
        agents = [a for a in self.view.agents if a.card]
        return [
            a.instance
            for a in agents
            for owned in (a.card.owns if a.card else ())
            if key == f"resource/{owned}/ack"
        ]

    def _inputs(self, instance: str) -> list[str]:
        """The states that it listens to and that were heard once, the robot's own first."""
        card, rates = self.view.cards.get(instance), self.view.rates
        known = [key for key, rate in rates.items() if rate.deadline_s is not None]
        found = [key for key in known if card and any(matches(r, key) for r in card.requests)]
        own = card.provides if card else ()
        return sorted((k for k in found if k not in own), key=lambda k: (self._last(k), k))

    def _not_arriving(self, key: str, instance: str, alive: list[str]) -> Cause:
        """It is published: stale already, or it does not arrive."""
        name = agent_of(instance)
        if (late := self.stale(key)) and alive:
            who = agent_of(alive[0])
            what = f"{who} publishes {key} that answers cycles {late} too old."
            return self.end(Sort.STALE, who, what, f"{who} is slow, or hears the robot late")
        by = alive[0] if alive else key
        there, here = self.host(by), self.host(instance)
        who = f"{agent_of(by)} -> {name}"
        todo = "look at the network between them"
        if there and here and there != here:
            what = f"{key} is published on {there}, and does not arrive on {here}."
            return self.end(Sort.HOST, there, what, todo, name)
        what = f"{key} is published, and does not arrive."
        return self.end(Sort.LINK, who, what, todo, name)

    def _unprovided(self, key: str) -> Cause:
        gone = [i for i in self.view.gone if self._provided(i, key)]
        if gone:
            return self.absent(gone)
        missing = {n for r in self.view.reports.values() if r.acts for n in r.missing}
        able = tuple(self._installed(key))
        named = [n for n in able if n in missing] or [n for n in able if n not in self.view.names]
        what = f"No agent that provides {key} is alive."
        if away := self._away(able):
            self.say(what)
            return away
        if not named:
            return self.end(Sort.ABSENT, key, what, f"start one that provides {key}")
        what = f"No agent that provides {key} is alive: {' or '.join(named)} would."
        return self.end(Sort.ABSENT, named[0], what, f"`armadico-agent {named[0]}` starts it")

    def _away(self, able: Sequence[str] | None) -> Cause | None:
        """A host of the table that runs one of these agents, or any, and has none alive."""
        there = {self.host(instance) for instance in self.view.alive}
        for host, agents in self._table.items():
            wanted = [name for name in agents if able is None or name in able]
            if wanted and host not in there and not self.view.names & set(wanted):
                what = f"{host} is to run {', '.join(wanted)}, and no agent of {host} is alive."
                return self.end(Sort.HOST, host, what, f"{_reachable(host)} {_starts(host)}")
        return None

    def _start_all(self) -> str:
        """What to do where no agent is left."""
        if not self._table:
            return "`armadico up` starts a whole society"
        return "; ".join(_starts(host) for host, agents in self._table.items() if agents)

    def _provided(self, instance: str, key: str) -> bool:
        card = self.view.cards.get(instance)
        owned = () if card is None else tuple(f"resource/{each}/ack" for each in card.owns)
        return card is not None and key in (*card.provides, *owned)

    def absent(self, gone: list[str]) -> Cause:
        """Instances that were there and are not: one of them, or a whole host."""
        last = max(gone, key=lambda instance: self.view.gone[instance])
        name, host = agent_of(last), self.host(last)
        ago = self.now - self.view.gone[last]
        there = [i for i in self.view.alive if host and self.host(i) == host]
        away = sorted({agent_of(i) for i in self.view.gone if host and self.host(i) == host})
        if host and not there and len(away) > 1 and self._hosts() > 1:
            what = f"All of {host} is gone, for {ago:.1f} s: {', '.join(away)}."
            todo = _reachable(host)
            todo += f" {_starts(host)}" if host in self._table else ""
            return self.end(Sort.HOST, host, what, todo)
        names = ", ".join(sorted({agent_of(i) for i in gone}))
        at = f" (host {host})" if host else ""
        what = f"{names}{at} is not alive; it was until {ago:.1f} s ago."
        what += self._last_words(last)
        return self.end(Sort.ABSENT, name, what, f"start it again: `armadico-agent {name}`")

    def quiet(self, instance: str, key: str = "") -> Cause:
        """It is there, has what it needs, and publishes nothing on a key, or does nothing."""
        name, host, card = agent_of(instance), self.host(instance), self.view.cards.get(instance)
        since = self._last(key)
        came = self.view.alive.get(instance, float("-inf"))
        if self.now - came <= YOUNG_S and since <= came and not self._words(instance, came):
            what = f"{name} is there for {self.now - came:.1f} s only."
            return self.end(Sort.STARTING, name, what)
        if key and self._lives(instance, since):
            words = self._words(instance, since)
            if card is not None and card.owns:
                words = f": {card.fault}" if card.fault else words
                what = f"The device of {name} gives nothing{words}."
                todo = "look at the robot, its port and its line"
                if card.fault:
                    todo = "mend that, and start the society again"
                return self.end(Sort.DEVICE, name, what, todo)
            what = f"{name} answers, and publishes no {key}{words}."
            return self.end(Sort.SILENT, name, what, f"`armadico logs {name}` may say more")
        pid = f" (host {host}, pid {card.pid})" if card is not None else ""
        what = f"{name}{pid} hangs, or is cut off: what it needs is there, and it does not answer."
        return self.end(Sort.SILENT, name, what, f"restart it; `armadico logs {name}` says more")

    def _words(self, instance: str, since: float) -> str:
        """What an instance complained of since."""
        said = [
            each.log.text
            for each in self.view.logs
            if each.instance == instance and each.at >= since and each.log.level >= WARNING
        ]
        return f": {said[-1]}" if said else ""

    def _last_words(self, instance: str) -> str:
        said = [s.log for s in self.view.logs if s.instance == instance and s.log.level > WARNING]
        return f" Its last words: {said[-1].text}" if said else ""

    # What is known -------------------------------------------------------------------------------

    def end(self, sort: Sort, who: str, what: str, todo: str = "", of: str = "") -> Cause:
        """The last link of the chain; `of` is the contender that it is said of."""
        self.say(what, of)
        cause = Cause(sort, who, f"{of}: {what}" if of else what, todo)
        self._ends[cause] = what
        return cause

    def host(self, instance: str) -> str:
        """The machine of an instance; empty if nobody knows."""
        card = self.view.cards.get(instance)
        return "" if card is None else card.host

    def _hosts(self) -> int:
        return len({*self._table, *(card.host for card in self.view.cards.values())})

    def _last(self, key: str) -> float:
        rate = self.view.rates.get(key)
        return float("-inf") if rate is None or rate.last is None else rate.last

    def silence(self, key: str) -> float:
        """For how long nothing was published on a key, s; infinite if nothing ever was."""
        return self.now - self._last(key)

    def silent(self, key: str) -> bool:
        """Whether nothing was published on a key for longer than it should be."""
        rate = self.view.rates.get(key)
        allowed = QUIET_S if rate is None else max(rate.deadline_s or 0.0, QUIET_S)
        return self.silence(key) > allowed

    def stale(self, key: str) -> int:
        """By how many cycles too old the newest on a key is; 0: it is not."""
        state, newest = self.view.state, self.view.newest.get(key)
        cycle = getattr(newest, "cycle", None)
        if state is None or not isinstance(cycle, Cycle) or cycle.epoch != state.cycle.epoch:
            return 0
        late = state.cycle.number - cycle.number
        allowed = (self.view.rates[key].deadline_s or 0.0) / self._cycle_s()
        return late if late > max(FRESH_CYCLES, round(allowed)) else 0

    def _lately(self, event: LogEvent) -> str:
        """The newest log line that tells of an event; empty if there was none of late."""
        lately = (said for said in reversed(self.view.logs) if self.now - said.at <= LATELY_S)
        return next((said.log.text for said in lately if said.log.event == event), "")


_ORDER: Final = tuple(Sort)


def _reachable(host: str) -> str:
    return f"is {host} switched on, and its network up?"


def _starts(host: str) -> str:
    return f"`armadico up --host {host}`, on {host} and with its host table, starts its share"


def _within(cycle: Cycle, newest: Cycle, cycles: int) -> bool:
    return cycle.epoch == newest.epoch and newest.number - cycle.number <= cycles
