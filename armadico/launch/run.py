"""Runs: start a society, send its mission, and watch it until the end.

`Run` is the life cycle of every run, of one or several robots. `RobotRun` is one robot's run. Its
society is started by `launch.virtual` (in this process under a virtual clock) or `launch.local`
(processes on this machine), or is already running (`launch.attached`). A run of several robots
consists of such runs; its entry point is in the group `armadico.runs`. A run decides nothing: if it
is killed, the society continues.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from armadico.config.scenarios import Scenario, mission_of, unmapped
from armadico.config.worlds import doubts, load_world
from armadico.core.agent import WARNING
from armadico.core.cycles import LISTEN
from armadico.core.discovery import GUESTS, agent_class, owners
from armadico.core.installed import made
from armadico.core.membership import agent_of
from armadico.core.messages import Claim, Log, LogEvent, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.launch.client import Client
from armadico.launch.society import LIVE, Options, errand, names, time_limit, watch
from armadico.mesh.base import Mesh
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.messages import Correction, Pose
from armadico.observe.measures import Phase, Result, RunWatch, watched
from armadico.runtime.errors import RunFailedError

FIND_S = 5.0
"""Time to find the interface agent; its plan may take longer."""

LINKS_S = 2.0
"""A mission is sent again for so long if it is rejected: links between new processes come up."""

SILENT_S = 10.0
"""A run ends if its robot publishes nothing for so long."""

IDLE_S = 15.0
"""A run ends without a claim for the wheels for so long, if an agent is missing."""

R_co = TypeVar("R_co", covariant=True)


class Watch(Protocol[R_co]):
    """The measures of a run, from the messages of its robots."""

    def end(self, limit: float) -> None:
        """Called when the time limit, s, is over."""

    def result(self) -> R_co:
        """The present result."""


R = TypeVar("R")
W = TypeVar("W", bound=Watch[Any])


def _drives(name: str) -> bool:
    """Whether an agent competes for the wheels of a localized robot."""
    kind = agent_class(name)
    return WHEELS in kind.competes_for and not (issubclass(kind, Behaviour) and kind.seeks)


class Run(Generic[W, R]):
    """The life cycle of a run, as a context manager."""

    watch: W  # its measures

    step_s = 0.2
    """Period of progress reports and checks, s."""

    def __init__(self, scenario: Scenario, options: Options) -> None:
        self.scenario = scenario  # the scenario and its agents
        self.options = options  # the other options of the run
        self.limit = time_limit(0.0, options)  # its time limit, s, from `begin` on
        self._warn: Callable[[str], None] = lambda _: None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Clean up, also after an error."""

    @property
    def over(self) -> bool:
        """Whether the run is done."""
        raise NotImplementedError

    def now(self) -> float:
        """The clock of the time limit, s."""
        raise NotImplementedError

    def report_to(self, warn: Callable[[str], None]) -> None:
        """Set the function that receives warnings."""
        self._warn = warn

    def start(self) -> None:
        """Start the agents, or wait for them. Raises RunFailedError if one is missing."""
        raise NotImplementedError

    def begin(self) -> float:
        """Send the mission, if there is one; returns the time when the run begins, s.

        Raises MissionRefusedError or AbsentError.
        """
        raise NotImplementedError

    def wait(self, seconds: float) -> None:
        """Wait for so long, or until the run is over."""
        raise NotImplementedError

    def goes_on(self, elapsed: float) -> bool:
        """Whether to continue; called at each step, s after the beginning.

        Raises RunFailedError if the run cannot continue.
        """
        raise NotImplementedError

    def run(
        self,
        progress: Callable[[W], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> R:
        """Drive until the run is over or its time is up; `warn` receives warnings."""
        if warn is not None:
            self.report_to(warn)
        self.start()
        begun = self.begin()
        end = begun + self.limit  # an end time, since a small remainder may vanish in rounding
        while not self.over and self.now() < end:
            self.wait(min(self.step_s, end - self.now()))
            if progress is not None:
                progress(self.watch)
            if not self.goes_on(self.now() - begun):
                break
        else:
            self.watch.end(self.limit)
        result: R = self.watch.result()
        return result


class RobotRun(Run[RunWatch, Result]):
    """The run of one robot; subclasses start or find its society."""

    mode: str
    """The mode in the conditions of the result."""

    again_s = 0.0
    """A rejected mission is sent again for so long, s."""

    def __init__(self, scenario: Scenario, options: Options, client: Client) -> None:
        """`client` sends the mission."""
        super().__init__(scenario, options)
        self.names = names(scenario, options.without)
        self.client = client
        self.watch = watch(scenario, options, self.mode, client.mesh.namespace)
        self._warned = ""
        self.report_to(self._warn)
        self._guests = made(GUESTS, "due", scenario)

    @property
    def over(self) -> bool:
        return self.watch.done

    def now(self) -> float:
        return self.client.mesh.now()

    def report_to(self, warn: Callable[[str], None]) -> None:
        """See `Run`. The measures keep the warnings, too."""

        def keep(text: str) -> None:
            self.watch.warnings.append(text)
            warn(text)

        self._warn = keep

    def begin(self) -> float:
        request = errand(self.scenario, self.options)
        if request is None:
            self.watch.begin()
            return self.now()
        reply = self.client.request_mission(request, find=FIND_S, again=self.again_s)
        self.limit = time_limit(reply.length, self.options, mission_of(self.scenario))
        self.watch.begin(reply.mission)
        return self.now()

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """See `Run`. Warns before if the robot will not drive, and after if its pose was wrong."""
        if warn is not None:
            self.report_to(warn)
        for doubt in doubts(self.scenario.world):
            self._warn(doubt)
        if not any(map(_drives, self.names)):
            self._warn("no agent competes for the wheels, so the robot will not drive")
        self.watch.unaided = self._unaided()
        super().run(progress)
        self.read_bids()
        if self.watch.mistaken:
            self._warn(self.watch.mistaken)
        return self.watch.result()

    def _unaided(self) -> str:
        """The reason why nothing corrects the pose, or ""."""
        if not any(Correction in agent_class(name).provides for name in self.names):
            return " (no agent localizes)"
        if unmapped(self.scenario) or load_world(self.scenario.world).outlines:
            return ""
        return " (no walls to localize against; `--sensors ideal` has no drift)"

    def read_bids(self) -> None:
        """Have the measures learn the bids that agents keep, if that takes no messages."""

    def wait(self, seconds: float) -> None:
        self.client.wait_for(lambda: self.watch.done, seconds)

    def goes_on(self, elapsed: float) -> bool:
        """See `Run`. Publishes the messages of guests, such as alarms."""
        for guest in self._guests:
            for message in guest.due(elapsed, self.watch.errand):
                self.client.publish(message)
        return True

    def pass_on(self, key: str, message: Message) -> None:
        """Report an agent's warning with the agent's name, unless it repeats the last one."""
        if isinstance(message, Log) and message.level >= WARNING and message.text != self._warned:
            self._warned = message.text
            name = agent_of(key.rpartition("/")[2])
            named = message.text.startswith(name)
            self._warn(message.text if named else f"{name}: {message.text}")


class LiveRun(RobotRun):
    """A run over a real mesh."""

    mode = LIVE
    again_s = LINKS_S

    def __init__(self, scenario: Scenario, options: Options, mesh: Mesh) -> None:
        super().__init__(scenario, options, Client(mesh))
        self._strangers: set[str] = set()
        self.client.listen(*watched(), then=self.watch.update)
        self._unfit = ""
        self.client.listen(Log, then=lambda log, _: self._on_log(log))

    def goes_on(self, elapsed: float) -> bool:
        self.poll()
        lost = self.watch.phase is Phase.LOST
        return super().goes_on(elapsed) and not lost and not self._abandoned(elapsed)

    def poll(self) -> None:
        """Check the society. Raises RunFailedError if the robot is silent or has changed."""
        if self._unfit:
            raise RunFailedError(self._unfit)
        if self.watch.mixed:
            raise RunFailedError(
                f"the robot's controller is {self.watch.mixed} now, and was"
                f" {self.watch.controller} when the run began: this is another robot, or its driver"
                " was restarted under another name, and the measures may be of two robots"
            )
        for name in self.watch.view.strangers(self.client.mesh.now()):
            if self.watch.truth.broken:
                break  # the judgement has the reason
            if name not in self._strangers:
                self._strangers.add(name)
                self._warn(
                    "another simulator publishes in the namespace"
                    f" {self.client.mesh.namespace!r}: {name or 'of an older version'}; it is"
                    f" ignored{self._claimed(name)}"
                )
        if self.client.age(RobotState) > SILENT_S:
            silent = f"no message from the robot for {SILENT_S:g} s"
            truth = self.watch.truth
            if truth.newest is not None and truth.gap(self.client.mesh.now()):
                self.watch.lose(f"{silent}, and none from its simulator")
                self._warn(f"{silent}, and none from its simulator: the run is over")
                return
            raise RunFailedError(f"{silent}; {self.robot_advice()}")

    def wait_on(self) -> None:
        """Wait for one step. Raises RunFailedError as `poll`."""
        self.client.wait_for(lambda: None, self.step_s)
        self.poll()

    def _claimed(self, simulator: str) -> str:
        """What to do if that simulator is the robot's."""
        there = self.options.robot is not None and not self.options.simulator and simulator
        return f"; if it is the robot's: --simulator {simulator}" if there else ""

    def robot_advice(self) -> str:
        """What to do about a robot that does not answer."""
        return "`armadico ps` lists alive agents, `armadico logs -f` shows their logs"

    # Inside --------------------------------------------------------------------------------------

    def _on_log(self, message: Message) -> None:
        """Report a warning; a robot that does not fit the profile ends the run."""
        if isinstance(message, Log) and message.event == LogEvent.UNFIT:
            self._unfit = message.text
        elif not self._unfit:  # what follows from it would only hide the reason
            self.pass_on(self.client.key, message)

    def _ready_to_drive(self) -> bool:
        """Whether the robot reports and obeys, and its pose is published.

        Raises RunFailedError if the robot does not fit the profile.
        """
        kinds: list[type[Message]] = [RobotState]
        if any(Pose in agent_class(name).provides for name in self.names):
            kinds.append(Pose)
        if self._unfit:
            raise RunFailedError(self._unfit)
        state = self.client.latest(RobotState)
        listens = state is None or state.cycle.number <= LISTEN  # it refuses commands until then
        described = self.watch.view.description is not None  # which names its simulator
        return described and not listens and all(self.client.age(kind) < 1.0 for kind in kinds)

    def _missing(self) -> list[str]:
        """The participating agents that are not alive; a redundant one may be listed twice."""
        alive = Counter(name for name, _ in self.client.alive)
        return sorted((Counter(self.names) - alive).elements())

    def _robots(self) -> list[tuple[str, str]]:
        """(name, instance) of all robot agents in the namespace."""
        robots = {*owners({name for name, _ in self.client.alive}, WHEELS)}
        return sorted(agent for agent in self.client.alive if agent[0] in robots)

    def _abandoned(self, elapsed: float) -> bool:
        """Whether no agent claims the wheels any more, and a participating agent is missing."""
        state = self.watch.view.state
        # One of two redundant agents is enough.
        missing = sorted({*self._missing()} - {name for name, _ in self.client.alive})
        if state is None or state.stop.stopped or not missing:
            return False
        if min(self.client.age(Claim), elapsed) < IDLE_S:
            return False
        why = (
            f"no agent has claimed the wheels for {IDLE_S:g} s, and {', '.join(missing)}"
            f" {'is' if len(missing) == 1 else 'are'} missing"
        )
        self.watch.note = self.watch.note or why
        self._warn(f"{why}: the run is over")
        return True
