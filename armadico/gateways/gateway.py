"""A society shown to other people's tools, live: samples out, goals in.

A guest: no agent notices whether it runs, is slow or hangs. A goal is a mission as anybody's, asked
for by the client that all commands use; what is refused is said, with the reason.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Final, NamedTuple, Protocol

from armadico.core.hands import remedy
from armadico.core.messages import Message, RobotState
from armadico.mesh.base import Mesh
from armadico.mobile.messages import MissionRequest, MissionState, MissionStatus
from armadico.observe.translators import Sample, Translator
from armadico.runtime.client import Client, Mission
from armadico.runtime.errors import SocietyError

TURN_S: Final = 0.05
"""How often goals are looked for."""

GOAL_S: Final = 0.5
"""Of goals that come faster than this the newest is taken."""

AGAIN_S: Final = 5.0
"""What has been said is not repeated within this."""

ALONE_S: Final = 10.0
"""Without anything to pass on for so long, that is said."""

LEAVE_S: Final = 1.0
"""What threads have for their last turn."""

Say = Callable[[str], None]


class Asked(NamedTuple):
    """A goal, as it came from outside."""

    topic: str
    data: bytes
    encoding: str
    schema: str = ""  # the type's name, as whoever sent it has it; empty: that of the topic


class Outside(Protocol):
    """Where samples go, and where goals come from. What breaks it for good is an OSError."""

    def publish(self, sample: Sample, at: int) -> None:
        """Send a sample; `at` is when the message that it comes from was received, ns."""

    def asked(self) -> Iterable[Asked]:
        """What has come since this was last asked."""


class Gateway:
    """One robot's society, and one outside; everything happens in `turn`, on whoever calls it."""

    def __init__(
        self, mesh: Mesh, translators: Sequence[Translator], outside: Outside, say: Say
    ) -> None:
        """Listen; the mesh must have been opened. `say` is told what people should know."""
        self.samples = 0
        self._client = Client(mesh)
        self._mesh = mesh
        self._outside = outside
        self._goals = {each.goals.topic: each for each in translators}
        self._tell = say
        self._told: dict[str, float] = {}
        self._goal: tuple[str, MissionRequest] | None = None
        self._goal_at = -math.inf
        self._heard_at = mesh.now()
        self._mission: Mission | None = None
        self._request: MissionRequest | None = None  # that it came of
        self._offset = time.time_ns() - round(1e9 * mesh.now())  # from the mesh's time, ns
        for each in translators:
            self._client.listen(*each.kinds, then=self._taker(each))
        self._client.listen(MissionStatus, RobotState)

    def turn(self, timeout: float = TURN_S) -> None:
        """Pass on what comes within `timeout` (s), and then goals, if any. Raises OSError."""
        self._client.wait_for(lambda: None, timeout)
        for asked in self._outside.asked():
            self._publish(asked)
        now = self._mesh.now()
        if self._goal is not None and now >= self._goal_at:
            (topic, request), self._goal, self._goal_at = self._goal, None, now + GOAL_S
            if not self._under_way(request):
                self._drive(topic, request)
        self._follow()
        if now - self._heard_at >= ALONE_S:
            self._heard_at = math.inf
            self._say(
                f"nothing is heard in the namespace {self._mesh.namespace!r}; waiting"
                " (`armadico ps` shows who is there, --namespace and --connect say where to look)"
            )

    def _taker(self, translator: Translator) -> Callable[[Message, float], None]:
        def take(message: Message, at: float) -> None:
            stamp = round(1e9 * at) + self._offset
            self._heard_at = at
            for sample in translator.translate(self._client.key, message, stamp):
                self._outside.publish(sample, stamp)
                self.samples += 1

        return take

    def _publish(self, asked: Asked) -> None:
        by = self._goals.get(asked.topic)
        if by is None:
            return
        at = round(1e9 * self._mesh.now()) + self._offset
        try:
            self._goal = asked.topic, by.goal(asked.data, asked.encoding, asked.schema, at)
        except ValueError as error:
            self._say(f"{asked.topic} refused: {error}")

    def _under_way(self, request: MissionRequest) -> bool:
        """Whether the robot drives there already: some say the same goal again and again."""
        if self._mission is None or request != self._request:
            return False
        return self._mission.status is not None

    def _drive(self, topic: str, request: MissionRequest) -> None:
        """Samples are passed on meanwhile."""
        goal = request.goal
        where = f"{goal.x:.2f} {goal.y:.2f} {math.degrees(goal.theta):.0f}"
        try:
            reply = self._client.hand_over(request)
        except SocietyError as error:
            self._say(f"{topic} {where} refused: {error}")
            return
        self._mission, self._request = Mission(self._client, reply), request
        state = self._client.latest(RobotState)
        until = ""
        if state is not None and state.stop.stopped:
            first = remedy(state.stop, motors=state.motors)
            how = f"{first}, then " if first else ""
            until = f", once the stop is released: {how}`armadico resume`"
        self._say(f"{topic} {where} accepted: {reply.length:.1f} m to go{until}")

    def _follow(self) -> None:
        """Say how the mission ended, if it was one of ours."""
        status = None if self._mission is None else self._mission.status
        if status is None or status.state not in {MissionState.REACHED, MissionState.FAILED}:
            return
        self._mission = None
        self._say(
            "the goal is reached"
            if not status.note
            else f"the mission {status.state.value}: {status.note}"
        )

    def _say(self, text: str) -> None:
        now = self._mesh.now()
        self._told = {said: at for said, at in self._told.items() if now - at < AGAIN_S}
        if text not in self._told:
            self._told[text] = now
            self._tell(text)


def serve(gateways: Sequence[Gateway], ended: Callable[[], bool] = lambda: False) -> None:
    """Pass on until Ctrl-C, or until `ended`; a thread for each robot.

    Asking one robot's society for a mission takes time, in which the others are shown, too.
    Raises OSError if an outside breaks.
    """
    stopping = threading.Event()
    broken: list[Exception] = []

    def work(gateway: Gateway) -> None:
        try:
            while not stopping.is_set():
                gateway.turn()
        except Exception as error:  # raised again where somebody sees it
            broken.append(error)
            stopping.set()

    threads = [threading.Thread(target=work, args=(each,), daemon=True) for each in gateways]
    for thread in threads:
        thread.start()
    try:
        with suppress(KeyboardInterrupt):
            while not stopping.wait(TURN_S) and not ended():
                pass
    finally:
        stopping.set()
        for thread in threads:
            thread.join(LEAVE_S)  # who waits for a mission's answer is left behind
    if broken:
        raise broken[0]
