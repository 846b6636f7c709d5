"""Why a society did what it did: moments, exchanges, stops and collisions, explained (sans-IO).

A `Chronicle` is shown what a watcher hears, live or of a recording, in order and with its times. It
keeps the last seconds, and explains a moment when it is over: losers publish nothing, so what they
would have done comes only when they are asked, about a second later. Each answer is a struct, its
sentences and the cause where the reasons end (`armadico.observe.standing`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import degrees, hypot
from typing import Final, TypeVar

from msgspec.structs import replace

from armadico.core.agent import AT_WORK, REPORT_S
from armadico.core.coordination import SILENCE, Owner, Verdict, beats
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.hands import release
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
from armadico.core.resources import WHEELS, declared
from armadico.core.services import matches
from armadico.mobile.messages import MissionState, Pose, Truth
from armadico.mobile.motion import Body
from armadico.mobile.obstacles import Obstacles
from armadico.observe.explained import (
    Bidding,
    Collision,
    Contest,
    Exchange,
    Input,
    Moment,
    Press,
    bid_told,
    contest_told,
    outbid,
)
from armadico.observe.standing import NO_TABLE, Cause, Hosts, Installed, Sort, standing
from armadico.observe.view import FRESH_CYCLES, RESTS, View, agent_of

T = TypeVar("T")

LATER_S: Final = 1.6
"""Bids of a moment are known so much later: everybody is asked once a second."""

KEPT_CYCLES: Final = 200
"""Bids, claims and commands of so many cycles are kept: of more than `LATER_S`, and of a holder
that let go and that nobody took over from for a while."""

MOST: Final = 10_000
"""Exchanges, stops, collisions and moments that are kept, the last ones."""

AGO: Final = FRESH_CYCLES
"""A contender whose newest bid is more cycles older than a moment had no turn then."""

NEAR_M: Final = 0.1
"""What is known so near to the outline was known to be in the way."""

GONE_S: Final = 1.0
"""A recording of a virtual run has tokens so much late."""

REFUSED_S: Final = 1.0
"""Refusals of so long before a moment are told."""


@dataclass
class _Pressed:
    number: int
    t: float
    stop: Stop
    before: bool  # the robot was heard
    stood: float | None = None
    released: float | None = None
    released_by: str = ""


@dataclass
class _Snapshot:
    """What was known at a time, until the bids of then are."""

    t: float
    state: RobotState | None
    said: tuple[str, ...]  # of the robot
    stands: bool
    cause: Cause | None
    contests: list[Contest]
    contenders: dict[str, list[tuple[str, str]]]  # by resource: instance and host
    newest: dict[str, Message]


@dataclass
class _Taken:
    """An exchange, until it is over and the bids of then are known."""

    t: float
    ack: Ack
    loser: Claim | None
    lost: str
    winner: str
    heard: float  # when the loser last claimed, s
    snapshot: _Snapshot
    blended: int = 0


@dataclass
class _History:
    """What was received about one resource, the last `KEPT_CYCLES` of it."""

    owner: Owner | None  # judges as its owner does; None: it has cycles of its own
    obeyed: str = ""  # the instance that was obeyed last
    exchanges: int = 0
    claims: deque[tuple[float, Claim]] = field(default_factory=lambda: deque(maxlen=KEPT_CYCLES))


@dataclass
class _Touch:
    """What the robot has touched so far."""

    collisions: int = 0  # by the truth
    bumped: int = 0  # of those, how often somebody walked into it
    felt: bool = False  # by the robot's own report, now


_Pending = _Snapshot | _Taken | tuple[_Snapshot, Cause, str]
"""What is explained later; the tuple is a collision."""


class Chronicle:
    """Takes what a watcher hears, in order; times are s by one clock."""

    def __init__(
        self,
        recomputed: Mapping[tuple[str, str], Sequence[BidRecord]] | None = None,
        *,
        installed: Installed = lambda _: (),
        hosts: Hosts = NO_TABLE,
        begun: float = 0.0,
    ) -> None:
        """Nothing was heard yet.

        Args:
            recomputed: Bids that nobody was asked for in time, by instance and resource, oldest
                first, if journals were gone through again for them.
            installed: As `standing` takes it.
            hosts: As `standing` takes it.
            begun: When it is shown the first, s: what is told of times counts from then.
        """
        self.installed, self.hosts, self._begun = installed, hosts, begun
        self.view = View()
        self.now = 0.0
        self._recomputed = recomputed or {}
        self.exchanges: list[Exchange] = []
        self.collisions: list[Collision] = []
        self.moments: list[Moment] = []
        self._pressed: list[_Pressed] = []
        self._records: dict[tuple[str, str], deque[BidRecord]] = {}
        self._history: dict[str, _History] = {}  # by resource
        self._commands: deque[tuple[float, Command, str]] = deque(maxlen=4 * KEPT_CYCLES)
        self._clock = CycleClock()
        self._pending: deque[_Pending] = deque()
        self._touch = _Touch()

    # What comes in -------------------------------------------------------------------------------

    def token(self, instance: str, *, there: bool, t: float) -> None:
        """A liveliness token came or went."""
        self._pass(t)
        self.view.token(instance, there=there, t=t)

    def update(self, key: str, message: Message | None, t: float) -> None:
        """Something was published on a key; None: it cannot be read."""
        self._pass(t)
        unheard, truth = self.view.state is None, self.view.truth
        self.view.update(key, message, t)
        match message:
            case RobotState():
                self._take_state(message, t, first=unheard)
            case Truth() if self.view.truth is message:
                self._take_truth(message, begun=truth is not None)
            case Stop():
                self._take_stop(message, t, before=unheard)
            case Claim():
                self._take_claim(message, t)
            case Command():
                self._take_command(message, t)
            case Ack():
                self._take_ack(message, t)

    def learn(self, message: Message, t: float) -> None:
        """Somebody answered, or a recording has what it answered."""
        self._pass(t)
        self.view.learn(message, t)
        if isinstance(message, BidHistory):
            for bid in message.bids:
                kept = self._records.setdefault(
                    (message.instance, bid.resource), deque(maxlen=KEPT_CYCLES)
                )
                if bid not in kept:
                    kept.append(bid)

    def mark(self, t: float) -> None:
        """Explain a moment, now, once its bids are known; it comes into `moments`."""
        self.now = t
        self._pending.append(self._snapshot())

    def finish(self) -> None:
        """There is nothing more to come."""
        while self._pending:
            self._explain(self._pending.popleft())

    @property
    def presses(self) -> list[Press]:
        return [self._press(pressed) for pressed in self._pressed]

    # Inside --------------------------------------------------------------------------------------

    def _pass(self, t: float) -> None:
        self.now = t
        while self._pending and self._at(self._pending[0]) + LATER_S <= t - self._begun:
            self._explain(self._pending.popleft())

    @staticmethod
    def _at(what: _Pending) -> float:
        return what[0].t if isinstance(what, tuple) else what.t

    def _explain(self, what: _Pending) -> None:
        if isinstance(what, _Snapshot):
            _keep(self.moments, self._moment(what))
        elif isinstance(what, _Taken):
            _keep(self.exchanges, self._exchange(what))
        else:
            snapshot, cause, text = what
            moment = self._moment(snapshot)
            number = self.collisions[-1].number + 1 if self.collisions else 1
            said = (text, *moment.sentences, cause.what)
            collision = Collision(number, snapshot.t, said, cause, moment)
            _keep(self.collisions, collision)

    def _take_state(self, state: RobotState, t: float, *, first: bool) -> None:
        self._clock.advance(state.cycle, t)
        if state.stop.stopped:
            self._take_stop(state.stop, t, before=first)
        for pressed in self._pressed[-1:]:
            if (
                pressed.stood is None
                and max(abs(state.v), abs(state.w)) <= RESTS
                and state.stop.stopped
            ):
                pressed.stood = t - self._begun - pressed.t
        felt = state.touch is not None or state.stalled
        if felt and not self._touch.felt and self.view.truth is None:
            self._collide("It touches something, by its own word.", bumped=False)
        self._touch.felt = felt

    def _take_truth(self, truth: Truth, *, begun: bool) -> None:
        touch = self._touch
        if begun and truth.collisions > touch.collisions:
            bumped = truth.bumped > touch.bumped
            what = "Somebody walks into it." if bumped else "It touches something."
            self._collide(what, bumped=bumped)
        touch.collisions, touch.bumped = truth.collisions, truth.bumped

    def _take_stop(self, stop: Stop, t: float, *, before: bool) -> None:
        # A state that was on its way may still show the press before.
        known = next((each for each in self._pressed if each.stop.press == stop.press), None)
        if known is None and stop.stopped:
            number = self._pressed[-1].number + 1 if self._pressed else 1
            _keep(self._pressed, _Pressed(number, t - self._begun, stop, before))
        elif known is not None and not stop.stopped and known.released is None:
            known.released, known.released_by = t - self._begun, stop.by

    def _take_claim(self, claim: Claim, t: float) -> None:
        history = self._of(claim.resource)
        history.claims.append((t, claim))
        if history.owner is not None:
            history.owner.on_claim(claim)
        for each in self._pending:
            if (
                isinstance(each, _Taken)
                and claim.ballot == each.ack.obeyed
                and claim.commanded != claim.wanted
            ):
                each.blended += 1

    def _take_command(self, command: Command, t: float) -> None:
        owner = self._of(command.resource).owner
        if owner is not None:
            verdict = owner.judge(command, t, stopped=self._stops(command.resource))
            self._commands.append((t, command, str(verdict)))

    def _stops(self, name: str) -> bool:
        resource = declared(name)
        return resource is not None and resource.stops and self.view.stop.stopped

    def _of(self, name: str) -> _History:
        """What was received about a resource; it is judged if its cycles are the robot's."""
        if name not in self._history:
            resource = declared(name)
            robots = resource is not None and resource.period_s is None
            owner = Owner(resource, self._clock) if resource is not None and robots else None
            self._history[name] = _History(owner)
        return self._history[name]

    def _take_ack(self, ack: Ack, t: float) -> None:
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
        taken = _Taken(since, ack, last, before, driver, at, self._snapshot(), blended)
        self._pending.append(taken)

    def _collide(self, what: str, *, bumped: bool) -> None:
        self._pending.append((self._snapshot(), self._struck_by(bumped=bumped), what))

    # A moment ------------------------------------------------------------------------------------

    def _snapshot(self) -> _Snapshot:
        view, now = self.view, self.now
        found = standing(view, now, self.installed, self.hosts)
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
            yield f"Its goal is {mission.to_go:.1f} m away{note}."

    def _contest(self, name: str) -> Contest:
        view, now = self.view, self.now
        claim, ack = view.claim(name, now), view.acks.get(name)
        obeyed = view.driver(name, now) or ""
        blended = claim is not None and claim.commanded != claim.wanted
        return Contest(
            resource=name,
            holder="" if claim is None else claim.ballot.instance,
            term=None if claim is None else claim.ballot.term,
            utility=None if claim is None else claim.utility,
            critical=claim is not None and claim.critical,
            wanted=() if claim is None else _numbers(claim.wanted),
            commanded=() if claim is None else _numbers(claim.commanded),
            loser=self._loser(name, claim) if blended and claim is not None else "",
            obeyed=obeyed,
            measured=() if ack is None else _numbers(ack.measured),
            refused=tuple(self._refused(name)),
            bids=(),
        )

    def _loser(self, name: str, claim: Claim) -> str:
        others = [c.ballot for _, c in self._of(name).claims if c.ballot < claim.ballot]
        return others[-1].instance if others else ""

    def _refused(self, name: str) -> Iterator[str]:
        """Which commands were refused of late, and why; of each agent its last reason.

        By a judge as its owner's, and by the owner's own word, which is told now and then.
        """
        for said in self.view.logs:
            if self.now - said.at <= REPORT_S and said.log.event == LogEvent.COMMANDS_REFUSED:
                yield said.log.text
        newest = {}
        for at, command, verdict in self._commands:
            if command.resource == name and self.now - at <= REFUSED_S:
                newest[command.ballot.instance] = verdict
        fine = {Verdict.OBEYED, Verdict.RELEASED, *AT_WORK}
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
        said = [f"At {of.t:.2f} s{at}:", *of.said]
        for each in contests:
            said += contest_told(each)
        cause = of.cause
        if cause is None and contests:
            cause = outbid(contests[0])
        return Moment(of.t, number, of.stands, contests, tuple(said), cause)

    def _biddings(self, name: str, cycle: Cycle | None, of: _Snapshot) -> tuple[Bidding, ...]:
        found = []
        for instance, host in of.contenders.get(name, ()):
            record = self._record(instance, name, cycle, of.t)
            inputs = () if record is None else tuple(_inputs(record, of.newest, cycle))
            found.append(
                Bidding(agent_of(instance), instance, host, None, None)
                if record is None
                else Bidding(
                    agent_of(instance),
                    instance,
                    host,
                    record.cycle.number,
                    record.utility,
                    record.critical,
                    _numbers(record.wanted),
                    record.reason,
                    inputs,
                )
            )
        return tuple(found)

    def _record(self, instance: str, name: str, cycle: Cycle | None, t: float) -> BidRecord | None:
        """Its newest bid that answers a cycle, or one shortly before."""
        kept = self._records.get((instance, name), ())
        resource = declared(name)
        if resource is not None and resource.period_s is not None:
            ack = self.view.acks.get(name)  # a resource with cycles of its own: those of then
            back = 0 if ack is None else int((self.now - self._begun - t) / resource.period_s)
            cycle = None if ack is None else Cycle(ack.cycle.epoch, max(0, ack.cycle.number - back))
        if cycle is None:
            return None
        fit = _answering(kept, cycle) or _answering(
            self._recomputed.get((instance, name), ()), cycle
        )
        return max(fit, key=lambda bid: bid.cycle.number, default=None)

    # An exchange ---------------------------------------------------------------------------------

    def _exchange(self, of: _Taken) -> Exchange:
        ack, resource = of.ack, of.ack.resource
        ballot = ack.obeyed
        assert ballot is not None, "somebody is obeyed"
        cycle = ack.obeyed_cycle or ack.cycle
        bids = self._biddings(resource, cycle, of.snapshot)
        loser, winner = agent_of(of.lost), agent_of(of.winner)
        cause = self._how(of, bids)
        critical = ", critical" if ballot.critical else ""
        said = [
            f"At {of.t:.2f} s, cycle {cycle.number}: {winner} took {resource} over from {loser}.",
            f"{winner} cast term {ballot.term} with {ballot.utility:.2f}{critical}.",
            cause.what,
        ]
        said += [bid_told(each) for each in bids]
        if of.blended:
            said.append(f"Its action was blended with {loser}'s for {of.blended} cycles.")
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
            tuple(said),
            cause,
            bids,
        )

    def _how(self, of: _Taken, bids: tuple[Bidding, ...]) -> Cause:
        """Why the one let go of it, or was beaten."""
        loser, winner, ballot, last = (
            agent_of(of.lost),
            agent_of(of.winner),
            of.ack.obeyed,
            of.loser,
        )
        assert ballot is not None, "somebody is obeyed"
        gone = self.view.gone.get(of.lost)
        if (
            gone is not None and gone - self._begun - of.t <= GONE_S
        ):  # tokens may be looked at once a second
            what = f"{loser} was gone: killed, crashed, or with its host."
            return Cause(Sort.ABSENT, loser, what, f"`armadico logs {loser}` has its last words")
        if last is None:
            return Cause(Sort.UNKNOWN, loser, f"Nothing was heard of {loser}.")
        if last.utility is None:
            record = self._record(of.lost, of.ack.resource, last.cycle, of.t)
            why = f": {record.reason}" if record is not None and record.reason else ""
            ago = of.t + self._begun - of.heard
            what = f"{loser} had released it {ago:.1f} s before{why}."
            return Cause(Sort.RELEASED, loser, what)
        theirs = self._first(of)
        if theirs is not None and theirs[0] - of.heard > SILENCE * self._clock.period:
            what = f"{loser} had been silent for {theirs[0] - of.heard:.2f} s."
            return Cause(Sort.SILENT, loser, what, f"`armadico logs {loser}`")
        bid = Bid(ballot.utility, (), ballot.critical)
        resource = declared(of.ack.resource)
        if not beats(bid, last, 0.0 if resource is None else resource.margin):
            what = f"{loser} still claimed it with {last.utility:.2f}, and was not obeyed."
            return Cause(Sort.LINK, loser, what, "look at the network around it")
        if ballot.critical and not last.critical:
            what = f"{winner} was about to touch something, {loser} ({last.utility:.2f}) was not."
        else:
            what = f"{winner}'s {ballot.utility:.2f} beat {loser}'s {last.utility:.2f}."
        why = next((each.reason for each in bids if each.instance == of.winner), "")
        return Cause(Sort.OUTBID, winner, what + (f" {winner}: {why}." if why else ""))

    def _first(self, of: _Taken) -> tuple[float, Claim] | None:
        claims = self._of(of.ack.resource).claims
        return next(((at, c) for at, c in claims if c.ballot == of.ack.obeyed), None)

    # A stop --------------------------------------------------------------------------------------

    def _press(self, of: _Pressed) -> Press:
        by = of.stop.who
        when = "Before it was listened" if of.before else f"At {of.t:.2f} s"
        said = [f"{when} {by} latched the stop."]
        if of.before:
            said.append("How soon the robot stood then nobody heard.")
        elif of.stood is None:
            said.append("The robot is not known to have stood.")
        else:
            said.append(f"The robot stood {of.stood:.1f} s later.")
        if of.released is not None:
            said.append(f"{of.released_by or 'Somebody'} released it at {of.released:.2f} s.")
        elif anew := next((each for each in self._pressed if each.number > of.number), None):
            who = anew.stop.who
            said.append(f"Before it was released {who} latched another at {anew.t:.2f} s.")
        else:
            said.append("Nobody has released it.")
        cause = Cause(Sort.STOP, by, said[0], release(of.stop))
        stood = None if of.before else of.stood
        return Press(of.number, of.t, by, stood, of.released, of.released_by, tuple(said), cause)

    # A collision ---------------------------------------------------------------------------------

    def _struck_by(self, *, bumped: bool) -> Cause:
        """What led to it, as far as it was known just before."""
        view = self.view
        if bumped:
            return Cause(Sort.BUMPED, "", "Somebody walked into it, however it drove.")
        driver = view.driver(WHEELS.name, self.now) or view.last_driver(WHEELS.name)
        name = agent_of(driver) if driver else "nobody"
        found = [o for o in view.newest.values() if isinstance(o, Obstacles)]
        if not found:
            return Cause(Sort.UNSEEN, "", "No obstacles were known at all.")
        for each in found:
            age = _age(each.cycle, None if view.state is None else view.state.cycle)
            if age is None or age > FRESH_CYCLES:
                what = (
                    f"What {each.sensor} knew was {age if age is not None else 'many'} cycles old."
                )
                return Cause(Sort.STALE, each.sensor, what)
        near = self._nearest(found)
        if near is None or near > NEAR_M:
            far = "nothing at all" if near is None else f"nothing nearer than {near:.2f} m"
            sensors = " and ".join(sorted({each.sensor for each in found}))
            what = f"It was not known to be there: {sensors} knew of {far}."
            return Cause(Sort.UNSEEN, sensors, what)
        what = f"It was known, {max(near, 0.0):.2f} m from the outline, and {name} drove."
        return Cause(Sort.DRIVEN, name, what, f"look at {name}'s bids before it")

    def _nearest(self, found: list[Obstacles]) -> float | None:
        """From the robot's outline to the nearest that was known, m."""
        said = self.view.description
        if said is None:
            return None
        outline = Body.of(said).outline
        away = [outline.clearance(p.x, p.y) for each in found for p in each.points]
        return min(away, default=None)


def _keep(kept: list[T], one: T) -> None:
    kept.append(one)
    del kept[:-MOST]


def _answering(bids: Iterable[BidRecord], cycle: Cycle) -> list[BidRecord]:
    """Those that answer a cycle, or one shortly before."""
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
    """A state in half a line."""
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
