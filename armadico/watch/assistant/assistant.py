"""The assistant agent: executes requests of programs and language models, with least authority."""

from __future__ import annotations

from collections.abc import Callable
from math import radians
from typing import Annotated, Any, ClassVar, Final

import msgspec
from msgspec import Meta

from armadico.agents.interface.messages import MissionCancel, MissionOrder
from armadico.config.errands import load_mission
from armadico.config.shipped import names
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Message, RobotState, line, next_count
from armadico.mobile.errand import Errands, Order
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import MissionReply, MissionRequest, Waypoint
from armadico.watch.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.watch.assistant.tools import TOOLS, Because, Goal, Named, Numbered

# The prefix of the name under which this agent orders missions and stops the robot.
BY: Final = "assistant"

LONGEST_BY: Final = 100  # characters of that name that are published


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The rate limit for requests, and the timeout for a mission agent's reply."""

    a_second: Annotated[float, Meta(gt=0, le=100)] = 2.0  # requests per second, on average
    at_once: Annotated[float, Meta(ge=1, le=1000)] = 20.0  # requests in one burst
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 25.0


class Assistant(Agent):
    """Publishes a record of each request of a program, and executes the permitted ones.

    It owns no resource and competes for none: it publishes no command, bid or ballot. It sends the
    same queries as the operator's commands do, at the lowest priority: a goal does not replace a
    goal of others, and a mission waits for all others. It may stop the robot. Only people release
    a stop; the agent replies with the code that they must type.
    """

    name = "assistant"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (RobotState,)
    provides: ClassVar[tuple[type[Message], ...]] = (AssistantRecord,)
    answers: ClassVar[tuple[type[Message], ...]] = (AssistantRequest,)
    queries: ClassVar[tuple[type[Message], ...]] = (MissionRequest, MissionOrder, MissionCancel)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._tokens, self._filled_at = self.p.at_once, 0.0  # token bucket
        self._number = self._left_out = 0
        self._mission = 0  # the last goal that was accepted
        self._waits = False  # for the reply to a query
        self._tools: dict[str, Callable[[AssistantRequest, Any, Question], AssistantReply | None]]
        self._tools = {
            "goto": self._goto,
            "mission": self._order,
            "cancel": self._cancel,
            "stop": self._stop,
            "resume": self._resume,
        }

    def on_assistant_request(
        self, request: AssistantRequest, question: Question
    ) -> AssistantReply | None:
        """Execute the request, or refuse it with the reason. A stop ignores the rate limit."""
        if request.tool != "stop" and not self._within_rate():
            self._left_out = next_count(self._left_out)
            often = f"{self.p.a_second:g} a second, after {self.p.at_once:g} at once"
            return AssistantReply(refusal=f"too many requests: {often}; ask again later")
        reply = self._answer(request, question)
        if reply is not None and (request.tool != "stop" or self._within_rate()):
            self._note(request, reply)
        elif reply is not None:
            self._left_out = next_count(self._left_out)
        return reply

    def _answer(self, request: AssistantRequest, question: Question) -> AssistantReply | None:
        tool = TOOLS.get(request.tool)
        if tool is None:
            return AssistantReply(refusal=f"no tool {request.tool!r}")
        try:
            args = msgspec.json.decode(request.text, type=tool.arguments)
        except msgspec.DecodeError as error:
            if tool.name != "stop":
                return AssistantReply(refusal=line(f"{tool.name}: {error}"))
            args = Because()  # a stop is not refused for its arguments
        do = self._tools.get(tool.name)
        return AssistantReply() if do is None else do(request, args, question)

    def _within_rate(self) -> bool:
        """Take a token from the bucket; return whether there was one."""
        since, self._filled_at = self.now - self._filled_at, self.now
        self._tokens = min(self._tokens + self.p.a_second * max(since, 0.0), self.p.at_once)
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def _note(self, request: AssistantRequest, reply: AssistantReply) -> None:
        self._number = next_count(self._number)
        self.publish(AssistantRecord(self._number, request, reply, self._left_out))
        self._left_out = 0

    # Tools ---------------------------------------------------------------------------------------

    def _stop(self, request: AssistantRequest, args: Because, question: Question) -> AssistantReply:  # noqa: ARG002
        before = self.stopped
        if before is not None:
            return AssistantReply(text=line(f"it is stopped already, by {before.requester}"))
        self.latch(line(f"{_by(request)}{f', {args.reason}' if args.reason else ''}")[:LONGEST_BY])
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
        asks = f"{_by(request)} asks for the release of the stop by {stop.requester}{because}"
        self.log(f"{asks}: a person types `{how}`", WARNING)
        return AssistantReply(text=line(f"nothing is released: a person has to type `{how}`"))

    def _goto(
        self, request: AssistantRequest, args: Goal, question: Question
    ) -> AssistantReply | None:
        goal = Waypoint(args.x, args.y, wrap(radians(args.heading)))
        going = MissionRequest(goal, replaces=self._mission)
        return self._pass_on(request, question, going)

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
        number = self.rng.getrandbits(63) or 1
        order = mission.order(0.0, _by(request)).numbered(number)
        return self._pass_on(request, question, order)

    def _cancel(
        self, request: AssistantRequest, args: Numbered, question: Question
    ) -> AssistantReply | None:
        boards = (each for each in self.memory.all() if isinstance(each, Errands))
        ordered = (each for board in boards for each in board.errands)
        found = next((each for each in ordered if str(each.number) == args.number), None)
        if found is None:
            return AssistantReply(refusal=f"no mission {args.number} on the board")
        if not found.by.startswith(BY):
            return AssistantReply(
                refusal=line(f"{found.name} was ordered by {found.by or 'people'}")
            )
        cancel = MissionCancel(found.number, _by(request))
        return self._pass_on(request, question, cancel, even_stopped=True)

    def _pass_on(
        self,
        request: AssistantRequest,
        question: Question,
        query: MissionRequest | Order | MissionCancel,
        *,
        even_stopped: bool = False,
    ) -> AssistantReply | None:
        """Send the query to a mission agent. Only one query is under way at a time."""
        stop = self.stopped
        # A goal accepted now would set the robot in motion when the stop is released.
        if stop is not None and not even_stopped:
            return AssistantReply(refusal=line(f"the robot is stopped by {stop.requester}"))
        if self._waits:
            return AssistantReply(refusal="one request is being answered; ask again later")
        self._waits = True

        def on_reply(reply: MissionReply | None) -> None:
            self._waits = False
            if reply is None:
                outcome = AssistantReply(refusal="no agent that takes missions has answered")
                withdrawal = query.withdrawal() if isinstance(query, Order) else None
                if withdrawal is not None:  # a hung agent would begin it later
                    self.query(withdrawal, lambda _: None)
            elif reply.refusal:
                outcome = AssistantReply(refusal=reply.refusal)
            else:
                if isinstance(query, MissionRequest):
                    self._mission = reply.mission
                outcome = AssistantReply("it is taken on", mission=reply.mission)
            self._note(request, outcome)
            self.answer(question, outcome)

        self._note(request, AssistantReply("it is passed on"))
        self.query(query, on_reply, self.p.planning_s)
        return None


def _by(request: AssistantRequest) -> str:
    return line(f"{BY}: {request.by or 'a program'}")[:LONGEST_BY]
