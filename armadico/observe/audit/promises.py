"""What is promised, what a rule finds, and what excuses a robot."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from armadico.core.judgement import Answer


class Promise(StrEnum):
    """The promises. Some need more than messages: the fault bed alone can check those."""

    # By messages, wherever they come from
    ONE_DRIVER = "within an epoch the ballots that are obeyed never decrease"
    FRESH = "commands for a cycle long past are rejected, however late they arrive"
    ORDERED = "what the agent that is obeyed commands is ordered, and turned by the base"
    ODOMETRY = "the odometry moves along its heading, and as far as the robot"
    COLLISION = "the robot does not touch anything"
    ARRIVES = "a mission is reached in the time that its path takes"
    REACHED = "a goal that is reported as reached is reached"
    FAILED = "a mission fails, or is refused, for a cause that was seen"
    SPEED = "the robot drives as fast as it may, or the reason is published"
    STANDS = "a robot with a free path does not stand"
    FOUND = "a robot that is lost finds its place again"
    HONEST = "no agent keeps commanding what readings forbid"
    EARNED = "no speed is let through that the robot's readings forbid"
    PATH = "a planned path leads through no wall of the map"
    HELD = "an agent that took the wheels for a mission releases them after it"
    STEADY = "no agent takes and loses the wheels again and again"
    SENSORS = "readings change as the robot moves, and agree with what is there"
    BRAKES = "the robot brakes along its ramp"
    STOP = "once stopped the wheels rest in time, and no agent drives until it is released"
    POSE = "the error of the pose is within its covariance"

    # By what only the fault bed knows: the line to the controller, bids, faults
    ONE_HOLDER = "in a whole network no two tenures overlap for 5 cycles"
    OBEYED = "in a whole network a command is obeyed within 5 s if an agent bids"
    SILENCE = "a stop is ordered within 0.4 s of the last valid command"
    WATCHDOG = "without the robot agent the guard of its line stops the wheels"
    SMOOTH = "speeds change within the ramps, and a takeover stays between both actions"
    NO_ERROR = "no agent raises an error"
    MOVES = "after healing the robot moves within 2 s (5 s after standing back), or bids say why"
    HANDOVER = "a holder that falls silent is replaced before the stop, if another bids"


class Excuse(StrEnum):
    """What excuses a robot from a promise. An excuse that no run needs should go."""

    STOPPED = "a stop is latched"
    LOST = "the pose is too uncertain to drive"
    WAITS = "no path is free"
    BLOCKED = "an obstacle is near its front or flanks"
    BY_HAND = "a person drives"
    LED = "an agent leads it, such as into a dock"
    FAULT = "the robot agent says why it cannot be driven"  # this ends a mission
    CAPPED = "the robot agent published why it drives slower than ordered"
    SILENT = "the robot agent publishes nothing"
    UNSURE = "the pose does not claim to know its place within the tolerance of a goal"
    DISTURBED = "the observer knows of a disturbance"


# No Struct: commands show these in --help, which imports no msgspec.
@dataclass(frozen=True, slots=True)
class Finding:
    """What a rule found out about a promise.

    Attributes:
        promise: The promise.
        at: When, s of the observer's clock.
        who: The agent, sensor or instance that is responsible; "" if nobody is.
        what: A sentence.
        evidence: The numbers and messages that it follows from.
        occasion: Whether there was one to break the promise. Without one nothing is missing.
        answer: No: the promise was broken. Unknown: it could not be checked, and `what` says what
            was missing. Yes: it was kept so far.
    """

    promise: Promise
    at: float
    who: str
    what: str
    evidence: str = ""
    answer: Answer = Answer.NO
    occasion: bool = True

    @property
    def text(self) -> str:
        """Who, what and the evidence, in a line."""
        who = f"{self.who}: " if self.who else ""
        return f"{who}{self.what}{self.evidence and f' ({self.evidence})'}"

    def __str__(self) -> str:
        return f"{self.promise.name}: {self.text}"
