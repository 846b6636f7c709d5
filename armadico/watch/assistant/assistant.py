"""The assistant agent: executes requests of programs and language models, with least authority."""

from __future__ import annotations

import dataclasses
import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import radians
from typing import Any, ClassVar, Final

import msgspec
from msgspec.structs import replace

from armadico.agents.interface.messages import MissionCancel, MissionOrder
from armadico.config.errands import Mission, load_mission
from armadico.config.loading import convert
from armadico.config.shipped import names
from armadico.core import agent
from armadico.core.agent import ERROR, WARNING, Question
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Description, Message, RobotState, line, next_count
from armadico.mesh.sources import Rations
from armadico.mobile.errand import Order
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    Terms,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.watch.assistant.goals import BY, LONGEST_BY, by_name, client_in
from armadico.watch.assistant.keeper import Keeper, Parameters
from armadico.watch.assistant.messages import (
    Against,
    AssistantRecord,
    AssistantReply,
    AssistantRequest,
    known_as,
)
from armadico.watch.assistant.policy import approvals
from armadico.watch.assistant.policy.ledger import ALWAYS, FORGOTTEN
from armadico.watch.assistant.policy.messages import (
    Answered,
    ApprovalAnswer,
    Approvals,
    Choice,
    Ledger,
)
from armadico.watch.assistant.policy.policy import NO_POLICY, Rules
from armadico.watch.assistant.tools import (
    REHEARSE,
    TOOLS,
    Because,
    Goal,
    Named,
    Numbered,
    Polled,
    Tool,
    Trial,
)

LOOK_S: Final = 1.0  # the period of what does not wait for a message

HOUR_S: Final = 3600.0

APPROVAL: Final = "approval"
"""What a server asks instead of a tool: what has become of a request that waits for a person."""

UNPROVED: Final = (
    "this society has no keys: clients are known by the names that they announce, which is no proof"
)

TAKEN_BACK: Final = "taken back by its client"

BUSY: Final = "one request is being answered; ask again later"

NOBODY: Final = "no agent that takes missions has answered"

LOST: Final = f"{NOBODY}: it may still begin, and is cancelled then"

TELL_S: Final = 3.0
"""A person who approves a request is told what becomes of it, at the latest after so long."""

Deliver = Callable[[AssistantReply], None]
"""Gives the outcome of a request to its client."""


@dataclass(frozen=True)
class _Drive:
    """A request that sets the robot in motion, on its way through the rules."""

    request: AssistantRequest
    rules: Rules
    deliver: Deliver
    goal: Waypoint | None  # None: a mission
    mission: Mission | None = None  # None: a goal
    approved: approvals.Waiting | None = None  # by a person
    rooms: tuple[str, ...] = ()  # on its way, that need approval and have it
    rehearsed: AssistantRequest | None = None  # what it would be as an order; None: it is one

    @property
    def wanted(self) -> AssistantRequest:
        """The order that is judged, also if it is only rehearsed."""
        return self.rehearsed or self.request

    @property
    def only_asked(self) -> bool:
        """Whether it is rehearsed: it is judged, and nothing is begun."""
        return self.rehearsed is not None


@dataclass(frozen=True)
class _Told:
    """A person who has approved a request, and is to be told what became of it."""

    waiting: approvals.Waiting
    question: Question
    text: str  # what it begins with
    at: float  # s


class Assistant(Keeper):
    """Publishes a record of each request of a program, and executes the permitted ones.

    It owns no resource and competes for none: it publishes no command, bid or ballot. It sends the
    same queries as the operator's commands do, at the lowest priority: a goal does not replace a
    goal of others, and a mission waits for all others. It may stop the robot. Only people release
    a stop; the agent replies with the code that they must type.

    A policy (`armadico.watch.assistant.policy`) limits further what each client may do. This agent
    judges the request; `Keeper` watches the robot while it drives for a client.
    """

    name = "assistant"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (
        *(RobotState, Description, Pose, Obstacles),
        *(Trajectory, MissionStatus, Ledger, Approvals),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (AssistantRecord, Approvals, Ledger)
    answers: ClassVar[tuple[type[Message], ...]] = (AssistantRequest, ApprovalAnswer)
    queries: ClassVar[tuple[type[Message], ...]] = (
        *(MissionRequest, MissionOrder, MissionCancel),
        PlanRequest,
    )
    launched_with = ("world",)

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._rations = Rations(self.p.a_second, self.p.at_once)
        """Of requests, by identity; without keys all have one, since a name proves nothing."""
        self._number = self._left_out = 0
        self._cancels: set[int] = set()  # the missions that clients are cancelling
        self._waits: _Drive | None = None  # for the reply to a query; one at a time
        self._rehearsed: _Drive | None = None
        """Its path is planned. It is apart, so that a rehearsal keeps no order waiting."""
        self._passed_on = False  # whether a mission agent has it, and it cannot be taken back
        self._after: Callable[[int | None], None] | None = None
        """It is taken back: called with the number of the mission that it has led to, or 0; None:
        nobody has answered."""
        self._tools: dict[str, Callable[[AssistantRequest, Any, Question], AssistantReply | None]]
        self._tools = {
            "goto": self._goto,
            "mission": self._order,
            "cancel": self._cancel,
            "stop": self._stop,
            "resume": self._resume,
            REHEARSE.name: self._foretell,
        }
        self._taken: dict[str, deque[float]] = {}  # when goals were taken, s, by section
        self._ready: deque[_Drive] = deque()  # to begin: approved, or the robot is not known yet
        self._told: list[_Told] = []  # who has approved something, and waits for what becomes of it

    def on_start(self) -> None:
        self._started = self.now
        if (known := self.memory.newest(Ledger)) is not None:  # before this adds to the log
            self.on_ledger(known)
        if self._fault:
            self.log(line(self._fault), ERROR)
        self._book.write("started", by=self.instance, why=self.p.policy or "no policy")
        if self.p.policy and self.identity.rights is None:
            self.log(UNPROVED, WARNING)
        self.on_wakeup()

    def on_wakeup(self) -> None:
        """End approvals that are over; look at the clock; publish what waits for people."""
        self.wake_at(self.now + LOOK_S)
        self._begin_next()
        self._tell()
        for ended in self._approvals.expire(self.now):
            self._book.write_of(ended.request, "not approved", ended.over)
        self._look_at_clock()
        waiting = tuple(each.shown(self.now) for each in self._approvals.waiting)
        policy = f"the policy is {self.p.policy}" if self.p.policy else ""
        self.publish(Approvals(waiting, line(self._fault or policy)))
        self._book.publish()

    # Requests ------------------------------------------------------------------------------------

    def on_assistant_request(
        self, request: AssistantRequest, question: Question
    ) -> AssistantReply | None:
        """Execute the request, or refuse it with the reason.

        A stop ignores the rate limit, and so does the cancellation of what the client wants.
        With keys a client is known by its identity. What it calls itself is only shown.
        """
        if question.asker:
            request = replace(request, by=question.asker, called=request.by)
        if request.tool == APPROVAL:
            return self._poll(request)
        within = self._rations.take(question.asker, self.now)
        if not (within or request.tool == "stop" or self._ends_own(request)):
            self._left_out = next_count(self._left_out)
            often = f"{self.p.a_second:g} a second, after {self.p.at_once:g} at once"
            return AssistantReply(refusal=f"too many requests: {often}; ask again later")
        reply = self._answer(request, question)
        if reply is not None and within:
            self._note(request, reply)
        elif reply is not None:
            self._left_out = next_count(self._left_out)
        return reply

    def _ends_own(self, request: AssistantRequest) -> bool:
        """Whether a request cancels something of its client's that no one cancels yet."""
        if request.tool != "cancel":
            return False
        try:
            number = int(msgspec.json.decode(request.text, type=Numbered).number or "0")
        except msgspec.DecodeError:
            return False
        driven = self._goals.driven_for(request)
        if driven not in (0, *self._cancels) and number in (0, driven):
            return True
        wants = [each.request.by for each in self._ready if not each.only_asked]
        wants += [each.request.by for each in self._approvals.waiting]
        wants += [self._waits.request.by] if self._waits and self._after is None else []
        return not number and request.by in wants

    def _answer(self, request: AssistantRequest, question: Question) -> AssistantReply | None:
        tool = TOOLS.get(request.tool)
        if tool is None:
            return AssistantReply(refusal=f"no tool {request.tool!r}")
        try:
            args = msgspec.json.decode(request.text, type=tool.arguments)
        except msgspec.DecodeError as error:
            if tool.name != "stop":
                return AssistantReply(refusal=line(_wrong(tool, request.text, error)))
            args = Because()  # a stop is not refused for its arguments
        if tool.name != "stop":
            forbidden = self._fault or self._beside or self._rules(request).forbids(tool.name)
            if forbidden:
                return AssistantReply(refusal=line(forbidden))
        do = self._tools.get(tool.name)
        return AssistantReply() if do is None else do(request, args, question)

    def _note(self, request: AssistantRequest, reply: AssistantReply) -> None:
        self._number = next_count(self._number)
        self.publish(AssistantRecord(self._number, request, reply, self._left_out))
        left_out = f"; {self._left_out} more before it were too many" if self._left_out else ""
        self._left_out = 0
        done = "rehearsed" if request.tool == REHEARSE.name else "allowed"
        what = "refused" if reply.refusal else "waits" if reply.approval else done
        self._book.write_of(request, what, (reply.refusal or reply.text) + left_out, reply.mission)

    def on_ledger(self, ledger: Ledger) -> None:
        """Compare the log with what the others remember of it."""
        self._book.hear(ledger)

    # Approvals -----------------------------------------------------------------------------------

    def _poll(self, request: AssistantRequest) -> AssistantReply:
        """What has become of a request that waits for a person; the server asks each second."""
        try:
            asks = msgspec.json.decode(request.text, type=Polled)
        except msgspec.DecodeError as error:
            return AssistantReply(refusal=line(f"{APPROVAL}: {error}"))
        ended = self._approvals.leave(int(asks.number), request.by) if asks.gone else None
        if ended is not None:
            self._book.write_of(ended.request, "not approved", ended.over)
        return self._approvals.poll(int(asks.number), request.by, self.now)

    def on_approval_answer(self, answer: ApprovalAnswer, question: Question) -> Answered | None:
        """A person has answered: do the request, if it is the first answer and in time.

        The reply to a yes waits for what becomes of the request.
        """
        by = known_as(question.asker, answer.by)
        if answer.choice is Choice.FORGET:
            reply, go = self._approvals.forget(answer.code), False
        else:
            reply, go = self._approvals.answer(answer.code, answer.choice, by, self.now)
        what = f"{answer.choice} to {answer.code}: {reply.refusal or reply.text}"
        self._book.write("a person's answer", by=by, why=what)
        self.log(line(f"{by or 'a person'} answers {what}"))
        if answer.choice is Choice.FORGET:  # the log may have more of them than count now
            self._book.write(FORGOTTEN, by=by, text=answer.code)
        if not go:
            return reply
        waiting = self._approvals.of(answer.code)
        if answer.choice is Choice.ALWAYS:
            new = self._approvals.allow_always(waiting)
            self._book.write(ALWAYS, by=new.by, why=msgspec.json.encode(new).decode())
            reply = Answered(f"{reply.text}, and always for this place")
        self._told.append(_Told(waiting, question, reply.text, self.now))
        waiting.go(waiting)
        return None

    def _tell(self) -> None:
        """Tell those who have approved a request what became of it."""
        told, self._told = self._told, []
        for each in told:
            outcome = each.waiting.outcome
            if outcome is not None and outcome.refusal:
                reply = Answered(
                    refusal=line(f"{each.text}; but it is not done: {outcome.refusal}")
                )
            elif outcome is not None:
                reply = Answered(line(f"{each.text}; {outcome.text}"))
            elif self.now - each.at >= TELL_S:
                reply = Answered(line(f"{each.text}; it has not begun yet: its client is told"))
            else:
                self._told.append(each)
                continue
            self.answer(each.question, reply)

    def _ask_a_person(self, drive: _Drive, why: str) -> bool:
        """Let a request wait for a person; return whether it does, or is refused."""
        self._book.end_hearing()
        goal, request = drive.goal, drive.wanted
        waiting = approvals.Waiting(
            number=self.rng.getrandbits(63) or 1,
            request=request,
            section=drive.rules.name,
            place="" if goal is None else f"({goal.x:.2f}, {goal.y:.2f})",
            goal=None if goal is None else (goal.x, goal.y),
            why=why,
            rooms=drive.rooms,
            go=partial(self._approved, drive),
            at=self.now,
            seen_at=self.now,
        )
        if self._approvals.always(waiting):
            return False
        if drive.only_asked:
            text = line(f"a person would be asked first: {why}")
            self._finish(drive, AssistantReply(text, against=Against.ASKS))
            return True
        waiting.why = line(why + self._approvals.why_not(waiting))
        self._waits = None
        if refusal := self._approvals.add(waiting):
            self._finish(drive, AssistantReply(refusal=refusal))
        else:
            waits = self._approvals.poll(waiting.number, request.by, self.now)
            how = f"armadico approve yes {waiting.code}"
            self.log(line(f"{BY}: {request.asker} asks for {request.tool} {request.text}: `{how}`"))
            self._finish(drive, waits)
        return True

    def _approved(self, drive: _Drive, waiting: approvals.Waiting) -> None:
        """Do a request that a person has approved: all other rules count as they are now."""

        def deliver(outcome: AssistantReply) -> None:
            waiting.outcome = outcome
            self._tell()

        self._ready.append(dataclasses.replace(drive, deliver=deliver, approved=waiting))
        self._begin_next()

    def _begin_next(self) -> None:
        """Begin the next request that waits, once none is being answered and it can be judged."""
        if not self._ready or (self._waits and not self._ready[0].only_asked):
            return
        if not self._learns_for(self._ready[0]):
            self._begin(self._ready.popleft())

    # Tools ---------------------------------------------------------------------------------------

    def _stop(self, request: AssistantRequest, args: Because, question: Question) -> AssistantReply:  # noqa: ARG002
        before = self.stopped
        if before is not None:
            return AssistantReply(text=line(f"it is stopped already, by {before.requester}"))
        self.latch(
            line(f"{by_name(request)}{f', {args.reason}' if args.reason else ''}")[:LONGEST_BY]
        )
        return AssistantReply(text="the stop is published; `where` says when the robot has it")

    def _resume(
        self,
        request: AssistantRequest,
        args: Because,
        question: Question,  # noqa: ARG002
    ) -> AssistantReply:
        stop = self.stopped
        if stop is None:
            return AssistantReply(text="the robot is not stopped")
        how = f"armadico resume --confirm {stop.code}"
        because = f", because {args.reason}" if args.reason else ""
        asks = f"{by_name(request)} asks for the release of the stop by {stop.requester}{because}"
        self.log(f"{asks}: a person types `{how}`", WARNING)
        return AssistantReply(text=line(f"nothing is released: a person has to type `{how}`"))

    def _goto(
        self, request: AssistantRequest, args: Goal, question: Question
    ) -> AssistantReply | None:
        if args.x is None or args.y is None:
            what = f"no place {args.place!r} is known" if args.place else "give a place, or x and y"
            return AssistantReply(refusal=line(f"goto: {what}"))
        goal = Waypoint(args.x, args.y, wrap(radians(args.heading or 0.0)))
        self._begin(self._drive(request, question, goal))
        return None

    def _order(
        self, request: AssistantRequest, args: Named, question: Question
    ) -> AssistantReply | None:
        if args.name not in (shipped := names("missions")):  # a name, and never a file
            known = ", ".join(shipped)
            return AssistantReply(refusal=line(f"no mission {args.name!r}; there are: {known}"))
        try:
            mission = load_mission(args.name)
        except ConfigError as error:
            return AssistantReply(refusal=line(str(error)))
        self._begin(self._drive(request, question, mission=mission))
        return None

    def _foretell(
        self, request: AssistantRequest, args: Trial, question: Question
    ) -> AssistantReply | None:
        """Judge what a client rehearses, as if it asked for it: the reply says what is against it.

        The server drives it virtually then. Without the reply it would tell a client that it
        arrives where it may not go.
        """
        goal = mission = None
        wanted = replace(request, tool="goto")  # of a goal an approval counts by the place
        if args.x is not None and args.y is not None:
            goal = Waypoint(args.x, args.y, wrap(radians(args.heading or 0.0)))
        elif args.mission in names("missions"):
            order = msgspec.json.encode(Named(args.mission)).decode()  # as the server writes it
            wanted = replace(request, tool="mission", text=order)
            try:
                mission = load_mission(args.mission)
            except ConfigError as error:
                return AssistantReply(refusal=line(str(error)))
        if goal is None and mission is None:  # the present mission, or nothing that there is
            return AssistantReply()
        drive = self._drive(request, question, goal, mission)
        drive = dataclasses.replace(drive, rehearsed=wanted)
        if why := drive.rules.forbids(drive.wanted.tool):
            return self._foretold(drive, AssistantReply(refusal=why))
        self._begin(drive)
        return None

    def _foretold(self, drive: _Drive, outcome: AssistantReply) -> AssistantReply:
        """What would become of a request, of which the refusal is not that of the rehearsal."""
        if outcome.refusal in ("", BUSY):
            return outcome
        text = line(f"{drive.wanted.tool} would be refused: {outcome.refusal}")
        return AssistantReply(text, against=Against.REFUSED)

    def _drive(
        self,
        request: AssistantRequest,
        question: Question,
        goal: Waypoint | None = None,
        mission: Mission | None = None,
    ) -> _Drive:
        return _Drive(request, self._rules(request), partial(self.answer, question), goal, mission)

    def _cancel(
        self, request: AssistantRequest, args: Numbered, question: Question
    ) -> AssistantReply | None:
        """Cancel a mission on the board, or a goal.

        Without a number it is all that the client wants: its goal, and what has not begun yet.
        """
        by = request.by
        taken = False if args.number else self._take_back(by)
        waits = None if args.number else self._waits
        if waits is not None and waits.request.by == by:
            if self._after is not None:
                return AssistantReply(refusal=BUSY)

            def after(number: int | None) -> None:
                found = self._goals.lose(request) if number is None else number
                if found := found or self._goals.driven_for(request):
                    self._cancel_mission(request, found, question)
                else:
                    why = LOST if number is None else "it was refused meanwhile"
                    self._note(request, AssistantReply(refusal=why))
                    self.answer(question, AssistantReply(refusal=why))

            self._after = after
            return None
        mine = self._goals.of(request)
        if taken and not self._goals.driven_for(request):
            return AssistantReply("it is cancelled: it had not begun")
        number = int(args.number or mine)
        if number == 0:
            return AssistantReply(refusal="no goal of yours is known")
        if number != mine:
            found = next((each for each in self._goals.listed() if each.number == number), None)
            if found is None:
                return AssistantReply(refusal=f"no mission {number} on the board, or goal of yours")
            if found.by != by_name(request):
                by = found.by or "people"
                return AssistantReply(refusal=line(f"{found.name} was ordered by {by}"))
        if number in self._cancels:
            return AssistantReply(refusal=BUSY)
        self._cancel_mission(request, number, question)
        return None

    def _cancel_mission(
        self, request: AssistantRequest, number: int, question: Question | None
    ) -> None:
        """Send a cancellation. It does not wait for the goals of others that are planned."""

        def finish(outcome: AssistantReply) -> None:
            self._note(request, outcome)
            if question is not None:
                self.answer(question, outcome)

        def on_reply(reply: MissionReply | None) -> None:
            self._cancels.discard(number)
            refusal = NOBODY if reply is None else reply.refusal
            done = AssistantReply("it is cancelled", mission=0 if reply is None else reply.mission)
            finish(AssistantReply(refusal=refusal) if refusal else done)

        self._cancels.add(number)
        self._note(request, AssistantReply("it is passed on"))
        self.query(MissionCancel(number, by_name(request)), on_reply, self.p.planning_s)

    def _take_back(self, by: str) -> bool:
        """End what a client wants and no mission agent has yet; return whether there was any."""
        taken = [each for each in self._ready if each.request.by == by and not each.only_asked]
        self._ready = deque(each for each in self._ready if each not in taken)
        waits = self._waits
        if waits is not None and not self._passed_on and waits.request.by == by:
            self._waits = None  # its plan is not waited for any more
            taken.append(waits)
        for drive in taken:
            self._finish(drive, AssistantReply(refusal=TAKEN_BACK))
        waiting = [each for each in self._approvals.waiting if each.request.by == by]
        for each in waiting:
            self._approvals.end(each, TAKEN_BACK)
            self._book.write_of(each.request, "not approved", TAKEN_BACK)
        return bool(taken or waiting)

    # What sets the robot in motion ---------------------------------------------------------------

    def _begin(self, drive: _Drive) -> None:
        """Judge a request by the rules, have its path planned, let it wait, and pass it on."""
        learns = self._learns_for(drive)
        if learns and all(each.only_asked != drive.only_asked for each in self._ready):
            self._ready.append(drive)
            return
        if refusal := BUSY if learns else self._refusal(drive):
            self._finish(drive, AssistantReply(refusal=line(refusal)))
            return
        if not drive.only_asked:
            self._waits, self._passed_on = drive, False
        goal, pose, needed = drive.goal, self.fresh(Pose), drive.rules.needs_path
        # Nobody is asked for a goal that cannot be reached.
        asks = drive.approved is None and self._asks(drive)
        if goal is None or not (needed or asks) or pose is None:
            self._planned(drive, None)
            return

        def planned(plan: Plan | None) -> None:
            if drive.only_asked:
                self._rehearsed = None
            elif self._waits is not drive:
                return  # it was taken back
            if plan is None and not needed:  # the mission agent may do without a planner
                self._planned(drive, None)
            elif plan is None or plan.refusal or not plan.waypoints:
                why = "no path planning agent answered" if plan is None else plan.refusal
                self._give_up(drive, why or "there is no path")
            else:
                self._planned(drive, plan)

        if drive.only_asked:
            self._rehearsed = drive
        self.query(
            PlanRequest(Waypoint(pose.x, pose.y, pose.theta), goal), planned, self.p.planning_s
        )

    def _refusal(self, drive: _Drive) -> str:
        """Why a request is refused before its path is known; "" if it is not."""
        rules = drive.rules
        if why := self._barred(rules):
            return why
        if self._rehearsed if drive.only_asked else self._waits:
            return BUSY
        most, taken = rules.section.goals_an_hour, self._taken.setdefault(rules.name, deque())
        while taken and self.now - taken[0] >= HOUR_S:
            taken.popleft()
        if most is not None and len(taken) >= most:
            return f"the policy ({rules.name}) has {most} goals an hour, and they are used up"
        goal = () if drive.goal is None else ((drive.goal.x, drive.goal.y),)
        unbound = "" if drive.mission is None else rules.unbound(drive.mission.does)
        if unbound or drive.goal is None:
            return unbound
        return self._scene.refusal(rules, goal, "the goal", legs=False)

    def _barred(self, rules: Rules) -> str:
        """Why nothing may be begun now; "" if it may. It may change while a path is planned."""
        stop = self.stopped
        # A goal accepted now would set the robot in motion when the stop is released.
        if stop is not None:
            return f"the robot is stopped by {stop.requester}"
        return self._fault or rules.closed(self.clock())

    def _planned(self, drive: _Drive, plan: Plan | None) -> None:
        """Judge the path; let the request wait for a person if it needs one."""
        path = () if plan is None else tuple((at.x, at.y) for at in plan.waypoints)
        rules = drive.rules
        bad = "" if plan is None else self._scene.refusal(rules, path)
        if why := self._barred(rules) or bad:
            self._give_up(drive, why)
            return
        rooms = self._scene.rooms_to_ask(rules, path) if path and rules.asks else ()
        rooms = tuple(rules.asks) if drive.mission is not None and self._asks(drive) else rooms
        drive = dataclasses.replace(drive, rooms=rooms)
        if self._lacks_approval(drive):
            return
        if drive.only_asked:
            self._finish(drive, AssistantReply())
            return
        by, section = by_name(drive.request), rules.section
        terms = None if rules is NO_POLICY.default else Terms(by, section.v_max, self.name)
        self._taken.setdefault(rules.name, deque()).append(self.now)
        self._note(drive.request, AssistantReply("it is passed on"))
        if drive.goal is not None:
            mine = self._goals.of(drive.request)
            going = MissionRequest(drive.goal, replaces=mine, terms=terms, by=by)
            self._pass_on(drive, going)
            return
        assert drive.mission is not None, "a goal or a mission"
        order = drive.mission.order(0.0, by).numbered(self.rng.getrandbits(63) or 1)
        if isinstance(order, MissionOrder):
            order = replace(order, terms=terms)
        self._pass_on(drive, order)

    def _lacks_approval(self, drive: _Drive) -> bool:
        """Let a request wait if it needs a person's yes, and has none; return whether it ended."""
        why = f"the way leads through {', '.join(drive.rooms)}" if drive.rooms else ""
        why = f"the policy asks for each {drive.wanted.tool}" if self._asks(drive) else why
        if not why:
            return False
        if drive.approved is None:
            return self._ask_a_person(drive, line(why))
        more = [room for room in drive.rooms if room not in drive.approved.rooms]
        if more:
            why = f"the way leads through {', '.join(more)} now, which nobody has approved"
            self._give_up(drive, why)
        return bool(more)

    def _asks(self, drive: _Drive) -> bool:
        return drive.rules.asks_for(drive.wanted.tool)

    def _give_up(self, drive: _Drive, why: str) -> None:
        """Refuse the request that is being answered."""
        if not drive.only_asked:
            self._waits = None
        self._finish(drive, AssistantReply(refusal=line(why)))

    def _finish(self, drive: _Drive, outcome: AssistantReply) -> None:
        outcome = self._foretold(drive, outcome) if drive.only_asked else outcome
        self._note(drive.request, outcome)
        drive.deliver(outcome)

    def _pass_on(self, drive: _Drive, query: Order) -> None:
        """Send the query to a mission agent. Only one query is under way at a time."""
        self._waits, self._passed_on = drive, True
        request, self._going = drive.request, drive.rooms
        self._goals.begin(request)

        def on_reply(reply: MissionReply | None) -> None:
            self._waits, self._going = None, None
            after, self._after = self._after, None
            if reply is None:
                outcome = AssistantReply(refusal=NOBODY)
                withdrawal = query.withdrawal()
                if withdrawal is not None:  # a hung agent would begin it later
                    self.query(withdrawal, lambda _: None)
            elif reply.refusal:
                outcome = AssistantReply(refusal=reply.refusal)
            else:
                self._goals.allow(reply.mission, drive.rooms)
                if isinstance(query, MissionRequest):
                    self._goals.accept(request.by, reply.mission)
                outcome = AssistantReply("it is taken on", mission=reply.mission)
            if after is not None:
                lost = reply is None and isinstance(query, MissionRequest)
                after(None if lost else outcome.mission)
                outcome = outcome if outcome.refusal else AssistantReply(refusal=TAKEN_BACK)
            self._finish(drive, outcome)

        self.query(query, on_reply, self.p.planning_s)

    # The drive -----------------------------------------------------------------------------------

    def on_trajectory(self, trajectory: Trajectory) -> None:
        """Cancel a goal that begins although its client has cancelled it; see also `Keeper`."""
        if (cancel := self._goals.found(trajectory)) is not None:
            self._cancel_mission(cancel, trajectory.mission, None)
        super().on_trajectory(trajectory)

    def on_pose(self, pose: Pose) -> None:
        """Begin a goal that waited for a pose; see also `Keeper`."""
        self._begin_next()
        super().on_pose(pose)

    def _learns_for(self, drive: _Drive) -> bool:
        """The same, of what it needs to judge a goal, or an approval for always."""
        lacks = drive.goal is not None and bool(self._scene.lacks(drive.rules))
        return self._is_new and (lacks or bool(self._approvals.unproved))

    def _rules(self, request: AssistantRequest) -> Rules:
        """The rules of the client that asks."""
        return self._policy.of(client_in(by_name(request)))


def _wrong(tool: Tool, text: str, error: msgspec.DecodeError) -> str:
    """What is wrong with a tool's arguments: which one, its value, and what is expected."""
    try:
        convert(json.loads(text), tool.arguments, tool.name, "")
    except ConfigError as found:
        return str(found)
    except (ValueError, RecursionError):
        pass  # it is no JSON
    return f"{tool.name}: {error}"
