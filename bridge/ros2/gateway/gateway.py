"""The gateway of a society to ROS 2: samples out, goals in.

It is not an agent, so agents are not affected if it is slow or hangs. A goal becomes a mission,
requested with the client that all commands use. Refusals are logged with the reason.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Final, Protocol

from armadico.bridge.ros2.gateway.society import Society
from armadico.core.hands import remedy
from armadico.core.messages import Message, RobotState
from armadico.launch.client import Client, Mission
from armadico.mesh.base import Mesh
from armadico.mobile.messages import MissionRequest, MissionState, MissionStatus
from armadico.observe.translators import Sample
from armadico.runtime.errors import SocietyError

TURN_S: Final = 0.05  # interval at which goals are checked
GOAL_S: Final = 0.5  # of goals that arrive faster, only the newest is used
AGAIN_S: Final = 5.0  # a line is not logged again within this time
ALONE_S: Final = 10.0  # time without messages after which that is logged
LEAVE_S: Final = 1.0  # timeout of a thread's last turn

Log = Callable[[str], None]


class Outside(Protocol):
    """The other nodes' side of a gateway. Its methods raise OSError if it fails for good."""

    def publish(self, sample: Sample) -> None: ...

    def goals(self) -> Iterable[bytes]:
        """The encoded goals received since the last call."""


class Gateway:
    """The gateway of one robot's society; all work is done in `turn`, on the caller's thread."""

    def __init__(self, mesh: Mesh, society: Society, outside: Outside, log: Log) -> None:
        """Subscribe on an open mesh; `log` receives lines for the operator."""
        self.samples = 0
        self._client = Client(mesh)
        self._mesh = mesh
        self._outside = outside
        self._society = society
        self._sink = log
        self._logged: dict[str, float] = {}
        self._goal: MissionRequest | None = None  # received, and not yet requested
        self._goal_at = -math.inf
        self._received_at = mesh.now()
        self._driven: tuple[MissionRequest, Mission] | None = None  # requested, and not over
        self._offset = time.time_ns() - round(1e9 * mesh.now())  # from the mesh's time, ns
        self._client.listen(*society.kinds, then=self._translate)
        self._client.listen(MissionStatus, RobotState)

    def turn(self, timeout: float = TURN_S) -> None:
        """Publish samples for `timeout` (s), then handle goals. Raises OSError."""
        self._client.wait_for(lambda: None, timeout)
        for goal in self._outside.goals():
            self._on_goal(goal)
        now = self._mesh.now()
        if self._goal is not None and now >= self._goal_at:
            request, self._goal, self._goal_at = self._goal, None, now + GOAL_S
            if not self._is_driving(request):
                self._drive(request)
        self._follow()
        if now - self._received_at >= ALONE_S:
            self._received_at = math.inf
            self._log(
                f"no messages in namespace {self._mesh.namespace!r}; waiting (`armadico ps` lists"
                " live agents; select another with --namespace or --connect)"
            )

    def _translate(self, message: Message, at: float) -> None:
        self._received_at = at
        for sample in self._society.translate(self._client.key, message, self._stamp(at)):
            self._outside.publish(sample)
            self.samples += 1

    def _stamp(self, at: float) -> int:
        """A time of the mesh in ns since 1970."""
        return round(1e9 * at) + self._offset

    def _on_goal(self, data: bytes) -> None:
        try:
            self._goal = self._society.goal(data, self._stamp(self._mesh.now()))
        except ValueError as error:
            self._log(f"{self._society.goals.topic} refused: {error}")

    def _is_driving(self, request: MissionRequest) -> bool:
        """Whether the robot drives there already: some tools repeat a goal."""
        if self._driven is None:
            return False
        requested, mission = self._driven
        return request == requested and mission.status is not None

    def _drive(self, request: MissionRequest) -> None:
        # Samples are published while the client waits for the reply.
        goal, topic = request.goal, self._society.goals.topic
        where = f"{goal.x:.2f} {goal.y:.2f} {math.degrees(goal.theta):.0f}"
        try:
            reply = self._client.request_mission(request)
        except SocietyError as error:
            self._log(f"{topic} {where} refused: {error}")
            return
        self._driven = request, Mission(self._client, reply)
        state = self._client.latest(RobotState)
        until = ""
        if state is not None and state.stop.stopped:
            first = remedy(state.stop, motors=state.motors)
            how = f"{first}, then " if first else ""
            until = f", once the stop is released: {how}`armadico resume`"
        self._log(f"{topic} {where} accepted: {reply.length:.1f} m to go{until}")

    def _follow(self) -> None:
        """Log the end of the gateway's own mission."""
        status = None if self._driven is None else self._driven[1].status
        if status is None or status.state not in {MissionState.REACHED, MissionState.FAILED}:
            return
        self._driven = None
        self._log(
            "the goal is reached"
            if not status.note
            else f"the mission {status.outcome}: {status.note}"
        )

    def _log(self, text: str) -> None:
        now = self._mesh.now()
        self._logged = {line: at for line, at in self._logged.items() if now - at < AGAIN_S}
        if text not in self._logged:
            self._logged[text] = now
            self._sink(text)


def serve(gateways: Sequence[Gateway], ended: Callable[[], bool] = lambda: False) -> None:
    """Run gateways until Ctrl-C or until `ended`, each on a thread of its own.

    The request of a mission blocks a gateway, but not those of other robots. Raises OSError if an
    outside fails.
    """
    stopping = threading.Event()
    broken: list[Exception] = []

    def work(gateway: Gateway) -> None:
        try:
            while not stopping.is_set():
                gateway.turn()
        except Exception as error:  # raised again by the caller's thread
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
            thread.join(LEAVE_S)  # a thread may still wait for a mission's reply
    if broken:
        raise broken[0]
