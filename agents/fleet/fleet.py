"""The fleet agent: shares a list of tasks with the other robots, and has its own tasks done."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from math import inf
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from armadico.agents.fleet.messages import (
    FleetBoard,
    FleetClaims,
    FleetPassages,
    FleetReply,
    FleetRequest,
    FleetStatus,
    FleetTasks,
)
from armadico.agents.fleet.task_sharing import TaskSharing, done_of
from armadico.agents.fleet.tours import TURN_S, Tours
from armadico.core import agent
from armadico.core.agent import WARNING, Agent, Question
from armadico.core.exchange import Bid
from armadico.core.mechanisms import chosen
from armadico.core.messages import (
    Cycle,
    Description,
    Message,
    RobotState,
    line,
    next_count,
)
from armadico.core.services import service_of
from armadico.mobile.behaviour import LOST_M
from armadico.mobile.driven import Event, Ordered
from armadico.mobile.messages import (
    BatteryLevel,
    FleetAwards,
    FleetPose,
    FleetProposals,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Pose,
    Waypoint,
)

REPORT_S: Final = 1.0  # the period of reports, and of requests for a list while none is known

# A list is sent on request after a random time of up to this, unless another robot was faster.
GIVE_S: Final = 0.2

GIVEN_S: Final = 2.0  # the shortest time between two such answers

WAITS_MOST_S: Final = 600.0  # a robot that waits longer before a passage is stuck

POSE_CYCLES: Final = 2  # the robot's cycles between two poses for the other robots

# Without a pose or a mission's status for this time the robot can do nothing. Restarted agents are
# back sooner.
SILENT_S: Final = 5.0

# Paths planned per cycle of the fleet to learn their length: the planner has other requests, too.
PLANS: Final = 1

# A robot that has failed a task this often gives it up, unless it is the last one to try.
TRIES: Final = 3

NO_LIST: Final = Cycle(0, 0)


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The robot's name, its expected speed, and timeouts."""

    namespace: Annotated[str, Meta(min_length=1)] = "robot1"
    cruise_m_s: Annotated[float, Meta(gt=0, le=10)] = 0.4
    planning_s: Annotated[float, Meta(gt=0, le=120)] = 25.0
    stuck_s: Annotated[float, Meta(gt=0, le=3600)] = 30.0  # no nearer for so long: the task is left
    again_s: Annotated[float, Meta(gt=0, le=3600)] = 20.0  # until its next try; doubled each time


class Work:
    """One list of tasks that this robot works on.

    Attributes:
        list: The list.
        sharing: Which robot holds which task, as far as is known.
        tours: The paths between the tasks.
        order: The tasks that this robot holds, in order.
        barred: The time until which a task is not tried, s, by task.
        tries: The number of failed tries, by task.
        finished: Whether the list is over.
    """

    def __init__(self, tasks: FleetTasks, sharing: TaskSharing, cruise_m_s: float) -> None:
        self.list, self.sharing = tasks, sharing
        places, looks = [task.goal for task in tasks.tasks], [task.look_s for task in tasks.tasks]
        self.tours = Tours(places, looks, cruise_m_s)
        self.order: list[int] = []
        self.barred: dict[int, float] = {}
        self.tries: Counter[int] = Counter()
        self.finished = False

    @property
    def held(self) -> list[int]:
        """The tasks that it holds: first in their order, then those without a place in it."""
        mine = self.sharing.mine
        order = [task for task in self.order if task in mine]
        return [*order, *(task for task in mine if task not in order)]


class Fleet(Agent):
    """Bids for tasks against the other robots' fleet agents, and drives by missions of its own.

    It bids while its robot can drive: the pose is known, and the robot is neither stopped nor
    driven for others. A robot with less energy bids less (`tours.py`). Tasks that cannot be done
    are released; so are all tasks if the agent or the robot dies, because its claims expire.
    """

    name = "fleet"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (
        *(Pose, BatteryLevel, MissionStatus, FleetTasks, FleetClaims, FleetPassages, FleetAwards),
    )
    provides: ClassVar[tuple[type[Message], ...]] = (
        *(FleetPose, FleetTasks, FleetClaims, FleetBoard, FleetStatus, FleetProposals),
    )
    answers: ClassVar[tuple[type[Message], ...]] = (FleetRequest,)
    queries: ClassVar[tuple[type[Message], ...]] = (MissionRequest, PlanRequest)
    competes_later = ("task-",)
    parameters = Parameters
    launched_with = ("namespace", "social.coordination")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.robot = self.p.namespace.rpartition("/")[2]
        self.key_names = {"robot": self.robot}
        self.work: Work | None = None
        self._over: set[int] = set()  # earlier lists, done or not
        self._doing: int | None = None
        self._drive = Ordered()  # the mission of the current task
        self._looks_until: float | None = None
        self._doubt = ""  # why it is unknown whether the robot is at its task; empty: it is
        self._waits_since: float | None = None  # before a passage
        self._elsewhere = False  # the robot is driven for others
        self._pose_at = self._status_at = -inf  # when they were last received
        self._plans = 0  # plans that may still be requested in this cycle
        self._planning = False
        self._report_at = 0.0
        self._give_at: float | None = None
        self._given_at = -inf
        self._note = ""

    def on_start(self) -> None:
        """Begin to publish regularly."""
        self._report_at = self.now
        self._set_alarm()

    # Inputs --------------------------------------------------------------------------------------

    def on_pose(self, pose: Pose) -> None:
        """Publish the robot's pose for the other robots."""
        self._pose_at = self.now
        footprint, state = self.latest(Description), self.latest(RobotState)
        if footprint is None or state is None or pose.cycle.number % POSE_CYCLES:
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
                front=footprint.front,
                rear=footprint.rear,
                half_width=footprint.half_width,
            )
        )

    def on_fleet_request(self, request: FleetRequest, _question: Question) -> FleetReply:
        """Accept a list for the fleet; while it works on another, only with `replace`."""
        work = self.work
        if work is not None and not work.sharing.over(self.now) and not request.replace:
            left, all_ = len(work.sharing.open), len(work.list.tasks)
            why = f"the fleet works on a list of {all_}, of which {left} are not done yet"
            return FleetReply(0, why)
        known = 0 if work is None else work.list.id
        tasks = FleetTasks(1 + self.rng.getrandbits(62), known, request.tasks)
        work = self._adopt(tasks)
        self.publish(tasks)
        self._remember(work)
        return FleetReply(tasks.id)

    def on_fleet_tasks(self, tasks: FleetTasks) -> None:
        """Adopt a list if the own one is done, or is the one that it follows."""
        work = self.work
        if work is None or tasks.follows == work.list.id or work.finished:
            if tasks.id not in self._over and (work is None or tasks.id != work.list.id):
                self._remember(self._adopt(tasks))
            return
        self._give_at = None  # another robot was faster
        if tasks.id not in (work.list.id, work.list.follows):
            fleet = self.p.namespace.rpartition("/")[0]
            why = (
                f"a list that is not this fleet's, whose own is not done yet: two fleets are named"
                f" {fleet!r}; each goes on with its own; another --namespace tells them apart"
            )
            self.refuse(service_of(FleetTasks).pattern, why)

    def on_fleet_claims(self, message: FleetClaims) -> None:
        """Process another robot's claims and done tasks; send it the list if it has none."""
        work = self.work
        if message.instance == self.instance or work is None:
            return
        if message.cycle.epoch != work.list.id:
            left = not work.finished or message.cycle.epoch == work.list.follows
            if (left or message.cycle == NO_LIST) and self.now > self._given_at + GIVEN_S:
                if self._give_at is None:
                    self._give_at = self.now + self.rng.uniform(0.0, GIVE_S)
                self._set_alarm()
            return
        before = len(work.sharing.done)
        if work.sharing.on_claims(message, self.now):
            self._begin_cycle(work)
        if len(work.sharing.done) != before:
            self._remember(work)
        self._check_done(work)
        self._go_on()

    def on_fleet_awards(self, message: FleetAwards) -> None:
        """Process an arbiter's decisions about tasks."""
        work = self.work
        if work is None:
            return
        if why := work.sharing.on_awards(message, self.now):
            self.refuse(service_of(FleetAwards).key, why)
        self._go_on()

    def on_fleet_passages(self, message: FleetPassages) -> None:
        """Note that this robot waits before a passage, so that it does not count as stuck."""
        if message.robot != self.robot:
            return
        if not message.waits:
            self._waits_since = None
            return
        self._waits_since = self._waits_since or self.now
        if self.now - self._waits_since <= WAITS_MOST_S:
            self._drive.nearer_at = self.now

    def on_fleet_board(self, board: FleetBoard) -> None:
        """Restore the state from the robot's other agents after a restart."""
        work = self.work
        if work is None and board.tasks:
            work = self._adopt(FleetTasks(board.list, board.follows, board.tasks))
        if work is not None and board.list == work.list.id:
            work.sharing.learn(board.done)
            self._drive.own.add(board.mission)
            self._check_done(work)

    def on_mission_status(self, status: MissionStatus) -> None:
        """Update the progress of the current task; detect drives for others."""
        self._status_at = self.now
        under_way = status.state in (MissionState.DRIVING, MissionState.PLANNING)
        self._elsewhere = under_way and status.mission not in self._drive.own
        if self._elsewhere and not self._drive.pending:
            self._drop("the robot was sent elsewhere")
        work, doing, mission = self.work, self._doing, self._drive.mission
        if work is None or doing is None or not mission or status.mission != mission:
            return
        event = self._drive.update(status, self.now)
        if event is Event.REACHED:
            self._doubt = status.doubt
            self._looks_until = self.now + work.list.tasks[doing].look_s
            self._set_alarm()
        elif event is Event.FAILED:
            self._bar(work, doing, status.note)
        elif under_way and self.now - self._drive.nearer_at > self.p.stuck_s:
            self._bar(work, doing, f"no nearer for {self.p.stuck_s:g} s")

    def on_wakeup(self) -> None:
        """Do what is due: send the list, count a cycle, report, end an observation."""
        work = self.work
        if self._give_at is not None and self.now >= self._give_at:
            self._give_at, self._given_at = None, self.now
            if work is not None:
                self.publish(work.list)
        if work is not None and self.now >= work.sharing.wakeup and work.sharing.wake(self.now):
            self._begin_cycle(work)
        if self.now >= self._report_at:
            self._report_at = self.now + REPORT_S
            self._report()
        self._go_on()

    # The turn ------------------------------------------------------------------------------------

    def _begin_cycle(self, work: Work) -> None:
        self._check_done(work)
        self._plans = PLANS
        work.sharing.turn(lambda: self._bids(work), self.now)

    def _bids(self, work: Work) -> Mapping[int, Bid]:
        """Return the robot's bids."""
        pose = self.fresh(Pose)
        self._note = self._unfit(pose)
        if self._note or work.finished or pose is None:
            work.order = []
            return {}
        work.barred = {task: until for task, until in work.barred.items() if until > self.now}
        level = self.fresh(BatteryLevel)
        if level is not None:
            work.tours.left_j = max(level.joules, 1.0)
        held = [task for task in work.sharing.mine if task not in work.barred]
        pinned = self._doing if self._doing in held else None
        work.order = work.tours.ordered(pose, held, pinned)
        first_s = self._first_s(pinned)
        return work.tours.bids(
            work.sharing, pose, work.order, work.barred, first_s, pinned is not None
        )

    def _first_s(self, pinned: int | None) -> float | None:
        """Return the remaining time to the current task, s, if known."""
        to_go = self._drive.to_go
        if pinned is None or not self._drive.mission or to_go == inf:
            return None
        return 0.0 if self._looks_until is not None else TURN_S + to_go / self.p.cruise_m_s

    def _unfit(self, pose: Pose | None) -> str:
        """Return why the robot can do nothing now; "" if it can."""
        if self.stopped is not None:
            return f"stopped by {self.stopped.by}"
        # A pose stays fresh while no newer cycle follows: the fleet's cycles go on without them.
        silent = self.now - self._pose_at > SILENT_S
        if pose is None or silent or pose.deviation > LOST_M:
            return "the robot's pose is not known"
        if self.now - self._status_at > SILENT_S:
            return "the state of a mission is not known: no mission/status"
        if self._elsewhere:
            return "the robot was sent elsewhere"
        return ""

    def _go_on(self) -> None:
        """Do the next task that it holds, and publish the claims."""
        work = self.work
        if work is not None:
            if self._doing is not None and self._doing not in work.sharing.mine:
                self._drop(self._note or "another robot does it")
            until = self._looks_until
            if self._doing is not None and until is not None and self.now >= until:
                self._done(work, self._doing)
            if self._doing is None and not self._note and not self._drive.pending:
                following = next((task for task in work.held if task not in work.barred), None)
                if following is not None:
                    self._start(work, following)
            self._plan_ahead()
            claims = work.sharing.drain()
            if claims is not None:
                self.publish(claims)
            proposals = work.sharing.next_proposals(self.robot)
            if proposals is not None:
                self.publish(proposals)
        self._set_alarm()

    def _start(self, work: Work, task: int) -> None:
        """Request the drive to a task from the interface agent."""
        self._end_drive()
        self._doing = task
        self._drive.request(self.now)

        def on_reply(reply: MissionReply | None) -> None:
            refusal = self._drive.answered(reply, self.now)
            if self._doing is None:  # the task was dropped meanwhile
                if not refusal:
                    self._stand()
            elif refusal:
                self._bar(work, task, refusal)
            else:
                self._remember(work)
            self._go_on()

        self.query(
            MissionRequest(work.list.tasks[task].goal, by=self.name), on_reply, self.p.planning_s
        )

    def _end_drive(self) -> None:
        self._drive.drop()
        self._doing, self._looks_until = None, None

    def _stand(self) -> None:
        """Stand where the robot is: its task belongs to another robot, and there is no other."""
        pose = self.fresh(Pose)
        if pose is None or self._doing is not None:
            return

        def on_reply(reply: MissionReply | None) -> None:
            if reply is not None and not reply.refusal:
                self._drive.own.add(reply.mission)

        here = Waypoint(pose.x, pose.y, pose.theta)
        self.query(MissionRequest(here, planned=False, by=self.name), on_reply)

    def _drop(self, why: str) -> None:
        """Leave the current task; the robot stands if there is no other."""
        if self._doing is None:
            return
        self.log(f"task {self._doing} is left: {why}")
        drove = self._drive.mission
        self._end_drive()
        if drove and not self._elsewhere and self.work is not None and not self.work.sharing.mine:
            self._stand()

    def _bar(self, work: Work, task: int, why: str) -> None:
        """Release a task that cannot be done now."""
        again = self.p.again_s * 2.0 ** min(work.tries[task], 10)
        work.tries[task] += 1
        work.barred[task] = self.now + again
        self.log(line(f"task {task} is given back for {again:g} s: {why}"), WARNING)
        self._drop(why)
        if work.tries[task] >= TRIES:
            work.sharing.given_up.add(task)
        work.sharing.release([task], self.now)
        self._go_on()

    def _done(self, work: Work, task: int) -> None:
        self._end_drive()
        work.order = [other for other in work.order if other != task]
        work.sharing.finish(task, self.now, unsure=bool(self._doubt))
        end = f"unsure: {self._doubt}" if self._doubt else "done"
        self.log(line(f"task {task} {end}; {len(work.sharing.open)} are left"))
        self._remember(work)

    def _plan_ahead(self) -> None:
        """Request the lengths of the paths of its tour."""
        if self._planning or self._plans <= 0 or self.work is None:
            return
        tours = self.work.tours
        ends = tours.unknown(self.work.order)
        if ends is None:
            return
        self._plans -= 1
        self._planning = True
        a, b = ends

        def planned(plan: Plan | None) -> None:
            self._planning = False
            if plan is not None:
                tours.learn(a, b, None if plan.refusal else plan.length)
                if plan.length > 0.0:
                    tours.joules_a_s = plan.energy / plan.length * self.p.cruise_m_s
            self._plan_ahead()

        here, there = (self.work.list.tasks[end].goal for end in ends)
        self.query(PlanRequest(here, there), planned, self.p.planning_s)

    # State ---------------------------------------------------------------------------------------

    def _adopt(self, tasks: FleetTasks) -> Work:
        """Work on a list from now on."""
        self._drop("there is another list")
        if self.work is not None:
            self._over.add(self.work.list.id)  # a robot that still works on it cannot restore it
        count = len(tasks.tasks)
        sharing = TaskSharing(
            *(self.robot, self.instance, tasks.id, count, self.rng, self.now),
            lambda resource, clock: chosen(resource, self, clock)[1],
        )
        self.work, self._give_at = Work(tasks, sharing, self.p.cruise_m_s), None
        self.log(f"a list of {count} tasks")
        self._set_alarm()
        return self.work

    def _check_done(self, work: Work) -> None:
        if work.finished or not work.sharing.over(self.now):
            return
        work.finished = True
        self._over.add(work.list.id)
        left = ", ".join(map(str, work.sharing.open))
        if left:
            self.log(line(f"the list is over: no robot reaches {left}"), WARNING)
        else:
            self.log(f"all {len(work.list.tasks)} tasks are done")

    def _remember(self, work: Work) -> None:
        """Publish the state for the robot's other agents to remember."""
        self._check_done(work)
        before, known = self.memory.newest(FleetBoard), work.list
        counter = 1 if before is None else next_count(before.counter)
        done, mission = done_of(work.sharing.done), self._drive.mission
        self.publish(FleetBoard(counter, known.id, known.follows, known.tasks, done, mission))

    def _report(self) -> None:
        work = self.work
        if work is None:
            nothing = FleetClaims(self.robot, self.instance, NO_LIST)
            self.publish(nothing)
            self.publish(FleetStatus(0, 0, 0, (), note=line(self._unfit(self.fresh(Pose)))))
            return
        holds, pose, finish = tuple(work.held), self.latest(Pose), 0.0
        if pose is not None and holds:
            finish = work.tours.finish(pose, holds, self._first_s(self._doing))
        count, note = len(work.list.tasks), line(self._note)
        done = count - len(work.sharing.open)
        self.publish(FleetStatus(work.list.id, count, done, holds, min(finish, 1e9), note))

    def _set_alarm(self) -> None:
        """Schedule the next wakeup."""
        shared = None if self.work is None else self.work.sharing.wakeup
        due = (self._report_at, shared, self._give_at, self._looks_until)
        self.wake_at(min(at for at in due if at is not None))
