"""The fleet agent: shares a list of tasks with the other robots, and has its own done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from typing import Annotated, Any, ClassVar, Final

from msgspec import Meta

from armadico.agents.fleet.messages import (
    FleetBoard,
    FleetClaims,
    FleetPassages,
    FleetReply,
    FleetRequest,
    FleetStatus,
    FleetTask,
    FleetTasks,
)
from armadico.agents.fleet.task_sharing import TaskSharing, done_of
from armadico.agents.fleet.tours import TURN_S, Tours
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question, Refused
from armadico.core.exchange import Bid
from armadico.core.messages import Cycle, Description, Message, RobotState, line, next_count
from armadico.core.services import service_of
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.messages import (
    BatteryLevel,
    FleetPose,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    Waypoint,
)

SAY_S: Final = 1.0
"""From one report to the next; and who knows of no list asks for it so often."""

GIVE_S: Final = 0.2
"""Who knows the list gives it within this, drawn, unless somebody else was faster;"""

GIVEN_S: Final = 2.0
"""and does not again for so long."""

WAITS_MOST_S: Final = 600.0
"""A robot that waits before a passage for longer is stuck."""

POSE_CYCLES: Final = 2
"""The robot's cycles from one pose for the others to the next."""

SILENT_S: Final = 5.0
"""Of the robot's pose, or of its missions, nothing has come for so long: it can do nothing. Agents
that are started again are back sooner."""

PLANS: Final = 1
"""Ways that are planned in a cycle of the fleet, to know their length: the planner has others."""

TRIES: Final = 3
"""Who has tried a task so often in vain has given it up, unless all others have not."""

NO_LIST: Final = Cycle(0, 0)


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Which robot this is, the speed that it counts on, and what it does with what goes wrong."""

    namespace: Annotated[str, Meta(min_length=1)] = "robot1"
    cruise_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.4
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 25.0
    stuck_s: Annotated[float, Meta(gt=0, le=3600)] = 30.0
    """No nearer to a task for so long: somebody else may have it;"""

    again_s: Annotated[float, Meta(gt=0, le=3600)] = 20.0
    """and for so long it is not tried again; twice as long each time."""


class Fleet(Agent):
    """Bids for tasks against the other robots' fleet agents, and drives by missions of its own.

    It bids while its robot can: the pose is known, it is not stopped, and nobody has sent it
    elsewhere. Who has less energy left bids less (`methods/tours.py`). What cannot be done is given
    back, and so is everything when the agent or the robot dies: nobody hears its claims.
    """

    name = "fleet"
    alone = True
    hears: ClassVar[tuple[type[Message], ...]] = (
        *(Pose, BatteryLevel, MissionStatus, FleetTasks, FleetClaims, FleetPassages),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (
        *(FleetPose, FleetTasks, FleetClaims, FleetBoard, FleetStatus),
    )
    answers: ClassVar[tuple[type[Message], ...]] = (FleetRequest,)
    asks: ClassVar[tuple[type[Message], ...]] = (MissionRequest, PlanRequest)
    parameters = Parameters
    launched_with = ("namespace",)
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.robot = self.p.namespace.rpartition("/")[2]
        self._list: FleetTasks | None = None
        self._finished: set[int] = set()  # lists that are done
        self.sharing: TaskSharing | None = None
        self._tours = Tours((), (), self.p.cruise_m_s)
        self._order: list[int] = []  # of what it holds
        self._doing: int | None = None
        self._mission = 0  # by which that is driven to
        self._missions: set[int] = set()  # that it asked for
        self._asking = False
        self._looks_until: float | None = None
        self._to_go = self._nearest = inf  # m, to what it is doing
        self._nearer_at = 0.0
        self._waits_since: float | None = None  # before a passage
        self._elsewhere = False  # somebody has sent the robot
        self._pose_at = self._status_at = -inf  # when they last came
        self._barred: dict[int, float] = {}  # until when a task is not tried, s
        self._tries: dict[int, int] = {}
        self._plans = 0  # that may still be asked for in this cycle
        self._planning = False
        self._say_at = 0.0
        self._give_at: float | None = None
        self._given_at = -inf
        self._note = ""

    def key_of(self, kind: type[Message], **names: str) -> str:
        """Of what robots share each has a key of its own."""
        return super().key_of(kind, robot=self.robot, **names)

    def on_start(self) -> None:
        """Begin to publish now and then."""
        self._say_at = self.now
        self._set_alarm()

    # What comes in -------------------------------------------------------------------------------

    def on_pose(self, pose: Pose) -> None:
        """Tell the others where the robot is."""
        self._pose_at = self.now
        said, state = self.latest(Description), self.latest(RobotState)
        if said is None or state is None or pose.cycle.number % POSE_CYCLES:
            return
        self.publish(
            FleetPose(
                robot=self.robot,
                x=pose.x,
                y=pose.y,
                theta=pose.theta,
                covariance=pose.covariance,
                v=state.v,
                w=state.w,
                front=said.front,
                rear=said.rear,
                half_width=said.half_width,
            )
        )

    def on_fleet_request(self, question: Question) -> FleetReply:
        """Take a list on for all of the fleet; if it works on one, only instead of that."""
        request = question.request
        assert isinstance(request, FleetRequest)
        sharing = self.sharing
        at_work = sharing is not None and not sharing.over(self.now)
        if self._list is not None and sharing is not None and at_work and not request.replace:
            left, all_ = len(sharing.open), len(self._list.tasks)
            why = f"the fleet works on a list of {all_}, of which {left} are not done yet"
            return FleetReply(0, why)
        known = 0 if self._list is None else self._list.id
        self._adopt(FleetTasks(1 + self.rng.getrandbits(62), known, request.tasks))
        assert self._list is not None, "it was taken on"
        self.publish(self._list)
        self._remember()
        return FleetReply(self._list.id)

    def on_fleet_tasks(self, said: FleetTasks) -> None:
        """A list: taken on, if one's own is done or is the one before it."""
        known = self._list
        if known is None or said.follows == known.id or known.id in self._finished:
            if said.id not in self._finished and (known is None or said.id != known.id):
                self._adopt(said)
                self._remember()
            return
        self._give_at = None  # somebody was faster
        if said.id not in (known.id, known.follows):
            fleet = self.p.namespace.rpartition("/")[0]
            why = (
                f"a list that is not this fleet's, whose own is not done yet: two fleets are named"
                f" {fleet!r}; each goes on with its own; another --namespace tells them apart"
            )
            self.outbox.append(Refused(service_of(FleetTasks).key, why))

    def on_fleet_claims(self, said: FleetClaims) -> None:
        """What another robot holds, and knows to be done."""
        sharing, known = self.sharing, self._list
        if said.instance == self.instance:
            return
        if sharing is None or known is None or said.cycle.epoch != known.id:
            left = known is not None and (
                known.id not in self._finished or said.cycle.epoch == known.follows
            )
            late = self.now > self._given_at + GIVEN_S
            if (left or said.cycle == NO_LIST) and known is not None and late:
                if self._give_at is None:
                    self._give_at = self.now + self.rng.uniform(0.0, GIVE_S)
                self._set_alarm()
            return
        before = len(sharing.done)
        if sharing.hear(said, self.now):
            self._begin_cycle()
        if len(sharing.done) != before:
            self._remember()
        self._look_whether_done()
        self._go_on()

    def on_fleet_passages(self, said: FleetPassages) -> None:
        """Note that this robot waits before a passage: it is not stuck."""
        if said.robot != self.robot:
            return
        if not said.waits:
            self._waits_since = None
            return
        self._waits_since = self._waits_since or self.now
        if self.now - self._waits_since <= WAITS_MOST_S:
            self._nearer_at = self.now

    def on_fleet_board(self, board: FleetBoard) -> None:
        """What the other agents of this robot remember: this one was started again."""
        if self._list is None and board.tasks:
            self._adopt(FleetTasks(board.list, board.follows, board.tasks))
        if self.sharing is not None and self._list is not None and board.list == self._list.id:
            self.sharing.learn(board.done)
            self._missions.add(board.mission)
            self._look_whether_done()

    def on_mission_status(self, status: MissionStatus) -> None:
        """How far the robot is, if it is driven for a task."""
        self._status_at = self.now
        under_way = status.state in (MissionState.DRIVING, MissionState.PLANNING)
        self._elsewhere = under_way and status.mission not in self._missions
        if self._elsewhere and not self._asking:
            self._drop("somebody has sent the robot elsewhere")
        if self._doing is None or not self._mission or status.mission != self._mission:
            return
        self._to_go = status.to_go
        if status.to_go < self._nearest - 0.1:
            self._nearest, self._nearer_at = status.to_go, self.now
        if status.state is MissionState.REACHED and self._looks_until is None:
            assert self._list is not None, "of a list"
            self._looks_until = self.now + self._list.tasks[self._doing].look_s
            self._set_alarm()
        elif status.state is MissionState.FAILED:
            self._bar(self._doing, status.note)
        elif under_way and self.now - self._nearer_at > self.p.stuck_s:
            self._bar(self._doing, f"no nearer for {self.p.stuck_s:g} s")

    def on_wakeup(self) -> None:
        """Count on, take over, look no longer, give the list: whatever it is time for."""
        if self._give_at is not None and self.now >= self._give_at:
            self._give_at, self._given_at = None, self.now
            if self._list is not None:
                self.publish(self._list)
        sharing = self.sharing
        if sharing is not None and self.now >= sharing.wakeup and sharing.wake(self.now):
            self._begin_cycle()
        if self.now >= self._say_at:
            self._say_at = self.now + SAY_S
            self._report()
        self._go_on()

    # Its turn ------------------------------------------------------------------------------------

    def _begin_cycle(self) -> None:
        assert self.sharing is not None, "a cycle of a list has begun"
        self._look_whether_done()
        self._plans = PLANS
        self.sharing.turn(self._bids, self.now)

    def _bids(self) -> Mapping[int, Bid]:
        """What the robot would do."""
        sharing, pose = self.sharing, self.fresh(Pose)
        self._note = self._unfit(pose)
        over = self._list is not None and self._list.id in self._finished
        if self._note or over or sharing is None or pose is None:
            self._order = []
            return {}
        self._barred = {task: until for task, until in self._barred.items() if until > self.now}
        level = self.fresh(BatteryLevel)
        if level is not None:
            self._tours.left_j = max(level.joules, 1.0)
        held = [task for task in sharing.mine if task not in self._barred]
        pinned = self._doing if self._doing in held else None
        self._order = self._tours.ordered(pose, held, pinned)
        return self._tours.bids(
            sharing, pose, self._order, self._barred, self._first_s(pinned), pinned is not None
        )

    def _first_s(self, pinned: int | None) -> float | None:
        """How long it still takes to what it is doing."""
        if pinned is None or not self._mission or self._to_go == inf:
            return None
        return 0.0 if self._looks_until is not None else TURN_S + self._to_go / self.p.cruise_m_s

    def _unfit(self, pose: Pose | None) -> str:
        """Why the robot can do nothing now; "" if it can."""
        if self.stopped is not None:
            return f"stopped by {self.stopped.by}"
        # A pose stays fresh by its cycle if no cycle follows: the fleet's go on without the robot.
        silent = self.now - self._pose_at > SILENT_S
        if pose is None or silent or pose.deviation > LOST_M:
            return "nobody knows where the robot is"
        if self.now - self._status_at > SILENT_S:
            return "nobody says what becomes of a mission"
        if self._elsewhere:
            return "somebody has sent the robot elsewhere"
        return ""

    def _go_on(self) -> None:
        """Do what is to be done by what it holds now, and publish it."""
        sharing = self.sharing
        if sharing is not None:
            if self._doing is not None and self._doing not in sharing.mine:
                self._drop(self._note or "another robot does it")
            until = self._looks_until
            if self._doing is not None and until is not None and self.now >= until:
                self._done(self._doing)
            mine = sharing.mine
            if self._doing is None and not self._note:
                order = [task for task in self._order if task in mine and task not in self._barred]
                rest = [t for t in mine if t not in order and t not in self._barred]
                if order or rest:
                    self._start((order or rest)[0])
            self._plan_ahead()
            said = sharing.take()
            if said is not None:
                self.publish(said)
        self._set_alarm()

    def _start(self, task: int) -> None:
        """Have the interface agent send the robot there."""
        if self._asking or self._list is None:
            return
        self._doing, self._mission, self._looks_until = task, 0, None
        self._to_go = self._nearest = inf
        self._nearer_at = self.now
        self._asking = True
        wanted = self._list.id

        def taken(reply: MissionReply | None) -> None:
            self._asking = False
            if reply is not None and not reply.refusal:
                self._missions.add(reply.mission)
            if self._doing != task or self._list is None or self._list.id != wanted:
                if reply is not None and not reply.refusal:
                    self._stand()
            elif reply is None or reply.refusal:
                self._bar(task, "nobody takes missions" if reply is None else reply.refusal)
            else:
                self._mission, self._nearer_at = reply.mission, self.now
                self._to_go = self._nearest = reply.length
                self._remember()
            self._go_on()

        goal = self._list.tasks[task].goal
        self.ask(MissionRequest(goal), taken, self.p.planning_s)

    def _stand(self) -> None:
        """Stand where the robot is: what it drives to is another's, and there is nothing else."""
        pose = self.fresh(Pose)
        if pose is None or self._doing is not None:
            return

        def taken(reply: MissionReply | None) -> None:
            if reply is not None and not reply.refusal:
                self._missions.add(reply.mission)

        here = Waypoint(pose.x, pose.y, pose.theta)
        self.ask(MissionRequest(here, planned=False), taken)

    def _drop(self, why: str) -> None:
        """Do no longer what it is doing; the robot stands, if there is nothing else to do."""
        if self._doing is None:
            return
        self.log(f"task {self._doing} is left: {why}")
        drove, self._doing = self._mission, None
        self._mission, self._looks_until = 0, None
        if drove and not self._elsewhere and self.sharing is not None and not self.sharing.mine:
            self._stand()

    def _bar(self, task: int, why: str) -> None:
        """Give a task back that cannot be done now."""
        again = self.p.again_s * 2.0 ** min(self._tries.get(task, 0), 10)
        self._tries[task] = self._tries.get(task, 0) + 1
        self._barred[task] = self.now + again
        self.log(line(f"task {task} is given back for {again:g} s: {why}"), WARNING)
        self._drop(why)
        if self.sharing is not None:
            if self._tries[task] >= TRIES:
                self.sharing.given_up.add(task)
            self.sharing.let_go([task], self.now)
        self._go_on()

    def _done(self, task: int) -> None:
        assert self.sharing is not None, "a task of a list"
        self._doing, self._mission, self._looks_until = None, 0, None
        self._order = [other for other in self._order if other != task]
        self.sharing.finish(task, self.now)
        self.log(f"task {task} done; {len(self.sharing.open)} are left")
        self._remember()

    def _plan_ahead(self) -> None:
        """Ask how long the ways of its tour are."""
        if self._planning or self._plans <= 0 or self._list is None:
            return
        ends = self._tours.unknown(self._order)
        if ends is None:
            return
        self._plans -= 1
        self._planning = True
        tours, (a, b) = self._tours, ends

        def planned(plan: Plan | None) -> None:
            self._planning = False
            if plan is not None:
                tours.learn(a, b, None if plan.refusal else plan.length)
                if plan.length > 0.0:
                    tours.joules_a_s = plan.energy / plan.length * self.p.cruise_m_s
            self._plan_ahead()

        here, there = self._list.tasks[a].goal, self._list.tasks[b].goal
        self.ask(PlanRequest(here, there), planned, self.p.planning_s)

    # What is known -------------------------------------------------------------------------------

    def _adopt(self, said: FleetTasks) -> None:
        """Work on a list from now on."""
        self._drop("there is another list")
        if self._list is not None:
            self._finished.add(self._list.id)  # whoever still works on it does not bring it back
        self._list, self._give_at = said, None
        places, looks = _split(said.tasks)
        self._tours = Tours(places, looks, self.p.cruise_m_s)
        self._order = []
        self._barred, self._tries = {}, {}
        count = len(said.tasks)
        self.sharing = TaskSharing(self.robot, self.instance, said.id, count, self.rng, self.now)
        self.log(f"a list of {count} tasks")
        self._set_alarm()

    def _look_whether_done(self) -> None:
        known, sharing = self._list, self.sharing
        if known is None or sharing is None or known.id in self._finished:
            return
        if not sharing.over(self.now):
            return
        self._finished.add(known.id)
        left = ", ".join(map(str, sharing.open))
        if left:
            self.log(line(f"the list is over: nobody gets to {left}"), WARNING)
        else:
            self.log(f"all {len(known.tasks)} tasks are done")

    def _remember(self) -> None:
        """Have the robot's other agents remember what is known."""
        self._look_whether_done()
        known, sharing = self._list, self.sharing
        if known is None or sharing is None:
            return
        before = self.memory.newest(FleetBoard)
        counter = 1 if before is None else next_count(before.counter)
        done, mission = done_of(sharing.done), self._mission
        self.publish(FleetBoard(counter, known.id, known.follows, known.tasks, done, mission))

    def _report(self) -> None:
        known, sharing = self._list, self.sharing
        if known is None or sharing is None:
            nothing = FleetClaims(self.robot, self.instance, NO_LIST)
            self.publish(nothing)
            self.publish(FleetStatus(0, 0, 0, (), note=line(self._unfit(self.fresh(Pose)))))
            return
        mine = sharing.mine
        order = [task for task in self._order if task in mine]
        holds = (*order, *(task for task in mine if task not in order))
        pose = self.latest(Pose)
        finish = 0.0
        if pose is not None and holds:
            finish = self._tours.finish(pose, holds, self._first_s(self._doing))
        count, note = len(known.tasks), line(self._note)
        done = count - len(sharing.open)
        self.publish(FleetStatus(known.id, count, done, holds, min(finish, 1e9), note))

    def _set_alarm(self) -> None:
        """Have it woken when something is due."""
        due = [self._say_at]
        if self.sharing is not None:
            due.append(self.sharing.wakeup)
        if self._give_at is not None:
            due.append(self._give_at)
        if self._looks_until is not None:
            due.append(self._looks_until)
        self.wake_at(min(due))


def _split(tasks: Sequence[FleetTask]) -> tuple[list[Waypoint], list[float]]:
    """Where tasks are, and how long is looked."""
    return [task.goal for task in tasks], [task.look_s for task in tasks]
