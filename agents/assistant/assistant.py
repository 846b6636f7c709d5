"""The assistant agent: what programs and language models ask for, with the lowest authority."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from math import radians
from typing import Annotated, Any, ClassVar, Final

import msgspec
from msgspec import Meta

from armadico.agents.assistant.messages import AssistantRecord, AssistantReply, AssistantRequest
from armadico.agents.assistant.tools import TOOLS, Because, Goal, Named, Numbered
from armadico.agents.missions.messages import Board, MissionCancel, MissionOrder
from armadico.agents.missions.mission_file import load_mission
from armadico.config.errors import ConfigError
from armadico.config.shipped import names
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.messages import Message, RobotState, line, next_count
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import MissionReply, MissionRequest, Waypoint

BY: Final = "assistant"
"""Begins the name under which it orders missions, and stops the robot."""

LONGEST_BY: Final = 100
"""Characters of a program's name that are told."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """How much may be asked, and how long others may take over it."""

    a_second: Annotated[float, Meta(gt=0, le=100)] = 2.0  # requests, for ever,
    at_once: Annotated[float, Meta(ge=1, le=1000)] = 20.0  # and so many at once
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 25.0


class Assistant(Agent):
    """Takes requests of programs down for everybody to see, and passes on what they may.

    It owns and competes for nothing: no command, no bid and no ballot is ever its own. What it has
    done is asked of the same agents as people ask, at the lowest priority: a goal never takes the
    place of somebody else's, and a mission waits for all others. It may stop the robot, as anybody
    may, and release nothing: people do, by the code that it answers with.
    """

    name = "assistant"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (RobotState,)
    provides: ClassVar[tuple[type[Message], ...]] = (AssistantRecord,)
    answers: ClassVar[tuple[type[Message], ...]] = (AssistantRequest,)
    asks: ClassVar[tuple[type[Message], ...]] = (MissionRequest, MissionOrder, MissionCancel)
    parameters = Parameters
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._tokens, self._filled_at = self.p.at_once, 0.0  # of a bucket
        self._number = self._left_out = 0
        self._mission = 0  # the goal that it had taken on last
        self._waits = False  # for somebody's answer
        self._doing: dict[str, Callable[[AssistantRequest, Any, Question], AssistantReply | None]]
        self._doing = {
            "goto": self._goto,
            "mission": self._order,
            "cancel": self._cancel,
            "stop": self._stop,
            "resume": self._resume,
        }

    def on_assistant_request(self, question: Question) -> AssistantReply | None:
        """Take it down, and do it or say why not. A stop is never too much."""
        request = question.request
        assert isinstance(request, AssistantRequest)
        if request.tool != "stop" and not self._may_ask():
            self._left_out = next_count(self._left_out)
            often = f"{self.p.a_second:g} a second, after {self.p.at_once:g} at once"
            return AssistantReply(refusal=f"too many requests: {often}; ask again later")
        reply = self._answer(request, question)
        if reply is not None and (request.tool != "stop" or self._may_ask()):
            self._note(request, reply)
        elif reply is not None:
            self._left_out = next_count(self._left_out)
        return reply

    def _answer(self, request: AssistantRequest, question: Question) -> AssistantReply | None:
        tool = TOOLS.get(request.tool)
        if tool is None:
            return AssistantReply(refusal=f"no tool {request.tool!r}")
        try:
            told = msgspec.json.decode(request.text, type=tool.arguments)
        except msgspec.DecodeError as error:
            if tool.name != "stop":
                return AssistantReply(refusal=line(f"{tool.name}: {error}"))
            told = Because()  # whoever wants it stopped need not say so well
        do = self._doing.get(tool.name)
        return AssistantReply() if do is None else do(request, told, question)

    def _may_ask(self) -> bool:
        """Whether there is a token left in the bucket; takes it."""
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

    # What it does --------------------------------------------------------------------------------

    def _stop(self, request: AssistantRequest, told: Because, question: Question) -> AssistantReply:  # noqa: ARG002
        before = self.stopped
        if before is not None:
            return AssistantReply(said=line(f"it is stopped already, by {before.who}"))
        self.latch(line(f"{_by(request)}{f', {told.reason}' if told.reason else ''}")[:LONGEST_BY])
        return AssistantReply(said="the stop is published; `where` says when the robot has it")

    def _resume(
        self,
        request: AssistantRequest,
        told: Because,
        question: Question,  # noqa: ARG002
    ) -> AssistantReply:
        stop = self.stopped
        if stop is None:
            return AssistantReply(said="the robot is not stopped")
        how = f"armadico resume --confirm {stop.code}"
        because = f", because {told.reason}" if told.reason else ""
        asks = f"{_by(request)} asks for the release of the stop by {stop.who}{because}"
        self.log(f"{asks}: a person types `{how}`", WARNING)
        return AssistantReply(said=line(f"nothing is released: a person has to type `{how}`"))

    def _goto(
        self, request: AssistantRequest, told: Goal, question: Question
    ) -> AssistantReply | None:
        goal = Waypoint(told.x, told.y, wrap(radians(told.heading)))
        going = MissionRequest(goal, replaces=self._mission)
        return self._pass_on(request, question, going)

    def _order(
        self, request: AssistantRequest, told: Named, question: Question
    ) -> AssistantReply | None:
        if told.name not in (shipped := names("missions")):  # a name, and never a file
            known = ", ".join(shipped)
            return AssistantReply(refusal=line(f"no mission {told.name!r}; there are: {known}"))
        try:
            mission = load_mission(told.name)
        except ConfigError as error:
            return AssistantReply(refusal=line(str(error)))
        packed = zlib.compress(mission.text.encode(), 9)
        number = self.rng.getrandbits(63) or 1
        order = MissionOrder(mission.name, packed, 0.0, _by(request), number)
        return self._pass_on(request, question, order)

    def _cancel(
        self, request: AssistantRequest, told: Numbered, question: Question
    ) -> AssistantReply | None:
        board = self.memory.newest(Board)
        missions = () if board is None else board.missions
        found = next((m for m in missions if str(m.mission) == told.number), None)
        if found is None:
            return AssistantReply(refusal=f"no mission {told.number} on the board")
        if not found.by.startswith(BY):
            return AssistantReply(
                refusal=line(f"{found.name} was ordered by {found.by or 'people'}")
            )
        cancel = MissionCancel(found.mission, _by(request))
        return self._pass_on(request, question, cancel, even_stopped=True)

    def _pass_on(
        self,
        request: AssistantRequest,
        question: Question,
        wish: MissionRequest | MissionOrder | MissionCancel,
        *,
        even_stopped: bool = False,
    ) -> AssistantReply | None:
        """Ask those whom people ask; one thing at a time."""
        stop = self.stopped
        if stop is not None and not even_stopped:  # or who releases it would set it in motion
            return AssistantReply(refusal=line(f"the robot is stopped by {stop.who}"))
        if self._waits:
            return AssistantReply(refusal="one request is being answered; ask again later")
        self._waits = True

        def answered(reply: MissionReply | None) -> None:
            self._waits = False
            if reply is None:
                told = AssistantReply(refusal="no agent that takes missions has answered")
                if isinstance(wish, MissionOrder):  # whoever hangs would begin it later
                    self.ask(MissionCancel(wish.mission, wish.by), lambda _: None)
            elif reply.refusal:
                told = AssistantReply(refusal=reply.refusal)
            else:
                if isinstance(wish, MissionRequest):
                    self._mission = reply.mission
                told = AssistantReply("it is taken on", mission=reply.mission)
            self._note(request, told)
            self.answer(question, told)

        self._note(request, AssistantReply("it is passed on"))
        self.ask(wish, answered, self.p.planning_s)
        return None


def _by(request: AssistantRequest) -> str:
    return line(f"{BY}: {request.by or 'a program'}")[:LONGEST_BY]
