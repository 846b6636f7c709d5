"""One run: societies start, their errand is handed over, and it is watched to its end.

`Run` is the life of every run, over one robot or over several. `RobotRun` is one robot's; what
starts its society is `launch.virtual` (in this process, under a virtual clock), `launch.local`
(processes on this machine) or `launch.attached` (somebody else). A run of several robots is made of
such runs, by a capability whose entry point is in the group `armadico.runs`. A run decides nothing:
kill it and the societies drive on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from armadico.config.discovery import GUESTS, agent_class, installed, owners
from armadico.config.scenarios import Scenario, mission_of
from armadico.config.worlds import bare, load_world
from armadico.core.agent import WARNING
from armadico.core.cycles import LISTEN
from armadico.core.messages import Claim, Log, LogEvent, Message, RobotState
from armadico.core.resources import WHEELS
from armadico.launch.society import LIVE, Options, errand, names, time_limit, watch
from armadico.mesh.base import Mesh
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.messages import Correction, Pose
from armadico.observe.measures import Result, RunWatch, watched
from armadico.runtime.client import Client
from armadico.runtime.errors import RunFailedError

HEAR_S = 5.0
"""What the interface agent may take to be found; its plan may take longer."""

LINKS_S = 2.0
"""A refusal stands after this: among processes that have just started, links are coming up."""

SILENT_S = 10.0
"""A run whose robot has published nothing for so long is over."""

IDLE_S = 15.0
"""A run without a claim for the wheels for so long is over, if an agent is missing."""

R_co = TypeVar("R_co", covariant=True)


class Watch(Protocol[R_co]):
    """What a run comes to, by the messages of its robots."""

    def end(self, limit: float) -> None:
        """The time that it may take (s) is over."""

    def result(self) -> R_co:
        """The row, as far as it has come."""


R = TypeVar("R")
W = TypeVar("W", bound=Watch[Any])


def _drives(name: str) -> bool:
    """Whether an agent contends for the wheels of a robot that knows where it is."""
    kind = agent_class(name)
    return WHEELS in kind.competes_for and not (issubclass(kind, Behaviour) and kind.seeks)


class Run(Generic[W, R]):
    """The life of a run; a context manager, since whoever leaves it has something to leave.

    Attributes:
        scenario: What is driven, and who takes part.
        options: What else was chosen for the run.
        watch: What it comes to.
        limit: How long it may take, s, once it has begun.
    """

    watch: W

    step_s = 0.2
    """How often progress is reported and the societies are checked."""

    def __init__(self, scenario: Scenario, options: Options) -> None:
        self.scenario = scenario
        self.options = options
        self.limit = time_limit(0.0, options)
        self._warn: Callable[[str], None] = lambda _: None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave things as they should be left, whatever happened."""

    @property
    def over(self) -> bool:
        """Whether nothing is left to be done."""
        raise NotImplementedError

    def now(self) -> float:
        """The time by which it is limited, s."""
        raise NotImplementedError

    def report_to(self, warn: Callable[[str], None]) -> None:
        """Have what goes wrong, and who is gone, passed to a function."""
        self._warn = warn

    def start(self) -> None:
        """See that all agents are alive. Raises RunFailedError if one is not."""
        raise NotImplementedError

    def begin(self) -> float:
        """Hand the errand over, if there is one; returns since when the time counts, s.

        Raises MissionRefusedError or AbsentError.
        """
        raise NotImplementedError

    def wait(self, seconds: float) -> None:
        """Let it drive for so long, or until it is over."""
        raise NotImplementedError

    def goes_on(self, elapsed: float) -> bool:
        """Called at each step, s after the beginning. Raises RunFailedError if it cannot go on."""
        raise NotImplementedError

    def run(
        self,
        progress: Callable[[W], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> R:
        """Drive until it is over or its time is up; `warn` is told what goes wrong meanwhile."""
        if warn is not None:
            self.report_to(warn)
        self.start()
        begun = self.begin()
        end = begun + self.limit  # and not what is left of it: that may be too little to be added
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
    """One robot's run of a scenario; what differs between societies is in its subclasses."""

    mode: str
    """How it is driven, as its conditions name it."""

    again_s = 0.0
    """A mission that is refused is asked for again for so long."""

    def __init__(self, scenario: Scenario, options: Options, client: Client) -> None:
        """Prepare; `client` is the guest that hands the mission over."""
        super().__init__(scenario, options)
        self.names = names(scenario, options.without)
        self.client = client
        self.watch = watch(scenario, options, self.mode, client.mesh.namespace)
        self._warned = ""
        self._guests = [found.load()(scenario) for found in installed(GUESTS).values()]

    @property
    def over(self) -> bool:
        return self.watch.done

    def now(self) -> float:
        return self.client.mesh.now()

    def begin(self) -> float:
        request = errand(self.scenario, self.options)
        if request is None:
            self.watch.begin()
            return self.now()
        reply = self.client.hand_over(request, find=HEAR_S, again=self.again_s)
        self.limit = time_limit(reply.length, self.options, mission_of(self.scenario))
        self.watch.begin(reply.mission)
        return self.now()

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """See `Run`; said before is what will keep it from driving, and after it what misled it."""
        if warn is not None:
            self.report_to(warn)
        if warning := bare(self.scenario.world):
            self._warn(warning)
        if not any(map(_drives, self.names)):
            self._warn(
                "nobody contends for the wheels: no agent that would drive takes part, so the robot"
                " will stand"
            )
        result = super().run(progress)
        if self.watch.astray is not None:
            metres, turned = self.watch.astray
            self._warn(
                "by its pose the robot is at the goal, and in truth it is not: the pose is"
                f" {metres:.2f} m and {turned:.1f} degrees off{self._unaided()}"
            )
        return result

    def _unaided(self) -> str:
        """Why nothing corrects the pose, in a half sentence; empty if somebody might."""
        if not any(Correction in agent_class(name).provides for name in self.names):
            return ", since nobody localizes"
        walls = load_world(self.scenario.world).outlines
        if walls:
            return ""
        return ", since there is no wall to localize against; with `--sensors ideal` nothing drifts"

    def wait(self, seconds: float) -> None:
        self.client.wait_for(lambda: self.watch.done, seconds)

    def goes_on(self, elapsed: float) -> bool:
        """See `Run`: those who take part besides agents have their turn."""
        for guest in self._guests:
            for message in guest.due(elapsed, self.watch.errand):
                self.client.publish(message)
        return True

    def pass_on(self, key: str, message: Message) -> None:
        """Pass on what an agent logs of faults, with whose it is; nothing twice running."""
        if isinstance(message, Log) and message.level >= WARNING and message.text != self._warned:
            self._warned = message.text
            name = key.rpartition("/")[2].rpartition("-")[0]
            said = message.text.startswith(name)
            self._warn(message.text if said else f"{name}: {message.text}")


class LiveRun(RobotRun):
    """A run over a real mesh."""

    mode = LIVE
    again_s = LINKS_S

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        mesh: Mesh,
        *,
        silent_s: float = SILENT_S,
        idle_s: float = IDLE_S,
    ) -> None:
        """Prepare.

        Args:
            scenario: What is driven, and who takes part.
            options: What else was chosen for the run.
            mesh: Where to listen.
            silent_s: A run whose robot has published nothing for so long is over.
            idle_s: So is one in which nobody has claimed the wheels for so long, if somebody who
                takes part is missing.
        """
        super().__init__(scenario, options, Client(mesh))
        self._silent_s = silent_s
        self._idle_s = idle_s
        self._strangers: set[str] = set()
        self.client.listen(*watched(), then=self.watch.update)
        self._unfit = ""
        self.client.listen(Log, then=lambda log, _: self._hear_log(log))

    def goes_on(self, elapsed: float) -> bool:
        self.poll()
        return super().goes_on(elapsed) and not self._nobody_can(elapsed)

    def poll(self) -> None:
        """Called now and then while it runs.

        Raises RunFailedError if the robot is silent, or another one has come in its place.
        """
        if self._unfit:
            raise RunFailedError(self._unfit)
        if self.watch.mixed:
            raise RunFailedError(
                f"the robot's controller is {self.watch.mixed} now, and was another one when the"
                " run began: what was measured is of two robots"
            )
        for name in self.watch.view.strangers(self.client.mesh.now()):
            if name not in self._strangers:
                self._strangers.add(name)
                self._warn(
                    f"another simulator speaks in the namespace {self.client.mesh.namespace!r}:"
                    f" {name or 'of an older version'}; it is not this run's, and nothing of it is"
                    " counted"
                )
        if self.client.age(RobotState) > self._silent_s:
            raise RunFailedError(
                f"the robot has said nothing for {self._silent_s:g} s; {self.words_of_the_robot()}"
            )

    def wait_on(self) -> None:
        """Let the society be for a step. Raises RunFailedError if the robot is silent."""
        self.client.wait_for(lambda: None, self.step_s)
        self.poll()

    def words_of_the_robot(self) -> str:
        """What is known of a robot that does not answer."""
        return "`armadico ps` shows whether its agent is there, `armadico logs -f` what it says"

    # Inside --------------------------------------------------------------------------------------

    def _hear_log(self, message: Message) -> None:
        """A robot that the profile does not fit ends the run, with the reason."""
        if isinstance(message, Log) and message.event == LogEvent.UNFIT:
            self._unfit = message.text
        else:
            self.pass_on(self.client.key, message)

    def _ready_to_drive(self) -> bool:
        """Whether the robot talks and obeys, and whoever provides its pose knows where it is.

        Raises RunFailedError if it is another robot than the profile's.
        """
        kinds: list[type[Message]] = [RobotState]
        if any(Pose in agent_class(name).provides for name in self.names):
            kinds.append(Pose)
        if self._unfit:
            raise RunFailedError(self._unfit)
        state = self.client.latest(RobotState)
        listens = state is None or state.cycle.number <= LISTEN  # and refuses, meanwhile
        described = self.watch.view.description is not None  # and whose truth is the robot's
        return described and not listens and all(self.client.age(kind) < 1.0 for kind in kinds)

    def _missing(self) -> list[str]:
        """Who takes part and has no token; twice, if both of two are gone."""
        alive = Counter(name for name, _ in self.client.alive)
        return sorted((Counter(self.names) - alive).elements())

    def _robots(self) -> list[tuple[str, str]]:
        """The robot agents in the namespace, whoever started them: name and instance."""
        robots = {*owners({name for name, _ in self.client.alive}, WHEELS)}
        return sorted(who for who in self.client.alive if who[0] in robots)

    def _nobody_can(self, elapsed: float) -> bool:
        """Whether the wheels are not claimed any more, and an agent that takes part is missing."""
        state = self.watch.view.state
        # One of two that is left can, so far as its kind is needed.
        missing = sorted({*self._missing()} - {name for name, _ in self.client.alive})
        if state is None or state.stop.stopped or not missing:
            return False
        if min(self.client.age(Claim), elapsed) < self._idle_s:
            return False
        self._warn(
            f"nobody has claimed the wheels for {self._idle_s:g} s, and {', '.join(missing)}"
            f" {'is' if len(missing) == 1 else 'are'} gone: the run is over"
        )
        return True
