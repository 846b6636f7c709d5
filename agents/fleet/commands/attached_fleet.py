"""A run of a fleet that is already running, on any machines: it starts and ends no process."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing, suppress
from types import TracebackType
from typing import TYPE_CHECKING, Final

from armadico.agents.fleet.commands.run import HEAR_S, FleetRun, give, names_of, short, tasks_of
from armadico.agents.fleet.messages import FleetClaims
from armadico.core.messages import Message, RobotState
from armadico.launch.attached import COME_S, REPORT_S, STOP_S
from armadico.launch.client import PRESS_S, Client
from armadico.launch.processes import undisturbed
from armadico.launch.run import SILENT_S
from armadico.mesh.topology import MeshError, TopologyError, checked_namespace
from armadico.runtime.errors import AbsentError, MissionRefusedError, RunFailedError, SocietyError

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.launch.society import Options
    from armadico.mesh.base import Mesh

BY: Final = "armadico run"  # published as the reason of a stop


class AttachedFleet(FleetRun):
    """Watches running societies. Unless all tasks are done, it leaves their robots stopped."""

    come_s: float = COME_S

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        robots: int | None,
        fleet: str,
        join: Callable[[str], Mesh],
        *,
        scouts: Callable[[], Iterable[Mesh]] = tuple,
        replace: bool = False,
    ) -> None:
        """Set up a run; it waits for `robots` (None: one), whose namespaces are in `fleet`.

        `join` joins the mesh in a namespace; the mesh is closed at the end. `scouts` returns an
        open mesh for each new route to a router of the fleet; each passes on what all robots share.
        `replace`: give the list also instead of one that the fleet works on.
        """
        super().__init__(scenario, options, fleet)
        self._wanted, self._replace = robots or 1, replace
        self._claimed_at: dict[str, float] = {}  # each robot's last claims
        self._silent: set[str] = set()
        self._notes: dict[str, str] = {}  # the reported reasons why robots take no task
        self._meshes, self._join, self._more = ExitStack(), join, scouts
        # Shared messages are beside the robots' namespaces: any namespace of the fleet will do.
        self._scouts = [self._guest(join(names_of(fleet, 1)[0]))]

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Latch the stop of all robots if the list was accepted and is not done."""
        with undisturbed():
            if self.watch.began is not None and not self.watch.over:
                self._stop()
            self._meshes.close()

    # Starting ------------------------------------------------------------------------------------

    def find(self) -> None:
        """Find the running robots. Raises RunFailedError if there are too few."""
        if not self._seek(self._enough, REPORT_S):
            self._warn(f"waiting for {self._wanted} or more robots of the fleet {self.fleet!r}")
        if not self._seek(self._enough, self.come_s - REPORT_S):
            raise RunFailedError(self._lacking())
        self._seek(lambda: False, HEAR_S)  # the whole time, to find all robots
        self._meet()

    def start(self) -> None:
        """Find the robots, and wait until one can take a task. Raises RunFailedError if none."""
        if not self.names:
            self.find()
        soon, end = self.now() + HEAR_S, self.now() + self.come_s
        while not self._all_told() and self.now() < soon:
            self.wait_until(self._all_told, self.step_s)
        while not (able := self._able()) and self.now() < end and not self._all_stopped():
            self._say_notes()
            self.wait_until(lambda: bool(self._able()), self.step_s)
            self._meet()
        self._say_notes()
        if not able:
            raise RunFailedError(
                f"no robot of the fleet {self.fleet!r} can take a task;"
                f" `armadico resume --namespace {self.names[0]}` releases one that is stopped"
            )

    def request_mission(self) -> int:
        """See `FleetRun`: the robots that can take a task are queried one after another."""
        tasks = tasks_of(self.scenario)
        *others, last = self._able()
        try:
            for name in others:
                try:
                    return give(self.clients[name], tasks, replace=self._replace)
                except AbsentError as error:
                    self._warn(str(error))
            return give(self.clients[last], tasks, replace=self._replace)
        except MissionRefusedError as error:
            raise MissionRefusedError(f"{error.reason}; --replace gives it instead") from None

    # Watching ------------------------------------------------------------------------------------

    def goes_on(self, elapsed: float) -> bool:  # noqa: ARG002
        self._meet()
        self._say_notes()
        for name in self.names:
            told = short(name) in self.watch.status
            silent = told and self.watch.silent(short(name), self.now())
            if silent and name not in self._silent:
                self._silent.add(name)
                self._warn(f"{name}: its fleet agent is silent; other robots take its tasks")
            elif not silent and name in self._silent:
                self._silent.remove(name)
                self._warn(f"{name}: its fleet agent is back")
        if self.now() - max(self._claimed_at.values()) > SILENT_S:
            raise RunFailedError(
                f"no robot of the fleet {self.fleet!r} has published for {SILENT_S:g} s;"
                f" `armadico ps --namespace {self.names[0]}` lists the agents"
            )
        return True

    # Implementation ------------------------------------------------------------------------------

    def now(self) -> float:
        return self._scouts[0].mesh.now()

    def _guest(self, mesh: Mesh) -> Client:
        """Return a client that receives what all robots share."""
        client = Client(self._meshes.enter_context(closing(mesh)))
        client.listen(FleetClaims, then=self._on_claims)
        return client

    def _on_claims(self, message: Message, now: float) -> None:
        if isinstance(message, FleetClaims):
            with suppress(TopologyError):  # an invalid namespace is no robot's
                checked_namespace(f"{self.fleet}/{message.robot}")
                self._claimed_at[message.robot] = now

    def _seek(self, over: Callable[[], bool], seconds: float) -> bool:
        """Search for robots by all routes until a condition holds; return whether it does."""
        end = self.now() + seconds
        while not over() and self.now() < end:
            self._scouts += map(self._guest, self._more())
            for scout in self._scouts:
                scout.wait_for(over, self.step_s / len(self._scouts))
        return over()

    def _enough(self) -> bool:
        return len(self._claimed_at) >= self._wanted

    def _meet(self) -> None:
        """Watch the robots that have been found."""
        for each in (*self._scouts, *self.clients.values()):
            each.latest(FleetClaims)  # processes received messages
        for robot in sorted(self._claimed_at):
            name = f"{self.fleet}/{robot}"
            if name in self.clients:
                continue
            client = self._guest(self._join(name))
            client.listen(RobotState)  # needed for stopping the robot
            self.meet(name, client)
            if self.watch.began is not None:
                self._warn(f"{name}: has come")

    def _lacking(self) -> str:
        there = (
            ", ".join(f"{self.fleet}/{robot}" for robot in sorted(self._claimed_at)) or "no robot"
        )
        return (
            f"{there} of the fleet {self.fleet!r} is there after {self.come_s:g} s, and"
            f" {self._wanted} or more are waited for; `armadico up fleet --namespace"
            f" {self.fleet}/r1` brings a robot up on its machine; --namespace names the fleet, and"
            " --connect chooses where to look"
        )

    def _why_not(self, name: str) -> str:
        """Return why a robot can take no task now; "" if it can."""
        status = self.watch.status.get(short(name))
        return "its fleet agent has said nothing yet" if status is None else status.note

    def _able(self) -> list[str]:
        return [name for name in self.names if not self._why_not(name)]

    def _all_told(self) -> bool:
        return all(short(name) in self.watch.status for name in self.names)

    def _all_stopped(self) -> bool:
        states = [client.latest(RobotState) for client in self.clients.values()]
        return all(state is not None and state.stop.stopped for state in states)

    def _say_notes(self) -> None:
        for name in self.names:
            why = self._why_not(name)
            if why and why != self._notes.get(name):
                self._warn(f"{name}: {why}; until that is over it takes no task")
            self._notes[name] = why

    def _stop(self) -> None:
        """Order all stops before waiting for one: no robot drives on meanwhile."""
        for client in self.clients.values():
            with suppress(SocietyError, MeshError):
                client.stop(PRESS_S, by=BY)
        stopped = []
        for name, client in self.clients.items():
            try:
                client.stop(STOP_S, by=BY)
            except (SocietyError, MeshError) as failure:
                self._warn(f"{name}: {failure}; `armadico stop --namespace {name}` tries again")
            else:
                stopped.append(name)
        if stopped:
            self._warn(
                f"stopped: {', '.join(stopped)}; `armadico resume --namespace {stopped[0]}`"
                " releases one"
            )
        left = self.watch.tasks - len(self.watch.done)
        self._warn(
            f"the fleet remembers the list, of which {left} are not done: a robot that is released"
            " goes on with it; `armadico run --attach --replace` gives another one instead"
        )
