"""The MCP server: answers programs' calls from the state of a society; stops come first."""

from __future__ import annotations

import logging
import os
import queue
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from math import degrees, radians
from typing import Any, BinaryIO, Final

import msgspec
from msgspec.structs import replace

from armadico.core.config_errors import ConfigError
from armadico.core.messages import RobotState
from armadico.launch.client import Client, heading_to
from armadico.launch.latch import rests
from armadico.mesh.topology import MeshError
from armadico.observe.jsons import Json, JsonObject
from armadico.observe.watching import QUERY_S, Watcher, show
from armadico.runtime.errors import SocietyError
from armadico.watch.assistant.assistant import APPROVAL
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.approvals import GONE_S, WAITS_S
from armadico.watch.assistant.policy.policy import DRIVING
from armadico.watch.assistant.tools import (
    REHEARSE,
    TOOLS,
    Goal,
    Last,
    Subject,
    Trial,
    Waiting,
    Why,
)
from armadico.watch.mcp.answers import NO_WORLD, Society
from armadico.watch.mcp.calls import (
    Approving,
    Asked,
    Asking,
    AwaitingEnd,
    Open,
    Rehearsing,
    Send,
    client_of,
    ill_posed,
    is_bare,
    refuse,
    request_of,
    tell,
    unheard,
    with_arguments,
)
from armadico.watch.mcp.lines import LONGEST, Call, Dropped, Lines, answer, in_ascii
from armadico.watch.mcp.short import fitted, shortened
from armadico.watch.mcp.waiting import Wait
from armadico.watch.why import LATER_S

WAITING: Final = 64  # calls in the queue; further calls are refused at once

TURN_S: Final = 0.05  # how often the queue is read while no message arrives from the society

# Agents are queried for bids and cards for this time after a call.
WATCHED_S: Final = 60.0

FIND_S: Final = 2.0  # how long to wait for an assistant agent before one is started

HURRY_S: Final = 0.3  # the same before a stop is published without it

START_S: Final = 15.0  # how long an assistant agent may take to start

# The timeout for an answer that other agents contribute to: the assistant agent waits up to 25 s
# (`planning_s`) for a path, and as long again for the mission agent, which plans its own.
ANSWER_S: Final = 60.0

STOP_S: Final = 5.0  # the timeout for braking

AGAIN_S: Final = 0.1  # the pause before a call without an answer is sent again

STOP: Final = "stop"  # the tool
CANCEL: Final = "cancel"  # the same

TOLD_S: Final = 1.0  # period of progress notifications

CLIENTS: Final = 100  # whose last goals are remembered

POLL_S: Final = 1.0  # how often the agent is asked for an approval; see `GONE_S`

REHEARSED_S: Final = 30.0  # the longest rehearsal

# A program must not get rid of a policy by waiting until its agent has ended.
LAWLESS: Final = (
    "the assistant agent is gone, and its policy with it: none without a policy is started instead;"
    " a person has to start it again: armadico up ... --with assistant --set assistant.policy=FILE"
)

NOT_BEGUN: Final = "cancelled before it had begun"

UNANSWERED: Final = "no assistant agent answers: is the society up?"

ABSENT: Final = (
    "no assistant agent is alive, and a program with a key of its own starts none: a person has to:"
    " armadico up ... --with assistant"
)

logger = logging.getLogger("armadico.mcp")


Rehearse = Callable[..., Mapping[str, Any]]
"""Drives an errand virtually (group `armadico.rehearsals`); it blocks, and runs on any thread.

The keywords are `samples`, `within_s`, and `done`, which is called with the number of those that
have ended. Returns its answer: `says`, and `small` for JSON. Raises ConfigError.
"""

News = tuple[float, str]
"""When an open call ends at the latest, s, and how far it is; "": there is nothing to tell."""


class _Wordy(msgspec.Struct, frozen=True):
    """The argument that all reading tools share."""

    more: bool = False


class Server:
    """Answers calls in sequence, and receives the society's messages meanwhile.

    A stop does not wait for earlier calls: it has its own thread and client. A `cancel` overtakes
    those that the agent has not answered yet, and takes back this client's that have not begun. A
    call that waits for the end of a goal, or for a person, does not delay others. What reads from
    clients has threads of its own.
    """

    def __init__(
        self,
        guests: tuple[Client, Client],
        watcher: Watcher,
        society: Society,
        start: Callable[[], object] | None,
        rehearse: Rehearse | None = None,
        *,
        limited: bool = False,
    ) -> None:
        """Set up the server.

        `guests` are clients on the mesh: for stops, and for all else. The watcher's messages are
        added to `society`. `start` starts an assistant agent, which is `limited` by a policy; None:
        this program may not. `rehearse` drives virtually; None: it is not installed.
        """
        self._stopper, self._client = guests
        self._watcher = watcher
        self._society = society
        self._start = start
        self._rehearse, self._limited = rehearse, limited
        self._open: list[Open] = []
        self._calls: deque[Asked] = deque()
        self._ended = threading.Event()  # the client of `serve` is gone
        self._stops: queue.SimpleQueue[Asked | None] = queue.SimpleQueue()
        self._dropped: queue.SimpleQueue[tuple[Send, int | str]] = queue.SimpleQueue()
        self._goals: dict[str, tuple[int, str]] = {}  # by client: the last one's number and name
        self._called_at = self._polled_at = float("-inf")

    def serve(self, file: BinaryIO, out: BinaryIO, lines: Lines) -> None:
        """Answer one client's calls until its file ends, including those still in the queue."""
        writing = threading.Lock()

        def send(data: bytes) -> None:
            """Write a line. If the reader is gone, the file ends, too, and ends the server."""
            with writing, suppress(BrokenPipeError):
                out.write(data)
                out.flush()

        def read() -> None:
            for data in lines_of(file):
                if data.strip():
                    self.receive(lines.receive(data), send)
            self._ended.set()

        threading.Thread(target=read, name="stdin", daemon=True).start()
        self.keep()

    def keep(self) -> None:
        """Answer calls until the client of `serve` is gone, or for ever."""
        with self._stopping():
            while self.turn():
                pass

    # On threads that read from clients -----------------------------------------------------------

    def receive(self, found: Call | Dropped | bytes | None, send: Send) -> None:
        """Queue a call; answer at once what does not need the society."""
        match found:
            case bytes():
                send(found)
            case Dropped():
                self.drop(found.id, send)
            case Call(tool=tool) if tool == STOP:
                self._stops.put(Asked(found, send))
            case Call():
                asked = Asked(found, send)
                if len(self._calls) < WAITING:
                    self._calls.append(asked)
                else:
                    refuse(asked, f"{WAITING} calls wait to be answered: ask again later")

    def drop(self, number: int | str, send: Send) -> None:
        """End a call whose client is gone or does not want it any more.

        If the agent has it already, the robot drives on.
        """
        self._dropped.put((send, number))

    # Stops, on their own thread ------------------------------------------------------------------

    @contextmanager
    def _stopping(self) -> Iterator[None]:
        thread = threading.Thread(target=self._serve_stops, name="stop", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._stops.put(None)
            thread.join()

    def _serve_stops(self) -> None:
        while (asked := self._stops.get()) is not None:
            with _surviving(asked):
                found, failed = self.stopped(asked.call)
                asked.send(answer(asked.call, found, failed=failed))

    def stopped(self, call: Call) -> tuple[Mapping[str, Json], bool]:
        """Stop the robot: by the assistant agent, or directly if that does not reply at once."""
        request = request_of(call)
        reply = None
        try:
            if request is not None:
                reply = self._stopper.query(request, FIND_S, patience=HURRY_S)
        except Exception:  # a stop is published nevertheless
            logger.exception("the assistant agent cannot be asked for a stop")
        if isinstance(reply, AssistantReply):
            if reply.refusal:
                return {"refused": reply.refusal}, True
            stopped = bool(self._stopper.wait_for(self._rests, STOP_S))
            return {"text": reply.text, "stopped": stopped}, not stopped
        try:
            self._stopper.stop(STOP_S, by=f"armadico mcp: {client_of(call)}")
        except SocietyError as error:
            return {"refused": str(error), "stopped": False}, True
        text = "it is stopped; no assistant agent answered, so this is not recorded"
        return {"text": text, "stopped": True}, False

    def _rests(self) -> bool:
        """Return whether the robot reports the stop, and its wheels are at rest."""
        state = self._stopper.latest(RobotState)
        return state is not None and state.stop.stopped and rests(state.v, state.w)

    # All else, on the thread of `keep` -----------------------------------------------------------

    def turn(self) -> bool:
        """Receive, and go on with each call; return False once the client of `serve` is gone."""
        ended = self._ended.is_set()  # before its last calls are looked for
        self._receive(TURN_S)
        self._client.catch_up()
        self._take_back()
        self._go_on()
        while (asked := self._next()) is not None:
            with _surviving(asked):
                self._begin(asked)
        if not ended or self._calls or self._has(Asking):
            return True
        for each in self._open:
            if isinstance(each, Approving):
                self._leave(each)
        return False

    def _take_back(self) -> None:
        """Forget the calls that are not waited for any more; they are not begun later."""
        with suppress(queue.Empty):
            while True:
                gone = self._dropped.get_nowait()
                # Threads that read from clients append to it meanwhile.
                for asked in [each for each in list(self._calls) if each.own == gone]:
                    self._calls.remove(asked)
                for each in [each for each in self._open if each.asked.own == gone]:
                    if isinstance(each, Asking) and each.under_way and each.call.tool in DRIVING:
                        # The agent may begin it, and its goal is the client's last one then.
                        each.once = each.asked.gone = True
                        each.asked.send = unheard
                    elif not isinstance(each, Rehearsing):  # it has begun; there is one at a time
                        self._open.remove(each)
                        if isinstance(each, Approving):
                            self._leave(each)

    def _has(self, kind: type[Open]) -> bool:
        """Return whether such a call is open, and waited for."""
        return any(isinstance(each, kind) and not each.asked.gone for each in self._open)

    def _next(self) -> Asked | None:
        """Return the next call to begin: one at a time, but a `cancel` waits for no other call."""
        calls = list(self._calls)
        found = next((each for each in calls if each.call.tool == CANCEL), None)
        if found is not None:
            own = found.call.by if is_bare(found.call) else None
            for each in calls[: calls.index(found)]:
                if each.call.by == own and each.call.tool in DRIVING:
                    self._calls.remove(each)
                    found.taken_back = True
                    refuse(each, NOT_BEGUN)
            self._cancel_asked(own, found)
        elif calls and not self._has(Asking):
            found = calls[0]
        if found is not None:
            self._calls.remove(found)
        return found

    def _cancel_asked(self, own: str | None, cancel: Asked) -> None:
        """Do not ask the agent again for a client's calls, which no agent has answered yet.

        They would begin after the answer to the `cancel`.
        """
        for each in [*self._open]:
            if not isinstance(each, Asking) or each.reply is not None:
                continue
            if each.asked.call.by == own and each.call.tool in DRIVING:
                each.once = True
                if not each.under_way:
                    self._open.remove(each)
                    cancel.taken_back = True
                    refuse(each.asked, NOT_BEGUN)

    def _go_on(self) -> None:
        """Go on with each open call, and tell its client how far it is."""
        now = self._now
        for each in [*self._open]:
            news: News | None = None
            with _surviving(each.asked):
                news = self._check(each, now)
            if news is None:
                self._open.remove(each)
                continue
            until, text = news
            if text and now - each.asked.told_at >= TOLD_S:
                each.asked.told_at = now
                tell(each.asked, now, until, text)

    def _check(self, each: Open, now: float) -> News | None:
        """Answer a call if it has ended, and return None; otherwise return its news."""
        match each:
            case Asking():
                return self._check_asked(each, now)
            case AwaitingEnd(wait=wait):
                found = wait.end(self._society, now)
                if found is None:
                    return wait.until, wait.news(self._society)
                each.asked.send(answer(each.asked.call, fitted(found)))
            case Approving():
                return self._check_approval(each, now)
            case Rehearsing(answer=None):
                return each.asked.began + REHEARSED_S, f"{each.done} drives have ended"
            case Rehearsing(answer=str(why)):
                refuse(each.asked, why)
            case Rehearsing():
                each.asked.send(answer(each.asked.call, fitted(each.told)))
        return None

    def _check_asked(self, each: Asking, now: float) -> News | None:
        """Go on with a call that the agent has answered, or has to be asked for again."""
        if each.reply is not None:
            self._answered(each, each.reply)
            return None
        if not each.under_way and each.once:
            refuse(each.asked, UNANSWERED)
            return None
        if not each.under_way and now >= each.until:
            if why := UNANSWERED if each.started else self._begin_agent():
                refuse(each.asked, why)
                return None
            each.started, each.until = True, now + START_S
        elif not each.under_way and now >= each.again_at:
            self._ask(each)
        return each.until, ""

    def _check_approval(self, each: Approving, now: float) -> News | None:
        """Answer a call that a person has answered, or nobody in time."""
        if each.reply is not None and each.reply.refusal:
            refuse(each.asked, each.reply.refusal)
        elif each.reply is not None:
            self._replied(each.asked, each.call, each.reply)
        elif now - each.heard_at >= GONE_S:
            refuse(each.asked, "the assistant agent does not answer any more")
        else:
            if now - each.polled_at >= POLL_S:
                self._poll(each)
            return each.until, each.text
        return None

    def _begin_agent(self) -> str:
        """Start an assistant agent; return why this may not be, or ""."""
        if self._start is None:
            return ABSENT
        if self._society.policy and not self._limited:
            return LAWLESS
        self._start()
        return ""

    def _ask(self, each: Asking) -> None:
        """Send a call to the assistant agent. Without a reply it is sent again later."""
        each.under_way, each.again_at = True, self._now + AGAIN_S

        def then(reply: object) -> None:
            each.under_way = False
            each.reply = reply if isinstance(reply, AssistantReply) else None

        request = request_of(each.call)
        assert request is not None, "it was checked"
        self._client.begin_query(request, ANSWER_S, then)

    def _leave(self, each: Approving) -> None:
        """Tell the agent that the client is gone, so that no yes begins what it asked for.

        Without that the agent ends it once nobody has asked for so long.
        """
        request = self._question(each, gone=True)
        if request is not None:
            self._client.begin_query(request, FIND_S, lambda _: None)

    def _question(self, each: Approving, *, gone: bool = False) -> AssistantRequest | None:
        asks = {"number": str(each.number)} | ({"gone": True} if gone else {})
        text = in_ascii(msgspec.json.encode(asks))
        return request_of(replace(each.call, tool=APPROVAL, text=text))

    def _poll(self, each: Approving) -> None:
        """Ask what has become of a call that waits for a person."""
        each.polled_at = self._now
        request = self._question(each)

        def then(reply: object) -> None:
            if isinstance(reply, AssistantReply):
                each.heard_at = self._now
                each.reply = None if reply.approval else reply

        if request is not None:
            self._client.begin_query(request, FIND_S, then)

    @property
    def _now(self) -> float:
        return self._watcher.clock() / 1e9

    def _receive(self, for_s: float) -> None:
        """Wait up to `for_s` seconds for a message; process it and those already received."""
        now = self._now
        if now - self._called_at < WATCHED_S and now - self._polled_at >= QUERY_S:
            self._polled_at = now
            self._society.view.ask(now)
            self._watcher.query_cards()
            self._watcher.query_bids()
        item = self._watcher.get(for_s)
        while item is not None:
            show(self._society, item)
            item = self._watcher.get(0.0)

    def _receive_until(self, enough: Callable[[], bool], for_s: float) -> None:
        end = self._now + for_s
        while not enough() and self._now < end:
            self._receive(TURN_S)

    # Calls ---------------------------------------------------------------------------------------

    def _begin(self, asked: Asked) -> None:
        """Ask the assistant agent for a call."""
        idle = self._now - self._called_at > WATCHED_S
        self._called_at = asked.began = now = self._now
        if asked.call.tool == APPROVAL:  # this server's own question: neither limited nor recorded
            refuse(asked, f"no tool {APPROVAL!r}")
            return
        call, unknown = self._placed(asked.call)
        if request_of(call) is None:
            refuse(asked, "too long: 2,000 characters at most, and printable ones")
            return
        each = Asking(asked, call, unknown, idle, now + FIND_S, now)
        self._open.append(each)
        self._ask(each)

    def _answered(self, each: Asking, reply: AssistantReply) -> None:
        """Go on with a call that the agent has answered."""
        asked, call = each.asked, each.call
        if reply.refusal and asked.taken_back:  # the agent knows nothing of it
            asked.send(answer(call, fitted({"text": NOT_BEGUN})))
        elif reply.refusal:
            refuse(asked, each.unknown or reply.refusal)
        elif reply.approval:
            now = self._now
            until = now + WAITS_S
            waits = Approving(asked, call, reply.approval, until, reply.text, now, now)
            if asked.gone:
                self._leave(waits)
            else:
                self._open.append(waits)
        elif each.unknown:  # the agent takes a place that is not known for none
            refuse(asked, each.unknown)
        else:
            tool = TOOLS.get(call.tool)
            if each.idle and tool is not None and not tool.does:
                self._receive_until(lambda: False, QUERY_S)  # for agents' cards and bids
            self._replied(asked, call, reply)

    def _replied(self, asked: Asked, call: Call, reply: AssistantReply) -> None:
        """Answer a call that the agent has executed, or has nothing to do for."""
        tool = TOOLS.get(call.tool)
        if tool is None:  # it has packages installed that this computer lacks
            refuse(asked, f"the assistant agent accepts {call.tool}; this server does not know it")
        elif call.tool == "goto":
            goal = msgspec.json.decode(call.text, type=Goal)
            name = goal.place or f"({goal.x or 0.0:g}, {goal.y or 0.0:g})"
            self._goals = dict([*self._goals.items(), (call.by, (reply.mission, name))][-CLIENTS:])
            self._wait(asked, reply.mission, name, goal.wait_s, reply.text)
        elif call.tool == "wait":
            status = self._society.view.mission
            present = (0 if status is None else status.mission, "its goal")
            mission, name = self._goals.get(call.by, present)
            for_s = msgspec.json.decode(call.text, type=Waiting).wait_s
            if mission:
                self._wait(asked, mission, name, for_s, "")
            else:
                refuse(asked, "no goal was ordered: there is nothing to wait for")
        elif tool.does:
            mission_of = {"mission": str(reply.mission)} if reply.mission else {}
            asked.send(answer(call, fitted({"text": reply.text} | mission_of)))
        elif call.tool == REHEARSE.name:
            self._try(asked, msgspec.json.decode(call.text, type=Trial), reply)
        else:
            self._show(asked)

    def _try(self, asked: Asked, trial: Trial, against: AssistantReply) -> None:
        """Begin a rehearsal; one at a time, since each takes all spare processors."""
        if self._rehearse is None:
            refuse(asked, "no rehearsal is installed here")
            return
        if wrong := ill_posed(trial):
            refuse(asked, f"rehearse: {wrong}")
            return
        if self._has(Rehearsing):
            refuse(asked, "another rehearsal is under way: ask again when it has ended")
            return
        begun = Rehearsing(asked, against)
        self._open.append(begun)
        drive, errand = self._rehearse, dict[str, object]()
        if trial.x is not None and trial.y is not None:
            turned = None if trial.heading is None else radians(trial.heading)
            errand["goal"] = [trial.x, trial.y, turned]
        elif trial.mission:
            errand["mission"] = trial.mission

        def done(count: int) -> None:
            begun.done = count

        def run() -> None:
            try:
                begun.answer = drive(errand, samples=trial.samples, within_s=REHEARSED_S, done=done)
            except (ConfigError, SocietyError, MeshError) as error:
                begun.answer = str(error)
            except Exception as error:
                begun.answer = f"the rehearsal broke: {error!r}"

        threading.Thread(target=run, name="rehearsal", daemon=True).start()

    def _wait(self, asked: Asked, mission: int, name: str, for_s: float, text: str) -> None:
        """Answer when a goal has ended; at once if the client does not wait."""
        if for_s > 0.0 and not asked.gone:
            wait = Wait(mission, name, self._now, self._now + for_s)
            self._open.append(AwaitingEnd(asked, wait))
            return
        said = f"The goal {name} is accepted: {text}" if text else "It was not waited for"
        found: JsonObject = {"text": said, "end": "driving", "mission": str(mission)}
        asked.send(answer(asked.call, fitted(found)))

    def _placed(self, call: Call) -> tuple[Call, str]:
        """Return a call with the pose of the place that it names.

        With an unknown place it remains as it is, so that the agent records and refuses it; the
        text says what would be right.
        """
        try:
            if call.tool not in ("goto", REHEARSE.name):
                return call, ""
            kind: type[Goal | Trial] = Goal if call.tool == "goto" else Trial
            goal: Goal | Trial = msgspec.json.decode(call.text, type=kind)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return call, ""
        x, y, heading = goal.x, goal.y, goal.heading
        if goal.place and (x is not None or y is not None):
            bare = replace(goal, x=None, y=None)
            return with_arguments(call, bare), f"{call.tool}: give a place, or x and y, not both"
        if goal.place:
            if self._society.gazetteer is None:
                return call, NO_WORLD
            try:
                place = self._society.gazetteer.of(goal.place)
            except ConfigError as error:
                return call, str(error)
            x, y = place.x, place.y
            if heading is None and place.heading is not None:
                heading = degrees(place.heading)
        if x is None or y is None:
            return call, ""
        if heading is None and isinstance(goal, Goal):
            heading = round(degrees(heading_to(x, y, self._society.view.pose)), 2)
        return with_arguments(call, replace(goal, x=x, y=y, heading=heading)), ""

    def _show(self, asked: Asked) -> None:
        """Answer a tool that only reads, or a resource. The agent has already checked the call."""
        call = asked.call
        if call.uri and call.tool == "map":
            asked.send(answer(call, {}, picture=self._society.picture()))
            return
        full = self._read_only(call)
        more = bool(call.uri) or msgspec.json.decode(call.text, type=_Wordy).more
        asked.send(answer(call, shortened(call.tool, full, more=more)))

    def _read_only(self, call: Call) -> JsonObject:
        society, now = self._society, self._now
        match call.tool:
            case "where":
                return society.where(now)
            case "map":
                return society.map()
            case "places":
                return society.places()
            case "who":
                return society.who()
            case "missions":
                return society.missions()
            case "history":
                return society.history(now, msgspec.json.decode(call.text, type=Last).lines)
        if msgspec.json.decode(call.text, type=Why).what is Subject.STANDING:
            return society.why(now)
        count = len(society.moments)
        society.mark(now)
        self._receive_until(lambda: len(society.moments) > count, 2 * LATER_S)
        return society.moment()


@contextmanager
def _surviving(asked: Asked) -> Iterator[None]:
    """Answer a call with the error that it leads to: stops and other calls must go on."""
    try:
        yield
    except ConfigError as error:  # such as the file of added places, damaged meanwhile
        refuse(asked, str(error))
    except Exception as error:
        logger.exception("the call of %s failed", asked.call.tool)
        with suppress(Exception):  # it may be the client that is gone
            refuse(asked, f"this server failed: {error!r}")


def lines_of(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file as they arrive; a too long line is cut to `LONGEST` + 1 bytes.

    It reads by the descriptor: a thread that waits in a Python file holds its lock, and a process
    that exits meanwhile, such as by Ctrl-C, is aborted.
    """
    begun = b""
    while data := os.read(file.fileno(), LONGEST):
        *whole, last = data.split(b"\n")
        for part in whole:
            yield begun + part[: LONGEST + 1 - len(begun)]
            begun = b""
        begun += last[: LONGEST + 1 - len(begun)]
    if begun:
        yield begun
