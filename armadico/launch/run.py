"""One run of a society that is really there: the mission is handed over, and the run watched.

Whoever starts the processes, `armadico run` or `armadico up` on any machines, this decides nothing:
kill it and the society drives on.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from armadico.config.discovery import agent_class, owners
from armadico.config.scenarios import Scenario
from armadico.core.agent import WARNING
from armadico.core.cycles import LISTEN
from armadico.core.messages import Claim, Log, Message, Pose, RobotState
from armadico.core.resources import WHEELS
from armadico.launch.society import LIVE, Options, mission, names, time_limit, watch
from armadico.mesh.base import Mesh
from armadico.observe.measures import WATCHED, Result, RunWatch
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


class LiveRun:
    """A run that is watched; a context manager, since whoever leaves it has something to leave."""

    mode: str = LIVE

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
        self.scenario = scenario
        self.options = options
        self.names = names(scenario, options.without)
        self.client = Client(mesh)
        self.watch = watch(scenario, options, self.mode, mesh.namespace)
        self.limit = time_limit(0.0)
        self._silent_s = silent_s
        self._idle_s = idle_s
        self._warn: Callable[[str], None] = lambda _: None
        self._warned = ""
        self._strangers: set[str] = set()
        self.client.listen(*WATCHED, then=self.watch.show)
        self.client.listen(Log, then=self._pass_on)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave things as they should be left, whatever happened."""

    def start(self) -> None:
        """See that all agents are alive. Raises RunFailedError if one is not."""
        raise NotImplementedError

    def begin(self) -> None:
        """Hand the mission over. Raises MissionRefusedError or AbsentError."""
        reply = self.client.hand_over(mission(self.scenario), find=HEAR_S, again=LINKS_S)
        self.limit = time_limit(reply.length)
        self.watch.begin(reply.mission)

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """Drive to the goal or the time limit; `warn` is told who is gone and what goes wrong."""
        self._warn = warn or self._warn
        self.start()
        self.begin()
        begun = self.client.mesh.now()
        end = begun + self.limit
        while not self.watch.done and self.client.mesh.now() < end:
            self.client.wait_for(lambda: self.watch.done, 0.2)
            if progress is not None:
                progress(self.watch)
            self.look()
            if self._nobody_can(self.client.mesh.now() - begun):
                break
        if self.watch.astray is not None:
            self._warn(
                "by its pose the robot is at the goal, and in truth it is not: the pose is"
                f" {self.watch.astray:.2f} m off"
            )
        return self.watch.result()

    def look(self) -> None:
        """Called now and then while it runs.

        Raises RunFailedError if the robot is silent, or another one has come in its place.
        """
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

    def words_of_the_robot(self) -> str:
        """What is known of a robot that does not answer."""
        return "`armadico ps` shows whether its agent is there, `armadico logs -f` what it says"

    # Inside --------------------------------------------------------------------------------------

    def _ready_to_drive(self) -> bool:
        """Whether the robot talks and obeys, and whoever provides its pose knows where it is."""
        kinds: list[type[Message]] = [RobotState]
        if any(Pose in agent_class(name).provides for name in self.names):
            kinds.append(Pose)
        state = self.client.latest(RobotState)
        listens = state is None or state.cycle.number <= LISTEN  # and refuses, meanwhile
        described = self.watch.view.description is not None  # and whose truth is the robot's
        return described and not listens and all(self.client.age(kind) < 1.0 for kind in kinds)

    def _missing(self) -> list[str]:
        """Who takes part and has no token."""
        return sorted({*self.names} - {name for name, _ in self.client.alive})

    def _robots(self) -> list[tuple[str, str]]:
        """The robot agents in the namespace, whoever started them: name and instance."""
        robots = {*owners({name for name, _ in self.client.alive}, WHEELS)}
        return sorted(who for who in self.client.alive if who[0] in robots)

    def _nobody_can(self, elapsed: float) -> bool:
        """Whether the wheels are not claimed any more, and an agent that takes part is missing."""
        state = self.watch.view.state
        if state is None or state.stop.stopped or not (missing := self._missing()):
            return False
        if min(self.client.age(Claim), elapsed) < self._idle_s:
            return False
        self._warn(
            f"nobody has claimed the wheels for {self._idle_s:g} s, and {', '.join(missing)}"
            f" {'is' if len(missing) == 1 else 'are'} gone: the run is over"
        )
        return True

    def _pass_on(self, message: Message, _now: float) -> None:
        """Pass on what an agent logs of faults, with whose it is."""
        if isinstance(message, Log) and message.level >= WARNING and message.text != self._warned:
            self._warned = message.text
            name = self.client.key.rpartition("/")[2].rpartition("-")[0]
            said = message.text.startswith(name)
            self._warn(message.text if said else f"{name}: {message.text}")
