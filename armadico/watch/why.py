"""Explanations of moments, exchanges, stops and collisions (sans-IO).

A `Chronicle` receives the messages of a live society or of a recording, in order and with times.
It explains a moment about a second later: contenders that lost publish nothing, so their bids are
known only from the next query. Each answer is a struct with sentences and a cause
(`armadico.observe.standing`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import degrees, hypot
from typing import Final, TypeVar

from msgspec.structs import replace

from armadico.core.coordination import SILENCE, Owner, Verdict, beats
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.hands import release
from armadico.core.membership import agent_of
from armadico.core.messages import (
    Ack,
    Action,
    BidHistory,
    BidRecord,
    Claim,
    Command,
    Cycle,
    LogEvent,
    Message,
    RobotState,
    Stop,
)
from armadico.core.outgoing import WARNING
from armadico.core.owning import EXPECTED_REFUSALS, REPORT_S
from armadico.core.resources import WHEELS, declared
from armadico.core.services import matches, service_at, service_of
from armadico.mobile.messages import MissionState, Pose, Truth
from armadico.mobile.motion import Body
from armadico.mobile.obstacles import Obstacles
from armadico.observe.findings import NOTHING, Demand, Finding, Sort, cause
from armadico.observe.journeys import Journeys
from armadico.observe.pauses import Pauses
from armadico.observe.standing import standing
from armadico.observe.view import FRESH_CYCLES, RESTS, View
from armadico.watch.drives import Drives
from armadico.watch.explained import (
    Bidding,
    Collision,
    Contest,
    Exchange,
    Input,
    Moment,
    Press,
    describe_bid,
    describe_contest,
    outbid,
)

T = TypeVar("T")

# Delay after which the bids of a moment are known: agents are queried once per second.
LATER_S: Final = 1.6

# Cycles of bids, claims and commands in memory: longer than LATER_S, because a released resource
# may stay free for a while before the next exchange.
KEPT_CYCLES: Final = 200

# Maximum number of exchanges, stops, collisions and moments in memory; the oldest are dropped.
MOST: Final = 10_000

# A contender whose newest bid is more cycles older than a moment computed no bid for it.
AGO: Final = FRESH_CYCLES

# An obstacle reported this close to the footprint counts as detected.
NEAR_M: Final = 0.1

# Recordings of virtual runs contain token changes up to this much late.
GONE_S: Final = 1.0

# Age limit of the refused commands that a moment lists.
REFUSED_S: Final = 1.0

STATE: Final = service_of(RobotState).key
TRUTH: Final = service_of(Truth).key


def _ack_key(resource: str) -> str:
    return service_of(Ack).key.format(resource=resource)


@dataclass
class _Pressed:
    number: int
    t: float
    stop: Stop
    before: bool  # latched before the first robot state was received
    stood: float | None = None
    released: float | None = None
    released_by: str = ""


@dataclass
class _Snapshot:
    """The state at a time `t`, kept until the bids of that time are known."""

    t: float
    state: RobotState | None
    sentences: tuple[str, ...]  # about the robot
    stands: bool
    cause: Finding | None
    contests: list[Contest]
    contenders: dict[str, list[tuple[str, str]]]  # by resource: instance and host
    newest: dict[str, Message]


@dataclass
class _Takeover:
    """An exchange, kept until it is over and the bids of that time are known."""

    t: float
    ack: Ack
    loser: Claim | None
    lost: str
    winner: str
    claimed_at: float  # when the loser last claimed, s
    snapshot: _Snapshot
    blended: int = 0


@dataclass
class _History:
    """The last `KEPT_CYCLES` messages about one resource."""

    owner: Owner | None  # judges as the real owner does; None: the resource has its own cycles
    obeyed: str = ""  # the instance obeyed last
    exchanges: int = 0
    claims: deque[tuple[float, Claim]] = field(default_factory=lambda: deque(maxlen=KEPT_CYCLES))


_Pending = _Snapshot | _Takeover | tuple[_Snapshot, Finding, str]  # the tuple is a collision


class Chronicle:
    """Explains a society from its messages, received in order; times are s of one clock."""

    def __init__(
        self,
        recomputed: Mapping[tuple[str, str], Sequence[BidRecord]] | None = None,
        *,
        demand: Demand = NOTHING,
        begun: float = 0.0,
    ) -> None:
        """Start without messages.

        Args:
            recomputed: Bids replayed from journals, by instance and resource, oldest first. They
                replace bids that were not queried in time.
            demand: What the society should be.
            begun: Start of the observation, s; reported times count from it.
        """
        self.demand, self._begun = demand, begun
        self.view = View()
        self.now = 0.0
        self._recomputed = recomputed or {}
        self.exchanges: list[Exchange] = []
        self.collisions: list[Collision] = []
        self.moments: list[Moment] = []
        self.drives = Drives(WHEELS.name)
        self.journeys = Journeys()
        self._pressed: list[_Pressed] = []
        self._records: dict[tuple[str, str], deque[BidRecord]] = {}
        self._history: dict[str, _History] = {}  # by resource
        self._commands: deque[tuple[float, Command, str]] = deque(maxlen=4 * KEPT_CYCLES)
        self._clock = CycleClock()
        self._pending: deque[_Pending] = deque()
        self._collided = self._bumped = 0  # by the truth; of these, people walked into the robot
        self._touches = False  # the robot reports contact now
        self._counts: dict[str, Pauses] = {}  # by key
        self._state_at: float | None = None  # of the first state of the robot, s
        self.lost = ""  # which messages a recording lacks: any event may be among them

    # Input ---------------------------------------------------------------------------------------

    def begin(self, t: float) -> None:
        """Record that the observation began; reported times count from it."""
        self._begun = t
        self.view.begin(t)

    def token(self, instance: str, *, there: bool, t: float) -> None:
        self._advance(t)
        self.view.token(instance, there=there, t=t)

    def update(self, key: str, message: Message | None, t: float) -> None:
        """Process a publication; a message of None cannot be decoded."""
        self._advance(t)
        first, truth = self.view.state is None, self.view.truth
        self.view.update(key, message, t)
        if message is not None:
            self.journeys.update(message, self.view, t - self._begun)
        match message:
            case RobotState():
                self._count(STATE, t)
                self._on_state(message, t, first=first)
            case Truth() if self.view.truth is message:
                self._count(TRUTH, t)
                self._on_truth(message, begun=truth is not None)
            case Stop():
                self._on_stop(message, t, before=first)
            case Claim():
                self._on_claim(message, t)
            case Command():
                self._on_command(message, t)
            case Ack():
                self._count(_ack_key(message.resource), t)
                self._on_ack(message, t)

    def learn(self, message: Message, t: float) -> None:
        """Process a reply to a query, live or from a recording."""
        self._advance(t)
        self.view.learn(message, t)
        if isinstance(message, BidHistory):
            for bid in message.bids:
                kept = self._records.setdefault(
                    (message.instance, bid.resource), deque(maxlen=KEPT_CYCLES)
                )
                if bid not in kept:
                    kept.append(bid)

    def mark(self, t: float) -> None:
        """Explain the present moment once its bids are known; the result is added to `moments`."""
        self.now = t
        self._pending.append(self._snapshot())

    def finish(self) -> None:
        """Explain everything that is pending; no more messages follow."""
        while self._pending:
            self._explain(self._pending.popleft())

    @property
    def presses(self) -> list[Press]:
        return [self._press(pressed) for pressed in self._pressed]

    @property
    def unknown(self) -> dict[str, str]:
        """By kind of event, why not all of them may be known."""
        kinds = ("exchange", "stop", "collision")
        return {what: why for what in kinds if (why := self.uncounted(what))}

    def uncounted(self, what: str, resource: str = WHEELS.name) -> str:
        """Why not all events of a kind may be known; "" if they are.

        The kind is "collision", "stop", or "exchange" of a resource.
        """
        key = {"collision": TRUTH, "stop": STATE}.get(what) or _ack_key(resource)
        count, begun = self._counts.get(key), self._begun
        if count is None or self._state_at is None:
            return f"no {key if self._state_at is not None else STATE} was received"
        gap = count.gap(self.now, begun)
        return f"no {key} was received {gap}" if gap else self.lost

    # Inside --------------------------------------------------------------------------------------

    def _count(self, key: str, t: float) -> None:
        if key == STATE and self._state_at is None:
            self._state_at = t
        if key not in self._counts:  # before the first state there was nothing to count
            row = service_at(key)  # of a resource with long cycles acks are rare
            since = t if self._state_at is None else self._state_at
            self._counts[key] = Pauses(since, row.deadline_s if row else None)
        self._counts[key].add(t)

    def _advance(self, t: float) -> None:
        self.now = t
        while self._pending and self._at(self._pending[0]) + LATER_S <= t - self._begun:
            self._explain(self._pending.popleft())

    @staticmethod
    def _at(what: _Pending) -> float:
        return what[0].t if isinstance(what, tuple) else what.t

    def _explain(self, what: _Pending) -> None:
        if isinstance(what, _Snapshot):
            _keep(self.moments, self._moment(what))
        elif isinstance(what, _Takeover):
            _keep(self.exchanges, self._exchange(what))
        else:
            snapshot, cause, text = what
            moment = self._moment(snapshot)
            number = self.collisions[-1].number + 1 if self.collisions else 1
            sentences = (text, *moment.sentences, cause.what)
            _keep(self.collisions, Collision(number, snapshot.t, sentences, cause, moment))

    def _on_state(self, state: RobotState, t: float, *, first: bool) -> None:
        self._clock.advance(state.cycle, t)
        if state.stop.stopped:
            self._on_stop(state.stop, t, before=first)
        for pressed in self._pressed[-1:]:
            if (
                pressed.stood is None
                and max(abs(state.v), abs(state.w)) <= RESTS
                and state.stop.stopped
            ):
                pressed.stood = t - self._begun - pressed.t
        felt = state.touch is not None or state.stalled
        if felt and not self._touches and self.view.truth is None:
            self._collide("The robot reports contact with an obstacle.", bumped=False)
        self._touches = felt

    def _on_truth(self, truth: Truth, *, begun: bool) -> None:
        if begun and truth.collisions > self._collided:
            bumped = truth.bumped > self._bumped
            what = "A person walks into the robot." if bumped else "The robot touches an obstacle."
            self._collide(what, bumped=bumped)
        self._collided, self._bumped = truth.collisions, truth.bumped

    def _on_stop(self, stop: Stop, t: float, *, before: bool) -> None:
        # A delayed state may still contain the previous press.
        known = next((each for each in self._pressed if each.stop.press == stop.press), None)
        if known is None and stop.stopped:
            number = self._pressed[-1].number + 1 if self._pressed else 1
            _keep(self._pressed, _Pressed(number, t - self._begun, stop, before))
        elif known is not None and not stop.stopped and known.released is None:
            known.released, known.released_by = t - self._begun, stop.by

    def _on_claim(self, claim: Claim, t: float) -> None:
        history = self._of(claim.resource)
        history.claims.append((t, claim))
        if history.owner is not None:
            history.owner.on_claim(claim)
        for each in self._pending:
            if (
                isinstance(each, _Takeover)
                and claim.ballot == each.ack.obeyed
                and claim.commanded != claim.wanted
            ):
                each.blended += 1

    def _on_command(self, command: Command, t: float) -> None:
        owner = self._of(command.resource).owner
        if owner is not None:
            verdict = owner.judge(command, t, stopped=self._stops(command.resource))
            self._commands.append((t, command, str(verdict)))

    def _stops(self, name: str) -> bool:
        resource = declared(name)
        return resource is not None and resource.stops and self.view.stop.stopped

    def _of(self, name: str) -> _History:
        """The history of a resource; commands are judged only if its cycles are the robot's."""
        if name not in self._history:
            resource = declared(name)
            robots = resource is not None and resource.period_s is None
            owner = Owner(resource, self._clock) if resource is not None and robots else None
            self._history[name] = _History(owner)
        return self._history[name]

    def _on_ack(self, ack: Ack, t: float) -> None:
        lead = self.view.lead(ack.resource, t)
        self.drives.update(ack, self.view.cards, t - self._begun, lead)
        driver = self.view.driver(ack.resource, t)
        if driver is None or ack.obeyed is None:
            return
        history = self._of(ack.resource)
        before, history.obeyed = history.obeyed, driver
        if before in ("", driver):
            return
        theirs = [(at, c) for at, c in history.claims if c.ballot.instance == before]
        at, last = theirs[-1] if theirs else (float("-inf"), None)
        blended = sum(c.ballot == ack.obeyed and c.commanded != c.wanted for _, c in history.claims)
        since = t - self._begun
        taken = _Takeover(since, ack, last, before, driver, at, self._snapshot(), blended)
        self._pending.append(taken)

    def _collide(self, what: str, *, bumped: bool) -> None:
        self._pending.append((self._snapshot(), self._struck_by(bumped=bumped), what))

    # A moment ------------------------------------------------------------------------------------

    def _snapshot(self) -> _Snapshot:
        view, now = self.view, self.now
        found = standing(view, now, self.demand)
        names = [WHEELS.name, *(name for name in view.claimed if name != WHEELS.name)]
        contenders = {
            name: [
                (each.instance, each.card.host)
                for each in view.agents
                if each.card is not None and name in each.card.resources
            ]
            for name in names
        }
        return _Snapshot(
            now - self._begun,
            view.state,
            (*found.sentences, *self._mission()),
            found.stands,
            found.cause,
            [self._contest(name) for name in names],
            contenders,
            dict(view.newest),
        )

    def _mission(self) -> Iterator[str]:
        mission = self.view.mission
        if mission is not None and mission.state is MissionState.DRIVING:
            note = f" ({mission.note})" if mission.note else ""
            due = "" if mission.due_s is None else f", due in {mission.due_s:.0f} s"
            if (silent_s := self.view.mission_silent_s(self.now)) is not None:
                yield f"{silent_s:.0f} s ago its goal was {mission.to_go:.1f} m away{note}."
                return
            yield f"Its goal is {mission.to_go:.1f} m away{note}{'' if mission.late else due}."
            if mission.late:
                yield mission.delay

    def _contest(self, name: str) -> Contest:
        view, now = self.view, self.now
        claim, ack = view.claim(name, now), view.acks.get(name)
        found = Contest(
            name,
            obeyed=view.driver(name, now) or "",
            measured=() if ack is None else _numbers(ack.measured),
            refused=tuple(self._refused(name)),
        )
        if claim is None:
            return found
        return replace(
            found,
            holder=claim.ballot.instance,
            term=claim.ballot.term,
            utility=claim.utility,
            critical=claim.critical,
            wanted=_numbers(claim.wanted),
            commanded=_numbers(claim.commanded),
            loser=self._loser(name, claim) if claim.commanded != claim.wanted else "",
        )

    def _loser(self, name: str, claim: Claim) -> str:
        others = [c.ballot for _, c in self._of(name).claims if c.ballot < claim.ballot]
        return others[-1].instance if others else ""

    def _refused(self, name: str) -> Iterator[str]:
        """Commands refused recently, with the last reason for each agent.

        Sources: the owner's warnings, which are rate-limited, and `Owner` applied here.
        """
        for line in self.view.logs:
            card = self.view.cards.get(line.instance)
            owned = card is None or name in card.owns
            # An exchange causes refusals, too; the owner reports these below the level of warnings.
            warned = line.log.event == LogEvent.COMMANDS_REFUSED and line.log.level >= WARNING
            if owned and warned and self.now - line.at <= REPORT_S:
                yield line.log.text
        newest = {}
        for at, command, verdict in self._commands:
            if command.resource == name and self.now - at <= REFUSED_S:
                newest[command.ballot.instance] = verdict
        fine = {Verdict.OBEYED, Verdict.RELEASED, *EXPECTED_REFUSALS}
        for instance, verdict in newest.items():
            if verdict not in fine:
                yield f"commands refused: {agent_of(instance)}: {verdict}"

    def _moment(self, of: _Snapshot) -> Moment:
        cycle = None if of.state is None else of.state.cycle
        contests = tuple(
            replace(each, bids=self._biddings(each.resource, cycle, of)) for each in of.contests
        )
        number = None if cycle is None else cycle.number
        at = "" if number is None else f", cycle {number}"
        sentences = [f"At {of.t:.2f} s{at}:", *of.sentences]
        for each in contests:
            sentences += describe_contest(each)
        cause = of.cause
        if cause is None and contests:
            cause = outbid(contests[0])
        return Moment(of.t, number, of.stands, contests, tuple(sentences), cause)

    def _biddings(self, name: str, cycle: Cycle | None, of: _Snapshot) -> tuple[Bidding, ...]:
        found = []
        for instance, host in of.contenders.get(name, ()):
            bid = Bidding(agent_of(instance), instance, host)
            if (record := self._record(instance, name, cycle, of.t)) is not None:
                bid = replace(
                    bid,
                    cycle=record.cycle.number,
                    utility=record.utility,
                    critical=record.critical,
                    wanted=_numbers(record.wanted),
                    reason=record.reason,
                    inputs=tuple(_inputs(record, of.newest, cycle)),
                )
            found.append(bid)
        return tuple(found)

    def _record(self, instance: str, name: str, cycle: Cycle | None, t: float) -> BidRecord | None:
        """The instance's newest bid for a cycle or at most `AGO` cycles before it."""
        kept = self._records.get((instance, name), ())
        resource = declared(name)
        if resource is not None and resource.period_s is not None:
            ack = self.view.acks.get(name)  # the resource has its own cycles
            back = 0 if ack is None else int((self.now - self._begun - t) / resource.period_s)
            cycle = None if ack is None else Cycle(ack.cycle.epoch, max(0, ack.cycle.number - back))
        if cycle is None:
            return None
        fit = _answering(kept, cycle) or _answering(
            self._recomputed.get((instance, name), ()), cycle
        )
        return max(fit, key=lambda bid: bid.cycle.number, default=None)

    # An exchange ---------------------------------------------------------------------------------

    def _exchange(self, of: _Takeover) -> Exchange:
        ack, resource = of.ack, of.ack.resource
        ballot = ack.obeyed
        assert ballot is not None, "an exchange has a new ballot"
        cycle = ack.obeyed_cycle or ack.cycle
        bids = self._biddings(resource, cycle, of.snapshot)
        loser, winner = agent_of(of.lost), agent_of(of.winner)
        cause = self._how(of, bids)
        critical = ", critical" if ballot.critical else ""
        sentences = [
            f"At {of.t:.2f} s, cycle {cycle.number}: {winner} took {resource} over from {loser}.",
            f"{winner}'s ballot: term {ballot.term}, utility {ballot.utility:.2f}{critical}.",
            cause.what,
        ]
        sentences += [describe_bid(each) for each in bids]
        if of.blended:
            sentences.append(f"Its action was blended with {loser}'s for {of.blended} cycles.")
        history = self._of(resource)
        history.exchanges += 1
        return Exchange(
            history.exchanges,
            of.t,
            cycle.number,
            resource,
            of.lost,
            of.winner,
            of.blended,
            tuple(sentences),
            cause,
            bids,
        )

    def _how(self, of: _Takeover, bids: tuple[Bidding, ...]) -> Finding:
        """Why the loser lost or released the resource."""
        loser, winner = agent_of(of.lost), agent_of(of.winner)
        ballot, last = of.ack.obeyed, of.loser
        assert ballot is not None, "an exchange has a new ballot"
        gone = self.view.gone.get(of.lost)
        if gone is not None and gone - self._begun - of.t <= GONE_S:
            what = f"{loser} was no longer alive: it was killed, it crashed, or its host failed."
            return cause(Sort.ABSENT, loser, what, f"see `armadico logs {loser}`")
        if last is None:
            return cause(Sort.UNKNOWN, loser, f"No claim of {loser} was received.")
        if last.utility is None:
            record = self._record(of.lost, of.ack.resource, last.cycle, of.t)
            why = f": {record.reason}" if record is not None and record.reason else ""
            ago = of.t + self._begun - of.claimed_at
            what = f"{loser} had released it {ago:.1f} s earlier{why}."
            return cause(Sort.RELEASED, loser, what)
        theirs = self._first(of)
        if theirs is not None and theirs[0] - of.claimed_at > SILENCE * self._clock.period:
            what = f"{loser} had published no claim for {theirs[0] - of.claimed_at:.2f} s."
            return cause(Sort.SILENT, loser, what, f"see `armadico logs {loser}`")
        bid = Bid(ballot.utility, (), ballot.critical)
        resource = declared(of.ack.resource)
        if not beats(bid, last, 0.0 if resource is None else resource.margin):
            what = f"{loser} still claimed it with {last.utility:.2f}, but was not obeyed."
            return cause(Sort.LINK, loser, what, f"check the network connection of {loser}")
        if ballot.critical and not last.critical:
            what = f"{winner}'s bid was critical (a collision was near), "
            what += f"{loser}'s bid of {last.utility:.2f} was not."
        else:
            what = f"{winner}'s bid of {ballot.utility:.2f} beat {loser}'s {last.utility:.2f}."
        why = next((each.reason for each in bids if each.instance == of.winner), "")
        return cause(Sort.OUTBID, winner, what + (f" {winner}: {why}." if why else ""))

    def _first(self, of: _Takeover) -> tuple[float, Claim] | None:
        claims = self._of(of.ack.resource).claims
        return next(((at, c) for at, c in claims if c.ballot == of.ack.obeyed), None)

    # A stop --------------------------------------------------------------------------------------

    def _press(self, of: _Pressed) -> Press:
        by = of.stop.requester
        when = "Before the observation began," if of.before else f"At {of.t:.2f} s"
        found = [f"{when} {by} latched the stop."]
        if of.before:
            found.append("The time until the robot stood is not known.")
        elif of.stood is None:
            found.append("The robot was not observed to come to rest.")
        else:
            found.append(f"The robot stood {of.stood:.1f} s later.")
        if of.released is not None:
            sender = f" by {of.released_by}" if of.released_by else ""
            found.append(f"It was released{sender} at {of.released:.2f} s.")
        elif anew := next((each for each in self._pressed if each.number > of.number), None):
            found.append(
                f"{anew.stop.requester} latched another stop at {anew.t:.2f} s before a release."
            )
        else:
            found.append("It has not been released.")
        latched = cause(Sort.STOP, by, found[0], release(of.stop))
        stood = None if of.before else of.stood
        return Press(of.number, of.t, by, stood, of.released, of.released_by, tuple(found), latched)

    # A collision ---------------------------------------------------------------------------------

    def _struck_by(self, *, bumped: bool) -> Finding:
        """The cause of a collision, from the state just before it."""
        view = self.view
        if bumped:
            return cause(Sort.BUMPED, "", "A person walked into the robot.")
        driver = view.lead(WHEELS.name, self.now) or view.last_driver(WHEELS.name)
        name = agent_of(driver) if driver else "no agent"
        found = [o for o in view.newest.values() if isinstance(o, Obstacles)]
        if not found:
            return cause(Sort.UNSEEN, "", "No agent had published obstacles.")
        for each in found:
            age = _age(each.cycle, None if view.state is None else view.state.cycle)
            if age is None or age > FRESH_CYCLES:
                old = "many" if age is None else age
                what = f"The obstacles published by {each.sensor} were {old} cycles old."
                return cause(Sort.STALE, each.sensor, what)
        near = self._nearest(found)
        if near is None or near > NEAR_M:
            far = "no obstacle" if near is None else f"no obstacle nearer than {near:.2f} m"
            sensors = " and ".join(sorted({each.sensor for each in found}))
            what = f"The obstacle was not detected: {sensors} reported {far}."
            return cause(Sort.UNSEEN, sensors, what)
        what = f"The obstacle was detected, {max(near, 0.0):.2f} m from the footprint, "
        what += f"and {name} drove."
        return cause(Sort.DRIVEN, name, what, f"check {name}'s bids before the collision")

    def _nearest(self, found: list[Obstacles]) -> float | None:
        """Distance from the robot's footprint to the nearest obstacle point, m."""
        description = self.view.description
        if description is None:
            return None
        outline = Body.of(description).outline
        away = [outline.clearance(p.x, p.y) for each in found for p in each.points]
        return min(away, default=None)


def _keep(kept: list[T], one: T) -> None:
    kept.append(one)
    del kept[:-MOST]


def _answering(bids: Iterable[BidRecord], cycle: Cycle) -> list[BidRecord]:
    """The bids for a cycle or at most `AGO` cycles before it."""
    return [
        bid
        for bid in bids
        if bid.cycle.epoch == cycle.epoch and 0 <= cycle.number - bid.cycle.number <= AGO
    ]


def _inputs(bid: BidRecord, newest: dict[str, Message], cycle: Cycle | None) -> Iterator[Input]:
    for pattern in bid.inputs:
        for key, message in newest.items():
            if matches(pattern, key):
                at = getattr(message, "cycle", None)
                yield Input(key, _age(at, cycle), _summary(message))


def _summary(message: Message) -> str:
    match message:
        case Pose():
            place = f"({message.x:.2f}, {message.y:.2f}, {degrees(message.theta):.0f} deg)"
            return f"{place} +-{message.deviation:.2f} m" if message.covariance else place
        case Obstacles():
            near = message.closest
            if near is None:
                return "nothing near"
            return f"nearest {hypot(near.x, near.y):.2f} m away, {len(message.points)} points"
        case RobotState():
            return f"{message.v:.2f} m/s, {message.w:.2f} rad/s"
    return type(message).__name__


def _age(at: Cycle | None, cycle: Cycle | None) -> int | None:
    if at is None or cycle is None or at.epoch != cycle.epoch:
        return None
    return cycle.number - at.number


def _numbers(action: Action) -> tuple[float, ...]:
    return () if isinstance(action, bytes) else action
