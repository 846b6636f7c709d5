"""A robot agent on a bench: a controller with scripted answers, and the time set by hand."""

from __future__ import annotations

import random
from typing import Any

from armadico.bridge.p2os.commands import SYNC0, SYNC1, Cmd, decode_command
from armadico.bridge.p2os.packets import Decoder, encode
from armadico.bridge.p2os.status import Status, encode_status
from armadico.bridge.robot import Parameters, Robot
from armadico.core.agent import Identity
from armadico.core.messages import Ack, Ballot, Command, Cycle, Log, Message, RobotState
from armadico.core.outgoing import Publish, Write
from tests.robot.bridge.kit import PROFILE


def names_of(subclass: str, class_name: str = "Pioneer", name: str = "Rob") -> bytes:
    """The answer to SYNC2."""
    return encode(b"\x02" + b"".join(s.encode() + b"\0" for s in (name, class_name, subclass)))


NAMES = names_of("p2dx")
BALLOT = Ballot(5, 0.6, False, "goto-1")
TICK = 0.01


class Bench:
    """A robot agent, a controller's answers, and the time, in steps of 10 ms."""

    def __init__(self, **set_: Any) -> None:
        parameters = Parameters(port="memory:", **set_)
        self.robot = Robot(Identity("robot-1", rng=random.Random(1)), parameters)
        self.now = 0.0
        self.x_m = 0.0
        self.published: list[tuple[float, Message]] = []
        self.written: list[tuple[float, int, int]] = []  # when, which command, its value
        self.writes: list[Write] = []
        self.raw = b""
        self._decoder = Decoder()
        self.robot.kernel.start(0.0)

    # What happens ------------------------------------------------------------------------------

    def plug(self) -> None:
        self.robot.kernel.on_link(True, "", self.now)
        self.take()

    def unplug(self) -> None:
        self.robot.kernel.on_link(False, "pulled out", self.now)
        self.take()

    def answer(self, *packets: bytes) -> None:
        for packet in packets:
            self.robot.kernel.on_bytes(packet, self.now)
            self.take()

    def connect(self) -> Bench:
        self.plug()
        self.answer(SYNC0, SYNC1, NAMES)
        return self

    def status(self, **fields: object) -> RobotState:
        """A status packet, and the robot/state that comes of it."""
        self.report(**fields)
        return self.state()

    def report(self, **fields: object) -> None:
        """A status packet, whatever comes of it."""
        plain: dict[str, object] = {
            "x_m": self.x_m,
            "y_m": 0,
            "theta_rad": 0,
            "left_m_s": 0,
            "right_m_s": 0,
        }
        plain |= {"battery_v": 12.5, "echoes": ((3, 2.0),), "motors_enabled": True}
        status = Status(**(plain | fields))  # type: ignore[arg-type]
        self.answer(encode(encode_status(status, PROFILE.p2os)))

    def let_pass(self, seconds: float, *, statuses: bool = False) -> None:
        for step in range(1, round(seconds / TICK) + 1):
            self.now = round(self.now + TICK, 6)
            if statuses and step % 10 == 0:
                self.status()
            due = self.robot.kernel.wakeup
            if due is not None and self.now >= due:
                self.robot.kernel.wake(self.now)
                self.take()

    def cycles(self, count: int) -> Bench:
        self.let_pass(0.1 * count, statuses=True)
        return self

    def hand(self, message: Message) -> None:
        self.robot.kernel.receive(message, self.now)
        self.take()

    def command(
        self, v: float, w: float = 0.0, *, cycle: Cycle | None = None, ballot: Ballot = BALLOT
    ) -> None:
        self.hand(Command("wheels", cycle or self.state().cycle, ballot, (v, w)))

    # What came of it ---------------------------------------------------------------------------

    def state(self) -> RobotState:
        return next(m for _, m in reversed(self.published) if isinstance(m, RobotState))

    def ack(self) -> Ack:
        return next(m for _, m in reversed(self.published) if isinstance(m, Ack))

    def logs(self) -> list[str]:
        return [m.text for _, m in self.published if isinstance(m, Log)]

    def speeds(self, since: float = 0.0) -> list[int]:
        """The VEL commands, mm/s."""
        return [value for at, number, value in self.written if number == Cmd.VEL and at >= since]

    def sent(self, number: int, since: float = 0.0) -> list[float]:
        return [at for at, which, _ in self.written if which == number and at >= since]

    def take(self) -> None:
        """Collect what it has written and published since."""
        for item in self.robot.kernel.outbox:
            if isinstance(item, Write):
                self.writes.append(item)
                self.raw += item.data
                for payload in self._decoder.feed(item.data, self.now):
                    one = decode_command(payload)
                    self.written.append((self.now, one.number, one.value))
            elif isinstance(item, Publish):
                self.published.append((self.now, item.message))
        self.robot.kernel.outbox.clear()
