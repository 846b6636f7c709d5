"""What an observer finds out about a society: one type for all commands (sans-IO).

A finding has a code, what it is about, an answer, a sentence and a cure. `observe.standing` finds
why the robot stands; `observe.diagnosis` makes all checks.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from armadico.core.judgement import Answer, Judgement, all_of


class Sort(StrEnum):
    """The code of a finding: what is wrong, or what was checked."""

    STOP = "stop"  # an emergency stop is latched
    MOTORS = "motors"  # the motors are off
    STARTING = "starting"  # too early to judge: an agent, its inputs or this observer are new
    STALLED = "stalled"  # the wheels are blocked or not driven
    CHARGING = "charging"
    NO_GOAL = "no goal"
    REFUSED_GOAL = "refused goal"  # the last goal was refused
    PLANNING = "planning"
    REACHED = "reached"
    UNSURE = "unsure"  # the mission ended, and the pose does not tell whether at the goal
    FAILED = "failed"  # the mission failed
    NO_WAY = "no way"  # it waits for a path to become free
    LOST = "lost"  # the pose is too uncertain to drive
    BLOCKED = "blocked"  # the agent that drives finds no free path
    ABSENT = "absent"  # an agent is not alive
    SILENT = "silent"  # an agent is alive and publishes or answers nothing
    UNREACHABLE = "unreachable"  # the robot's router, and with it all agents
    HOST = "host"  # all agents of a host are gone, or the host is disconnected
    LINK = "link"  # publications or queries do not arrive
    STALE = "stale"  # an agent publishes data of old cycles
    DEVICE = "device"  # the controller, its line or its port
    UNSOUND = "unsound"  # an agent's bid is invalid
    REFUSED = "refused"  # the owner refuses the holder's commands
    FOREIGN = "foreign"  # an agent uses another protocol or another declaration of a resource
    OUTBID = "outbid"  # another agent's bid is better
    RELEASED = "released"  # the holder released the resource
    BUMPED = "bumped"  # a person walked into the robot
    UNSEEN = "unseen"  # no sensor detected the obstacle that the robot touched
    DRIVEN = "driven"  # the obstacle was detected, and the robot was driven into it
    UNKNOWN = "unknown"  # the messages received do not show a cause
    MOVES = "moves"  # the robot moves
    AGENTS = "agents"  # the agents that are alive, and those that should be
    VERSION = "version"  # of the program, or of its protocol
    TABLE = "table"  # host tables
    TWICE = "twice"  # two agents or simulators publish the same
    MIXED = "mechanisms"  # agents compete for a resource by different coordination mechanisms
    FAULT = "reported"  # an agent reports that it cannot work, or distrusts its inputs
    HAND = "by hand"  # a person drives
    BATTERY = "battery"
    LINE = "line"  # the bytes from the controller
    POSE = "pose"
    MAP = "map"
    CLOCK = "clock"
    SLOW = "slow"  # an agent publishes less often than it promises
    LATE = "late"  # the mission is not reached in the time that its path should take
    MONITOR = "monitor"
    ACTION = "action"  # the last action of the active monitor, or of a host, with the evidence
    PROMISE = "promise"  # a monitor found that the society did not do what it promises
    KEYS = "keys"  # a file of keys on this computer cannot be read
    EXPIRY = "expiry"  # a certificate is about to expire, and was not renewed
    OPEN = "open"  # the robot's port is open to every program that reaches it
    MACHINE = "machine"  # this machine: packages, ports, memory, disk


_YES: Final = frozenset(
    {
        *(Sort.NO_GOAL, Sort.REFUSED_GOAL, Sort.PLANNING, Sort.REACHED, Sort.CHARGING),
        *(Sort.OUTBID, Sort.RELEASED, Sort.MOVES),
    }
)
_OPEN: Final = frozenset({Sort.STARTING, Sort.UNSURE, Sort.UNKNOWN})


# No Struct: --help of the commands imports no msgspec.
@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check, or the cause of an event."""

    sort: Sort  # its code
    # What it is about: an agent's name, a host, a key, a link (`a -> b`), or the sender of a stop.
    # It may be empty.
    who: str
    what: str  # A sentence
    todo: str = ""  # The cure, or how to make it known. With the answer yes it is advice.
    answer: Answer = Answer.NO  # Whether all is well. Unknown never counts as yes.

    def __str__(self) -> str:
        return f"{self.what} -> {self.todo}" if self.todo else self.what


def cause(sort: Sort, who: str, what: str, todo: str = "") -> Finding:
    """A cause, with the answer that its code implies."""
    answer = Answer.YES if sort in _YES else Answer.UNKNOWN if sort in _OPEN else Answer.NO
    return Finding(sort, who, what, todo, answer)


def fine(sort: Sort, who: str, what: str, todo: str = "") -> Finding:
    return Finding(sort, who, what, todo, Answer.YES)


def open_question(sort: Sort, who: str, what: str, todo: str = "") -> Finding:
    """A check that could not be made: `what` has the reason, `todo` how to make it known."""
    return Finding(sort, who, what, todo, Answer.UNKNOWN)


# What is demanded ---------------------------------------------------------------------------------

Installed = Callable[[str], Iterable[str]]  # by key, the installed agents that publish on it
Hosts = Mapping[str, Sequence[str]]  # by host, the agents that it should run


@dataclass(frozen=True)
class Demand:
    """What a society should be, by its host table, or by the launcher of this machine."""

    # By host, the agents that it should run; empty: not known.
    hosts: Hosts = field(default_factory=dict)
    table: str = ""  # the digest of the host table (`HostTable.digest`); empty: none
    # Candidates for missing agents. A new observer has no cards of agents that ended before it
    # started.
    installed: Installed = lambda _: ()
    # The endpoint of the robot's router, if any program that reaches it may drive; empty: none, or
    # not known.
    open: str = ""
    # Returns the certificates that soon end a link, and in how many seconds.
    ending: Callable[[], Mapping[str, float]] = dict
    # Returns which files of keys on this computer cannot be read, a sentence each.
    unread: Callable[[], Sequence[str]] = tuple

    def host_of(self, agent: str) -> str:
        """The first host that should run an agent; empty if none."""
        return next((host for host, agents in self.hosts.items() if agent in agents), "")

    def starts(self, host: str) -> str:
        """How the agents of a host are started."""
        if not self.table:  # it is this machine, on which `armadico up` runs without a host table
            return f"`armadico up`, run on {host}, starts its agents"
        return f"`armadico up --host {host}`, run on {host} with its host table, starts its agents"

    def restarts(self, agent: str, host: str) -> str:
        """How an agent that ended on a host is started again."""
        if agent == LAUNCHER:
            return self.starts(host)
        return f"start it again: `armadico-agent {agent}`"


LAUNCHER: Final = "wakeup"
"""The agent that `armadico up` itself is."""

NOTHING: Final = Demand()

UP: Final = "`armadico up` starts a society; --namespace, --hosts and --connect select another"


# In words -----------------------------------------------------------------------------------------


def those(findings: Iterable[Finding], answer: Answer) -> list[Finding]:
    return [each for each in findings if each.answer is answer]


def judgement(findings: Iterable[Finding]) -> Judgement:
    """The judgement of all findings."""
    return all_of(Judgement(each.answer, each.what, each.todo) for each in findings)


_SIGHT: Final = frozenset(
    {
        *(Sort.ABSENT, Sort.SILENT, Sort.UNREACHABLE, Sort.HOST, Sort.LINK, Sort.STALE),
        *(Sort.DEVICE, Sort.UNKNOWN),
    }
)


def sight(findings: Sequence[Finding]) -> int:
    """The exit code of a command that shows a society: 0 only if all of it was seen.

    1: something that should be there is not, or does not answer; 3: that is not known. What was
    seen may be wrong: a robot that is stopped, or that finds no way.
    """
    blind = {each.answer for each in findings if each.sort in _SIGHT}
    if Answer.NO in blind:
        return Judgement(Answer.NO).exit_code
    # Without a fresh state of the robot the battery is not known, nor anything else of it.
    level = {each.answer for each in findings if each.sort is Sort.BATTERY}
    unseen = not findings or Answer.UNKNOWN in blind | level
    return Judgement(Answer.UNKNOWN if unseen else Answer.YES).exit_code


def summary(findings: Sequence[Finding]) -> str:
    """All findings in a line: `nothing is wrong` only if each check was made and passed."""
    wrong, unknown = len(those(findings, Answer.NO)), len(those(findings, Answer.UNKNOWN))
    if findings and not wrong and not unknown:
        return "nothing is wrong"
    return f"{wrong} wrong, {unknown} unknown of {len(findings)} checks"


def short(findings: Sequence[Finding], without: Container[tuple[Sort, str]] = ()) -> list[str]:
    """What is open or wrong, a line for each, and where to read more; nothing if all is well.

    For commands that show something else. What is unknown is only counted there, and findings
    `without`, by code and subject, were shown already.
    """
    wrong = [each for each in those(findings, Answer.NO) if (each.sort, each.who) not in without]
    lines = [f"open: {each}" for each in findings if each.sort is Sort.OPEN]
    lines += [f"wrong: {each}" for each in wrong]
    if judgement(findings).answer is not Answer.YES and findings:
        lines.append(f"{summary(findings)}: see `armadico doctor`")
    return lines
