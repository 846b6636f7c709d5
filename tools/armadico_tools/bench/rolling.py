"""How far a robot rolls when its robot agent is killed or hangs, over serial, TCP and ROS 2.

A process of its own is each of: the robot (the simulator, or `ros2_base.py`, a node of rclpy with
its own physics and no watchdog), and the robot agent. This process bids for the wheels, straight
ahead, and reads the robot's true pose. Nothing restarts the robot agent meanwhile.
"""

from __future__ import annotations

import json
import os
import queue
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import psutil

from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import Message, RobotState, decode
from armadico.core.resources import WHEELS
from armadico.core.services import service_of
from armadico.mesh.ports import free_port
from armadico.mobile.messages import Truth
from armadico.runtime.process import AgentHost, identity
from armadico_tools.bench.figures import show_trials
from armadico_tools.testbed import Place

BASE: Final = Path(__file__).with_name("ros2_base.py")
SOON_S: Final = 30.0
"""Time limit for an expected event; a robot that still rolls then is reported as that."""

STEADY_S: Final = 0.6
"""A trial begins after so long at speed, plus up to `PHASE_S`."""

PHASE_S: Final = 0.2
CYCLE_S: Final = 0.1
"""A cycle of the robot, in which a fault comes at any time."""

REST_M_S: Final = 0.005
SLOWER: Final = 0.95
RAMP: Final = 6
"""Most samples of a ramp whose line shows when it began."""

RESTS_S: Final = 0.5
"""At rest for so long it rests."""

Sample = tuple[float, float, float]
"""Time, s; way, m; speed, m/s."""


@dataclass(frozen=True)
class Line:
    """One kind of line: serial, tcp or ros2; the robot's profile, and the speed of trials, m/s."""

    name: str
    profile: str
    speed: float


LINES: Final = {
    line.name: line
    for line in (
        Line("serial", "pioneer-2dx", 0.5),
        Line("tcp", "pioneer-2dx", 0.5),
        Line("ros2", "turtlebot3-burger", 0.22),
    )
}
FAULTS: Final = ("kill", "hang", "kill-guard", "hang-guard")


@dataclass
class Trial:
    """What one robot did after a fault."""

    line: str
    fault: str
    speed: float  # m/s, at the fault
    begins_s: float  # until it began to be slower
    rest_s: float  # until it rested
    roll_m: float  # how far it went
    rolls_on: bool = False  # it still rolled after `SOON_S`


class Ahead(Agent):
    """Bids for the wheels in each cycle, straight ahead."""

    name = "ahead"
    reacts_to = RobotState
    competes_for = (WHEELS,)
    speed = 0.0

    def bid(self, message: Message) -> Bid | None:  # noqa: ARG002
        return Bid(1.0, (self.speed, 0.0)) if self.speed else None


@dataclass
class Track:
    """The robot's true motion."""

    samples: list[Sample] = field(default_factory=list)
    news: queue.SimpleQueue[Sample] = field(default_factory=queue.SimpleQueue)

    def put(self, way: float, speed: float) -> None:
        self.news.put((time.monotonic(), way, speed))

    def until(self, done: Callable[[list[Sample]], bool], what: str) -> None:
        """Wait for samples until something is so. Raises TimeoutError."""
        end = time.monotonic() + SOON_S
        while not done(self.samples):
            try:
                self.samples.append(self.news.get(timeout=max(end - time.monotonic(), 0.0)))
            except queue.Empty:
                raise TimeoutError(f"not within {SOON_S:.0f} s: {what}") from None

    def steady(self, speed: float, since: float, lasts: float) -> bool:
        late = [s for s in self.samples if s[0] > max(since, self.samples[-1][0] - lasts)]
        return (
            bool(late) and late[-1][0] - since >= lasts and all(s[2] > 0.93 * speed for s in late)
        )

    def at(self, when: float) -> float:
        """The way at a time, m."""
        before = max((s for s in self.samples if s[0] <= when), default=self.samples[0])
        return before[1] + before[2] * (when - before[0])

    def brakes(self, since: float, speed: float) -> float | None:
        """When it began to be slower, after a time: by the line through its first slower samples.

        None if it was not. A sample is up to a cycle late, in which the ramp has gone on.
        """
        slower = [s for s in self.samples if s[0] > since and s[2] < SLOWER * speed]
        ramp = [s for s in slower if s[2] > REST_M_S][:RAMP]
        if not slower:
            return None
        if len(ramp) < 3:
            return slower[0][0]
        slope, begins = np.polyfit([speed - s[2] for s in ramp], [s[0] for s in ramp], 1)
        return float(min(max(begins, since), slower[0][0])) if slope > 0.0 else slower[0][0]

    def rest(self, since: float) -> Sample | None:
        """The first sample after a time at which it rests, and goes on resting."""
        late = [s for s in self.samples if s[0] > since]
        for number, sample in enumerate(late):
            if all(abs(s[2]) < REST_M_S for s in late[number:]):
                return sample if late[-1][0] - sample[0] >= RESTS_S else None
        return None


class Rig:
    """A robot, its robot agent, and what drives it."""

    def __init__(self, line: Line, place: Place, program: str = "", python: str = "") -> None:
        """Start the robot. `program`: another `armadico-agent`; `python` has rclpy."""
        self.line, self.track = line, Track()
        self._place = place
        self._program = program
        self._stack = ExitStack()
        self._agent: subprocess.Popen[bytes] | None = None
        self.address = self._ros2(python) if line.name == "ros2" else self._simulated()
        self.ahead = Ahead(identity("ahead"))

    def _simulated(self) -> str:
        place, key = self._place, service_of(Truth).key
        onlooker = self._stack.enter_context(closing(place.onlooker()))

        def arrived(_key: str, data: bytes) -> None:
            truth = decode(data, Truth)
            self.track.put(truth.x, truth.v)

        onlooker.subscribe(key, arrived)
        words = ["sim", self.line.profile, "empty", "--namespace", place.namespace]
        words += place.joining_onlooker()
        if self.line.name == "tcp":
            port = free_port()
            place.start("", "simulator", [*words, f"--port={port}"])
            address = f"tcp://127.0.0.1:{port}"
        else:
            link = f"/tmp/{place.namespace}.tty"
            place.start("", "simulator", [*words, f"--pty={link}"])
            address = f"serial://{link}"
        self.track.until(bool, "the simulator publishes the truth")
        return address

    def _ros2(self, python: str) -> str:
        domain = os.environ.get("ROS_DOMAIN_ID") or "20"
        env = {
            **{name: value for name, value in os.environ.items() if not name.startswith("ROS_")},
            "ROS_DOMAIN_ID": domain,
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        }
        base = self._place.popen(
            "", [python, str(BASE)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=env
        )
        assert base.stdout is not None, "it is a pipe"

        def read(lines: Iterator[bytes]) -> None:
            for text in lines:
                way, speed = json.loads(text)
                self.track.put(way, speed)

        threading.Thread(target=read, args=(base.stdout,), daemon=True).start()
        self.track.until(bool, "the ROS 2 base prints its pose")
        return f"ros2://?domain={domain}&interface=lo"

    @contextmanager
    def driving(self) -> Iterator[None]:
        """Run the robot agent and what drives."""
        mesh = self._stack.enter_context(closing(self._place.mesh()))
        self.start()
        host = AgentHost([self.ahead], mesh)
        host.wait_joined()
        thread = threading.Thread(target=host.live, daemon=True)
        thread.start()
        try:
            yield
        finally:
            host.request_stop()
            thread.join()
            host.leave()
            self._stack.close()

    def start(self) -> None:
        """Start a robot agent, once the one before has ended."""
        if self._agent is not None:
            self._agent.wait()
        words = ["robot", "--namespace", self._place.namespace]
        words += ["--set", f"port={self.address}", "--set", f"profile={self.line.profile}"]
        if self._program:
            nowhere = subprocess.DEVNULL
            command = [self._program, *words]
            self._agent = self._place.popen("", command, stdout=nowhere, stderr=nowhere)
        else:
            self._agent = self._place.start("", "robot", ["agent", *words])

    def make(self, fault: str) -> Trial:
        """Drive, make a fault, and see what becomes of it. Raises TimeoutError."""
        track = self.track
        self.drive()
        time.sleep(random.uniform(0.0, CYCLE_S))  # samples keep step with the robot agent's writes
        number = signal.SIGKILL if fault.startswith("kill") else signal.SIGSTOP
        target = self.guard if fault.endswith("guard") else self.robot
        at = time.monotonic()
        target.send_signal(number)
        before = track.samples[-1][2]
        self.ahead.speed = 0.0
        try:
            end, rolls_on = self.awaits_rest(at), False
        except TimeoutError:
            end, rolls_on = track.samples[-1], True
        begins = track.brakes(at, before) or end[0]
        trial = Trial(
            self.line.name,
            fault,
            before,
            begins - at,
            end[0] - at,
            end[1] - track.at(at),
            rolls_on,
        )
        if fault == "kill":
            self.start()
        elif fault == "hang":
            self.robot.resume()
        return trial

    def drive(self) -> None:
        """Drive until it has been at speed for some time. Raises TimeoutError."""
        track, speed = self.track, self.line.speed
        self.ahead.speed = speed
        lasts, since = STEADY_S + random.uniform(0.0, PHASE_S), time.monotonic()
        track.until(lambda _: track.steady(speed, since, lasts), f"{speed} m/s")

    def awaits_rest(self, since: float | None = None) -> Sample:
        """Return the first sample at which it rests. Raises TimeoutError."""
        after = time.monotonic() if since is None else since
        self.track.until(lambda _: self.track.rest(after) is not None, "rest")
        rest = self.track.rest(after)
        assert rest is not None, "it was awaited"
        return rest

    @property
    def robot(self) -> psutil.Process:
        """The robot agent's process."""
        assert self._agent is not None, "it was started"
        return psutil.Process(self._agent.pid)

    @property
    def guard(self) -> psutil.Process:
        return next(p for p in self.robot.children() if "armadico.runtime.guard" in p.cmdline())


def roll(line: Line, fault: str, count: int, *, program: str = "", python: str = "") -> list[Trial]:
    """Make one fault so often over one line."""
    with Place(f"rolling-{line.name}") as place:
        rig = Rig(line, place, program, python or sys.executable)
        with rig.driving():
            return [rig.make(fault) for _ in range(count)]


def main() -> None:
    """`python -m armadico_tools.bench.rolling LINE FAULT COUNT [PROGRAM [PYTHON]]`."""
    line, fault, count, *others = sys.argv[1:]
    program = "".join(others[:1])
    trials = roll(LINES[line], fault, int(count), program=program, python="".join(others[1:2]))
    show_trials(trials, ("begins_s", "rest_s", "roll_m"))


if __name__ == "__main__":
    main()
